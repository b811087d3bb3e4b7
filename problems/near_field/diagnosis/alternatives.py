"""Whether the data fit far better under another convention: conjugated, or with an array in other units or turned."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from ..geometry import Frame, flatness
from ..search import grid_size, response_grid, search_greedily
from ..wavefronts import Manifold
from .eigenvalues import Spectrum
from .goodness import explained_share, weighted_subspace

__all__ = ["OTHER_UNIT", "better_alternative", "search_share"]

LARGEST = 2 * 10**6  # grid points that are searched for one alternative
DENSITY = 1.5  # of the grid, as of the formulation grid-refine
SWEEPS = 3
ELEVATION = 60  # to which elevations are tried if none are searched [°]
HIGH = 0.25  # height of an array [wavelengths] from which it can distinguish elevations
FLAT = 0.02  # deviation from a line [wavelengths, root mean square] that phases do not show
ENOUGH = 0.5  # share of the signal subspace that an alternative must explain
FAR_BETTER = 0.75  # factor by which it must lower the share that is not explained
SURE = 0.9  # the share that must be explained where the coordinates are in another unit
OTHER_UNIT = "the coordinates of the array are probably"
UNITS = {  # factor on the coordinates: what the user did, and the remedy
    1e-3: ("1000 times too large, as if millimetres were read as metres", 'set unit = "mm" (--unit mm)'),
    1e-2: ("100 times too large, as if centimetres were read as metres", 'set unit = "cm" (--unit cm)'),
    0.0254: ("39.4 times too large, as if inches were read as metres", 'set unit = "in" (--unit in)'),
    1e3: ("1000 times too small, as if metres were read as millimetres", 'set unit = "m" (--unit m)'),
    1e2: ("100 times too small, as if metres were read as centimetres", 'set unit = "m" (--unit m)'),
    1 / 0.0254: ("39.4 times too small, as if metres were read as inches", 'set unit = "m" (--unit m)'),
}
AXES = {"+x": (1, 0, 0), "-x": (-1, 0, 0), "+y": (0, 1, 0), "-y": (0, -1, 0), "+z": (0, 0, 1), "-z": (0, 0, -1)}


class _Alternative(NamedTuple):
    """Another reading of the data.

    text: what fits better, and the remedy.
    spectrum, manifold: what is fitted.
    box: lower and upper bounds of one source; None: as before.
    freedom: what more parameters are expected to explain, which does not count.
    """

    text: tuple[str, str]
    spectrum: Spectrum
    manifold: Manifold
    box: tuple[Float[ndarray, " d"], Float[ndarray, " d"]] | None = None
    freedom: float = 0.0


def better_alternative(
    spectrum: Spectrum,
    manifold: Manifold,
    frame: Frame,
    lower: Float[ndarray, " d"],
    upper: Float[ndarray, " d"],
    sources: int,
    explained: float,
    others: Iterable[tuple[tuple[str, str], Spectrum]] = (),
) -> str | None:
    """Return a sentence about the reading of the data that fits far better than the present one; None if none does.

    The readings are: conjugated data; an array whose coordinates are in millimetres, centimetres, inches or metres; an
    array whose broadside is another axis of its coordinates; channels in the opposite order; and, without elevation,
    sources above or below the plane. Each is searched on a grid and refined. One whose grid has more than two million
    points is left out.

    spectrum: eigenvalues of the data.
    manifold: array and wavefront model.
    frame: coordinates in which the user describes the array.
    lower, upper: bounds of one source [rad, m], shape (d,).
    sources: number K of sources.
    explained: share of the signal subspace that the present reading explains.
    others: further readings of the data: what fits better, and the remedy, with the eigenvalues.
    """
    best: tuple[float, tuple[str, str]] | None = None
    readings = [_Alternative(text, of_data, manifold) for text, of_data in others]
    readings += [*_alternatives(spectrum, manifold, frame), *_with_elevation(spectrum, manifold, lower, upper)]
    for other in readings:
        share = search_share(other.spectrum, other.manifold, *(other.box or (lower, upper)), sources)
        if share is None or (share < SURE and other.text[0].startswith(OTHER_UNIT)):
            continue
        if best is None or share > best[0] + max(1e-6, other.freedom):
            best = share, other.text
    if best is None or best[0] < ENOUGH or 1 - best[0] > FAR_BETTER * (1 - explained):
        return None
    share, (what, remedy) = best
    return (
        f"{what} ({100 * share:.0f} % instead of {100 * explained:.0f} % of the signal subspace is explained); {remedy}"
    )


def search_share(
    spectrum: Spectrum,
    manifold: Manifold,
    lower: Float[ndarray, " d"],
    upper: Float[ndarray, " d"],
    sources: int,
) -> float | None:
    """Return the share of the signal subspace that K sources in the box can explain; None if the grid is too large."""
    if math.prod(map(float, grid_size(manifold, lower, upper, DENSITY))) > LARGEST:
        return None
    rank = min(max(spectrum.significant, 1), sources)
    F = weighted_subspace(spectrum, rank)
    if not np.isfinite(F).all() or not F.any():
        return None
    found = search_greedily(F, response_grid(manifold, lower, upper, DENSITY), sources, SWEEPS)
    return explained_share(manifold.response(found.x.reshape(sources, -1)), spectrum.U[:, :rank])


def _alternatives(spectrum: Spectrum, manifold: Manifold, frame: Frame) -> Iterator[_Alternative]:
    Q = manifold.positions
    yield _Alternative(
        (
            "the conjugated data fit far better",
            "your phase convention is the opposite one, exp(+jkd) in place of exp(−jkd): set conjugate (--conjugate)",
        ),
        spectrum._replace(U=spectrum.U.conj()),
        manifold,
    )
    for factor, (what, remedy) in UNITS.items():
        text = f"{OTHER_UNIT} {what}: the data fit far better with the other unit"
        yield _Alternative((text, remedy), spectrum, replace(manifold, positions=Q * factor))
    for broadside, up, axes in _orientations(frame):
        text = f"the array is probably turned: the data fit far better with the broadside {broadside}"
        remedy = f'set broadside = "{broadside}" and up = "{up}" (--broadside {broadside} --up {up})'
        yield _Alternative((text, remedy), spectrum, replace(manifold, positions=Q @ (frame.axes @ axes.T)))
    text = "the channels are probably in another order than the positions: the data fit far better in reverse order"
    yield _Alternative(
        (text, "reverse the rows of the positions"), spectrum, replace(manifold, positions=Q[::-1].copy())
    )


def _with_elevation(
    spectrum: Spectrum, manifold: Manifold, lower: Float[ndarray, " d"], upper: Float[ndarray, " d"]
) -> Iterator[_Alternative]:
    """Yield the reading with elevations, if they are not searched and the array can distinguish them."""
    Q, wavelength = manifold.positions, manifold.wavelength_m
    if manifold.has_elevation or np.ptp(Q[:, 2]) < HIGH * wavelength or flatness(Q, FLAT * wavelength)[0] < 2:
        return
    text = (
        "the sources are probably not at elevation 0, where they are searched without elevation_deg: the data fit far "
    )
    text += f"better with elevations from -{ELEVATION}° to {ELEVATION}°"
    remedy = f"give elevation_deg (--elevation-deg -{ELEVATION} {ELEVATION})"
    bound = math.radians(ELEVATION)
    box = np.insert(lower, 1, -bound), np.insert(upper, 1, bound)
    yield _Alternative((text, remedy), spectrum, replace(manifold, has_elevation=True), box, freedom=0.02)


def _orientations(frame: Frame) -> Iterator[tuple[str, str, Float[ndarray, "3 3"]]]:
    """Yield other broadsides, each with two directions upwards, and their axes; the present one is left out."""
    for broadside, x in AXES.items():
        for up in ("+z", "+y", "+x"):
            if up[1] == broadside[1]:
                continue
            axes = np.array([x, np.cross(AXES[up], x), AXES[up]], dtype=np.float64)
            if axes[0] @ frame.axes[0] < 0.999 or abs(axes[2] @ frame.axes[2]) < 0.999:
                yield broadside, up, axes
