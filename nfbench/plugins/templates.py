"""Writes new plugin files for ``nfbench new``. The files work without changes."""

from __future__ import annotations

import re
from pathlib import Path

from nfbench.core import NfbenchError

from .registry import Registry

__all__ = ["write_template"]

SOLVER = '''"""The solver {name} for nfbench. Replace the algorithm with your own.

To check that it conforms to the solver contract:
    nfbench check solver {file}

To use it in a study, add `[[solver]]` with `kind = "{name}"` to the manifest and run:
    nfbench run STUDY.toml --plugin {file}
"""

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from nfbench import Gt, Le, Solver, SolverInfo


@dataclass(frozen=True)  # turns the annotated fields below into options
class {cls}(Solver):
    """(1+1) evolution strategy with the 1/5 success rule, restarted when its steps become tiny.

    step: standard deviation of the first step, as a fraction of the box's width.
    least_step: standard deviation, as a fraction of the box's width, below which the search restarts at a random point.
    """

    name: ClassVar[str] = "{name}"
    info: ClassVar[SolverInfo] = SolverInfo(  # shown in tables, used to form groups, and verified by the checks
        stochastic=True,
        batched=False,
        needs_gradient=False,
        global_search=True,
        converges=True,
        reference="Rechenberg 1973",
    )

    step: Annotated[float, Gt(0.0), Le(1.0)] = 0.2  # an invalid value is reported before any run starts
    least_step: Annotated[float, Gt(0.0), Le(1.0)] = 1e-7

    def minimize(self, problem, rng):
        """Minimize ``problem``, drawing all random numbers from ``rng``.

        ``problem(x)`` returns the value at one point, and ``problem.evaluate(X)`` the values at the rows of ``X``.
        There is nothing to return, because nfbench keeps the best point. The loop needs no stopping rule: when the
        budget is used up, the next evaluation raises an exception that ends the run.
        """
        while True:
            u = rng.random(problem.dimension)  # a point of the unit box, in which all axes have the same scale
            value, step = problem(problem.from_unit(u)), self.step
            while step >= self.least_step:
                v = np.clip(u + step * rng.standard_normal(len(u)), 0.0, 1.0)  # stay in the box
                new_value = problem(problem.from_unit(v))
                if new_value <= value:  # longer steps after a success, shorter ones after a failure
                    u, value, step = v, new_value, min(1.5 * step, 1.0)
                else:
                    step *= 0.9
'''

SOLVER_TEST = '''"""Tests of the solver {name}."""

import numpy as np
import pytest
from {module} import {cls}

from nfbench import minimize
from nfbench.problems.functions import Functions
from nfbench.testing import check_names, solver_checks


@pytest.mark.parametrize("check", check_names())
def test_solver_conforms_to_the_contract(check):
    (result,) = solver_checks({cls}(), only=[check])
    assert result.passed, result.message


def test_solver_finds_the_minimum_of_a_sphere():
    instance = Functions(function="sphere", dimension=3).draw(np.random.default_rng(1))
    assert minimize(instance.problem, {cls}(), budget=5000, seed=1).value < 1e-8
'''

