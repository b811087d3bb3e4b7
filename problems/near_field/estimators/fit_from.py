"""A local fit that starts from the estimate of any other formulation."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar, final

import numpy as np

from nfbench import (
    Formulation,
    Instance,
    Minimize,
    NestedFormulation,
    OptionError,
    Solution,
    formulation_of,
    nested_formulation,
)

from ..array_instance import ArrayInstance
from ..calibration import calibrated
from ..objectives.factors import Objective
from ..search import search_bands_locally, search_locally
from ..search import warm_up as warm_up_search
from ..wavefronts import Amplitude, Wavefront
from .grid_refine import errors_of, fitted

__all__ = ["FitFrom"]


@final
@dataclass(frozen=True)
class FitFrom(Formulation):
    """Weighted subspace fitting or maximum likelihood, minimized locally from the estimate of another formulation.

    The other formulation, ``start``, estimates the sources. From there, the misfit ‖(I − P_A)F‖² of all sources
    together is minimized by Levenberg–Marquardt on the variable projection, as in ``grid-refine``, but without any
    search: the result is the minimum in whose valley the start lies. A study with several starts and one objective
    shows how good each start is; one with several objectives and one start shows what each fit adds. The number of
    sources is that which the start finds. For several frequency bins the misfit is the sum of theirs, weighted as in
    ``neef``.

    The standard errors of the estimates are stored in columns, as by ``grid-refine``; columns of the start are not.

    start: the other formulation, a name such as "omp" or a table with its options, such as
        ``{ kind = "music", grid = { azimuth = 200 } }``. What it knows and assumes, and its number of sources, are its
        own options. If it needs a solver, so does this.
    objective: misfit that is minimized: "wsf" is weighted subspace fitting, which attains the stochastic bound
        (Viberg & Ottersten 1991, doi:10.1109/78.80966), "esf" gives all eigenvectors of the signal subspace the same
        weight, and "dml" is deterministic maximum likelihood, which also works with fewer snapshots than sources.
    wavefront: wavefront model that the fit assumes, "exact", "fresnel", "paper" or "planar"; None: that of the
        scenario.
    known_gains: whether the fit knows the gains and phases of the elements.
    known_coupling: whether the fit knows the mutual coupling of the elements.
    known_noise: whether the fit knows the covariance of the noise, and whitens the data with it.
    known_failed: whether the fit knows which elements have failed, and leaves them out.
    known_positions: whether the fit knows the true positions of the elements.
    amplitude: amplitude over the array that the fit assumes, "constant", or "spherical", which is r/‖p − q_m‖.
    """

    accepts: ClassVar[type[Instance]] = ArrayInstance  # type: ignore[type-abstract]  # any subclass
    needs_solver: ClassVar[bool] = False

    start: NestedFormulation = field(default_factory=lambda: nested_formulation("omp"))
    objective: Objective = "wsf"
    wavefront: Wavefront | None = None
    known_gains: bool = False
    known_coupling: bool = False
    known_noise: bool = False
    known_failed: bool = False
    known_positions: bool = False
    amplitude: Amplitude = "constant"

    def validate(self) -> None:
        start = formulation_of(self.start)
        if not issubclass(ArrayInstance, start.accepts):
            text = f"expected a formulation that estimates sources from data of an array, got {self.start.kind!r}"
            raise OptionError("FitFrom", [("start.kind", text)])
        object.__setattr__(self, "needs_solver", start.needs_solver)

    def warm_up(self) -> None:
        formulation_of(self.start).warm_up()
        warm_up_search()

    def warnings(self, scenario: Any) -> list[str]:
        return [f"start.{text}" for text in formulation_of(self.start).warnings(scenario)]

    def solve(self, instance: ArrayInstance, minimize: Minimize) -> Solution:
        """Return the sources (K, d) [rad, m] in the order of the start, with the columns of ``standard_errors``.

        Raises Incompatible if the start does, or if there are fewer snapshots than sources, except for "dml"; and
        ValueError if the estimate of the start is not finite.
        """
        found = formulation_of(self.start).solve(instance, minimize)
        estimate = found.estimate if isinstance(found, Solution) else found
        box = instance.lower, instance.upper
        start = np.asarray(estimate, dtype=np.float64).reshape(-1, len(instance.lower))
        if not np.isfinite(start).all():
            raise ValueError(f"start: expected finite positions from {self.start.kind}, got NaN or infinite ones")
        if not len(start):
            return Solution(start)
        start = np.clip(start, *box)
        bands = calibrated(instance, self)
        misfit = fitted(bands, len(start), self.objective)
        if len(bands) == 1:
            best = search_locally(*misfit.fits[0], *box, start.ravel())
        else:
            best = search_bands_locally(misfit.fits, *box, start.ravel())
        theta = best.x.reshape(start.shape)
        return Solution(theta, errors_of(misfit, bands, theta, *box))
