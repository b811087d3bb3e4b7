"""The near-field scenario: draws, common random numbers, validation and scores."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from nfbench import OptionError
from nfbench.core.options import build, canonical
from nfbench.problems.near_field.arrays import ULA, UPA
from nfbench.problems.near_field.geometry import cartesian, directions
from nfbench.problems.near_field.scenario import NearField, NearFieldInstance

MANIFEST = {
    "array": {"kind": "ula", "elements": 32, "spacing_wavelengths": 0.25, "origin": "first"},
    "wavelength_m": 0.02,
    "wavefront": "paper",
    "sources": 3,
    "snapshots": 50,
    "snr_db": 20.0,
    "rician_k": 10.0,
    "fading": "block",
    "azimuth_deg": [-60, 60],
    "range_m": [1.27, 20.16],
}


def scenario(**changes) -> NearField:
    return build(NearField, MANIFEST | changes)


def draw(seed: int = 0, **changes) -> NearFieldInstance:
    return scenario(**changes).draw(np.random.default_rng(seed))


def symbols(instance: NearFieldInstance) -> np.ndarray:
    """Return the symbols √snr·s of the sources, estimated by least squares with the true responses."""
    A = instance.manifold.response(instance.theta).T
    return np.linalg.lstsq(A, instance.Y)[0]


def test_a_scenario_is_built_from_a_manifest_table():
    near_field = scenario()
    assert near_field.array == ULA(elements=32, spacing_wavelengths=0.25, origin="first")
    assert build(NearField, canonical(near_field)) == near_field
    assert canonical(near_field)["nlos"] == {"kind": "iid"}


def test_a_draw_has_the_specified_shapes_and_bounds():
    instance = draw()
    assert (instance.Y.shape, instance.Y.dtype) == ((32, 50), np.complex128)
    assert instance.sources == 3
    assert_allclose(instance.lower, [-math.pi / 3, 1.27])
    assert_allclose(instance.upper, [math.pi / 3, 20.16])
    assert_array_equal(instance.Y, draw().Y)
    assert np.abs(instance.Y - draw(seed=1).Y).max() > 1


def test_three_dimensions_with_elevation():
    array = {"kind": "upa", "columns": 4, "rows": 4, "spacing_wavelengths": 0.5, "origin": "center"}
    instance = draw(array=array, elevation_deg=[-30, 20])
    assert instance.theta.shape == (3, 3)
    assert_allclose(instance.lower, [-math.pi / 3, -math.pi / 6, 1.27])
    assert_allclose(instance.upper, [math.pi / 3, math.pi / 9, 20.16])
    assert scenario(array=array).array == UPA(columns=4, rows=4, spacing_wavelengths=0.5, origin="center")


def test_positions_are_uniform_in_angle_and_range():
    near_field = scenario(sources=20, snapshots=1)
    rng = np.random.default_rng(0)
    unit = np.concatenate(
        [(i.theta - i.lower) / (i.upper - i.lower) for i in (near_field.draw(rng) for _ in range(300))]
    )
    assert unit.min() >= 0
    assert unit.max() <= 1
    assert_allclose(unit.mean(axis=0), 0.5, atol=0.02)
    assert_allclose(unit.var(axis=0), 1 / 12, atol=0.005)


def test_the_same_seed_gives_the_same_sources_noise_and_symbols_under_all_conditions():
    base = draw()
    for changes in (
        {"snr_db": [0.0, 5.0, 10.0]},
        {"rician_k": 1.0},
        {"rician_k": math.inf},
        {"fading": "snapshot"},
        {"wavefront": "exact"},
        {"snapshots": 10},
    ):
        assert_array_equal(draw(**changes).theta, base.theta)
    # noise: two SNRs differ by a multiple of the same signal; κ = inf so that the signal is A·S
    at_0, at_20, at_40 = (draw(rician_k=math.inf, snr_db=snr).Y for snr in (0, 20, 40))
    assert_allclose(at_40 - at_20, 10 * (at_20 - at_0), rtol=0, atol=1e-9)
    # block and snapshot fading share their first snapshot
    block, snapshot = draw(rician_k=1.0).Y, draw(rician_k=1.0, fading="snapshot").Y
    assert_allclose(block[:, 0], snapshot[:, 0], rtol=0, atol=1e-10)
    assert np.abs(block[:, 1] - snapshot[:, 1]).max() > 1


def test_snr_is_per_source_and_per_antenna():
    """For κ = inf, the power of source k at each antenna is snr_k, and that of the noise is 1."""
    snr_db = [0.0, 10.0, 20.0]
    positions = [[-40, 3], [5, 5], [45, 4]]
    instance = draw(rician_k=math.inf, snr_db=snr_db, positions=positions, snapshots=20_000)
    A = instance.manifold.response(instance.theta).T
    S = symbols(instance)
    noise = instance.Y - A @ S
    assert np.mean(np.abs(noise) ** 2) == pytest.approx((32 - 3) / 32, rel=0.01)
    gram = np.linalg.inv(A.conj().T @ A).diagonal().real  # variance that the noise adds to each estimated symbol
    measured = 10 * np.log10(np.mean(np.abs(S) ** 2, axis=1) - gram)
    assert_allclose(measured, snr_db, atol=0.15)
    correlation = S @ S.conj().T / 20_000
    assert abs(correlation[1, 2]) < 0.05 * math.sqrt(10 * 100)  # independent sources


def test_the_signal_has_rank_k_under_block_fading_but_not_under_snapshot_fading():
    quiet = {"snr_db": 60.0, "rician_k": 1.0}
    block = np.linalg.svd(draw(**quiet).Y, compute_uv=False)
    snapshot = np.linalg.svd(draw(**quiet, fading="snapshot").Y, compute_uv=False)
    assert block[3] < 1e-2 * block[2]
    assert snapshot[3] > 0.1 * snapshot[2]


@pytest.mark.parametrize("fading", ["block", "snapshot"])
def test_received_power_does_not_depend_on_the_rician_factor(fading):
    powers = [
        np.mean([np.mean(np.abs(draw(s, rician_k=k, fading=fading, snapshots=100).Y) ** 2) for s in range(40)])
        for k in (0.2, math.inf)
    ]
    assert_allclose(powers, 3 * 100 + 1, rtol=0.06)


def test_fixed_positions_are_used_in_order_even_on_the_edge():
    instance = draw(positions=[[-60, 20.16], [10, 5], [60, 1.27]])
    assert_allclose(np.degrees(instance.theta[:, 0]), [-60, 10, 60], rtol=1e-14)
    assert_array_equal(instance.theta[:, 1], [20.16, 5, 1.27])
    assert (instance.theta >= instance.lower).all()
    assert (instance.theta <= instance.upper).all()


def test_sources_keep_the_minimum_separation():
    near_field = scenario(min_separation_deg=15.0, snapshots=1)
    rng = np.random.default_rng(0)
    closest = []
    for _ in range(200):
        azimuth = np.sort(near_field.draw(rng).theta[:, 0])
        closest.append(np.degrees(np.diff(azimuth).min()))
    assert min(closest) >= 15 - 1e-9
    assert min(closest) < 17  # no larger separation is enforced


def test_separation_in_three_dimensions_is_the_angle_between_directions():
    array = {"kind": "upa", "columns": 4, "rows": 4, "spacing_wavelengths": 0.5, "origin": "center"}
    near_field = scenario(array=array, elevation_deg=[40, 80], min_separation_deg=20.0, sources=2, snapshots=1)
    rng = np.random.default_rng(0)
    angles = []
    for _ in range(200):
        u = directions(near_field.draw(rng).theta)
        angles.append(math.degrees(math.acos(np.clip(u[0] @ u[1], -1, 1))))
    assert 20 - 1e-9 <= min(angles) < 22


def test_an_impossible_separation_is_refused_before_anything_is_drawn():
    with pytest.raises(OptionError, match="expected room for 5 sources in azimuths from -60° to 60°, got 40°"):
        scenario(sources=5, min_separation_deg=40.0)


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"fading": None}, 'fading: expected "block" or "snapshot" for rician_k = 10, got none'),
        ({"sources": 32}, "sources: expected fewer than the 32 elements, got 32"),
        ({"sources": 0}, "sources: .*got 0"),
        ({"snapshots": 0}, "snapshots: .*got 0"),
        ({"snr_db": [10.0, 20.0]}, r"snr_db: expected one number, or 3 \(one per source\), got 2"),
        ({"snr_db": math.inf}, "snr_db: .*inf"),
        ({"snr_db": [1.0, 2.0, math.nan]}, "snr_db"),
        ({"rician_k": 0.0}, "rician_k: .*got 0"),
        ({"rician_k": -1.0}, "rician_k: .*got -1"),
        ({"azimuth_deg": [60, -60]}, r"azimuth_deg: expected \[low, high\] with low < high, got \[60, -60\]"),
        ({"azimuth_deg": [-361, 60]}, r"azimuth_deg: expected an interval within \[-360, 360\], got \[-361, 60\]"),
        ({"azimuth_deg": [-200, 161]}, r"azimuth_deg: expected an interval of at most 360°, got \[-200, 161\]"),
        ({"elevation_deg": [-30, 91]}, r"elevation_deg: expected an interval within \[-90, 90\], got \[-30, 91\]"),
        ({"range_m": [0, 5]}, "range_m: expected ranges greater than 0"),
        ({"range_m": [5, 5]}, "range_m: expected .*low < high"),
        ({"range_m": [5, math.inf]}, r"range_m\[1\]: .*inf"),
        ({"range_m": [1, 2, 3]}, "range_m"),
        ({"wavefront": "spherical"}, "wavefront: .*'spherical'"),
        ({"wavelength_m": -0.02}, "wavelength_m: .*got -0.02"),
        ({"min_separation_deg": -1.0}, "min_separation_deg: .*got -1"),
        ({"nlos": {"kind": "rayleigh"}}, "nlos.kind: unknown kind 'rayleigh'; known: cluster"),
        (
            {"nlos": {"kind": "clusters", "weights": (1.0, 2.0)}},
            "nlos: weights: expected 3 numbers, one per cluster, got 2",
        ),
        ({"nlos": {"kind": "clusters", "angular_spread_deg": -1.0}}, "nlos.angular_spread_deg: .*got -1"),
        ({"array": {"kind": "ulla", "elements": 8}}, "array.kind: unknown kind 'ulla'; did you mean \"ula\""),
        ({"array": MANIFEST["array"] | {"element": 9}}, 'array.element: unknown option; did you mean "elements"'),
        ({"positions": [[0, 5]]}, "positions: expected 3 positions, one per source, got 1"),
        (
            {"positions": [[0, 5], [0, 0, 5], [0, 6]]},
            r"positions\[1\]: expected 2 numbers \(azimuth_deg, range_m\), got",
        ),
        ({"positions": [[0, 5], [0, 21], [0, 6]]}, r"positions\[1\]: expected range_m within \[1.27, 20.16\], got 21"),
        (
            {"positions": [[0, 5], [0, 7], [-61, 6]]},
            r"positions\[2\]: expected azimuth_deg within \[-60, 60\], got -61",
        ),
    ],
)
def test_invalid_options_are_refused_by_name(changes, complaint):
    with pytest.raises(OptionError, match=complaint):
        scenario(**changes)


@pytest.mark.parametrize(
    ("changes", "path", "complaint"),
    [
        ({"snapshots": 10**9}, "snapshots", "less than or equal to 100000000, got 1000000000"),
        ({"snapshots": 10**7}, "snapshots", "snapshots × elements = 10,000,000 × 32 = 320,000,000"),
        ({"snapshots": 2 * 10**6, "fading": "snapshot"}, "snapshots", "× sources = 2,000,000 × 32 × 3 = 192,000,000"),
        (
            {"snapshots": 10**5, "fading": "snapshot", "nlos": {"kind": "clusters"}},
            "snapshots",
            "gains of the scattered",
        ),
        ({"nlos": {"kind": "clusters", "clusters": 3000}}, "nlos", "the scattered waves of 3 sources at 32 elements"),
        ({"nlos": {"kind": "cluster-around-source", "scatterers": 10**6}}, "nlos.scatterers", "got 1000000"),
        ({"nlos": {"kind": "isotropic"}, "array": MANIFEST["array"] | {"elements": 10**4}}, "nlos", "= 300,000,000"),
        ({"sources": 10**6}, "sources", "less than or equal to 1000, got 1000000"),
        ({"sources": 31, "min_separation_deg": 1.0, "snapshots": 10**8}, "snapshots", "= 3,200,000,000"),
        ({"snr_db": [0.0, 1.0, 4000.0]}, "snr_db[2]", "less than or equal to 300, got 4000"),
        ({"wavelength_m": 1e-300}, "wavelength_m", "got 1e-300"),
        ({"range_m": [1.0, 1e300]}, "range_m", "expected an interval within [1e-09, 1e+09]"),
        ({"gospa_cutoff_m": 1e308}, "gospa_cutoff_m", "got 1e+308"),
    ],
)
def test_sizes_that_no_memory_holds_are_refused_before_anything_is_drawn(changes, path, complaint):
    with pytest.raises(OptionError) as caught:
        scenario(**changes)
    assert [found for found, _ in caught.value.problems] == [path]
    assert complaint in caught.value.problems[0][1]


def test_the_number_of_scattered_waves_is_that_of_their_factors():
    for kind in ("clusters", "cluster-around-source"):
        near_field = scenario(nlos={"kind": kind, "scatterers": 7})
        theta = draw().theta
        F = near_field.nlos.factors(np.random.default_rng(0).spawn(3), near_field.manifold(), theta, *near_field.box())
        assert near_field.nlos.numbers(3, 32) == F.size


def test_all_errors_are_reported_at_once():
    with pytest.raises(OptionError) as caught:
        scenario(fading=None, sources=40, azimuth_deg=[5, 5], range_m=[-1, 2])
    assert [path for path, _ in caught.value.problems] == ["azimuth_deg", "range_m", "sources", "fading"]


def test_line_of_sight_needs_no_fading():
    assert math.isinf(scenario(rician_k=math.inf, fading=None).rician_k)


def matchings(true: int, found: int):
    """Yield every assignment of min(K, K̂) of the K̂ estimates to as many of the K true sources, as lists of pairs."""
    for sources in itertools.combinations(range(true), min(true, found)):
        for estimates in itertools.permutations(range(found), len(sources)):
            yield list(zip(sources, estimates, strict=True))


def errors_by_brute_force(instance: NearFieldInstance, estimate: np.ndarray) -> np.ndarray:
    d = np.linalg.norm(cartesian(instance.theta)[:, None] - cartesian(estimate), axis=-1)
    best = min(matchings(*d.shape), key=lambda pairs: sum(d[pair] ** 2 for pair in pairs))
    errors = np.full(len(d), math.nan)
    for k, j in best:
        errors[k] = d[k, j]
    return errors


def gospa_by_brute_force(instance: NearFieldInstance, estimate: np.ndarray, c: float) -> float:
    """Return √(min_γ Σ d² + c²/2·(K + K̂ − 2|γ|)) over all partial assignments γ, which is the definition of GOSPA."""
    d = np.linalg.norm(cartesian(instance.theta)[:, None] - cartesian(estimate), axis=-1)
    total = sum(d.shape)
    return math.sqrt(
        min(
            sum(d[pair] ** 2 for pair in chosen) + c**2 / 2 * (total - 2 * size)
            for pairs in matchings(*d.shape)
            for size in range(len(pairs) + 1)
            for chosen in itertools.combinations(pairs, size)
        )
    )


@settings(deadline=None, database=None, derandomize=True, max_examples=60)
@given(
    seed=st.integers(0, 2**32 - 1),
    sources=st.integers(1, 4),
    found=st.integers(0, 4),
    spread_m=st.sampled_from([0.3, 3.0]),
    cutoff_m=st.sampled_from([0.5, 1.0]),
)
def test_scores_follow_from_the_best_assignment(seed, sources, found, spread_m, cutoff_m):
    instance = draw(sources=sources, snapshots=1, range_m=[5, 6], azimuth_deg=[0, 10], gospa_cutoff_m=cutoff_m)
    rng = np.random.default_rng(seed)  # some estimates lie within the cutoff of gospa_m, others beyond
    estimate = rng.uniform(instance.lower, instance.lower + np.array([0.2, spread_m]), (found, 2))
    scores = instance.score(estimate)
    errors = errors_by_brute_force(instance, estimate)
    names = ["rmse_m", "gospa_m", "sources", "sources_found"]
    parameters = ["azimuth_rmse_deg", "range_rmse_m"]
    for k in range(1, sources + 1):
        parameters += [f"azimuth_error_{k}_deg", f"range_error_{k}_m"]
    assert list(scores) == [*names, *(f"error_{k}_m" for k in range(1, sources + 1)), *parameters, "floor_m"]
    assert_allclose(list(scores.values())[4 : 4 + sources], errors, rtol=1e-9)
    assert np.isnan(errors).sum() == max(sources - found, 0)
    matched = errors[~np.isnan(errors)]
    rmse = math.sqrt(np.mean(matched**2)) if found else math.nan
    assert scores["rmse_m"] == pytest.approx(rmse, rel=1e-9, nan_ok=True)
    assert scores["gospa_m"] == pytest.approx(gospa_by_brute_force(instance, estimate, cutoff_m), rel=1e-9)
    assert (scores["sources"], scores["sources_found"]) == (sources, found)
    shuffled = rng.permutation(estimate)
    assert_allclose(list(instance.score(shuffled).values()), list(scores.values()), rtol=1e-9)


def test_errors_belong_to_the_true_sources_in_order():
    instance = draw()
    estimate = instance.theta[[2, 0, 1]].copy()
    estimate[1, 1] += 0.5  # this estimate belongs to true source 1
    scores = instance.score(estimate)
    assert_allclose(list(scores.values())[:7], [0.5 / math.sqrt(3), 0.5, 3, 3, 0.5, 0.0, 0.0], atol=1e-12)


def test_a_missed_source_and_a_surplus_estimate_cost_half_the_squared_cutoff_each():
    instance, cutoff_m = draw(positions=[[-40, 5], [0, 5], [40, 5]], gospa_cutoff_m=0.7), 0.7
    assert instance.score(instance.theta[:2])["gospa_m"] == pytest.approx(cutoff_m / math.sqrt(2))
    surplus = np.vstack([instance.theta, instance.theta[:1]])
    assert instance.score(surplus)["gospa_m"] == pytest.approx(cutoff_m / math.sqrt(2))
    empty = instance.score(np.empty((0, 2)))
    assert empty["gospa_m"] == pytest.approx(cutoff_m * math.sqrt(3 / 2))
    assert math.isnan(empty["rmse_m"])


@pytest.mark.parametrize("shape", [(3, 3), (3, 1), (6,), (0,), (0, 3), (1, 3, 2)])
def test_an_estimate_of_the_wrong_shape_is_refused(shape):
    with pytest.raises(ValueError, match=r"estimate: expected shape \(K, 2\), one row per source, got"):
        draw().score(np.ones(shape))


@pytest.mark.parametrize(
    ("column", "bad"),
    [(0, math.nan), (0, math.inf), (1, math.nan), (1, math.inf), (1, -math.inf), (1, 1e200)],
)
def test_an_estimate_that_is_not_finite_scores_nan(column, bad):
    instance = draw()
    estimate = instance.theta.copy()
    estimate[1, column] = bad
    scores = instance.score(estimate)
    assert all(math.isnan(score) for name, score in scores.items() if name not in instance.bounds())


def test_scenario_options_can_be_swept():
    assert replace(scenario(), snr_db=5.0).snr_db == 5.0
    with pytest.raises(OptionError):
        replace(scenario(), sources=99)
