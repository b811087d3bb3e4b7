"""From the numbers in a file to snapshots: one row per element, one column per snapshot."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Complex, Float, Shaped
from numpy import ndarray
from scipy.signal import get_window

__all__ = [
    "COMPLEX",
    "covariance_factor",
    "normalized",
    "oriented",
    "refuse_covariance",
    "spectral_snapshots",
    "spherical",
    "without_phase",
]

COMPLEX = (
    "the data are complex, as snapshots at one frequency are: if they are snapshots, leave out sample_rate_hz "
    '(--sample-rate-hz) and data_kind = "samples"'
)

WEAKEST = 1e-10  # power that the sources do not explain, relative to that of the data, below which it is rounding
SAME = 1e-6  # relative difference of two elements of a covariance that are equal up to rounding


def oriented(X: Shaped[ndarray, ...], elements: int, axis: int | None) -> tuple[Shaped[ndarray, "m n"], int]:
    """Return a table of numbers with the elements along its first axis, and the axis along which they were.

    axis: axis of the elements; None: the only axis of the right length, or the first one if both have it.
    Raises ValueError if no axis has as many entries as there are elements.
    """
    if X.ndim != 2:
        raise ValueError(f"expected a table with an axis of {elements} elements, got an array of shape {X.shape}")
    fits = [i for i in (0, 1) if X.shape[i] == elements]
    if not fits or (axis is not None and axis not in fits):
        where = "one axis" if axis is None else f"axis {axis}"
        text = f"expected {elements} entries along {where}, one per element of the array"
        raise ValueError(f"{text}, got an array of shape {X.shape}; correct the positions or the data")
    axis = fits[0] if axis is None else axis
    return (X if axis == 0 else X.T), axis


def spectral_snapshots(
    x: Shaped[ndarray, "m n"], rate_hz: float, frequency_hz: float, block: int, window: str, overlap: float
) -> Complex[ndarray, "m t"]:
    """Return the Fourier transform at one frequency of windowed, overlapping blocks of samples over time.

    Where the frequency is that of a bin k·rate/block of the FFT, the result is that bin.

    x: samples, one row per element.
    rate_hz: sampling rate [Hz].
    frequency_hz: frequency [Hz], at least one bin away from 0 and from half the sampling rate.
    block: samples per block; samples that do not fill a block are left out.
    window: name of a window of scipy.signal.get_window, such as "hann".
    overlap: share of a block that the next one repeats.
    """
    if not 1 <= frequency_hz / rate_hz * block <= block / 2 - 1:
        low, high = rate_hz / block, rate_hz / 2 - rate_hz / block
        interval = f"from {low:g} to {high:g} Hz for blocks of {block} samples"
        raise ValueError(f"frequency_hz: expected a value {interval}, got {frequency_hz:g}")
    if x.shape[1] < block:
        raise ValueError(f"block: expected at least one block of {block} samples, got {x.shape[1]} samples")
    hop = max(1, round(block * (1 - overlap)))
    try:
        taper = get_window(window, block)
    except (ValueError, TypeError) as error:
        raise ValueError(f"window: expected the name of a window of SciPy, such as hann, got {window!r}") from error
    weights = taper * np.exp(-2j * math.pi * frequency_hz / rate_hz * np.arange(block))
    starts = np.arange(0, x.shape[1] - block + 1, hop)
    return np.stack([x[:, start : start + block] @ weights for start in starts], axis=1)


def covariance_factor(R: Shaped[ndarray, "m m"], snapshots: int) -> Complex[ndarray, "m t"]:
    """Return Y with T columns and Y·Yᴴ/T = R, the covariance of T snapshots.

    Raises ValueError if R is not Hermitian and positive semidefinite up to rounding, or has a rank above T.
    """
    M = len(R)
    if R.ndim != 2 or R.shape != (M, M):
        text = f"expected a square covariance, got an array of shape {R.shape}"
        raise ValueError(f'{text}; for snapshots, leave out data_kind = "covariance" (--covariance)')
    size = float(np.abs(R).max())
    difference = np.abs(R - R.conj().T)
    if difference.max() > SAME * size:
        i, j = (int(k) for k in np.unravel_index(np.argmax(difference), R.shape))
        raise ValueError(
            f"expected a Hermitian covariance, got {R[i, j]:.4g} at [{i}, {j}], {R[j, i]:.4g} at [{j}, {i}]"
        )
    values, V = np.linalg.eigh((R + R.conj().T) / 2)
    if values[0] < -SAME * size * M:
        raise ValueError(f"expected a positive semidefinite covariance, got the eigenvalue {values[0]:.4g}")
    values, V = np.maximum(values[::-1], 0.0), V[:, ::-1]
    rank = int(np.sum(values > 1e-12 * values[0]))
    if rank > snapshots:
        raise ValueError(f"expected at least {rank} snapshots, the rank of the covariance, got snapshots = {snapshots}")
    Y = np.zeros((M, snapshots), dtype=np.complex128)
    columns = min(M, snapshots)
    Y[:, :columns] = V[:, :columns] * np.sqrt(values[:columns] * snapshots)
    return Y


def refuse_covariance(X: Complex[ndarray, "m m"]) -> None:
    """Raise ValueError if square data that are to be snapshots are Hermitian with a positive diagonal."""
    size = float(np.abs(X).max())
    if len(X) > 1 and np.abs(X - X.conj().T).max() <= SAME * size and (np.diag(X).real > 0).all():
        text = "expected snapshots, got a Hermitian table with a positive diagonal, which is probably a covariance"
        raise ValueError(f'{text}: set data_kind = "covariance" (--covariance)')


def without_phase(kind: str, rate_hz: float | None) -> str:
    """Return what is wrong with real numbers that are to be complex.

    rate_hz: sampling rate that the file states [Hz]; None if it states none.
    """
    rate = "" if rate_hz else " and sample_rate_hz (--sample-rate-hz)"
    text = f"expected complex {kind}, got real numbers, which have no phase"
    return f'{text}; for samples over time, give data_kind = "samples"{rate}'


def normalized(Y: Complex[ndarray, "m t"], sources: int) -> tuple[Complex[ndarray, "m t"], float]:
    """Return the data divided by the deviation of what K sources cannot explain, and that deviation.

    The variance is the mean of the M − K smallest eigenvalues of Y·Yᴴ/T, but at least 1e-10 of the mean power of an
    element.
    """
    M, T = Y.shape
    energies = np.linalg.svd(Y, compute_uv=False) ** 2
    rest = float(energies[sources:].sum()) / (T * (M - sources))
    deviation = math.sqrt(max(rest, WEAKEST * float(energies.sum()) / (M * T)))
    return Y / deviation, deviation


def spherical(points: Float[ndarray, "k 3"], has_elevation: bool) -> Float[ndarray, "k d"]:
    """Return points ``[x, y, z]`` [m] as sources ``[azimuth, (elevation,) range]`` [rad, m].

    Raises ValueError if there are no elevations and a point is farther from the plane z = 0 than a thousandth of its
    range.
    """
    r = np.linalg.norm(points, axis=1)
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    if has_elevation:
        return np.stack([azimuth, np.arcsin(np.clip(points[:, 2] / r, -1.0, 1.0)), r], axis=1)
    if (above := np.abs(points[:, 2]) > 1e-3 * r).any():
        k = int(np.argmax(above))
        text = f"expected sources at elevation 0, as elevation_deg is not given, got one {points[k, 2]:.4g} m above it"
        raise ValueError(f"{text}; give elevation_deg, or the array's broadside and up")
    return np.stack([azimuth, np.hypot(points[:, 0], points[:, 1])], axis=1)
