"""The contracts of a scenario, which describes what is measured, and of an instance, which is one draw of it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy import ndarray

from .cut import Cut
from .localization import Localization
from .options import Options
from .problem import Problem
from .survey import Survey

__all__ = ["Extra", "Instance", "ProblemInstance", "Scenario"]


class Instance(ABC):
    """One draw of a scenario: the data that every method sees, and the truth with which estimates are compared."""

    @abstractmethod
    def score(self, estimate: ndarray) -> dict[str, float]:
        """Return the scores of an estimate by column name, including the scenario's ``error``.

        Raise ValueError if the estimate has the wrong shape. If the ``error`` is NaN, the run becomes ``invalid``,
        unless the estimate is empty, which is the valid result that no source was found.
        """

    def errors(self, measure: str, estimates: ndarray) -> ndarray:
        """Return the score ``measure`` of many estimates (r, ...) at once, as an array (r,).

        It is computed along whole traces, so override it where that is faster than one call of ``score`` per estimate.
        Each value must agree with that of ``score``. Raises KeyError if there is no such score, and ValueError if the
        estimates have the wrong shape.
        """
        return np.array([self.score(estimate)[measure] for estimate in estimates], dtype=np.float64)

    def positions(self, estimate: ndarray) -> tuple[ndarray, ndarray] | None:
        """Return the true and the estimated positions of the sources for ``positions.csv`` and figures, Cartesian [m].

        They are in the coordinates in which the user describes the array. If angles and ranges are measured from
        another point or other axes than x, y and z, three more columns have the azimuth, the elevation [rad] and the
        range [m]; else these follow from x, y and z.

        The two arrays have K rows and at least K rows. Row k of the second one is the estimate assigned to source k, or
        NaN if no estimate is assigned to it. Rows beyond K are the estimates that are assigned to no source, which are
        all of them if K is 0 because the truth is not known. The default is None, which means that there are no
        positions to show. It is called for estimates whose ``score`` is valid.
        """
        return None

    def origin(self) -> ndarray:
        """Return the point from which ranges are measured, (3,) [m], in the coordinates of ``positions``."""
        return np.zeros(3)

    def describe(self, estimate: ndarray, columns: Mapping[str, float]) -> Localization | None:
        """Return what an estimate says about the sources, for ``nfbench localize``; None if there is nothing to say.

        estimate: an estimate as for ``score``.
        columns: columns of the Solution from which it comes; empty if there are none.
        """
        return None

    def cuts(self) -> Sequence[Cut]:
        """Return planes through objectives at the truth, for figures of the landscape; the default is none."""
        return ()

    def truth(self) -> ndarray | None:
        """Return the estimate whose ``error`` is 0, which the checks use; None if it is not known."""
        return None


class ProblemInstance(Instance, ABC):
    """An instance that consists of one problem, whose minimizer is the estimate.

    The formulation ``direct`` solves such instances.
    """

    problem: Problem

    def cuts(self) -> Sequence[Cut]:
        """The problem itself, if it has two unknowns and its minimizer is known."""
        truth = self.truth()
        if truth is None or self.problem.dimension != 2 or np.shape(truth) != (2,):
            return ()
        return (Cut("Objective", self.problem, truth, (0, 1), ("x₁", "x₂"), (1.0, 1.0), truth[None]),)


@dataclass(frozen=True)
class Extra:
    """Modules that a plugin imports when it runs and that its package does not always install.

    name: name of the package's optional extra that installs the modules; None if they are installed separately.
    requires: names of the modules.
    """

    name: str | None
    requires: tuple[str, ...]


@dataclass(frozen=True)
class Scenario(Options, ABC):
    """A description of what is measured.

    Subclass it as a frozen dataclass; its fields are the keys of ``[scenario]`` and ``[sweep]``. ``instance`` is the
    class of the objects that ``draw`` returns; a formulation is used only if it accepts this class. ``error`` is the
    name of the score by which methods are ranked; smaller is better.
    """

    instance: ClassVar[type[Instance]]
    error: ClassVar[str] = "rmse_m"

    def warm_up(self) -> None:
        """Compile or load what the runs need. It is called before the first run, so that no run time includes it."""

    def ranked_by(self) -> str:
        """Return the name of the score by which methods are ranked with these options; the default is ``error``.

        Override it if that score exists only with some options, for example if the true sources may not be known.
        """
        return self.error

    def most_scenes(self) -> tuple[int, str] | None:
        """Return how many different scenes there are with these options, and why; the default is None, any number.

        Override it if the data of scenes repeat after some number, as the segments of a recording do. A study with more
        scenes is refused, because its statistics would count the same data several times. The second item completes
        the error "expected at most 7, …", for example "one per segment; raise segments".
        """
        return None

    def needed_extra(self) -> Extra | None:
        """Return the optional library that the scenario needs with these options. The default is None."""
        return None

    def warnings(self) -> list[str]:
        """Return sentences about options that are valid but probably not what was meant, e.g. a wrong unit.

        Each sentence names the option, its value with the unit, and what may be wrong. ``load_study`` collects them in
        ``Study.warnings``, and ``nfbench run`` prints them; they do not prevent the study from running. The method must
        return within milliseconds. The default is an empty list.
        """
        return []

    def differences(self, other: Scenario) -> list[str]:
        """Return sentences about how another scenario, whose results are to hold for this one, differs from it.

        ``nfbench localize --study`` calls it with the scenario of the study. The default is an empty list.
        """
        return []

    @classmethod
    def survey(cls, options: Mapping[str, Any]) -> Survey | None:
        """Return what is worth knowing about the array in some options of the scenario, for ``nfbench show array``.

        options: ``array`` and what determines the wavelength, as in a manifest; other options may be missing.

        Raise OptionError if they are invalid. The default is None, which means that the scenario has no array.
        """
        return None

    @abstractmethod
    def draw(self, rng: np.random.Generator) -> Instance:
        """Draw one instance. All randomness must come from ``rng``."""

    def draw_scene(self, rng: np.random.Generator, number: int) -> Instance:
        """Draw the scene of this number of a study, from 0. The default is ``draw(rng)``, whatever the number.

        Override it if scenes are enumerated rather than drawn, such as the segments of a recording. ``rng`` is that of
        the scene's seed, and all randomness must come from it.
        """
        return self.draw(rng)

    def draw_truth(self, rng: np.random.Generator, number: int) -> Instance:
        """Draw what the scores of the scene need; its data may be missing. The default is ``draw_scene``.

        It is called to score the points of stored traces. Override it if it can be drawn much faster than the data.
        ``errors`` of the instance must be those of the scene.
        """
        return self.draw_scene(rng, number)
