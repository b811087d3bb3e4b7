"""Newtonized orthogonal matching pursuit: after each pick, all sources are refined in turn by Newton steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar, final

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

from nfbench import Formulation, Ge, Instance, Le, Minimize

from ..array_instance import ArrayInstance, ArrayScenario
from ..calibration import calibrated
from ..enumeration import Criterion, Sources, how_many
from ..objectives import kernels
from ..objectives.factors import factors
from ..search import BandFit, polar_grid
from ..search import warm_up as warm_up_search
from ..wavefronts import Amplitude, Wavefront
from .newton import newton_step
from .omp import Coherence, grid_warnings, refine_together, residuals, strongest
from .relaxation import TOLERANCE

__all__ = ["NewtonizedOmp"]


@final
@dataclass(frozen=True)
class NewtonizedOmp(Formulation):
    """Orthogonal matching pursuit with cyclic Newton refinement (NOMP; Mamandipoor, Ramasamy & Madhow 2016).

    A source is picked from the polar grid as by ``omp``, and refined off the grid by Newton steps of its correlation
    ‖aᴴR‖²/‖a‖² with the residual. Then, in some rounds, each source found so far is refined in turn in what the data
    leave without the others, which are subtracted with their present symbols. At the end, the symbols of all sources
    are fitted together by least squares, which gives the residual for the next pick. Later sources thereby correct the
    earlier ones, and the estimates leave the grid (doi:10.1109/TSP.2016.2580523; for several snapshots Zhu, Han, Blum
    & Xu 2019). The frequencies of that method are angle and inverse range here, and its false-alarm threshold is
    replaced with ``sources``. The number of snapshots may be smaller than that of sources.
    For several frequency bins the correlations are added, each weighted as the misfits of ``neef`` with "dml".

    coherence: coherence |aᴴb|/(‖a‖‖b‖) of the responses of neighbours on the grid, in angle and in inverse range.
    steps: Newton steps of a source each time it is refined.
    rounds: rounds of cyclic refinement after each source but the last.
    last_rounds: maximum number of rounds after the last source; they end when a round lowers the misfit of all sources
        together by no more than 1e-9 of it.
    refine: whether to refine the result by a local search of deterministic maximum likelihood (DML), ‖(I − P_A)Y‖²,
        over all sources together.
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

    coherence: Coherence = 0.9
    steps: Annotated[int, Ge(1), Le(100)] = 1
    rounds: Annotated[int, Ge(0), Le(1000)] = 3
    last_rounds: Annotated[int, Ge(0), Le(10_000)] = 100
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
        K = min(K, len(grid))
        for k in range(K):
            R = residuals(fits, theta)
            new = strongest(R, grid, *box, avoided=theta)
            for _ in range(self.steps):
                new = newton_step(R, *box, new)
            theta = self._refine_in_turn(fits, *box, np.vstack([theta, new]), is_last=k == K - 1)
        return refine_together(fits, *box, theta) if self.refine else theta

    def _refine_in_turn(
        self,
        fits: Sequence[BandFit],
        lower: Float[ndarray, " d"],
        upper: Float[ndarray, " d"],
        theta: Float[ndarray, "k d"],
        *,
        is_last: bool,
    ) -> Float[ndarray, "k d"]:
        """Return the sources after rounds of cyclic refinement, in which each source in turn is refined."""
        A = [manifold.response(theta).T for _, manifold in fits]
        S = [np.linalg.lstsq(a, F)[0] for a, (F, _) in zip(A, fits, strict=True)]
        before = _misfit(fits, A, S)
        for _ in range(self.last_rounds if is_last else self.rounds):
            for k in range(len(theta)):
                alone = [
                    BandFit(F - np.delete(a, k, axis=1) @ np.delete(s, k, axis=0), manifold)
                    for (F, manifold), a, s in zip(fits, A, S, strict=True)
                ]
                for _ in range(self.steps):
                    theta[k] = newton_step(alone, lower, upper, theta[k])
                for (R, manifold), a, s in zip(alone, A, S, strict=True):
                    a[:, k] = manifold.response(theta[k])
                    s[k] = a[:, k].conj() @ R / np.vdot(a[:, k], a[:, k]).real
            after = _misfit(fits, A, S)
            if is_last and before - after <= TOLERANCE * before:
                break
            before = after
        return theta


def _misfit(fits: Sequence[BandFit], A: list[Complex[ndarray, "m k"]], S: list[Complex[ndarray, "k c"]]) -> float:
    """Return Σ_f ‖F − AS‖²."""
    return sum(float(np.linalg.norm(F - a @ s)) ** 2 for (F, _), a, s in zip(fits, A, S, strict=True))
