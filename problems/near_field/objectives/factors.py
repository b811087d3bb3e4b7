"""The factors that subspace fitting fits: ESF, WSF and DML."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal, TypeAlias

import numpy as np
from jaxtyping import Complex
from numpy import ndarray

from ..subspace import compress, decompose

__all__ = ["Objective", "factor", "factors", "noise_weights"]

NOISELESS = 1e-18
"""Power of the noise, relative to the largest eigenvalue, below which it is due to the rounding of the subspace."""

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


def factors(Y: Sequence[Complex[ndarray, "m t"]], sources: int, objective: Objective) -> list[Complex[ndarray, "m c"]]:
    """Return the factors of frequency bins, whose misfits are added; of a single bin the ``factor``.

    esf: the factors as they are, so that all bins have the same weight.
    wsf, dml: multiplied by the square roots of ``noise_weights``, so that the sum of the misfits is a log-likelihood
        up to a scale.

    Y: received data of each bin, shape (M, T).
    sources: number K of sources.
    objective: "esf", "wsf" or "dml".
    """
    found = [factor(each, sources, objective) for each in Y]
    if len(found) == 1 or objective == "esf":
        return found
    return [math.sqrt(weight) * F for weight, F in zip(noise_weights(Y, sources), found, strict=True)]


def noise_weights(Y: Sequence[Complex[ndarray, "m t"]], sources: int) -> list[float]:
    """Return the weight (T_f/σ̂_f²)/(T_1/σ̂_1²) of each frequency bin f, so that that of the first is 1.

    With them a sum of WSF or DML over the bins is −σ̂_1²/T_1 times the log-likelihood of independent bins whose noise
    has different powers σ_f², up to a constant. The powers are estimated by the means of the M − K smallest
    eigenvalues. Where that is impossible in a bin, because it has no more snapshots than sources or no noise, noise of
    the same power is assumed in all bins.

    Y: received data of each bin, shape (M, T).
    sources: number K of sources.
    """
    snapshots = [each.shape[1] for each in Y]
    noise = [_noise(each, sources) for each in Y]
    if 0.0 in noise:
        noise = [1.0] * len(Y)
    precisions = [T / power for T, power in zip(snapshots, noise, strict=True)]
    return [precision / precisions[0] for precision in precisions]


def _noise(Y: Complex[ndarray, "m t"], sources: int) -> float:
    """Return the power of the noise; 0 where it cannot be estimated."""
    if Y.shape[1] <= sources:
        return 0.0
    _, eigenvalues, noise = decompose(Y, sources)
    return noise if noise > NOISELESS * eigenvalues[0] else 0.0
