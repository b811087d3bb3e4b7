"""ESF: how far the signal subspace is from the span of K candidate sources, the objective of NEEF."""

from __future__ import annotations

from functools import partial
from typing import final

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

from nfbench import Problem

from ..objectives import kernels
from ..wavefronts import Manifold

__all__ = ["ESF", "RIDGE"]

RIDGE = 1e-13
"""The least pivot of Cholesky's factorization of G, relative to M.

A pivot is the squared distance of a response from the span of those before it. Where two candidates coincide it
vanishes up to rounding, and is raised to this value: the second adds nothing to the span, and J is that of the others.
Rounding alone changes J by up to about 1e-15·cond(A)², so J has digits as long as cond(A) is below about 1e7. For K
well below M, only candidates that nearly coincide exceed that. For K near M, candidates that are apart exceed it too:
J then depends on the order of the candidates, may be wrong in its first digit, and may be NaN."""


@final
class ESF(Problem):
    """J(x) = ‖(I − P_A)U_s‖²_F = K − tr(BᴴG⁻¹B) with G = AᴴA, B = AᴴU_s; x = [θ_1 … θ_K], n = dK, 0 <= J <= K.

    Subspace fitting with unit weights (Viberg & Ottersten 1991, doi:10.1109/78.80966); the gradient is that of a
    variable projection (Golub & Pereyra 1973, doi:10.1137/0710036). J is smooth except where candidates coincide, and
    accurate for K well below M (see RIDGE).

    U_s: (M, K) orthonormal. lower, upper: (d,) the box of one source [rad, m]. Raises ValueError where shapes differ.
    """

    has_gradient = True

    def __init__(
        self,
        U_s: Complex[ndarray, "m k"],
        manifold: Manifold,
        lower: Float[ndarray, " d"],
        upper: Float[ndarray, " d"],
    ) -> None:
        if U_s.ndim != 2 or len(U_s) != manifold.elements:
            raise ValueError(f"U_s: expected shape ({manifold.elements}, K), got {U_s.shape}")
        if lower.shape != (manifold.dimension,) or upper.shape != lower.shape:
            raise ValueError(f"lower, upper: expected shape ({manifold.dimension},), got {lower.shape}, {upper.shape}")
        self._sources = U_s.shape[1]
        self.lower, self.upper = np.tile(lower, self._sources), np.tile(upper, self._sources)
        self.factor = U_s  # F of J = ‖(I − P_A)F‖²
        kernels.warm_up()
        fit = *manifold.packed, RIDGE * manifold.elements, *kernels.pack_subspace(U_s)
        self._kernel = partial(kernels.esf, *fit)
        self._kernel_one = partial(kernels.esf_one, *fit)
        self._kernel_and_gradient = partial(kernels.esf_and_gradient, *fit)

    def evaluate(self, X: Float[ndarray, "p n"]) -> Float[ndarray, " p"]:
        J: Float[ndarray, " p"] = self._kernel(X)
        return J

    def value(self, x: Float[ndarray, " n"]) -> float:
        J: float = self._kernel_one(x)
        return J

    def value_and_gradient(self, x: Float[ndarray, " n"]) -> tuple[float, Float[ndarray, " n"]]:
        J, gradient = self._kernel_and_gradient(x)
        return J, gradient
