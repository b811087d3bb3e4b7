"""The network of the formulation ``learned``: its forward pass, what it sees, its weights and how they were made."""

import ast
import hashlib
import json
import tomllib

import numpy as np
import oracles
import pytest
from conftest import PROJECT
from numpy.testing import assert_allclose, assert_array_equal

from nfbench import MissingExtra
from nfbench.problems.near_field.learned import (
    Network,
    PolarGrid,
    from_polar,
    load_network,
    to_polar,
    training_scenario,
)
from nfbench.problems.near_field.learned import train as training
from nfbench.problems.near_field.learned.network import COMMAND, WEIGHTS
from nfbench.problems.near_field.learned.scenes import draw_scenes

FOLDER = PROJECT / "problems" / "near_field" / "learned"
GRID = PolarGrid(step_u=1 / 16, half_u=4, step_v=0.004, count_v=3)


def stored() -> dict[str, np.ndarray]:
    with np.load(FOLDER / WEIGHTS) as file:
        return dict(file)


def subspace(theta: np.ndarray, wavefront: str = "paper") -> tuple[np.ndarray, object]:
    """Return the signal subspace of noise-free sources, and their manifold."""
    manifold = training_scenario().manifold().under(wavefront)
    A = np.array([oracles.response(manifold, source) for source in theta]).T
    return np.linalg.svd(A, full_matrices=False)[0], manifold


def test_the_forward_pass_is_that_of_pytorch():
    """PyTorch's output for one scene was stored with the weights when they were trained."""
    arrays, network = stored(), load_network()
    output = network(network.grid.channels(arrays["example_spectrum"]))
    assert output.dtype == np.float32 and np.abs(output).max() > 1
    assert_allclose(output, arrays["example_output"], rtol=1e-4, atol=1e-4)


