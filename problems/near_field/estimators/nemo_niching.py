"""NEMO with niching: all sources are taken from one population, without deflation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nfbench import Formulation, Incompatible, Instance, Minimize

from ..array_instance import ArrayInstance
from ..bands import one_band
from ..calibration import calibrated
from ..enumeration import Criterion, Sources, how_many
from ..objectives.rls import RLS
from ..search import warm_up as warm_up_search
from ..subspace import compress
from ..wavefronts import Amplitude, Wavefront
from .music import pick_peaks

__all__ = ["NemoNiching"]


@final
@dataclass(frozen=True)
class NemoNiching(Formulation):
    """Multimodal optimization without deflation: one search of one RLS problem, whose K deepest minima are the sources.

    The minima are taken from the solver's last population, which the solver must report; ``crowding-de`` is designed to
    hold many minima at once. Individuals are processed in the order of their values. Of those from which a local
    search reaches the same minimum, only the best is used; these evaluations do not count towards the budget. If the
    population contains fewer than K minima, the best remaining individuals complete the estimate. A minimum need not be
    a source: without deflation, a sidelobe of a strong source may be deeper than the minimum of a weak source.

    refine: whether to return the refined minima instead of the individuals.
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
        warm_up_search()

    def solve(self, instance: ArrayInstance, minimize: Minimize) -> Float[ndarray, "k d"]:
        """Return the sources (K, d) [rad, m], the deepest minimum first; fewer if the population is smaller.

        Raises Incompatible if the solver does not report a population, or if there are several frequency bins.
        """
        one_band(instance.bands, "nemo-niching", "which searches one problem of one wavelength")
        K = how_many(instance, self.sources, self.criterion, self)
        Y, manifold = calibrated(instance, self)[0].received
        if K == 0:
            return np.empty((0, manifold.dimension))
        problem = RLS(compress(Y), manifold, instance.lower, instance.upper)
        population = minimize(problem).population
        if population is None:
            raise Incompatible(
                "solver: expected one that keeps its last population, from which nemo-niching takes the sources, "
                "got one that keeps none; use for example crowding-de"
            )
        individuals, minima = pick_peaks(problem, population, K)
        return minima if self.refine else individuals
