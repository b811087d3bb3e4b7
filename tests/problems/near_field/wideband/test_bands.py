"""Guards wideband scenes: what the frequency bins have in common and what is independent, and the bounds from them."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.linalg import block_diag
from scipy.optimize import minimize
from wideband_scenes import WIDEBAND, assert_same_covariance, misfit, response, scene, slopes

from nfbench import Incompatible, OptionError
from nfbench.core.options import build
from nfbench.problems.near_field.bands import Band, bounds_of_bands, one_band, spread_bins
from nfbench.problems.near_field.bounds import deterministic_bound, stochastic_bound
from nfbench.problems.near_field.floor import floor_of_bands, local_fit
from nfbench.problems.near_field.scenario import NearField


@pytest.mark.parametrize(
    ("bins", "expected"),
    [(1, [1.0]), (2, [0.8, 1.2]), (3, [1.0, 0.8, 1.2]), (5, [1.0, 0.9, 1.1, 0.8, 1.2])],
)
def test_the_bins_divide_the_bandwidth_and_the_nearest_to_the_carrier_comes_first(bins, expected):
    found = spread_bins(bins, 0.4)
    assert found[0] == expected[0]  # the carrier exactly
    assert_allclose(found, expected, rtol=1e-15)


def test_further_bins_change_nothing_in_the_data_of_the_carrier():
    narrow, three, five = scene(7, bins=1), scene(7), scene(7, bins=5, bandwidth_relative=0.6)
    assert len(narrow.bands) == 1 and not narrow.further
    for wide in (three, five):
        for name in ("Y", "theta", "H", "symbols", "snr"):
            assert_array_equal(getattr(wide, name), getattr(narrow, name))
    for first, second in zip(three.bands, five.bands, strict=False):  # the first three bins of the five
        assert first.manifold.wavelength_m == second.manifold.wavelength_m
        assert_array_equal(first.Y, second.Y)


def test_each_bin_has_its_wavelength_and_the_same_array_and_sources():
    wide = scene(3, snapshots=400)
    assert [band.manifold.wavelength_m for band in wide.bands] == [0.02, 0.02 / 0.85, 0.02 / 1.15]
    for band in wide.bands:
        assert_array_equal(band.manifold.positions, wide.manifold.positions)
        A = response(wide.manifold.positions, band.manifold.wavelength_m, wide.theta)
        noise = band.Y - A @ band.symbols
        assert_allclose(np.mean(np.abs(noise) ** 2), 1, rtol=0.04)  # 9,600 values
        assert_allclose(np.mean(np.abs(band.symbols) ** 2, axis=1), wide.snr, rtol=0.25)


def test_symbols_noise_and_scattering_of_different_bins_are_independent():
    wide = scene(5, snapshots=500, rician_k=1.0, fading="snapshot")
    for i, first in enumerate(wide.bands):
        for second in wide.bands[i + 1 :]:
            noise = [band.Y - np.einsum("tmk,kt->mt", band.H, band.symbols) for band in (first, second)]
            scattered = [band.H - band.H.mean(axis=0) for band in (first, second)]
            for a, b in [noise, scattered, (first.symbols, second.symbols)]:
                limit = 4.5 / np.sqrt(a.size)
                assert abs(np.vdot(a, b)) / np.linalg.norm(a) / np.linalg.norm(b) < limit


def test_impossible_bins_are_refused_by_name():
    for changes, name in [({"bins": 0}, "bins"), ({"bandwidth_relative": 2.0}, "bandwidth_relative")]:
        with pytest.raises(OptionError, match=name):
            scene(**changes)
    with pytest.raises(OptionError, match="bins: expected at most 100,000,000 numbers"):
        scene(bins=1000, snapshots=10_000)
    with pytest.raises(Incompatible, match="bins: expected 1 for certified, as it is so, got 3"):
        one_band(scene().bands, "certified", "as it is so")
    assert build(NearField, WIDEBAND | {"bins": 1}).bins == 1


# bounds


def small(**changes):
    return scene(2, array={**WIDEBAND["array"], "elements": 8}, snapshots=5, snr_db=[3.0, 8.0], **changes)


def test_the_deterministic_bound_is_that_of_the_whole_fisher_matrix():
    """Positions and all symbols of all bins are unknown; the Jacobian of the mean is that of plain differences."""
    wide = small()

    def mean(x, k):
        band = wide.bands[k]
        return (response(band.manifold.positions, band.manifold.wavelength_m, x) @ band.symbols).ravel()

    by_position = np.vstack([slopes(lambda x, k=k: mean(x, k), wide.theta.ravel()) for k in range(3)])
    by_symbols = block_diag(
        *[
            np.kron(response(band.manifold.positions, band.manifold.wavelength_m, wide.theta), np.eye(5))
            for band in wide.bands
        ]
    )
    J = np.hstack([by_position, by_symbols, 1j * by_symbols])
    expected = np.linalg.inv(2 * (J.conj().T @ J).real)[:4, :4]
    assert_same_covariance(bounds_of_bands(wide.bands, wide.theta, wide.snr)[1], expected, 1e-6)


def test_the_stochastic_bound_is_that_of_the_whole_fisher_matrix():
    """Slepian and Bangs: T·tr(R⁻¹∂R·R⁻¹∂R), with the covariance of the symbols and the noise unknown in each bin."""
    wide = small()
    K, T = 2, wide.Y.shape[1]
    basis = [np.array(b) for b in ([[1, 0], [0, 0]], [[0, 0], [0, 1]], [[0, 1], [1, 0]], [[0, 1j], [-1j, 0]])]
    free = len(basis) + 1
    fisher = np.zeros((2 * K + 3 * free,) * 2)
    for f, band in enumerate(wide.bands):

        def covariance(x, manifold=band.manifold):
            A = response(manifold.positions, manifold.wavelength_m, x)
            return A @ np.diag(wide.snr) @ A.conj().T + np.eye(8)

        A = response(band.manifold.positions, band.manifold.wavelength_m, wide.theta)
        by_position = np.moveaxis(slopes(covariance, wide.theta.ravel()), -1, 0)
        derivatives = [*by_position, *(A @ b @ A.conj().T for b in basis), np.eye(8)]
        index = [*range(2 * K), *range(2 * K + f * free, 2 * K + (f + 1) * free)]
        whitened = [np.linalg.solve(covariance(wide.theta.ravel()), each) for each in derivatives]
        fisher[np.ix_(index, index)] += T * np.array([[np.trace(a @ b).real for b in whitened] for a in whitened])
    expected = np.linalg.inv(fisher)[: 2 * K, : 2 * K]
    assert_same_covariance(bounds_of_bands(wide.bands, wide.theta, wide.snr)[0], expected, 1e-6)


def test_bins_at_one_frequency_are_worth_as_many_snapshots():
    wide, narrow = scene(4, bandwidth_relative=0.0), scene(4, bins=1)
    assert_allclose(wide.bounds()["crb_m"], narrow.bounds()["crb_m"] / np.sqrt(3), rtol=1e-10)
    symbols = np.hstack([band.symbols for band in wide.bands])
    stochastic, deterministic = bounds_of_bands(wide.bands, wide.theta, wide.snr)
    assert_allclose(stochastic, stochastic_bound(wide.manifold, wide.theta, wide.snr, 180), rtol=1e-9)
    assert_allclose(deterministic, deterministic_bound(wide.manifold, wide.theta, symbols), rtol=1e-9)


def test_bins_with_different_numbers_of_snapshots_count_by_their_snapshots():
    wide = scene(6)
    first, second, third = wide.bands
    shorter = Band(second.Y[:, :20], second.manifold, second.H, second.symbols[:, :20])
    parts = [bounds_of_bands([band], wide.theta, wide.snr) for band in (first, shorter, third)]
    together = bounds_of_bands([first, shorter, third], wide.theta, wide.snr)
    for k in range(2):
        assert_allclose(together[k], np.linalg.inv(sum(np.linalg.inv(part[k]) for part in parts)), rtol=1e-8)


def test_the_bound_is_infinite_where_two_sources_coincide():
    wide = scene(1)
    assert np.isinf(bounds_of_bands(wide.bands, wide.theta[[0, 0]], wide.snr)[0]).all()


def test_the_floor_is_the_least_squares_fit_to_the_channels_of_all_bins():
    wide = scene(8, rician_k=5.0, fading="block")
    box = wide.lower, wide.upper
    found = floor_of_bands(wide.bands, wide.theta, *box)

    def objective(x):
        A = [response(band.manifold.positions, band.manifold.wavelength_m, x) for band in wide.bands]
        return sum(misfit(band.H[0], each) for band, each in zip(wide.bands, A, strict=True))

    precise = {"xatol": 1e-9, "fatol": 1e-12, "maxiter": 4000}
    naive = minimize(objective, wide.theta.ravel(), method="Nelder-Mead", options=precise)
    assert_allclose(found.ravel(), naive.x, rtol=1e-5)
    assert wide.bounds()["floor_m"] > 0
    twice = replace(wide, further=(Band(wide.Y, wide.manifold, wide.H, wide.symbols),))
    alone = local_fit(wide.H[0], wide.manifold, wide.theta, *box)
    assert_allclose(floor_of_bands(twice.bands, wide.theta, *box), alone, rtol=1e-4)
