"""Guards the estimators of wideband data: their efficiency, their objectives, and who refuses several bins."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.ndimage import maximum_filter
from wideband_scenes import SPARSE, WIDEBAND, misfit, response, scene

from nfbench import Incompatible, Solution, minimize, solver
from nfbench.problems.near_field.bands import Band
from nfbench.problems.near_field.enumeration import estimate_sources
from nfbench.problems.near_field.estimators.alternating_projection import AlternatingProjection
from nfbench.problems.near_field.estimators.certified import Certified
from nfbench.problems.near_field.estimators.grid_refine import GridRefine
from nfbench.problems.near_field.estimators.learned import Learned
from nfbench.problems.near_field.estimators.modified_music import ModifiedMusic
from nfbench.problems.near_field.estimators.music import Grid, Music
from nfbench.problems.near_field.estimators.neef import Neef
from nfbench.problems.near_field.estimators.nemo import Nemo
from nfbench.problems.near_field.estimators.nemo_niching import NemoNiching

DE = solver("de", population=40)


def by_de(problem):
    return minimize(problem, DE, 4000, 1)


def solve(formulation, instance, run=by_de):
    found = formulation.solve(instance, run)
    return found.estimate if isinstance(found, Solution) else found


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.parametrize("objective", ["wsf", "dml"])
def test_the_error_is_that_of_the_bound_of_all_bins(objective):
    """At 20 dB; 100 scenes give the ratio to within about 12 %, and the bound of a single bin is 1.7 times as large."""
    scenes = [scene(seed) for seed in range(100)]
    solutions = [GridRefine(objective=objective).solve(each, by_de) for each in scenes]
    errors = [each.score(found.estimate)["rmse_m"] for each, found in zip(scenes, solutions, strict=True)]
    bounds = [each.bounds()["crb_m"] for each in scenes]
    assert 0.85 < rms(np.array(errors) / np.array(bounds)) < 1.15
    stated = np.array([found.columns["std_m"] for found in solutions])
    assert abs(np.nanmedian(stated / bounds) - 1) < 0.1


@pytest.mark.parametrize("objective", ["esf", "wsf", "dml"])
def test_known_noise_of_different_levels_is_whitened_in_every_bin(objective):
    """With weights the responses have no unit modulus, so that the compiled kernels do not apply."""
    impaired = {"impairments": {"noise_level_db": 6.0}}
    scenes = [scene(seed, **impaired) for seed in range(12)]
    known = GridRefine(objective=objective, known_noise=True)
    ratios = [each.score(solve(known, each))["rmse_m"] / each.bounds()["crb_m"] for each in scenes]
    assert 0.6 < rms(ratios) < 1.4
    found = AlternatingProjection(objective=objective, known_noise=True)
    for each in scenes[:2]:
        assert (
            replace(each, theta=solve(known, each)).score(solve(found, each))["rmse_m"] < 0.1 * each.bounds()["crb_m"]
        )


FORMULATIONS = [
    Neef(objective="wsf", refine=True),
    AlternatingProjection(),
    Nemo(refine=True, relax=5),
    Nemo(refine=True, relax=5, alpha_relative=1.0),
    GridRefine(objective="wsf"),
]


@pytest.mark.parametrize("formulation", FORMULATIONS, ids=lambda each: type(each).__name__)
def test_formulations_reach_the_maximum_of_the_likelihood(formulation):
    """Weighted and maximum-likelihood fitting agree to within a fraction of the bound."""
    for seed in range(3):
        wide = scene(seed)
        best = solve(GridRefine(objective="dml"), wide)
        found = solve(formulation, wide)
        assert wide.score(best)["rmse_m"] < 3 * wide.bounds()["crb_m"]
        assert replace(wide, theta=best).score(found)["rmse_m"] < 0.3 * wide.bounds()["crb_m"]


@pytest.mark.parametrize("formulation", FORMULATIONS, ids=lambda each: type(each).__name__)
def test_an_estimate_uses_every_bin(formulation):
    wide = scene(1)
    fewer = replace(wide, further=wide.further[:-1])
    assert np.abs(solve(formulation, wide) - solve(formulation, fewer)).max() > 1e-6


def test_nemo_minimizes_the_sum_of_rls_and_deflates_every_bin():
    wide, problems = scene(4), []

    def run(problem):
        problems.append(problem)
        return by_de(problem)

    first, _ = solve(Nemo(alpha_relative=0.5, delta_min=0.3), wide, run)
    X = np.random.default_rng(3).uniform(wide.lower, wide.upper, (30, 2))
    energy, expected = 0.0, np.zeros(30)
    for band in wide.bands:
        m = band.manifold
        a = response(m.positions, m.wavelength_m, first)
        residual = band.Y - a @ (a.conj().T @ band.Y) / len(a)
        energy += np.linalg.norm(residual) ** 2
        expected += [misfit(residual, response(m.positions, m.wavelength_m, x)) for x in X]
    alpha = 0.5 * energy / len(wide.Y)
    expected += alpha * np.maximum(0, 0.3 - np.linalg.norm(X - first, axis=1))
    assert_allclose(problems[1].evaluate(X), expected, rtol=1e-9)


def test_a_detection_of_nemo_below_the_quality_is_discarded():
    """In noise the quality of the best position is at most about (1 + √(M/T))² = 2.7; a source at 20 dB has more."""
    assert len(solve(Nemo(stop_below=3.0, sources=5), scene(1))) == 2


def test_music_returns_the_peaks_of_the_summed_spectrum():
    wide, grid = scene(3), Grid(azimuth=90, range=70)
    axes = grid.axes(wide.lower, wide.upper)
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    distance = np.zeros(points.shape[:2])
    for band in wide.bands:
        U = np.linalg.svd(band.Y)[0][:, 2:]  # the noise subspace
        A = response(band.manifold.positions, band.manifold.wavelength_m, points.reshape(-1, 2))
        distance += np.sum(np.abs(U.conj().T @ A) ** 2, axis=0).reshape(distance.shape)
    spectrum = 1 / distance
    peaks = np.argwhere(spectrum == maximum_filter(spectrum, 3, mode="constant"))
    peaks = peaks[np.argsort(-spectrum[tuple(peaks.T)])]
    highest = points[tuple(peaks[0])]
    found = solve(Music(grid=grid), wide)
    assert_allclose(found[0], highest)
    assert wide.score(found)["rmse_m"] < 0.1
    refined = solve(Music(grid=grid, refine=True), wide)
    assert wide.score(refined)["rmse_m"] < 4 * wide.bounds()["crb_m"]


def test_bins_distinguish_what_one_frequency_cannot():
    """Elements 2λ apart: MUSIC of one frequency has several equal peaks, that of five frequencies does not."""
    grid = Music(grid=Grid(azimuth=400, range=60), refine=True)
    wrong = np.zeros(2)
    for seed in range(8):
        wide = scene(seed, SPARSE, bandwidth_relative=0.2)
        for i, each in enumerate([wide, replace(wide, further=())]):
            wrong[i] += wide.score(solve(grid, each))["rmse_m"] > 0.3
    assert wrong[0] == 0 and wrong[1] >= 5


# the number of sources


@pytest.mark.parametrize("criterion", ["aic", "mdl", "ne"])
def test_the_criteria_of_the_bins_are_added(criterion):
    """One source is weak; the same bin twice gives the number of that bin."""
    wide = scene(2, snr_db=[-17.0, 5.0], snapshots=100)
    Y = [band.Y for band in wide.bands]
    alone = estimate_sources(Y[0], criterion)
    assert estimate_sources([Y[0], Y[0]], criterion) == estimate_sources([Y[0]], criterion) == alone
    eigenvalues = [np.linalg.eigvalsh(each @ each.conj().T / 100)[::-1] for each in Y]
    M, T, scores = 24, 100, np.zeros(24)
    for k in range(24):
        for values in eigenvalues:
            tail = values[k:]
            if criterion == "ne":
                t = M * ((M - k) * np.sum(tail**2) / np.sum(tail) ** 2 - (1 + M / T))
                scores[k] += (T / M) ** 2 * t**2 / 2 + 2 * (k + 1)
            else:
                L = T * (M - k) * (np.log(tail.mean()) - np.mean(np.log(tail)))
                free = k * (2 * M - k)
                scores[k] += 2 * L + 2 * free if criterion == "aic" else L + free * np.log(T) / 2
    assert estimate_sources(Y, criterion) == np.argmin(scores)


def test_the_number_is_surer_from_all_bins():
    """Just above the SNR from which a source counts: the sum of nine criteria varies less than one of them."""
    scenes = [scene(seed, snr_db=[-12.0, 10.0], bins=9) for seed in range(20)]
    alone = [estimate_sources(wide.Y, "ne") for wide in scenes]
    together = [estimate_sources([band.Y for band in wide.bands], "ne") for wide in scenes]
    assert together.count(2) >= 19 and alone.count(2) <= 17


def test_the_estimated_number_is_that_of_all_bins():
    wide = scene(2)
    noise = np.random.default_rng(1).normal(size=(2, *wide.Y.shape))
    weak = replace(wide, further=tuple(Band(noise[0] + 1j * noise[1], band.manifold) for band in wide.further * 3))
    assert len(solve(Neef(sources="estimate"), wide)) == 2
    assert estimate_sources([band.Y for band in weak.bands], "ne") == len(solve(Neef(sources="estimate"), weak))


# several bins are refused


@pytest.mark.parametrize(
    "formulation",
    [Certified(), NemoNiching(), ModifiedMusic(), Learned()],
    ids=["certified", "niching", "modified", "learned"],
)
def test_formulations_of_one_wavelength_refuse_several_bins(formulation):
    with pytest.raises(Incompatible, match=r"bins: expected 1 for [\w-]+, .*, got 3; use neef"):
        formulation.solve(scene(), by_de)


@pytest.mark.parametrize("formulation", [Neef(), Nemo(), AlternatingProjection()], ids=lambda each: type(each).__name__)
def test_no_reference_is_claimed_for_several_bins(formulation):
    assert formulation.reference(scene()) is None
    assert formulation.reference(scene(bins=1)) is not None


def test_a_wavefront_assumed_by_the_estimator_holds_in_every_bin():
    """The data are spherical waves: with any other model in one of the bins, the misfit at the truth is not small."""
    wide, problems = scene(5, wavefront="fresnel"), []

    def run(problem):
        problems.append(problem)
        return by_de(problem)

    solve(Neef(objective="dml", wavefront="exact"), wide, run)
    x = wide.theta.ravel()
    expected = sum(
        misfit(band.Y, response(band.manifold.positions, band.manifold.wavelength_m, x)) / 60 for band in wide.bands
    )
    assert_allclose(problems[0].value(x), expected, rtol=0.1)  # up to the weights of the bins
    assert WIDEBAND["bins"] == len(problems[0].parts)
    assert {part.manifold.wavefront for part in problems[0].parts} == {"exact"}
