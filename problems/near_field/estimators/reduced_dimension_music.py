"""Reduced-dimension MUSIC: a search over angles, in which the best range profile of each angle is known in advance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, final

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

from nfbench import Formulation, Ge, Instance, Le, Minimize, Solution

from ..array_instance import ArrayInstance
from ..enumeration import Criterion, Sources, how_many
from ..search import warm_up as warm_up_search
from ..subspace import signal_subspace
from ..wavefronts import Amplitude, Wavefront
from .mirrored import Halves, candidates, confirmed, data_of_mirrored_line, halves, mismatch
from .refinement import refine_jointly
from .uniform_line import inverse_range_scale

__all__ = ["ReducedDimensionMusic"]

TITLE = "reduced-dimension MUSIC"
LEAST = 1e-15  # an eigenvalue of the matrix of mismatch that is 0 up to rounding


@final
@dataclass(frozen=True)
class ReducedDimensionMusic(Formulation):
    """MUSIC over angles alone (Zhang, Chen, Zheng, Xia & Wang 2018, IEEE Commun. Lett. 22(7)).

    In a centred ULA the response is a = Ω(φ)·v(r): v has one entry for each pair of elements ±y_m (and for the centre),
    which is its quadratic phase, and Ω(φ) spreads it over the pair with the phases ±k·y_m·sinφ. For each angle the v
    that minimizes vᴴQv, where Q(φ) = Ωᴴ(I − U_sU_sᴴ)Ω, is v̂ = Q⁻¹e_1/(e_1ᵀQ⁻¹e_1), if the entry of the innermost pair
    or centre is to be 1. The angles are the K highest peaks of the spectrum e_1ᵀQ⁻¹e_1. A line fitted to the unwrapped
    phases of v̂ as a function of y_m² has the slope −k·κ/2, from which the range follows, as κ = cos²φ/r, or 1/r for the
    wavefront "paper".

    Q is a diagonal matrix D minus a matrix WWᴴ of rank K, so that Q⁻¹ = D⁻¹ + D⁻¹W(I − WᴴD⁻¹W)⁻¹WᴴD⁻¹ costs K³ per
    angle, and I − WᴴD⁻¹W is half of the matrix whose determinant generalized ESPRIT searches.

    Two sources of similar curvature κ cause a false peak at the mean of their sines. K(K + 1)/2 peaks are therefore
    examined, and the K sources are those whose responses are the closest to the signal subspace. The cubic phase of an
    exact wavefront is odd, and biases the angles. Two sources at the same angle are detected as one. If the phases rise
    with y_m², the range is the largest of the box.

    azimuths: number of angles on the grid.
    refine: whether to refine all sources together by a local search of weighted subspace fitting, which removes the
        bias and the errors of the grid; then there are standard errors.
    wavefront: wavefront model that the estimator assumes, "exact", "fresnel" or "paper"; None: that of the scenario.
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
    needs_solver: ClassVar[bool] = False

    azimuths: Annotated[int, Ge(2), Le(100_000)] = 400
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

    def solve(self, instance: ArrayInstance, minimize: Minimize) -> Float[ndarray, "k d"] | Solution:
        """Return the sources (K, 2) [rad, m], the best first; fewer if there are fewer peaks.

        Raises Incompatible if there are several frequency bins, elevation or fewer snapshots than sources, if the
        array is not a centred ULA along y with a spacing below λ/(4·sinφ_max), or if it has 2K + 1 elements or fewer.
        """
        Y, manifold = data_of_mirrored_line(instance, self, "reduced-dimension-music", TITLE)
        K = how_many(instance, self.sources, self.criterion, self)
        if K == 0:
            return np.empty((0, 2))
        azimuths = np.linspace(instance.lower[0], instance.upper[0], self.azimuths)
        U_s = signal_subspace(Y, K)
        pair, wavelength = halves(U_s, manifold.positions[:, 1]), manifold.wavelength_m
        centre = U_s[len(U_s) // 2] if len(U_s) % 2 else None
        spectrum, inner = _spectrum(pair, centre, azimuths, wavelength)
        best = candidates(spectrum, K)
        theta = np.empty((len(best), 2))
        theta[:, 0] = azimuths[best]
        for k, i in enumerate(best):
            curvature = _curvature(pair, centre, azimuths[i], inner[i], wavelength)
            scale = float(inverse_range_scale(manifold.wavefront, azimuths[i]))
            theta[k, 1] = scale / curvature if curvature > 0 else np.inf
        theta = confirmed(np.clip(theta, instance.lower, instance.upper), U_s, manifold)
        return refine_jointly(Y, manifold, instance.lower, instance.upper, theta) if self.refine else theta


def _spectrum(
    pair: Halves, centre: Complex[ndarray, " k"] | None, azimuth: Float[ndarray, " p"], wavelength: float
) -> tuple[Float[ndarray, " p"], Complex[ndarray, "p k"]]:
    """Return e_1ᵀQ⁻¹e_1 of each angle, and the vectors (I − WᴴD⁻¹W)⁻¹WᴴD⁻¹e_1, from which Q⁻¹e_1 follows."""
    squares, vectors = np.linalg.eigh(mismatch(pair, azimuth, wavelength) / 2)
    if centre is None:
        turn = np.exp(2j * np.pi / wavelength * pair.y[-1] * np.sin(azimuth))[:, None]
        first, weight = turn.conj() * pair.upper[-1] + turn * pair.lower[-1], 2.0  # row of W, entry of D
    else:
        first, weight = np.broadcast_to(centre, (len(azimuth), len(centre))), 1.0
    along = np.einsum("pji,pj->pi", vectors.conj(), first.conj() / weight)
    inner = np.einsum("pij,pj->pi", vectors, along / np.maximum(squares, LEAST))
    return 1 / weight + np.sum(first * inner, axis=1).real / weight, inner


def _curvature(
    pair: Halves,
    centre: Complex[ndarray, " k"] | None,
    azimuth: float,
    inner: Complex[ndarray, " k"],
    wavelength: float,
) -> float:
    """Return κ [1/m], twice the curvature of the wave: the slope of the phases of v̂ as a function of y², times −2/k."""
    turn = np.exp(2j * np.pi / wavelength * pair.y * np.sin(azimuth))[:, None]
    v = ((turn.conj() * pair.upper + turn * pair.lower) @ inner)[::-1]  # D⁻¹W·inner, and e_1 does not matter to phases
    y = pair.y[::-1]
    if centre is not None:
        v, y = np.append(centre @ inner, v), np.append(0.0, y)
    phase, squares = np.unwrap(np.angle(v)), y**2 - np.mean(y**2)
    return float(-wavelength / np.pi * (squares @ phase) / (squares @ squares))
