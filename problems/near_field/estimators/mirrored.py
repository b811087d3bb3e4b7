"""Mirrored halves of a centred array: what they say about angles does not depend on ranges."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

from nfbench import Incompatible

from ..array_instance import ArrayInstance
from ..calibration import Knowledge
from ..wavefronts import Manifold
from .uniform_line import data_of_line, require_centre, require_quarter_wave, widest_sine

__all__ = ["Halves", "candidates", "confirmed", "data_of_mirrored_line", "examined", "halves", "mismatch"]

BLOCK = 2**20  # entries of Ψ computed at once
MOST_FALSE = 50  # number of angles between two sources that are examined


class Halves(NamedTuple):
    """The rows of U_s of the two halves of a centred array, without the element at its centre.

    upper: U_1, rows of the elements at y_m, the outermost first, shape (N, K), N = ⌊M/2⌋.
    lower: U_2, rows of the elements at −y_m, shape (N, K).
    y: y_m [m], shape (N,).
    """

    upper: Complex[ndarray, "n k"]
    lower: Complex[ndarray, "n k"]
    y: Float[ndarray, " n"]


def data_of_mirrored_line(
    instance: ArrayInstance, knows: Knowledge, name: str, title: str
) -> tuple[Complex[ndarray, "m t"], Manifold]:
    """Return the data and the manifold of a centred ULA along y with |δ| < λ/(4·sinφ_max).

    Raises Incompatible if the array is another one, and as ``data_of_line`` does.
    """
    Y, manifold, spacing = data_of_line(instance, knows, name, title)
    require_centre(manifold, title)
    require_quarter_wave(manifold, spacing, widest_sine(instance.lower, instance.upper), title)
    return Y, manifold


def halves(U_s: Complex[ndarray, "m k"], y: Float[ndarray, " m"]) -> Halves:
    """Return the mirrored halves; raises Incompatible unless each has more elements than there are sources.

    U_s: signal subspace, shape (M, K).
    y: positions of the elements along the array [m], shape (M,), which are symmetric about 0.
    """
    M, K = U_s.shape
    N = M // 2
    if N <= K:
        raise Incompatible(f"array: expected more than {2 * K + 1} elements for {K} sources, got {M}")
    return Halves(U_s[: M - N - 1 : -1], U_s[:N], y[: M - N - 1 : -1])


def mismatch(pair: Halves, azimuth: Float[ndarray, " p"], wavelength: float) -> Float[ndarray, "p k k"]:
    """Return the K × K matrices (U_1 − Ψ(φ)U_2)ᴴ(U_1 − Ψ(φ)U_2) of directions φ, shape (p, K, K).

    Ψ(φ) = diag(exp(j2k·y_m·sinφ)). The quadratic phases of an element and its mirror image are equal, so that
    a_m = ψ_m·a_−m, and the matrix is singular at the angles of the sources, whatever their ranges.

    azimuth: φ [rad].
    wavelength: λ [m].
    """
    U_1, U_2, y = pair
    N, K = U_1.shape
    positions = np.zeros((N, 3))
    positions[:, 1] = 2 * y
    far = Manifold(positions, wavelength, "planar", has_elevation=False)
    directions = np.stack([azimuth, np.ones_like(azimuth)], axis=1)
    products = (U_1.conj()[:, :, None] * U_2[:, None, :]).reshape(N, K * K)
    count = max(BLOCK // N, 1)
    blocks = [far.response(directions[i : i + count]) @ products for i in range(0, len(azimuth), count)]
    C = np.concatenate(blocks).reshape(-1, K, K)  # U_1ᴴΨU_2
    constant = U_1.conj().T @ U_1 + U_2.conj().T @ U_2
    matrices: ndarray = constant - C - C.conj().swapaxes(1, 2)
    return matrices


def candidates(heights: Float[ndarray, " p"], sources: int) -> ndarray:
    """Return the indices of the highest local maxima of a spectrum of angles; a plateau counts once, and ends may be.

    For sources k and l with v_k = v_l, which have the same curvature, a_k + a_l is symmetric about the mean of their
    sines just as a_k about its own. Sources at similar ranges, or far ones, therefore cause false peaks, one per pair
    of sources, and K(K + 1)/2 maxima are returned. Their responses are too far from the signal subspace; see
    ``confirmed``.

    heights: values on a grid.
    sources: number K of sources.
    """
    padded = np.concatenate([[-np.inf], heights, [-np.inf]])
    maxima = np.flatnonzero((heights > padded[:-2]) & (heights >= padded[2:]))
    return maxima[np.argsort(-heights[maxima], kind="stable")[: examined(sources)]]


def examined(sources: int) -> int:
    """Return the number of angles that are examined for K sources."""
    return sources + min(sources * (sources - 1) // 2, MOST_FALSE)


def confirmed(theta: Float[ndarray, "p d"], U_s: Complex[ndarray, "m k"], manifold: Manifold) -> Float[ndarray, "k d"]:
    """Return the K candidates (p, d) [rad, m] with the responses closest to the signal subspace, the best first."""
    energy = np.sum(np.abs(manifold.response(theta).conj() @ U_s) ** 2, axis=1)
    return theta[np.argsort(-energy, kind="stable")[: U_s.shape[1]]]
