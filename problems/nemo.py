"""NEMO: sources found one after another in what the ones before leave unexplained."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar, final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nfbench import Formulation, Ge, Instance, Lt, Minimize

from .instance import NearFieldInstance
from .rls import RLS, deflate
from .subspace import compress
from .wavefronts import Wavefront

__all__ = ["Nemo"]


@final
@dataclass(frozen=True)
class Nemo(Formulation):
    """Near-field multimodal localization: K times, minimize RLS and deflate (Mousavirad et al., Algorithm 1).

    K is known, so every detection is accepted; a local search afterwards is the solver's to make.

    alpha: repulsion from sources found before. alpha_relative: instead of alpha, in units of ‖Y‖²/M of the residual.
    delta_min: how far it reaches [1 rad, 1 m alike]. wavefront: what the estimator assumes (default: the scenario's).
    """

    accepts: ClassVar[type[Instance]] = NearFieldInstance

    alpha: Annotated[float, Ge(0.0), Lt(math.inf)] = 1000.0
    alpha_relative: Annotated[float, Ge(0.0), Lt(math.inf)] | None = None
    delta_min: Annotated[float, Ge(0.0), Lt(math.inf)] = 0.08
    wavefront: Wavefront | None = None

    def solve(self, instance: NearFieldInstance, minimize: Minimize) -> Float[ndarray, "k d"]:
        """The sources (K, d) in the order of their detection [rad, m]."""
        manifold = instance.manifold.under(self.wavefront)
        Y = compress(instance.Y)
        detected = np.empty((0, manifold.dimension))  # S_det ← ∅
        for _ in range(instance.sources):  # while k ≤ K
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
            Y = deflate(Y, manifold.response(theta))  # Y ← Y − a(θ̂_k)·ŝ_kᵀ
            detected = np.vstack([detected, theta])  # S_det ← S_det ∪ {θ̂_k}
        return detected
