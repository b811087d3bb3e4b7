"""NEMO with niching: all sources from one population, without deflation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nfbench import Formulation, Incompatible, Instance, Minimize

from ..enumeration import Criterion, Sources, how_many
from ..instance import NearFieldInstance
from ..objectives.rls import RLS
from ..subspace import compress
from ..wavefronts import Wavefront
from .music import pick_peaks

__all__ = ["NemoNiching"]


@final
@dataclass(frozen=True)
class NemoNiching(Formulation):
    """Multimodal optimization taken literally: one RLS problem, searched once, its K deepest minima the sources.

    The minima are picked from the solver's last population, which the solver must keep; ``crowding-de`` is made to hold
    many of them at once. Best individuals come first; of those that climb to one minimum the best counts. The climbs,
    by L-BFGS-B, are beside the solver's budget. Where the population holds fewer minima than K, the estimate is filled
    up with the best individuals left. A minimum need not be a source: nothing is deflated, so a sidelobe of a strong
    source may lie deeper than a weak source.

    refine: report the minima climbed to instead of the individuals. wavefront: what the estimator assumes (default: the
    scenario's). sources, criterion: how many, as of ``neef``.
    """

    accepts: ClassVar[type[Instance]] = NearFieldInstance

    refine: bool = False
    wavefront: Wavefront | None = None
    sources: Sources = "known"
    criterion: Criterion = "ne"

    def solve(self, instance: NearFieldInstance, minimize: Minimize) -> Float[ndarray, "k d"]:
        """The sources (K, d), deepest minimum first [rad, m]; fewer where the population is smaller.

        Raises Incompatible where the solver keeps no population.
        """
        K = how_many(instance, self.sources, self.criterion)
        manifold = instance.manifold.under(self.wavefront)
        if K == 0:
            return np.empty((0, manifold.dimension))
        problem = RLS(compress(instance.Y), manifold, instance.lower, instance.upper)
        population = minimize(problem).population
        if population is None:
            raise Incompatible("nemo-niching picks sources from the solver's last population, and this one keeps none")
        individuals, minima = pick_peaks(problem, manifold, population, K)
        return minima if self.refine else individuals
