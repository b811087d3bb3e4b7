"""An array of several panels, each an array of its own at a given place and orientation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nfbench import OneOf, OptionError, Options

from ..geometry import Frame, nearest_distances
from .axes import Axis, axes_of
from .base import MAX_ELEMENTS, Array, Origin
from .custom import Custom
from .planar import Cross, Rings, Spiral, Sunflower
from .uniform import UCA, ULA, UPA

__all__ = ["Panel", "Panels"]

MAX_PANELS = 1000
TOUCHING = 1e-9  # of the largest coordinate; elements that are not farther apart are at the same place


@dataclass(frozen=True, kw_only=True)
class Panel(Options):
    """One panel: an array, with the place of its origin and the directions of its axes.

    array: table of kind "ula", "upa", "uca", "cross", "rings", "spiral", "sunflower" or "custom".
    position_m: position [x, y, z] of the origin of the panel [m].
    broadside: direction in front of the panel: "+x", "-x", "+y", "-y", "+z", "-z", or a vector [x, y, z]; None: "+x".
    up: direction upwards of the panel, given like ``broadside``; its part along the broadside is ignored. None: "+z",
        or "+y" if the broadside is along z.
    """

    array: Annotated[Array, OneOf(ULA, UPA, UCA, Cross, Rings, Spiral, Sunflower, Custom)]
    position_m: tuple[float, float, float]
    broadside: Axis | None = None
    up: Axis | None = None

    def validate(self) -> None:
        axes_of(self.broadside, self.up, type(self).__name__)
        if not np.abs(self.position_m).max() <= 1e9:
            text = f"expected coordinates within ±1e9 m, got {list(self.position_m)}"
            raise OptionError(type(self).__name__, [("position_m", text)])

    def place(self, wavelength_m: float) -> Float[ndarray, "m 3"]:
        """Return the element positions in the coordinates of ``position_m`` [m]."""
        Q = self.array.place(wavelength_m)
        return Q @ axes_of(self.broadside, self.up, type(self).__name__) + np.array(self.position_m)


@dataclass(frozen=True, kw_only=True)
class Panels(Options, Array):
    """An array of several panels, whose elements are numbered panel by panel.

    All positions and directions are given in one coordinate system.

    panels: list of tables with ``array`` (any other kind of array), ``position_m`` (position [x, y, z] of the panel's
        origin [m]), ``broadside`` (direction in front of the panel, as for kind "custom"; "+x" if left out) and ``up``
        (direction upwards of the panel; "+z" if left out).
    origin: point from which range and angles are measured: "first" (first element of the first panel) or "center"
        (centroid of all elements).
    broadside: direction in front of the whole array, where azimuth and elevation are 0: "+x", "-x", "+y", "-y", "+z",
        "-z", or a vector [x, y, z]; None: "+x".
    up: direction upwards, towards which elevations are positive, given like ``broadside``; its part along the broadside
        is ignored. None: "+z", or "+y" if the broadside is along z.
    """

    kind: ClassVar[str] = "panels"
    panels: tuple[Panel, ...]
    origin: Origin
    broadside: Axis | None = None
    up: Axis | None = None

    def validate(self) -> None:
        axes_of(self.broadside, self.up, type(self).__name__)
        text = ""
        if not 1 <= len(self.panels) <= MAX_PANELS:
            text = f"expected 1 to {MAX_PANELS:,} panels, got {len(self.panels):,}"
        elif self.count > MAX_ELEMENTS:
            text = f"expected at most {MAX_ELEMENTS:,} elements, got {self.count:,} in {len(self.panels):,} panels"
        if text:
            raise OptionError(type(self).__name__, [("panels", text)])

    @property
    def count(self) -> int:
        return sum(panel.array.count for panel in self.panels)

    @property
    def in_metres(self) -> bool:
        return all(panel.array.in_metres for panel in self.panels)

    def place(self, wavelength_m: float) -> Float[ndarray, "m 3"]:
        return self.frame(wavelength_m).inward(self._placed(wavelength_m))

    def frame(self, wavelength_m: float) -> Frame:
        Q = self._placed(wavelength_m)
        return Frame(
            axes_of(self.broadside, self.up, type(self).__name__), Q[0] if self.origin == "first" else Q.mean(axis=0)
        )

    def misplaced(self, wavelength_m: float) -> list[tuple[str, str]]:
        Q = self._placed(wavelength_m)
        distances = nearest_distances(Q)
        closest = int(np.argmin(distances))
        if distances[closest] > TOUCHING * np.abs(Q).max():
            return []
        panel = int(np.searchsorted(np.cumsum([panel.array.count for panel in self.panels]), closest, side="right"))
        where = ", ".join(f"{part:.4g}" for part in Q[closest] + 0.0)
        text = f"expected elements at distinct positions, got two at [{where}] m, one of them in panels[{panel}]"
        return [("array.panels", text)]

    def _placed(self, wavelength_m: float) -> Float[ndarray, "m 3"]:
        """Return the positions in the coordinates of the panels [m]."""
        return np.vstack([panel.place(wavelength_m) for panel in self.panels])
