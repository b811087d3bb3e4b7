"""The networks of the formulation ``learned``: forward pass, what they see, weights and how they were made."""

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
    COMMAND,
    SETTINGS,
    Network,
    PolarGrid,
    Setting,
    from_polar,
    load_network,
    to_polar,
)
from nfbench.problems.near_field.learned import train as training
from nfbench.problems.near_field.learned.scenes import draw_scenes

FOLDER = PROJECT / "problems" / "near_field" / "learned"
GRID = PolarGrid(step_u=1 / 16, half_u=4, step_v=0.004, count_v=3)
SPACE = PolarGrid(step_u=1 / 8, half_u=4, step_v=0.02, count_v=2, half_w=3)
ULA, UPA = SETTINGS["ula"], SETTINGS["upa"]
BOTH = pytest.mark.parametrize("setting", [ULA, UPA], ids=["ULA", "UPA"])


def stored(setting: Setting) -> dict[str, np.ndarray]:
    with np.load(FOLDER / f"{setting.file}.npz") as file:
        return dict(file)


def subspace(theta: np.ndarray, wavefront: str = "paper", setting: Setting = ULA) -> tuple[np.ndarray, object]:
    """Return the signal subspace of noise-free sources, and their manifold."""
    manifold = setting.scenario.manifold().under(wavefront)
    A = np.array([oracles.response(manifold, source) for source in theta]).T
    return np.linalg.svd(A, full_matrices=False)[0], manifold


@BOTH
def test_the_forward_pass_is_that_of_pytorch(setting):
    """PyTorch's output for one scene was stored with the weights when they were trained."""
    arrays, network = stored(setting), load_network(setting)
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


def test_the_forward_pass_over_two_directions_is_that_of_the_formula():
    """y_nm = b + Σ_ij W_ijᵀ·x_{n+i−h, m+j−h} with zeros outside, on a grid that is not square."""
    rng = np.random.default_rng(0)
    layers = tuple((rng.normal(size=shape), rng.normal(size=shape[3])) for shape in [(5, 5, 2, 3), (3, 3, 3, 2)])
    x = rng.normal(size=(7, 4, 2))
    expected = x
    for depth, (W, b) in enumerate(layers):
        if depth:
            expected = expected / (1 + np.exp(-expected))
        h, y = len(W) // 2, np.zeros((7, 4, len(b))) + b
        for n, m, i, j in np.ndindex(7, 4, *W.shape[:2]):
            if 0 <= n + i - h < 7 and 0 <= m + j - h < 4:
                y[n, m] += W[i, j].T @ expected[n + i - h, m + j - h]
        expected = y
    assert_allclose(Network(SPACE, layers, {})(x), expected, rtol=1e-12)


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


@pytest.mark.parametrize("wavefront", ["paper", "fresnel", "exact"])
def test_the_spectrum_with_elevation_is_the_energy_in_the_signal_subspace(wavefront):
    """e = ‖U_sᴴa‖²/M at sinψ = w, cosψ·sinφ = u and λ/r = v, for all wavefronts."""
    U_s, manifold = subspace(np.array([[0.1, 0.2, 0.5], [-0.5, -0.3, 2.0]]), wavefront, UPA)
    e = SPACE.spectrum(U_s, manifold)
    assert e.shape == (9, 7, 2)
    for i, u in enumerate(SPACE.u):
        for j, w in enumerate(np.arange(-3, 4) / 8):
            theta = np.array([np.arcsin(u / np.sqrt(1 - w * w)), np.arcsin(w), 0.02 / 0.02])
            a = oracles.response(manifold, theta)
            assert e[i, j, 1] == pytest.approx(np.linalg.norm(U_s.conj().T @ a) ** 2 / 256, abs=1e-9)
            a = oracles.response(manifold.under("planar"), theta)  # v = 0
            assert e[i, j, 0] == pytest.approx(np.linalg.norm(U_s.conj().T @ a) ** 2 / 256, abs=1e-4)


def test_with_elevation_the_network_also_sees_the_direction():
    """The phase of a planar array depends on the direction, unlike that of a line in its coordinates."""
    e = np.random.default_rng(0).random((9, 7, 2))
    x = SPACE.channels(e)
    assert x.shape == (9, 7, 9) and SPACE.channels_count == 9 and GRID.channels_count == 6
    u, w = np.meshgrid(np.arange(-4, 5) / 8, np.arange(-3, 4) / 8, indexing="ij")
    assert_allclose(x[..., :2], e, rtol=1e-6)
    assert_allclose(x[..., 2:4], np.log10(1.01 - e), rtol=1e-4)
    assert_allclose(x[..., 4:], np.stack([u, w, u**2, w**2, u * w], axis=-1), rtol=1e-6)


