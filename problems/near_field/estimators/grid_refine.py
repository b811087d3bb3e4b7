"""Grid and refinement: a greedy search on a coarse grid, followed by a local search over all sources."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar, NamedTuple, final

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

from nfbench import Formulation, Ge, Gt, Instance, Le, Minimize, Solution

from ..array_instance import ArrayInstance, ArrayScenario
from ..bands import Band
from ..calibration import calibrated
from ..enumeration import Criterion, Sources, how_many
from ..objectives.factors import Objective, factor, noise_weights
from ..objectives.subspace_fitting import SubspaceFit
from ..search import (
    BandFit,
    covariance_of_bands,
    error_columns,
    grid_size,
    response_grid,
    search_bands_greedily,
    search_greedily,
    standard_errors,
)
from ..search import warm_up as warm_up_search
from ..subspace import decompose
from ..wavefronts import Amplitude, Wavefront
from .music import SLOW_S, search_s

__all__ = ["Fitted", "GridRefine", "errors_of", "fitted"]

MANY = 2 * 10**7  # grid points that may not fit in memory


@final
@dataclass(frozen=True)
class GridRefine(Formulation):
    """Subspace fitting by a grid search and local refinement: a baseline for global optimizers.

    Sources are chosen one by one from a grid whose spacing matches the resolution of the array. Each is placed where it
    reduces the misfit J most, given the sources chosen before (orthogonal least squares; Chen, Billings & Luo 1989).
    All sources are then refined together by Levenberg–Marquardt on the variable projection. After that, as in
    alternating projection (Ziskind & Wax 1988), each source in turn is chosen again given the others and all are
    refined again, until a sweep over the sources brings no improvement.

    For several frequency bins the misfit is the sum of theirs, weighted as in ``neef``.

    The standard errors of the estimates are stored in the columns std_1_m, std_2_m, … and std_m. They come from the
    curvature of J at the minimum, and assume pure line of sight and white noise.

    density: number of grid points per beamwidth in each angle, and per depth of focus in inverse range.
    sweeps: maximum number of sweeps, in each of which every source is chosen again once.
    wavefront: wavefront model that the estimator assumes, "exact", "fresnel", "paper" or "planar"; None: that of the
        scenario.
    sources: number of sources to search for: "known" is the true number, "estimate" is an estimate from the data by
        ``criterion``, and an integer is used as given, even if it is wrong.
    criterion: criterion by which the number of sources is estimated: "aic", "mdl" or "ne" (Nadakuditi & Edelman); used
        only if ``sources`` is "estimate".
    objective: misfit that is minimized: "esf" gives all eigenvectors of the signal subspace the same weight, "wsf" the
        weights that attain the stochastic bound (Viberg & Ottersten 1991), and "dml" is deterministic maximum
        likelihood, which also works with fewer snapshots than sources.
    known_gains: whether the estimator knows the gains and phases of the elements.
    known_coupling: whether the estimator knows the mutual coupling of the elements.
    known_noise: whether the estimator knows the covariance of the noise, and whitens the data with it.
    known_failed: whether the estimator knows which elements have failed, and leaves them out.
    known_positions: whether the estimator knows the true positions of the elements.
    amplitude: amplitude over the array that the estimator assumes, "constant", or "spherical", which is r/‖p − q_m‖.
    """

    accepts: ClassVar[type[Instance]] = ArrayInstance  # type: ignore[type-abstract]  # any subclass
    needs_solver: ClassVar[bool] = False

    density: Annotated[float, Gt(0.0), Le(100.0)] = 1.5
    sweeps: Annotated[int, Ge(0)] = 5
    wavefront: Wavefront | None = None
    sources: Sources = "known"
    criterion: Criterion = "ne"
    objective: Objective = "esf"
    known_gains: bool = False
    known_coupling: bool = False
    known_noise: bool = False
    known_failed: bool = False
    known_positions: bool = False
    amplitude: Amplitude = "constant"

    def warm_up(self) -> None:
        warm_up_search()

    def warnings(self, scenario: ArrayScenario) -> list[str]:
        counts = grid_size(scenario.manifold(), *scenario.box(), self.density)
        M, K, points = scenario.array.count, scenario.sources, math.prod(counts)
        passes = K + min(self.sweeps, 2)  # over the grid: one per source, and one per sweep
        seconds = search_s(points, M, 2) * passes * scenario.bins
        size = f"{' × '.join(map(str, counts))} points"
        if points > MANY:
            return [f"density: {self.density:g} gives a grid of about {size}, which may not fit in memory; reduce it"]
        if seconds <= SLOW_S or self.density != type(self).density:
            return []
        text = f"density: the default, {self.density:g}, gives a grid of about {size}"
        return [f"{text}, which takes about {seconds:,.0f} s per run with {M} elements and {K} sources; reduce it"]

    def solve(self, instance: ArrayInstance, minimize: Minimize) -> Solution:
        """Return the sources (K, d) [rad, m] with the columns of ``standard_errors``.

        Raises Incompatible if there are fewer snapshots than sources, except with the objective "dml".
        """
        K = how_many(instance, self.sources, self.criterion, self)
        if K == 0:
            return Solution(np.empty((0, instance.manifold.dimension)))
        bands = calibrated(instance, self)
        if len(bands) > 1:
            return self._solve_bands(bands, instance, K)
        Y, manifold = bands[0].Y, bands[0].manifold
        grid = response_grid(manifold, instance.lower, instance.upper, self.density)
        T = Y.shape[1]
        F, spread, noise = _factors(Y, K, self.objective)
        found = search_greedily(F, grid, K, self.sweeps)
        if noise is None:
            noise = found.value / max(len(F) - K, 1)
        theta, box = found.x.reshape(K, -1), (grid.lower, grid.upper)
        return Solution(theta, standard_errors(theta, grid.manifold, *box, F, noise, T, spread))

    def _solve_bands(self, bands: list[Band], instance: ArrayInstance, K: int) -> Solution:
        """Return the minimizer of the sum of the misfits of several frequency bins."""
        found = fitted(bands, K, self.objective)
        box = instance.lower, instance.upper
        theta = search_bands_greedily(found.fits, *box, K, self.density, self.sweeps).x.reshape(K, -1)
        return Solution(theta, errors_of(found, bands, theta, *box))


class Fitted(NamedTuple):
    """What is fitted in each frequency bin: its weight, F of the misfit, the factor G of its covariance, and σ̂²."""

    weights: list[float]
    fits: list[BandFit]
    spreads: list[ndarray]
    noise: list[float | None]


def fitted(bands: Sequence[Band], K: int, objective: Objective) -> Fitted:
    """Return what is fitted in each frequency bin; the weight of a single bin is 1."""
    found = [_factors(band.Y, K, objective) for band in bands]
    equal = objective == "esf" or len(bands) == 1
    weights = [1.0] * len(bands) if equal else noise_weights([band.Y for band in bands], K)
    each = list(zip(weights, found, bands, strict=True))
    return Fitted(
        weights,
        [BandFit(math.sqrt(weight) * F, band.manifold) for weight, (F, _, _), band in each],
        [weight * (F if G is None else G) for weight, (F, G, _), _ in each],
        [sigma for _, _, sigma in found],
    )


def errors_of(
    found: Fitted,
    bands: Sequence[Band],
    theta: Float[ndarray, "k d"],
    lower: Float[ndarray, " d"],
    upper: Float[ndarray, " d"],
) -> dict[str, float]:
    """Return the ``error_columns`` of sources at a minimum of the sum of the misfits; σ̂² is J/(M − K) if not given."""
    K = len(theta)
    noise = [
        SubspaceFit(*fit, lower, upper, sources=K).value(theta.ravel()) / weight / max(len(fit.F) - K, 1)
        if sigma is None
        else sigma
        for weight, fit, sigma in zip(found.weights, found.fits, found.noise, strict=True)
    ]
    variances = [sigma / (2 * band.Y.shape[1]) for sigma, band in zip(noise, bands, strict=True)]
    C = covariance_of_bands(theta, found.fits, lower, upper, variances, found.spreads)
    return error_columns(C, theta, lower, upper)


def _factors(
    Y: Complex[ndarray, "m t"], K: int, objective: Objective
) -> tuple[Complex[ndarray, "m c"], Complex[ndarray, "m c"] | None, float | None]:
    """Return F of J = ‖(I − P_A)F‖², the factor G of its ``covariance``, and σ̂², which is J/(M − K) where it is None.

    With the eigenvalues λ_i of R̂, F is U_s for ESF and U_s·diag((λ_i − σ̂²)/√λ_i) for WSF, where a weight is 0 if
    λ_i <= σ̂². For DML, FFᴴ = R̂.
    """
    if objective == "dml":
        return factor(Y, K, objective), None, None
    U_s, eigenvalues, noise = decompose(Y, K)
    deviation, excess = np.sqrt(eigenvalues), eigenvalues - noise
    if objective == "wsf":
        return U_s * np.divide(excess, deviation, out=np.zeros(K), where=excess > 0), None, noise
    return U_s, U_s * np.divide(deviation, excess, out=np.full(K, math.nan), where=excess > 0), noise
