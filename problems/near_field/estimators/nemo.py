"""NEMO: detects the sources one after another, each in the residual of those detected before."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar, final

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

from nfbench import Formulation, Ge, Instance, Lt, Minimize, Reference

from ..array_instance import ArrayInstance
from ..calibration import calibrated
from ..enumeration import Criterion, Sources, how_many
from ..objectives import kernels_conditional
from ..objectives.rls import RLS, deflate
from ..objectives.sum_of_fits import SumOfFits, together
from ..search import BandFit
from ..search import warm_up as warm_up_search
from ..subspace import compress
from ..wavefronts import Amplitude, Manifold, Wavefront
from .certified import certified_first_source
from .refinement import refine
from .relaxation import relax

__all__ = ["Nemo"]


@final
@dataclass(frozen=True)
class Nemo(Formulation):
    """Near-field multimodal localization: minimizes RLS and deflates, K times (Mousavirad et al., Algorithm 1).

    For several frequency bins, RLS is summed over them, all with the same weight, and each bin is deflated.

    alpha: weight of the repulsion from the sources detected before, in the unit of the objective ‖Y‖² per unit of
        distance (1 rad and 1 m count the same).
    alpha_relative: weight of the repulsion in units of ‖Y‖²/M of the current residual; it replaces ``alpha``. None:
        ``alpha`` is used.
    delta_min: distance up to which the repulsion acts, where 1 rad and 1 m count the same.
    wavefront: wavefront model that the estimator assumes, "exact", "fresnel", "paper" or "planar"; None: that of the
        scenario.
    sources: number of sources to search for: "known" is the true number, "estimate" is an estimate from the data by
        ``criterion``, and an integer is used as given, even if it is wrong.
    criterion: criterion by which the number of sources is estimated: "aic", "mdl" or "ne" (Nadakuditi & Edelman); used
        only if ``sources`` is "estimate".
    stop_below: minimum quality of a detection; the search ends, and the detection is discarded, when its quality is
        lower. The quality is the energy that the detection explains divided by the mean energy of the residual per
        dimension, of which M − k remain after k detections. It is about 1 for noise at an arbitrary position, and
        hardly exceeds (1 + √(M/T))² for noise at the best position, because the eigenvalues of noise end there
        (Marchenko & Pastur 1967). None: every detection is accepted.
    refine: whether to refine each of the solver's minimizers by a local search before deflation; its evaluations do not
        count towards the budget.
    relax: maximum number of sweeps of relaxation after the last detection; 0: none, as in the paper. In a sweep each
        source in turn is found again with all others projected off, as in ``alternating-projection`` with the objective
        "dml"; each of these problems has the whole budget. The repulsion does not act, and a source keeps its position
        if the solver finds nothing better. Relaxation ends early when a sweep lowers the misfit of all sources together
        by no more than 1e-9 of it. With ``refine``, each position is refined. A single source is not relaxed.
    known_gains: whether the estimator knows the gains and phases of the elements.
    known_coupling: whether the estimator knows the mutual coupling of the elements.
    known_noise: whether the estimator knows the covariance of the noise, and whitens the data with it.
    known_failed: whether the estimator knows which elements have failed, and leaves them out.
    known_positions: whether the estimator knows the true positions of the elements.
    amplitude: amplitude over the array that the estimator assumes, "constant", or "spherical", which is r/‖p − q_m‖.
    """

    accepts: ClassVar[type[Instance]] = ArrayInstance  # type: ignore[type-abstract]  # any subclass

    alpha: Annotated[float, Ge(0.0), Lt(math.inf)] = 1000.0
    alpha_relative: Annotated[float, Ge(0.0), Lt(math.inf)] | None = None
    delta_min: Annotated[float, Ge(0.0), Lt(math.inf)] = 0.08
    wavefront: Wavefront | None = None
    sources: Sources = "known"
    criterion: Criterion = "ne"
    stop_below: Annotated[float, Ge(0.0), Lt(math.inf)] | None = None
    refine: bool = False
    relax: Annotated[int, Ge(0)] = 0
    known_gains: bool = False
    known_coupling: bool = False
    known_noise: bool = False
    known_failed: bool = False
    known_positions: bool = False
    amplitude: Amplitude = "constant"

    def estimates(self, instance: ArrayInstance, X: Float[ndarray, "r n"]) -> Float[ndarray, "r 1 d"] | None:
        """Return the estimates of a search for one source; with more sources, or if it may be discarded, None."""
        single = how_many(instance, self.sources, self.criterion, self) == 1
        return None if self.refine or self.stop_below is not None or not single else X[:, None]

    def warm_up(self) -> None:
        if self.refine:
            warm_up_search()
        if self.relax:
            kernels_conditional.warm_up()

    def reference(self, instance: ArrayInstance) -> Reference | None:
        """Return the certified minimum of the first problem, RLS of one source, to a stated gap.

        None for several frequency bins, for which no proof is known.
        """
        if len(instance.bands) > 1 or how_many(instance, self.sources, self.criterion, self) == 0:
            return None
        Y, manifold = calibrated(instance, self)[0].received
        return certified_first_source(compress(Y), manifold, instance.lower, instance.upper)

    def solve(self, instance: ArrayInstance, minimize: Minimize) -> Float[ndarray, "k d"]:
        """Return the sources (K, d) [rad, m] in the order of their detection."""
        bands = calibrated(instance, self)
        manifolds = [band.manifold for band in bands]
        data = Y = [compress(band.Y) for band in bands]
        detected = np.empty((0, instance.manifold.dimension))  # S_det ← ∅
        for _ in range(how_many(instance, self.sources, self.criterion, self)):  # while k ≤ K
            residual = self._residual(instance, Y, manifolds, detected)
            theta = minimize(residual).x  # θ̂_k
            if self.refine:
                theta = refine(residual, theta, manifolds[0])
            # Y − a(θ̂_k)·ŝ_kᵀ
            deflated = [deflate(L, manifold.response(theta)) for L, manifold in zip(Y, manifolds, strict=True)]
            if self.stop_below is not None and _quality(Y, deflated, len(detected)) < self.stop_below:
                break
            Y = deflated
            detected = np.vstack([detected, theta])  # S_det ← S_det ∪ {θ̂_k}
        box = instance.lower, instance.upper
        fits = [BandFit(L, manifold) for L, manifold in zip(data, manifolds, strict=True)]
        return relax(fits, *box, detected, minimize, sweeps=self.relax, refining=self.refine)

    def _residual(
        self,
        instance: ArrayInstance,
        Y: list[Complex[ndarray, "m c"]],
        manifolds: list[Manifold],
        detected: Float[ndarray, "k d"],
    ) -> RLS | SumOfFits:
        """Return RLS of one more source, summed over the frequency bins; the first has the repulsion of all of them."""
        alpha, relative = self.alpha, self.alpha_relative
        if len(Y) > 1 and relative is not None:
            alpha, relative = relative * sum(float(np.vdot(L, L).real) for L in Y) / len(Y[0]), None
        box = instance.lower, instance.upper
        first = RLS(
            Y[0],
            manifolds[0],
            *box,
            detected=detected,
            alpha=alpha,
            delta_min=self.delta_min,
            alpha_relative=relative,
        )
        return together([first, *(RLS(L, manifold, *box) for L, manifold in zip(Y[1:], manifolds[1:], strict=True))])


def _quality(Y: list[Complex[ndarray, "m c"]], deflated: list[Complex[ndarray, "m c"]], found: int) -> float:
    """Return the explained energy ‖Y‖² − ‖deflated‖² divided by the mean of ‖Y‖² over its M − ``found`` dimensions."""
    before, after = (sum(float(np.linalg.norm(L)) ** 2 for L in each) for each in (Y, deflated))
    return (len(Y[0]) - found) * (1 - after / before)
