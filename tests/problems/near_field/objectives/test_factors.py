"""The family of objectives: the factors of ESF, WSF and DML by their definitions, and what follows from them."""

import math
from dataclasses import replace

import numpy as np
import oracles
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from nfbench import Incompatible
from nfbench.problems.near_field.arrays import ULA, UPA
from nfbench.problems.near_field.channels import complex_normal
from nfbench.problems.near_field.estimators.refinement import refine
from nfbench.problems.near_field.geometry import cartesian
from nfbench.problems.near_field.objectives.factors import factor
from nfbench.problems.near_field.objectives.rls import RLS
from nfbench.problems.near_field.objectives.subspace_fitting import SubspaceFit
from nfbench.problems.near_field.scenario import NearField
from nfbench.problems.near_field.subspace import signal_subspace
from nfbench.problems.near_field.wavefronts import Manifold

WAVELENGTH = 0.02
PLANE = Manifold(
    ULA(elements=24, spacing_wavelengths=0.25, origin="first").place(WAVELENGTH),
    WAVELENGTH,
    "exact",
    has_elevation=False,
)
SPACE = Manifold(
    UPA(columns=4, rows=5, spacing_wavelengths=0.5, origin="center").place(WAVELENGTH),
    WAVELENGTH,
    "fresnel",
    has_elevation=True,
)
BOX = {2: (np.array([-1.0, 0.5]), np.array([1.0, 10.0])), 3: (np.array([-1.0, -0.5, 0.5]), np.array([1.0, 0.5, 10.0]))}
OBJECTIVES = pytest.mark.parametrize("objective", ["esf", "wsf", "dml"])
MANIFOLDS = pytest.mark.parametrize("manifold", [PLANE, SPACE], ids=["2d", "3d"])


