"""What is questionable about estimates and their box: edges, and other places with the same response."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.sparse.csgraph import connected_components

from ..geometry import ambiguity, cartesian, nearest_distances
from ..search import grid_size, resolution, resolution_grid, search_locally
from ..wavefronts import Manifold

__all__ = ["alias_warnings", "coincidence_warnings", "edge_warnings", "side_warnings"]

ALIKE = 0.9  # squared correlation of two responses from which they are hardly distinguished
LIKELY = 0.5  # squared correlation of a grid point from which the peak next to it is looked at
LARGEST = 2 * 10**6  # grid points that are compared with the estimates
CHUNK = 2**22  # numbers of responses that are computed at once
SAME = 0.999  # squared correlation of the responses of two estimates from which they count as one place
FLAT = 0.02  # deviation from a line or plane [wavelengths, root mean square] that phases do not show
FULL_TURN = 2 * math.pi - 1e-9  # a box this wide has no edge in azimuth
CANDIDATES = 8  # grid points from which a peak is searched
NAMES = ("azimuth", "elevation", "range")


def edge_warnings(theta: Float[ndarray, "k d"], lower: Float[ndarray, " d"], upper: Float[ndarray, " d"]) -> list[str]:
    """Return a sentence for each side of the box on which estimates lie.

    theta: estimated sources [rad, m], shape (K, d).
    lower, upper: bounds of one source [rad, m], shape (d,).
    """
    names = NAMES if len(lower) == 3 else (NAMES[0], NAMES[2])
    margin = 1e-9 * (upper - lower)
    found = []
    for i, name in enumerate(names):
        for bound, outside in (
            (lower[i], theta[:, i] <= lower[i] + margin[i]),
            (upper[i], theta[:, i] >= upper[i] - margin[i]),
        ):
            if not outside.any() or (name == "azimuth" and upper[i] - lower[i] >= FULL_TURN):
                continue
            which = _listed([str(k + 1) for k in np.flatnonzero(outside)])
            unit = "m" if name == "range" else "deg"
            value = f"{bound:.6g} m" if unit == "m" else f"{math.degrees(bound):.6g}°"
            many = outside.sum() > 1
            found.append(
                f"{'sources' if many else 'source'} {which} {'lie' if many else 'lies'} on the edge of the box, at the "
                f"{name} {value}, so that the true {name} may lie beyond it and has no standard error; widen "
                f"{name}_{unit} (--{name}-{unit})"
            )
    return found


def _listed(words: list[str]) -> str:
    """Join words: "1, 2 and 3"."""
    return " and ".join(filter(None, [", ".join(words[:-1]), words[-1]]))


def coincidence_warnings(theta: Float[ndarray, "k d"], manifold: Manifold) -> list[str]:
    """Return a sentence if responses of estimates are nearly the same, so that their powers are not known."""
    A = manifold.response(theta)
    alike = np.triu(np.abs(A.conj() @ A.T / manifold.elements) ** 2, 1) > SAME
    if not alike.any():
        return []
    count, place = connected_components(alike, directed=False)
    groups = [np.flatnonzero(place == k) + 1 for k in range(count)]
    same = ", ".join(_listed([str(k) for k in group]) for group in groups if len(group) > 1)
    return [
        f"sources {same} are at nearly the same place: the data probably contain fewer sources; set sources to "
        f"{count} (--sources {count})"
    ]


def side_warnings(manifold: Manifold, lower: Float[ndarray, " d"], upper: Float[ndarray, " d"]) -> list[str]:
    """Return a sentence if the box contains both sides of a line or plane of elements, which are the same to them."""
    found = ambiguity(manifold.positions, lower, upper, FLAT * manifold.wavelength_m)
    if found is None:
        return []
    shape, pair = found
    first, second = (", ".join(f"{angle:.1f}°" for angle in row) for row in np.degrees(pair) + 0.0)
    names = "azimuths" if pair.shape[1] == 1 else "azimuths and elevations"
    where = "in a plane" if shape == "plane" else "on a line"
    return [
        f"the box contains both sides of the array: its elements lie {where} and cannot distinguish, for example, the "
        f"{names} {first} and {second}; make the box smaller (--azimuth-deg, --elevation-deg), or check broadside and "
        f"up of the array (--broadside, --up)"
    ]


def alias_warnings(
    theta: Float[ndarray, "k d"], manifold: Manifold, lower: Float[ndarray, " d"], upper: Float[ndarray, " d"]
) -> list[str]:
    """Return a sentence for each source whose response is nearly that of another place in the box.

    Such a place is a peak of |a(θ̂)ᴴa(θ)|²/M² of at least 0.9 outside the lobe of the estimate. Arrays whose elements
    are more than half a wavelength apart can have them; irregular arrays rarely do.

    theta: estimated sources [rad, m], shape (K, d).
    manifold: array and wavefront model.
    lower, upper: bounds of one source [rad, m], shape (d,).
    """
    if math.prod(map(float, grid_size(manifold, lower, upper, 1.0))) > LARGEST:
        return []
    inside = np.clip(theta, lower, upper)
    points = resolution_grid(manifold, lower, upper, 1.0)
    correlation = _correlations(manifold, inside, points)
    found = []
    for k, own in enumerate(inside):
        peak = _other_peak(manifold, own, points, correlation[:, k], lower, upper)
        if peak is None:
            continue
        place, alike = peak
        spacing = float(np.median(nearest_distances(manifold.positions))) / manifold.wavelength_m
        where = ", ".join(f"{name} {value}" for name, value in zip(*_shown(place), strict=True))
        found.append(
            f"source {k + 1} is ambiguous: a source at {where} would give nearly the same data (squared correlation "
            f"{alike:.2f}), as the elements are {spacing:.2g} wavelengths apart (median); make the box smaller, or use "
            f"a lower frequency or a denser array"
        )
    return found


def _correlations(
    manifold: Manifold, theta: Float[ndarray, "k d"], points: Float[ndarray, "p d"]
) -> Float[ndarray, "p k"]:
    """Return |a(θ_k)ᴴa(θ_p)|²/M² of all points with all estimates."""
    A = manifold.response(theta).conj().T / manifold.elements
    step = max(CHUNK // manifold.elements, 1)
    parts = [np.abs(manifold.response(points[i : i + step]) @ A) ** 2 for i in range(0, len(points), step)]
    return np.concatenate(parts)


def _other_peak(
    manifold: Manifold,
    own: Float[ndarray, " d"],
    points: Float[ndarray, "p d"],
    correlation: Float[ndarray, " p"],
    lower: Float[ndarray, " d"],
    upper: Float[ndarray, " d"],
) -> tuple[Float[ndarray, " d"], float] | None:
    """Return the place outside the lobe of an estimate whose response is most like its own, if it is alike."""
    likely = correlation >= LIKELY
    likely &= ~_in_lobe(manifold, own, points)
    order = np.flatnonzero(likely)
    order = order[np.argsort(-correlation[order])][:CANDIDATES]
    F = manifold.response(own[None]).T / math.sqrt(manifold.elements)
    best: tuple[Float[ndarray, " d"], float] | None = None
    for i in order:
        found = search_locally(F, manifold, lower, upper, points[i].copy())
        alike = 1 - found.value
        if alike >= ALIKE and not _in_lobe(manifold, own, found.x[None])[0] and (best is None or alike > best[1]):
            best = found.x, alike
    return best


def _in_lobe(manifold: Manifold, own: Float[ndarray, " d"], points: Float[ndarray, "p d"]) -> np.ndarray:
    """Whether points are within two beamwidths of an estimate, seen from the array; their range does not matter."""
    beamwidth = resolution(manifold)[0]
    u, v = cartesian(np.append(own[:-1], 1.0)), cartesian(np.column_stack([points[:, :-1], np.ones(len(points))]))
    return np.linalg.norm(v - u, axis=-1) <= max(2 * beamwidth, 1e-6)


def _shown(place: Float[ndarray, " d"]) -> tuple[tuple[str, ...], list[str]]:
    names = NAMES if len(place) == 3 else (NAMES[0], NAMES[2])
    return names, [*(f"{math.degrees(angle):.1f}°" for angle in place[:-1]), f"{place[-1]:.3g} m"]
