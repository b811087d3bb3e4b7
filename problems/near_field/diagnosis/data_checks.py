"""What is wrong with received data before any model is fitted to them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Complex
from numpy import ndarray

__all__ = ["data_warnings"]

DEAD = 1e-4  # power of a channel, relative to the median, at or below which it is dead: −40 dB
SHOWN = 12  # channels named in a sentence


def data_warnings(Y: Complex[ndarray, "m t"]) -> list[str]:
    """Return sentences about data that no array receives: NaN, all zero, real, or with dead channels.

    Y: received data, shape (M, T).
    """
    finite = np.isfinite(Y)
    if not finite.all():
        element, snapshot = np.argwhere(~finite)[0]
        bad = int((~finite).sum())
        return [
            f"the data contain {bad} numbers that are NaN or infinite, the first at element {element}, snapshot "
            f"{snapshot} (counted from 0); leave out these snapshots, or the element with failed (--failed)"
        ]
    power = np.mean(np.abs(Y) ** 2, axis=1)
    if not power.any():
        return ["the data are all zero; check which array of the file is read (--variable)"]
    found = []
    if not Y.imag.any():
        found.append(
            "the data are real numbers, which have no phase; give complex snapshots, or, if these are samples over "
            "time, their sampling rate (--sample-rate-hz)"
        )
    median = float(np.median(power))
    dead = np.flatnonzero(power <= DEAD * median) if median > 0 else np.flatnonzero(power == 0)
    if len(dead):
        listed = ",".join(map(str, dead[:SHOWN])) + (f" and {len(dead) - SHOWN} more" if len(dead) > SHOWN else "")
        one = len(dead) == 1
        found.append(
            f"{'element' if one else 'elements'} {listed} (counted from 0) {'is' if one else 'are'} dead: "
            f"{'its' if one else 'their'} power is at least 40 dB below the median of all elements; "
            f"leave {'it' if one else 'them'} out with failed (--failed {listed})"
        )
    return found
