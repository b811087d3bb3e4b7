"""The scenario of a recording: data from a file in place of simulated data."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, ClassVar, Literal, NamedTuple, TypeAlias, final

import numpy as np
from jaxtyping import Complex, Float, Shaped
from numpy import ndarray

from nfbench import FilePath, Ge, Instance, Le, Lt, OptionError

from ..bands import Band
from ..diagnosis import Reading, silent_elements
from .blocks import block_problem, default_block, longest_delay
from .files import read_array
from .instance import RecordedInstance
from .measurement import (
    COMPLEX,
    covariance_factor,
    normalized,
    oriented,
    refuse_covariance,
    spectral_snapshots,
    without_phase,
)
from .points import read_points
from .setting import Finite, Measured, Positive

__all__ = ["Recorded"]

_Point: TypeAlias = tuple[Finite, Finite, Finite]

MAX_NUMBERS = 10**8  # in the snapshots, 1.6 GB
WINDOW, OVERLAP = "hann", 0.5
TIME_OPTIONS = {
    "sample_rate_hz": None,
    "block": None,
    "window": WINDOW,
    "overlap": OVERLAP,
    "further_frequencies_hz": (),
}


class _Data(NamedTuple):
    """Snapshots (M, T), sentences that say how they were read, and what warnings about them depend on."""

    Y: Complex[ndarray, "m t"]
    notes: tuple[str, ...]
    reading: Reading


@final
@dataclass(frozen=True, kw_only=True)
class Recorded(Measured):
    """Sources in a recording of an array, whose positions may be known or not.

    Without true positions, methods are ranked by ``misfit``, the share of the energy of the data that an estimate does
    not explain. The data are scaled so that what K sources cannot explain has unit variance. Nothing is random: with
    ``segments``, scene s is the s-th of so many parts of the recording.

    data: path of the file with the recording: .npy, .npz, .mat, .h5, .hdf5, .wav, .csv, .txt or .tsv.
    data_kind: what the file contains: "snapshots" (complex), "covariance" (elements × elements, complex), or "samples"
        over time, from which snapshots at ``frequency_hz`` are computed by windowed Fourier transforms.
    variable: name of the array in a file that can hold several; None: the only one that fits the number of elements.
    element_axis: axis of the data along which the elements are, 0 or 1; None: the one that has as many entries as the
        array has elements, or 0 if both have.
    snapshots: number of snapshots from which the covariance was estimated, on which the standard errors depend; only
        for "covariance". None: the number of elements.
    sample_rate_hz: sampling rate [Hz]; only for "samples". None: that of a .wav file.
    block: samples per snapshot; only for "samples". None: a power of two, at least 256 and, if that leaves as
        many snapshots as elements in each segment, at least 32 times the longest delay across the array.
    window: window of each block, a name that scipy.signal.get_window knows, such as "hann"; only for "samples".
    overlap: share of a block that the next one repeats; only for "samples".
    further_frequencies_hz: frequencies [Hz] besides ``frequency_hz`` whose snapshots are fitted together with its own;
        only for "samples".
    segments: number of parts of equal length into which the snapshots are divided; scene s uses part s, so that a
        study has at most as many scenes.
    array: table that describes the antenna array.
    failed: elements to leave out, by their numbers from 0 or their names.
    conjugate: whether to conjugate the data, for data whose phases grow with the distance.
    gains_file: path of a file with the complex gains of the elements, shape (M,); None: not known.
    noise_file: path of a file with the covariance of the noise, shape (M, M), or its power in each element, shape (M,),
        in the units of the data squared; None: not known.
    wavelength_m: wavelength λ [m]; None: it follows from ``frequency_hz`` and ``speed_m_s``.
    frequency_hz: frequency f of the waves [Hz], in place of ``wavelength_m``; None: ``wavelength_m`` is used.
    speed_m_s: speed c of the waves [m/s], required with ``frequency_hz``: 299792458 for radio waves, about 343 for
        sound in air; None: ``wavelength_m`` is used.
    wavefront: wavefront model that the formulations assume: "exact" (spherical), "fresnel", "paper" or "planar".
    sources: number K of sources; must be smaller than the number of elements.
    azimuth_deg: interval [low, high] [°] in which azimuths are searched.
    elevation_deg: interval [low, high] [°] in which elevations are searched; None: all sources lie in the plane z = 0,
        and elevation is not estimated.
    range_m: interval [low, high] [m] in which ranges are searched.
    truth_m: list of true sources [x, y, z] [m] in the coordinates in which the array is described; None: they are read
        from ``truth_file``, or not known.
    truth_file: path of a file with one row x, y, z [m] per true source, which is read when the options are checked and
        stored as ``truth_m``; None: ``truth_m`` is used.
    gospa_cutoff_m: cutoff distance c [m] of the score ``gospa_m``.
    available_from: where the files can be obtained, which is reported if one is missing; None: not stated.
    sha256: list of hashes of the contents of the files; None: they are computed. Other contents are refused.
    """

    instance: ClassVar[type[Instance]] = RecordedInstance

    data: FilePath = field(metadata={"identifies": False})
    data_kind: Literal["snapshots", "covariance", "samples"] = "snapshots"
    variable: str | None = None
    element_axis: Annotated[int, Ge(0), Le(1)] | None = None
    snapshots: Annotated[int, Ge(1), Le(MAX_NUMBERS)] | None = None
    sample_rate_hz: Positive | None = None
    block: Annotated[int, Ge(4), Le(2**24)] | None = None
    window: str = WINDOW
    overlap: Annotated[float, Ge(0.0), Lt(1.0)] = OVERLAP
    further_frequencies_hz: tuple[Positive, ...] = ()
    segments: Annotated[int, Ge(1), Le(100_000)] = 1
    gains_file: FilePath | None = field(default=None, metadata={"identifies": False})
    noise_file: FilePath | None = field(default=None, metadata={"identifies": False})
    truth_m: tuple[_Point, ...] | None = None
    truth_file: FilePath | None = field(default=None, metadata={"identifies": False})

    @property
    def bins(self) -> int:
        return 1 + len(self.further_frequencies_hz)

    def files(self) -> tuple[str, ...]:
        return "data", "gains_file", "noise_file"

    def validate(self) -> None:
        self._read_truth()
        super().validate()
        self._check_options_of_kind()
        T = self.checked("data", lambda: self._data).Y.shape[1]
        self.checked("further_frequencies_hz", lambda: self._further)
        if self.segments > T:
            raise self._error("segments", f"expected at most {T}, the number of snapshots, got {self.segments}")
        self.checked("gains_file", self._gains)
        self.checked("noise_file", self._noise)
        self.checked("truth_m", self._theta)

    def ranked_by(self) -> str:
        return self.error if self.truth_m is not None else "misfit"

    def most_scenes(self) -> tuple[int, str]:
        if self.data_kind == "covariance":
            return 1, "as a covariance has no parts"
        return self.segments, "one per segment of the recording; raise segments"

    def warnings(self) -> list[str]:
        theta = self._theta()
        found = super().warnings() + ([] if theta is None else self.outside("truth_m", theta))
        if theta is not None and len(theta) != self.sources:
            text = (
                f"truth_m: expected the positions of all {self.sources} sources, got {len(theta)}: the errors are those"
            )
            found.append(
                f"{text} of the nearest pairs and may be too small; only gospa_m counts the sources without a pair"
            )
        silent = silent_elements(self._data.Y, self._element_names())
        return found + [f"data: {text}" for text in silent]

    def draw(self, rng: np.random.Generator) -> RecordedInstance:
        """Return the recording, or its first segment; nothing is random."""
        return self.draw_scene(rng, 0)

    def draw_scene(self, rng: np.random.Generator, number: int) -> RecordedInstance:
        """Return a segment of the recording; after the last one follows the first."""
        self.warm_up()
        data = self._data
        parts = np.linspace(0, data.Y.shape[1], self.segments + 1).astype(int)
        part = number % self.segments
        segment = slice(parts[part], parts[part + 1])
        Y, deviation = normalized(data.Y[:, segment], self.sources)
        noise = self._noise()
        lower, upper = self.box()
        return RecordedInstance(
            Y,
            self.manifold(),
            lower,
            upper,
            self.sources,
            self.frame,
            self._theta(),
            gospa_cutoff_m=self.gospa_cutoff_m,
            gains=self._gains(),
            noise_covariance=None if noise is None else noise / deviation**2,
            notes=data.notes,
            reading=replace(data.reading, transposed=None if self.segments > 1 else data.reading.transposed),
            further=tuple(
                Band(normalized(band.Y[:, segment], self.sources)[0], band.manifold) for band in self._further
            ),
        )

    def _error(self, name: str, text: str) -> OptionError:
        return OptionError(type(self).__name__, [(name, text)])

    def _check_options_of_kind(self) -> None:
        """Raise OptionError if an option has no effect with this kind of data."""
        wrong = []
        if self.data_kind != "samples":
            wrong = [name for name, default in TIME_OPTIONS.items() if getattr(self, name) != default]
        if self.data_kind != "covariance" and self.snapshots is not None:
            wrong.append("snapshots")
        if wrong:
            kind = "covariance" if wrong[0] == "snapshots" else "samples"
            raise self._error(wrong[0], f'has an effect only with data_kind = "{kind}", got "{self.data_kind}"')
        if self.data_kind == "covariance" and self.segments > 1:
            raise self._error("segments", f"expected 1, as a covariance has no parts, got {self.segments}")

    def _read_truth(self) -> None:
        if self.truth_file is None:
            return
        if self.truth_m is not None:
            raise ValueError("expected either truth_m or truth_file, got both")
        path = self.truth_file
        points = self.checked("truth_file", lambda: read_points(path))
        object.__setattr__(self, "truth_m", tuple(map(tuple, points.tolist())))
        object.__setattr__(self, "truth_file", None)

    def _theta(self) -> Float[ndarray, "k d"] | None:
        return None if self.truth_m is None else self.sources_at(np.array(self.truth_m).reshape(-1, 3))

    def _gains(self) -> Complex[ndarray, " m"] | None:
        if self.gains_file is None:
            return None
        g = read_array(self.gains_file, length=self.array.count).array.ravel()
        if len(g) != self.array.count or not g.all():
            raise ValueError(f"expected {self.array.count} gains other than 0, got {len(g)} numbers")
        return g[self.working].astype(np.complex128)

    def _noise(self) -> Complex[ndarray, "m m"] | None:
        if self.noise_file is None:
            return None
        M, R = self.array.count, read_array(self.noise_file, length=self.array.count).array
        if R.size == M:
            R = np.diag(R.ravel())
        if R.shape != (M, M):
            raise ValueError(f"expected a covariance of {M} × {M} or {M} powers, got an array of shape {R.shape}")
        R = R[np.ix_(self.working, self.working)].astype(np.complex128)
        if np.abs(R - R.conj().T).max() > 1e-6 * np.abs(R).max() or np.linalg.eigvalsh(R)[0] <= 0:
            raise ValueError("expected a Hermitian, positive definite covariance of the noise")
        return R

    @cached_property
    def _data(self) -> _Data:
        """The snapshots of the elements that are used. Raises ValueError."""
        return self._at(self.frequency_hz)

    @cached_property
    def _further(self) -> list[Band]:
        """The snapshots at the further frequencies. Raises ValueError."""
        if not self.further_frequencies_hz:
            return []
        manifold, speed = self.manifold(), self.speed_m_s
        if self.frequency_hz is None or speed is None:
            raise ValueError("expected none without frequency_hz and speed_m_s")
        if len({self.frequency_hz, *self.further_frequencies_hz}) < self.bins:
            raise ValueError(f"expected different frequencies, none of them frequency_hz = {self.frequency_hz:g}")
        return [Band(self._at(f).Y, replace(manifold, wavelength_m=speed / f)) for f in self.further_frequencies_hz]

    def _at(self, frequency_hz: float | None) -> _Data:
        """Return the snapshots at a frequency of the elements that are used. Raises ValueError."""
        X, rate_hz = read_array(self.data, self.variable, self.array.count)
        X, axis = oriented(X, self.array.count, self.element_axis)
        if not X.shape[1]:
            raise ValueError(f"expected at least one {self.data_kind.removesuffix('s')}, got none: shape {X.shape}")
        both = X.shape[0] == X.shape[1] and self.data_kind != "covariance"
        other = f"; both are as long, and element_axis = {1 - axis} (--element-axis {1 - axis}) takes the other" * both
        notes = [f"axis {axis} of the data, {X.shape[0]} long, is that of the elements{other}"]
        reading, working = Reading(elements=self._element_names()), self.working
        if self.data_kind == "samples":
            Y, note, problem = self._transformed(X, rate_hz, frequency_hz)
            notes.append(note)
            reading = replace(reading, short_blocks=problem)
        elif not np.iscomplexobj(X) or (X.any() and not X.imag.any()):
            raise ValueError(without_phase(self.data_kind, rate_hz))
        elif self.data_kind == "covariance":
            Y, note = self._factored(X)
            notes.append(note)
        else:
            Y = X.astype(np.complex128)
            if both:
                refuse_covariance(Y)
                flipped = Y.T[working]
                reading = replace(reading, transposed=(flipped.conj() if self.conjugate else flipped, 1 - axis))
        if self.failed:
            names = ", ".join(map(str, self.failed))
            notes.append(f"{len(Y) - len(working)} of {len(Y)} elements are left out: {names}")
        Y = Y[working]
        if not Y.any():
            raise ValueError("expected data other than 0, got zeros only; check which array is read (variable)")
        return _Data(Y.conj() if self.conjugate else Y, tuple(notes), reading)

    def _element_names(self) -> tuple[str, ...]:
        """What the elements that are used are called in ``failed``."""
        names = self.array.element_names
        return tuple(names[m] if names else str(m) for m in self.working)

    def _transformed(
        self, x: Shaped[ndarray, "m n"], stated_hz: float | None, frequency_hz: float | None
    ) -> tuple[Complex[ndarray, "m t"], str, tuple[str, bool] | None]:
        """Return the snapshots at a frequency, a sentence about them, and what is wrong with the blocks."""
        rate = self.sample_rate_hz or stated_hz
        if frequency_hz is None:
            raise self._error("frequency_hz", "is required for samples over time, with speed_m_s: the frequency [Hz]")
        if rate is None:
            raise self._error("sample_rate_hz", "is required for samples over time: the sampling rate [Hz]")
        if stated_hz is not None and not math.isclose(rate, stated_hz, rel_tol=1e-6):
            raise self._error("sample_rate_hz", f"expected {stated_hz:g}, as in the file, got {rate:g}")
        Q, M, N = self.array.place(self.wavelength)[self.working], self.array.count, x.shape[1]
        delay = longest_delay(Q, self.wavelength * (self.frequency_hz or frequency_hz), rate)
        block = self.block or default_block(delay, N, self.overlap, M * self.segments)
        try:
            Y = spectral_snapshots(x, rate, frequency_hz, block, self.window, self.overlap)
        except ValueError as error:
            name, _, text = str(error).partition(": ")  # the option that is wrong
            if np.iscomplexobj(x):
                text = f"{text}; {COMPLEX}"
            if name == "frequency_hz" and frequency_hz != self.frequency_hz:
                name = "further_frequencies_hz"
            raise self._error(name, text) from error
        text = f"{Y.shape[1]} snapshots at {frequency_hz:g} Hz from blocks of {block} samples"
        text = f"{text}: bin {frequency_hz / rate * block:.4g} of {rate / block:g} Hz"
        return Y, f"{text}; {COMPLEX}" if np.iscomplexobj(x) else text, block_problem(block, delay, N)

    def _factored(self, R: Complex[ndarray, "m m"]) -> tuple[Complex[ndarray, "m t"], str]:
        """Return data with this covariance, and a sentence about the number of snapshots."""
        T = self.snapshots or self.array.count
        if T * self.array.count > MAX_NUMBERS:
            raise self._error("snapshots", f"expected at most {MAX_NUMBERS // self.array.count:,}, got {T:,}")
        how = "as given" if self.snapshots else "the number of elements, as snapshots is not given"
        return covariance_factor(R, T), f"standard errors assume a covariance of {T} snapshots, {how}"
