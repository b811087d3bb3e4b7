"""BBOB from coco and from ioh, compared with the definitions and with each other."""

import importlib.util
import pickle

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from nfbench import Budget, ManifestError, MissingExtra, OptionError, load_study, minimize
from nfbench.plugins.registry import Registry
from nfbench.problems.bbob import BBOB, MODULES, BBOBProblem
from nfbench.problems.functions import Direct
from nfbench.solvers.de import DE
from nfbench.testing import check_scenario

INSTALLED = {backend: importlib.util.find_spec(module) is not None for backend, module in MODULES.items()}
BACKENDS = [
    pytest.param(backend, marks=pytest.mark.skipif(not installed, reason=f"pip install 'nfbench[{backend}]'"))
    for backend, installed in INSTALLED.items()
]
both = pytest.mark.skipif(not all(INSTALLED.values()), reason="pip install 'nfbench[coco,ioh]'")
each_backend = pytest.mark.parametrize("backend", BACKENDS)


# --- the definitions of Hansen, Finck, Ros & Auger 2009, for the functions that need no rotation ----------------------


def oscillated(x):
    """Return T_osz(x)."""
    size = np.log(np.abs(x, where=x != 0.0, out=np.ones_like(x)))
    c1, c2 = np.where(x > 0.0, 10.0, 5.5), np.where(x > 0.0, 7.9, 3.1)
    return np.sign(x) * np.exp(size + 0.049 * (np.sin(c1 * size) + np.sin(c2 * size)))


def exponents(n):
    return np.arange(n) / (n - 1)


def sphere(shift):
    return (shift**2).sum(axis=1)


def ellipsoid(shift):
    return (1e6 ** exponents(shift.shape[1]) * oscillated(shift) ** 2).sum(axis=1)


def rastrigin(shift):
    n = shift.shape[1]
    z = oscillated(shift)
    z = np.where(z > 0.0, np.abs(z) ** (1.0 + 0.2 * exponents(n) * np.sqrt(np.abs(z))), z)  # T_asy
    z = z * np.sqrt(10.0) ** exponents(n)
    return 10.0 * (n - np.cos(2.0 * np.pi * z).sum(axis=1)) + (z**2).sum(axis=1)


def rosenbrock(shift):
    z = max(1.0, np.sqrt(shift.shape[1]) / 8.0) * shift + 1.0
    return (100.0 * (z[:, :-1] ** 2 - z[:, 1:]) ** 2 + (z[:, :-1] - 1.0) ** 2).sum(axis=1)


@each_backend
@pytest.mark.parametrize(("function", "formula"), [(1, sphere), (2, ellipsoid), (3, rastrigin), (8, rosenbrock)])
@pytest.mark.parametrize("n", [2, 5, 40])
def test_functions_without_rotation_agree_with_their_definition(backend, function, formula, n):
    for instance in (1, 2, 777):
        problem = BBOBProblem(backend, function, n, instance)
        X = np.random.default_rng(n).uniform(-5.0, 5.0, (100, n))
        assert_allclose(problem.evaluate(X), formula(X - problem.optimum) + problem.f_opt, rtol=1e-12)


@each_backend
@pytest.mark.parametrize("function", range(1, 25))
def test_the_minimum_is_at_the_stated_optimum(backend, function):
    """The gap is 0 at the optimum and positive at other points, none of which has a lower value."""
    rng = np.random.default_rng(function)
    for n, number in ((2, 1), (5, 2), (10, 1000)):
        instance = BBOB(function, n, number, backend).draw(rng)
        problem, optimum = instance.problem, instance.truth()
        assert np.abs(optimum).max() <= 5.0
        assert_allclose(problem.value(optimum), problem.f_opt, rtol=1e-14, atol=1e-14)
        assert_allclose(instance.score(optimum)["gap"], 0.0, atol=1e-13)
        X = rng.uniform(-5.0, 5.0, (200, n))
        X[100:] = np.clip(optimum + 0.02 * X[100:], -5.0, 5.0)
        assert problem.evaluate(X).min() >= problem.f_opt
        assert instance.score(X[0])["gap"] == problem.value(X[0]) - problem.f_opt > 0.0


@pytest.mark.skipif(not INSTALLED["coco"], reason="pip install 'nfbench[coco]'")
def test_published_values():
    """The value of the sphere with 13 unknowns at 0 is printed in COCO's documentation."""
    assert_allclose(BBOBProblem("coco", 1, 13, 1).evaluate(np.zeros((1, 13))), 124.61122368, rtol=1e-14)


# --- one library against the other ------------------------------------------------------------------------------------