def data(manifold: Manifold, sources: int, snapshots: int, amplitudes: object = 3.0, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    theta = rng.uniform(*BOX[manifold.dimension], (sources, manifold.dimension))
    symbols = np.broadcast_to(amplitudes, sources)[:, None] * complex_normal(rng, (sources, snapshots))
    return manifold.response(theta).T @ symbols + complex_normal(rng, (manifold.elements, snapshots))


def fit(Y: np.ndarray, manifold: Manifold, sources: int, objective: str) -> SubspaceFit:
    return SubspaceFit(factor(Y, sources, objective), manifold, *BOX[manifold.dimension], sources=sources)


def points(problem: SubspaceFit, count: int = 20) -> np.ndarray:
    return np.random.default_rng(1).uniform(problem.lower, problem.upper, (count, problem.dimension))


def unexplained(manifold: Manifold, x: np.ndarray, matrix: np.ndarray) -> float:
    """tr((I − P_A)·matrix)."""
    A = manifold.response(x.reshape(-1, manifold.dimension)).T
    return float(np.trace(matrix - A @ (np.linalg.pinv(A) @ matrix)).real)


@MANIFOLDS
@pytest.mark.parametrize("snapshots", [2, 11, 18, 50])
def test_dml_is_the_unexplained_power_of_the_covariance(manifold, snapshots):
    Y = data(manifold, 3, snapshots)
    problem = fit(Y, manifold, 3, "dml")
    X = points(problem)
    assert problem.factor.shape == (manifold.elements, min(manifold.elements, snapshots))
    expected = [unexplained(manifold, x, Y @ Y.conj().T / snapshots) for x in X]
    assert_allclose(problem.evaluate(X), expected, rtol=1e-10)
    assert_allclose([problem.value(x) for x in X], problem.evaluate(X), rtol=0, atol=0)


@MANIFOLDS
def test_wsf_weights_the_eigenvectors(manifold):
    Y = data(manifold, 3, 50, [3.0, 1.0, 0.3])
    eigenvalues, vectors = np.linalg.eigh(Y @ Y.conj().T / 50)
    noise = eigenvalues[:-3].mean()
    W = np.diag((eigenvalues[-3:] - noise) ** 2 / eigenvalues[-3:])
    problem = fit(Y, manifold, 3, "wsf")
    X = points(problem)
    expected = [unexplained(manifold, x, vectors[:, -3:] @ W @ vectors[:, -3:].conj().T) for x in X]
    assert_allclose(problem.evaluate(X), expected, rtol=1e-9)


def test_wsf_gives_no_weight_to_eigenvectors_that_are_not_above_the_noise():
    """Two coherent sources with little noise, and three assumed: an eigenvalue may lie below the mean of the rest."""
    Y = np.diag([3.0, 1.0, 0.5, 1.0, 1.0]).astype(complex)  # 9, 1, 1, 1, 0.25 over T = 5
    weights = np.linalg.norm(factor(Y, 2, "wsf"), axis=0) ** 2
    noise = (1 + 1 + 0.25) / 5 / 3
    assert_allclose(weights, [(1.8 - noise) ** 2 / 1.8, (0.2 - noise) ** 2 / 0.2], rtol=1e-12)
    level = factor(np.eye(5, dtype=complex), 2, "wsf")  # all equal: no signal
    assert_allclose(level, 0.0, atol=1e-12)
    none = factor(np.zeros((5, 5), complex), 2, "wsf")  # λ = σ̂² = 0 must not divide
    assert_array_equal(none, 0.0)


def test_esf_is_the_signal_subspace():
    Y = data(PLANE, 3, 50)
    assert_array_equal(factor(Y, 3, "esf"), signal_subspace(Y, 3))


def test_wsf_and_dml_of_one_source_are_rls_but_for_a_scale_and_a_constant():
    Y = data(PLANE, 1, 30)
    X = points(fit(Y, PLANE, 1, "dml"))
    rls = RLS(Y, PLANE, *BOX[2]).evaluate(X)
    assert_allclose(fit(Y, PLANE, 1, "dml").evaluate(X), rls / 30, rtol=1e-10)
    F = factor(Y, 1, "wsf")
    assert_allclose(fit(Y, PLANE, 1, "wsf").evaluate(X), RLS(F, PLANE, *BOX[2]).evaluate(X), rtol=1e-9)


@OBJECTIVES
@MANIFOLDS
@pytest.mark.parametrize("sources", [1, 2, 3])
def test_gradients_agree_with_differences(manifold, objective, sources):
    problem = fit(data(manifold, sources, 50), manifold, sources, objective)
    compared = 0
    for x in points(problem):
        if np.linalg.cond(manifold.response(x.reshape(sources, -1))) > 30:
            continue
        compared += 1
        value, gradient = problem.value_and_gradient(x)
        assert value == pytest.approx(problem.value(x), rel=1e-12)
        expected = oracles.central_difference(problem.value, x, np.full(len(x), 1e-6))
        assert_allclose(gradient, expected, rtol=1e-5, atol=1e-7 * np.abs(expected).max() + 1e-7)
    assert compared >= 10


@OBJECTIVES
def test_what_the_data_are_multiplied_with_and_the_order_of_snapshots_do_not_matter(objective):
    """A phase and a permutation of snapshots leave R̂ alone; twice the amplitude is four times the power."""
    Y = data(PLANE, 2, 40)
    problem = fit(Y, PLANE, 2, objective)
    X, order = points(problem), np.random.default_rng(2).permutation(40)
    assert_allclose(fit(Y[:, order] * np.exp(0.7j), PLANE, 2, objective).evaluate(X), problem.evaluate(X), rtol=1e-9)
    scale = 1 if objective == "esf" else 4
    assert_allclose(fit(2 * Y, PLANE, 2, objective).evaluate(X), scale * problem.evaluate(X), rtol=1e-9)


def test_a_wide_factor_need_not_be_triangular():
    rng = np.random.default_rng(0)
    F = complex_normal(rng, (24, 40))
    problem = SubspaceFit(F, PLANE, *BOX[2], sources=2)
    X = points(problem)
    assert_allclose(problem.evaluate(X), [unexplained(PLANE, x, F @ F.conj().T) for x in X], rtol=1e-10)
    assert problem.factor is F
    assert (problem.sources, problem.dimension) == (2, 4)


def test_what_a_factor_requires_of_the_data():
    Y = data(PLANE, 2, 2)
    for objective in ("esf", "wsf"):
        with pytest.raises(Incompatible, match="snapshots: expected at least 3"):
            factor(Y, 3, objective)
    assert factor(Y, 3, "dml").shape == (24, 2)


@OBJECTIVES
@pytest.mark.parametrize("bad", [math.nan, math.inf, complex(0, -math.inf)])
def test_data_that_are_not_finite_are_refused(objective, bad):
    Y = data(PLANE, 2, 30)
    Y[3, 4] = bad
    with pytest.raises(ValueError, match="Y: expected finite data, got NaN or infinite entries"):
        factor(Y, 2, objective)
    with pytest.raises(ValueError, match="F: expected finite entries, got NaN or infinite entries"):
        SubspaceFit(Y, PLANE, *BOX[2], sources=2)


def test_a_coherent_pair_is_resolved_by_wsf_and_dml_but_not_by_esf():
    """Medians over 100 scenes at 20 dB: 10.9 cm by ESF, 1.13 cm by WSF and DML; here over 20, from the truth."""
    scenario = NearField(
        array={"kind": "ula", "elements": 128, "spacing_wavelengths": 0.25, "origin": "first"},
        wavelength_m=WAVELENGTH,
        wavefront="paper",
        sources=2,
        snapshots=200,
        snr_db=20.0,
        azimuth_deg=(-60, 60),
        range_m=(1.27, 20.16),
        min_separation_deg=2.0,
    )
    errors: dict[str, list[float]] = {"esf": [], "wsf": [], "dml": []}
    for seed in range(20):
        instance = scenario.draw(rng := np.random.default_rng(seed))
        A = instance.manifold.response(instance.theta).T
        symbols = 10 * np.outer([1.0, np.exp(2j * np.pi * rng.random())], complex_normal(rng, (200,)))  # one signal
        instance = replace(instance, Y=A @ symbols + complex_normal(rng, (128, 200)), symbols=symbols)
        for objective, found in errors.items():
            F = factor(instance.Y, 2, objective)
            problem = SubspaceFit(F, instance.manifold, instance.lower, instance.upper, sources=2)
            theta = refine(problem, instance.theta.ravel(), instance.manifold).reshape(2, 2)
            found.append(float(np.sqrt(np.mean((cartesian(theta) - cartesian(instance.theta)) ** 2) * 3)))
    esf, wsf, dml = (float(np.median(found)) for found in errors.values())
    assert wsf < 0.03
    assert wsf == pytest.approx(dml, rel=0.05)
    assert esf > 3 * wsf
