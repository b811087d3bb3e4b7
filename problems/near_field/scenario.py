"""The near-field scenario: sources in a box, an antenna array, a Rician channel and noise."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal, TypeAlias, final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nfbench import Ge, Gt, Instance, Le, Lt, OneOf, OptionError, Scenario

from .arrays import UCA, ULA, UPA, Array, Custom
from .channels import IID, ClusterAroundSource, Clusters, Isotropic, NLoS, complex_normal, rician
from .geometry import directions
from .instance import NearFieldInstance
from .objectives import kernels
from .wavefronts import Manifold, Wavefront

__all__ = ["NearField", "NearFieldInstance"]

_Finite: TypeAlias = Annotated[float, Gt(-math.inf), Lt(math.inf)]

_BATCH, _BATCHES = 1000, 100  # placements per attempt, and attempts, to find sources that are far enough apart


@final
@dataclass(frozen=True, kw_only=True)
class NearField(Scenario):
    """K sources in the near field of an array: Y = H·diag(√snr)·S + N.

    array: table of kind "ula", "upa", "uca" or "custom" that describes the antenna array.
    wavelength_m: wavelength λ [m].
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
    azimuth_deg: interval [low, high] [°] from which azimuths are drawn and in which they are searched.
    elevation_deg: interval [low, high] [°] from which elevations are drawn and in which they are searched; None: all
        sources lie in the plane z = 0, and elevation is not estimated.
    range_m: interval [low, high] [m] from which ranges are drawn and in which they are searched.
    min_separation_deg: minimum angle [°] between the directions of any two sources, seen from the origin.
    positions: list of fixed sources [azimuth, (elevation,) range] [°, m], one per source; None: sources are drawn at
        random.
    gospa_cutoff_m: cutoff distance c [m] of the score ``gospa_m``; an estimate farther away counts as a missed source
        and a false estimate.
    """

    instance: ClassVar[type[Instance]] = NearFieldInstance

    array: Annotated[Array, OneOf(ULA, UPA, UCA, Custom)]
    wavelength_m: Annotated[float, Gt(0.0), Lt(math.inf)]
    wavefront: Wavefront = "exact"
    sources: Annotated[int, Ge(1)]
    snapshots: Annotated[int, Ge(1)]
    snr_db: _Finite | tuple[_Finite, ...]
    rician_k: Annotated[float, Gt(0.0)] = math.inf
    fading: Literal["block", "snapshot"] | None = None
    nlos: Annotated[NLoS, OneOf(IID, Clusters, ClusterAroundSource, Isotropic)] = IID()  # noqa: RUF009  # frozen
    azimuth_deg: tuple[_Finite, _Finite]
    elevation_deg: tuple[_Finite, _Finite] | None = None
    range_m: tuple[_Finite, _Finite]
    min_separation_deg: Annotated[float, Ge(0.0), Le(180.0)] = 0.0
    positions: tuple[tuple[_Finite, ...], ...] | None = None
    gospa_cutoff_m: Annotated[float, Gt(0.0), Lt(math.inf)] = 1.0

    def validate(self) -> None:
        problems = [
            *_interval("azimuth_deg", self.azimuth_deg, -180.0, 180.0),
            *_interval("elevation_deg", self.elevation_deg, -90.0, 90.0),
            *_interval("range_m", self.range_m, 0.0, math.inf),
        ]
        elements = len(self.array.place(self.wavelength_m))
        if self.sources >= elements:
            problems.append(("sources", f"expected fewer than the {elements} elements, got {self.sources}"))
        if isinstance(self.snr_db, tuple) and len(self.snr_db) != self.sources:
            text = f"expected one number, or {self.sources} (one per source), got {len(self.snr_db)}"
            problems.append(("snr_db", text))
        if math.isfinite(self.rician_k) and self.fading is None:
            problems.append(("fading", f'expected "block" or "snapshot" for rician_k = {self.rician_k:g}, got none'))
        if self.positions is not None and not problems:
            problems += self._misplaced(self.positions)
        if problems:
            raise OptionError(type(self).__name__, problems)

    def warm_up(self) -> None:
        kernels.warm_up()

    def draw(self, rng: np.random.Generator) -> NearFieldInstance:
        """Draw positions, fading, symbols and noise, each from its own child of ``rng``, spawned in this order.

        The same seed therefore gives the same positions, symbols and noise at every SNR, Rician factor and wavefront.
        Raises ValueError if no placement is found whose sources are ``min_separation_deg`` apart.
        """
        kernels.warm_up()  # so that no measured time includes the compilation
        for_positions, for_fading, for_symbols, for_noise = rng.spawn(4)
        lower, upper = self._box()
        theta = self._place_sources(for_positions, lower, upper)
        manifold = Manifold(
            self.array.place(self.wavelength_m), self.wavelength_m, self.wavefront, self.elevation_deg is not None
        )
        draws = self.snapshots if self.fading == "snapshot" else 1
        G = self.nlos.draw(for_fading, draws, manifold, theta, lower, upper)
        H = rician(manifold.response(theta).T, G, self.rician_k)
        snr = 10.0 ** (np.broadcast_to(self.snr_db, self.sources) / 10)
        symbols = np.sqrt(snr)[:, None] * complex_normal(for_symbols, (self.sources, self.snapshots))
        N = complex_normal(for_noise, (manifold.elements, self.snapshots))
        Y = np.einsum("tmk,kt->mt", np.broadcast_to(H, (self.snapshots, *H.shape[1:])), symbols) + N
        return NearFieldInstance(Y, theta, manifold, lower, upper, H, symbols, snr, self.rician_k, self.gospa_cutoff_m)

    def _box(self) -> tuple[Float[ndarray, " d"], Float[ndarray, " d"]]:
        """Return the lower and upper bounds of one source [rad, m]."""
        angles = [self.azimuth_deg] if self.elevation_deg is None else [self.azimuth_deg, self.elevation_deg]
        lower, upper = np.array([*np.radians(angles), self.range_m]).T
        return lower, upper

    def _place_sources(self, rng: np.random.Generator, lower: ndarray, upper: ndarray) -> Float[ndarray, "k d"]:
        """Draw uniform positions in the box; all of them are redrawn until every pair is far enough apart."""
        if self.positions is not None:
            degrees = np.array(self.positions)
            return np.hstack([np.radians(degrees[:, :-1]), degrees[:, -1:]])
        if not self.min_separation_deg:
            return rng.uniform(lower, upper, (self.sources, len(lower)))
        chord = 2 * math.sin(math.radians(self.min_separation_deg) / 2)  # smallest distance of two unit vectors
        first, second = np.triu_indices(self.sources, k=1)
        for _ in range(_BATCHES):
            theta = rng.uniform(lower, upper, (_BATCH, self.sources, len(lower)))
            u = directions(theta)
            apart = (np.linalg.norm(u[:, first] - u[:, second], axis=-1) >= chord).all(axis=-1)
            if apart.any():
                return np.asarray(theta[np.argmax(apart)])
        raise ValueError(
            f"min_separation_deg: expected a placement of {self.sources} sources {self.min_separation_deg:g}° apart, "
            f"got none in {_BATCH * _BATCHES} attempts; widen the box, or reduce min_separation_deg or sources"
        )

    def _misplaced(self, positions: tuple[tuple[float, ...], ...]) -> list[tuple[str, str]]:
        """Return the errors in fixed positions as (path, message) pairs."""
        if len(positions) != self.sources:
            return [("positions", f"expected {self.sources} positions, one per source, got {len(positions)}")]
        box = {"azimuth_deg": self.azimuth_deg, "elevation_deg": self.elevation_deg, "range_m": self.range_m}
        sides = {name: side for name, side in box.items() if side is not None}
        problems = []
        for k, position in enumerate(positions):
            if len(position) != len(sides):
                problems.append(
                    (f"positions[{k}]", f"expected {len(sides)} numbers ({', '.join(sides)}), got {position}")
                )
                continue
            for value, (name, (low, high)) in zip(position, sides.items(), strict=True):
                if not low <= value <= high:
                    problems.append((f"positions[{k}]", f"expected {name} within [{low:g}, {high:g}], got {value:g}"))
        return problems


def _interval(
    name: str, interval: tuple[float, float] | None, smallest: float, largest: float
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
    return []
