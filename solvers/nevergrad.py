"""All optimizers in the registry of Nevergrad."""

from __future__ import annotations

import contextlib
import copy
import difflib
import importlib.util
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import nlopt
import numpy as np

from nfbench import Ge, Incompatible, MeteredProblem, OptionError, Solver, SolverInfo

from ._finite import Finite
from ._nevergrad import cannot_be_used, contained, surrogates_fail
from ._wrapped import from_unit, global_random, planned, rehearse

__all__ = ["Nevergrad"]


@dataclass(frozen=True)
class Nevergrad(Solver):
    """An optimizer of Nevergrad, run point by point in the unit box until the budget is used up.

    Many of the optimizers choose their method from the budget and the number of unknowns. Nevergrad itself takes 0.1 ms
    or more per point; optimizers with a surrogate model ("BO", "MetaModel" …) become much slower with the number of
    points.

    Some optimizers do not work with the installed versions of NumPy and other libraries; ``nfbench show solver
    nevergrad`` lists them with the reason. Four more never end ("NLOPT_LN_NEWUOA_BOUND", "NgIohLn",
    "NgIohMLn", "NgIohRS"), and the runs of three cannot be repeated ("DS14", "MultiDS", "VoxelizeMetaModelOnePlusOne").

    algorithm: name in ``nevergrad.optimizers.registry``: "NGOpt", "DE", "TwoPointsDE", "PSO", "OnePlusOne", "CMA" …
    horizon: number of evaluations to plan for if the budget does not limit them.
    """

    algorithm: str = "TwoPointsDE"
    horizon: Annotated[int, Ge(1)] = 100_000

    info: ClassVar[SolverInfo] = SolverInfo(
        plans_evaluations=True,
        reference="Rapin & Teytaud 2018 (Nevergrad); Bennet et al. 2021, doi:10.1145/3460310.3460312",
        extra="nevergrad",
        requires=("nevergrad",),
    )

    def validate(self) -> None:
        if importlib.util.find_spec("nevergrad") is None:
            return  # the registry reports the missing library when the solver is used
        known = _registry()
        if self.algorithm not in known:
            near = difflib.get_close_matches(self.algorithm, known, n=3)
            hint = f"; did you mean {' or '.join(near)}?" if near else "; e.g. NGOpt, DE, PSO, OnePlusOne, CMA"
            text = f"expected the name of a Nevergrad optimizer, got {self.algorithm!r}{hint}"
            raise OptionError(type(self).__name__, [("algorithm", text)])
        if reason := cannot_be_used().get(self.algorithm):
            text = f"expected an optimizer that works here, got {self.algorithm!r}: {reason}"
            raise OptionError(type(self).__name__, [("algorithm", text)])

    @classmethod
    def unusable(cls) -> dict[str, str]:
        return cannot_be_used()

    def warm_up(self) -> None:
        rehearse(self, evaluations=12)  # some algorithms take 0.1 s per point

    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        from nevergrad.parametrization.parameter import Array

        finite = Finite(start=0.0)
        seeds = rng.integers(2**31 - 1, size=2).tolist()
        # some optimizers use NumPy's global generator; some end when rounding errors prevent further progress
        with contextlib.suppress(nlopt.RoundoffLimited), global_random(seeds[0]), contained(seeds[0]):
            box = Array(init=rng.random(problem.dimension), lower=0.0, upper=1.0)
            box.random_state = np.random.RandomState(seeds[1])  # the type that Nevergrad requires
            with _library():
                optimizer = copy.deepcopy(_registry()[self.algorithm])(box, budget=planned(problem, self.horizon))
            while problem.remaining:
                with _library():
                    candidate = optimizer.ask()
                value = finite.one(problem(from_unit(problem, candidate.value)))
                with _library():
                    optimizer.tell(candidate, value)


def _registry() -> Mapping[str, Any]:
    """Return the optimizers by name."""
    with _quiet():
        from nevergrad.optimization import registry
    return dict(registry)


@contextlib.contextmanager
def _library() -> Iterator[None]:
    """Call the library without its warnings; raise Incompatible if it needs something that does not work here."""
    where = "for this budget and number of unknowns"
    try:
        with _quiet():
            yield
    except ModuleNotFoundError as error:
        raise Incompatible(f"{where}, it needs the module {error.name}, which is not installed here") from error
    except TypeError as error:
        if "array" in str(error) and surrogates_fail():
            raise Incompatible(f"{where}, {surrogates_fail()}") from error
        raise


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Suppress NumPy's warnings and Nevergrad's warnings about inefficient settings."""
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        yield
