"""The scenario of a recording: data from a file in place of simulated data."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal, TypeAlias, final

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

from nfbench import FilePath, Ge, Gt, Instance, Le, Lt, OneOf, OptionError, Scenario

from ..arrays import UCA, ULA, UPA, Array, Custom
from ..objectives import kernels
from ..wavefronts import Manifold, Wavefront
from .files import content_hash, read_array
from .instance import RecordedInstance
from .measurement import normalized, oriented, spherical

__all__ = ["Recorded"]

_Finite: TypeAlias = Annotated[float, Gt(-math.inf), Lt(math.inf)]
_Point: TypeAlias = tuple[_Finite, _Finite, _Finite]


@final
@dataclass(frozen=True, kw_only=True)
class Recorded(Scenario):
    """Sources in a recording of an array.

    data: path of the file with the recording.
    data_kind: what the file contains: "snapshots" (complex, elements × snapshots).
    data_sha256: hash of the contents of ``data``; None: computed. A file with another hash is refused.
    element_axis: axis of the data along which the elements are, 0 or 1; None: the one that has as many entries as the
        array has elements, or 0 if both have.
    conjugate: whether to conjugate the data, for data whose phases grow with the distance.
    failed: elements to leave out, by their numbers from 0.
    array: table that describes the antenna array.
    frequency_hz: frequency [Hz].
    speed_m_s: speed of the waves [m/s].
    wavefront: wavefront model: "exact" (spherical), "fresnel", "paper" or "planar".
    sources: number K of sources; must be smaller than the number of elements.
    azimuth_deg: interval [low, high] [°] in which azimuths are searched.
    elevation_deg: interval [low, high] [°] in which elevations are searched; None: all sources lie in the plane z = 0,
        and elevation is not estimated.
    range_m: interval [low, high] [m] in which ranges are searched.
    truth_m: list of true sources [x, y, z] [m] in the coordinates of the array's positions; None: not known.
    gospa_cutoff_m: cutoff distance c [m] of the score ``gospa_m``.
    """

    instance: ClassVar[type[Instance]] = RecordedInstance

    data: FilePath
    data_kind: Literal["snapshots"] = "snapshots"
    data_sha256: str | None = None
    element_axis: Annotated[int, Ge(0), Le(1)] | None = None
    conjugate: bool = False
    failed: tuple[Annotated[int, Ge(0)], ...] = ()
    array: Annotated[Array, OneOf(ULA, UPA, UCA, Custom)]
    frequency_hz: Annotated[float, Gt(0.0), Lt(math.inf)]
    speed_m_s: Annotated[float, Gt(0.0), Lt(math.inf)]
    wavefront: Wavefront = "exact"
    sources: Annotated[int, Ge(1), Le(1000)]
    azimuth_deg: tuple[_Finite, _Finite]
    elevation_deg: tuple[_Finite, _Finite] | None = None
    range_m: tuple[_Finite, _Finite]
    truth_m: tuple[_Point, ...] | None = None
    gospa_cutoff_m: Annotated[float, Gt(0.0), Le(1e9)] = 1.0

    def validate(self) -> None:
        try:
            found = content_hash(self.data)
            self._snapshots()
        except ValueError as error:
            raise OptionError(type(self).__name__, [("data", str(error))]) from error
        object.__setattr__(self, "data_sha256", found)

    @property
    def wavelength_m(self) -> float:
        """The wavelength λ [m]."""
        return self.speed_m_s / self.frequency_hz

    def warm_up(self) -> None:
        kernels.warm_up()

    def manifold(self) -> Manifold:
        """Return the array, without the elements that failed, and the wavefront model."""
        Q = self.array.place(self.wavelength_m)[self._working()]
        return Manifold(Q, self.wavelength_m, self.wavefront, self.elevation_deg is not None)

    def box(self) -> tuple[Float[ndarray, " d"], Float[ndarray, " d"]]:
        """Return the lower and upper bounds of one source [rad, m]."""
        angles = [self.azimuth_deg] if self.elevation_deg is None else [self.azimuth_deg, self.elevation_deg]
        lower, upper = np.array([*np.radians(angles), self.range_m]).T
        return lower, upper

    def draw(self, rng: np.random.Generator) -> RecordedInstance:
        """Return the recording; nothing is random."""
        self.warm_up()
        Y, _ = normalized(self._snapshots(), self.sources)
        lower, upper = self.box()
        frame = self.array.frame(self.wavelength_m)
        theta = None
        if self.truth_m is not None:
            theta = spherical(frame.inward(np.array(self.truth_m)), self.elevation_deg is not None)
        return RecordedInstance(
            Y, self.manifold(), lower, upper, self.sources, frame, theta, gospa_cutoff_m=self.gospa_cutoff_m
        )

    def _working(self) -> list[int]:
        return [m for m in range(self.array.count) if m not in set(self.failed)]

    def _snapshots(self) -> Complex[ndarray, "m t"]:
        X, _ = oriented(read_array(self.data), self.array.count, self.element_axis)
        Y = X[self._working()].astype(np.complex128)
        return Y.conj() if self.conjugate else Y
