"""NEMO and NEEF: the problems they build, deflation and repulsion, the number of sources, and refinement."""

import math
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from rich.console import Console
from scipy import optimize

from nfbench import (
    Budget,
    Incompatible,
    MeteredProblem,
    Minimum,
    OptionError,
    Problem,
    Solver,
    SolverInfo,
    load_study,
    minimize,
    run,
)
from nfbench.core.options import build
from nfbench.problems.near_field.estimators.neef import Neef
from nfbench.problems.near_field.estimators.nemo import Nemo
from nfbench.problems.near_field.objectives.factors import factor
from nfbench.problems.near_field.objectives.rls import RLS
from nfbench.problems.near_field.objectives.subspace_fitting import SubspaceFit
from nfbench.problems.near_field.scenario import NearField
from nfbench.report.terminal import print_report

MANIFEST = {
    "array": {"kind": "ula", "elements": 64, "spacing_wavelengths": 0.25, "origin": "center"},
    "wavelength_m": 0.02,
    "sources": 2,
    "snapshots": 40,
    "snr_db": 30.0,
    "azimuth_deg": [-60, 60],
    "range_m": [0.5, 4.0],
    "positions": [[-35, 1.0], [30, 1.5]],
}


def scene(**changes):
    return build(NearField, MANIFEST | changes).draw(np.random.default_rng(0))


@dataclass(frozen=True)
class RandomThenNewton(Solver):
    """Improves the best of many random points by SciPy's L-BFGS-B in the unit box."""

    info = SolverInfo(needs_gradient=True, batched=True)

    def minimize(self, problem: MeteredProblem, rng: np.random.Generator) -> None:
        X = rng.uniform(problem.lower, problem.upper, (4000, problem.dimension))
        width = problem.upper - problem.lower

        def scaled(u: np.ndarray) -> tuple[float, np.ndarray]:
            value, gradient = problem.value_and_gradient(problem.from_unit(u))
            return value, width * gradient

        for x in X[np.argsort(problem.evaluate(X))[:20]]:
            bounds = [(0.0, 1.0)] * problem.dimension
            optimize.minimize(scaled, problem.to_unit(x), jac=True, method="L-BFGS-B", bounds=bounds)


def solved(problems: list[Problem] | None = None):
    """Return a ``minimize`` like that of the engine, which also records the problems."""

    def run(problem: Problem) -> Minimum:
        if problems is not None:
            problems.append(problem)
        return minimize(problem, RandomThenNewton(), Budget(evaluations=6000), seed=1)

    return run


def answering(answers: list[np.ndarray], problems: list[Problem]):
    """Return a ``minimize`` that returns given points and records the problems that a formulation builds."""

    def run(problem: Problem) -> Minimum:
        problems.append(problem)
        found = minimize(problem, RandomThenNewton(), 1, seed=0)
        return Minimum(**{**vars(found), "x": answers[len(problems) - 1]})

    return run


def test_nemo_finds_the_sources():
    instance, problems = scene(), []
    estimate = Nemo().solve(instance, solved(problems))
    assert estimate.shape == (2, 2)
    assert instance.score(estimate)["rmse_m"] < 0.05
    assert [type(problem) for problem in problems] == [RLS, RLS]


def test_neef_finds_the_sources():
    instance, problems = scene(), []
    estimate = Neef().solve(instance, solved(problems))
    assert estimate.shape == (2, 2)
    assert instance.score(estimate)["rmse_m"] < 0.05
    (problem,) = problems
    assert isinstance(problem, SubspaceFit)
    assert_array_equal(problem.lower, np.tile(instance.lower, 2))
    assert_array_equal(problem.upper, np.tile(instance.upper, 2))


def test_formulations_work_in_three_dimensions():
    array = {"kind": "upa", "columns": 6, "rows": 6, "spacing_wavelengths": 0.5, "origin": "center"}
    instance = scene(
        array=array, elevation_deg=[-30, 30], range_m=[0.2, 0.6], positions=[[-35, 10, 0.3], [30, -20, 0.4]]
    )
    cases = [(Nemo(), list(instance.theta), [3, 3]), (Neef(), [instance.theta.ravel()], [6])]
    for formulation, answers, dimensions in cases:
        problems: list[Problem] = []
        estimate = formulation.solve(instance, answering(answers, problems))
        assert_array_equal(estimate, instance.theta)
        assert [problem.dimension for problem in problems] == dimensions


def test_nemo_deflates_each_detected_source():
    """In Algorithm 1, each search minimizes the residual of the earlier detections."""
    instance, problems = scene(), []
    answers = [instance.theta[0], instance.theta[1]]
    assert_array_equal(Nemo(alpha=0.0).solve(instance, answering(answers, problems)), answers)
    X = np.random.default_rng(0).uniform(instance.lower, instance.upper, (20, 2))
    a = instance.manifold.response(answers[0])
    residual = instance.Y - np.outer(a, a.conj() @ instance.Y) / 64
    for problem, Y in zip(problems, (instance.Y, residual), strict=True):
        assert_allclose(
            problem.evaluate(X), RLS(Y, instance.manifold, instance.lower, instance.upper).evaluate(X), rtol=1e-9
        )
    assert problems[1].value(answers[0]) == pytest.approx(np.linalg.norm(residual) ** 2, rel=1e-9)


