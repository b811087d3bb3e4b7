"""Scenes of measured responses are the combinations of the measured sources, with symbols and noise of a stated SNR."""

import math
from itertools import combinations

import numpy as np
import pytest
from simulated import OPTIONS, POSITIONS, SPEED, manifold, responses

from nfbench import OptionError
from nfbench.problems.near_field.estimators.grid_refine import GridRefine
from nfbench.problems.near_field.geometry import cartesian
from nfbench.problems.near_field.recordings.responses import MeasuredResponses, gated
from nfbench.testing import scenario_check_names, scenario_checks

POINTS = np.array([[0.1, 0.2, 1.0], [-0.25, -0.05, 0.95], [0.3, -0.2, 1.1], [0.0, 0.0, 0.95]])
LOSS = np.array([1.0, 3.0, 0.2, 1.0])  # of the sources: the SNR does not depend on it
RATE = 24_000.0


def impulse_responses(reflection=0.0):
    """Band-limited impulses (sources, samples, elements) with reflections 4 ms later, of sources at other places."""
    t = np.arange(400) / RATE
    delays = np.linalg.norm(POSITIONS - POINTS[:, None], axis=2) / SPEED + 20 / RATE
    late = t[None, :, None] - delays[:, None, :]
    h = np.sinc(RATE * late) * np.exp(-((late * 4_000) ** 2))
    late = late[::-1] - 0.004
    return LOSS[:, None, None] * (h + reflection * np.sinc(RATE * late) * np.exp(-((late * 4_000) ** 2)))


@pytest.fixture
def measured(tmp_path):
    """A function that writes responses to a file and returns the scenario."""

    def make(data=None, **options):
        H = responses(POINTS).T * LOSS[:, None] if data is None else data
        np.savez(tmp_path / "h.npz", h=H)
        given = {"snapshots": 50, "snr_db": 20.0, "positions_m": POINTS.tolist(), **OPTIONS, **options}
        return MeasuredResponses(data=str(tmp_path / "h.npz"), **given)

    return make


def drawn(scenario, number=0, seed=0):
    return scenario.draw_scene(np.random.default_rng(seed), number)


def chosen(scenario, instance):
    """The numbers of the measured sources in a scene."""
    points = scenario.frame.outward(cartesian(instance.theta))
    return tuple(int(np.argmin(np.linalg.norm(POINTS - point, axis=1))) for point in points)


def test_all_combinations_follow_one_another(measured):
    scenario = measured()
    expected = list(combinations(range(4), 2))
    found = [chosen(scenario, drawn(scenario, number, seed=number)) for number in range(8)]
    assert found == [*expected, *expected[:2]]
    again = drawn(scenario, 6, seed=6)
    assert not np.array_equal(again.Y, drawn(scenario, 0, seed=0).Y)  # new symbols and noise


def test_random_choices_cover_all_combinations_equally(measured):
    scenario = measured(choose="random", snapshots=1)
    found = [chosen(scenario, drawn(scenario, seed=seed)) for seed in range(300)]
    counts = [found.count(pair) for pair in combinations(range(4), 2)]
    assert sum(counts) == 300
    assert sum((count - 50) ** 2 / 50 for count in counts) < 15.09  # chi-squared, 5 degrees of freedom, 1 %


def test_a_given_choice_is_taken_in_its_order(measured):
    scenario = measured(choose=(3, 1))
    assert [chosen(scenario, drawn(scenario, number)) for number in (0, 5)] == [(3, 1), (3, 1)]


def test_the_signal_has_the_stated_ratio_to_noise_of_unit_power_whatever_the_response(measured):
    scenario = measured(snapshots=20_000, snr_db=(10.0, 0.0), choose=(1, 2))
    Y = drawn(scenario).Y
    R = Y @ Y.conj().T / Y.shape[1]
    A = responses(POINTS[[1, 2]])
    expected = A @ np.diag([10.0, 1.0]) @ A.conj().T + np.eye(16)
    np.testing.assert_allclose(R, expected, atol=6 * 11 / math.sqrt(20_000))
    assert np.trace(R).real / 16 == pytest.approx(12.0, rel=0.03)


def test_the_same_seed_gives_the_same_noise_at_every_snr_and_without_failed_elements(measured):
    low, high, fewer = (
        drawn(measured(choose=(0, 1), **o)).Y for o in ({"snr_db": -300.0}, {"snr_db": -290.0}, {"failed": (2,)})
    )
    np.testing.assert_allclose(low, high, atol=1e-12)
    noiseless = drawn(measured(choose=(0, 1), snr_db=20.0)).Y - low
    np.testing.assert_allclose(fewer, np.delete(noiseless + low, 2, axis=0), atol=1e-9)