PROBLEM = '''"""The scenario {name} for nfbench. Replace the scenario and its problem with your own.

In this example, the unknown is a point in a square. It is estimated from noisy distances to anchors around the square.

To check that the scenario and its problem conform to their contracts:
    nfbench check problem {file}

To use the scenario in a study, set `kind = "{name}"` in the `[scenario]` table of the manifest and run:
    nfbench run STUDY.toml --plugin {file}
"""

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from nfbench import Ge, Gt, Instance, Problem, ProblemInstance, Scenario


class {cls}Problem(Problem):
    """Sum of squared differences [m²] between the measured distances and the distances from the point (x, y) [m]."""

    has_gradient = True  # if your problem has no gradient, remove this line and value_and_gradient

    def __init__(self, anchors, distances, width):
        self.anchors, self.distances = anchors, distances  # (a, 2) [m] and (a,) [m]
        self.lower, self.upper = np.zeros(2), np.full(2, width)

    def evaluate(self, X):
        """Return the values at the points in the rows of ``X``: (p, 2) -> (p,)."""
        lengths = np.linalg.norm(X[:, None, :] - self.anchors, axis=2)
        return ((lengths - self.distances) ** 2).sum(axis=1)

    def value_and_gradient(self, x):
        """Return the value and the gradient at one point ``x``, (2,)."""
        offsets = x - self.anchors
        lengths = np.maximum(np.linalg.norm(offsets, axis=1), 1e-12)  # avoids dividing by zero at an anchor
        errors = lengths - self.distances
        return float((errors**2).sum()), 2.0 * (errors / lengths) @ offsets


class {cls}Instance(ProblemInstance):
    """One draw of the scenario: the problem and the true position, ``place`` (2,) [m].

    The formulation `direct` solves any ProblemInstance: it minimizes the problem and takes the minimizer as the
    estimate. If computing an estimate takes more than one minimization, derive this class from nfbench.Instance instead
    and write an nfbench.Formulation that accepts it.
    """

    def __init__(self, problem, place):
        self.problem, self.place = problem, place

    def truth(self):
        """Return the estimate whose error is 0, which the checks use."""
        return self.place

    def score(self, estimate):
        """Return the errors of an estimate by column name."""
        if np.shape(estimate) != (2,):
            raise ValueError(f"estimate: expected shape (2,), got {{np.shape(estimate)}}")
        return {{"error_m": float(np.linalg.norm(estimate - self.place))}}


@dataclass(frozen=True)  # turns the annotated fields below into options
class {cls}(Scenario):
    """Noisy distances between a point in a square and anchors on a circle around it.

    anchors: number of anchors.
    noise_m: standard deviation of the noise on each distance [m].
    width_m: side length of the square [m].
    """

    name: ClassVar[str] = "{name}"
    instance: ClassVar[type[Instance]] = {cls}Instance
    error: ClassVar[str] = "error_m"  # the score by which methods are ranked; smaller is better

    anchors: Annotated[int, Ge(3)] = 4
    noise_m: Annotated[float, Ge(0.0)] = 0.05
    width_m: Annotated[float, Gt(0.0)] = 10.0

    def draw(self, rng):
        """Return one draw. All random numbers come from ``rng``, so that every method gets the same data."""
        angle = 2.0 * np.pi * np.arange(self.anchors) / self.anchors
        anchors = self.width_m * (0.5 + 0.6 * np.column_stack([np.cos(angle), np.sin(angle)]))
        place = rng.uniform(0.1, 0.9, 2) * self.width_m
        distances = np.linalg.norm(anchors - place, axis=1) + self.noise_m * rng.standard_normal(self.anchors)
        return {cls}Instance({cls}Problem(anchors, distances, self.width_m), place)
'''

PROBLEM_TEST = '''"""Tests of the scenario {name}."""

import numpy as np
from {module} import {cls}

import nfbench
from nfbench.problems.functions import Direct
from nfbench.testing import check_scenario


def test_scenario_and_problem_conform_to_their_contracts():
    check_scenario({cls}(), [Direct()])


def test_without_noise_the_minimizer_is_the_truth():
    instance = {cls}(noise_m=0.0).draw(np.random.default_rng(1))
    found = nfbench.minimize(instance.problem, nfbench.solver("de"), budget=4000, seed=1)
    assert instance.score(found.x)["error_m"] < 1e-3
'''

FILES = {"solver": (SOLVER, SOLVER_TEST), "problem": (PROBLEM, PROBLEM_TEST)}
KINDS = {"solver": "solver", "problem": "scenario"}


def write_template(kind: str, name: str, out: Path | None = None) -> tuple[Path, Path]:
    """Write a plugin file and, in the same folder, a file with its tests; return both paths.

    kind: "solver" or "problem".
    name: name under which the plugin is registered, e.g. "my-solver".
    out: path of the plugin file; None for a file in the current folder that is named after the plugin.

    Raises NfbenchError if the name is invalid or in use, or if ``out`` is not a Python file in an existing folder. An
    existing file is not overwritten and also raises NfbenchError.
    """
    if not re.fullmatch(r"[a-z][a-z0-9]*(-[a-z0-9]+)*", name):
        raise NfbenchError(f"name: expected lower-case words joined by hyphens, e.g. my-{kind}, got {name!r}")
    if name in (registry := Registry()).names(KINDS[kind]):
        origin = registry.find(KINDS[kind], name).origin
        raise NfbenchError(f"name: expected a new name, got {name!r}, which is a {KINDS[kind]} of {origin}")
    file = Path(f"{name.replace('-', '_')}.py") if out is None else out
    if file.suffix != ".py" or not file.stem.isidentifier():
        raise NfbenchError(f"--out: expected a Python file like my_{kind}.py, got {file}")
    if not file.parent.is_dir():
        raise NfbenchError(f"--out: expected an existing folder, got {file.parent}")
    test = file.with_name(f"test_{file.name}")
    for path in (file, test):
        if path.exists():
            raise NfbenchError(f"{path} already exists and was not changed; choose another path with --out")
    words = {"name": name, "cls": "".join(part.capitalize() for part in name.split("-")), "module": file.stem}
    for path, text in zip((file, test), FILES[kind], strict=True):
        path.write_text(text.format(**words, file=file.name), encoding="utf-8")
    return file, test
