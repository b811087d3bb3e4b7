"""Orthogonal matching pursuit: sources are picked one by one from a polar grid, and projected off together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar, TypeAlias, final

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

from nfbench import Formulation, Ge, Instance, Lt, Minimize

from ..array_instance import ArrayInstance, ArrayScenario
from ..calibration import calibrated
from ..enumeration import Criterion, Sources, how_many
from ..objectives import kernels
from ..objectives.factors import factors
from ..objectives.rls import RLS
from ..objectives.subspace_fitting import SubspaceFit
from ..objectives.sum_of_fits import together
from ..search import BandFit, polar_grid, polar_grid_size
from ..search import warm_up as warm_up_search
from ..wavefronts import Amplitude, Wavefront
from .music import SLOW_S, search_s
from .refinement import refine

__all__ = ["Coherence", "Omp", "grid_warnings", "refine_together", "residuals", "strongest"]

Coherence: TypeAlias = Annotated[float, Ge(0.1), Lt(1.0)]
"""The coherence of the responses of neighbours on the polar grid."""


@final
@dataclass(frozen=True)
class Omp(Formulation):
    """Simultaneous orthogonal matching pursuit on the polar-domain grid (Cui & Dai 2022, Algorithm 1, P-SOMP).

    The sources are picked from the grid one by one, each where the residual R of all snapshots correlates most with the
    response, θ̂ = argmax ‖aᴴR‖²/‖a‖². Then R = (I − P_A)Y, with all sources picked so far projected off together
    (Cui & Dai 2022, doi:10.1109/TCOMM.2022.3146400; for several snapshots Tropp, Gilbert & Strauss 2006,
    doi:10.1016/j.sigpro.2005.05.030). NEMO does the same without a grid and subtracts each source on its own. The
    number of snapshots may be smaller than that of sources, and sources may be coherent. For several frequency bins
    the correlations are added, each weighted as the misfits of ``neef`` with the objective "dml".

    The estimates are grid points: without ``refine`` their error does not vanish with the noise. A source between grid
    points leaves a residual, which a later pick may take for a source; the finer the grid, the smaller it is.

    coherence: coherence |aᴴb|/(‖a‖‖b‖) of the responses of neighbours on the grid, in angle and in inverse range. The
        closer to 1, the finer the grid.
    refine: whether to refine the picked points together by a local search of deterministic maximum likelihood (DML),
        ‖(I − P_A)Y‖², on which Cui & Dai descend by gradient steps (P-SIGW).
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
    needs_solver: ClassVar[bool] = False

    coherence: Coherence = 0.95
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
        kernels.warm_up()
        if self.refine:
            warm_up_search()

    def warnings(self, scenario: ArrayScenario) -> list[str]:
        return grid_warnings(scenario, self.coherence, scenario.sources * scenario.bins)

    def solve(self, instance: ArrayInstance, minimize: Minimize) -> Float[ndarray, "k d"]:
        """Return the sources (K, d) [rad, m] in the order in which they are picked; fewer if the grid is smaller.

        Raises Incompatible if the grid would have more than 10^7 points.
        """
        K = how_many(instance, self.sources, self.criterion, self)
        theta, box = np.empty((0, instance.manifold.dimension)), (instance.lower, instance.upper)
        if K == 0:
            return theta
        bands = calibrated(instance, self)
        data = factors([band.Y for band in bands], K, "dml")
        fits = [BandFit(L, band.manifold) for L, band in zip(data, bands, strict=True)]
        grid = polar_grid(bands[0].manifold, *box, self.coherence)
        for _ in range(min(K, len(grid))):
            theta = np.vstack([theta, strongest(residuals(fits, theta), grid, *box, avoided=theta)])
        return refine_together(fits, *box, theta) if self.refine else theta


def strongest(
    fits: Sequence[BandFit],
    grid: Float[ndarray, "p d"],
    lower: Float[ndarray, " d"],
    upper: Float[ndarray, " d"],
    avoided: Float[ndarray, "k d"],
) -> Float[ndarray, " d"]:
    """Return the grid point of the greatest Σ_f ‖aᴴR‖²/‖a‖², except those of ``avoided``.

    fits: residual R, or any factor of R·Rᴴ, of each frequency bin, with the array and wavefront model.
    """
    J = together([RLS(R, manifold, lower, upper) for R, manifold in fits]).evaluate(grid)  # ‖R‖² − ‖aᴴR‖²/‖a‖²
    for theta in avoided:
        J[(grid == theta).all(axis=1)] = np.inf
    point: Float[ndarray, " d"] = grid[np.argmin(J)]
    return point


def residuals(fits: Sequence[BandFit], theta: Float[ndarray, "k d"]) -> list[BandFit]:
    """Return (I − P_A)F of each frequency bin, with the sources ``theta`` projected off."""
    return [BandFit(_projected_off(F, manifold.response(theta).T), manifold) for F, manifold in fits]


def _projected_off(F: Complex[ndarray, "m c"], A: Complex[ndarray, "m k"]) -> Complex[ndarray, "m c"]:
    Q = np.linalg.qr(A).Q
    return F - Q @ (Q.conj().T @ F)


def refine_together(
    fits: Sequence[BandFit], lower: Float[ndarray, " d"], upper: Float[ndarray, " d"], theta: Float[ndarray, "k d"]
) -> Float[ndarray, "k d"]:
    """Return a local minimizer (K, d) of the misfit Σ_f ‖(I − P_A)F‖² of all sources together, found from ``theta``."""
    problem = together([SubspaceFit(F, manifold, lower, upper, sources=len(theta)) for F, manifold in fits])
    return refine(problem, theta.ravel(), fits[0].manifold).reshape(theta.shape)


def grid_warnings(scenario: ArrayScenario, coherence: float, passes: int) -> list[str]:
    """Return a sentence if so many passes over the polar grid, one residual each, take long."""
    points, M = polar_grid_size(scenario.manifold(), *scenario.box(), coherence), scenario.array.count
    seconds = passes * search_s(points, M, M)
    if seconds <= SLOW_S:
        return []
    text = f"coherence: {coherence:g} gives a polar grid of about {points:,} points, which takes about {seconds:,.0f} s"
    return [f"{text} per run with {M} elements and {scenario.sources} sources; reduce it"]
