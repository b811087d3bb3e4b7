"""NEEF: all sources at once, fitted to the signal subspace."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nfbench import Formulation, Instance, Minimize

from ..enumeration import Criterion, Sources, how_many
from ..instance import NearFieldInstance
from ..objectives.subspace_fitting import ESF
from ..subspace import signal_subspace
from ..wavefronts import Wavefront
from .refinement import refine

__all__ = ["Neef"]


@final
@dataclass(frozen=True)
class Neef(Formulation):
    """Near-field eigen-subspace fitting: minimize ESF once, over all sources (Mousavirad et al., Algorithm 2).

    wavefront: what the estimator assumes (default: the scenario's). sources: how many to look for: "known", the true
    number; "estimate", by the criterion "aic", "mdl" or "ne" (Nadakuditi & Edelman); or a number, right or wrong.
    refine: search on from the solver's minimizer by L-BFGS-B, beside its budget.
    """

    accepts: ClassVar[type[Instance]] = NearFieldInstance

    wavefront: Wavefront | None = None
    sources: Sources = "known"
    criterion: Criterion = "ne"
    refine: bool = False

    def solve(self, instance: NearFieldInstance, minimize: Minimize) -> Float[ndarray, "k d"]:
        """The sources (K, d) [rad, m]. Raises Incompatible with fewer snapshots than sources."""
        K = how_many(instance, self.sources, self.criterion)
        if K == 0:
            return np.empty((0, instance.manifold.dimension))
        U_s = signal_subspace(instance.Y, K)
        manifold = instance.manifold.under(self.wavefront)
        problem = ESF(U_s, manifold, instance.lower, instance.upper)
        x = minimize(problem).x
        return (refine(problem, x, manifold) if self.refine else x).reshape(K, -1)