def test_the_forward_pass_is_that_of_the_formula():
    """y_n = b + Σ_i W_iᵀ·x_{n+i−h} with zeros outside, and x/(1 + exp(−x)) between two convolutions."""
    rng = np.random.default_rng(0)
    shapes = [(5, 6, 4), (3, 4, 4), (1, 4, 3)]
    layers = tuple((rng.normal(size=shape), rng.normal(size=shape[2])) for shape in shapes)
    x = rng.normal(size=(9, 6))
    expected = x
    for depth, (W, b) in enumerate(layers):
        if depth:
            expected = expected / (1 + np.exp(-expected))
        rows = []
        for n in range(9):
            taps = [(i, n + i - len(W) // 2) for i in range(len(W))]
            rows.append(b + sum(W[i].T @ expected[at] for i, at in taps if 0 <= at < 9))
        expected = np.array(rows)
    assert_allclose(Network(GRID, layers, {})(x), expected, rtol=1e-12)


def test_large_activations_do_not_overflow():
    layers = ((np.full((1, 2, 1), -1000.0, np.float32), np.zeros(1, np.float32)),) * 1
    layers += ((np.ones((1, 1, 3), np.float32), np.zeros(3, np.float32)),)
    assert_array_equal(Network(GRID, layers, {})(np.full((4, 2), 1e5, np.float32)), 0.0)


@pytest.mark.parametrize("wavefront", ["paper", "fresnel", "exact"])
def test_the_spectrum_is_the_energy_in_the_signal_subspace(wavefront):
    """e = ‖U_sᴴa‖²/M at λ/r = v for the paper's wavefront, and at λ·cos²φ/r = v for the others."""
    U_s, manifold = subspace(np.array([[0.1, 2.0], [-0.5, 5.0]]), wavefront)
    e = GRID.spectrum(U_s, manifold)
    for i, u in enumerate(GRID.u):
        for j, v in enumerate(GRID.v[1:], start=1):
            r = 0.02 * (1.0 if wavefront == "paper" else 1 - u**2) / v
            a = oracles.response(manifold, np.array([np.arcsin(u), r]))
            assert e[i, j] == pytest.approx(np.linalg.norm(U_s.conj().T @ a) ** 2 / 128, abs=1e-9)
        a = oracles.response(manifold.under("planar"), np.array([np.arcsin(u), 1.0]))  # v = 0
        assert e[i, 0] == pytest.approx(np.linalg.norm(U_s.conj().T @ a) ** 2 / 128, abs=1e-4)


def test_the_spectrum_does_not_depend_on_phases_and_rotations_of_the_eigenvectors():
    U_s, manifold = subspace(np.array([[0.1, 2.0], [-0.5, 5.0], [0.2, 9.0]]))
    rng = np.random.default_rng(0)
    Q = np.linalg.qr(rng.normal(size=(3, 3)) + 1j * rng.normal(size=(3, 3))).Q
    phases = np.exp(2j * np.pi * rng.random(3))
    grid = load_network().grid
    assert_allclose(grid.spectrum(U_s * phases, manifold), grid.spectrum(U_s, manifold), atol=1e-12)
    assert_allclose(grid.spectrum(U_s @ Q, manifold), grid.spectrum(U_s, manifold), atol=1e-12)


def test_a_source_looks_the_same_everywhere():
    """Moved by whole steps of the grid, a source moves its spectrum by as many steps."""
    x = np.array([[0.03, 0.0052]])
    manifold = training_scenario().manifold()
    grid = load_network().grid
    moved = x + np.array([7 * grid.step_u, 3 * grid.step_v])
    here, there = (grid.spectrum(subspace(from_polar(each, manifold))[0], manifold) for each in (x, moved))
    assert_allclose(there[7:, 3:], here[:-7, :-3], atol=1e-6)


@pytest.mark.parametrize("wavefront", ["paper", "exact"])
def test_the_coordinates_are_inverse_to_each_other(wavefront):
    manifold = training_scenario().manifold().under(wavefront)
    theta = np.random.default_rng(0).uniform([-1.0, 1.27], [1.0, 20.0], (50, 2))
    assert_allclose(from_polar(to_polar(theta, manifold), manifold), theta, rtol=1e-12)


def test_coordinates_of_no_source_give_finite_ones():
    manifold = training_scenario().manifold()
    theta = from_polar(np.array([[1.5, -0.001], [-2.0, 0.0], [0.0, 0.01]]), manifold)
    assert_allclose(theta, [[np.pi / 2, 2e7], [-np.pi / 2, 2e7], [0.0, 2.0]])


def test_the_weights_are_small_and_have_their_recipe_beside_them():
    file, recipe = FOLDER / WEIGHTS, json.loads((FOLDER / WEIGHTS.replace(".npz", ".json")).read_text(encoding="utf-8"))
    assert file.stat().st_size <= 2 * 10**6
    assert hashlib.sha256(file.read_bytes()).hexdigest() == recipe["sha256"]
    assert recipe["command"] == f"{COMMAND} --scenes {training.SCENES} --epochs {training.EPOCHS}"
    assert recipe["seed"] == training.SEED and recipe["training_time"]["threads"] == 1
    assert 0 < recipe["training_time"]["cpu_s"] < 900
    assert recipe["grid"] == vars(training.GRID) and tuple(recipe["widths"]) == training.WIDTHS
    weights = [array.size for name, array in stored().items() if name.startswith(("weights", "bias"))]
    assert sum(weights) == recipe["parameters"]
    assert {"python", "numpy", "torch"} == set(recipe["versions"])


def test_the_weights_are_installed_with_the_package():
    project = tomllib.loads((PROJECT / "pyproject.toml").read_text(encoding="utf-8"))
    patterns = project["tool"]["setuptools"]["package-data"]["nfbench.problems.near_field.learned"]
    assert {path.name for pattern in patterns for path in FOLDER.glob(pattern)} == {WEIGHTS, f"{WEIGHTS[:-4]}.json"}
    (extra,) = project["project"]["optional-dependencies"]["learned"]
    assert extra.startswith("torch>=") and "<3" in extra


def test_the_weights_are_right_in_the_scenes_that_were_held_out():
    """The mean errors of u and v in the recipe, by the loss of the training written out again."""
    network, manifold = load_network(), training_scenario().manifold()
    wanted, errors = network.recipe["held_out"], []
    subspaces, sources = draw_scenes(wanted["seed"], wanted["scenes"])
    for U_s, theta in zip(subspaces, sources, strict=True):
        _, x = network.propose(network.grid.spectrum(U_s, manifold))
        for u, v in to_polar(theta, manifold):
            for n in np.flatnonzero(np.abs(network.grid.u - u) <= network.grid.step_u):
                nearest = min(to_polar(theta, manifold), key=lambda each: abs(each[0] - network.grid.u[n]))
                if nearest[0] == u:
                    errors.append(np.abs(x[n] - [u, v]) / [network.grid.step_u, network.grid.step_v])
    assert_allclose(np.mean(errors, axis=0), [wanted["u"], wanted["v"]], rtol=0.02)


def test_missing_weights_are_reported_with_the_remedy(tmp_path):
    with pytest.raises(FileNotFoundError, match=rf"expected the weights in .*; reinstall nfbench, or run: {COMMAND}"):
        load_network(tmp_path)


def test_training_scenes_do_not_depend_on_their_number():
    few, many = draw_scenes(3, 2), draw_scenes(3, 4)
    for some, all_of_them in zip(few, many, strict=True):
        assert_array_equal(some, all_of_them[:2])
    assert not np.array_equal(draw_scenes(4, 1)[1], few[1][:1])
    assert (many[1][1::2, :, 1] <= 4.0).all() and (many[1][::2, :, 1] > 4.0).any()


def test_only_the_training_needs_pytorch(monkeypatch):
    for path in (PROJECT / "problems").rglob("*.py"):
        imported = {
            alias.name.partition(".")[0]
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
            if isinstance(node, ast.Import)
            for alias in node.names
        }
        assert ("torch" in imported) == (path == FOLDER / "train.py")
    monkeypatch.setattr(training, "torch", None)
    monkeypatch.setattr("sys.argv", ["train"])
    with pytest.raises(MissingExtra, match=r"needs PyTorch, .*: pip install 'nfbench\[learned\]'"):
        training.main()