def penalty_at_first_source(**options) -> float:
    """Return the increase of the second search's objective by the repulsion at the first detected source."""
    instance, with_repulsion, without = scene(), [], []
    answers = [instance.theta[0], instance.theta[1]]
    Nemo(**options).solve(instance, answering(answers, with_repulsion))
    Nemo(alpha=0.0).solve(instance, answering(answers, without))
    assert with_repulsion[0].value(answers[0]) == without[0].value(answers[0])  # no source is detected yet
    return with_repulsion[1].value(answers[0]) - without[1].value(answers[0])


def test_nemo_is_repelled_from_detected_sources():
    assert penalty_at_first_source() == pytest.approx(1000 * 0.08, rel=1e-6)  # the paper's values
    assert penalty_at_first_source(alpha=50.0, delta_min=0.2) == pytest.approx(50 * 0.2, rel=1e-6)


def test_alpha_relative_replaces_alpha():
    instance = scene()
    a = instance.manifold.response(instance.theta[0])
    residual = np.linalg.norm(instance.Y - np.outer(a, a.conj() @ instance.Y) / 64) ** 2
    expected = 3.0 * residual / 64 * 0.08
    assert penalty_at_first_source(alpha_relative=3.0) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("formulation", [Nemo, Neef])
def test_an_estimator_may_assume_another_wavefront(formulation):
    instance = scene(snr_db=40.0)
    X = np.random.default_rng(0).uniform(instance.lower, instance.upper, (4, 2))

    def values(wavefront):
        problems: list[Problem] = []
        answers = [instance.theta[0], instance.theta[1]] if formulation is Nemo else [instance.theta.ravel()]
        formulation(wavefront=wavefront).solve(instance, answering(answers, problems))
        return problems[-1].evaluate(X if formulation is Nemo else X.reshape(2, 4))

    assert_array_equal(values(None), values("exact"))
    assert np.abs(values("planar") - values("exact")).max() > 1e-3


def test_neef_requires_at_least_as_many_snapshots_as_sources():
    with pytest.raises(Incompatible, match=r"snapshots: expected at least 2 .* got 1"):
        Neef().solve(scene(snapshots=1), solved())


@pytest.mark.parametrize("objective", ["esf", "wsf", "dml"])
def test_neef_minimizes_the_objective_that_is_chosen(objective):
    instance, problems = scene(), []
    estimate = Neef(objective=objective).solve(instance, solved(problems))
    assert instance.score(estimate)["rmse_m"] < 0.05
    (problem,) = problems
    assert isinstance(problem, SubspaceFit)
    assert_array_equal(problem.factor, factor(instance.Y, 2, objective))
    assert (problem.sources, problem.dimension) == (2, 4)


def test_neef_fits_all_data_of_fewer_snapshots_than_sources():
    instance = scene(snapshots=1, snr_db=40.0)
    for objective in ("esf", "wsf"):
        with pytest.raises(Incompatible, match=r"snapshots: expected at least 2 .* got 1"):
            Neef(objective=objective).solve(instance, solved())
    estimate = Neef(objective="dml").solve(instance, solved())
    assert instance.score(estimate)["rmse_m"] < 0.1


def test_an_objective_that_does_not_exist_is_refused():
    with pytest.raises(OptionError, match="objective"):
        Neef(objective="mse")


def test_nemo_works_with_one_snapshot():
    assert Nemo().solve(scene(snapshots=1), solved()).shape == (2, 2)


@pytest.mark.parametrize(
    "options",
    [{"alpha": -1.0}, {"alpha": math.inf}, {"alpha_relative": -1.0}, {"delta_min": -0.1}, {"wavefront": "round"}],
)
def test_invalid_options_are_refused(options):
    (name,) = options
    with pytest.raises(OptionError, match=name):
        Nemo(**options)


def test_another_number_of_sources_may_be_assumed_or_estimated():
    instance = scene()
    ends = [*instance.theta, instance.lower, instance.upper]
    for sources, found in (("known", 2), ("estimate", 2), (1, 1), (4, 4)):
        problems: list[Problem] = []
        estimate = Nemo(sources=sources).solve(instance, answering(ends, problems))
        assert_array_equal(estimate, ends[:found])
        assert len(problems) == found
        problems.clear()
        estimate = Neef(sources=sources).solve(instance, answering([np.ravel(ends[:found])], problems))
        assert_array_equal(estimate, ends[:found])
        assert [problem.dimension for problem in problems] == [2 * found]


