"""A local fit from another formulation's estimate: its minimum, its options, and studies that use it."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pursuit_scenes import HOSTILE, LINE, SMALL, SPACE, coherent, in_order, noise_free, scene, solve

import nfbench
from nfbench import Incompatible, ManifestError, OptionError, Solution, load_study, run
from nfbench.plugins.registry import Registry
from nfbench.problems.near_field.estimators.fit_from import FitFrom
from nfbench.problems.near_field.estimators.grid_refine import GridRefine
from nfbench.problems.near_field.estimators.music import Grid, Music
from nfbench.problems.near_field.estimators.omp import Omp

MUSIC = {"kind": "music", "grid": {"azimuth": 100, "range": 60}}
STARTS = ["omp", "newtonized-omp", "sparse-bayesian", "music", "modified-music", "grid-refine"]


def misfit(Y: np.ndarray, A: np.ndarray, objective: str) -> float:
    """Return tr((I − P_A)·W) by the printed formulas; W is that of ESF, of WSF, or the sample covariance."""
    K = A.shape[1]
    R = Y @ Y.conj().T / Y.shape[1]
    values, vectors = np.linalg.eigh(R)
    U, top, noise = vectors[:, -K:], values[-K:], values[:-K].mean()
    W = {
        "esf": U @ U.conj().T,
        "wsf": U @ np.diag(np.maximum(top - noise, 0) ** 2 / top) @ U.conj().T,
        "dml": R,
    }[objective]
    return float(np.trace((np.eye(len(A)) - A @ np.linalg.pinv(A)) @ W).real)


@pytest.mark.parametrize("objective", ["wsf", "dml", "esf"])
def test_the_fit_ends_at_a_minimum_below_its_start(objective):
    """On 50 scenes: the printed misfit is not higher than at the start, nor at any point next to the estimate."""
    for seed in range(50):
        instance = scene(seed, SMALL, snr_db=float(seed % 3) * 10.0)
        start, found = solve(Omp(coherence=0.9), instance), solve(FitFrom(objective=objective), instance)

        def left(theta, Y=instance.Y, at=instance.manifold):
            return misfit(Y, at.response(theta).T, objective)

        here = left(found)
        assert here <= left(start) * (1 + 1e-9)
        for k in range(len(found)):
            for side in range(2):
                for sign in (-1, 1):
                    moved = found.copy()
                    moved[k, side] *= 1 + sign * 1e-3
                    moved = np.clip(moved, instance.lower, instance.upper)
                    assert left(moved) >= here * (1 - 1e-6)


@pytest.mark.parametrize("start", STARTS)
def test_every_start_leads_to_the_same_minimum_where_sources_are_apart(start):
    array = LINE["array"] | {"elements": 64, "origin": "center"}
    instance = scene(2, LINE, array=array, wavefront="fresnel", positions=[[-35, 1.5], [5, 2.0], [30, 1.8]])
    best = solve(GridRefine(objective="wsf"), instance)
    assert_allclose(in_order(solve(FitFrom(start=start), instance)), in_order(best), rtol=1e-5)


@pytest.mark.parametrize("manifest", [SMALL, SPACE], ids=["line", "space"])
def test_without_noise_the_sources_are_found(manifest):
    instance = noise_free(scene(1, manifest, min_separation_deg=20.0, snapshots=20))
    for objective in ("wsf", "dml", "esf"):
        found = in_order(solve(FitFrom(start="omp", objective=objective), instance))
        assert_allclose(found, in_order(instance.theta), rtol=1e-6)


def test_it_separates_the_start_from_the_fit():
    """A start of twice the error ends at the same minimum; a start in another valley does not."""
    instance = scene(0, LINE, positions=[[-35, 3.0], [5, 2.0], [30, 4.0]])
    fine, coarse = (solve(FitFrom(start={"kind": "omp", "coherence": c}), instance) for c in (0.95, 0.8))
    assert_allclose(in_order(fine), in_order(coarse), rtol=1e-6)
    lost = solve(FitFrom(start={"kind": "omp", "wavefront": "planar", "coherence": 0.5}), instance)
    best = misfit(instance.Y, instance.manifold.response(fine).T, "wsf")
    assert misfit(instance.Y, instance.manifold.response(lost).T, "wsf") > 2 * best


def test_the_standard_errors_are_those_of_grid_refine():
    instance = scene(0, LINE, positions=[[-35, 3.0], [5, 2.0], [30, 4.0]])
    for objective in ("wsf", "dml", "esf"):
        found, expected = (
            FitFrom(objective=objective).solve(instance, None),
            GridRefine(objective=objective).solve(instance, None),
        )
        assert found.columns["std_m"] == pytest.approx(expected.columns["std_m"], rel=1e-5)
        assert list(found.columns) == list(expected.columns)


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_scenes_end_with_sources_in_the_box(name):
    instance = scene(0, HOSTILE[name])
    found = solve(FitFrom(objective="dml"), instance)
    assert found.shape == instance.theta.shape and np.isfinite(found).all()
    assert (found >= instance.lower).all() and (found <= instance.upper).all()


def test_coherent_sources_are_found_with_maximum_likelihood():
    instance = coherent(scene(positions=[[-35, 1.0], [10, 0.8], [40, 2.0]]))
    assert instance.score(solve(FitFrom(objective="dml"), instance))["rmse_m"] < 0.2


def test_bins_are_fitted_together():
    instance = scene(0, SMALL | {"bins": 3, "bandwidth_relative": 0.1, "positions": [[-35, 1.0], [10, 0.8], [40, 1.2]]})
    found, best = FitFrom().solve(instance, None), GridRefine(objective="wsf").solve(instance, None)
    assert_allclose(in_order(found.estimate), in_order(best.estimate), rtol=1e-5)
    assert found.columns["std_m"] == pytest.approx(best.columns["std_m"], rel=1e-4)


def test_the_number_of_sources_is_that_of_the_start():
    instance = scene()
    assert solve(FitFrom(start={"kind": "omp", "sources": 2}), instance).shape == (2, 2)
    noise = replace(instance, Y=np.random.default_rng(0).normal(size=(32, 400)).view(complex))
    assert solve(FitFrom(start={"kind": "omp", "sources": "estimate"}), noise).shape == (0, 2)


def test_the_start_may_need_a_solver_and_then_its_minimizers_are_fitted():
    fit = FitFrom(start={"kind": "nemo"})
    assert fit.needs_solver and not FitFrom().needs_solver and not FitFrom.needs_solver
    instance = scene(sources=1)
    called = []

    def search(problem):
        called.append(problem)
        return nfbench.minimize(problem, nfbench.solver("random-search"), 200, seed=1)

    found = fit.solve(instance, search)
    assert isinstance(found, Solution) and len(called) == 1


def test_fits_may_be_chained():
    fit = FitFrom(start={"kind": "fit-from", "start": "omp", "objective": "dml"}, objective="wsf")
    assert solve(fit, scene()).shape == (3, 2)


def test_what_does_not_apply_is_refused():
    with pytest.raises(Incompatible, match=r"snapshots: expected at least 3 .* got 2"):
        solve(FitFrom(), scene(snapshots=2))
    with pytest.raises(Incompatible, match=r"array.origin: expected \"center\" for modified MUSIC"):
        solve(FitFrom(start="modified-music"), scene(0, LINE))


@pytest.mark.parametrize(
    ("start", "message"),
    [
        ("omq", r"start\.kind: unknown formulation 'omq'.*omp"),
        ({"kind": "omp", "coherense": 0.5}, r"start\.coherense: unknown option.*coherence"),
        ({"coherence": 0.5}, r"start\.kind: is required; known: .*omp"),
        (3, r"start: expected a table with the kind of a formulation, got 3"),
        ("direct", r"start\.kind: expected a formulation that estimates sources from data of an array, got 'direct'"),
    ],
    ids=str,
)
def test_invalid_starts_are_refused(start, message):
    with pytest.raises(OptionError, match=message):
        FitFrom(start=start)


def test_a_start_that_is_not_finite_is_refused(monkeypatch):
    monkeypatch.setattr(Omp, "solve", lambda self, instance, minimize: np.full((2, 2), np.nan))
    with pytest.raises(ValueError, match="start: expected finite positions from omp, got NaN"):
        solve(FitFrom(), scene())


def test_warnings_of_the_start_are_given():
    scenario = Registry().make("scenario", "near-field", LINE)
    (text,) = FitFrom(start={"kind": "omp", "coherence": 0.9999}).warnings(scenario)
    assert text.startswith("start.coherence: 0.9999 gives a polar grid")
    assert FitFrom(start=MUSIC).warnings(scenario) == []


STUDY = """
name = "fits"
scenes = 2
seed = 1
[scenario]
kind = "near-field"
array = { kind = "ula", elements = 16, spacing_wavelengths = 0.5, origin = "center" }
wavelength_m = 0.02
sources = 1
snapshots = 10
snr_db = 20.0
azimuth_deg = [-60, 60]
range_m = [0.2, 1.0]
[[formulation]]
kind = "omp"
[[formulation]]
kind = "fit-from"
start = "omp"
[[formulation]]
kind = "fit-from"
start = { kind = "music", grid = { azimuth = 30, range = 20 } }
objective = "dml"
[[formulation]]
kind = "fit-from"
start = { kind = "nemo" }
[[solver]]
kind = "random-search"
[budget]
evaluations = 50
"""


def test_a_study_compares_starts_and_fits(tmp_path):
    (tmp_path / "study.toml").write_text(STUDY)
    results = run(load_study(tmp_path / "study.toml"), out=tmp_path / "out", jobs=1)
    assert (results.runs.status == "ok").all() and len(results.runs) == 8
    assert results.runs.method.nunique() == 4
    error = results.runs.groupby("method").rmse_m.median()
    assert error.drop("omp").max() < error["omp"]


def test_errors_of_a_manifest_name_the_option_of_the_start(tmp_path):
    (tmp_path / "study.toml").write_text(STUDY.replace('start = "omp"', 'start = { kind = "omp", coherence = 2 }'))
    with pytest.raises(ManifestError, match=r"formulation\[1\]\.start\.coherence: expected"):
        load_study(tmp_path / "study.toml")


def test_equal_runs_give_equal_estimates_and_options():
    instance = scene()
    assert_array_equal(solve(FitFrom(), instance), solve(FitFrom(start="omp"), instance))
    made = FitFrom(start=MUSIC).start.made
    assert made == Music(grid=Grid(azimuth=100, range=60))
