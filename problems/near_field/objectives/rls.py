"""RLS: how much of the data one source does not explain, the objective of NEMO."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import final

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

from nfbench import Problem

from ..objectives import kernels
from ..subspace import compress
from ..wavefronts import Manifold
from .general_fit import GeneralFit

__all__ = ["RLS", "deflate", "flattened"]

LEAST = 1e-16  # squared length of a response, relative to itself, that is 0: there is no other source to be near to


@final
class RLS(Problem):
    """J(θ) = ‖(I − P_a)Y‖²_F + Σ_i α·max(0, δ_min − ‖θ − θ_i‖), n = 2, or 3 with elevation.

    The first term is the residual of the least-squares fit of one source, as in CLEAN (Högbom 1974) and matching
    pursuit (Mallat & Zhang 1993, doi:10.1109/78.258082). The second pushes away from sources found before; its norm
    adds radians and metres alike (1 rad, 1 m). At the paper's α = 1000, δ_min = 0.08 it is at most 80 per detected
    source, while ‖Y‖² is about 10⁶, so it has no effect; ``alpha_relative`` has the same effect at any SNR.

    Y: (M, T) data, or any factor of it. lower, upper: (d,) the box of one source [rad, m]. detected: (k, d) the θ_i.
    alpha_relative: if given, α in units of ‖Y‖²/M. Raises ValueError where shapes differ or Y is not finite.
    """

    has_gradient = True

    def __init__(
        self,
        Y: Complex[ndarray, "m t"],
        manifold: Manifold,
        lower: Float[ndarray, " d"],
        upper: Float[ndarray, " d"],
        *,
        detected: Float[ndarray, "k d"] | None = None,
        alpha: float = 1000.0,
        delta_min: float = 0.08,
        alpha_relative: float | None = None,
    ) -> None:
        if Y.ndim != 2 or len(Y) != manifold.elements:
            raise ValueError(f"Y: expected shape ({manifold.elements}, T), got {Y.shape}")
        if not np.isfinite(Y).all():
            raise ValueError("Y: expected finite data, got NaN or infinite entries")
        if lower.shape != (manifold.dimension,) or upper.shape != lower.shape:
            raise ValueError(f"lower, upper: expected shape ({manifold.dimension},), got {lower.shape}, {upper.shape}")
        self.lower, self.upper = lower, upper
        self.manifold = manifold
        kernels.warm_up()
        L = compress(Y)
        self._choose_kernels(L)
        self._energy = float(np.vdot(Y, Y).real)
        self._detected = np.empty((0, manifold.dimension)) if detected is None else detected
        self._alpha = alpha if alpha_relative is None else alpha_relative * self._energy / manifold.elements
        self._delta_min = delta_min
        repels = len(self._detected) > 0 and self._alpha * delta_min > 0
        self.factor = None if repels else L  # F of J = ‖(I − P_a)F‖², of which no repulsion is part
        cone = self._detected, float(self._alpha), float(delta_min)
        self._repulsion = partial(kernels.repulsion, *cone)

    def _choose_kernels(self, L: Complex[ndarray, "m c"]) -> None:
        """Set the functions that return M·‖aᴴL‖²/‖a‖², which is ‖aᴴL‖² where the entries of a have modulus 1."""
        M = self.manifold.elements
        self._projected_energy: Callable[[ndarray], ndarray]
        self._projected_energy_and_gradient: Callable[[ndarray], tuple[float, ndarray]]
        if (flat := flattened(L, self.manifold)) is None:
            fit = GeneralFit(L * np.sqrt(M), self.manifold, least=LEAST)
            self._projected_energy = fit.explained
            self._projected_energy_and_gradient = fit.explained_and_gradient
            return
        rows, manifold = flat
        factor = *manifold.packed, kernels.pack_rows(rows)
        self._projected_energy = partial(kernels.projected_energy, *factor)
        self._projected_energy_and_gradient = partial(kernels.projected_energy_and_gradient, *factor)

    def evaluate(self, X: Float[ndarray, "p n"]) -> Float[ndarray, " p"]:
        residual = np.maximum(self._energy - self._projected_energy(X) / self.manifold.elements, 0.0)
        return residual + self._repulsion(X) if len(self._detected) else residual

    def value(self, x: Float[ndarray, " n"]) -> float:
        residual = max(self._energy - float(self._projected_energy(x[None])[0]) / self.manifold.elements, 0.0)
        return residual + float(self._repulsion(x[None])[0]) if len(self._detected) else residual

    def value_and_gradient(self, x: Float[ndarray, " n"]) -> tuple[float, Float[ndarray, " n"]]:
        """The value and the gradient; of the repulsion a subgradient, zero where it has a kink."""
        M = self.manifold.elements
        energy, slope = self._projected_energy_and_gradient(x)
        gradient: Float[ndarray, " n"] = -slope / M
        value = max(self._energy - energy / M, 0.0)
        if not len(self._detected):
            return value, gradient
        away = x - self._detected
        distance = np.linalg.norm(away, axis=1)
        near = (distance > 0) & (distance < self._delta_min)
        gradient -= self._alpha * np.sum(away[near] / distance[near, None], axis=0)
        return value + float(self._repulsion(x[None])[0]), gradient


def flattened(F: Complex[ndarray, "m c"], manifold: Manifold) -> tuple[Complex[ndarray, "m c"], Manifold] | None:
    """Return a factor and a manifold of modulus 1 with the same ‖aᴴF‖²/‖a‖² for all sources; None if there are none.

    For weights w on the diagonal and constant amplitudes, ‖a‖² = Σ|w_m|² does not depend on the source.
    """
    if manifold.has_unit_modulus:
        return F, manifold
    w = manifold.weights
    if w is None or w.ndim == 2 or manifold.amplitude != "constant":
        return None
    scale = np.sqrt(len(w) / np.vdot(w, w).real)
    return w.conj()[:, None] * F * scale, replace(manifold, weights=None)


def deflate(Y: Complex[ndarray, "m t"], a: Complex[ndarray, " m"]) -> Complex[ndarray, "m t"]:
    """(I − P_a)Y: the data, or a factor of them, without what a source of response ``a`` explains."""
    s = a.conj() @ Y / np.vdot(a, a).real  # ŝᵀ = aᴴY/aᴴa
    return Y - np.outer(a, s)
