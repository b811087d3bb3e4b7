"""Adapters of optional libraries: a missing library is reported, and the algorithms of installed ones pass checks."""

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
TOO_SLOW = {"BO", "BOSplit"}  # of Nevergrad: a Gaussian process is fitted for every point
PIECES = 40  # into which the algorithms are divided, so that a run of the tests can be divided too
NEVERGRAD = ("TwoPointsDE", "DE", "PSO", "RealSpacePSO", "OnePlusOne", "CMA", "TBPSA", "ScrHammersleySearch", "Cobyla")


def algorithms(name):
    hint = typing.get_type_hints(CLASSES[name])["algorithm"]
    return NEVERGRAD if name == "nevergrad" else typing.get_args(hint)


def every_algorithm(name):
    """Every algorithm that works here; those of Nevergrad from its registry."""
    if name != "nevergrad":
        return algorithms(name)
    from nfbench.solvers.nevergrad import _registry

    return sorted({*_registry()} - {*CLASSES[name].unusable()} - TOO_SLOW)


def present(name):
    return all(importlib.util.find_spec(module) for module in CLASSES[name].info.requires)


def parameters():
    """Every algorithm of every adapter; most algorithms of libraries that take 1 ms per point are marked slow."""
    for name in NAMES:
        for algorithm in algorithms(name):
            marks = [pytest.mark.skipif(not present(name), reason=f"pip install 'nfbench[{name}]'")]
            if name in ("nevergrad", "optuna") and algorithm not in ("DE", "OnePlusOne", "nsgaii"):
                marks.append(pytest.mark.slow)
            yield pytest.param(name, algorithm, marks=marks)


@pytest.mark.parametrize(("name", "algorithm"), [*parameters()])
def test_an_algorithm_passes_the_main_checks(name, algorithm):
    for result in solver_checks(nfbench.solver(name, algorithm=algorithm), only=QUICK):
        assert result.passed, f"{result.name}: {result.message}"


@pytest.mark.slow
@pytest.mark.parametrize("piece", range(PIECES))
def test_every_algorithm_of_every_adapter_repeats_its_runs(piece):
    """Whatever ran before in the process: this is what makes the table independent of the number of workers."""
    found = [(name, algorithm) for name in NAMES if present(name) for algorithm in every_algorithm(name)]
    failed = [
        f"{name} {algorithm}: {result.message}"
        for name, algorithm in found[piece::PIECES]
        for result in solver_checks(nfbench.solver(name, algorithm=algorithm), only=["same-seed"])
        if not result.passed
    ]
    assert not failed, "\n".join(failed)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "algorithm"), [*parameters()])
def test_an_algorithm_leaves_no_trace_and_repeats_in_a_new_process(name, algorithm):
    for result in solver_checks(nfbench.solver(name, algorithm=algorithm), only=["new-process", "leaves-no-trace"]):
        assert result.passed, f"{result.name}: {result.message}"


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in NAMES if present(name)])
def test_the_default_algorithm_passes_every_check(name):
    for result in solver_checks(nfbench.solver(name)):
        assert result.passed, f"{result.name}: {result.message}"


@pytest.mark.parametrize(("name", "algorithm"), [*parameters()])
def test_an_algorithm_is_better_than_random_sampling(name, algorithm):
    """After 1,500 evaluations of a sphere with 4 unknowns, the median result is below half the best random value."""
    exempt = algorithm in ("random", "qmc", "ScrHammersleySearch", "PGPE", "ACMA")
    if exempt or (name, algorithm) == ("nevergrad", "PSO"):
        return  # three only sample; PGPE needs more; ACMA may stop early; Nevergrad's PSO stays at the bounds
    instance = Functions(function="sphere", dimension=4).draw(np.random.default_rng(4))
    solver = nfbench.solver(name, algorithm=algorithm)
    minima = [nfbench.minimize(instance.problem, solver, 1500, seed) for seed in range(3)]
    assert all(minimum.status is Status.OK and minimum.evaluations <= 1500 for minimum in minima)
    points = np.random.default_rng(1).uniform(-5.12, 5.12, (1500, 4))
    assert np.median([minimum.value for minimum in minima]) < 0.5 * instance.problem.evaluate(points).min()


def test_no_adapter_imports_its_library_before_it_runs(tmp_path):
    code = f"""
import sys
from nfbench.plugins import Registry
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
def test_a_missing_library_is_reported_with_the_install_command(name, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda module: None)
    with pytest.raises(
        MissingExtra, match=rf"solver {name} needs .*not installed here: pip install 'nfbench\[{name}\]'"
    ):
        nfbench.solver(name)
    with pytest.raises(OptionError, match="popularity: unknown option"):
        nfbench.solver(name, popularity=3)  # the options are checked nevertheless


@pytest.mark.skipif(not present("nevergrad"), reason="pip install 'nfbench[nevergrad]'")
def test_nevergrad_suggests_the_nearest_optimizer():
    with pytest.raises(
        OptionError, match="expected the name of a Nevergrad optimizer, got 'TwoPointDE'; did you mean TwoPointsDE"
    ):
        nfbench.solver("nevergrad", algorithm="TwoPointDE")


@pytest.mark.parametrize(("name", "algorithm"), [("pymoo", "CMAES"), ("optuna", "tpe")])
def test_a_population_is_refused_for_algorithms_without_this_option(name, algorithm):
    with pytest.raises(OptionError, match=f"population: expected none, because {algorithm} has no such option, got 20"):
        CLASSES[name](algorithm=algorithm, population=20)