def test_the_spectrum_does_not_depend_on_phases_and_rotations_of_the_eigenvectors():
    U_s, manifold = subspace(np.array([[0.1, 2.0], [-0.5, 5.0], [0.2, 9.0]]))
    rng = np.random.default_rng(0)
    Q = np.linalg.qr(rng.normal(size=(3, 3)) + 1j * rng.normal(size=(3, 3))).Q
    phases = np.exp(2j * np.pi * rng.random(3))
    grid = load_network(ULA).grid
    assert_allclose(grid.spectrum(U_s * phases, manifold), grid.spectrum(U_s, manifold), atol=1e-12)
    assert_allclose(grid.spectrum(U_s @ Q, manifold), grid.spectrum(U_s, manifold), atol=1e-12)


def test_a_source_looks_the_same_everywhere():
    """Moved by whole steps of the grid, a source moves its spectrum by as many steps."""
    x = np.array([[0.03, 0.0052]])
    manifold = ULA.scenario.manifold()
    grid = load_network(ULA).grid
    moved = x + np.array([7 * grid.step_u, 3 * grid.step_v])
    here, there = (grid.spectrum(subspace(from_polar(each, manifold))[0], manifold) for each in (x, moved))
    assert_allclose(there[7:, 3:], here[:-7, :-3], atol=1e-6)


@BOTH
@pytest.mark.parametrize("wavefront", ["paper", "exact"])
def test_the_coordinates_are_inverse_to_each_other(wavefront, setting):
    manifold = setting.scenario.manifold().under(wavefront)
    theta = np.random.default_rng(0).uniform(*setting.scenario.box(), (50, manifold.dimension))
    assert_allclose(from_polar(to_polar(theta, manifold), manifold), theta, rtol=1e-12)


def test_coordinates_of_no_source_give_finite_ones():
    manifold = ULA.scenario.manifold()
    theta = from_polar(np.array([[1.5, -0.001], [-2.0, 0.0], [0.0, 0.01]]), manifold)
    assert_allclose(theta, [[np.pi / 2, 2e7], [-np.pi / 2, 2e7], [0.0, 2.0]])


def test_directions_outside_the_unit_circle_give_finite_ones():
    theta = from_polar(np.array([[0.9, 0.6, 0.02], [0.0, 1.2, 0.02], [-0.3, -1.0, -1.0]]), UPA.scenario.manifold())
    assert_allclose(theta, [[np.pi / 2, np.arcsin(0.6), 1.0], [0.0, np.pi / 2, 1.0], [-np.pi / 2, -np.pi / 2, 2e7]])


@BOTH
def test_the_weights_are_small_and_have_their_recipe_beside_them(setting):
    file = FOLDER / f"{setting.file}.npz"
    about, recipe = json.loads(file.with_suffix(".json").read_text(encoding="utf-8")), training.RECIPES[setting.name]
    assert file.stat().st_size <= 300_000
    assert hashlib.sha256(file.read_bytes()).hexdigest() == about["sha256"]
    options = f"--array {setting.name} --scenes {recipe.scenes} --epochs {recipe.epochs}"
    assert about["command"] == f"{COMMAND} {options}" and "unfinished" not in about
    assert about["seed"] == training.SEED and about["training_time"]["threads"] == 1
    assert 0 < about["training_time"]["cpu_s"] < 900
    assert PolarGrid(**about["grid"]) == recipe.grid and tuple(about["widths"]) == recipe.widths
    weights = [array.size for name, array in stored(setting).items() if name.startswith(("weights", "bias"))]
    assert sum(weights) == about["parameters"]
    assert {"python", "numpy", "torch"} == set(about["versions"])


def test_the_weights_are_installed_with_the_package():
    project = tomllib.loads((PROJECT / "pyproject.toml").read_text(encoding="utf-8"))
    patterns = project["tool"]["setuptools"]["package-data"]["nfbench.problems.near_field.learned"]
    wanted = {f"{setting.file}.{kind}" for setting in SETTINGS.values() for kind in ("npz", "json")}
    assert {path.name for pattern in patterns for path in FOLDER.glob(pattern)} == wanted
    (extra,) = project["project"]["optional-dependencies"]["learned"]
    assert extra.startswith("torch>=") and "<3" in extra


