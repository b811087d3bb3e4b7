"""Writes plugin files that work as they are, for ``nfbench new``."""

from __future__ import annotations

import re
from pathlib import Path

from nfbench.core import NfbenchError

from .registry import Registry

__all__ = ["write_template"]

SOLVER = '''"""The solver {name} of nfbench: to make your own of.

nfbench check solver {file}            says whether it keeps the contract of solvers
nfbench run STUDY.toml --plugin {file} runs it, with `[[solver]]` and `kind = "{name}"` in the manifest
"""

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from nfbench import Gt, Le, Solver, SolverInfo


@dataclass(frozen=True)  # makes the annotated fields below its options
class {cls}(Solver):
    """(1+1) evolution strategy with the 1/5 success rule, begun anew where its steps have become tiny.

    step: the first step, as a fraction of the box's width.
    least_step: below this the search begins anew at a random point.
    """

    name: ClassVar[str] = "{name}"
    info: ClassVar[SolverInfo] = SolverInfo(  # what tables and groups go by, and what the checks hold it to
        stochastic=True,
        batched=False,
        needs_gradient=False,
        global_search=True,
        converges=True,
        reference="Rechenberg 1973",
    )

    step: Annotated[float, Gt(0.0), Le(1.0)] = 0.2  # checked when it is made: a wrong value is told before a run begins
    least_step: Annotated[float, Gt(0.0), Le(1.0)] = 1e-7

    def minimize(self, problem, rng):
        """Ask problem(x) for a value, or problem.evaluate(X) for those of the rows of X; draw from rng alone.

        Nothing is returned: the meter knows the best point. The loop has no end, as the budget ends it.
        """
        while True:
            u = rng.random(problem.dimension)  # in the unit box, so that steps mean the same along every axis
            value, step = problem(problem.from_unit(u)), self.step
            while step >= self.least_step:
                v = np.clip(u + step * rng.standard_normal(len(u)), 0.0, 1.0)  # a point outside would be refused
                new = problem(problem.from_unit(v))
                if new <= value:
                    u, value, step = v, new, min(1.5 * step, 1.0)
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
def test_it_keeps_the_contract(check):
    (result,) = solver_checks({cls}(), only=[check])
    assert result.passed, result.message


def test_it_finds_the_minimum_of_a_sphere():
    instance = Functions(function="sphere", dimension=3).draw(np.random.default_rng(1))
    assert minimize(instance.problem, {cls}(), budget=5000, seed=1).value < 1e-8
'''

PROBLEM = '''"""The scenario {name} of nfbench: to make your own of.

nfbench check problem {file}           says whether scenario and problem keep their contracts
nfbench run STUDY.toml --plugin {file} runs it, with `[scenario]` and `kind = "{name}"` in the manifest

A hidden point in a square sends a signal to anchors around it; from the noisy distances its place is to be found.
"""

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from nfbench import Ge, Gt, Instance, Problem, ProblemInstance, Scenario


class {cls}Problem(Problem):
    """Sum of squared differences [m²] of the distances to x = (x, y) [m] and those measured."""

    has_gradient = True  # leave it out, and value_and_gradient too, where there is none

    def __init__(self, anchors, distances, width):
        self.anchors, self.distances = anchors, distances  # (a, 2) and (a,), both in m
        self.lower, self.upper = np.zeros(2), np.full(2, width)

    def evaluate(self, X):  # X is (p, 2), the answer (p,): each row by itself
        lengths = np.linalg.norm(X[:, None, :] - self.anchors, axis=2)
        return ((lengths - self.distances) ** 2).sum(axis=1)

    def value_and_gradient(self, x):
        offsets = x - self.anchors
        lengths = np.maximum(np.linalg.norm(offsets, axis=1), 1e-12)
        errors = lengths - self.distances
        return float((errors**2).sum()), 2.0 * (errors / lengths) @ offsets


class {cls}Instance(ProblemInstance):
    """One draw. As a ProblemInstance it is solved by the formulation `direct`: one problem, its minimizer the estimate.

    Where an estimate takes more than that, derive from nfbench.Instance, and a nfbench.Formulation that accepts it.
    """

    def __init__(self, problem, place):
        self.problem, self.place = problem, place

    def truth(self):
        return self.place

    def score(self, estimate):
        if np.shape(estimate) != (2,):
            raise ValueError(f"estimate: expected shape (2,), got {{np.shape(estimate)}}")
        return {{"error_m": float(np.linalg.norm(estimate - self.place))}}


@dataclass(frozen=True)  # makes the annotated fields below its options
class {cls}(Scenario):
    """Noisy distances to anchors on a circle, from which a point in a square is to be found.

    anchors: how many. noise_m: standard deviation of the distances [m]. width_m: side of the square [m].
    """

    name: ClassVar[str] = "{name}"
    instance: ClassVar[type[Instance]] = {cls}Instance
    error: ClassVar[str] = "error_m"  # the score that methods are ranked by

    anchors: Annotated[int, Ge(3)] = 4
    noise_m: Annotated[float, Ge(0.0)] = 0.05
    width_m: Annotated[float, Gt(0.0)] = 10.0

    def draw(self, rng):
        """Draw from rng alone, so that every method and every computer sees the same."""
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


def test_scenario_and_problem_keep_their_contracts():
    check_scenario({cls}(), [Direct()])


def test_without_noise_the_minimizer_is_the_truth():
    instance = {cls}(noise_m=0.0).draw(np.random.default_rng(1))
    found = nfbench.minimize(instance.problem, nfbench.solver("de"), budget=4000, seed=1)
    assert instance.score(found.x)["error_m"] < 1e-3
'''

FILES = {"solver": (SOLVER, SOLVER_TEST), "problem": (PROBLEM, PROBLEM_TEST)}
KINDS = {"solver": "solver", "problem": "scenario"}


def write_template(kind: str, name: str, out: Path | None = None) -> tuple[Path, Path]:
    """Write the plugin file (default: the name with .py) and, beside it, its test; both are returned.

    kind: "solver" or "problem". Raises NfbenchError for a name that is no slug or is taken, and where a file exists.
    """
    if not re.fullmatch(r"[a-z][a-z0-9]*(-[a-z0-9]+)*", name):
        raise NfbenchError(f"name: expected lower-case words joined by hyphens, e.g. my-{kind}, got {name!r}")
    if name in (taken := Registry()).names(KINDS[kind]):
        raise NfbenchError(f"name: {name!r} is a {KINDS[kind]} of {taken.find(KINDS[kind], name).origin} already")
    file = Path(f"{name.replace('-', '_')}.py") if out is None else out
    if file.suffix != ".py" or not file.stem.isidentifier():
        raise NfbenchError(f"--out: expected a Python file like my_{kind}.py, got {file}")
    if not file.parent.is_dir():
        raise NfbenchError(f"--out: expected an existing folder, got {file.parent}")
    test = file.with_name(f"test_{file.name}")
    for path in (file, test):
        if path.exists():
            raise NfbenchError(f"{path} exists already and is left as it is; choose another place by --out")
    words = {"name": name, "cls": "".join(part.capitalize() for part in name.split("-")), "module": file.stem}
    for path, text in zip((file, test), FILES[kind], strict=True):
        path.write_text(text.format(**words, file=file.name), encoding="utf-8")
    return file, test
