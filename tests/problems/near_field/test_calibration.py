"""Known impairments: prewhitened data fit the weighted responses, and estimators that know reach the bound."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from nfbench import Budget, Incompatible, minimize
from nfbench.problems.near_field.calibration import calibrated
from nfbench.problems.near_field.estimators.alternating_projection import AlternatingProjection
from nfbench.problems.near_field.estimators.certified import Certified
from nfbench.problems.near_field.estimators.grid_refine import GridRefine
from nfbench.problems.near_field.estimators.modified_music import ModifiedMusic
from nfbench.problems.near_field.estimators.music import Grid, Music
from nfbench.problems.near_field.estimators.neef import Neef
from nfbench.problems.near_field.estimators.nemo import Nemo
from nfbench.problems.near_field.estimators.nemo_niching import NemoNiching
from nfbench.problems.near_field.scenario import NearField
from nfbench.solvers.crowding_de import CrowdingDE
from nfbench.solvers.de import DE

SCENE = {
    "array": {"kind": "ula", "elements": 32, "spacing_wavelengths": 0.25, "origin": "center"},
    "wavelength_m": 0.02,
    "sources": 2,
    "snapshots": 200,
    "snr_db": 20.0,
    "azimuth_deg": (-60, 60),
    "range_m": (0.15, 1.0),
    "positions": ((-20.0, 0.3), (15.0, 0.5)),
}
CASES = {  # impairments, what the estimator knows, and the least factor by which not knowing it multiplies the error
    "gains": ({"gain_error_db": 3.0, "phase_error_deg": 60.0}, {"known_gains": True}, 30),
    "phases": ({"phase_error_deg": 60.0}, {"known_gains": True}, 30),
    "positions": ({"position_error_wavelengths": 0.1}, {"known_positions": True}, 30),
    "failed": ({"failed_elements": 8}, {"known_failed": True}, 5),
    "levels": ({"noise_level_db": 8.0}, {"known_noise": True}, 2.5),
    "colour": ({"noise_correlation_wavelengths": 1.0}, {"known_noise": True}, 1.1),
    "coupling": ({"coupling_db": -6.0, "coupling_phase_deg": 40.0}, {"known_coupling": True}, 30),
    "amplitude": ({"amplitude": "spherical"}, {"amplitude": "spherical"}, 1.1),
}
EVERYTHING = {key: value for impairments, _, _ in CASES.values() for key, value in impairments.items()}
EVERYTHING["noise_level_db"] = 3.0
KNOWN = {key: value for _, knows, _ in CASES.values() for key, value in knows.items()}
TRIALS = 40


def draw(seed=0, **impairments):
    return NearField(**SCENE, impairments=impairments).draw(np.random.default_rng(seed))


def error_in_bounds(impairments, formulation) -> float:
    """The RMSE of many trials divided by the root mean square of the bounds."""
    squares = []
    for seed in range(TRIALS):
        instance = draw(seed, **impairments)
        scores = instance.score(formulation.solve(instance, None).estimate)
        squares.append((scores["rmse_m"] ** 2, scores["crb_m"] ** 2))
    error, bound = np.sqrt(np.mean(squares, axis=0))
    return float(error / bound)


@pytest.mark.parametrize(
    ("case", "objective"),
    [
        *((case, "wsf") for case in list(CASES)[::2]),
        *(pytest.param(case, "wsf", marks=pytest.mark.slow) for case in list(CASES)[1::2]),
        ("gains", "dml"),
        pytest.param("colour", "dml", marks=pytest.mark.slow),
    ],
)
def test_an_estimator_that_knows_an_impairment_reaches_the_bound(case, objective):
    """The RMSE of 80 errors has a standard deviation of some 8 %; the bound is that of the true model."""
    impairments, knows, factor = CASES[case]
    informed = error_in_bounds(impairments, GridRefine(objective=objective, **knows))
    assert 0.75 < informed < 1.25
    assert error_in_bounds(impairments, GridRefine(objective=objective)) > factor * informed


@pytest.mark.parametrize("objective", ["wsf", "dml"])
def test_an_estimator_that_knows_everything_reaches_the_bound(objective):
    assert 0.75 < error_in_bounds(EVERYTHING, GridRefine(objective=objective, **KNOWN)) < 1.25


@pytest.mark.parametrize("rho", [0.9, 1.0])
def test_wsf_and_dml_reach_the_bound_of_correlated_sources_and_esf_does_not(rho):
    impairments = {"source_correlation": rho, "source_correlation_phase_deg": 30.0}
    for objective in ("wsf", "dml"):
        assert 0.75 < error_in_bounds(impairments, GridRefine(objective=objective)) < 1.25
    assert error_in_bounds(impairments, GridRefine(objective="esf")) > (1.4 if rho < 1 else 10)


@pytest.mark.parametrize("case", CASES)
def test_the_standard_errors_of_an_informed_estimator_are_the_bound(case):
    impairments, knows, _ = CASES[case]
    instance = draw(1, **impairments)
    solution = GridRefine(objective="dml", **knows).solve(instance, None)
    assert_allclose(solution.columns["std_m"], instance.bounds()["crb_m"], rtol=0.1)


def test_prewhitened_noise_is_white_and_the_signal_follows_the_weighted_responses():
    instance = draw(2, **EVERYTHING)
    Y, manifold = calibrated(instance, GridRefine(**KNOWN))[0].received
    whitener = np.linalg.inv(np.linalg.cholesky(instance.noise_covariance))
    assert_allclose(Y, whitener @ instance.Y, atol=1e-9)
    assert_allclose(manifold.response(instance.theta).T, whitener @ instance.H[0], atol=1e-9)


def test_failed_elements_are_left_out_if_their_noise_says_nothing_about_that_of_others():
    known = {name: value for name, value in KNOWN.items() if name != "known_noise"}
    for impairments, knows in ((EVERYTHING, known), (EVERYTHING | {"noise_correlation_wavelengths": 0.0}, KNOWN)):
        instance = draw(2, **impairments)
        kept = np.delete(np.arange(32), instance.failed)
        scale = np.sqrt(np.diag(instance.noise_covariance).real)[kept, None] if "known_noise" in knows else 1.0
        Y, manifold = calibrated(instance, GridRefine(**knows))[0].received
        assert_allclose(Y, instance.Y[kept] / scale, rtol=1e-12)
        assert_allclose(manifold.response(instance.theta).T, instance.H[0][kept] / scale, rtol=1e-9)


def test_nothing_known_leaves_the_data_as_they_are():
    instance = draw(2, **EVERYTHING)
    Y, manifold = calibrated(instance, GridRefine())[0].received
    assert Y is instance.Y and manifold is instance.manifold


def test_options_without_an_impairment_change_nothing():
    instance = draw(2)
    every = {name: value for name, value in KNOWN.items() if name != "amplitude"}
    Y, manifold = calibrated(instance, GridRefine(**every))[0].received
    assert Y is instance.Y and manifold is instance.manifold


def test_known_phases_turn_the_data_and_keep_the_modulus_of_the_responses():
    clean, turned = draw(4), draw(4, phase_error_deg=80.0)
    Y, manifold = calibrated(turned, GridRefine(known_gains=True))[0].received
    assert manifold.has_unit_modulus
    noise = [each.Y - each.H[0] @ each.symbols for each in (clean, turned)]
    expected = clean.Y - noise[0] + turned.gains.conj()[:, None] * noise[1]
    assert_allclose(Y, expected, atol=1e-10)


def test_equal_levels_of_noise_keep_the_modulus_of_the_responses():
    Y, manifold = calibrated(draw(noise_level_db=(6.0,) * 32), GridRefine(known_noise=True))[0].received
    assert manifold.has_unit_modulus
    assert_allclose(Y, draw(noise_level_db=(6.0,) * 32).Y / 10**0.3, rtol=1e-12)


def test_leaving_out_known_failures_is_the_smaller_array():
    instance = draw(5, failed_elements=(0, 1, 2, 31))
    positions = draw().manifold.positions[3:31]
    smaller = NearField(**SCENE | {"array": {"kind": "custom", "origin": "first", "positions": positions.tolist()}})
    Y, manifold = calibrated(instance, GridRefine(known_failed=True))[0].received
    assert_array_equal(Y, instance.Y[3:31])
    assert_array_equal(manifold.positions, positions)
    assert smaller.array.count == manifold.elements


def test_the_number_of_sources_is_estimated_from_the_whitened_data():
    impairments = {"noise_correlation_wavelengths": 3.0}
    counts = {
        known: [
            len(GridRefine(sources="estimate", known_noise=known).solve(draw(seed, **impairments), None).estimate)
            for seed in range(4)
        ]
        for known in (True, False)
    }
    assert counts[True] == [2, 2, 2, 2]
    assert min(counts[False]) > 2


def with_de(problem):
    """Minimize by differential evolution, as a run does."""
    return minimize(problem, DE(population=40), Budget(evaluations=4000), seed=1)


@pytest.mark.parametrize(
    "formulation",
    [
        lambda **knows: Nemo(refine=True, relax=5, **knows),
        lambda **knows: Neef(objective="wsf", refine=True, **knows),
        lambda **knows: Neef(objective="dml", refine=True, **knows),
        lambda **knows: AlternatingProjection(**knows),
        lambda **knows: Music(grid=Grid(azimuth=120, range=60), refine=True, **knows),
    ],
    ids=["nemo", "neef-wsf", "neef-dml", "alternating-projection", "music"],
)
def test_every_formulation_uses_what_it_knows(formulation):
    instance = draw(6, **EVERYTHING)
    informed = formulation(**KNOWN).solve(instance, with_de)
    uninformed = formulation().solve(instance, with_de)
    bound = instance.bounds()["crb_m"]
    assert instance.score(informed)["rmse_m"] < 4 * bound
    assert instance.score(uninformed)["rmse_m"] > 40 * bound


def test_nemo_without_relaxation_and_niching_come_near():
    """Both have an error floor, but find the right peaks."""
    instance = draw(6, **EVERYTHING)
    informed = Nemo(**KNOWN).solve(instance, with_de)
    assert instance.score(informed)["rmse_m"] < 0.05 < instance.score(Nemo().solve(instance, with_de))["rmse_m"]

    def crowded(problem):
        return minimize(problem, CrowdingDE(population=100), Budget(evaluations=10_000), seed=1)

    informed = NemoNiching(refine=True, **KNOWN).solve(instance, crowded)
    assert instance.score(informed)["rmse_m"] < 0.05


def test_all_objectives_of_all_formulations_agree_on_a_manifold_of_known_gains():
    """NEEF, alternating projection and grid-refine minimize one function; their general paths must find one minimum."""
    instance = draw(7, gain_error_db=4.0, phase_error_deg=60.0, noise_correlation_wavelengths=0.5)
    knows = {"known_gains": True, "known_noise": True}
    found = GridRefine(objective="wsf", **knows).solve(instance, None).estimate
    for formulation in (Neef(objective="wsf", refine=True, **knows), AlternatingProjection(**knows)):
        estimate = formulation.solve(instance, with_de)
        order = [0, 1] if abs(estimate[0, 0] - found[0, 0]) < 0.1 else [1, 0]
        assert_allclose(estimate[order], found, rtol=1e-5)


@pytest.mark.parametrize(("impairments", "knows"), [({"gain_error_db": 3.0}, {"known_gains": True})])
def test_proofs_and_modified_music_refuse_what_they_cannot_use(impairments, knows):
    instance = draw(8, **impairments)
    with pytest.raises(Incompatible, match="expected responses of modulus 1, for which the proof holds"):
        Certified(**knows).solve(instance, None)
    with pytest.raises(Incompatible, match="expected phases only for modified MUSIC"):
        ModifiedMusic(**knows).solve(instance, None)
    for formulation in (Neef(**knows), Nemo(**knows), AlternatingProjection(**knows)):
        assert formulation.reference(instance) is None


def test_modified_music_refuses_an_array_with_gaps():
    instance = draw(8, failed_elements=(3,))
    with pytest.raises(Incompatible, match="expected a uniform linear array"):
        ModifiedMusic(known_failed=True).solve(instance, None)


def test_a_proof_holds_with_known_phases_positions_and_failures():
    impairments = {"phase_error_deg": 60.0, "position_error_wavelengths": 0.05, "failed_elements": 3}
    instance = draw(9, **impairments)
    solution = Certified(known_gains=True, known_positions=True, known_failed=True).solve(instance, None)
    assert solution.columns["certified"] == 1
    assert instance.score(solution.estimate)["rmse_m"] < 4 * instance.bounds()["crb_m"]


def test_modified_music_uses_known_phases():
    instance = draw(10, phase_error_deg=60.0)
    grid = Grid(azimuth=400, range=200)
    informed, uninformed = (
        ModifiedMusic(grid=grid, refine=True, known_gains=known).solve(instance, None) for known in (True, False)
    )
    assert instance.score(informed)["rmse_m"] < 0.03 < instance.score(uninformed)["rmse_m"]