@BOTH
def test_the_weights_are_right_in_the_scenes_that_were_held_out(setting):
    """The mean errors of the coordinates in the recipe, by the loss of the training written out again."""
    network, manifold = load_network(setting), setting.scenario.manifold()
    wanted, grid, errors = network.recipe["held_out"], network.grid, []
    steps = np.array([grid.step_u] * len(grid.halves) + [grid.step_v])
    directions = grid.directions.reshape(-1, len(grid.halves))
    subspaces, sources = draw_scenes(setting, wanted["seed"], wanted["scenes"])
    for U_s, theta in zip(subspaces, sources, strict=True):
        _, x = network.propose(grid.spectrum(U_s, manifold))
        true = to_polar(theta, manifold)
        distance = np.abs(directions[:, None] - true[:, :-1]).max(axis=-1)  # (points, sources)
        near = distance.min(axis=1) <= grid.step_u
        errors.append(np.abs(x[near] - true[distance[near].argmin(axis=1)]) / steps)
    expected = [wanted[name] for name in (["u", "v"] if len(steps) == 2 else ["u", "w", "v"])]
    assert_allclose(np.concatenate(errors).mean(axis=0), expected, rtol=0.02)


def test_missing_weights_are_reported_with_the_remedy(tmp_path):
    reason = rf"upa_16_half.npz: expected the weights in .*; reinstall nfbench, or run: {COMMAND} --array upa"
    with pytest.raises(FileNotFoundError, match=reason):
        load_network(UPA, tmp_path)


@BOTH
def test_training_scenes_do_not_depend_on_their_number(setting):
    few, many = draw_scenes(setting, 3, 2), draw_scenes(setting, 3, 4)
    for some, all_of_them in zip(few, many, strict=True):
        assert_array_equal(some, all_of_them[:2])
    assert not np.array_equal(draw_scenes(setting, 4, 1)[1], few[1][:1])
    near, box = setting.near_m, setting.scenario.range_m
    assert box[0] < near < box[1]
    assert (many[1][1::2, :, -1] <= near).all() and (many[1][::2, :, -1] > near).any()


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


@pytest.mark.parametrize("name", ["ula", "upa"])
def test_windows_and_mirrored_scenes_give_the_outputs_that_they_should(name):
    """In windows the network gives what it gives everywhere, also at the edges; mirrored twice, a scene is itself."""
    torch = pytest.importorskip("torch", reason="the extra learned")
    recipe = training.RECIPES[name]
    grid, axes = recipe.grid, recipe.axes
    torch.manual_seed(0)
    network = training.build(recipe)
    e = np.random.default_rng(0).random((20, *[2 * half + 1 for half in grid.halves], grid.count_v))
    edges = [*np.array(grid.halves) - 1.2, 2.0]
    x, sources = training.as_tensors(recipe, e, np.stack([edges, np.zeros(axes + 1)])[None].repeat(20, axis=0))
    with torch.no_grad():
        out, points, of = training.in_windows(recipe, network, x, sources)
        full = training.everywhere(recipe, network, x, sources)[0]
    assert out.shape == (60, axes + 2, 3**axes) and of.shape == (60, 2, axes + 1)
    indices = (points.long() + torch.tensor(grid.halves)).unbind(-1)
    at = np.ravel_multi_index([index.numpy() for index in indices], [2 * half + 1 for half in grid.halves])
    for window in range(60):
        np.testing.assert_allclose(out[window], full[window // 3][:, at[window]], rtol=1e-4, atol=1e-5)
    for axis in range(axes):
        there = training.mirror(recipe, x, sources, axis)
        assert (there[1][:, :, axis] == -sources[:, :, axis]).all()
        assert torch.equal(there[0].flip(2 + axis)[:, : 2 * grid.count_v], x[:, : 2 * grid.count_v])
        assert torch.equal(there[0][:, 2 * grid.count_v :], x[:, 2 * grid.count_v :])  # the direction stays
        for back, here in zip(training.mirror(recipe, *there, axis), (x, sources), strict=True):
            assert torch.equal(back, here)
