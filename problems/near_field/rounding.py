"""How far the derivatives of responses are rounded, which decides whether a Cramér–Rao bound is finite."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from .geometry import cartesian, directions
from .objectives import kernels
from .wavefronts import Manifold

__all__ = ["CERTAIN", "magnitudes", "next_to_element", "undefined"]

CERTAIN = 100
"""Factor by which a number must exceed its rounding error to be used: the result is then right to about 1 %."""


def undefined(manifold: Manifold, theta: Float[ndarray, "k d"]) -> bool:
    """Whether one of the sources is at a place where the responses have no derivatives, or no digits.

    An exact wavefront has a kink at each element, and near to it, the direction from the element to the source is only
    rounding error: at less than ``CERTAIN``·ε ≈ 2e-14 of the source's range, or of the largest distance of an element
    from the origin if that is longer. The other wavefronts are smooth at their elements, but the phases of "fresnel"
    and "paper" grow as 1/r near the origin: from 1/(``CERTAIN``·ε) ≈ 5e13 rad on, they are only rounding error.

    theta: sources [rad, m], shape (K, d).
    """
    smallest, lengths = CERTAIN * np.finfo(np.float64).eps, np.linalg.norm(manifold.positions, axis=1)
    r = theta[:, -1:]
    if manifold.wavefront == "exact":
        return bool((_distances(manifold, theta) <= smallest * np.maximum(r, lengths.max())).any())
    curvatures = 0.0 if manifold.wavefront == "planar" else lengths**2 / (2 * r)
    phases = 2 * math.pi / manifold.wavelength_m * (lengths + curvatures)
    return bool((phases * smallest >= 1).any())


def next_to_element(manifold: Manifold, theta: Float[ndarray, "k d"]) -> bool:
    """Whether a source is nearer to an element than 1/``kernels.NEAR`` of its range, with an exact wavefront.

    The kernels of the local search compute distances as differences of squares, which lose their digits there.

    theta: sources [rad, m], shape (K, d).
    """
    if manifold.wavefront != "exact":
        return False
    return bool((_distances(manifold, theta) * kernels.NEAR < theta[:, -1:]).any())


def magnitudes(manifold: Manifold, theta: Float[ndarray, "k d"]) -> Float[ndarray, "k d"]:
    """Return the norms over the elements of the terms whose sums are ∂a/∂θ_i; their rounding errors are ε times that.

    Where the terms cancel, as on the axis of a line of elements, the derivative is smaller by far and has no digits.

    theta: sources [rad, m], shape (K, d).
    """
    Q, r, u = manifold.positions, theta[:, -1:], directions(theta)
    s, w = u @ Q.T, np.sum(Q**2, axis=1)
    by_s, by_r = (
        np.abs(slope) for slope in kernels.advance_slopes(kernels.WAVEFRONTS[manifold.wavefront], s, r[:, 0], w)
    )
    terms = np.empty((*theta.shape, len(Q)))
    terms[:, :-1] = (by_s * np.sqrt(w))[:, None]
    terms[:, 0] = by_s * np.hypot(Q[:, 0], Q[:, 1])  # the azimuth turns about the z axis
    terms[:, -1] = by_r
    if manifold.wavefront == "fresnel":
        terms[:, -1] = (w + s * s) / (2 * r * r)
    elif manifold.wavefront == "exact":
        with np.errstate(divide="ignore"):
            d = _distances(manifold, theta)
            terms[:, -1] = 2 * w / ((r + d) * d)
            near = by_s > kernels.NEAR  # the derivatives are those of ``Manifold``, −r·v and 1 − v·u
            terms[:, :-1] = np.where(near[:, None], (r * r / d)[:, None], terms[:, :-1])
            terms[:, -1] = np.where(near, r / d, terms[:, -1])
    if theta.shape[1] == 3:
        terms[:, 0] *= np.cos(theta[:, 1:2])  # exact, also at the poles
    if not manifold.has_unit_modulus:  # |W|·(ρ ⊙ terms), which the sums with weights do not exceed
        terms *= np.abs(replace(manifold, weights=None).response(theta))[:, None]
        W = np.ones(1) if manifold.weights is None else np.abs(manifold.weights)
        terms = terms @ W.T if W.ndim == 2 else terms * W
    norms: ndarray = 2 * math.pi / manifold.wavelength_m * np.linalg.norm(terms, axis=2)
    return norms


def _distances(manifold: Manifold, theta: Float[ndarray, "k d"]) -> Float[ndarray, "k m"]:
    """The distances from the sources to the elements [m]."""
    distances: ndarray = np.linalg.norm(cartesian(theta)[:, None] - manifold.positions, axis=2)
    return distances
