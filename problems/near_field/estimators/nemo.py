"""NEMO: sources found one after another in what the ones before leave unexplained."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar, final

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

from nfbench import Formulation, Ge, Instance, Lt, Minimize

from ..enumeration import Criterion, Sources, how_many
from ..instance import NearFieldInstance
from ..objectives.rls import RLS, deflate
from ..subspace import compress
from ..wavefronts import Wavefront
from .refinement import refine

__all__ = ["Nemo"]


@final
@dataclass(frozen=True)
class Nemo(Formulation):
    """Near-field multimodal localization: K times, minimize RLS and deflate (Mousavirad et al., Algorithm 1).

    Every detection is accepted, unless ``stop_below`` is given.

    alpha: repulsion from sources found before. alpha_relative: instead of alpha, in units of ‖Y‖²/M of the residual.
    delta_min: how far it reaches [1 rad, 1 m alike]. wavefront: what the estimator assumes (default: the scenario's).
    sources: how many to look for: "known", the true number; "estimate", by the criterion "aic", "mdl" or "ne"
    (Nadakuditi & Edelman); or a number, right or wrong. stop_below: the quality of a detection at which, and without
    which, to end early. It is the energy explained over the mean energy of the residual in each of its M − k
    dimensions, k found before: about 1 where noise is explained at any one place, and hardly above (1 + √(M/T))² at
    the best, as eigenvalues of noise end there (Marchenko & Pastur 1967). Default: no such end.
    refine: search on from each of the solver's minimizers by L-BFGS-B, before deflation and beside its budget.
    """

    accepts: ClassVar[type[Instance]] = NearFieldInstance

    alpha: Annotated[float, Ge(0.0), Lt(math.inf)] = 1000.0
    alpha_relative: Annotated[float, Ge(0.0), Lt(math.inf)] | None = None
    delta_min: Annotated[float, Ge(0.0), Lt(math.inf)] = 0.08
    wavefront: Wavefront | None = None
    sources: Sources = "known"
    criterion: Criterion = "ne"
    stop_below: Annotated[float, Ge(0.0), Lt(math.inf)] | None = None
    refine: bool = False

    def solve(self, instance: NearFieldInstance, minimize: Minimize) -> Float[ndarray, "k d"]:
        """The sources (K, d) in the order of their detection [rad, m]."""
        manifold = instance.manifold.under(self.wavefront)
        Y = compress(instance.Y)
        detected = np.empty((0, manifold.dimension))  # S_det ← ∅
        for _ in range(how_many(instance, self.sources, self.criterion)):  # while k ≤ K
            residual = RLS(
                Y,
                manifold,
                instance.lower,
                instance.upper,
                detected=detected,
                alpha=self.alpha,
                delta_min=self.delta_min,
                alpha_relative=self.alpha_relative,
            )
            theta = minimize(residual).x  # θ̂_k
            if self.refine:
                theta = refine(residual, theta, manifold)
            left = deflate(Y, manifold.response(theta))  # Y − a(θ̂_k)·ŝ_kᵀ
            if self.stop_below is not None and _quality(Y, left, len(detected)) < self.stop_below:
                break
            Y = left
            detected = np.vstack([detected, theta])  # S_det ← S_det ∪ {θ̂_k}
        return detected


def _quality(Y: Complex[ndarray, "m c"], left: Complex[ndarray, "m c"], found: int) -> float:
    """The energy explained, ‖Y‖² − ‖left‖², over the mean of ‖Y‖² in each of its M − ``found`` dimensions."""
    return float((len(Y) - found) * (1 - np.linalg.norm(left) ** 2 / np.linalg.norm(Y) ** 2))
