"""The number of sources: the true number, an assumed number, or an estimate from the eigenvalues of the data."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal, TypeAlias

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

from nfbench import Ge, Incompatible

from .array_instance import ArrayInstance
from .calibration import Knowledge, calibrated
from .subspace import compress

__all__ = ["Criterion", "Sources", "estimate_sources", "how_many"]

Criterion: TypeAlias = Literal["aic", "mdl", "ne"]
"""The criterion that the estimated number minimizes: AIC, MDL, or that of Nadakuditi and Edelman."""

Sources: TypeAlias = Annotated[int, Ge(1)] | Literal["known", "estimate"]
"""The number of sources that a formulation assumes: a number (which may be wrong), "known" for the true number, or
"estimate" for an estimate from the data."""


def how_many(instance: ArrayInstance, sources: Sources, criterion: Criterion, knows: Knowledge | None = None) -> int:
    """Return the number K of sources that a formulation with these options looks for; "estimate" may return 0.

    The estimate is made from the data after removing what the formulation ``knows`` of the array.

    Raises Incompatible if ``criterion`` is undefined for the data, or if the assumed number is not smaller than the
    number of antennas.
    """
    if sources == "known":
        return instance.sources
    if sources == "estimate":
        bands = instance.bands if knows is None else calibrated(instance, knows)
        return estimate_sources([band.Y for band in bands], criterion)
    if sources >= instance.manifold.elements:
        raise Incompatible(f"sources: expected fewer than the {instance.manifold.elements} elements, got {sources}")
    return sources


def estimate_sources(Y: Complex[ndarray, "m t"] | Sequence[Complex[ndarray, "m t"]], criterion: Criterion) -> int:
    """Estimate the number of sources from the eigenvalues of Y·Yᴴ/T, for white noise of unknown power.

    Criteria of several frequency bins are added, each with its own penalty: the bins are independent, and a source has
    its own symbols and response in each of them.

    Each source is assumed to contribute a signal of rank one; a source whose channel changes from snapshot to snapshot
    is counted as several. Raises Incompatible for AIC and MDL if T < M, and ValueError if Y is not finite or contains
    no noise, so that an eigenvalue is zero.

    Y: received data, shape (M, T), or those of each frequency bin.
    criterion: "aic" or "mdl" (Wax & Kailath 1985, doi:10.1109/TASSP.1985.1164557), where MDL is consistent and AIC
        tends to overestimate; or "ne" (Nadakuditi & Edelman 2008, arXiv:0705.2605), which also works with fewer
        snapshots than antennas.
    """
    bins = [Y] if isinstance(Y, ndarray) else Y
    values = [_values(each, criterion) for each in bins]
    tried = min(map(len, values))  # numbers of sources, from 0 on
    return int(np.argmin(np.sum([each[:tried] for each in values], axis=0)))


def _values(Y: Complex[ndarray, "m t"], criterion: Criterion) -> Float[ndarray, " n"]:
    """Return the criterion of the numbers of sources 0, 1, …, min(M, T) − 1."""
    M, T = Y.shape
    if criterion != "ne" and T < M:
        raise Incompatible(
            f'criterion: expected "ne", because there are fewer snapshots ({T}) than antennas ({M}), got "{criterion}"'
        )
    eigenvalues = np.linalg.svd(compress(Y), compute_uv=False) ** 2 / T if np.isfinite(Y).all() else np.zeros(1)
    if not eigenvalues[-1] > 0:
        raise ValueError("Y: expected finite data with noise in every direction, got NaN, infinite or noiseless data")
    k = np.arange(len(eigenvalues))  # 0 … min(M, T) − 1
    mean = _tail_sum(eigenvalues) / (M - k)  # mean of l_i, i > k; for T < M the remaining ones are zero
    if criterion == "ne":
        t = M * (_tail_sum(eigenvalues**2) / (M - k) / mean**2 - (1 + M / T))
        score: Float[ndarray, " n"] = (T / M * t) ** 2 / 2 + 2 * (k + 1)
        return score
    L = T * ((M - k) * np.log(mean) - _tail_sum(np.log(eigenvalues)))
    freedom = k * (2 * M - k)
    return 2 * L + 2 * freedom if criterion == "aic" else L + freedom * np.log(T) / 2


def _tail_sum(values: Float[ndarray, " n"]) -> Float[ndarray, " n"]:
    """Return Σ_{i>k} values_i for k = 0, 1, …, with i counted from 1."""
    return np.cumsum(values[::-1])[::-1]
