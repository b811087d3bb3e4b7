"""NEEF: fits all sources at once to the signal subspace."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nfbench import Formulation, Instance, Minimize, Reference

from ..array_instance import ArrayInstance
from ..calibration import calibrated
from ..enumeration import Criterion, Sources, how_many
from ..objectives.factors import Objective, factors
from ..objectives.subspace_fitting import SubspaceFit
from ..objectives.sum_of_fits import together
from ..search import warm_up as warm_up_search
from ..subspace import decompose
from ..wavefronts import Amplitude, Wavefront
from .certified import certified_minimum
from .refinement import refine

__all__ = ["Neef"]


@final
@dataclass(frozen=True)
class Neef(Formulation):
    """Near-field eigen-subspace fitting: minimizes ESF once over all sources (Mousavirad et al., Algorithm 2).

    For several frequency bins the objective is the sum of theirs. In "wsf" and "dml" the bins are weighted by their
    numbers of snapshots divided by the powers of their noise, so that the sum is the log-likelihood of all data; in
    "esf" all bins have the same weight.

    objective: what is fitted. "esf" is the signal subspace with unit weights, as in the paper. "wsf" weights its
        eigenvectors by their eigenvalues, which is as accurate as possible also for close and for coherent sources, at
        the same cost. "dml" is deterministic maximum likelihood, which fits all data: as accurate, also with fewer
        snapshots than sources, but up to min(M, T)/K times as expensive.
    wavefront: wavefront model that the estimator assumes, "exact", "fresnel", "paper" or "planar"; None: that of the
        scenario.
    sources: number of sources to search for: "known" is the true number, "estimate" is an estimate from the data by
        ``criterion``, and an integer is used as given, even if it is wrong.
    criterion: criterion by which the number of sources is estimated: "aic", "mdl" or "ne" (Nadakuditi & Edelman); used
        only if ``sources`` is "estimate".
    refine: whether to refine the solver's minimizer by a local search; its evaluations do not count towards the budget.
    known_gains: whether the estimator knows the gains and phases of the elements.
    known_coupling: whether the estimator knows the mutual coupling of the elements.
    known_noise: whether the estimator knows the covariance of the noise, and whitens the data with it.
    known_failed: whether the estimator knows which elements have failed, and leaves them out.
    known_positions: whether the estimator knows the true positions of the elements.
    amplitude: amplitude over the array that the estimator assumes, "constant", or "spherical", which is r/‖p − q_m‖.
    """

    accepts: ClassVar[type[Instance]] = ArrayInstance  # type: ignore[type-abstract]  # any subclass

    objective: Objective = "esf"
    wavefront: Wavefront | None = None
    sources: Sources = "known"
    criterion: Criterion = "ne"
    refine: bool = False
    known_gains: bool = False
    known_coupling: bool = False
    known_noise: bool = False
    known_failed: bool = False
    known_positions: bool = False
    amplitude: Amplitude = "constant"

    def estimates(self, instance: ArrayInstance, X: Float[ndarray, "r n"]) -> Float[ndarray, "r k d"] | None:
        return None if self.refine else X.reshape(len(X), -1, instance.manifold.dimension)

    def warm_up(self) -> None:
        if self.refine:
            warm_up_search()

    def reference(self, instance: ArrayInstance) -> Reference | None:
        """Return the certified minimum of ESF; None where no proof is known.

        These are the other objectives, several frequency bins, and responses whose modulus is not 1, as those of known
        gains.
        """
        K = how_many(instance, self.sources, self.criterion, self)
        if self.objective != "esf" or K == 0 or len(instance.bands) > 1:
            return None
        Y, manifold = calibrated(instance, self)[0].received
        if not manifold.has_unit_modulus:
            return None
        found = certified_minimum(decompose(Y, K).U_s, manifold, instance.lower, instance.upper)
        columns = {"regions": float(found.regions), "certificate_evaluations": float(found.evaluations)}
        return Reference(found.J, found.gap, found.certified, found.theta.ravel(), found.step, columns)

    def solve(self, instance: ArrayInstance, minimize: Minimize) -> Float[ndarray, "k d"]:
        """Return the sources (K, d) [rad, m].

        Raises Incompatible if there are fewer snapshots than sources, except for "dml".
        """
        K = how_many(instance, self.sources, self.criterion, self)
        if K == 0:
            return np.empty((0, instance.manifold.dimension))
        bands = calibrated(instance, self)
        fitted, box = factors([band.Y for band in bands], K, self.objective), (instance.lower, instance.upper)
        parts = [SubspaceFit(F, band.manifold, *box, sources=K) for F, band in zip(fitted, bands, strict=True)]
        problem = together(parts)
        x = minimize(problem).x
        return (refine(problem, x, bands[0].manifold) if self.refine else x).reshape(K, -1)