@both
@pytest.mark.parametrize("function", range(1, 25))
def test_coco_and_ioh_agree(function):
    """The gaps agree to 1e-11 at random points of the box and near x_opt, f_opt to 1e-13 and x_opt to 1e-9."""
    rng = np.random.default_rng(function)
    for n in (2, 5):
        for instance in (1, 2, 3):
            coco, ioh = (BBOBProblem(backend, function, n, instance) for backend in ("coco", "ioh"))
            assert_allclose(ioh.f_opt, coco.f_opt, rtol=0, atol=1e-13)
            assert_allclose(ioh.optimum, coco.optimum, rtol=0, atol=1e-9)
            X = rng.uniform(-5.0, 5.0, (200, n))
            X[150:] = np.clip(coco.optimum + 0.2 * X[150:], -5.0, 5.0)
            ours, theirs = coco.evaluate(X), ioh.evaluate(X)
            assert_allclose(theirs - ioh.f_opt, ours - coco.f_opt, rtol=1e-11, atol=1e-11)


@both
def test_coco_and_ioh_differ_on_the_lowest_step_of_function_7():
    """By definition f - f_opt is |ẑ_1|/10⁵ there, where ẑ_1 is the product with a unit vector; it is 0 in ioh."""
    rng = np.random.default_rng(7)
    for n, instance in ((2, 1), (5, 2)):
        coco, ioh = (BBOBProblem(backend, 7, n, instance) for backend in ("coco", "ioh"))
        directions = rng.standard_normal((20_000, n))
        directions /= np.linalg.norm(directions, axis=1)[:, None]
        X = coco.optimum + 1e-3 * directions
        assert_array_equal(ioh.evaluate(X), ioh.f_opt)
        rise = coco.evaluate(X) - coco.f_opt
        assert 0.95e-8 < rise.max() <= 1.001e-8
        assert_allclose((rise**2).mean(), 1e-16 / n, rtol=0.05)


# --- the scenario -----------------------------------------------------------------------------------------------------


@each_backend
def test_the_scenario_passes_the_conformance_checks(backend, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    for function in (1, 7, 20, 24):
        check_scenario(BBOB(function=function, dimension=3, backend=backend), [Direct()])
    assert not [*tmp_path.iterdir()] and capfd.readouterr() == ("", "")


@each_backend
def test_a_draw_depends_only_on_the_generator_and_uses_the_instance_numbers_of_coco(backend):
    scenario = BBOB(function=15, dimension=3, backend=backend)

    def optima(scenario):
        return [scenario.draw(np.random.default_rng(seed)).problem.optimum for seed in range(8)]

    assert_array_equal(optima(scenario), optima(pickle.loads(pickle.dumps(scenario))))
    assert len(np.unique(optima(scenario), axis=0)) == 8
    numbers = [np.random.default_rng(seed).integers(1, 1001) for seed in range(8)]
    assert_array_equal(optima(scenario), [BBOBProblem(backend, 15, 3, number).optimum for number in numbers])
    fixed = BBOB(function=15, dimension=3, instance_id=4, backend=backend)
    assert_array_equal(optima(fixed), [BBOBProblem(backend, 15, 3, 4).optimum] * 8)


@each_backend
def test_a_solver_finds_the_minimum(backend):
    problem = BBOBProblem(backend, 8, 3, 1)
    minimum = minimize(problem, DE(population=30), Budget(15_000, target=problem.f_opt + 1e-8), 1)
    assert problem.f_opt <= minimum.value <= problem.f_opt + 1e-8
    assert_allclose(minimum.x, problem.optimum, atol=1e-3)


# --- options, and a library that is not installed ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"function": 25}, "function: expected less than or equal to 24, got 25"),
        ({"dimension": 1}, "dimension: expected greater than or equal to 2, got 1"),
        ({"dimension": 41}, "dimension: expected less than or equal to 40, got 41"),
        ({"instance_id": 0}, "instance_id: expected greater than or equal to 1, got 0"),
        ({"backend": "cocoex"}, "backend: expected 'coco' or 'ioh', got 'cocoex'"),
    ],
)
def test_options_outside_the_suite_are_refused(options, words):
    with pytest.raises(OptionError, match=words):
        BBOB(**options)


@pytest.mark.parametrize("backend", MODULES)
def test_a_missing_library_is_reported_with_the_install_command(backend, monkeypatch, tmp_path):
    present = ({*MODULES} - {backend}).pop()
    monkeypatch.setattr(importlib.util, "find_spec", lambda module: object() if module == MODULES[present] else None)
    words = f"scenario bbob needs {MODULES[backend]}, which is not installed here: pip install 'nfbench[{backend}]'"
    with pytest.raises(MissingExtra) as caught:
        Registry().make("scenario", "bbob", {"backend": backend})
    assert str(caught.value) == words
    assert isinstance(Registry().make("scenario", "bbob", {"backend": present}), BBOB)
    path = tmp_path / "study.toml"
    path.write_text(
        f'name = "x"\nrepetitions = 1\nseed = 1\nscenario = {{ kind = "bbob", backend = "{backend}" }}\n'
        'formulation = [{ kind = "direct" }]\nsolver = [{ kind = "de" }]\nbudget = { evaluations = 9 }\n'
        "sweep = { function = [1, 2] }\n"
    )
    with pytest.raises(ManifestError) as wrong:
        load_study(path)
    assert wrong.value.problems == [f"scenario.kind: {words}"]
