"""The steps of subspace fitting, one row at a time, against NumPy's Cholesky factorization of the Gram matrix."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from nfbench.problems.near_field.channels import complex_normal
from nfbench.problems.near_field.objectives.kernels import pack_factor
from nfbench.problems.near_field.objectives.kernels.inner_products import gram_row
from nfbench.problems.near_field.objectives.kernels.subspace_fitting import extend_cholesky, project

M = 21


def steps(F: np.ndarray, A: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """L, W and ‖W‖² after all steps."""
    K = A.shape[1]
    rows, h, L, W = pack_factor(F, K)
    c = W.shape[1]
    L[:] = np.nan
    W[:] = np.nan
    energy = 0.0
    for j in range(K):
        rows[0, c + j, :M], rows[1, c + j, :M] = A[:, j].real, A[:, j].imag
        gram_row.py_func(rows, c, j, h)
        zeros = np.zeros((M, c - F.shape[1]))
        assert_allclose(h[: c + j], A[:, j].conj() @ np.hstack([F, zeros, A[:, :j]]), rtol=0, atol=1e-12)
        L[j, j] = root = np.sqrt(extend_cholesky.py_func(h, c, j, M, L))
        energy = project.py_func(h, L, j, root, W, energy)
    return L, W, energy


@pytest.mark.parametrize("K", range(1, 8))
def test_the_steps_are_cholesky_and_forward_substitution(K):
    rng = np.random.default_rng(K)
    U_s = np.linalg.qr(complex_normal(rng, (M, K)))[0]
    A = np.exp(2j * np.pi * rng.random((M, K)))
    L, W, energy = steps(U_s, A)
    expected = np.linalg.cholesky(A.conj().T @ A)
    assert_allclose(np.tril(L), expected, rtol=0, atol=1e-12)
    assert_allclose(W, np.linalg.solve(expected, A.conj().T @ U_s), rtol=0, atol=1e-12)
    assert energy == pytest.approx(np.linalg.norm(np.linalg.qr(A)[0].conj().T @ U_s) ** 2)


@pytest.mark.parametrize("c", [1, 16, 17, 21])
def test_a_factor_of_any_width_and_a_triangular_one_beyond_the_lanes(c):
    rng = np.random.default_rng(c)
    F = complex_normal(rng, (M, c))
    F = np.tril(F) if c > 16 else F
    A = np.exp(2j * np.pi * rng.random((M, 3)))
    _, W, energy = steps(F, A)
    assert W.shape == (3, {1: 1, 16: 16, 17: 20, 21: 24}[c])
    assert_allclose(W[:, c:], 0.0, atol=0)
    assert energy == pytest.approx(np.linalg.norm(np.linalg.qr(A)[0].conj().T @ F) ** 2)


def test_the_pivot_of_a_twin_vanishes():
    A = np.exp(2j * np.pi * np.random.default_rng(0).random((M, 1))) * np.ones(2)
    rows, h, L, _ = pack_factor(A[:, :1], 2)
    rows[0, 1:3, :M], rows[1, 1:3, :M] = A.T.real, A.T.imag
    for j in range(2):
        gram_row.py_func(rows, 1, j, h)
        pivot = extend_cholesky.py_func(h, 1, j, M, L)
        L[j, j] = np.sqrt(max(pivot, 0.0))
    assert abs(pivot) < 1e-13 * M
