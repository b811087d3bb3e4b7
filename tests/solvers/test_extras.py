"""Adapters of optional libraries: one not installed says so, one installed keeps the contract with its algorithms."""

import importlib.util
import subprocess
import sys
import typing

import numpy as np
import pytest

import nfbench
from nfbench import MissingExtra, OptionError, Status
from nfbench.plugins.registry import Registry
from nfbench.problems.functions import Functions
from nfbench.testing import solver_checks

NAMES = ("fcmaes", "minionpy", "nevergrad", "optuna", "pygmo", "pymoo")
CLASSES = {name: Registry().find("solver", name).resolve() for name in NAMES}
QUICK = [
    "budget",
    "stops-when-told",
    "errors-pass",
    "bounds",
    "same-seed",
    "global-random-untouched",
    "constant",
    "quiet",
]
NEVERGRAD = ("TwoPointsDE", "DE", "PSO", "RealSpacePSO", "OnePlusOne", "CMA", "TBPSA", "ScrHammersleySearch", "Cobyla")


def algorithms(name):
    hint = typing.get_type_hints(CLASSES[name])["algorithm"]
    return NEVERGRAD if name == "nevergrad" else typing.get_args(hint)


def present(name):
    return all(importlib.util.find_spec(module) for module in CLASSES[name].info.requires)


def parameters():
    """Every algorithm of every adapter; of the libraries that take a millisecond a point, most are slow tests."""
    for name in NAMES:
        for algorithm in algorithms(name):
            marks = [pytest.mark.skipif(not present(name), reason=f"pip install 'nfbench[{name}]'")]
            if name in ("nevergrad", "optuna") and algorithm not in ("DE", "OnePlusOne", "nsgaii"):
                marks.append(pytest.mark.slow)
            yield pytest.param(name, algorithm, marks=marks)


@pytest.mark.parametrize(("name", "algorithm"), [*parameters()])
def test_an_algorithm_keeps_budget_box_seed_and_stop(name, algorithm):
    for result in solver_checks(nfbench.solver(name, algorithm=algorithm), only=QUICK):
        assert result.passed, f"{result.name}: {result.message}"


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in NAMES if present(name)])
def test_the_default_algorithm_passes_every_check(name):
    for result in solver_checks(nfbench.solver(name)):
        assert result.passed, f"{result.name}: {result.message}"


@pytest.mark.parametrize(("name", "algorithm"), [*parameters()])
def test_an_algorithm_searches_rather_than_samples(name, algorithm):
    """After 1,500 evaluations of a sphere in 4 unknowns it is mostly lower than the best of 1,500 random points."""
    exempt = algorithm in ("random", "qmc", "ScrHammersleySearch", "PGPE", "ACMA")
    if exempt or (name, algorithm) == ("nevergrad", "PSO"):
        return  # three sample, PGPE takes longer, ACMA may stop far off, and Nevergrad's PSO sticks to the bounds
    instance = Functions(function="sphere", dimension=4).draw(np.random.default_rng(4))
    solver = nfbench.solver(name, algorithm=algorithm)
    minima = [nfbench.minimize(instance.problem, solver, 1500, seed) for seed in range(3)]
    assert all(minimum.status is Status.OK and minimum.evaluations <= 1500 for minimum in minima)
    points = np.random.default_rng(1).uniform(-5.12, 5.12, (1500, 4))
    assert np.median([minimum.value for minimum in minima]) < 0.5 * instance.problem.evaluate(points).min()


def test_no_adapter_imports_its_library_before_it_runs(tmp_path):
    code = f"""
import sys
from nfbench.registry import Registry
registry = Registry()
for name in {NAMES}:
    registry.find("solver", name).missing()
print([name for name in {NAMES} if name in sys.modules])
"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60, cwd=tmp_path
    )
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("name", NAMES)
def test_without_its_library_a_solver_says_how_to_install_it(name, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda module: None)
    with pytest.raises(
        MissingExtra, match=rf"solver {name} needs .*not installed here: pip install 'nfbench\[{name}\]'"
    ):
        nfbench.solver(name)
    with pytest.raises(OptionError, match="popularity: unknown option"):
        nfbench.solver(name, popularity=3)  # the options are checked all the same


@pytest.mark.skipif(not present("nevergrad"), reason="pip install 'nfbench[nevergrad]'")
def test_nevergrad_suggests_the_nearest_optimizer():
    with pytest.raises(
        OptionError, match="expected an optimizer of Nevergrad, got 'TwoPointDE'; did you mean TwoPointsDE"
    ):
        nfbench.solver("nevergrad", algorithm="TwoPointDE")


@pytest.mark.parametrize(("name", "algorithm"), [("pymoo", "CMAES"), ("optuna", "tpe")])
def test_a_population_for_what_has_none_is_refused(name, algorithm):
    with pytest.raises(OptionError, match=f"population: expected none, as {algorithm} has no population, got 20"):
        CLASSES[name](algorithm=algorithm, population=20)
