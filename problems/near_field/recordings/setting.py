"""What the scenarios of measured data have in common: the array, the waves, the box, and the files."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Annotated, TypeAlias, TypeVar

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nfbench import Ge, Gt, Le, Lt, OptionError, Scenario, nearest

from ..arrays import AnyArray, unusual
from ..carrier import Frequency, Speed, Wavelength, carrier_problems, carrier_wavelength
from ..geometry import Frame, azimuth_near
from ..objectives import kernels
from ..wavefronts import Manifold, Wavefront
from .files import content_hash
from .likeness import unlike
from .measurement import spherical

__all__ = ["Finite", "Measured", "Positive"]

Finite: TypeAlias = Annotated[float, Gt(-math.inf), Lt(math.inf)]
Positive: TypeAlias = Annotated[float, Gt(0.0), Lt(math.inf)]

FAR = 20.0  # factor by which points must lie beyond the box to be suspected of another unit

T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class Measured(Scenario, ABC):
    """Sources that a real array has received. The options are described in the classes derived from this one."""

    array: AnyArray
    wavelength_m: Wavelength | None = None
    frequency_hz: Frequency | None = None
    speed_m_s: Speed | None = None
    wavefront: Wavefront = "exact"
    sources: Annotated[int, Ge(1), Le(1000)]
    azimuth_deg: tuple[Finite, Finite]
    elevation_deg: tuple[Finite, Finite] | None = None
    range_m: tuple[Finite, Finite]
    conjugate: bool = False
    failed: tuple[Annotated[int, Ge(0)] | str, ...] = ()
    gospa_cutoff_m: Annotated[float, Gt(0.0), Le(1e9)] = 1.0
    available_from: str | None = field(default=None, metadata={"identifies": False})
    sha256: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        try:
            super().__post_init__()
        except OptionError as error:  # whoever has the manifest but not the data must learn where they are
            missing = any("no such file" in text for _, text in error.problems)
            if missing and isinstance(self.available_from, str):
                hint = ("available_from", f"missing files are available from {self.available_from}")
                raise OptionError(type(self).__name__, [*error.problems, hint]) from error
            raise

    def validate(self) -> None:
        problems = [
            *carrier_problems(self.wavelength_m, self.frequency_hz, self.speed_m_s),
            *_interval("azimuth_deg", self.azimuth_deg, -360.0, 360.0, widest=360.0),
            *_interval("elevation_deg", self.elevation_deg, -90.0, 90.0),
            *_interval("range_m", self.range_m, 1e-9, 1e9),
            *self._wrong_elements(),
        ]
        if problems:
            raise OptionError(type(self).__name__, problems)
        if problems := self.array.misplaced(self.wavelength):
            raise OptionError(type(self).__name__, problems)
        elements = len(self.working)
        if self.sources >= elements:
            text = f"expected fewer than the {elements} elements that are used, got {self.sources}"
            raise OptionError(type(self).__name__, [("sources", text)])
        self._check_content()

    @abstractmethod
    def files(self) -> tuple[str, ...]:
        """Return the names of the options that are files, in a fixed order."""

    @property
    def wavelength(self) -> float:
        """The wavelength λ [m]."""
        return carrier_wavelength(self.wavelength_m, self.frequency_hz, self.speed_m_s)

    @property
    def bins(self) -> int:
        """The number of frequencies whose data are fitted together."""
        return 1

    @property
    def frame(self) -> Frame:
        """The coordinates in which the array and the true positions are described."""
        return self.array.frame(self.wavelength)

    @property
    def working(self) -> list[int]:
        """The numbers of the elements that are used."""
        names = self.array.element_names
        failed = {names.index(which) if isinstance(which, str) else which for which in self.failed}
        return [m for m in range(self.array.count) if m not in failed]

    def warm_up(self) -> None:
        kernels.warm_up()

    def manifold(self) -> Manifold:
        """Return the array, without the elements that failed, and the wavefront model."""
        Q = self.array.place(self.wavelength)[self.working]
        return Manifold(Q, self.wavelength, self.wavefront, self.elevation_deg is not None)

    def box(self) -> tuple[Float[ndarray, " d"], Float[ndarray, " d"]]:
        """Return the lower and upper bounds of one source [rad, m]."""
        angles = [self.azimuth_deg] if self.elevation_deg is None else [self.azimuth_deg, self.elevation_deg]
        lower, upper = np.array([*np.radians(angles), self.range_m]).T
        return lower, upper

    def sources_at(self, points: Float[ndarray, "k 3"]) -> Float[ndarray, "k d"]:
        """Return sources [rad, m] at points [m] given in the coordinates of the array. Raises ValueError."""
        self._refuse_other_unit(points)
        theta = spherical(self.frame.inward(points), self.elevation_deg is not None)
        middle = math.radians(sum(self.azimuth_deg) / 2)
        theta[:, 0] = azimuth_near(theta[:, 0], middle)
        return theta

    def _refuse_other_unit(self, points: Float[ndarray, "k 3"]) -> None:
        """Raise ValueError if points are far beyond the box, but not in millimetres or centimetres."""
        (low, high), r = self.range_m, np.linalg.norm(self.frame.inward(points), axis=1)
        if not len(r) or r.min() < FAR * high:
            return
        fits = []
        for unit, name, factor in (("mm", "millimetres", 1000), ("cm", "centimetres", 100)):
            inside = np.linalg.norm(self.frame.inward(points / factor), axis=1)
            if ((inside >= low / 2) & (inside <= 2 * high)).all():
                fits.append((unit, name))
        if fits:
            names = " or ".join(name for _, name in fits)
            columns = " or ".join(f"x_{unit}, y_{unit}, z_{unit}" for unit, _ in fits)
            text = f"expected points [m] near the box, which ends at {high:g} m, got one {r.min():.4g} m away"
            raise ValueError(f"{text}: are these {names}? If they are in a file, name its columns {columns}")

    def warnings(self) -> list[str]:
        low, high = np.array(self.azimuth_deg) - 360 * round(sum(self.azimuth_deg) / 720)
        return list(unusual(self.array, self.wavelength, faces_forward=bool(low >= -90 and high <= 90)))

    def differences(self, other: Scenario) -> list[str]:
        return unlike(self, other)

    def outside(self, name: str, theta: Float[ndarray, "k d"]) -> list[str]:
        """Return a sentence if sources lie outside the box, where no method can find them."""
        lower, upper = self.box()
        beyond = [int(k) for k in np.flatnonzero(((theta < lower) | (theta > upper)).any(axis=1))]
        if not beyond:
            return []
        angles = ", ".join(f"{angle:.4g}°" for angle in np.degrees(theta[beyond[0], :-1]))
        where = f"the first at {angles}, {theta[beyond[0], -1]:.4g} m"
        text = f"{name}: true sources {', '.join(map(str, beyond))} (counted from 0) are outside the box, {where}"
        return [f"{text}; enlarge azimuth_deg, elevation_deg or range_m, or check broadside and up of the array"]

    def checked(self, name: str, read: Callable[[], T]) -> T:
        """Read the file of an option. Raises OptionError with the name of the option in place of ValueError."""
        try:
            return read()
        except OptionError:
            raise
        except ValueError as error:
            raise OptionError(type(self).__name__, [(name, str(error))]) from error

    def _check_content(self) -> None:
        """Store the hashes of the files, or compare them with those stored when the study was planned."""
        names = [name for name in self.files() if getattr(self, name) is not None]
        found = tuple(self.checked(name, partial(content_hash, getattr(self, name))) for name in names)
        if self.sha256 is not None and self.sha256 != found:
            changed = [n for n, old, new in zip(names, self.sha256, found, strict=False) if old != new] or names
            text = f"expected the content with the hash in sha256, got another one of {', '.join(changed)}"
            text = f"{text}; leave sha256 out to use the files as they are"
            raise OptionError(type(self).__name__, [("sha256", text)])
        object.__setattr__(self, "sha256", found)

    def _wrong_elements(self) -> list[tuple[str, str]]:
        names, M, problems = self.array.element_names, self.array.count, []
        for i, which in enumerate(self.failed):
            if isinstance(which, str) and which not in names:
                near = nearest(which, names)
                hint = f'did you mean "{near}"?' if near else f"names: {', '.join(names[:12]) or 'none'}"
                text = f"expected a number or the name of an element, got {which!r}; {hint}"
                problems.append((f"failed[{i}]", text))
            elif isinstance(which, int) and which >= M:
                problems.append((f"failed[{i}]", f"expected the number of an element, 0 to {M - 1}, got {which}"))
        return problems


def _interval(
    name: str, interval: tuple[float, float] | None, smallest: float, largest: float, widest: float = math.inf
) -> list[tuple[str, str]]:
    """Return the errors in one interval of the box as (path, message) pairs."""
    if interval is None:
        return []
    low, high = interval
    if not low < high:
        return [(name, f"expected [low, high] with low < high, got [{low:g}, {high:g}]")]
    if high - low > widest:
        return [(name, f"expected an interval of at most {widest:g}, got [{low:g}, {high:g}]")]
    if low < smallest or high > largest:
        return [(name, f"expected an interval within [{smallest:g}, {largest:g}], got [{low:g}, {high:g}]")]
    return []
