"""The signal subspace: that of the singular value decomposition, by each of its three algorithms."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from nfbench import Incompatible
from nfbench.problems.near_field import subspace
from nfbench.problems.near_field.channels import complex_normal
from nfbench.problems.near_field.subspace import decompose

LEVELS = [-10.0, 0.0, 20.0, 100.0, (40.0, 20.0, 0.0), (60.0, 40.0, 20.0), (100.0, 50.0, 10.0)]


def data(M, T, K, snr_db, seed=0):
    """Return noisy data of K plane waves 15° apart."""
    rng = np.random.default_rng(seed)
    angles = np.radians(15.0 * np.arange(K) - 20.0)
    A = np.exp(1j * np.pi * np.outer(np.arange(M), np.sin(angles)))
    amplitudes = 10 ** (np.broadcast_to(snr_db, K) / 20)
    return (A * amplitudes) @ complex_normal(rng, (K, T)) + complex_normal(rng, (M, T))


def reference(Y, K):
    """Return the left singular vectors with the phases that ``decompose`` chooses, λ and σ̂²."""
    M, T = Y.shape
    vectors, values, _ = np.linalg.svd(Y, full_matrices=False)
    U = vectors[:, :K]
    pivots = U[np.argmax(np.abs(U), axis=0), np.arange(K)]
    return U * (pivots.conj() / np.abs(pivots)), values[:K] ** 2 / T, np.sum(values[K:] ** 2) / T / max(M - K, 1)


def angle(U, V):
    """Return the sine of the largest angle between the spans of U and V."""
    return np.linalg.norm(U - V @ (V.conj().T @ U), 2)


@pytest.mark.parametrize("snr_db", LEVELS, ids=str)
@pytest.mark.parametrize(("M", "T"), [(128, 200), (256, 100), (64, 300), (128, 20), (7, 5), (96, 96)])
def test_it_is_that_of_the_singular_value_decomposition(M, T, snr_db):
    Y = data(M, T, 3, snr_db)
    U_s, eigenvalues, noise = reference(Y, 3)
    found = decompose(Y, 3)
    assert angle(found.U_s, U_s) < 1e-10
    assert_allclose(found.U_s, U_s, rtol=0, atol=1e-10)
    assert_allclose(found.U_s.conj().T @ found.U_s, np.eye(3), atol=1e-13)
    assert_allclose(found.eigenvalues, eigenvalues, rtol=1e-10)
    assert_allclose(found.noise, noise, rtol=1e-7)


def test_the_largest_data_of_a_study():
    Y = data(512, 512, 3, 20.0)
    assert angle(decompose(Y, 3).U_s, reference(Y, 3)[0]) < 1e-10


@pytest.mark.parametrize(
    ("M", "T", "snr_db", "expected"),
    [
        (128, 200, 20.0, "_by_power_iteration"),
        (128, 200, -10.0, "_by_gram_matrix"),
        (64, 300, 20.0, "_by_gram_matrix"),
        (128, 200, (100.0, 50.0, 10.0), "_by_singular_values"),
    ],
)
def test_each_algorithm_is_used_where_it_is_the_fastest_that_is_certain(M, T, snr_db, expected, monkeypatch):
    used = []
    for name in ("_by_power_iteration", "_by_gram_matrix", "_by_singular_values"):
        original = getattr(subspace, name)

        def watched(*given, name=name, original=original):
            found = original(*given)
            used.extend([name] if found is not None else [])
            return found

        monkeypatch.setattr(subspace, name, watched)
    decompose(data(M, T, 3, snr_db), 3)
    assert used == [expected]


@pytest.mark.parametrize(("M", "T", "K"), [(4, 3, 2), (4, 3, 3), (3, 4, 3), (5, 2, 2), (1, 1, 1), (100, 100, 99)])
def test_the_smallest_data_and_as_many_sources_as_possible(M, T, K):
    Y = complex_normal(np.random.default_rng(0), (M, T))
    U_s, eigenvalues, noise = reference(Y, K)
    found = decompose(Y, K)
    assert_allclose(found.U_s, U_s, rtol=0, atol=1e-9)
    assert_allclose(found.eigenvalues, eigenvalues, rtol=1e-12)
    assert_allclose(found.noise, noise, rtol=1e-7, atol=1e-14 * eigenvalues[0])


@pytest.mark.parametrize("shape", [(128, 200), (40, 60)])
@pytest.mark.parametrize("rank", [1, 2, 3])
def test_data_without_noise(shape, rank):
    rng = np.random.default_rng(1)
    Y = complex_normal(rng, (shape[0], rank)) @ complex_normal(rng, (rank, shape[1]))
    found = decompose(Y, 3)
    assert_allclose(found.U_s.conj().T @ found.U_s, np.eye(3), atol=1e-13)
    assert angle(np.linalg.svd(Y)[0][:, :rank], found.U_s) < 1e-12
    assert 0 <= found.noise < 1e-25 * found.eigenvalues[0]
    assert_allclose(found.eigenvalues[rank:], 0.0, atol=1e-12 * found.eigenvalues[0])


def test_data_of_zeros_have_some_orthonormal_vectors():
    found = decompose(np.zeros((128, 200), complex), 2)
    assert_allclose(found.U_s.conj().T @ found.U_s, np.eye(2), atol=1e-14)
    assert_array_equal(found.eigenvalues, 0.0)


@pytest.mark.parametrize("active", [slice(190, 200), slice(0, 5), slice(60, 63)])
def test_a_source_that_is_silent_most_of_the_time_is_not_missed(active):
    rng = np.random.default_rng(2)
    symbols = complex_normal(rng, (3, 200))
    silent = np.ones(200, bool)
    silent[active] = False
    symbols[2, silent] = 0.0
    A = np.exp(1j * np.pi * np.outer(np.arange(128), np.sin([-0.5, 0.1, 0.7])))
    Y = 100 * A @ symbols + complex_normal(rng, (128, 200))
    assert angle(decompose(Y, 3).U_s, reference(Y, 3)[0]) < 1e-10


def test_the_order_of_memory_and_the_type_do_not_matter():
    Y = data(128, 200, 3, 20.0)
    expected = decompose(Y, 3).U_s
    assert_array_equal(decompose(np.asfortranarray(Y), 3).U_s, expected)
    frozen = Y.copy()
    frozen.flags.writeable = False
    assert_array_equal(decompose(frozen, 3).U_s, expected)
    assert_array_equal(decompose(Y, 3).U_s, expected)


@pytest.mark.parametrize("value", [np.nan, np.inf, complex(0, -np.inf)])
def test_data_that_are_not_finite_are_refused(value):
    Y = data(128, 200, 3, 20.0)
    Y[3, 5] = value
    with pytest.raises(ValueError, match="Y: expected finite data, got NaN or infinite entries"):
        decompose(Y, 3)


def test_fewer_snapshots_than_sources_are_incompatible():
    with pytest.raises(Incompatible, match=r"snapshots: expected at least 3 .* got 2"):
        decompose(data(10, 2, 1, 0.0), 3)
