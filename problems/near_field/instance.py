"""One draw of a near-field scenario: the data, the true sources, and the scores of an estimate."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from itertools import permutations
from typing import final

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray
from scipy.optimize import linear_sum_assignment

from .array_instance import ArrayInstance
from .bands import Band, bounds_of_bands
from .bounds import position_bounds
from .calibration import true_bands
from .floor import floor_of_bands, local_fit, noise_free_columns
from .geometry import Frame, cartesian
from .parameters import parameter_bounds, parameter_scores
from .wavefronts import Amplitude, Manifold

__all__ = ["NearFieldInstance", "position_errors", "position_scores", "positions_of"]

ENUMERATED = 3  # up to this number of sources, trying all assignments of many estimates is faster than Kuhn's algorithm


@final
@dataclass(frozen=True, eq=False)
class NearFieldInstance(ArrayInstance):
    """The data received by an array, and the sources that sent them.

    The data are Y = Γ·C·H·S + N. What follows ``frame`` describes how the array differs from the nominal one;
    None or nothing stands for the nominal value. An estimator sees it only as far as its options say so.

    Y: received data, shape (M, T), with noise of unit variance.
    theta: true sources ``[azimuth, (elevation,) range]`` [rad, m], shape (K, d).
    manifold: array and wavefront model with which the data were generated, without impairments.
    lower: lower bounds of one source [rad, m], shape (d,).
    upper: upper bounds of one source [rad, m], shape (d,).
    H: channel of the whole block, shape (1, M, K), or of each snapshot, shape (T, M, K), including Γ and C.
    symbols: symbols sent by the sources, shape (K, T); symbols of source k have the power ``snr[k]``.
    snr: signal-to-noise power ratio per source at each antenna, shape (K,).
    rician_k: Rician factor κ; inf: pure line of sight.
    gospa_cutoff_m: cutoff distance c [m] of the score ``gospa_m``.
    frame: coordinates in which the array and the estimates are described.
    further: frequency bins of wideband data besides that of Y.
    gains: gains with phases of the elements, the diagonal of Γ, shape (M,).
    coupling: matrix C of mutual coupling, shape (M, M).
    noise_covariance: covariance of the noise, shape (M, M); None: the noise is white, of unit variance.
    failed: indices of elements that receive noise only; their rows of H are 0.
    element_positions: true positions of the elements relative to the nominal origin [m], shape (M, 3).
    amplitude: amplitude of the line of sight over the array, "constant" or "spherical".
    correlation: correlation matrix of the symbols, shape (K, K).
    original: the same scene as it was drawn, whose bounds are computed once for all copies; None if this is no copy.
    """

    Y: Complex[ndarray, "m t"]
    theta: Float[ndarray, "k d"]
    manifold: Manifold
    lower: Float[ndarray, " d"]
    upper: Float[ndarray, " d"]
    H: Complex[ndarray, "draws m k"]
    symbols: Complex[ndarray, "k t"]
    snr: Float[ndarray, " k"]
    rician_k: float
    gospa_cutoff_m: float = 1.0
    frame: Frame = Frame(np.eye(3), np.zeros(3))  # noqa: RUF009  # frozen
    gains: Complex[ndarray, " m"] | None = None
    coupling: Complex[ndarray, "m m"] | None = None
    noise_covariance: Complex[ndarray, "m m"] | None = None
    failed: tuple[int, ...] = ()
    element_positions: Float[ndarray, "m 3"] | None = None
    amplitude: Amplitude = "constant"
    correlation: Complex[ndarray, "k k"] | None = None
    further: tuple[Band, ...] = ()
    original: NearFieldInstance | None = field(default=None, init=False, repr=False)

    @property
    def bands(self) -> tuple[Band, ...]:
        """The data of all frequency bins, those of Y first; narrowband data have one."""
        return Band(self.Y, self.manifold, self.H, self.symbols), *self.further

    @property
    def sources(self) -> int:
        """The number K of sources."""
        return len(self.theta)

    def truth(self) -> Float[ndarray, "k d"]:
        return self.theta

    def score(self, estimate: Float[ndarray, "found d"]) -> dict[str, float]:
        """Return the Cartesian errors [m] of an estimate (K̂, d) [rad, m], and the bounds of the scene.

        Estimates are assigned to sources so that the sum of squared distances is minimal (Kuhn 1955). All scores except
        the bounds are NaN if the estimate is not finite. Raises ValueError if the estimate has the wrong shape.

        rmse_m: root mean square error of the min(K, K̂) assigned pairs; NaN if the estimate is empty.
        gospa_m: GOSPA metric with p = α = 2 (Rahmathullah, García-Fernández & Svensson 2017,
            doi:10.23919/ICIF.2017.8009645), which also penalizes a wrong number of estimates: each missed source and
            each surplus estimate adds c²/2 to its square.
        sources: true number K.
        sources_found: number K̂ of estimates.
        error_1_m, error_2_m, …: errors of the true sources in their order; NaN for a source without an estimate.

        The columns of ``parameter_scores`` are the errors in azimuth, elevation and range of the same pairs. The
        columns of ``bounds`` are included; they do not depend on the estimate.
        """
        return position_scores(self.theta, estimate, self.gospa_cutoff_m) | self.bounds()

    def errors(self, measure: str, estimates: Float[ndarray, "r found d"]) -> Float[ndarray, " r"]:
        errors = position_errors(self.theta, estimates) if measure == "rmse_m" else None
        return super().errors(measure, estimates) if errors is None else errors

    def positions(
        self, estimate: Float[ndarray, "q d"]
    ) -> tuple[Float[ndarray, "k columns"], Float[ndarray, "_ columns"]]:
        """Return the true positions, and the estimates assigned to them as in ``score`` before the others [m]."""
        return positions_of(self.theta, estimate, self.frame)

    def bounds(self) -> dict[str, float]:
        """Return reference values [m] for the errors of this scene, by column name.

        In pure line of sight these are the Cramér–Rao bounds of the positions, given the data of all frequency bins.
        They are inf if the sources cannot be distinguished. They do not take the box into account: if a bound is
        comparable with the size of the box, an estimate within the box can have a smaller error.

        crb_m: root mean square of the stochastic bounds over the sources.
        crb_deterministic_m: root mean square of the deterministic bounds, for the symbols that were sent.
        crb_1_m, crb_2_m, …: stochastic bounds of the individual sources.

        The columns of ``parameter_bounds`` are the stochastic bounds of the azimuths, elevations and ranges.

        Under Rician fading these bounds do not hold; the only column is then:

        floor_m: root mean square error of a least-squares fit to data without noise, started at the true sources. This
            is not a bound, but the error that remains even at infinite SNR.

        All bounds are those of an estimator that knows the impairments of the array: its gains and phases, coupling,
        true positions, failed elements, amplitudes and the covariance of the noise. The correlation of the sources is
        unknown. An estimator that does not know an impairment can only be worse, unless it is biased.

        With a planar wavefront, from which the range cannot be estimated, there are no columns.
        """
        return dict((self.original or self)._bounds)

    @cached_property
    def _bounds(self) -> dict[str, float]:
        if self.manifold.wavefront == "planar":
            return {}
        if math.isfinite(self.rician_k):
            if self.further:
                fitted = floor_of_bands(self.bands, self.theta, self.lower, self.upper)
            else:
                columns = noise_free_columns(self.H, self.symbols)
                fitted = local_fit(columns, self.manifold, self.theta, self.lower, self.upper)
            errors = np.linalg.norm(cartesian(fitted) - cartesian(self.theta), axis=1)
            return {"floor_m": _root_mean_square(errors)}
        bands = true_bands(self, self.amplitude)
        stochastic, deterministic = bounds_of_bands(bands, self.theta, self.snr, self.correlation)
        per_source = position_bounds(stochastic, self.theta)
        return {
            "crb_m": _root_mean_square(per_source),
            "crb_deterministic_m": _root_mean_square(position_bounds(deterministic, self.theta)),
            **{f"crb_{k}_m": float(bound) for k, bound in enumerate(per_source, start=1)},
            **parameter_bounds(stochastic, self.theta),
        }


def position_scores(
    truth: Float[ndarray, "k d"], estimate: Float[ndarray, "found d"], gospa_cutoff_m: float
) -> dict[str, float]:
    """Return the errors [m] of an estimate, the columns of ``NearFieldInstance.score`` except the bounds.

    truth: true sources [rad, m], shape (K, d).
    estimate: estimated sources [rad, m], shape (K̂, d). Raises ValueError if it has another shape.
    gospa_cutoff_m: cutoff distance c [m] of GOSPA.
    """
    estimate = np.asarray(estimate, dtype=np.float64)
    d = truth.shape[1]
    if estimate.ndim != 2 or estimate.shape[1] != d:
        raise ValueError(f"estimate: expected shape (K, {d}), one row per source, got {estimate.shape}")
    with np.errstate(over="ignore", invalid="ignore"):
        squares = np.sum((cartesian(truth)[:, None] - cartesian(estimate)) ** 2, axis=-1)
    K, found = squares.shape
    errors, assigned = np.full(K, math.nan), np.full_like(truth, math.nan)
    scores = dict.fromkeys(("rmse_m", "gospa_m", "sources", "sources_found"), math.nan)
    if np.isfinite(squares).all():  # also false if a squared distance overflows
        true, matched = linear_sum_assignment(squares)
        errors[true], assigned[true] = np.sqrt(squares[true, matched]), estimate[matched]
        rmse = math.sqrt(np.mean(squares[true, matched])) if found else math.nan
        scores = {
            "rmse_m": rmse,
            "gospa_m": _gospa(squares, gospa_cutoff_m),
            "sources": K,
            "sources_found": found,
        }
    scores |= {f"error_{k}_m": float(error) for k, error in enumerate(errors, start=1)}
    return scores | parameter_scores(truth, assigned)


def position_errors(
    truth: Float[ndarray, "k d"], estimates: Float[ndarray, "r found d"]
) -> Float[ndarray, " r"] | None:
    """Return the scores ``rmse_m`` of many estimates [rad, m]; None if they do not have the shape (r, K̂ >= 1, d)."""
    if estimates.ndim != 3 or estimates.shape[2] != truth.shape[1] or not estimates.shape[1]:
        return None
    with np.errstate(over="ignore", invalid="ignore"):
        differences = cartesian(truth)[:, None] - cartesian(estimates)[:, None]
        squares = np.sum(differences**2, axis=-1)  # (r, K, found)
    return np.sqrt(_assigned(squares) / min(squares.shape[1:]))


def positions_of(
    theta: Float[ndarray, "k d"], estimate: Float[ndarray, "q d"], frame: Frame
) -> tuple[Float[ndarray, "k columns"], Float[ndarray, "_ columns"]]:
    """Return the true positions, and the estimates assigned as in ``position_scores`` before the others [m].

    They are in the coordinates of the user. If these differ from those of this module, azimuth, elevation [rad] and
    range [m] follow.
    """
    truth, ordered = assigned_positions(theta, estimate)
    if not frame.origin.any() and np.array_equal(frame.axes, np.eye(3)):
        return truth, ordered
    return _outward(truth, frame), _outward(ordered, frame)


def assigned_positions(
    theta: Float[ndarray, "k d"], estimate: Float[ndarray, "q d"]
) -> tuple[Float[ndarray, "k 3"], Float[ndarray, "_ 3"]]:
    """Return the same in the coordinates of this module."""
    truth = cartesian(theta)
    found = cartesian(np.asarray(estimate, dtype=np.float64).reshape(-1, theta.shape[1]))
    source, guess = linear_sum_assignment(np.sum((truth[:, None] - found) ** 2, axis=-1))
    matched = np.full_like(truth, math.nan)
    matched[source] = found[guess]
    return truth, np.vstack([matched, np.delete(found, guess, axis=0)])


def _outward(p: Float[ndarray, "n 3"], frame: Frame) -> Float[ndarray, "n 6"]:
    """Return points of this module in the coordinates of the user, followed by azimuth, elevation and range."""
    across = np.hypot(p[:, 0], p[:, 1])
    angles = np.arctan2(p[:, 1], p[:, 0]), np.arctan2(p[:, 2], across)
    return np.column_stack([frame.outward(p), *angles, np.hypot(across, p[:, 2])])


def _assigned(squares: Float[ndarray, "r k found"]) -> Float[ndarray, " r"]:
    """Return the sum of the assigned squared distances [m²] for each of r estimates; NaN where one is not finite."""
    K, found = squares.shape[1:]
    finite = np.isfinite(squares).all(axis=(1, 2))
    if max(K, found) <= ENUMERATED:
        squares = squares.swapaxes(1, 2) if found < K else squares
        rows = range(min(K, found))
        with np.errstate(invalid="ignore"):
            sums = [squares[:, rows, list(p)].sum(axis=1) for p in permutations(range(max(K, found)), len(rows))]
        return np.where(finite, np.min(sums, axis=0), math.nan)
    sums = [
        each[linear_sum_assignment(each)].sum() if ok else math.nan for each, ok in zip(squares, finite, strict=True)
    ]
    return np.array(sums)


def _root_mean_square(lengths: Float[ndarray, " k"]) -> float:
    return math.sqrt(np.mean(lengths**2))


def _gospa(squares: Float[ndarray, "k found"], cutoff: float) -> float:
    """Return GOSPA with p = α = 2 from squared distances [m²].

    A pair that is farther apart than the cutoff costs as much as a missed source and a false estimate.
    """
    near = np.minimum(squares, cutoff**2)
    unmatched = abs(squares.shape[0] - squares.shape[1])
    return math.sqrt(near[linear_sum_assignment(near)].sum() + unmatched * cutoff**2 / 2)
