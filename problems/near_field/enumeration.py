"""How many sources there are: as the truth has it, as the user assumes, or estimated from eigenvalues."""

from __future__ import annotations

from typing import Annotated, Literal, TypeAlias

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

from nfbench import Ge, Incompatible

from .instance import NearFieldInstance
from .subspace import compress

__all__ = ["Criterion", "Sources", "estimate_sources", "how_many"]

Criterion: TypeAlias = Literal["aic", "mdl", "ne"]
"""What the estimated number minimizes: AIC, MDL, or the criterion of Nadakuditi and Edelman."""

Sources: TypeAlias = Annotated[int, Ge(1)] | Literal["known", "estimate"]
"""The option of a formulation: a number to assume, right or wrong; "known", the true one; "estimate", from the data."""


def how_many(instance: NearFieldInstance, sources: Sources, criterion: Criterion) -> int:
    """The number K of sources that a formulation with these options looks for; 0 is possible with "estimate".

    Raises Incompatible where ``criterion`` is undefined, or where as many or more than the antennas are assumed.
    """
    if sources == "known":
        return instance.sources
    if sources == "estimate":
        return estimate_sources(instance.Y, criterion)
    if sources >= instance.manifold.elements:
        raise Incompatible(f"sources: expected fewer than the {instance.manifold.elements} elements, got {sources}")
    return sources


def estimate_sources(Y: Complex[ndarray, "m t"], criterion: Criterion) -> int:
    """The number of sources in Y, (M, T), from the eigenvalues of Y·Yᴴ/T, for noise white and unknown in power.

    "aic", "mdl": Wax & Kailath 1985, doi:10.1109/TASSP.1985.1164557; MDL is consistent, AIC tends to see too many.
    "ne": Nadakuditi & Edelman 2008 (arXiv:0705.2605), with fewer snapshots than antennas too. Raises Incompatible for
    AIC and MDL where T < M, ValueError where Y is not finite or lacks the noise: then an eigenvalue is zero.

    What is counted are signals of rank one: a channel that fades from snapshot to snapshot counts as many.
    """
    M, T = Y.shape
    if criterion != "ne" and T < M:
        raise Incompatible(
            f'criterion: expected "ne" with fewer snapshots ({T}) than antennas ({M}), got "{criterion}"'
        )
    eigenvalues = np.linalg.svd(compress(Y), compute_uv=False) ** 2 / T if np.isfinite(Y).all() else np.zeros(1)
    if not eigenvalues[-1] > 0:
        raise ValueError("Y: expected finite data with noise in every direction, got NaN, infinite or noiseless data")
    k = np.arange(len(eigenvalues))  # 0 … min(M, T) − 1
    mean = _tail_sum(eigenvalues) / (M - k)  # of l_i, i > k; for T < M the others are zero
    if criterion == "ne":
        t = M * (_tail_sum(eigenvalues**2) / (M - k) / mean**2 - (1 + M / T))
        return int(np.argmin((T / M * t) ** 2 / 2 + 2 * (k + 1)))
    L = T * ((M - k) * np.log(mean) - _tail_sum(np.log(eigenvalues)))
    freedom = k * (2 * M - k)
    return int(np.argmin(2 * L + 2 * freedom if criterion == "aic" else L + freedom * np.log(T) / 2))


def _tail_sum(values: Float[ndarray, " n"]) -> Float[ndarray, " n"]:
    """Σ_{i>k} of values 1, 2, … for k = 0, 1, …"""
    return np.cumsum(values[::-1])[::-1]
