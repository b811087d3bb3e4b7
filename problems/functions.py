"""Test functions with a known minimum, to check solvers and to compare them on problems other than localization."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal, TypeAlias, final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nfbench import Formulation, Ge, Instance, Le, Minimize, Problem, ProblemInstance, Scenario

__all__ = ["Direct", "FunctionInstance", "FunctionProblem", "Functions", "Shape"]

Batch: TypeAlias = Float[ndarray, "p n"]
Values: TypeAlias = Float[ndarray, " p"]
Point: TypeAlias = Float[ndarray, " n"]

MARGIN = 0.1  # distance of a shifted minimum from the faces, as a fraction of the width of the box


def sphere(z: Batch) -> Values:
    """Return Σ z_j²."""
    return np.asarray((z * z).sum(axis=1))


def sphere_gradient(z: Point) -> Point:
    return 2.0 * z


def rosenbrock(z: Batch) -> Values:
    """Return Σ 100·(z_{j+1} - z_j²)² + (1 - z_j)², whose minimum is at z_j = 1."""
    head, tail = z[:, :-1], z[:, 1:]
    return np.asarray((100.0 * (tail - head**2) ** 2 + (1.0 - head) ** 2).sum(axis=1))


def rosenbrock_gradient(z: Point) -> Point:
    head, bend = z[:-1], z[1:] - z[:-1] ** 2
    gradient = np.zeros_like(z)
    gradient[:-1] = -400.0 * head * bend - 2.0 * (1.0 - head)
    gradient[1:] += 200.0 * bend
    return gradient


def rastrigin(z: Batch) -> Values:
    """Return Σ z_j² + 10·(1 - cos 2πz_j), computed with 1 - cos 2x = 2·sin² x, which is accurate for small values."""
    return np.asarray((z * z + 20.0 * np.sin(math.pi * z) ** 2).sum(axis=1))


def rastrigin_gradient(z: Point) -> Point:
    return 2.0 * z + 20.0 * math.pi * np.sin(2.0 * math.pi * z)


def ackley(z: Batch) -> Values:
    """Return 20·(1 - exp(-0.2·√mean z²)) + e - exp(mean cos 2πz), in a form that is accurate for small values."""
    radius = np.sqrt((z * z).mean(axis=1))
    waves = 2.0 * (np.sin(math.pi * z) ** 2).mean(axis=1)  # 1 - mean cos
    return np.asarray(-20.0 * np.expm1(-0.2 * radius) - math.e * np.expm1(-waves))


def ackley_gradient(z: Point) -> Point:
    """Return the gradient; it is set to 0 at the minimum, where the function has a cusp."""
    radius = math.sqrt((z * z).mean())
    waves = 2.0 * math.pi * math.exp(np.cos(2.0 * math.pi * z).mean()) * np.sin(2.0 * math.pi * z)
    return np.asarray(((4.0 * math.exp(-0.2 * radius) / radius) * z + waves) / len(z)) if radius else np.zeros_like(z)


def griewank(z: Batch) -> Values:
    """Return 1 + Σ z_j²/4000 - Π cos(z_j/√j)."""
    root = np.sqrt(np.arange(1.0, z.shape[1] + 1.0))
    return np.asarray(1.0 + (z * z).sum(axis=1) / 4000.0 - np.cos(z / root).prod(axis=1))


def griewank_gradient(z: Point) -> Point:
    root = np.sqrt(np.arange(1.0, len(z) + 1.0))
    others = np.tile(np.cos(z / root), (len(z), 1))  # row j: the factors of the product other than z_j's
    np.fill_diagonal(others, 1.0)
    return np.asarray(z / 2000.0 + others.prod(axis=1) * np.sin(z / root) / root)


SCHWEFEL_PLACE = 420.968746359982  # the root of sin √z + ½√z·cos √z = 0 in the deepest valley
SCHWEFEL_DEPTH = SCHWEFEL_PLACE * math.sin(math.sqrt(SCHWEFEL_PLACE))


def schwefel(z: Batch) -> Values:
    """Return Σ 418.98… - z_j·sin √|z_j|, whose minimum is at z_j = 420.97…

    Beyond ±500 a term is its value at the edge plus (|z_j| - 500)²/100.
    """
    inner = np.clip(z, -500.0, 500.0)
    waves = inner * np.sin(np.sqrt(np.abs(inner)))
    return np.asarray((SCHWEFEL_DEPTH - waves + 0.01 * (z - inner) ** 2).sum(axis=1))


def schwefel_gradient(z: Point) -> Point:
    root = np.sqrt(np.abs(z))
    beyond = z - np.clip(z, -500.0, 500.0)
    return np.asarray(np.where(beyond == 0.0, -np.sin(root) - 0.5 * root * np.cos(root), 0.02 * beyond))


@dataclass(frozen=True)
class Shape:
    """A test function.

    value: function of a batch (p, n) that returns the values (p,).
    gradient: function of a point (n,) that returns the gradient (n,).
    low: lower end of the usual box [low, high]ⁿ.
    high: upper end of the usual box.
    place: coordinate z_j* of the minimum, equal for all j.
    """

    value: Callable[[Batch], Values]
    gradient: Callable[[Point], Point]
    low: float
    high: float
    place: float


SHAPES = {
    "sphere": Shape(sphere, sphere_gradient, -5.12, 5.12, 0.0),
    "rosenbrock": Shape(rosenbrock, rosenbrock_gradient, -5.0, 10.0, 1.0),
    "rastrigin": Shape(rastrigin, rastrigin_gradient, -5.12, 5.12, 0.0),
    "ackley": Shape(ackley, ackley_gradient, -32.768, 32.768, 0.0),
    "griewank": Shape(griewank, griewank_gradient, -600.0, 600.0, 0.0),
    "schwefel": Shape(schwefel, schwefel_gradient, -500.0, 500.0, SCHWEFEL_PLACE),
}


@final
class FunctionProblem(Problem):
    """f(R·(x - x*) + z*): a function whose minimum is moved from z* to x*, and which is rotated about it by R.

    shape: the function f.
    optimum: minimizer x*, shape (n,); the value there is 0 up to rounding.
    rotation: orthogonal matrix R, shape (n, n); None: the identity.
    """

    has_gradient: ClassVar[bool] = True

    def __init__(self, shape: Shape, optimum: Point, rotation: Float[ndarray, "n n"] | None = None) -> None:
        self.shape, self.optimum, self.rotation = shape, optimum, rotation
        self.minimum = 0.0
        self.lower, self.upper = np.full(len(optimum), shape.low), np.full(len(optimum), shape.high)

    def evaluate(self, X: Batch) -> Values:
        return self.shape.value(self._original(X))

    def value_and_gradient(self, x: Point) -> tuple[float, Point]:
        z = self._original(x[None, :])
        gradient = self.shape.gradient(z[0])
        return float(self.shape.value(z)[0]), gradient if self.rotation is None else gradient @ self.rotation

    def _original(self, X: Batch) -> Batch:
        """Return z = R·(x - x*) + z* for each row x."""
        moved = X - self.optimum
        rotated = moved if self.rotation is None else moved @ self.rotation.T
        return np.asarray(rotated + self.shape.place)


@final
class FunctionInstance(ProblemInstance):
    """A test function to minimize; an estimate is a point of its box."""

    problem: FunctionProblem

    def __init__(self, problem: FunctionProblem) -> None:
        self.problem = problem

    def truth(self) -> Point:
        return self.problem.optimum

    def score(self, estimate: Point) -> dict[str, float]:
        """Return the scores of an estimate (n,); raises ValueError if its shape is wrong.

        gap: f(x) - f*, at least 0.
        distance: ‖x - x*‖ as a fraction of the diagonal of the box.
        """
        estimate = np.asarray(estimate, dtype=np.float64)
        problem = self.problem
        if estimate.shape != problem.lower.shape:
            raise ValueError(f"estimate: expected shape {problem.lower.shape}, got {estimate.shape}")
        distance = np.linalg.norm(estimate - problem.optimum) / np.linalg.norm(problem.upper - problem.lower)
        return {"gap": max(problem.value(estimate), 0.0), "distance": float(distance)}

    def errors(self, measure: str, estimates: Batch) -> Values:
        if measure != "gap":
            return super().errors(measure, estimates)
        return np.maximum(self.problem.evaluate(estimates), 0.0)


@dataclass(frozen=True)
class Functions(Scenario):
    """Classical test functions in their usual boxes, with the minimum value 0 at a known point inside the box.

    function: name of the function. Its box is [-5.12, 5.12]ⁿ for sphere and rastrigin, [-5, 10]ⁿ for rosenbrock (which
        needs n >= 2), [-32.768, 32.768]ⁿ for ackley, [-600, 600]ⁿ for griewank and [-500, 500]ⁿ for schwefel.
    dimension: number n of unknowns, at most 1000.
    shifted: whether to move the minimum to a random point, uniform in the inner 80 % of the box along each axis; false:
        the minimum is at its classical place.
    rotated: whether to rotate the function about its minimum by a random orthogonal matrix.

    The box does not move, so a shifted or rotated function is also evaluated outside its usual domain. All functions
    except schwefel are nonnegative everywhere. Beyond ±500, schwefel is its value at the edge plus (|z| - 500)²/100, so
    that it is also nonnegative, and 0 only at its minimum.
    """

    function: Literal["sphere", "rosenbrock", "rastrigin", "ackley", "griewank", "schwefel"] = "rastrigin"
    dimension: Annotated[int, Ge(1), Le(1000)] = 2
    shifted: bool = True
    rotated: bool = False

    instance: ClassVar[type[Instance]] = FunctionInstance
    error: ClassVar[str] = "gap"

    def validate(self) -> None:
        if self.function == "rosenbrock" and self.dimension < 2:
            raise ValueError(f"dimension: expected at least 2 for rosenbrock, got {self.dimension}")

    def draw(self, rng: np.random.Generator) -> FunctionInstance:
        """Draw the instance; shift and rotation are always drawn, so that switching off one keeps the other."""
        shape, n = SHAPES[self.function], self.dimension
        shift = shape.low + (MARGIN + (1.0 - 2.0 * MARGIN) * rng.random(n)) * (shape.high - shape.low)
        rotation = _orthogonal(n, rng)
        optimum = shift if self.shifted else np.full(n, shape.place)
        return FunctionInstance(FunctionProblem(shape, optimum, rotation if self.rotated else None))


@dataclass(frozen=True)
class Direct(Formulation):
    """Minimizes the problem of the instance once; the minimizer is the estimate."""

    accepts: ClassVar[type[Instance]] = ProblemInstance  # type: ignore[type-abstract]  # any subclass

    def estimates(self, instance: ProblemInstance, X: Batch) -> Batch:
        return X

    def solve(self, instance: ProblemInstance, minimize: Minimize) -> Point:
        return minimize(instance.problem).x


def _orthogonal(n: int, rng: np.random.Generator) -> Float[ndarray, "n n"]:
    """Draw an orthogonal matrix (n, n), uniform with respect to the Haar measure (Mezzadri 2007)."""
    q, r = np.linalg.qr(rng.standard_normal((n, n)))
    return np.asarray(q * np.where(np.diag(r) < 0.0, -1.0, 1.0))
