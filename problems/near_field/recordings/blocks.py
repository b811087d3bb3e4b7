"""How long the blocks must be from which snapshots are computed: much longer than a wave takes across the array."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.distance import pdist

__all__ = ["block_problem", "default_block", "longest_delay"]

SHORTEST = 256  # samples of a block whose length is not given
LONG_ENOUGH = 32  # blocks in units of the longest delay across the array, from which one source is one eigenvalue
LONG = 256  # the same, from which not even a strong source gives a second one
MAX_PAIRED = 2000  # elements whose distances are all computed


def longest_delay(positions: Float[ndarray, "m 3"], speed_m_s: float, rate_hz: float) -> float:
    """Return how many samples a wave takes from one end of the array to the other."""
    few = len(positions) <= MAX_PAIRED
    extent = float(pdist(positions).max()) if few else float(np.linalg.norm(np.ptp(positions, axis=0)))
    return extent / speed_m_s * rate_hz


def default_block(delay: float, samples: int, overlap: float, snapshots: int) -> int:
    """Return the samples of a block: a power of two, at least 256 and, if the recording is long enough, 32 delays.

    delay: the longest delay across the array [samples].
    samples: length of the recording.
    overlap: share of a block that the next one repeats.
    snapshots: number of snapshots that blocks longer than 256 samples must leave.
    """
    block = SHORTEST
    while block < LONG_ENOUGH * delay and _blocks(2 * block, samples, overlap) >= snapshots:
        block *= 2
    return block


def block_problem(block: int, delay: float, samples: int) -> tuple[str, bool] | None:
    """Return why one source may seem to be several with such blocks, and whether it is likely; None if it is not.

    The arguments are those of ``default_block``.
    """
    if block >= LONG * delay or delay < 1:
        return None
    longer = block
    while longer < LONG_ENOUGH * delay and 4 * longer <= samples:
        longer *= 2
    remedy = f"use longer blocks (--block {longer})" if longer > block else "record for longer"
    if block < longer < LONG_ENOUGH * delay:
        remedy += ", or record for longer"
    text = (
        f"blocks of {block} samples are only {block / delay:.2g} times as long as the delay across the array, "
        f"{delay:.3g} samples, so that one source may seem to be several: {remedy}"
    )
    return text, block < LONG_ENOUGH * delay


def _blocks(block: int, samples: int, overlap: float) -> int:
    return (samples - block) // max(1, round(block * (1 - overlap))) + 1 if samples >= block else 0
