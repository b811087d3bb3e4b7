"""The conditional fit: how well data are explained by given sources and one more, an objective of one source."""

from __future__ import annotations

from functools import partial
from typing import final

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray
from scipy.linalg import qr

from nfbench import Problem

from ..subspace import compress
from ..wavefronts import Manifold
from . import kernels, kernels_conditional
from .general_fit import GeneralFit

__all__ = ["LEAST", "ConditionalFit"]

LEAST = 1e-8
"""The least squared distance ‖P⊥a‖² of a response from the span of the others, relative to M.

Below it a source adds nothing to the others: the misfit is that of the others. Rounding changes N/D by some 1e-16·M/D
of its value, so J keeps eight digits of what a candidate explains. Two sources at this limit are about 5e-5 beamwidths
apart, which no realistic SNR resolves."""


@final
class ConditionalFit(Problem):
    """J(θ) = ‖(I − P_[A, a(θ)])F‖²_F = ‖F⊥‖² − ‖F⊥ᴴa‖²/‖P⊥a‖², F⊥ = P⊥F, n = 2, or 3 with elevation.

    P⊥ = I − P_A projects off the responses A of the other sources. As a function of one source with the others fixed,
    this is the objective of subspace fitting, and one step of alternating projection minimizes it (Ziskind & Wax 1988,
    doi:10.1109/29.7543). Without other sources it is RLS. J is smooth except where a(θ) is in the span of the others:
    there J = ‖F⊥‖² (see LEAST), while in every neighbourhood of such a point J may be lower. The value has the unit of
    ‖F‖².

    factor: (M, c) the data or any factor F of them. lower, upper: (d,) the box of one source [rad, m]. others: (k, d)
    the other sources [rad, m], where k may be 0, and sources may coincide. Raises ValueError where shapes differ, or
    where the factor or the other sources are not finite.
    """

    has_gradient = True

    def __init__(
        self,
        factor: Complex[ndarray, "m c"],
        manifold: Manifold,
        lower: Float[ndarray, " d"],
        upper: Float[ndarray, " d"],
        others: Float[ndarray, "k d"],
    ) -> None:
        M, d = manifold.elements, manifold.dimension
        if factor.ndim != 2 or len(factor) != M:
            raise ValueError(f"factor: expected shape ({M}, c), got {factor.shape}")
        if not np.isfinite(factor).all():
            raise ValueError("factor: expected finite data, got NaN or infinite entries")
        if lower.shape != (d,) or upper.shape != lower.shape:
            raise ValueError(f"lower, upper: expected shape ({d},), got {lower.shape}, {upper.shape}")
        if others.ndim != 2 or others.shape[1] != d or not np.isfinite(others).all():
            raise ValueError(f"others: expected finite sources of shape (k, {d}), got {others.tolist()}")
        self.lower, self.upper = lower, upper
        self.factor, self.manifold, self.others = factor, manifold, others
        kernels_conditional.warm_up()
        if not manifold.has_unit_modulus:
            general = GeneralFit(factor, manifold, least=LEAST, others=others)
            self._kernel, self._kernel_and_gradient = general.evaluate, general.value_and_gradient
            return
        Q = _basis(manifold.response(others).T)
        remaining = factor
        for _ in range(2):  # F⊥; the second projection removes what rounding leaves of a large F
            remaining = remaining - Q @ (Q.conj().T @ remaining)
        rows = kernels.pack_rows(np.hstack([Q, compress(remaining)]))
        fit = *manifold.packed, rows, Q.shape[1], float(np.vdot(remaining, remaining).real), LEAST * M
        self._kernel = partial(kernels_conditional.conditional_misfit, *fit)
        self._kernel_and_gradient = partial(kernels_conditional.conditional_misfit_and_gradient, *fit)

    def evaluate(self, X: Float[ndarray, "p n"]) -> Float[ndarray, " p"]:
        J: Float[ndarray, " p"] = self._kernel(X)
        return J

    def value(self, x: Float[ndarray, " n"]) -> float:
        return float(self._kernel(x[None])[0])

    def value_and_gradient(self, x: Float[ndarray, " n"]) -> tuple[float, Float[ndarray, " n"]]:
        """The value and the gradient; the gradient is 0 where a(θ) is in the span of the others."""
        J, gradient = self._kernel_and_gradient(x)
        return J, gradient


def _basis(A: Complex[ndarray, "m k"]) -> Complex[ndarray, "m r"]:
    """Return an orthonormal basis of the columns of A; those nearly in the span of others do not enlarge it."""
    if not A.shape[1]:
        return A
    Q, R, _ = qr(A, mode="economic", pivoting=True)
    rank = np.count_nonzero(np.abs(np.diag(R)) ** 2 > LEAST * len(A))
    basis: ndarray = Q[:, :rank]
    return basis
