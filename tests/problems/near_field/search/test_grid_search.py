"""The greedy search on the grid: its choices compared with explicit projections, and the table with its absence."""

from dataclasses import replace

import numpy as np
import oracles
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from search_scenes import PLANE, SPACE, scene

from nfbench.problems.near_field.channels import complex_normal
from nfbench.problems.near_field.search import grid, kernels, response_grid, search_greedily
from nfbench.problems.near_field.subspace import signal_subspace


def grid_of(instance, density=0.7):
    return response_grid(instance.manifold, instance.lower, instance.upper, density)


def misfits(F, model, others, points):
    """Return J of the other sources with each of the points, by explicit projection."""
    fixed = [oracles.response(model, theta) for theta in others]
    return np.array([oracles.esf(F, np.array([*fixed, oracles.response(model, x)]).T) for x in points])


@pytest.mark.parametrize("manifest", [PLANE, SPACE], ids=["plane", "space"])
@pytest.mark.parametrize("columns", [3, 8])
def test_each_source_is_the_point_that_lowers_the_misfit_most(manifest, columns):
    instance = scene(3, manifest)
    F = complex_normal(np.random.default_rng(0), (instance.manifold.elements, columns))
    F[:, :3] += signal_subspace(instance.Y, 3) * [9.0, 6.0, 3.0]
    candidates = grid_of(instance)
    x, b = kernels.choose_greedily(*instance.manifold.packed, candidates.points, candidates.table, F, 3)
    chosen = x.reshape(3, -1)
    for k in range(3):
        J = misfits(F, instance.manifold, chosen[:k], candidates.points)
        assert_allclose(J[(candidates.points == chosen[k]).all(axis=1)], J.min(), rtol=1e-12)
    A = instance.manifold.response(candidates.points)
    expected = (A.conj() @ F).T
    assert_allclose(b[0] + 1j * b[1], expected, rtol=0, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize(
    "manifest", [pytest.param(PLANE, id="plane"), pytest.param(SPACE, id="space", marks=pytest.mark.slow)]
)
def test_the_best_replacement_of_each_source_is_the_best_point_given_the_others(manifest):
    """One of four sources has been placed wrongly; the best points in place of the others are near these."""
    instance = scene(4, manifest, sources=4, min_separation_deg=10.0)
    U_s = signal_subspace(instance.Y, 4)
    candidates, theta = grid_of(instance, 1.0), instance.theta.copy()
    theta[1, 0] -= 0.5 * np.sign(theta[1, 0])
    packed = *instance.manifold.packed, candidates.points, candidates.table
    _, b = kernels.choose_greedily(*packed, U_s, 4)
    found, alike = kernels.choose_replacements(*packed, U_s, b, theta.ravel())
    for k in range(4):
        J = misfits(U_s, instance.manifold, np.delete(theta, k, axis=0), candidates.points)
        assert_allclose(J[found[k]], J.min(), rtol=1e-10)
        a, old = instance.manifold.response(np.array([candidates.points[found[k]], theta[k]]))
        assert_allclose(alike[k], np.abs(np.vdot(a, old)) ** 2 / len(a) ** 2, rtol=1e-9)
    assert alike[1] < 0.3


def test_no_source_is_chosen_at_the_position_of_another():
    instance = scene(0, sources=1)
    points = np.vstack([instance.theta, instance.theta, [[-0.9, 2.0]]])
    table = kernels.respond_all(*instance.manifold.packed, points)
    F = signal_subspace(instance.Y, 1)
    x, _ = kernels.choose_greedily(*instance.manifold.packed, points, table, F, 2)
    assert_array_equal(x, points[[0, 2]].ravel())


def test_a_table_that_would_be_too_large_changes_nothing(monkeypatch):
    instance = scene(5)
    U_s, stored = signal_subspace(instance.Y, 3), grid_of(instance, 1.5)
    empty = replace(stored, table=stored.table[:, :0].copy())
    assert_array_equal(search_greedily(U_s, empty, 3, 2).x, search_greedily(U_s, stored, 3, 2).x)
    grid._remembered.cache_clear()
    monkeypatch.setattr(grid, "LARGEST_TABLE", 16)
    assert grid_of(instance, 1.5).table.shape == (2, 0, 128)
    grid._remembered.cache_clear()


def test_a_grid_is_made_once_for_equal_arrays_and_boxes():
    first, same, other = grid_of(scene(0)), grid_of(scene(1)), grid_of(scene(0, range_m=[1.0, 20.16]))
    assert first is same and first is not other
    assert_allclose(
        first.table[0, :, :128] + 1j * first.table[1, :, :128], first.manifold.response(first.points), rtol=0, atol=0
    )


def test_a_sweep_corrects_a_wrong_greedy_choice():
    """At density 1.0 the first choices of this scene are wrong; choosing each source again corrects them."""
    instance = scene(26, SPACE)
    U_s, candidates = signal_subspace(instance.Y, 3), grid_of(instance, 1.0)
    assert search_greedily(U_s, candidates, 3, 0).value > 0.9
    assert search_greedily(U_s, candidates, 3, 5).value < 1e-2
