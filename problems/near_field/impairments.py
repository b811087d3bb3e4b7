"""Impairments of a real array: how what it receives differs from the nominal model Y = A·S + N.

The data are Y = Γ·C·H·S + N with Γ = diag(g_m·e^{jγ_m}), 0 at failed elements, a matrix C of mutual coupling, and noise
of any covariance. The elements may lie beside their nominal positions, and the sources may be correlated.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Literal, TypeAlias, final

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray
from scipy.spatial.distance import cdist

from nfbench import FilePath, Ge, Le, Lt, OptionError, Options

from .geometry import flatness, nearest_distances
from .wavefronts import Amplitude, Manifold

__all__ = ["MAX_MATRIX", "Drawn", "Impairments", "mixing_matrix"]

MAX_MATRIX = 4096  # elements of an array with a matrix of coupling or of the noise
MAX_FILE_BYTES = 2**29
LARGEST_CONDITION = 1e10
FLAT = 0.02  # deviation from a line or plane [wavelengths, root mean square] that does not count as an extent
ROUNDING = 1e-10

_Angle: TypeAlias = Annotated[float, Ge(-360.0), Le(360.0)]
_Entry: TypeAlias = float | tuple[float, float]
_Problem: TypeAlias = tuple[str, str]  # path of an option, what is wrong with it


@final
@dataclass(frozen=True, eq=False)
class Drawn:
    """The impairments of one scene; None or nothing stands for the nominal value.

    positions: true element positions relative to the nominal origin [m], shape (M, 3).
    gains: diagonal of Γ without failures, shape (M,).
    failed: indices of the failed elements, in ascending order.
    coupling: matrix C, shape (M, M).
    noise_covariance: covariance of the noise, shape (M, M).
    amplitude: amplitude over the array.
    """

    positions: Float[ndarray, "m 3"] | None = None
    gains: Complex[ndarray, " m"] | None = None
    failed: tuple[int, ...] = ()
    coupling: Complex[ndarray, "m m"] | None = None
    noise_covariance: Complex[ndarray, "m m"] | None = None
    amplitude: Amplitude = "constant"

    def displace(self, manifold: Manifold) -> Manifold:
        """Return a manifold with the true element positions."""
        return manifold if self.positions is None else replace(manifold, positions=self.positions)

    def distort(self, H: Complex[ndarray, "draws m k"]) -> Complex[ndarray, "draws m k"]:
        """Return Γ·C·H."""
        if self.coupling is not None:
            H = self.coupling @ H
        if self.gains is not None:
            H = self.gains[:, None] * H
        if self.failed:
            H = np.array(H)
            H[:, list(self.failed)] = 0.0
        return H

    def colour(self, N: Complex[ndarray, "m t"]) -> Complex[ndarray, "m t"]:
        """Return L·N with the covariance L·Lᴴ of the noise, from white noise N."""
        if self.noise_covariance is None:
            return N
        L: ndarray = np.linalg.cholesky(self.noise_covariance)
        return L @ N


@final
@dataclass(frozen=True)
class Impairments(Options):
    """What distinguishes a real array from its model; by default nothing does.

    Random impairments are drawn once per scene. Their random numbers do not depend on their size: a sweep over the size
    scales one and the same error.

    gain_error_db: standard deviation of the gain of each element [dB]; g_m = 10^(ε_m/20) with normally distributed ε_m.
    phase_error_deg: standard deviation of the phase γ_m of each element [°]; normally distributed.
    position_error_wavelengths: standard deviation of the position of each element along each axis [wavelengths];
        normally distributed.
    position_error_axes: axes along which elements are displaced: "all" three, or only those of the "array", along which
        it extends.
    failed_elements: number of elements that receive noise only, drawn at random, or a list of the indices of these
        elements, counted from 0 as the rows of the data are.
    amplitude: amplitude of the line of sight over the array: "constant", or "spherical", which is r/‖p − q_m‖ at an
        element at q_m, so that the stated SNR holds at the origin.
    coupling_db: mutual coupling c of the closest elements [dB]; elements at a distance of n times theirs are coupled by
        (c·e^{jχ})ⁿ. None: no coupling, or that of ``coupling_file``.
    coupling_phase_deg: phase χ of the coupling of the closest elements [°].
    coupling_reach: largest distance at which elements are coupled, in distances of the closest elements; None: all are.
    coupling_file: path of a .npy file with the matrix C of mutual coupling, shape (M, M), 1 on its diagonal or whatever
        was measured; None: ``coupling_db`` is used.
    coupling_digest: fingerprint of the contents of ``coupling_file``, filled in when it is read; leave it out. A run
        with another fingerprint is another run.
    noise_level_db: noise of the elements relative to the nominal one [dB]: the standard deviation of normally
        distributed levels, or a list of the levels, one per element.
    noise_correlation_wavelengths: distance L [wavelengths] over which the correlation of the noise falls to 1/e; the
        noise of elements at a distance d has the correlation exp(−d/L). 0: no correlation.
    noise_covariance_file: path of a .npy file with the covariance of the noise, shape (M, M), Hermitian and positive
        definite; it is scaled so that the mean of its diagonal is 1. None: the options above are used.
    noise_covariance_digest: fingerprint of the contents of ``noise_covariance_file``, filled in when it is read; leave
        it out.
    source_correlation: correlation ρ of the symbols of any two sources, from −1/(K − 1) to 1, or the K × K correlation
        matrix as a list of rows, each entry a number or a pair [real, imaginary]. With ρ = 1 all sources are coherent.
    source_correlation_phase_deg: phase χ of the correlation [°]; the correlation of sources k and l is ρ·e^{j(k−l)χ}.
    """

    gain_error_db: Annotated[float, Ge(0.0), Le(60.0)] = 0.0
    phase_error_deg: Annotated[float, Ge(0.0), Le(3600.0)] = 0.0
    position_error_wavelengths: Annotated[float, Ge(0.0), Le(1e3)] = 0.0
    position_error_axes: Literal["all", "array"] = "all"
    failed_elements: Annotated[int, Ge(0)] | tuple[Annotated[int, Ge(0)], ...] = 0
    amplitude: Amplitude = "constant"
    coupling_db: Annotated[float, Ge(-300.0), Lt(0.0)] | None = None
    coupling_phase_deg: _Angle = 0.0
    coupling_reach: Annotated[float, Ge(1.0), Le(1e6)] | None = None
    coupling_file: FilePath | None = None
    coupling_digest: str | None = None
    noise_level_db: Annotated[float, Ge(0.0), Le(60.0)] | tuple[Annotated[float, Ge(-100.0), Le(100.0)], ...] = 0.0
    noise_correlation_wavelengths: Annotated[float, Ge(0.0), Le(1e3)] = 0.0
    noise_covariance_file: FilePath | None = None
    noise_covariance_digest: str | None = None
    source_correlation: Annotated[float, Ge(-1.0), Le(1.0)] | tuple[tuple[_Entry, ...], ...] = 0.0
    source_correlation_phase_deg: _Angle = 0.0

    def validate(self) -> None:
        problems = []
        if self.coupling_db is not None and self.coupling_file is not None:
            problems.append(("coupling_file", "expected either coupling_db or coupling_file, got both"))
        if self.noise_covariance_file is not None and (self.noise_level_db or self.noise_correlation_wavelengths):
            text = "expected no noise_level_db and no noise_correlation_wavelengths besides a file, got one"
            problems.append(("noise_covariance_file", text))
        if isinstance(self.failed_elements, tuple) and len(set(self.failed_elements)) < len(self.failed_elements):
            problems.append(("failed_elements", f"expected distinct indices, got {list(self.failed_elements)}"))
        for name in ("coupling", "noise_covariance"):
            path = getattr(self, f"{name}_file")
            if path is None:
                continue
            try:
                digest = _digest(Path(path))
            except OSError as error:
                problems.append((f"{name}_file", f"expected a .npy file, but reading it failed: {error}"))
                continue
            if getattr(self, f"{name}_digest") not in (None, digest):
                problems.append((f"{name}_file", "the file has changed since the study was started; run it again"))
            object.__setattr__(self, f"{name}_digest", digest)
        if problems:
            raise OptionError(type(self).__name__, problems)

    @property
    def is_nominal(self) -> bool:
        """Whether nothing differs from the nominal model."""
        return self == Impairments()

    def problems(self, elements: int, sources: int, wavefront: str) -> list[_Problem]:
        """Return what contradicts an array or its sources, as (path, message) pairs."""
        found = [*self._failure_problems(elements), *self._matrix_problems(elements)]
        if self.amplitude == "spherical" and wavefront == "planar":
            found.append(("amplitude", 'expected "constant" for a planar wavefront, got "spherical"'))
        if isinstance(self.noise_level_db, tuple) and len(self.noise_level_db) != elements:
            text = f"expected one number, or {elements} (one per element), got {len(self.noise_level_db)}"
            found.append(("noise_level_db", text))
        try:
            mixing_matrix(self.correlation(sources))
        except ValueError as error:
            found.append(("source_correlation", str(error)))
        return found

    def _failure_problems(self, elements: int) -> Iterator[_Problem]:
        if isinstance(self.failed_elements, int):
            if self.failed_elements > elements - 2:
                yield (
                    "failed_elements",
                    f"expected at most {elements - 2} of {elements}, got {self.failed_elements}",
                )
            return
        outside = [index for index in self.failed_elements if index >= elements]
        if outside:
            yield "failed_elements", f"expected indices from 0 to {elements - 1}, got {outside[0]}"
        elif len(self.failed_elements) > elements - 2:
            yield "failed_elements", f"expected at most {elements - 2} indices, got {len(self.failed_elements)}"

    def _matrix_problems(self, elements: int) -> Iterator[_Problem]:
        coupled = self.coupling_db is not None or self.coupling_file is not None
        coloured = bool(self.noise_level_db or self.noise_correlation_wavelengths or self.noise_covariance_file)
        if (coupled or coloured) and elements > MAX_MATRIX:
            name = "coupling_db" if coupled else "noise_correlation_wavelengths"
            yield name, f"expected at most {MAX_MATRIX:,} elements for a matrix of them, got {elements:,}"
            return
        for name in ("coupling", "noise_covariance"):
            if (path := getattr(self, f"{name}_file")) is None:
                continue
            try:
                _check_matrix(_matrix(path, getattr(self, f"{name}_digest")), elements, name)
            except (ValueError, OSError, EOFError, TypeError) as error:
                yield f"{name}_file", f"{Path(path).name}: {error}"

    def warnings(self) -> list[str]:
        """Return sentences about options that are valid but probably not what was meant."""
        found = []
        if 0 < self.phase_error_deg < 0.1:
            text = f"impairments.phase_error_deg: {self.phase_error_deg:g}° is unusually small; is it in radians?"
            found.append(f"{text} {self.phase_error_deg:g} rad are {math.degrees(self.phase_error_deg):.3g}°")
        if self.position_error_wavelengths > 1:
            text = f"impairments.position_error_wavelengths: {self.position_error_wavelengths:g} wavelengths"
            found.append(f"{text} leave no phase known; is it in millimetres?")
        return found

    def correlation(self, sources: int) -> Complex[ndarray, "k k"]:
        """Return the correlation matrix of the sources; raises ValueError if it has another size."""
        given = self.source_correlation
        if not isinstance(given, tuple):
            P = np.full((sources, sources), given, dtype=np.complex128)
            np.fill_diagonal(P, 1.0)
        else:
            if len(given) != sources or any(len(row) != sources for row in given):
                size = f"{len(given)} rows of {', '.join(str(n) for n in sorted({len(row) for row in given})[:5])}"
                raise ValueError(f"expected one number, or {sources} rows of {sources} entries, got {size}")
            P = np.array([[complex(*e) if isinstance(e, tuple) else complex(e) for e in row] for row in given])
        turn = np.exp(1j * math.radians(self.source_correlation_phase_deg) * np.arange(sources))
        return turn[:, None] * P * turn.conj()

    def draw(self, rng: np.random.Generator, manifold: Manifold) -> Drawn:
        """Draw the impairments of one scene, each from its own child of ``rng``; M elements are the first of M + 1."""
        for_gains, for_phases, for_positions, for_failures, for_levels = rng.spawn(5)
        M = len(manifold.positions)
        gains = None
        if self.gain_error_db or self.phase_error_deg:
            gains = 10 ** (self.gain_error_db / 20 * for_gains.standard_normal(M)) * np.exp(
                1j * math.radians(self.phase_error_deg) * for_phases.standard_normal(M)
            )
        if isinstance(self.failed_elements, int):
            failed = for_failures.permutation(M)[: self.failed_elements]
        else:
            failed = np.array(self.failed_elements, dtype=int)
        return Drawn(
            self._displaced(for_positions, manifold),
            gains,
            tuple(sorted(int(m) for m in failed)),
            self._coupling(manifold),
            self._noise(for_levels, manifold),
            self.amplitude,
        )

    def _displaced(self, rng: np.random.Generator, manifold: Manifold) -> Float[ndarray, "m 3"] | None:
        if not self.position_error_wavelengths:
            return None
        Q = manifold.positions
        shift = self.position_error_wavelengths * manifold.wavelength_m * rng.standard_normal(Q.shape)
        if self.position_error_axes == "array":
            rank, axes = flatness(Q, FLAT * manifold.wavelength_m)
            shift = shift @ axes[:rank].T @ axes[:rank]
        return Q + shift

    def _coupling(self, manifold: Manifold) -> Complex[ndarray, "m m"] | None:
        if self.coupling_file is not None:
            return _matrix(self.coupling_file, self.coupling_digest)
        if self.coupling_db is None:
            return None
        Q = manifold.positions
        steps = cdist(Q, Q) / nearest_distances(Q).min()
        c = self.coupling_db / 20 * math.log(10) + 1j * math.radians(self.coupling_phase_deg)
        C = np.exp(c * steps)
        if self.coupling_reach is not None:
            C[steps > self.coupling_reach * (1 + 1e-9)] = 0.0
        return C

    def _noise(self, rng: np.random.Generator, manifold: Manifold) -> Complex[ndarray, "m m"] | None:
        """Return the covariance D·R·D of levels D and correlations R, or that of the file."""
        if self.noise_covariance_file is not None:
            R = _matrix(self.noise_covariance_file, self.noise_covariance_digest)
            return R / np.mean(np.diag(R).real)
        if not (self.noise_level_db or self.noise_correlation_wavelengths):
            return None
        Q, length = manifold.positions, self.noise_correlation_wavelengths * manifold.wavelength_m
        correlation = np.exp(-cdist(Q, Q) / length) if length > 0 else np.eye(len(Q))
        random = not isinstance(self.noise_level_db, tuple)
        levels = np.array(self.noise_level_db) * (rng.standard_normal(len(Q)) if random else 1.0)
        D = 10 ** (levels / 20)
        return (D[:, None] * correlation * D).astype(np.complex128)


def mixing_matrix(P: Complex[ndarray, "k k"]) -> Complex[ndarray, "k k"] | None:
    """Return the lower triangular L with L·Lᴴ = P, which correlates uncorrelated symbols; None if P = I.

    The symbols of the first sources do not depend on the others. Raises ValueError unless P is Hermitian and positive
    semidefinite with ones on its diagonal; it may be singular.
    """
    if not np.isfinite(P).all() or not np.allclose(P, P.conj().T, rtol=0, atol=1e-9):
        raise ValueError("expected a Hermitian matrix, got one that differs from its conjugate transpose")
    if not np.allclose(np.diag(P), 1.0, rtol=0, atol=1e-9):
        raise ValueError(f"expected ones on the diagonal, got {np.diag(P).real.round(6).tolist()}")
    if (np.eye(len(P)) == P).all():
        return None
    least = float(np.linalg.eigvalsh(P)[0])
    if least < -1e-8:
        raise ValueError(f"expected a positive semidefinite matrix, got one with the eigenvalue {least:.4g}")
    L = np.zeros_like(P)
    for k in range(len(P)):
        column = P[k:, k] - L[k:, :k] @ L[k, :k].conj()
        if column[0].real > ROUNDING:
            L[k:, k] = column / math.sqrt(column[0].real)
    return L


def _digest(path: Path) -> str:
    """Return a fingerprint of a file's contents; raises OSError if it is no file or far too large."""
    if not path.is_file():
        raise OSError("it is not a file")
    if path.stat().st_size > MAX_FILE_BYTES:
        raise OSError(f"it has more than {MAX_FILE_BYTES:,} bytes")
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]


