"""Newtonized OMP: agreement with the printed algorithm, the Cramér–Rao bound, hostile scenes."""

from dataclasses import replace

import numpy as np
import oracles
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pursuit_scenes import HOSTILE, LINE, SMALL, SPACE, coherent, dictionary, in_order, noise_free, scene, solve

from nfbench import OptionError
from nfbench.plugins.registry import Registry
from nfbench.problems.near_field.estimators.newton import newton_step
from nfbench.problems.near_field.estimators.newtonized_omp import NewtonizedOmp
from nfbench.problems.near_field.estimators.omp import Omp
from nfbench.problems.near_field.instance import NearFieldInstance
from nfbench.problems.near_field.search import BandFit, polar_grid

STEP = 1e-4


class Oracle:
    """NOMP by its printed steps; the derivatives of G are differences of G itself, in angles [rad] and 1/r [1/m]."""

    def __init__(self, instance: NearFieldInstance, coherence: float, rounds: int, last_rounds: int) -> None:
        self.instance, self.rounds, self.last_rounds = instance, rounds, last_rounds
        self.grid = polar_grid(instance.manifold, instance.lower, instance.upper, coherence)
        aperture = np.ptp(instance.manifold.positions, axis=0).max()
        beamwidth = instance.manifold.wavelength_m / aperture
        self.scale = np.array([beamwidth] * (instance.manifold.dimension - 1) + [4 * beamwidth / aperture])

    def a(self, z: np.ndarray) -> np.ndarray:
        return oracles.response(self.instance.manifold, self.theta(z))

    def theta(self, z: np.ndarray) -> np.ndarray:
        return np.append(z[:-1], 1 / z[-1])

    def gain(self, R: np.ndarray, z: np.ndarray) -> float:
        a = self.a(z)
        return float(np.linalg.norm(a.conj() @ R) ** 2 / np.linalg.norm(a) ** 2)

    def refine_single(self, R: np.ndarray, z: np.ndarray) -> np.ndarray:
        d = len(z)
        E = np.diag(STEP * self.scale)
        G = {
            (i, j, s, t): self.gain(R, z + s * E[i] + t * E[j])
            for i in range(d)
            for j in range(d)
            for s in (-1, 1)
            for t in (-1, 1)
        }
        here = self.gain(R, z)
        H, g = np.empty((d, d)), np.empty(d)
        for i in range(d):
            g[i] = (G[i, i, 1, 1] - G[i, i, -1, -1]) / 4
            for j in range(d):
                H[i, j] = (G[i, j, 1, 1] - G[i, j, 1, -1] - G[i, j, -1, 1] + G[i, j, -1, -1]) / 4
        if np.linalg.eigvalsh(H).max() >= 0:
            return z
        new = z - np.linalg.solve(H, g) * STEP * self.scale
        low, high = self.instance.lower.copy(), self.instance.upper.copy()
        low[-1], high[-1] = 1 / self.instance.upper[-1], 1 / self.instance.lower[-1]
        new = np.clip(new, low, high)
        return new if self.gain(R, new) > here else z

    def run(self) -> np.ndarray:
        Y, Z = self.instance.Y, []
        R = Y
        Psi = dictionary(self.instance, self.grid)
        for k in range(self.instance.sources):
            picked = self.grid[np.argmax(np.linalg.norm(Psi.conj().T @ R, axis=1))]
            Z.append(self.refine_single(R, np.append(picked[:-1], 1 / picked[-1])))
            A = np.array([self.a(z) for z in Z]).T
            S = np.linalg.pinv(A) @ Y
            for _ in range(self.last_rounds if k == self.instance.sources - 1 else self.rounds):
                for i in range(len(Z)):
                    R_i = Y - A @ S + np.outer(A[:, i], S[i])
                    Z[i] = self.refine_single(R_i, Z[i])
                    A[:, i] = self.a(Z[i])
                    S[i] = A[:, i].conj() @ R_i / np.linalg.norm(A[:, i]) ** 2
            R = Y - A @ np.linalg.pinv(A) @ Y
        return np.array([self.theta(z) for z in Z])


@pytest.mark.parametrize(("manifest", "scenes"), [(SMALL, 50), (SPACE, 10)], ids=["line", "space"])
def test_the_sources_are_those_of_the_printed_algorithm(manifest, scenes):
    agree = 0
    for seed in range(scenes):
        instance = scene(seed, manifest, sources=2 + seed % 2, snr_db=20.0, min_separation_deg=8.0)
        oracle = Oracle(instance, 0.9, rounds=2, last_rounds=3).run()
        found = solve(NewtonizedOmp(coherence=0.9, rounds=2, last_rounds=3), instance)
        inside = ((oracle > instance.lower) & (oracle < instance.upper)).all()
        if inside:  # at an end of the box the step of the oracle is clipped, and the other coordinates are not held
            assert_allclose(found, oracle, rtol=1e-5 if manifest is SMALL else 3e-4)
            agree += 1
    assert agree > 0.6 * scenes


