"""Accuracy in the paper's scenario at full size: ULA M = 128, λ/4, T = 200, K = 3, 20 dB, line of sight."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

import nfbench
from nfbench import Status, minimize
from nfbench.problems.near_field.estimators import neef, nemo
from nfbench.problems.near_field.estimators.neef import Neef
from nfbench.problems.near_field.estimators.nemo import Nemo
from nfbench.problems.near_field.objectives.rls import RLS
from nfbench.problems.near_field.objectives.subspace_fitting import SubspaceFit
from nfbench.problems.near_field.scenario import NearField

sys.path.append(str(Path(__file__).parent / "benchmarks"))
from numpy_objectives import NumPyESF, NumPyRLS

SCENARIO = NearField(
    array={"kind": "ula", "elements": 128, "spacing_wavelengths": 0.25, "origin": "first"},
    wavelength_m=0.02,
    wavefront="paper",
    sources=3,
    snapshots=200,
    snr_db=20.0,
    azimuth_deg=(-60, 60),
    range_m=(1.27, 20.16),
)
BUDGET = 60_000  # the paper's 40·K individuals for 500 generations, K = 3


def solved(seed, solver):
    """NEEF on the scene with this seed: the RMSE of the estimate [m] and the minimum of ESF."""
    instance, minima = SCENARIO.draw(np.random.default_rng(seed)), []

    def run(problem):
        minima.append(minimize(problem, solver, BUDGET, seed))
        assert minima[-1].status is Status.OK and minima[-1].evaluations <= BUDGET
        return minima[-1]

    estimate = Neef().solve(instance, run)
    return instance.score(estimate)["rmse_m"], minima[0].value


@pytest.fixture(scope="module")
def de():
    return [solved(seed, nfbench.solver("de", population=120)) for seed in range(20)]


def test_neef_de_at_the_papers_settings_has_a_median_error_under_2_cm(de):
    assert np.median([rmse for rmse, _ in de]) < 0.02


@pytest.mark.parametrize("name", ["scipy-de", pytest.param("cmaes", marks=pytest.mark.slow)])
def test_other_global_solvers_reach_the_same_optimum(name, de):
    reached = 0
    for seed in range(10):
        _, value = solved(seed, nfbench.solver(name))
        best = min(value, de[seed][1])
        reached += value - best <= 1e-8
    assert reached >= 8


@pytest.mark.parametrize("rician_k", [np.inf, 10.0])
@pytest.mark.parametrize(
    ("formulation", "module", "compiled", "plain", "population", "budget"),
    [(Nemo(), nemo, RLS, NumPyRLS, 50, 15_000), (Neef(), neef, SubspaceFit, NumPyESF, 120, BUDGET)],
    ids=["nemo", "neef"],
)
def test_runs_of_the_quickstart_agree_with_those_on_numpy_objectives(
    formulation, module, compiled, plain, population, budget, rician_k, monkeypatch
):
    """Compiled and NumPy objectives agree at the minimizers of the compiled run, and both runs reach the same J.

    NEMO's later problems need a larger tolerance. A minimizer is known only to the square root of the rounding error
    of J, and the next residual depends on it to first order, so that J agrees only to the square root of 1e-16.
    """
    instance = replace(SCENARIO, rician_k=rician_k, fading="block").draw(np.random.default_rng(3))
    solver = nfbench.solver("de", population=population)
    twins, runs = [], []

    def twin(*arguments, **options):
        twins.append([kind(*arguments, **options) for kind in (compiled, plain)])
        return twins[-1][0]

    for objective in (twin, plain):
        monkeypatch.setattr(module, compiled.__name__, objective)
        minima = []
        formulation.solve(instance, lambda p, m=minima: m.append(minimize(p, solver, budget, len(m))) or m[-1])
        runs.append(minima)
    for (fast, slow), minimum in zip(twins, runs[0], strict=True):
        assert fast.value(minimum.x) == minimum.value
        assert_allclose(slow.value(minimum.x), minimum.value, rtol=1e-9)
    values = np.array([[minimum.value for minimum in minima] for minima in runs])
    assert_allclose(values[0, 0], values[1, 0], rtol=1e-9)
    assert_allclose(values[0], values[1], rtol=1e-6)
