"""The error floor under fading, compared with independent least-squares fits, and the columns of the bounds."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import optimize

import nfbench
from nfbench.core.options import build
from nfbench.problems.near_field.floor import local_fit, noise_free_columns
from nfbench.problems.near_field.geometry import cartesian
from nfbench.problems.near_field.scenario import NearField

LINE = {
    "array": {"kind": "ula", "elements": 48, "spacing_wavelengths": 0.5, "origin": "first"},
    "wavelength_m": 0.02,
    "wavefront": "paper",
    "sources": 3,
    "snapshots": 40,
    "snr_db": 20.0,
    "rician_k": 10.0,
    "fading": "block",
    "azimuth_deg": [-60, 60],
    "range_m": [0.5, 5.0],
    "min_separation_deg": 5.0,
}
PLANE = LINE | {
    "array": {"kind": "upa", "columns": 8, "rows": 8, "spacing_wavelengths": 0.5, "origin": "center"},
    "wavefront": "exact",
    "elevation_deg": [-30, 30],
    "range_m": [0.2, 0.5],
}


def draw(manifest=LINE, seed=0, **changes):
    return build(NearField, manifest | changes).draw(np.random.default_rng(seed))


def without_noise(instance):
    """Return H·diag(√snr)·S, computed snapshot by snapshot."""
    H = np.broadcast_to(instance.H, (instance.Y.shape[1], *instance.H.shape[1:]))
    return np.stack([H_t @ s_t for H_t, s_t in zip(H, instance.symbols.T, strict=True)], axis=1)


def fitted_by_trust_region(instance, columns):
    """Return the same fit by SciPy's least_squares on the residuals, with derivatives by finite differences."""
    K, d = instance.theta.shape

    def residuals(x):
        A = instance.manifold.response(x.reshape(K, d)).T
        E = columns - A @ np.linalg.lstsq(A, columns)[0]
        return np.concatenate([E.real.ravel(), E.imag.ravel()])

    box = np.tile(instance.lower, K), np.tile(instance.upper, K)
    fit = optimize.least_squares(
        residuals, instance.theta.ravel(), bounds=box, x_scale="jac", xtol=1e-13, ftol=1e-13, gtol=1e-13
    )
    return fit.x.reshape(K, d)


@pytest.mark.parametrize("rician_k", [1.0, 10.0])
@pytest.mark.parametrize("manifest", [LINE, PLANE], ids=["2d", "3d"])
@pytest.mark.parametrize("fading", ["block", "snapshot"])
def test_the_floor_is_the_error_of_least_squares_without_noise(fading, manifest, rician_k):
    for seed in range(3):
        instance = draw(manifest, seed, fading=fading, rician_k=rician_k)
        columns = instance.H[0] if fading == "block" else without_noise(instance)
        fitted = fitted_by_trust_region(instance, columns)
        errors = np.linalg.norm(cartesian(fitted) - cartesian(instance.theta), axis=1)
        assert list(instance.bounds()) == ["floor_m"]
        assert instance.bounds()["floor_m"] == pytest.approx(math.sqrt(np.mean(errors**2)), rel=2e-3)


def test_the_floor_is_the_error_of_least_squares_as_the_noise_vanishes():
    instance = draw(fading="snapshot", snr_db=90.0)
    fitted = local_fit(instance.Y, instance.manifold, instance.theta, instance.lower, instance.upper)
    errors = np.linalg.norm(cartesian(fitted) - cartesian(instance.theta), axis=1)
    assert instance.bounds()["floor_m"] == pytest.approx(math.sqrt(np.mean(errors**2)), rel=1e-2)


def test_the_floor_vanishes_with_the_scattering():
    for fading in ("block", "snapshot"):
        floors = [draw(fading=fading, rician_k=k).bounds()["floor_m"] for k in (1e4, 1e8, 1e12)]
        assert_allclose(floors[1] / floors[0], 1e-2, rtol=0.2)
        assert floors[2] < 1e-4


def test_under_block_fading_the_floor_does_not_depend_on_the_snrs():
    floor = draw().bounds()["floor_m"]
    assert draw(snr_db=[-10.0, 20.0, 50.0]).bounds()["floor_m"] == floor
    equal, unequal = (draw(fading="snapshot", snr_db=snr).bounds()["floor_m"] for snr in (20.0, [0.0, 20.0, 40.0]))
    assert unequal > 3 * equal  # under snapshot fading, strong sources mask weak ones


