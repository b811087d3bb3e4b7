"""Subspace fitting: how much of a factor of the data K sources do not explain, the objective of NEEF."""

from __future__ import annotations

from functools import partial
from typing import final

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

from nfbench import Problem

from ..objectives import kernels
from ..subspace import compress
from ..wavefronts import Manifold
from .general_fit import GeneralFit

__all__ = ["SubspaceFit"]

RANK = 1e-16  # as in ``kernels/singular.py``


@final
class SubspaceFit(Problem):
    """J(x) = ‖(I − P_A)F‖²_F = ‖F‖² − tr(BᴴG⁻¹B) with G = AᴴA, B = AᴴF; x = [θ_1 … θ_K], n = dK, 0 <= J <= ‖F‖².

    One family of objectives (Viberg & Ottersten 1991, doi:10.1109/78.80966), which differ in F: see ``factor``. The
    gradient is that of a variable projection (Golub & Pereyra 1973, doi:10.1137/0710036). J is a difference: rounding
    changes it by some 1e-15·‖F‖² where responses are well apart, and by less than 1e-8·‖F‖² everywhere.

    P_A projects onto the span of the responses, whatever their number and order. Candidates whose G is nearly singular,
    as where sources run together or where K is near M, are evaluated by a rank-revealing factorization, which takes
    longer. A response closer to the span of the others than RANK (``kernels/singular.py``) adds nothing to it, because
    rounding would decide in which direction it leaves the span. J then is that of the other sources, and jumps where a
    source comes that close; the gradient is that of the pseudo-inverse of A.

    F: the factor, shape (M, c).
    manifold: array and wavefront model.
    lower: lower bounds of one source [rad, m], shape (d,).
    upper: upper bounds of one source [rad, m], shape (d,).
    sources: number K of sources; None: c.

    Raises ValueError where shapes differ, F is not finite, or ``sources`` is less than 1.
    """

    has_gradient = True

    def __init__(
        self,
        F: Complex[ndarray, "m c"],
        manifold: Manifold,
        lower: Float[ndarray, " d"],
        upper: Float[ndarray, " d"],
        sources: int | None = None,
    ) -> None:
        if F.ndim != 2 or len(F) != manifold.elements or not F.shape[1]:
            raise ValueError(f"F: expected shape ({manifold.elements}, c), got {F.shape}")
        if not np.isfinite(F).all():
            raise ValueError("F: expected finite entries, got NaN or infinite entries")
        if lower.shape != (manifold.dimension,) or upper.shape != lower.shape:
            raise ValueError(f"lower, upper: expected shape ({manifold.dimension},), got {lower.shape}, {upper.shape}")
        K = F.shape[1] if sources is None else sources
        if K < 1:
            raise ValueError(f"sources: expected at least 1, got {K}")
        self.factor: Complex[ndarray, "m c"] = F
        self.manifold = manifold
        self.sources = K
        self.lower, self.upper = np.tile(lower, K), np.tile(upper, K)
        self._no_gradients = np.empty((0, K * manifold.dimension))
        kernels.warm_up()
        if not manifold.has_unit_modulus:
            general = GeneralFit(F, manifold, K, least=RANK)
            self._kernel, self._kernel_and_gradient = general.evaluate, general.value_and_gradient
            return
        fit = *manifold.packed, _energy(F), *kernels.pack_factor(_triangular(F), K)
        self._kernel = partial(kernels.misfit, *fit)
        self._kernel_and_gradient = partial(kernels.misfit_and_gradient, *fit)
        self._fill_singular = partial(kernels.fill_singular, *fit)

    def evaluate(self, X: Float[ndarray, "p n"]) -> Float[ndarray, " p"]:
        J: Float[ndarray, " p"] = self._kernel(X)
        if len(J) and J.min() < 0:
            self._fill_singular(X, J, self._no_gradients)
        return J

    def value(self, x: Float[ndarray, " n"]) -> float:
        J = float(self._kernel(x[None])[0])
        return self._singular(x, self._no_gradients) if J < 0 else J

    def value_and_gradient(self, x: Float[ndarray, " n"]) -> tuple[float, Float[ndarray, " n"]]:
        J, gradient = self._kernel_and_gradient(x)
        return self._singular(x, gradient[None]) if J < 0 else J, gradient

    def _singular(self, x: Float[ndarray, " n"], gradient: Float[ndarray, "q n"]) -> float:
        """Return J of a candidate whose G is nearly singular, and write ∂J into the row of ``gradient``, if any."""
        J = np.array([-1.0])
        self._fill_singular(x[None], J, gradient)
        return float(J[0])


def _energy(F: Complex[ndarray, "m c"]) -> float:
    """Return ‖F‖²; exactly c if the columns are orthonormal, as those of U_s."""
    c = F.shape[1]
    is_orthonormal = c <= len(F) and np.allclose(F.conj().T @ F, np.eye(c), rtol=0, atol=1e-12)
    return float(c) if is_orthonormal else float(np.vdot(F, F).real)


def _triangular(F: Complex[ndarray, "m c"]) -> Complex[ndarray, "m c"]:
    """Return F, or if it has many columns, a lower triangular factor of F·Fᴴ, which gives the same J."""
    return compress(F) if F.shape[1] > kernels.LANES and np.triu(F, 1).any() else F
