"""Sparse Bayesian learning: agreement with the posterior formulas, resolution, refinement, hostile scenes."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pursuit_scenes import HOSTILE, LINE, SMALL, SPACE, coherent, dictionary, in_order, noise_free, scene, solve

from nfbench import Incompatible, OptionError
from nfbench.plugins.registry import Registry
from nfbench.problems.near_field.estimators.evidence import Evidence, evidence, refine_evidence
from nfbench.problems.near_field.estimators.omp import Omp
from nfbench.problems.near_field.estimators.sparse_bayesian import SparseBayesian
from nfbench.problems.near_field.instance import NearFieldInstance
from nfbench.problems.near_field.search import polar_grid


def posterior_updates(Y: np.ndarray, A: np.ndarray, K: int, c: float, updates: int) -> tuple[np.ndarray, float]:
    """Return γ and σ² after updates γ_p ← (‖μ_p‖²/T)/(1 − C_pp/γ_p) with the posterior mean μ and covariance C."""
    M, T = Y.shape
    R = Y @ Y.conj().T / T
    beams = np.array([(a.conj() @ R @ a).real for a in A.T]) / M**2
    gamma = beams * np.trace(R).real / (M * beams.sum())
    noise = 0.1 * np.trace(R).real / M
    for _ in range(updates):
        on = gamma > 0
        B, g = A[:, on], gamma[on]
        S = noise * np.eye(M) + B @ np.diag(g) @ B.conj().T
        mu = np.diag(g) @ B.conj().T @ np.linalg.inv(S) @ Y
        C = np.diag(g) - np.diag(g) @ B.conj().T @ np.linalg.inv(S) @ B @ np.diag(g)
        g = np.linalg.norm(mu, axis=1) ** 2 / T / (1 - np.diag(C).real / g)
        g[g < 1e-3 * g.max()] = 0
        gamma[on] = g
        alike = np.abs(A.conj().T @ A) / M >= c**2
        peaks = [p for p in np.flatnonzero(gamma) if gamma[p] == gamma[alike[p]].max()]
        best = sorted(peaks, key=lambda p: -gamma[p])[:K]
        best += [p for p in np.argsort(-gamma) if p not in best and gamma[p] > 0][: K - len(best)]
        P = A[:, best] @ np.linalg.pinv(A[:, best])
        noise = np.trace((np.eye(M) - P) @ R).real / (M - K)
    return gamma, noise


@pytest.mark.parametrize(("manifest", "scenes"), [(SMALL, 50), (SPACE, 3)], ids=["line", "space"])
def test_the_updates_are_those_of_the_posterior_formulas(manifest, scenes):
    for seed in range(scenes):
        instance = scene(seed, manifest, snapshots=40, snr_db=float(seed % 3) * 10.0)
        grid = polar_grid(instance.manifold, instance.lower, instance.upper, 0.7)
        A = dictionary(instance, grid)
        gamma, noise = posterior_updates(instance.Y, A, 3, 0.7, updates=5)
        learned = Evidence(instance.Y / np.sqrt(40), A, 3, 0.7)
        for _ in range(5):
            learned.update(1e-3)
        assert_array_equal(learned.kept, np.flatnonzero(gamma))
        assert_allclose(learned.gamma, gamma[learned.kept], rtol=1e-7)
        assert learned.noise == pytest.approx(noise, rel=1e-7)


def test_most_points_are_dropped_and_the_noise_is_found():
    instance = scene(0, LINE, positions=[[-35, 3.0], [5, 2.0], [30, 4.0]], snr_db=0.0)
    grid = polar_grid(instance.manifold, instance.lower, instance.upper, 0.9)
    learned = Evidence(instance.Y / np.sqrt(200), instance.manifold.response(grid).T, 3, 0.9)
    for _ in range(100):
        learned.update(1e-3)
    assert len(learned.kept) < len(grid) / 50
    assert learned.noise == pytest.approx(1.0, rel=0.2)


def test_sources_within_a_beamwidth_are_resolved():
    """Gerstoft et al., Fig. 1 and 2: SBL resolves arrivals that the beamformer shows as one."""
    beamwidth, resolved, picked = np.degrees(2 / 32), 0, 0
    for seed in range(20):
        positions = [[0, 1.0], [0.6 * beamwidth, 1.0]]
        instance = scene(seed, SMALL, sources=2, positions=positions, snapshots=100, snr_db=20.0)
        truth = instance.theta[:, 0]
        resolved += bool(np.abs(in_order(solve(SparseBayesian(), instance))[:, 0] - truth).max() < 0.01)
        picked += bool(np.abs(in_order(solve(Omp(coherence=0.9), instance))[:, 0] - truth).max() < 0.01)
    assert resolved >= 18 and picked <= 5


@pytest.mark.parametrize("manifest", [SMALL, SPACE], ids=["line", "space"])
def test_without_noise_refinement_gives_the_sources(manifest):
    for seed in range(3):
        instance = noise_free(scene(seed, manifest, min_separation_deg=20.0, snapshots=20))
        found = in_order(solve(SparseBayesian(refine=True), instance))
        assert_allclose(found, in_order(instance.theta), rtol=1e-6)


def test_without_refinement_the_estimates_are_grid_points_near_the_sources():
    instance = scene(0, LINE, positions=[[-35, 3.0], [5, 2.0], [30, 4.0]])
    grid = polar_grid(instance.manifold, instance.lower, instance.upper, 0.9)
    found = in_order(solve(SparseBayesian(), instance))
    assert all((grid == theta).all(axis=1).any() for theta in found)
    a, b = instance.manifold.response(found), instance.manifold.response(instance.theta)
    assert (np.abs(np.sum(a.conj() * b, axis=1)) / 128 > 0.9).all()


def test_refinement_ends_at_a_maximum_of_the_evidence():
    """The evidence rises, and no move by a thousandth of a beamwidth or of the range raises it."""
    instance = scene(1, SMALL, positions=[[-30, 1.0], [5, 2.0], [30, 0.8]], snapshots=100, snr_db=10.0)
    L, box = instance.Y / 10, (instance.lower, instance.upper)
    start = instance.theta * [1.02, 1.05]

    def best(theta: np.ndarray) -> float:
        """Return the evidence with the powers and the noise to which the refinement has converged."""
        return evidence(L, instance.manifold.response(theta).T, gamma, noise)

    theta = refine_evidence(L, instance.manifold, *box, start, np.full(3, 10.0), 1.0)
    A = instance.manifold.response(theta).T
    inverse = np.linalg.pinv(A)
    left = L - A @ (inverse @ L)
    noise = float(np.linalg.norm(left) ** 2 / 29)
    gamma = np.maximum(np.sum(np.abs(inverse @ L) ** 2, axis=1) - noise / 32, 0)
    here = best(theta)
    assert here > best(start)
    for k in range(3):
        for step in ([1e-4, 0], [-1e-4, 0], [0, 5e-3], [0, -5e-3]):
            moved = theta.copy()
            moved[k] += step
            assert best(moved) < here + 1e-4


@pytest.mark.parametrize("refine", [False, True])
@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_scenes_end_with_sources_in_the_box(name, refine):
    instance = scene(0, HOSTILE[name])
    found = solve(SparseBayesian(coherence=0.7, refine=refine, updates=50), instance)
    assert len(found) <= len(instance.theta) and found.shape[1:] == (2,) and np.isfinite(found).all()
    assert (found >= instance.lower).all() and (found <= instance.upper).all()


def test_fewer_snapshots_than_sources_and_coherent_sources_are_allowed():
    positions = [[-35, 1.0], [10, 0.8], [40, 2.0]]
    for instance in (scene(snapshots=2, positions=positions, snr_db=40.0), coherent(scene(positions=positions))):
        assert instance.score(solve(SparseBayesian(refine=True), instance))["rmse_m"] < 0.3


def test_data_of_zeros_do_not_end_in_an_exception():
    instance = replace(scene(), Y=np.zeros((32, 10), dtype=complex))
    for refine in (False, True):
        assert np.isfinite(solve(SparseBayesian(coherence=0.5, refine=refine), instance)).all()


def test_known_gains_are_taken_into_account():
    rng = np.random.default_rng(0)
    gains = np.exp(0.5 * rng.normal(size=32) + 1j * rng.uniform(0, 2 * np.pi, 32))
    instance = scene(positions=[[-35, 1.0], [10, 0.8], [40, 2.0]], snr_db=40.0, snapshots=50)
    impaired = replace(instance, Y=gains[:, None] * instance.Y, gains=gains)
    ignorant, informed = (
        impaired.score(solve(SparseBayesian(known_gains=known, refine=True), impaired))["rmse_m"]
        for known in (False, True)
    )
    assert informed < 0.02 < ignorant


def test_what_does_not_apply_is_refused():
    with pytest.raises(Incompatible, match=r"bins: expected 1 for sparse-bayesian, .* got 3"):
        solve(SparseBayesian(), scene(0, SMALL | {"bins": 3, "bandwidth_relative": 0.1}))
    with pytest.raises(Incompatible, match=r"the polar grid would have .* at most 50,000 for sparse-bayesian"):
        solve(SparseBayesian(coherence=0.99999), scene())


def test_a_slow_grid_is_warned_about():
    scenario = Registry().make("scenario", "near-field", LINE)
    assert SparseBayesian().warnings(scenario) == []
    (text,) = SparseBayesian(coherence=0.995).warnings(scenario)
    assert text.startswith("coherence: 0.995 gives a polar grid of about ") and "with 128 elements" in text


def test_equal_runs_give_equal_estimates():
    instance: NearFieldInstance = scene()
    assert_array_equal(solve(SparseBayesian(refine=True), instance), solve(SparseBayesian(refine=True), instance))


def test_it_is_built_from_a_manifest_table():
    formulation = Registry().make("formulation", "sparse-bayesian", {"updates": 50})
    assert formulation == SparseBayesian(updates=50)
    assert not formulation.needs_solver


@pytest.mark.parametrize("options", [{"updates": 0}, {"tolerance": 1.0}, {"prune": 0.0}])
def test_invalid_options_are_refused(options):
    (name,) = options
    with pytest.raises(OptionError, match=name):
        SparseBayesian(**options)
