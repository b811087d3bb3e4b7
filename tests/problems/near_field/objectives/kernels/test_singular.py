"""The rank-revealing steps for nearly singular candidates, against NumPy's pseudo-inverse and sorting."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from nfbench.problems.near_field.channels import complex_normal
from nfbench.problems.near_field.objectives.kernels import warm_up
from nfbench.problems.near_field.objectives.kernels.singular import orthogonalize, source_order


def orthogonalized(V: np.ndarray, least: float) -> tuple[int, np.ndarray, np.ndarray, np.ndarray]:
    """The rank, Q, R and the pivots of the rows of V."""
    r = min(V.shape)
    Q, R = np.full((r, V.shape[1]), np.nan + 0j), np.full((r, len(V)), np.nan + 0j)
    pivots = np.zeros(r, np.int64)
    return orthogonalize(V.copy(), least, Q, R, pivots), Q, R, pivots


@pytest.mark.parametrize(("n", "m", "rank"), [(1, 5, 1), (4, 9, 4), (6, 9, 3), (9, 4, 4), (7, 7, 0)])
def test_the_rank_and_an_orthonormal_basis(n, m, rank):
    warm_up()
    rng = np.random.default_rng(n)
    V = complex_normal(rng, (n, max(rank, 1))) @ complex_normal(rng, (max(rank, 1), m)) * (rank > 0)
    found, Q, R, pivots = orthogonalized(V, 1e-20)
    assert found == rank
    assert_allclose(Q.conj() @ Q.T, np.diag(np.arange(len(Q)) < rank), rtol=0, atol=1e-14)
    assert_allclose(R.T @ Q, V, rtol=0, atol=1e-13)
    assert_allclose(np.tril(R[:rank, pivots[:rank]], -1), 0.0, atol=1e-14)


def test_nearly_dependent_vectors_stay_orthonormal():
    """Distances of 1e-7 from a plane: one pass of Gram–Schmidt loses half of the digits."""
    rng = np.random.default_rng(0)
    V = complex_normal(rng, (6, 2)) @ complex_normal(rng, (2, 40)) + 1e-7 * complex_normal(rng, (6, 40))
    rank, Q, R, _ = orthogonalized(V, 1e-20)
    assert rank == 6
    assert_allclose(Q.conj() @ Q.T, np.eye(6), rtol=0, atol=1e-14)
    assert_allclose(R.T @ Q, V, rtol=0, atol=1e-14)


@pytest.mark.parametrize("d", [2, 3])
def test_sources_are_ordered_by_their_coordinates(d):
    rng = np.random.default_rng(d)
    for _ in range(50):
        theta = rng.integers(0, 3, (6, d)).astype(float)  # many are equal
        order = source_order(theta.reshape(1, -1), 0, 6)
        assert_array_equal(order, np.lexsort(theta.T[::-1]))
