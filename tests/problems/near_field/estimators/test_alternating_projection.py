"""Alternating projection and relaxed NEMO: their problems, when they end, and that they reach the joint fit."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import oracles
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from nfbench import Budget, Incompatible, Minimum, OptionError, Problem, load_study, minimize
from nfbench.core.options import build
from nfbench.plugins import Registry
from nfbench.problems.near_field.estimators.alternating_projection import AlternatingProjection
from nfbench.problems.near_field.estimators.nemo import Nemo
from nfbench.problems.near_field.estimators.relaxation import relax
from nfbench.problems.near_field.floor import local_fit
from nfbench.problems.near_field.objectives.conditional_fit import ConditionalFit
from nfbench.problems.near_field.objectives.rls import RLS
from nfbench.problems.near_field.scenario import NearField
from nfbench.problems.near_field.search import resolution_grid
from nfbench.solvers.random_search import RandomSearch

STUDY = Path(__file__).parents[4] / "studies" / "relaxation.toml"
PLANE = {
    "array": {"kind": "ula", "elements": 64, "spacing_wavelengths": 0.25, "origin": "center"},
    "wavelength_m": 0.02,
    "sources": 3,
    "snapshots": 40,
    "snr_db": 20.0,
    "azimuth_deg": [-60, 60],
    "range_m": [0.5, 4.0],
    "positions": [[-35, 1.0], [20, 2.0], [27, 1.5]],
}
SPACE = {
    "array": {"kind": "upa", "columns": 8, "rows": 8, "spacing_wavelengths": 0.5, "origin": "center"},
    "elevation_deg": [-30, 30],
    "range_m": [0.2, 0.6],
    "positions": [[-35, 10, 0.3], [30, -20, 0.4], [10, 0, 0.25]],
}
FORMULATIONS = [AlternatingProjection(), Nemo(refine=True, relax=10)]


def scene(seed=0, **changes):
    return build(NearField, PLANE | changes).draw(np.random.default_rng(seed))


def at(x: np.ndarray, problem: Problem) -> Minimum:
    """The result of a solver that ends at x."""
    found = minimize(problem, RandomSearch(), 1, seed=0)
    return Minimum(**{**vars(found), "x": x, "value": problem.value(x)})


def grid_search(instance, problems: list[Problem] | None = None, density: float = 1.5):
    """Return a ``minimize`` that answers with the best point of a grid that resolves the array."""
    grid = resolution_grid(instance.manifold, instance.lower, instance.upper, density)

    def run(problem: Problem) -> Minimum:
        if problems is not None:
            problems.append(problem)
        return at(grid[np.argmin(problem.evaluate(grid))], problem)

    return run


def answering(answers, problems: list[Problem]):
    """Return a ``minimize`` that answers with given points, the last of them forever, and records the problems."""

    def run(problem: Problem) -> Minimum:
        problems.append(problem)
        return at(answers[min(len(problems), len(answers)) - 1], problem)

    return run


def misfit(F: np.ndarray, instance, theta: np.ndarray) -> float:
    return oracles.esf(F, np.array([oracles.response(instance.manifold, row) for row in theta]).T)


def covariance(instance) -> np.ndarray:
    return instance.Y @ instance.Y.conj().T / instance.Y.shape[1]


@pytest.mark.parametrize("space", [False, True], ids=["2d", "3d"])
@pytest.mark.parametrize(
    "formulation", [*FORMULATIONS, AlternatingProjection(objective="esf"), AlternatingProjection(objective="dml")]
)
def test_the_result_is_the_joint_fit(formulation, space):
    """A local search over all sources at once, from the truth, with an independent code, ends at the same point."""
    instance, problems = scene(**(SPACE if space else {})), []
    estimate = formulation.solve(instance, grid_search(instance, problems))
    F = problems[-1].factor
    joint = local_fit(F, instance.manifold, instance.theta, instance.lower, instance.upper)
    assert misfit(F, instance, estimate) <= misfit(F, instance, joint) * (1 + 1e-8)
    assert instance.score(estimate)["rmse_m"] < 3 * instance.bounds()["crb_m"]
    assert len(problems) % 3 == 0


def test_the_start_adds_each_source_to_those_found_before():
    """Its first problem is that of NEMO, up to the factor T; those after it project off what was found."""
    instance, problems = scene(), []
    answers = list(instance.theta)
    formulation = AlternatingProjection(objective="dml", sweeps=0, refine=False)
    assert_array_equal(formulation.solve(instance, answering(answers, problems)), answers)
    X = np.random.default_rng(0).uniform(instance.lower, instance.upper, (20, 2))
    first = RLS(instance.Y, instance.manifold, instance.lower, instance.upper)
    assert_allclose(problems[0].evaluate(X), first.evaluate(X) / 40, rtol=1e-10)
    for k, problem in enumerate(problems):
        expected = [misfit(instance.Y, instance, [*answers[:k], x]) / 40 for x in X]
        assert_allclose(problem.evaluate(X), expected, rtol=1e-8)


@pytest.mark.parametrize("formulation", [AlternatingProjection(sweeps=1, refine=False), Nemo(relax=1)])
def test_a_sweep_projects_off_all_other_sources(formulation):
    instance, problems = scene(), []
    off = instance.theta + np.array([0.01, 0.02])
    estimate = formulation.solve(instance, answering([*off, *instance.theta], problems))
    assert_array_equal(estimate, instance.theta)  # each is better than the position before
    sweep = problems[3:]
    assert [type(problem) for problem in sweep] == [ConditionalFit] * 3
    assert_array_equal(sweep[0].others, off[1:])
    assert_array_equal(sweep[1].others, [instance.theta[0], off[2]])
    assert_array_equal(sweep[2].others, instance.theta[:2])
    assert_array_equal([sweep[0].lower, sweep[0].upper], [instance.lower, instance.upper])


def test_the_factor_is_that_of_the_objective():
    """F·Fᴴ is R̂, the projector on the signal subspace, or the weighted one, from the eigenvectors of R̂."""
    instance = scene(snr_db=[20.0, 10.0, -25.0])
    R = covariance(instance)
    eigenvalues, U = (part[..., ::-1] for part in np.linalg.eigh(R))
    noise = eigenvalues[5:].mean()
    weights = np.maximum(eigenvalues[:5] - noise, 0) ** 2 / eigenvalues[:5]
    expected = {"dml": R, "esf": U[:, :5] @ U[:, :5].conj().T, "wsf": U[:, :5] * weights @ U[:, :5].conj().T}
    for objective, square in expected.items():
        problems: list[Problem] = []
        formulation = AlternatingProjection(objective=objective, sources=5, sweeps=0, refine=False)
        formulation.solve(instance, answering([instance.lower], problems))
        F = problems[0].factor
        assert_allclose(F @ F.conj().T, square, rtol=0, atol=1e-10 * np.abs(square).max())


@pytest.mark.parametrize("amplitude", [0.0, 1.0])
def test_eigenvectors_without_signal_have_no_weight(amplitude):
    """Data of rank one or zero without noise: the other eigenvalues are 0 or rounding, and nothing is NaN."""
    instance, problems = scene(), []
    instance.Y[:] = amplitude * np.outer(instance.manifold.response(instance.theta[0]), np.ones(40))
    estimate = AlternatingProjection().solve(instance, grid_search(instance, problems))
    norms = np.linalg.norm(problems[0].factor, axis=0)
    assert_allclose(norms, [8 * amplitude, 0, 0], rtol=1e-10, atol=1e-6)  # √λ_1 = ‖a‖
    assert np.isfinite(estimate).all()
    start = AlternatingProjection(sweeps=0).solve(instance, grid_search(instance))
    assert amplitude == 0 or np.abs(start[0] - instance.theta[0]).max() < 1e-6


@pytest.mark.parametrize("refine", [False, True])
@pytest.mark.parametrize("seed", range(5))
def test_the_misfit_never_rises_whatever_the_solver_answers(seed, refine):
    instance = scene(seed)
    rng, values = np.random.default_rng(seed), []
    start = rng.uniform(instance.lower, instance.upper, (3, 2))

    def run(problem: Problem) -> Minimum:
        return at(rng.uniform(instance.lower, instance.upper), problem)

    theta = start
    for _ in range(6):
        values.append(misfit(instance.Y, instance, theta))
        box = instance.lower, instance.upper
        theta = relax([(instance.Y, instance.manifold)], *box, theta, run, sweeps=1, refining=refine)
        assert ((theta >= instance.lower) & (theta <= instance.upper)).all()
    assert (np.diff(values) <= 1e-9 * values[0]).all()
    assert values[-1] < values[0]


def test_a_position_is_kept_if_the_solver_finds_nothing_better():
    instance, problems = scene(), []
    found = AlternatingProjection().solve(instance, grid_search(instance))
    worse = instance.lower
    box = instance.lower, instance.upper
    kept = relax([(instance.Y, instance.manifold)], *box, found, answering([worse], problems), sweeps=5, refining=False)
    assert_array_equal(kept, found)
    assert len(problems) == 3  # one sweep, which gained nothing


def test_the_sweeps_end_at_their_maximum_or_when_nothing_is_gained():
    instance = scene(snr_db=30.0)

    def problems_of(formulation) -> int:
        problems: list[Problem] = []
        formulation.solve(instance, grid_search(instance, problems))
        return len(problems)

    assert problems_of(AlternatingProjection(sweeps=0)) == 3
    assert problems_of(AlternatingProjection(sweeps=1)) == 6
    until_nothing = problems_of(AlternatingProjection(sweeps=100))
    assert 9 <= until_nothing <= 36
    assert problems_of(AlternatingProjection(sweeps=100, tolerance=0.9)) < until_nothing
    assert problems_of(Nemo()) == 3
    assert 9 <= problems_of(Nemo(relax=100, refine=True)) <= 36


def test_relaxation_removes_the_floor_of_nemo():
    """At high SNR the error of NEMO is what the other sources leave; after relaxation it falls as the noise does."""
    errors = {}
    for snr_db in (20.0, 60.0):
        instance = scene(snr_db=snr_db)
        for relaxed in (0, 10):
            estimate = Nemo(refine=True, relax=relaxed).solve(instance, grid_search(instance))
            errors[snr_db, relaxed] = instance.score(estimate)["rmse_m"]
    assert errors[60.0, 0] > 0.5 * errors[20.0, 0]
    assert errors[60.0, 10] == pytest.approx(0.01 * errors[20.0, 10], rel=0.1)


@pytest.mark.parametrize("formulation", [AlternatingProjection(refine=False), Nemo(relax=3)])
def test_one_source_is_one_problem_whose_minimizer_is_the_estimate(formulation):
    one = {"sources": 1, "positions": [[-35, 1.0]]}
    instance, problems = scene(**one), []
    X = np.array([[0.1, 2.0], [-0.6, 1.0]])
    assert_array_equal(formulation.estimates(instance, X), X[:, None])
    assert formulation.estimates(scene(), X) is None
    assert type(formulation)(refine=True).estimates(instance, X) is None
    assert_array_equal(formulation.solve(instance, answering(X, problems)), X[:1])
    assert len(problems) == 1


def test_nemo_relaxes_the_detections_that_it_has_accepted():
    """The third detection is discarded; the first two are then relaxed on all data, not on the residual."""
    instance, problems = scene(positions=[[-35, 1.0], [27, 1.5]], sources=2), []
    off = instance.theta + np.array([0.01, 0.02])
    none = np.array([0.0, 3.0])
    estimate = Nemo(sources=3, stop_below=8.0, relax=1).solve(instance, answering([*off, none, none], problems))
    assert_array_equal(estimate, off)
    assert [type(problem) for problem in problems] == [RLS] * 3 + [ConditionalFit] * 2
    assert problems[3].value(off[0]) == pytest.approx(misfit(instance.Y, instance, off), rel=1e-9)


def test_a_wrong_or_estimated_number_of_sources():
    instance = scene()
    assert AlternatingProjection(sources=2).solve(instance, grid_search(instance)).shape == (2, 2)
    assert AlternatingProjection(sources="estimate").solve(instance, grid_search(instance)).shape == (3, 2)
    silent = scene(snr_db=-60.0, snapshots=200)
    for formulation in (AlternatingProjection(sources="estimate", criterion="mdl"), Nemo(sources="estimate", relax=2)):
        assert formulation.solve(silent, answering([], [])).shape == (0, 2)


def test_fewer_snapshots_than_sources():
    instance = scene(snapshots=1)
    for objective in ("esf", "wsf"):
        with pytest.raises(Incompatible, match=r"snapshots: expected at least 3 .* got 1"):
            AlternatingProjection(objective=objective).solve(instance, grid_search(instance))
    assert AlternatingProjection(objective="dml").solve(instance, grid_search(instance)).shape == (3, 2)
    assert Nemo(relax=2).solve(instance, grid_search(instance)).shape == (3, 2)


def test_sources_that_the_solver_puts_at_one_point_are_separated():
    """The solver answers with one corner for all sources; the local search of the sweep leaves it."""
    instance = scene()
    estimate = AlternatingProjection(sweeps=2).solve(instance, answering([instance.lower], []))
    assert np.isfinite(estimate).all()
    stuck = AlternatingProjection(sweeps=2, refine=False).solve(instance, answering([instance.lower], []))
    assert_array_equal(stuck, [instance.lower] * 3)


def test_another_wavefront_may_be_assumed():
    instance = scene(snr_db=40.0)
    planar, exact = (
        AlternatingProjection(wavefront=wavefront).solve(instance, grid_search(instance))
        for wavefront in ("planar", None)
    )
    assert instance.score(exact)["rmse_m"] < 0.01 < 0.1 < instance.score(planar)["rmse_m"]


@pytest.mark.parametrize("objective", ["esf", "wsf", "dml"])
def test_data_that_are_not_finite_are_refused(objective):
    instance = scene()
    instance.Y[3, 4] = np.nan
    with pytest.raises(ValueError, match="Y: expected finite data, got NaN or infinite entries"):
        AlternatingProjection(objective=objective).solve(instance, answering([instance.lower], []))


@pytest.mark.parametrize(
    "options", [{"objective": "ml"}, {"sweeps": -1}, {"tolerance": -1e-9}, {"tolerance": math.nan}, {"tolerance": 1.0}]
)
def test_invalid_options_are_refused(options):
    (name,) = options
    with pytest.raises(OptionError, match=name):
        AlternatingProjection(**options)
    with pytest.raises(OptionError, match="relax"):
        Nemo(relax=-1)


def test_any_solver_can_be_used():
    solver = Registry().make("solver", "de", {"population": 20})
    instance = scene()
    estimate = AlternatingProjection().solve(
        instance, lambda problem: minimize(problem, solver, Budget(evaluations=600), seed=1)
    )
    assert instance.score(estimate)["rmse_m"] < 3 * instance.bounds()["crb_m"]


# ------------------------------------------------------------------------------------------------- the target


def check_the_target(formulation, snr_db: int, scenes: int, limit: float) -> None:
    """On the scenes of the study, 2° apart: the misfit of the joint fit in each of them, and the pooled error."""
    study = replace(load_study(STUDY), scenes=100)
    swept = {"snr_db": snr_db, "min_separation_deg": 2.0}
    (point,) = (point for point in study.points if {key.split(".")[-1]: v for key, v in point.swept.items()} == swept)
    scenario = Registry().make("scenario", point.scenario.kind, point.scenario.options)
    seeds = list(dict.fromkeys(spec.instance_seed for spec in study.specs()))[:scenes]
    squares = []
    for seed in seeds:
        instance, problems = scenario.draw(np.random.default_rng(seed)), []
        estimate = formulation.solve(instance, grid_search(instance, problems))
        F = problems[-1].factor
        joint = local_fit(F, instance.manifold, instance.theta, instance.lower, instance.upper)
        assert misfit(F, instance, estimate) <= misfit(F, instance, joint) * (1 + 1e-8), seed
        squares.append([instance.score(estimate)["rmse_m"] ** 2, instance.bounds()["crb_m"] ** 2])
    assert len(squares) == scenes
    error, bound = np.sqrt(np.mean(squares, axis=0))
    assert error <= limit * bound


@pytest.mark.parametrize("snr_db", [0, 30])
@pytest.mark.parametrize("formulation", FORMULATIONS, ids=["alternating projection", "NEMO"])
def test_the_joint_fit_is_reached_in_ten_scenes(formulation, snr_db):
    check_the_target(formulation, snr_db, scenes=10, limit=1.3)


@pytest.mark.slow
@pytest.mark.parametrize("snr_db", [0, 5, 10, 15, 20, 25, 30])
@pytest.mark.parametrize("formulation", FORMULATIONS, ids=["alternating projection", "NEMO"])
def test_the_bound_is_met_over_100_scenes(formulation, snr_db):
    """Over 100 scenes an efficient estimator has 0.85 to 1.15 bounds, and the joint fit at most 1.05 in these."""
    check_the_target(formulation, snr_db, scenes=100, limit=1.05)