def test_the_fit_stays_in_the_box_and_accepts_coincident_sources():
    instance = draw(positions=[[-60, 5.0], [60, 0.5], [60, 0.5]], min_separation_deg=0.0, rician_k=1.0)
    columns = noise_free_columns(instance.H, instance.symbols)
    fitted = local_fit(columns, instance.manifold, instance.theta, instance.lower, instance.upper)
    assert (fitted >= instance.lower).all()
    assert (fitted <= instance.upper).all()
    assert np.isfinite(instance.bounds()["floor_m"])


def test_the_columns_of_the_fit_are_the_channel_or_the_noise_free_snapshots():
    block, snapshot = draw(snr_db=200.0), draw(snr_db=200.0, fading="snapshot")
    assert (block.H.shape, snapshot.H.shape) == ((1, 48, 3), (40, 48, 3))
    for instance in (block, snapshot):
        assert_allclose(without_noise(instance), instance.Y, rtol=0, atol=1e-8 * np.abs(instance.Y).max())
    assert_array_equal(noise_free_columns(block.H, block.symbols), block.H[0])
    columns = noise_free_columns(snapshot.H, snapshot.symbols)
    assert_allclose(columns, snapshot.Y, rtol=0, atol=1e-8 * np.abs(columns).max())
    assert_allclose(np.mean(np.abs(draw(snapshots=20_000).symbols) ** 2, axis=1), 100, rtol=0.03)


def test_line_of_sight_has_bounds_and_a_planar_wavefront_has_none():
    sight = draw(rician_k=math.inf)
    bounds = sight.bounds()
    assert list(bounds)[:5] == ["crb_m", "crb_deterministic_m", "crb_1_m", "crb_2_m", "crb_3_m"]
    per_source = [bounds[f"crb_{k}_m"] for k in (1, 2, 3)]
    assert bounds["crb_m"] == pytest.approx(math.sqrt(np.mean(np.square(per_source))), rel=1e-12)
    assert bounds["crb_deterministic_m"] == pytest.approx(bounds["crb_m"], rel=0.2)
    assert {**sight.score(sight.theta), **bounds} == sight.score(sight.theta)
    imbalanced = draw(rician_k=math.inf, snr_db=[20.0, 20.0, 0.0]).bounds()
    assert imbalanced["crb_3_m"] > 9 * bounds["crb_3_m"]
    assert draw(rician_k=math.inf, wavefront="planar").bounds() == draw(wavefront="planar").bounds() == {}


STUDY = """
name = "bounds"
repetitions = 2
seed = 1
[scenario]
kind = "near-field"
array = { kind = "ula", elements = 16, spacing_wavelengths = 0.5, origin = "center" }
wavelength_m = 0.02
sources = 2
snapshots = 10
snr_db = 20.0
fading = "block"
azimuth_deg = [-60, 60]
range_m = [0.2, 1.0]
[sweep]
rician_k = [inf, 10.0]
wavefront = ["exact", "planar"]
[[formulation]]
kind = "neef"
[[solver]]
kind = "random-search"
[budget]
evaluations = 20
"""


def test_the_results_of_a_study_contain_the_bounds_that_exist(tmp_path):
    (tmp_path / "bounds.toml").write_text(STUDY)
    results = nfbench.run(nfbench.load_study(tmp_path / "bounds.toml"), out=tmp_path / "out", jobs=0)
    assert (results.runs.status == "ok").all()
    summary = results.summary().set_index(["scenario.rician_k", "scenario.wavefront"])
    assert {"floor_m", "gospa_m", "sources_found"} <= set(summary.columns)
    known = summary[["crb_m", "floor_m"]].notna()
    assert known.loc[(math.inf, "exact")].tolist() == [True, False]
    assert known.loc[(10.0, "exact")].tolist() == [False, True]
    assert not known.xs("planar", level=1).any(axis=None)
    runs = results.runs[results.runs.crb_m.notna()]
    assert summary.crb_m.loc[(math.inf, "exact")] == pytest.approx(math.sqrt(np.mean(runs.crb_m**2)))
    assert "floor_m" in (tmp_path / "out" / "summary.csv").read_text().splitlines()[0]
