"""The steps of subspace fitting, one row at a time, against NumPy's Cholesky factorization of the Gram matrix."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from nfbench.problems.near_field.channels import complex_normal
from nfbench.problems.near_field.objectives.kernels import pack_subspace
from nfbench.problems.near_field.objectives.kernels.subspace_fitting import extend_cholesky, gram_row, project

M = 21


def steps(U_s: np.ndarray, A: np.ndarray, least: float) -> tuple[np.ndarray, np.ndarray, float]:
    """L, W and ‖W‖² after all steps."""
    K = A.shape[1]
    rows, h, L, W = pack_subspace(U_s)
    L[:] = np.nan
    W[:] = np.nan
    energy = 0.0
    for j in range(K):
        rows[0, K + j, :M], rows[1, K + j, :M] = A[:, j].real, A[:, j].imag
        gram_row.py_func(rows, K, j, h)
        assert_allclose(h[: K + j], A[:, j].conj() @ np.hstack([U_s, A[:, :j]]), rtol=0, atol=1e-12)
        root = extend_cholesky.py_func(h, j, M, least, L)
        energy = project.py_func(h, L, j, root, W, energy)
    return L, W, energy


@pytest.mark.parametrize("K", range(1, 8))
def test_the_steps_are_cholesky_and_forward_substitution(K):
    rng = np.random.default_rng(K)
    U_s = np.linalg.qr(complex_normal(rng, (M, K)))[0]
    A = np.exp(2j * np.pi * rng.random((M, K)))
    L, W, energy = steps(U_s, A, 0.0)
    expected = np.linalg.cholesky(A.conj().T @ A)
    assert_allclose(np.tril(L), expected, rtol=0, atol=1e-12)
    assert_allclose(W, np.linalg.solve(expected, A.conj().T @ U_s), rtol=0, atol=1e-12)
    assert energy == pytest.approx(np.linalg.norm(np.linalg.qr(A)[0].conj().T @ U_s) ** 2)


def test_a_twin_gets_the_least_pivot_and_no_energy():
    rng = np.random.default_rng(0)
    U_s = np.linalg.qr(complex_normal(rng, (M, 2)))[0]
    A = np.exp(2j * np.pi * rng.random((M, 1))) * np.ones(2)
    L, _, energy = steps(U_s, A, 1e-13 * M)
    assert L[1, 1] == np.sqrt(1e-13 * M)
    assert energy == pytest.approx(np.linalg.norm(A[:, 0].conj() @ U_s) ** 2 / M, abs=1e-12)