def test_impulse_responses_are_transformed_to_the_transfer_functions_of_the_model(measured):
    instance = drawn(measured(impulse_responses(), sample_rate_hz=RATE, choose=(0, 2)))
    H, A = instance.noiseless, manifold().response(instance.theta).T
    match = np.abs(np.sum(H.conj() * A, axis=0)) / 16
    np.testing.assert_allclose(match, 1.0, atol=1e-6)
    assert instance.score(instance.theta)["floor_m"] < 1e-4


def test_a_gate_removes_the_reflection(measured):
    echoing = impulse_responses(0.5)
    options = {"sample_rate_hz": RATE, "choose": (0, 1)}
    floors = [
        drawn(measured(echoing, gate_samples=gate, **options)).score(np.zeros((0, 3)))["floor_m"] for gate in (None, 60)
    ]
    assert floors[0] > 5 * floors[1]


def test_the_gate_falls_from_one_at_the_first_arrival_to_zero():
    h = np.zeros((1, 50, 2))
    h[0, 20, 0] = h[0, 30, 1] = 2.0
    h[0, 19, 0] = 0.3  # below a fifth of the peak
    weights = gated(h, 10)
    assert (weights[0, :12, 0] == 0).all() and (weights[0, 12:21, 0] == 1).all()
    assert weights[0, 25, 0] == pytest.approx(0.5)
    assert (weights[0, 30:, 0] < 1e-12).all()
    np.testing.assert_array_equal(weights[0, 10:, 1], weights[0, :-10, 0])


def test_axes_are_found_from_their_lengths(measured):
    h = impulse_responses()
    first = drawn(measured(h, sample_rate_hz=RATE))
    for order in ((0, 1, 2), (2, 1, 0), (1, 2, 0)):
        names = ("sources", "samples", "elements")
        turned = h.transpose(order)
        np.testing.assert_allclose(drawn(measured(turned, sample_rate_hz=RATE)).Y, first.Y, rtol=1e-12)
        axes = tuple(names[i] for i in order)
        np.testing.assert_allclose(drawn(measured(turned, sample_rate_hz=RATE, axes=axes)).Y, first.Y, rtol=1e-12)


def test_the_sources_are_found(measured):
    instance = drawn(measured(snr_db=40.0))
    scores = instance.score(GridRefine().solve(instance, None).estimate)
    assert scores["rmse_m"] < 5e-3
    assert scores["misfit"] == pytest.approx(scores["misfit_limit"], rel=0.3)


def test_the_scenario_passes_the_checks_of_scenarios(measured):
    names = [name for name in scenario_check_names() if name != "global-random-untouched"]  # beartype draws from it
    results = list(scenario_checks(measured(), [GridRefine()], names))
    assert len(results) > 10
    assert all(result.passed for result in results), results


def test_positions_are_read_from_a_file(measured, tmp_path):
    np.savetxt(tmp_path / "p.csv", POINTS, delimiter=",")
    assert measured(positions_m=None, positions_file=str(tmp_path / "p.csv")) == measured()


@pytest.mark.parametrize(
    ("data", "options", "text"),
    [
        (None, {"sources": 5}, "sources: expected at most the 4 measured sources, got 5"),
        (None, {"choose": (0, 0)}, r"choose: expected 2 different numbers from 0 to 3, got \[0, 0\]"),
        (None, {"choose": (0, 4)}, r"choose: .* got \[0, 4\]"),
        (None, {"snr_db": (1.0, 2.0, 3.0)}, r"snr_db: expected one number, or 2 \(one per source\), got 3"),
        (None, {"gate_samples": 20}, "gate_samples: has an effect only on impulse responses"),
        (None, {"positions_m": None}, "expected either positions_m or positions_file, got neither"),
        (None, {"positions_m": POINTS[:3].tolist()}, "data: expected axes of 3 sources, 16 elements, got"),
        (None, {"axes": ("elements", "sources")}, r"data: expected axes .* in the order \['elements', 'sources'\]"),
        (None, {"sample_rate_hz": RATE}, "data: expected 3 axes"),
        (impulse_responses(), {}, "data: expected 2 axes .* give sample_rate_hz"),
        (impulse_responses(), {"sample_rate_hz": 3000.0}, "frequency_hz: expected a value below half .* 1500 Hz"),
        (np.ones((4, 16)), {}, "data: expected complex transfer functions, got real numbers"),
        (impulse_responses() * 0, {"sample_rate_hz": RATE}, "data: expected responses other than 0.* source 0"),
        (None, {"snapshots": 10**8}, "snapshots: expected at most 100,000,000 snapshots × elements"),
    ],
)
def test_a_wrong_description_is_refused(data, options, text, measured):
    with pytest.raises(OptionError, match=text):
        measured(data, **options)
