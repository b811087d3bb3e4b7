"""Alternating projection: fits one source at a time, with the others projected off, until nothing is gained."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nfbench import Formulation, Ge, Instance, Lt, Minimize, Reference

from ..array_instance import ArrayInstance
from ..calibration import calibrated
from ..enumeration import Criterion, Sources, how_many
from ..objectives import kernels_conditional
from ..objectives.factors import Objective, factors
from ..search import BandFit
from ..search import warm_up as warm_up_search
from ..wavefronts import Amplitude, Wavefront
from .certified import certified_first_source
from .relaxation import TOLERANCE, given, place, relax

__all__ = ["AlternatingProjection"]


@final
@dataclass(frozen=True)
class AlternatingProjection(Formulation):
    """Subspace fitting or maximum likelihood of all sources, minimized by searches for one source at a time.

    The objective is ‖(I − P_A)F‖² as a function of all sources. The start adds one source after another where it lowers
    the objective most, given those found before (orthogonal least squares; Chen, Billings & Luo 1989). The first search
    is that of NEMO with F in the place of the data. NEMO then subtracts what each detection explains on its own; here
    the detections are projected off together, so the gain of a further source is measured by the objective itself.
    After the start, each source in turn is found again with the others projected off, until a sweep over the sources
    gains nothing (alternating projection, Ziskind & Wax 1988, doi:10.1109/29.7543; RELAX, Li & Stoica 1996,
    doi:10.1109/78.485924). This removes the error floor of NEMO.

    Each search is one problem with as many unknowns as one source has, for any solver, with the whole budget: K
    problems for the start and K more in each sweep. A source keeps its position if a search finds nothing better, so
    the objective never rises. The result is a minimum in each source given the others, which need not be the global
    minimum over all of them. For several frequency bins the objective is the sum of theirs, as in ``neef``.

    objective: "wsf" is weighted subspace fitting, in which each signal eigenvector is weighted by (λ_i − σ̂²)/√λ_i
        (Viberg & Ottersten 1991); "esf" gives them equal weights, as NEEF does; "dml" is deterministic maximum
        likelihood, the least-squares fit to the data themselves, which also works with fewer snapshots than sources.
    sweeps: maximum number of sweeps after the start.
    tolerance: relative gain of the objective in a sweep at or below which the search ends.
    refine: whether to refine each position by a local search, both that of the solver and the previous one, before the
        better of the two is chosen; these evaluations do not count towards the budget.
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

    objective: Objective = "wsf"
    sweeps: Annotated[int, Ge(0)] = 10
    tolerance: Annotated[float, Ge(0.0), Lt(1.0)] = TOLERANCE
    refine: bool = True
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
        kernels_conditional.warm_up()
        if self.refine:
            warm_up_search()

    def estimates(self, instance: ArrayInstance, X: Float[ndarray, "r n"]) -> Float[ndarray, "r 1 d"] | None:
        """Return the estimates of a search for one source that is not refined; otherwise None."""
        single = how_many(instance, self.sources, self.criterion, self) == 1
        return X[:, None] if single and not self.refine else None

    def reference(self, instance: ArrayInstance) -> Reference | None:
        """Return the certified minimum of the first problem, the fit of one source, to a stated gap.

        None for several frequency bins, for which no proof is known.
        """
        K = how_many(instance, self.sources, self.criterion, self)
        if K == 0 or len(instance.bands) > 1:
            return None
        F, manifold = self._fits(instance, K)[0]
        return certified_first_source(F, manifold, instance.lower, instance.upper)

    def solve(self, instance: ArrayInstance, minimize: Minimize) -> Float[ndarray, "k d"]:
        """Return the sources (K, d) [rad, m] in the order in which the start finds them.

        Raises Incompatible if there are fewer snapshots than sources, unless the objective is "dml".
        """
        K = how_many(instance, self.sources, self.criterion, self)
        box = instance.lower, instance.upper
        theta = np.empty((0, instance.manifold.dimension))
        if K == 0:
            return theta
        fits = self._fits(instance, K)
        for _ in range(K):
            problem = given(fits, *box, theta)
            theta = np.vstack([theta, place(problem, minimize, refining=self.refine)[0]])
        return relax(fits, *box, theta, minimize, sweeps=self.sweeps, tolerance=self.tolerance, refining=self.refine)

    def _fits(self, instance: ArrayInstance, K: int) -> list[BandFit]:
        """Return what is fitted in each frequency bin."""
        bands = calibrated(instance, self)
        fitted = factors([band.Y for band in bands], K, self.objective)
        return [BandFit(F, band.manifold) for F, band in zip(fitted, bands, strict=True)]
