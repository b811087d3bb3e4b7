"""The factors that subspace fitting fits: ESF, WSF and DML."""

from __future__ import annotations

import math
from typing import Literal, TypeAlias

import numpy as np
from jaxtyping import Complex
from numpy import ndarray

from ..subspace import compress, decompose

__all__ = ["Objective", "factor"]

Objective: TypeAlias = Literal["esf", "wsf", "dml"]
"""What K sources are fitted to: the signal subspace, the weighted signal subspace, or all data."""


def factor(Y: Complex[ndarray, "m t"], sources: int, objective: Objective) -> Complex[ndarray, "m c"]:
    """Return the factor F of J(x) = ‖(I − P_A)F‖²_F, with the eigenvalues λ_i and the eigenvectors U_s of R̂ = Y·Yᴴ/T.

    esf: U_s, unit weights (c = K).
    wsf: U_s·diag((λ_i − σ̂²)/√λ_i), weight 0 where λ_i <= σ̂², σ̂² the mean of the M − K smallest eigenvalues; attains
        the stochastic Cramér–Rao bound (Viberg, Ottersten & Kailath 1991) (c = K).
    dml: L/√T with L·Lᴴ = Y·Yᴴ, so that J = tr((I − P_A)·R̂): deterministic maximum likelihood (Ziskind & Wax 1988,
        doi:10.1109/29.7543); also for fewer snapshots T than sources, and coherent sources (c = min(M, T)).

    Raises Incompatible if the objective needs more snapshots than there are, and ValueError if Y is not finite.

    Y: received data, shape (M, T).
    sources: number K of sources.
    objective: "esf", "wsf" or "dml".
    """
    if objective == "dml":
        if not np.isfinite(Y).all():
            raise ValueError("Y: expected finite data, got NaN or infinite entries")
        return compress(Y) / math.sqrt(Y.shape[1])
    U_s, eigenvalues, noise = decompose(Y, sources)
    if objective == "esf":
        return U_s
    signal = np.maximum(eigenvalues - noise, 0.0)
    weights = np.divide(signal, np.sqrt(eigenvalues), out=np.zeros_like(signal), where=signal > 0)
    return U_s * weights
