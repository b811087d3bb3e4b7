"""Standard errors of the positions of estimated sources, from the curvature of the misfit."""

from __future__ import annotations

import math

from jaxtyping import Complex, Float
from numpy import ndarray

from ..bounds import position_bounds
from ..rounding import next_to_element
from ..wavefronts import Manifold
from . import general, kernels
from .local_search import unit_of

__all__ = ["covariance", "error_columns", "standard_errors"]


def standard_errors(
    theta: Float[ndarray, "k d"],
    manifold: Manifold,
    lower: Float[ndarray, " d"],
    upper: Float[ndarray, " d"],
    F: Complex[ndarray, "m c"],
    noise: float,
    snapshots: int,
    spread: Complex[ndarray, "m c"] | None = None,
) -> dict[str, float]:
    """Return the ``error_columns`` of estimated positions; the arguments are those of ``covariance``."""
    return error_columns(covariance(theta, manifold, lower, upper, F, noise, snapshots, spread), theta, lower, upper)


def error_columns(
    C: Float[ndarray, "kd kd"],
    theta: Float[ndarray, "k d"],
    lower: Float[ndarray, " d"],
    upper: Float[ndarray, " d"],
) -> dict[str, float]:
    """Return the standard errors of estimated positions [m], by the names of their columns.

    std_1_m, std_2_m, …: standard deviation √(r²cos²ψ·C_φφ + r²·C_ψψ + C_rr) of the position of each estimate, in the
        order of the estimates; NaN if it lies on an edge of the box, or if the data do not determine it. All are NaN if
        one lies on an element, or is nearer to it than a thousandth of its range.
    std_m: root mean square of these; NaN if one of them is NaN.

    C: covariance of the estimates [rad, m], shape (Kd, Kd).
    theta: estimated sources [rad, m], shape (K, d).
    lower: lower bounds of one source [rad, m], shape (d,).
    upper: upper bounds of one source [rad, m], shape (d,).
    """
    deviations = position_bounds(C, theta)
    deviations[((theta <= lower) | (theta >= upper)).any(axis=1)] = math.nan
    columns = {f"std_{k}_m": float(deviation) for k, deviation in enumerate(deviations, start=1)}
    columns["std_m"] = math.sqrt(deviations @ deviations / len(deviations))
    return columns


def covariance(
    theta: Float[ndarray, "k d"],
    manifold: Manifold,
    lower: Float[ndarray, " d"],
    upper: Float[ndarray, " d"],
    F: Complex[ndarray, "m c"],
    noise: float,
    snapshots: int,
    spread: Complex[ndarray, "m c"] | None = None,
) -> Float[ndarray, "kd kd"]:
    """Return the covariance of minimizers of J = ‖(I − P_A)F‖² for white noise, in the order of ``theta`` [rad, m].

    With H(F) = Re[(DᴴP⊥D) ⊙ (A⁺FFᴴA⁺ᴴ)ᵀ] at the estimate it is (σ²/2T)·H(F)⁻¹·H(G)·H(F)⁻¹. For F = L/√T, LLᴴ = YYᴴ,
    and for WSF, F = U_s·diag((λ_i − σ²)/√λ_i), G is F: what is left, (σ²/2T)·H⁻¹, tends to the deterministic and to the
    stochastic Cramér–Rao bound. For F = U_s·diag(w_i), G = U_s·diag(w_i²·√λ_i/(λ_i − σ²)) (Viberg & Ottersten 1991,
    doi:10.1109/78.80966). All elements are NaN if the data do not determine the sources, or if an exact wavefront has
    no reliable curvature because a source is nearer to an element than a thousandth of its range.

    theta: estimated sources [rad, m], shape (K, d).
    manifold: array and wavefront model.
    lower: lower bounds of one source [rad, m], shape (d,); a coordinate on a bound is considered known, and its
        elements are 0.
    upper: upper bounds of one source [rad, m], shape (d,).
    F: factor that was fitted, shape (M, c).
    noise: power σ² of the noise, such as ``SignalSubspace.noise``.
    snapshots: number T of snapshots.
    spread: the factor G; None: F.
    """
    kernels.warm_up()
    G = F[:, :0] if spread is None else spread
    if manifold.has_unit_modulus:
        C = kernels.inverse_curvature(*manifold.packed, F, G, lower, upper, unit_of(manifold), theta.ravel())
    else:
        C = general.inverse_curvature(manifold, F, G, lower, upper, theta)
    C *= math.nan if next_to_element(manifold, theta) else noise / (2 * snapshots)
    return C