@lru_cache(maxsize=8)
def _matrix(path: str, digest: str | None) -> Complex[ndarray, "m m"]:
    """Read a matrix; the digest only tells the contents of the same file apart."""
    mapped = np.load(path, mmap_mode="r", allow_pickle=False)  # a header may promise more numbers than there are
    if not isinstance(mapped, ndarray) or mapped.dtype.kind not in "iufc":
        raise ValueError(f"expected numbers, got {getattr(mapped, 'dtype', 'several arrays')}")
    if mapped.ndim != 2 or max(mapped.shape) > MAX_MATRIX:
        raise ValueError(f"expected a matrix of at most {MAX_MATRIX:,} rows, got shape {mapped.shape}")
    matrix = np.array(mapped, dtype=np.complex128)
    matrix.flags.writeable = False
    return matrix


def _check_matrix(matrix: Complex[ndarray, "m m"], elements: int, name: str) -> None:
    """Raise ValueError unless a matrix of coupling can be inverted, or one of noise is a covariance."""
    if matrix.shape != (elements, elements):
        raise ValueError(f"expected shape ({elements}, {elements}), one row per element, got {matrix.shape}")
    if not np.isfinite(matrix).all():
        raise ValueError("expected finite numbers, got NaN or infinite ones")
    if name == "coupling":
        condition = float(np.linalg.cond(matrix))
        if not condition < LARGEST_CONDITION:
            raise ValueError(f"expected a matrix that can be inverted, got one with condition number {condition:.3g}")
        return
    size = float(np.abs(matrix).max())
    if not np.allclose(matrix, matrix.conj().T, rtol=0, atol=1e-9 * size):
        raise ValueError("expected a Hermitian matrix, got one that differs from its conjugate transpose")
    values = np.linalg.eigvalsh(matrix)
    if not values[0] > values[-1] / LARGEST_CONDITION:
        text = f"eigenvalues from {values[0]:.3g} to {values[-1]:.3g}"
        raise ValueError(f"expected a positive definite matrix, got {text}")
