"""Sparse Bayesian learning: powers of all points of a polar grid, most of which vanish."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nfbench import Formulation, Ge, Gt, Incompatible, Instance, Le, Lt, Minimize

from ..array_instance import ArrayInstance, ArrayScenario
from ..bands import one_band
from ..calibration import calibrated
from ..enumeration import Criterion, Sources, how_many
from ..objectives.factors import factor
from ..search import polar_grid, polar_grid_size
from ..search import warm_up as warm_up_search
from ..wavefronts import Amplitude, Wavefront
from .evidence import Evidence, refine_evidence
from .music import SLOW_S
from .omp import Coherence

__all__ = ["SparseBayesian"]

MANY = 50_000  # grid points, whose responses are held in memory
UPDATE_S = 1e-9  # time of an update per grid point and squared element [s], on one core of a machine of 2020
FULL = 20  # about how many updates with all grid points are worth a whole run


@final
@dataclass(frozen=True)
class SparseBayesian(Formulation):
    """Sparse Bayesian learning on the polar grid, with off-grid refinement of its peaks.

    All points of the grid may send: the data are complex normal with the covariance Σ = σ²I + Σ_p γ_p·a_p·a_pᴴ, and the
    powers γ_p are those that make the data most probable. Starting from the beamformer's powers, each update is
    γ_p ← γ_p·(a_pᴴΣ⁻¹R̂Σ⁻¹a_p)/(a_pᴴΣ⁻¹a_p) (Gerstoft, Mecklenbräuker, Xenaki & Nannuru 2016,
    doi:10.1109/LSP.2016.2598550; for several snapshots Wipf & Rao 2007, IEEE Trans. Signal Process. 55(7)). Only the
    sample covariance R̂ and matrices of M×M appear. Most powers vanish on the way and are dropped. The noise σ² is what
    the K highest peaks leave of the data, per dimension. The number of snapshots may be smaller than that of sources.

    The K highest peaks of γ are the estimate. A peak is a point whose power is not lower than that of any neighbour,
    which is a point with at least the coherence c² for neighbours of coherence c. If there are fewer peaks, the highest
    remaining points complete the estimate.

    With ``refine``, the peaks leave the grid: with their powers and σ² alone, each source in turn is moved to the
    position, and given the power, that makes the data most probable given the others (Tipping & Faul 2003; Hansen,
    Badiu, Fleury & Rao 2014), until nothing is gained. This is a local maximum of the
    stochastic likelihood of uncorrelated sources. Coherent sources violate that assumption, and bias the result.

    coherence: coherence |aᴴb|/(‖a‖‖b‖) of the responses of neighbours on the grid, in angle and in inverse range.
    updates: maximum number of updates.
    tolerance: change of the powers in an update, relative to their sum, at or below which the updates end.
    prune: power relative to the greatest, below which a point is dropped.
    refine: whether to move the peaks off the grid, each in turn, by a local search of the evidence, the likelihood of
        the model with these peaks alone.
    wavefront: wavefront model that the estimator assumes, "exact", "fresnel", "paper" or "planar"; None: that of the
        scenario.
    sources: number of sources to search for: "known" is the true number, "estimate" is an estimate from the data by
        ``criterion``, and an integer is used as given, even if it is wrong.
    criterion: criterion by which the number of sources is estimated: "aic", "mdl" or "ne" (Nadakuditi & Edelman); used
        only if ``sources`` is "estimate".
    known_gains: whether the estimator knows the gains and phases of the elements.
    known_coupling: whether the estimator knows the mutual coupling of the elements.
    known_noise: whether the estimator knows the covariance of the noise, and whitens the data with it.
    known_failed: whether the estimator knows which elements have failed, and leaves them out.
    known_positions: whether the estimator knows the true positions of the elements.
    amplitude: amplitude over the array that the estimator assumes, "constant", or "spherical", which is r/‖p − q_m‖.
    """

    accepts: ClassVar[type[Instance]] = ArrayInstance  # type: ignore[type-abstract]  # any subclass
    needs_solver: ClassVar[bool] = False

    coherence: Coherence = 0.9
    updates: Annotated[int, Ge(1), Le(100_000)] = 500
    tolerance: Annotated[float, Ge(0.0), Lt(1.0)] = 1e-3
    prune: Annotated[float, Gt(0.0), Lt(1.0)] = 1e-3
    refine: bool = False
    wavefront: Wavefront | None = None
    sources: Sources = "known"
    criterion: Criterion = "ne"
    known_gains: bool = False
    known_coupling: bool = False
    known_noise: bool = False
    known_failed: bool = False
    known_positions: bool = False
    amplitude: Amplitude = "constant"

    def warm_up(self) -> None:
        if self.refine:
            warm_up_search()

    def warnings(self, scenario: ArrayScenario) -> list[str]:
        points, M = polar_grid_size(scenario.manifold(), *scenario.box(), self.coherence), scenario.array.count
        seconds = FULL * UPDATE_S * points * M**2
        if points > MANY or seconds <= SLOW_S:
            return []
        text = f"coherence: {self.coherence:g} gives a polar grid of about {points:,} points, which takes about"
        return [f"{text} {seconds:,.0f} s per run with {M} elements; reduce it"]

    def solve(self, instance: ArrayInstance, minimize: Minimize) -> Float[ndarray, "k d"]:
        """Return the sources (K, d) [rad, m], the most powerful first; fewer if fewer points have any power.

        Raises Incompatible if the grid would have more than 50,000 points, or if there are several frequency bins.
        """
        one_band(instance.bands, "sparse-bayesian", "whose powers are those of one wavelength")
        K = how_many(instance, self.sources, self.criterion, self)
        if K == 0:
            return np.empty((0, instance.manifold.dimension))
        (Y, manifold), box = calibrated(instance, self)[0].received, (instance.lower, instance.upper)
        L = factor(Y, K, "dml")  # R̂ = L·Lᴴ
        grid = polar_grid(manifold, *box, self.coherence)
        if len(grid) > MANY:
            raise Incompatible(
                f"the polar grid would have {len(grid):,} points, expected at most {MANY:,} for sparse-bayesian, which "
                "holds the responses of all of them; make the box smaller, or reduce coherence"
            )
        learned = Evidence(L, manifold.response(grid).T, K, self.coherence)
        for _ in range(self.updates):
            if learned.update(self.prune) <= self.tolerance:
                break
        theta = grid[learned.kept[learned.peaks]]
        if not self.refine:
            return theta
        return refine_evidence(L, manifold, *box, theta, learned.gamma[learned.peaks], learned.noise)