def test_the_estimate_is_empty_if_the_estimated_number_is_zero():
    instance = scene(snr_db=-60.0, snapshots=200)
    for formulation in (Nemo(sources="estimate", criterion="mdl"), Neef(sources="estimate", criterion="mdl")):
        assert formulation.solve(instance, answering([], [])).shape == (0, 2)


def test_a_run_with_an_empty_estimate_is_ok_and_reported(tmp_path):
    path = tmp_path / "nothing.toml"
    path.write_text(
        """
        name = "nothing"
        repetitions = 1
        seed = 1
        [scenario]
        kind = "near-field"
        array = { kind = "ula", elements = 8, spacing_wavelengths = 0.5, origin = "center" }
        wavelength_m = 0.02
        sources = 2
        snapshots = 20
        snr_db = 10.0
        azimuth_deg = [-60, 60]
        range_m = [0.1, 1.0]
        [[formulation]]
        kind = "nemo"
        stop_below = 8.1            # more than the total energy
        [[formulation]]
        kind = "nemo"
        sources = 1
        [[solver]]
        kind = "random-search"
        [budget]
        evaluations = 50
        """
    )
    results = run(load_study(path), out=tmp_path / "out", jobs=1)
    assert results.runs.status.tolist() == ["ok", "ok"]
    assert results.runs.sources_found.tolist() == [0, 1]
    nothing, one = results.summary().to_dict("records")
    assert math.isnan(nothing["rmse_m"])
    assert nothing["outlier_rate"] == 1
    assert nothing["gospa_m"] == pytest.approx(1.0)  # two missed sources: √(2·c²/2)
    assert one["outlier_rate"] >= 0.5
    print_report(results, Console(width=120))


def test_aic_requires_at_least_as_many_snapshots_as_antennas():
    for formulation in (Nemo, Neef):
        with pytest.raises(Incompatible, match="criterion"):
            formulation(sources="estimate", criterion="aic").solve(scene(), solved())


def qualities(instance, answers) -> list[float]:
    """Return ‖aᴴY‖²/M divided by the mean of ‖Y‖² over M − k dimensions, with explicit projectors."""
    Y, M, values = instance.Y, len(instance.Y), []
    for k, a in enumerate(instance.manifold.response(np.array(answers))):
        values.append(np.linalg.norm(a.conj() @ Y) ** 2 / M / (np.linalg.norm(Y) ** 2 / (M - k)))
        Y = Y - np.outer(a, a.conj()) @ Y / M
    return values


def test_nemo_stops_at_the_first_detection_below_the_minimum_quality():
    instance = scene(snr_db=[30.0, -10.0])
    answers = [*instance.theta, np.array([0.0, 3.0])]  # two sources and a position without a source
    expected = qualities(instance, answers)
    assert expected[0] > 2 * expected[1] > 4 * expected[2]
    for found, quality in enumerate(expected):
        for stop_below, accepted in ((0.999 * quality, found + 1), (1.001 * quality, found)):
            estimate = Nemo(sources=3, stop_below=stop_below).solve(instance, answering(answers, []))
            assert_array_equal(estimate, np.reshape(answers[:accepted], (-1, 2)))
    assert len(Nemo(sources=3).solve(instance, answering(answers, []))) == 3  # off by default


@pytest.mark.parametrize(("snr_db", "found"), [(-60.0, 0), (0.0, 2), (20.0, 2)])
def test_nemo_with_the_noise_edge_as_minimum_quality_finds_all_sources(snr_db, found):
    """The edge (1 + √(M/T))² is the upper limit of the eigenvalues of noise."""
    edge = (1 + math.sqrt(64 / 200)) ** 2
    instance = scene(snr_db=snr_db, snapshots=200)
    estimate = Nemo(sources=5, stop_below=edge).solve(instance, solved())
    assert len(estimate) == found


def test_refine_improves_the_minimizer_of_the_solver():
    """NEMO refines each detection before deflation, NEEF all sources at once; both only if ``refine`` is true."""
    instance = scene()
    off = instance.theta + np.array([0.01, 0.02])
    for formulation, answers in ((Nemo, list(off)), (Neef, [off.ravel()])):
        problems: list[Problem] = []
        plain = formulation().solve(instance, answering(answers, []))
        refined = formulation(refine=True).solve(instance, answering(answers, problems))
        assert_array_equal(plain, off)
        assert instance.score(refined)["rmse_m"] < 0.2 * instance.score(plain)["rmse_m"]
        found = list(refined) if formulation is Nemo else [refined.ravel()]
        for problem, x, start in zip(problems, found, answers, strict=True):
            assert problem.value(x) < problem.value(start)
    a = instance.manifold.response(Nemo(refine=True).solve(instance, answering(list(off), problems := []))[0])
    residual = np.linalg.norm(instance.Y - np.outer(a, a.conj() @ instance.Y) / 64) ** 2
    assert problems[0].value(off[0]) > residual
    assert problems[1].value(instance.upper) <= residual  # the second search uses the residual of the refined source
