"""What is wrong with received data before any model is fitted to them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Complex
from numpy import ndarray

__all__ = ["data_warnings"]


def data_warnings(Y: Complex[ndarray, "m t"]) -> list[str]:
    """Return sentences about data that no array receives: NaN, all zero or real.

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
    if not Y.any():
        return ["the data are all zero; check which array of the file is read (--variable)"]
    if not Y.imag.any():
        return [
            "the data are real numbers, which have no phase; give complex snapshots, or, if these are samples over "
            "time, their sampling rate (--sample-rate-hz)"
        ]
    return []
