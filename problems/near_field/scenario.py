"""The near-field scenario: sources in a box, an antenna array, a Rician channel and noise."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, Literal, TypeAlias, final

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

from nfbench import Ge, Gt, Instance, Le, Lt, OneOf, OptionError, Scenario, Survey

from .arrays import AnyArray, unusual
from .arrays.survey import survey
from .bands import Band, spread_bins
from .cached_draw import drawn_once
from .carrier import Frequency, Speed, Wavelength, carrier_problems, carrier_wavelength
from .channels import IID, ClusterAroundSource, Clusters, Isotropic, NLoS, complex_normal, rician
from .fixed_sources import cartesian_problems, cartesian_sources, spherical_problems, spherical_sources
from .geometry import ambiguity
from .impairments import Drawn, Impairments, mixing_matrix
from .instance import NearFieldInstance
from .objectives import kernels
from .placement import has_room, place_sources
from .wavefronts import Manifold, Wavefront

__all__ = ["NearField", "NearFieldInstance"]

_Finite: TypeAlias = Annotated[float, Gt(-math.inf), Lt(math.inf)]
_Decibels: TypeAlias = Annotated[float, Ge(-300.0), Le(300.0)]

MAX_NUMBERS = 10**8  # in one array of a draw, 1.6 GB
MAX_SOURCES = 1000
MAX_BINS = 1000
BEYOND = 0.6  # share of the interval of ranges that may lie beyond the Fraunhofer distance
FLAT = 0.02  # deviation from a line or plane [wavelengths, root mean square] that phases do not show


@final
@dataclass(frozen=True, kw_only=True)
class NearField(Scenario):
    """K sources in the near field of an array: Y = H·diag(√snr)·S + N.

    array: table of kind "ula", "upa", "uca", "cross", "rings", "spiral", "sunflower", "panels" or "custom" that
        describes the antenna array.
    wavelength_m: wavelength λ [m]; None: it follows from ``frequency_hz`` and ``speed_m_s``.
    frequency_hz: frequency f of the waves [Hz], in place of ``wavelength_m``; None: ``wavelength_m`` is used.
    speed_m_s: speed c of the waves [m/s], required with ``frequency_hz``: 299792458 for radio waves, about 343 for
        sound in air; None: ``wavelength_m`` is used.
    wavefront: wavefront model of the data: "exact" (spherical), "fresnel", "paper" (the Fresnel model without its cos²φ
        factor) or "planar".
    sources: number K of sources; must be smaller than the number of antennas.
    snapshots: number T of snapshots.
    snr_db: signal-to-noise ratio per source at each antenna [dB]; one number for all sources, or a list with one number
        per source.
    rician_k: Rician factor κ, the power of the line of sight divided by that of the scattered waves (a ratio, not dB);
        inf: line of sight only.
    fading: "block" draws one channel for all snapshots, "snapshot" draws a new channel for each snapshot; None: not
        stated, which is allowed only if rician_k is inf.
    nlos: table of kind "iid", "clusters", "cluster-around-source" or "isotropic" that describes the distribution of the
        scattered waves; it has no effect if rician_k is inf.
    azimuth_deg: interval [low, high] [°] from which azimuths are drawn and in which they are searched, at most 360°
        wide; it may extend beyond ±180°, such as [150, 210] for a sector about the negative x axis.
    elevation_deg: interval [low, high] [°] from which elevations are drawn and in which they are searched; None: all
        sources lie in the plane z = 0, and elevation is not estimated.
    range_m: interval [low, high] [m] from which ranges are drawn and in which they are searched.
    min_separation_deg: minimum angle [°] between the directions of any two sources, seen from the origin.
    positions: list of fixed sources [azimuth, (elevation,) range] [°, m], one per source; None: sources are drawn at
        random, or ``positions_m`` is used.
    positions_m: list of fixed sources [x, y, z] [m], one per source, in place of ``positions``: in the coordinates in
        which the array is described, those of the element positions for kinds "custom" and "panels"; for the other
        kinds, x is the broadside, and the origin is the point from which ranges are measured. None: ``positions`` is
        used, or sources are drawn at random.
    bins: number of frequency bins. The array and the positions are the same in all of them; symbols, noise and
        scattered waves are independent, with the SNR as stated in each bin.
    bandwidth_relative: distance between the outermost bins as a multiple of the carrier frequency, which belongs to the
        wavelength λ and lies in their middle; the others divide it into equal parts. It has no effect on one bin, which
        is the carrier.
    impairments: table that describes how the array and its sources differ from the model that estimators assume: gain,
        phase and position errors, failed elements, mutual coupling, coloured noise, correlated sources.
    gospa_cutoff_m: cutoff distance c [m] of the score ``gospa_m``; an estimate farther away counts as a missed source
        and a false estimate.
    """

    instance: ClassVar[type[Instance]] = NearFieldInstance

    array: AnyArray
    wavelength_m: Wavelength | None = None
    frequency_hz: Frequency | None = None
    speed_m_s: Speed | None = None
    wavefront: Wavefront = "exact"
    sources: Annotated[int, Ge(1), Le(MAX_SOURCES)]
    snapshots: Annotated[int, Ge(1), Le(MAX_NUMBERS)]
    snr_db: _Decibels | tuple[_Decibels, ...]
    rician_k: Annotated[float, Gt(0.0)] = math.inf
    fading: Literal["block", "snapshot"] | None = None
    nlos: Annotated[NLoS, OneOf(IID, Clusters, ClusterAroundSource, Isotropic)] = IID()  # noqa: RUF009  # frozen
    azimuth_deg: tuple[_Finite, _Finite]
    elevation_deg: tuple[_Finite, _Finite] | None = None
    range_m: tuple[_Finite, _Finite]
    min_separation_deg: Annotated[float, Ge(0.0), Le(180.0)] = 0.0
    positions: tuple[tuple[_Finite, ...], ...] | None = None
    positions_m: tuple[tuple[_Finite, _Finite, _Finite], ...] | None = None
    bins: Annotated[int, Ge(1), Le(MAX_BINS)] = 1
    bandwidth_relative: Annotated[float, Ge(0.0), Le(1.9)] = 0.0
    impairments: Impairments = Impairments()  # noqa: RUF009  # frozen
    gospa_cutoff_m: Annotated[float, Gt(0.0), Le(1e9)] = 1.0

    def validate(self) -> None:
        problems = [
            *carrier_problems(self.wavelength_m, self.frequency_hz, self.speed_m_s),
            *_interval("azimuth_deg", self.azimuth_deg, -360.0, 360.0, widest=360.0),
            *_interval("elevation_deg", self.elevation_deg, -90.0, 90.0),
            *_interval("range_m", self.range_m, 1e-9, 1e9),
            *self._too_large(),
        ]
        elements = self.array.count
        if self.sources >= elements:
            problems.append(("sources", f"expected fewer than the {elements} elements, got {self.sources}"))
        if isinstance(self.snr_db, tuple) and len(self.snr_db) != self.sources:
            text = f"expected one number, or {self.sources} (one per source), got {len(self.snr_db)}"
            problems.append(("snr_db", text))
        if math.isfinite(self.rician_k) and self.fading is None:
            problems.append(("fading", f'expected "block" or "snapshot" for rician_k = {self.rician_k:g}, got none'))
        for path, text in self.impairments.problems(elements, self.sources, self.wavefront):
            problems.append((f"impairments.{path}", text))
        if not problems:
            problems += self.array.misplaced(self.wavelength) or self._misplaced()
        if self.positions is self.positions_m is None and not problems:
            separation, box = math.radians(self.min_separation_deg), self.box()
            if not has_room(*box, self.sources, separation):
                low, high = self.azimuth_deg
                text = f"expected room for {self.sources} sources in azimuths from {low:g}° to {high:g}°"
                problems.append(("min_separation_deg", f"{text}, got {self.min_separation_deg:g}°"))
        if problems:
            raise OptionError(type(self).__name__, problems)

    def _too_large(self) -> list[tuple[str, str]]:
        """Return an error for the largest array of a draw, if it has too many numbers."""
        K, M, T = self.sources, self.array.count, self.snapshots
        waves = self.nlos.numbers(K, M)
        sizes = {
            f"snapshots × elements = {T:,} × {M:,}": ("snapshots", T * M),
            f"snapshots × sources = {T:,} × {K:,}": ("snapshots", T * K),
            f"the scattered waves of {K:,} sources at {M:,} elements": ("nlos", waves),
        }
        if self.fading == "snapshot":
            sizes[f"snapshots × elements × sources = {T:,} × {M:,} × {K:,}"] = ("snapshots", T * M * K)
            sizes[f"the gains of the scattered waves in {T:,} snapshots"] = ("snapshots", T * waves // M)
        if self.bins > 1:
            sizes[f"bins × snapshots × elements = {self.bins:,} × {T:,} × {M:,}"] = ("bins", self.bins * T * M)
        text, (name, size) = max(sizes.items(), key=lambda item: item[1][1])
        if size <= MAX_NUMBERS:
            return []
        return [(name, f"expected at most {MAX_NUMBERS:,} numbers in the arrays of a scene, got {text} = {size:,}")]

    def warm_up(self) -> None:
        kernels.warm_up()

    @property
    def wavelength(self) -> float:
        """The wavelength λ [m]."""
        return carrier_wavelength(self.wavelength_m, self.frequency_hz, self.speed_m_s)

    @classmethod
    def survey(cls, options: Mapping[str, Any]) -> Survey:
        return survey(options)

    def manifold(self) -> Manifold:
        """Return the array and the wavefront model with which the data of the carrier are generated.

        If no bin is at the carrier, they are those of the nearest bin.
        """
        return self.manifolds()[0]

    def manifolds(self) -> list[Manifold]:
        """Return the same for each bin, the nearest to the carrier first; the array is placed at the carrier."""
        Q, has_elevation = self.array.place(self.wavelength), self.elevation_deg is not None
        ratios = spread_bins(self.bins, self.bandwidth_relative)
        return [Manifold(Q, self.wavelength / ratio, self.wavefront, has_elevation) for ratio in ratios]

    def warnings(self) -> list[str]:
        """Return sentences about units and geometry that are probably not what was meant."""
        low, high = np.array(self.azimuth_deg) - 360 * round(sum(self.azimuth_deg) / 720)
        return [
            *unusual(self.array, self.wavelength, faces_forward=bool(low >= -90 and high <= 90)),
            *self._two_sides(),
            *self._in_radians(),
            *self._too_far(),
            *self.nlos.warnings(),
            *self.impairments.warnings(),
        ]

    def _two_sides(self) -> list[str]:
        """Return a sentence if the box contains two directions that the array cannot distinguish."""
        lower, upper = self.box()
        found = ambiguity(self.array.place(self.wavelength), lower, upper, FLAT * self.wavelength)
        if found is None:
            return []
        shape, pair = found
        first, second = (", ".join(f"{angle:g}°" for angle in row) for row in np.degrees(pair).round(1) + 0.0)
        if pair.shape[1] == 1:
            names = f"azimuths {first} and {second}"
        else:
            names = f"directions ({first}) and ({second}) in azimuth and elevation"
        keys = "azimuth_deg" if self.elevation_deg is None else "azimuth_deg and elevation_deg"
        text = f"{keys}: the box contains both sides of the array, whose elements lie "
        where = "in a plane" if shape == "plane" else "on a line"
        where += "" if self.elevation_deg else ", seen along the z axis,"
        return [f"{text}{where} and cannot distinguish, for example, the {names}; make the box smaller"]

    def _in_radians(self) -> list[str]:
        """Return sentences about angles in degrees whose values are typical of radians."""
        found = []
        intervals = {"azimuth_deg": (self.azimuth_deg, math.pi), "elevation_deg": (self.elevation_deg, math.pi / 2)}
        for name, (interval, largest) in intervals.items():
            if interval is not None and max(map(abs, interval)) <= largest + 0.002:
                low, high = interval
                text = f"{name}: [{low:g}, {high:g}]° is an unusually narrow interval; are these radians?"
                found.append(f"{text} [{low:g}, {high:g}] rad is [{math.degrees(low):.4g}, {math.degrees(high):.4g}]°")
        if 0 < self.min_separation_deg < 0.1:
            value = self.min_separation_deg
            text = f"min_separation_deg: {value:g}° is unusually small; is it in radians?"
            found.append(f"{text} {value:g} rad is {math.degrees(value):.3g}°")
        azimuths = [abs(position[0]) for position in self.positions or ()]
        if len(azimuths) > 1 and 0 < max(azimuths) <= math.pi / 2 and max(map(abs, self.azimuth_deg)) > 10:
            text = f"positions: all azimuths are within ±{max(azimuths):g}°; are these radians?"
            found.append(f"{text} {max(azimuths):g} rad is {math.degrees(max(azimuths)):.3g}°")
        return found

    def _too_far(self) -> list[str]:
        """Return a sentence if most ranges are beyond the near field, where the range cannot be estimated."""
        aperture = self.array.aperture_m(self.wavelength)
        fraunhofer = 2 * aperture**2 / self.wavelength
        low, high = self.range_m
        share = (high - max(low, fraunhofer)) / (high - low)
        if share <= BEYOND:
            return []
        text = f"range_m: {share:.0%} of [{low:g}, {high:g}] m lie beyond the Fraunhofer distance 2D²/λ"
        return [
            f"{text} = {fraunhofer:.4g} m of this array, D = {aperture:.4g} m, where ranges can hardly be estimated"
        ]

    def draw(self, rng: np.random.Generator) -> NearFieldInstance:
        """Draw positions, fading, symbols, noise and impairments, each from its own child of ``rng``, in this order.

        Each source has its own generators for its position, scattered waves and symbols, and each element one for its
        noise. The same seed therefore gives the same scene at every SNR, Rician factor, array and wavefront: K sources
        are the first K of K + 1, M elements have the noise of the first M of M + 1, and T snapshots are the first T of
        T + 1. Each bin but the first, which is the nearest to the carrier, has its own generators, and the first bins
        of a scene do not depend on their number. Raises ValueError if no placement is found whose sources are
        ``min_separation_deg`` apart.
        """
        self.warm_up()  # so that no measured time includes the compilation
        return drawn_once(self, rng.spawn(6), self._drawn)

    def draw_truth(self, rng: np.random.Generator, number: int) -> NearFieldInstance:
        """Draw the positions of the sources as ``draw`` does, and no data."""
        lower, upper = self.box()
        theta = self._place_sources(rng.spawn(1)[0], lower, upper)
        manifold = self.manifolds()[0]
        nothing = [np.zeros(shape, complex) for shape in ((manifold.elements, 0), (1, manifold.elements, 0), (0, 0))]
        Y, H, symbols = nothing
        snr = 10.0 ** (np.broadcast_to(self.snr_db, self.sources) / 10)
        frame = self.array.frame(self.wavelength)
        scene = Y, theta, manifold, lower, upper, H, symbols, snr, self.rician_k, self.gospa_cutoff_m, frame
        return NearFieldInstance(*scene)

    def _drawn(self, streams: Sequence[np.random.Generator]) -> NearFieldInstance:
        for_positions, for_fading, for_symbols, for_noise, for_impairments, for_bins = streams
        lower, upper = self.box()
        theta = self._place_sources(for_positions, lower, upper)
        snr = 10.0 ** (np.broadcast_to(self.snr_db, self.sources) / 10)
        first, *others = self.manifolds()
        array = self.impairments.draw(for_impairments, first)
        Y, _, H, symbols = self._receive((for_fading, for_symbols, for_noise), first, array, theta, snr)
        of_bins = [own.spawn(3) for own in for_bins.spawn(len(others))]
        further = [self._receive(own, at, array, theta, snr) for own, at in zip(of_bins, others, strict=True)]
        correlation = self.impairments.correlation(self.sources)
        return NearFieldInstance(
            Y,
            theta,
            first,
            lower,
            upper,
            H,
            symbols,
            snr,
            self.rician_k,
            self.gospa_cutoff_m,
            self.array.frame(self.wavelength),
            gains=array.gains,
            coupling=array.coupling,
            noise_covariance=array.noise_covariance,
            failed=array.failed,
            element_positions=array.positions,
            amplitude=array.amplitude,
            correlation=None if mixing_matrix(correlation) is None else correlation,
            further=tuple(Band(*each) for each in further),
        )

    def _receive(
        self,
        streams: Sequence[np.random.Generator],
        manifold: Manifold,
        array: Drawn,
        theta: Float[ndarray, "k d"],
        snr: Float[ndarray, " k"],
    ) -> tuple[ndarray, Manifold, ndarray, ndarray]:
        """Return Y, the manifold, H and the symbols of one bin."""
        for_fading, for_symbols, for_noise = streams
        displaced = array.displace(manifold)
        draws = self.snapshots if self.fading == "snapshot" else 1
        G = self.nlos.draw(for_fading, draws, displaced, theta, *self.box())
        A = replace(displaced, amplitude=array.amplitude).response(theta).T
        H = array.distort(rician(A, G, self.rician_k))
        uncorrelated = _rows(for_symbols, self.sources, self.snapshots)
        mixing = mixing_matrix(self.impairments.correlation(self.sources))
        symbols = np.sqrt(snr)[:, None] * (uncorrelated if mixing is None else mixing @ uncorrelated)
        N = array.colour(_rows(for_noise, manifold.elements, self.snapshots))
        Y = np.einsum("tmk,kt->mt", np.broadcast_to(H, (self.snapshots, *H.shape[1:])), symbols) + N
        return Y, manifold, H, symbols

    def box(self) -> tuple[Float[ndarray, " d"], Float[ndarray, " d"]]:
        """Return the lower and upper bounds of one source [rad, m]."""
        angles = [self.azimuth_deg] if self.elevation_deg is None else [self.azimuth_deg, self.elevation_deg]
        lower, upper = np.array([*np.radians(angles), self.range_m]).T
        return lower, upper

    def _place_sources(self, rng: np.random.Generator, lower: ndarray, upper: ndarray) -> Float[ndarray, "k d"]:
        """Return the fixed positions, or draw them."""
        if self.positions is self.positions_m is None:
            return place_sources(rng, lower, upper, self.sources, math.radians(self.min_separation_deg))
        if self.positions_m is not None:
            return cartesian_sources(self.positions_m, self.array.frame(self.wavelength), lower, upper)
        return spherical_sources(self.positions or (), self.azimuth_deg)

    def _misplaced(self) -> list[tuple[str, str]]:
        """Return the errors in fixed positions as (path, message) pairs."""
        if self.positions is not None and self.positions_m is not None:
            return [("positions_m", "expected either positions or positions_m, got both")]
        name, positions = ("positions_m", self.positions_m) if self.positions is None else ("positions", self.positions)
        if positions is None:
            return []
        if len(positions) != self.sources:
            return [(name, f"expected {self.sources} positions, one per source, got {len(positions)}")]
        box = {"azimuth_deg": self.azimuth_deg, "elevation_deg": self.elevation_deg, "range_m": self.range_m}
        sides = {name: side for name, side in box.items() if side is not None}
        if self.positions_m is not None:
            return cartesian_problems(self.positions_m, self.array.frame(self.wavelength), sides)
        return spherical_problems(positions, sides)


def _rows(rng: np.random.Generator, count: int, length: int) -> Complex[ndarray, "count length"]:
    """Draw circular complex Gaussian rows of unit variance, each from its own child of ``rng``."""
    return np.stack([complex_normal(own, (length,)) for own in rng.spawn(count)])


def _interval(
    name: str, interval: tuple[float, float] | None, smallest: float, largest: float, widest: float = math.inf
) -> list[tuple[str, str]]:
    """Return the errors in one interval of the box as (path, message) pairs."""
    if interval is None:
        return []
    low, high = interval
    if not low < high:
        return [(name, f"expected [low, high] with low < high, got [{low:g}, {high:g}]")]
    if name == "range_m" and low <= 0:
        return [(name, f"expected ranges greater than 0, got [{low:g}, {high:g}]")]
    if low < smallest or high > largest:
        return [(name, f"expected an interval within [{smallest:g}, {largest:g}], got [{low:g}, {high:g}]")]
    if high - low > widest:
        return [(name, f"expected an interval of at most {widest:g}°, got [{low:g}, {high:g}]")]
    return []