def test_a_newton_step_near_the_maximum_converges_quadratically():
    instance = noise_free(scene(sources=1, positions=[[10, 1.0]]))
    fits, box = [BandFit(instance.Y, instance.manifold)], (instance.lower, instance.upper)
    theta = instance.theta[0] * [1.01, 1.02]
    errors = []
    for _ in range(3):
        theta = newton_step(fits, *box, theta)
        errors.append(np.abs(theta / instance.theta[0] - 1).max())
    assert errors[0] < 5e-3 and errors[1] < 1e-6 and errors[-1] < 1e-8


def test_a_newton_step_never_lowers_the_gain():
    rng = np.random.default_rng(0)
    instance = scene(snr_db=0.0)
    R = instance.Y

    def gain(theta):
        a = oracles.response(instance.manifold, theta)
        return np.linalg.norm(a.conj() @ R)

    moved = 0
    for _ in range(200):
        theta = rng.uniform(instance.lower, instance.upper)
        after = newton_step([BandFit(R, instance.manifold)], instance.lower, instance.upper, theta)
        assert gain(after) >= gain(theta) * (1 - 1e-12)
        assert (after >= instance.lower).all() and (after <= instance.upper).all()
        moved += bool((after != theta).any())
    assert moved > 20


@pytest.mark.parametrize("manifest", [SMALL, SPACE, LINE], ids=["small", "space", "line"])
def test_without_noise_the_sources_are_found(manifest):
    for seed in range(5):
        instance = noise_free(scene(seed, manifest, min_separation_deg=20.0, snapshots=20))
        assert_allclose(in_order(solve(NewtonizedOmp(), instance)), in_order(instance.theta), rtol=1e-6)


def test_the_error_meets_the_bound_and_that_of_omp_does_not():
    """Mamandipoor et al., Figs. 4 and 5: sources 2.5 beamwidths apart; NOMP attains the bound, OMP the grid's error."""
    squares, grid_squares = [], []
    for seed in range(25):
        instance = scene(seed, LINE, positions=[[-35, 3.0], [5, 2.0], [9.5, 4.0]], snr_db=10.0)
        squares.append(instance.score(solve(NewtonizedOmp(), instance))["rmse_m"] ** 2)
        grid_squares.append(instance.score(solve(Omp(), instance))["rmse_m"] ** 2)
    bound = np.mean(oracles.position_bounds(instance.manifold, instance.theta, 10.0, 200) ** 2)
    assert 0.8 < np.sqrt(np.mean(squares) / bound) < 1.2
    assert np.sqrt(np.mean(grid_squares) / bound) > 10


def test_cyclic_refinement_corrects_earlier_sources():
    """Without rounds a source keeps the bias that the later sources have caused."""
    instance = noise_free(scene(positions=[[-5, 1.0], [4, 1.0], [40, 2.0]]))
    with_rounds = in_order(solve(NewtonizedOmp(), instance))
    without = in_order(solve(NewtonizedOmp(rounds=0, last_rounds=0), instance))
    assert_allclose(with_rounds, in_order(instance.theta), rtol=1e-6)
    assert np.abs(without / in_order(instance.theta) - 1).max() > 1e-3


@pytest.mark.parametrize("refine", [False, True])
@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_scenes_end_with_sources_in_the_box(name, refine):
    instance = scene(0, HOSTILE[name])
    found = solve(NewtonizedOmp(coherence=0.7, refine=refine), instance)
    assert found.shape == instance.theta.shape and np.isfinite(found).all()
    assert (found >= instance.lower).all() and (found <= instance.upper).all()


def test_fewer_snapshots_than_sources_and_coherent_sources_are_allowed():
    positions = [[-35, 1.0], [10, 0.8], [40, 2.0]]
    for instance in (scene(snapshots=1, positions=positions, snr_db=40.0), coherent(scene(positions=positions))):
        assert instance.score(solve(NewtonizedOmp(), instance))["rmse_m"] < 0.2


def test_bins_are_fitted_together():
    """The errors of five bins are about √5 times smaller than those of one."""
    positions = [[-35, 1.0], [10, 0.8], [40, 1.5]]
    manifest = SMALL | {"bins": 5, "bandwidth_relative": 0.2, "snr_db": 10.0, "positions": positions}
    errors = np.empty((10, 2))
    for seed in range(10):
        instance = scene(seed, manifest)
        for i, each in enumerate((instance, replace(instance, further=()))):
            errors[seed, i] = instance.score(solve(NewtonizedOmp(), each))["rmse_m"]
    together, alone = np.sqrt(np.mean(errors**2, axis=0))
    assert 0.25 < together / alone < 0.7


def test_equal_runs_give_equal_estimates():
    instance = scene()
    assert_array_equal(solve(NewtonizedOmp(), instance), solve(NewtonizedOmp(), instance))


def test_it_is_built_from_a_manifest_table():
    formulation = Registry().make("formulation", "newtonized-omp", {"rounds": 5})
    assert formulation == NewtonizedOmp(rounds=5)
    assert not formulation.needs_solver


@pytest.mark.parametrize("options", [{"steps": 0}, {"rounds": -1}, {"coherence": 1.0}])
def test_invalid_options_are_refused(options):
    (name,) = options
    with pytest.raises(OptionError, match=name):
        NewtonizedOmp(**options)
