"""The scenario of measured responses: real sources at known positions, simulated symbols and noise."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations, islice, permutations
from typing import Annotated, ClassVar, Literal, TypeAlias, final

import numpy as np
from jaxtyping import Complex, Float, Shaped
from numpy import ndarray

from nfbench import FilePath, Ge, Instance, Le, OptionError

from ..channels import complex_normal
from .files import read_array
from .instance import RecordedInstance
from .points import read_points
from .setting import Finite, Measured, Positive

__all__ = ["MeasuredResponses", "gated"]

_Point: TypeAlias = tuple[Finite, Finite, Finite]
_Decibels: TypeAlias = Annotated[float, Ge(-300.0), Le(300.0)]
_Axis: TypeAlias = Literal["sources", "samples", "elements"]

ORDER: tuple[_Axis, _Axis, _Axis] = ("sources", "samples", "elements")
MAX_NUMBERS = 10**8
ARRIVED = 0.2  # share of the peak of a response that its first arrival exceeds
BEFORE = 8  # samples of the gate before the first arrival


@final
@dataclass(frozen=True, kw_only=True)
class MeasuredResponses(Measured):
    """K of several measured sources at known positions, to which symbols and noise are added.

    The data are Y = H·diag(√snr)·S + N as in the scenario ``near-field``, but the columns of H are measured responses,
    each divided by the root mean square of its elements. They include what no model describes: sources that are not
    points, gains of the elements, reflections.

    data: path of a .npz, .mat, .h5, .hdf5 or .npy file with the responses: impulse responses over time, with the axes
        sources, samples and elements, or transfer functions at ``frequency_hz``, with the axes sources and elements.
    variable: name of the array in a file that can hold several; None: the only one that fits the number of elements.
    axes: list of the axes in the order in which they are in the file, such as ["elements", "samples", "sources"]; None:
        "sources", "samples", "elements", or another order if only that one fits the numbers of sources and elements.
    sample_rate_hz: sampling rate [Hz] of impulse responses, whose Fourier transform at ``frequency_hz`` is used; None:
        the file contains transfer functions.
    gate_samples: number of samples after the first arrival at each element that are used, faded out by half a cosine;
        it removes reflections. None: all samples.
    positions_m: list of the positions [x, y, z] [m] of all measured sources, in the coordinates in which the array is
        described; None: they are read from ``positions_file``.
    positions_file: path of a file with one row x, y, z [m] per measured source, which is read when the options are
        checked and stored as ``positions_m``; None: ``positions_m`` is used.
    sources: number K of sources in a scene; must be smaller than the number of elements.
    choose: which K of the measured sources are in a scene: "all" takes all combinations in lexicographic order, scene
        by scene, and begins again after the last; "random" draws them; a list takes the sources with these numbers,
        counted from 0.
    snapshots: number T of snapshots.
    snr_db: signal-to-noise ratio per source [dB], averaged over the elements; one number for all sources, or a list
        with one number per source.
    array: table that describes the antenna array.
    failed: elements to leave out, by their numbers from 0 or their names.
    conjugate: whether to conjugate the responses, for data whose phases grow with the distance.
    wavelength_m: wavelength λ [m]; None: it follows from ``frequency_hz`` and ``speed_m_s``.
    frequency_hz: frequency f of the waves [Hz], in place of ``wavelength_m``; None: ``wavelength_m`` is used.
    speed_m_s: speed c of the waves [m/s], required with ``frequency_hz``: 299792458 for radio waves, about 343 for
        sound in air; None: ``wavelength_m`` is used.
    wavefront: wavefront model that the formulations assume: "exact" (spherical), "fresnel", "paper" or "planar".
    azimuth_deg: interval [low, high] [°] in which azimuths are searched.
    elevation_deg: interval [low, high] [°] in which elevations are searched; None: all sources lie in the plane z = 0,
        and elevation is not estimated.
    range_m: interval [low, high] [m] in which ranges are searched.
    gospa_cutoff_m: cutoff distance c [m] of the score ``gospa_m``.
    available_from: where the files can be obtained, which is reported if one is missing; None: not stated.
    sha256: list of hashes of the contents of the files; None: they are computed. Other contents are refused.
    """

    instance: ClassVar[type[Instance]] = RecordedInstance

    data: FilePath = field(metadata={"identifies": False})
    variable: str | None = None
    axes: tuple[_Axis, ...] | None = None
    sample_rate_hz: Positive | None = None
    gate_samples: Annotated[int, Ge(2)] | None = None
    positions_m: tuple[_Point, ...] | None = None
    positions_file: FilePath | None = field(default=None, metadata={"identifies": False})
    choose: Literal["all", "random"] | tuple[Annotated[int, Ge(0)], ...] = "all"
    snapshots: Annotated[int, Ge(1), Le(MAX_NUMBERS)]
    snr_db: _Decibels | tuple[_Decibels, ...]

    def files(self) -> tuple[str, ...]:
        return ("data",)

    def validate(self) -> None:
        self._read_positions()
        super().validate()
        K, measured = self.sources, len(self.positions_m or ())
        if measured < K:
            raise self._error("sources", f"expected at most the {measured} measured sources, got {K}")
        if isinstance(self.snr_db, tuple) and len(self.snr_db) != K:
            raise self._error("snr_db", f"expected one number, or {K} (one per source), got {len(self.snr_db)}")
        if self.snapshots * self.array.count > MAX_NUMBERS:
            text = f"expected at most {MAX_NUMBERS:,} snapshots × elements"
            raise self._error("snapshots", f"{text}, got {self.snapshots:,} × {self.array.count:,}")
        if isinstance(self.choose, tuple):
            distinct = set(self.choose)
            if len(self.choose) != K or len(distinct) != K or max(distinct) >= measured:
                text = f"expected {K} different numbers from 0 to {measured - 1}, got {list(self.choose)}"
                raise self._error("choose", text)
        if self.gate_samples is not None and self.sample_rate_hz is None:
            raise self._error("gate_samples", "has an effect only on impulse responses; give sample_rate_hz")
        self.checked("data", lambda: self._responses)
        self.checked("positions_m", lambda: self._theta)

    def warnings(self) -> list[str]:
        return super().warnings() + self.outside("positions_m", self._theta)

    def draw(self, rng: np.random.Generator) -> RecordedInstance:
        """Draw the first scene of a study; see ``draw_scene``."""
        return self.draw_scene(rng, 0)

    def draw_scene(self, rng: np.random.Generator, number: int) -> RecordedInstance:
        """Draw the choice of sources, symbols and noise, each from its own child of ``rng``, spawned in this order.

        Each source and each element has its own generator, as in the scenario ``near-field``.
        """
        self.warm_up()
        for_choice, for_symbols, for_noise = rng.spawn(3)
        chosen = self._chosen(for_choice, number)
        H = self._responses[:, chosen]
        snr = 10.0 ** (np.broadcast_to(self.snr_db, self.sources) / 10)
        symbols = np.sqrt(snr)[:, None] * _rows(for_symbols, self.sources, self.snapshots)
        noise = _rows(for_noise, self.array.count, self.snapshots)[self.working]
        lower, upper = self.box()
        return RecordedInstance(
            H @ symbols + noise,
            self.manifold(),
            lower,
            upper,
            self.sources,
            self.frame,
            self._theta[chosen],
            gospa_cutoff_m=self.gospa_cutoff_m,
            noiseless=H,
            notes=(f"sources {', '.join(map(str, chosen))} of the {len(self._theta)} measured ones",),
        )

    def _chosen(self, rng: np.random.Generator, number: int) -> list[int]:
        """Return the numbers of the sources in a scene."""
        if isinstance(self.choose, tuple):
            return list(self.choose)
        measured = len(self._theta)
        if self.choose == "random":
            return sorted(rng.choice(measured, self.sources, replace=False).tolist())
        place = number % math.comb(measured, self.sources)
        return list(next(islice(combinations(range(measured), self.sources), place, None)))

    def _error(self, name: str, text: str) -> OptionError:
        return OptionError(type(self).__name__, [(name, text)])

    def _read_positions(self) -> None:
        if (self.positions_m is None) == (self.positions_file is None):
            got = "neither" if self.positions_m is None else "both"
            raise ValueError(f"expected either positions_m or positions_file, got {got}")
        if self.positions_file is not None:
            path = self.positions_file
            points = self.checked("positions_file", lambda: read_points(path))
            object.__setattr__(self, "positions_m", tuple(map(tuple, points.tolist())))
            object.__setattr__(self, "positions_file", None)

    @cached_property
    def _theta(self) -> Float[ndarray, "n d"]:
        """All measured sources [rad, m]."""
        return self.sources_at(np.array(self.positions_m).reshape(-1, 3))

    @cached_property
    def _responses(self) -> Complex[ndarray, "m n"]:
        """The responses of the used elements to all measured sources, of unit mean power. Raises ValueError."""
        X = read_array(self.data, self.variable, self.array.count).array
        is_impulse = self.sample_rate_hz is not None
        if X.ndim != (3 if is_impulse else 2):
            what = "3 axes (sources, samples, elements)" if is_impulse else "2 axes (sources, elements)"
            remedy = "" if is_impulse else "; for impulse responses, give sample_rate_hz"
            raise ValueError(f"expected {what}, got an array of shape {X.shape}{remedy}")
        X = self._in_order(X)
        if self.sample_rate_hz is not None:
            X = self._transformed(X, self.sample_rate_hz)
        elif not np.iscomplexobj(X) or not X.imag.any():
            raise ValueError(
                "expected complex transfer functions, got real numbers; for impulse responses, give sample_rate_hz"
            )
        H = (X.conj() if self.conjugate else X).T[self.working].astype(np.complex128)
        power = np.mean(np.abs(H) ** 2, axis=0)
        if not power.all():
            raise ValueError(f"expected responses other than 0, got zeros only for source {int(np.argmin(power))}")
        return H / np.sqrt(power)

    def _in_order(self, X: Shaped[ndarray, ...]) -> Shaped[ndarray, "n ... m"]:
        """Return the responses with the axes sources, (samples,) elements."""
        names = ORDER if X.ndim == 3 else ("sources", "elements")
        sizes = {"sources": len(self.positions_m or ()), "elements": self.array.count}
        orders = [self.axes] if self.axes is not None else list(permutations(names))
        fit = [
            order
            for order in orders
            if sorted(order) == sorted(names)
            and all(sizes.get(name, size) == size for name, size in zip(order, X.shape, strict=True))
        ]
        if not fit:
            expected = ", ".join(f"{size} {name}" for name, size in sizes.items())
            given = f" in the order {list(self.axes)}" if self.axes is not None else ""
            raise ValueError(f"expected axes of {expected}{given}, got an array of shape {X.shape}")
        return X.transpose([fit[0].index(name) for name in names])

    def _transformed(self, h: Float[ndarray, "n samples m"], rate_hz: float) -> Complex[ndarray, "n m"]:
        """Return the Fourier transform of gated impulse responses at the frequency."""
        if self.frequency_hz is None:
            raise self._error("frequency_hz", "is required for impulse responses, with speed_m_s: the frequency [Hz]")
        if self.frequency_hz >= rate_hz / 2:
            text = f"expected a value below half the sampling rate, {rate_hz / 2:g} Hz, got {self.frequency_hz:g}"
            raise self._error("frequency_hz", text)
        if self.gate_samples is not None:
            h = h * gated(h, self.gate_samples)
        turns = np.exp(-2j * math.pi * self.frequency_hz / rate_hz * np.arange(h.shape[1]))
        transformed: ndarray = np.einsum("ntm,t->nm", h, turns)
        return transformed


def gated(h: Float[ndarray, "n samples m"], samples: int) -> Float[ndarray, "n samples m"]:
    """Return weights that are 1 at the first arrival of each response and fall to 0 within so many samples.

    The gate begins 8 samples before the first value that exceeds a fifth of the largest one of the response.
    """
    size = np.abs(h)
    arrival = np.argmax(size > ARRIVED * size.max(axis=1, keepdims=True), axis=1)
    t = (np.arange(h.shape[1])[:, None] - arrival[:, None]) + BEFORE
    fading = 0.5 + 0.5 * np.cos(math.pi * np.clip((t - BEFORE) / samples, 0.0, 1.0))
    return np.where(t >= 0, fading, 0.0)


def _rows(rng: np.random.Generator, count: int, length: int) -> Complex[ndarray, "count length"]:
    """Draw circular complex Gaussian rows of unit variance, each from its own child of ``rng``."""
    return np.stack([complex_normal(own, (length,)) for own in rng.spawn(count)])
