"""What is said about estimated sources: positions in the user's coordinates, standard errors, powers, the picture."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis_scenes import PLANE, SCENES

from nfbench.problems.near_field.bounds import position_bounds, stochastic_bound
from nfbench.problems.near_field.channels import complex_normal
from nfbench.problems.near_field.estimators.grid_refine import GridRefine
from nfbench.problems.near_field.geometry import cartesian
from nfbench.problems.near_field.scenario import NearField


@pytest.fixture(scope="module")
def turned():
    """A scene whose array lies in the x-y plane of the user, away from the origin."""
    rng = np.random.default_rng(8)
    Q = np.column_stack([rng.uniform(-0.3, 0.3, (40, 2)), np.zeros(40)]) + np.array([1.0, 2.0, 3.0])
    array = {"kind": "custom", "origin": "center", "positions": Q.tolist(), "broadside": "-z", "up": "+x"}
    scene = {"wavelength_m": 0.1, "sources": 2, "snapshots": 200, "snr_db": (10.0, 0.0)}
    where = {"azimuth_deg": (-60, 60), "elevation_deg": (-60, 60), "range_m": (0.4, 2.0)}
    return NearField(array=array, **scene, **where, positions=[(-20, 15, 0.7), (25, -10, 0.9)])


def test_positions_are_in_the_coordinates_of_the_user(turned):
    instance = turned.draw(np.random.default_rng(0))
    found = instance.describe(instance.theta, {})
    Q = np.array(turned.array.positions)
    for k, ((azimuth, elevation, r), source) in enumerate(zip(instance.theta, found.sources, strict=True)):
        u = np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)
        # broadside −z, up +x, and left = up × broadside = +x × −z = +y
        expected = Q.mean(axis=0) + r * (u[0] * np.array([0, 0, -1]) + u[1] * np.array([0, 1, 0]) + u[2] * np.eye(3)[0])
        assert [source[name] for name in ("x_m", "y_m", "z_m")] == pytest.approx(expected)
        assert source["azimuth_deg"] == pytest.approx(np.degrees(azimuth)) and source["range_m"] == pytest.approx(r)
        assert found.picture.sources[k] == pytest.approx(expected)
        # the same waves arrive at the elements of the picture as the model says
        path = np.linalg.norm(found.picture.elements - expected, axis=1)
        a = np.exp(-2j * np.pi / 0.1 * path)
        assert np.abs(a.conj() @ instance.manifold.response(instance.theta[k])) == pytest.approx(40.0)
    assert found.picture.elements == pytest.approx(Q)
    assert found.picture.truth == pytest.approx(found.picture.sources)


def test_two_dimensions_have_no_elevation():
    instance = SCENES["ULA of 16 elements"].draw(np.random.default_rng(0))
    source = instance.describe(instance.theta, {}).sources[0]
    assert "elevation_deg" not in source and "std_elevation_deg" not in source and source["z_m"] == 0.0


def test_standard_errors_are_those_of_the_stochastic_bound(turned):
    instance = turned.draw(np.random.default_rng(1))
    found = instance.describe(instance.theta, {})
    snr = 10 ** (np.array([source["snr_db"] for source in found.sources]) / 10)
    assert snr == pytest.approx([10.0, 1.0], rel=0.35)
    bound = stochastic_bound(instance.manifold, instance.theta, snr, 200)
    expected = np.sqrt(np.diag(bound)).reshape(2, 3) * [180 / np.pi, 180 / np.pi, 1.0]
    names = "std_azimuth_deg", "std_elevation_deg", "std_range_m"
    # the estimated powers include an estimated correlation of the signals, which is small
    assert np.array([[s[name] for name in names] for s in found.sources]) == pytest.approx(expected, rel=0.03)
    total = [np.sqrt(sum(source[f"std_{c}_m"] ** 2 for c in "xyz")) for source in found.sources]
    assert total == pytest.approx(position_bounds(bound, instance.theta), rel=0.03)
    assert [np.trace(C) for C in found.picture.covariances] == pytest.approx(np.square(total))


def test_standard_errors_are_those_of_repeated_measurements(turned):
    scenario = replace(turned, snr_db=5.0)
    stds, estimates = [], []
    for seed in range(60):
        instance = scenario.draw(np.random.default_rng(seed))
        theta = GridRefine(objective="wsf").solve(instance, None).estimate
        theta = theta[np.argsort(theta[:, 0])]
        sources = instance.describe(theta, {}).sources
        estimates.append([[source[f"{c}_m"] for c in "xyz"] for source in sources])
        stds.append([[source[f"std_{c}_m"] for c in "xyz"] for source in sources])
    ratio = np.std(estimates, axis=0) / np.sqrt(np.mean(np.square(stds), axis=0))
    assert ((ratio > 0.75) & (ratio < 1.3)).all(), ratio


def test_coherent_signals_have_larger_errors_than_uncorrelated_ones():
    scenario = NearField(**{**PLANE, "snapshots": 500}, snr_db=10.0)
    instance = scenario.draw(np.random.default_rng(2))
    rng = np.random.default_rng(3)
    one = np.sqrt(10) * complex_normal(rng, (1, 500))
    A = instance.manifold.response(instance.theta).T
    coherent = replace(instance, Y=A @ np.vstack([one, 1j * one]) + complex_normal(rng, (64, 500)))
    rows = [each.describe(instance.theta, {}).sources for each in (instance, coherent)]
    assert rows[0][0]["snr_db"] == pytest.approx(10.0, abs=0.6) and rows[1][0]["snr_db"] == pytest.approx(10, abs=0.6)
    assert all(np.isfinite(row["std_range_m"]) for row in rows[1])


def test_what_is_not_known_is_nan(turned):
    instance = turned.draw(np.random.default_rng(0))
    edge = instance.theta.copy()
    edge[0, 2] = instance.upper[2]
    first, second = instance.describe(edge, {}).sources
    assert np.isnan([first["std_x_m"], first["std_range_m"]]).all() and np.isfinite(second["std_range_m"])
    clean = replace(instance, Y=instance.manifold.response(instance.theta).T @ instance.symbols)
    found = clean.describe(instance.theta, {})
    assert np.isnan([found.sources[0]["snr_db"], found.sources[0]["std_x_m"], found.fit["p_value"]]).all()
    nothing = instance.describe(np.empty((0, 3)), {})
    assert nothing.sources == () and np.isnan(nothing.fit["misfit"])


def test_the_fit_has_its_numbers(turned):
    instance = turned.draw(np.random.default_rng(0))
    fit = instance.describe(instance.theta, {}).fit
    A = instance.manifold.response(instance.theta).T
    residual = instance.Y - A @ np.linalg.lstsq(A, instance.Y)[0]
    assert fit["misfit"] == pytest.approx(np.linalg.norm(residual) ** 2 / np.linalg.norm(instance.Y) ** 2)
    assert fit["noise_power"] == pytest.approx(1.0, rel=0.05)
    counts = {"sources": 2, "elements": 40, "snapshots": 200, "significant_eigenvalues": 2, "wavelength_m": 0.1}
    assert {name: fit[name] for name in counts} == counts


def test_the_box_of_the_picture_has_its_corners(turned):
    instance = turned.draw(np.random.default_rng(0))
    lines = np.concatenate(instance.describe(instance.theta, {}).picture.box)
    for corner in np.ndindex(2, 2, 2):
        theta = np.where(np.array(corner) == 0, instance.lower, instance.upper)
        expected = instance.frame.outward(cartesian(theta))
        assert np.linalg.norm(lines - expected, axis=1).min() < 1e-9
