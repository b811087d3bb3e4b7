"""The 24 noiseless BBOB functions, a standard benchmark of optimizers, from either of two libraries."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal, TypeAlias, final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nfbench import Extra, Ge, Instance, Le, Problem, ProblemInstance, Scenario

__all__ = ["BBOB", "BBOBInstance", "BBOBProblem", "Backend"]

Batch: TypeAlias = Float[ndarray, "p n"]
Values: TypeAlias = Float[ndarray, " p"]
Point: TypeAlias = Float[ndarray, " n"]
Backend: TypeAlias = Literal["coco", "ioh"]

INSTANCES = 1000
MODULES: dict[Backend, str] = {"coco": "cocoex", "ioh": "ioh"}


@final
class BBOBProblem(Problem):
    """A BBOB function over [-5, 5]ⁿ. Its values include the offset f_opt, as in COCO.

    backend: library that computes the function, "coco" or "ioh".
    function: number of the function, 1 to 24.
    dimension: number n of unknowns.
    instance: COCO's number of the instance.

    The attribute ``optimum`` is the minimizer x_opt (n,), ``f_opt`` the value there, and ``instance_id`` the number.
    """

    def __init__(self, backend: Backend, function: int, dimension: int, instance: int) -> None:
        self.lower, self.upper = np.full(dimension, -5.0), np.full(dimension, 5.0)
        self.instance_id = instance
        library = _coco if backend == "coco" else _ioh
        self.f, self.optimum, self.f_opt = library(function, dimension, instance)
        self.minimum = self.f_opt

    def evaluate(self, X: Batch) -> Values:
        return self.f(X)


@final
class BBOBInstance(ProblemInstance):
    """A BBOB function to minimize; an estimate is a point of its box."""

    problem: BBOBProblem

    def __init__(self, problem: BBOBProblem) -> None:
        self.problem = problem

    def truth(self) -> Point:
        return self.problem.optimum

    def score(self, estimate: Point) -> dict[str, float]:
        """Return the scores of an estimate (n,); raises ValueError if its shape is wrong.

        gap: f(x) - f_opt, at least 0.
        distance: ‖x - x_opt‖ as a fraction of the diagonal of the box.
        instance_id: COCO's number of the instance.
        """
        estimate = np.asarray(estimate, dtype=np.float64)
        problem = self.problem
        if estimate.shape != problem.lower.shape:
            raise ValueError(f"estimate: expected shape {problem.lower.shape}, got {estimate.shape}")
        distance = np.linalg.norm(estimate - problem.optimum) / np.linalg.norm(problem.upper - problem.lower)
        gap = max(problem.value(estimate) - problem.f_opt, 0.0)
        return {"gap": gap, "distance": float(distance), "instance_id": float(problem.instance_id)}

    def errors(self, measure: str, estimates: Batch) -> Values:
        if measure != "gap":
            return super().errors(measure, estimates)
        return np.maximum(self.problem.evaluate(estimates) - self.problem.f_opt, 0.0)


@dataclass(frozen=True)
class BBOB(Scenario):
    """The noiseless BBOB functions (Hansen, Finck, Ros & Auger 2009) in [-5, 5]ⁿ, without COCO's files and logs.

    function: number of the function: 1 sphere, 2 ellipsoid, 3 Rastrigin, 4 Büche-Rastrigin, 5 linear slope,
        6 attractive sector, 7 step ellipsoid, 8 Rosenbrock, 9 rotated Rosenbrock, 10 rotated ellipsoid, 11 discus,
        12 bent cigar, 13 sharp ridge, 14 different powers, 15 rotated Rastrigin, 16 Weierstrass, 17 Schaffer F7,
        18 ill-conditioned Schaffer F7, 19 Griewank-Rosenbrock, 20 Schwefel, 21 Gallagher's 101 peaks, 22 Gallagher's
        21 peaks, 23 Katsuura, 24 Lunacek bi-Rastrigin.
    dimension: number n of unknowns, 2 to 40 as in the BBOB suite.
    instance_id: COCO's number of the instance, which determines x_opt, f_opt and the rotations; None: each scene draws
        a number from 1 to 1000.
    backend: library that computes the functions: "coco" is the library of the authors (extra coco), "ioh" is
        IOHexperimenter (extra ioh). Both have the same instances, and their values agree up to rounding except for
        function 7 on its lowest step around x_opt. There ioh is constant, whereas the definition and coco rise from
        f_opt by up to 5e-7.
    """

    function: Annotated[int, Ge(1), Le(24)] = 1
    dimension: Annotated[int, Ge(2), Le(40)] = 2
    instance_id: Annotated[int, Ge(1), Le(INSTANCES)] | None = None
    backend: Backend = "coco"

    instance: ClassVar[type[Instance]] = BBOBInstance
    error: ClassVar[str] = "gap"

    def needed_extra(self) -> Extra:
        return Extra(self.backend, (MODULES[self.backend],))

    def warm_up(self) -> None:
        importlib.import_module(MODULES[self.backend])

    def draw(self, rng: np.random.Generator) -> BBOBInstance:
        """Draw the number of the instance unless ``instance_id`` is given."""
        number = self.instance_id or int(rng.integers(1, INSTANCES, endpoint=True))
        return BBOBInstance(BBOBProblem(self.backend, self.function, self.dimension, number))


def _coco(function: int, dimension: int, number: int) -> tuple[Callable[[Batch], Values], Point, float]:
    """Return f, x_opt and f_opt from COCO's library, which crashes outside its 24 functions and 2 to 40 unknowns."""
    from cocoex import BareProblem

    f = BareProblem("bbob", function, dimension, number)
    return lambda X: f(np.array(X)), f.best_parameter(), f.best_value()  # f does not accept read-only arrays


def _ioh(function: int, dimension: int, number: int) -> tuple[Callable[[Batch], Values], Point, float]:
    """Return f, x_opt and f_opt from IOHexperimenter (de Nobel et al. 2024)."""
    from ioh import ProblemClass, get_problem

    f = get_problem(function, number, dimension, ProblemClass.BBOB)
    return lambda X: np.array(f(X)), np.array(f.optimum.x), f.optimum.y
