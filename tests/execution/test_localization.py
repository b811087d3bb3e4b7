"""``nfbench.localize``: one recording, one method; values on simulated and measured recordings, and clear errors."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import PROJECT
from conftest import nfbench as command

import nfbench
from nfbench import NfbenchError, OptionError
from nfbench.execution import procedure, recommended
from nfbench.plugins import Registry

DATA = PROJECT / ".." / "shared" / "data" / "miracle"
measured = pytest.mark.skipif(not DATA.is_dir(), reason=f"the measured data are not in {DATA}")
BOX = {"azimuth_deg": (-60, 60), "elevation_deg": (-60, 60), "range_m": (0.4, 2.0)}
SOURCES = np.array([[0.3, 0.2, 0.9], [-0.4, -0.1, 1.1]])  # in front of an array in the x-y plane
TWO = {"frequency_hz": 1000.0, "speed_m_s": 343.0, "sources": 2, "broadside": "+z", **BOX}


def normal(rng, shape):
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)


@pytest.fixture(scope="module")
def recording():
    """Positions [m] and snapshots of spherical waves e^(−jkd) from two sources, 20 dB above the noise."""
    rng = np.random.default_rng(3)
    Q = np.column_stack([rng.uniform(-0.7, 0.7, (40, 2)), np.zeros(40)])
    d = np.linalg.norm(Q[:, None] - SOURCES, axis=-1)
    Y = 10 * np.exp(-2j * np.pi * 1000 / 343 * d) @ normal(rng, (2, 100)) + normal(rng, (40, 100))
    return Q, Y


def places(found):
    return np.array(sorted([source["x_m"], source["y_m"], source["z_m"]] for source in found.sources))


def test_sources_are_found_within_their_standard_errors(recording):
    Q, Y = recording
    found = nfbench.localize(Y, Q, **TWO)
    expected = SOURCES[np.argsort(SOURCES[:, 0])]
    rows = sorted(found.sources, key=lambda source: source["x_m"])
    std = np.array([[source[f"std_{c}_m"] for c in "xyz"] for source in rows])
    assert (np.abs(places(found) - expected) < 4.5 * std).all() and std.max() < 0.01
    assert [source["snr_db"] for source in rows] == pytest.approx([20, 20], abs=1.0)
    assert found.warnings == () and found.fit["p_value"] > 1e-3
    assert any("that of the elements" in note for note in found.notes)


def test_a_file_and_an_array_in_memory_give_the_same(recording, tmp_path):
    Q, Y = recording
    np.save(tmp_path / "y.npy", Y.T)
    (tmp_path / "q.csv").write_text("x_mm,y_mm,z_mm\n" + "\n".join(",".join(map(repr, q)) for q in (1e3 * Q).tolist()))
    first, second = nfbench.localize(Y, Q, **TWO), nfbench.localize(tmp_path / "y.npy", tmp_path / "q.csv", **TWO)
    assert places(second) == pytest.approx(places(first), abs=1e-9)
    table = {"kind": "custom", "positions": Q.tolist(), "origin": "first"}
    third = nfbench.localize(Y, table, **TWO)
    assert places(third) == pytest.approx(places(first), abs=1e-6)
    assert third.sources[0]["range_m"] != pytest.approx(first.sources[0]["range_m"], abs=0.01)


@pytest.mark.parametrize("method", ["neef + de", "music"])
def test_every_kind_of_method_finds_them(recording, method):
    Q, Y = recording
    options = {"grid": {"azimuth": 80, "elevation": 80, "range": 20}} if method == "music" else {}
    evaluations = 6000 if "+" in method else None
    how = nfbench.procedure(method, options, evaluations=evaluations)
    found = nfbench.localize(Y, Q, method=how, **TWO)
    expected = SOURCES[np.argsort(SOURCES[:, 0])]
    assert np.abs(places(found) - expected).max() < (0.1 if method == "music" else 0.01)


def test_the_same_seed_gives_the_same_result(recording):
    Q, Y = recording
    how = nfbench.procedure("neef + de", solver_options={"population": 12}, evaluations=240)
    first, second, other = (nfbench.localize(Y, Q, method=how, seed=seed, **TWO) for seed in (1, 1, 2))
    assert (places(first) == places(second)).all() and (places(first) != places(other)).any()


def test_the_number_of_sources_is_estimated(recording):
    Q, Y = recording
    assert len(nfbench.localize(Y, Q, **{**TWO, "sources": "estimate"}).sources) == 2


def test_known_gains_and_noise_are_used(recording, tmp_path):
    Q, Y = recording
    rng = np.random.default_rng(1)
    gains = np.exp(1j * rng.uniform(-1.5, 1.5, 40))
    np.save(tmp_path / "g.npy", gains)
    blind = nfbench.localize(gains[:, None] * Y, Q, **TWO)
    assert blind.warnings[0].startswith("the model does not fit")
    known = nfbench.localize(gains[:, None] * Y, Q, gains_file=str(tmp_path / "g.npy"), **TWO)
    assert places(known) == pytest.approx(places(nfbench.localize(Y, Q, **TWO)), abs=2e-3)


def test_an_array_in_millimetres_is_an_error_that_names_the_unit(recording):
    Q, Y = recording
    with pytest.raises(NfbenchError, match=r"--unit mm"):
        nfbench.localize(Y, 1000 * Q, **TWO)


def test_a_tested_unit_is_the_first_warning_and_replaces_the_guess_from_the_size(recording):
    Q, Y = recording
    with pytest.raises(NfbenchError) as caught:  # centimetres that are read as metres
        nfbench.localize(Y, 100 * Q, **TWO)
    first, *others = str(caught.value).splitlines()[1:]
    assert first.startswith("  the coordinates of the array are probably 100 times too large") and "--unit cm" in first
    assert not [text for text in others if text.startswith("  array: its")]


@pytest.mark.parametrize(
    ("method", "message"),
    [
        ("neef", "needs a solver"),
        ("neeef", 'did you mean "neef"'),
        ("neef + dee", 'did you mean "de"'),
        ("grid-refine + de", "needs no solver"),
        ("direct + de", "expected a formulation that solves RecordedInstance"),
    ],
)
def test_a_method_that_cannot_work_is_refused(recording, method, message):
    Q, Y = recording
    with pytest.raises(NfbenchError, match=message):
        nfbench.localize(Y, Q, method=method, **TWO)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (lambda Y: Y[:, :1], "expected at least 2 for the signal subspace|snapshots"),
        (lambda Y: Y.real, "no phase"),
        (lambda Y: 0 * Y, "zero"),
        (lambda Y: np.where(np.arange(100) == 5, np.nan, Y), "NaN|finite"),
        (lambda Y: Y[:39], "40"),
        (lambda Y: Y[0], "40|axis|shape"),
        (lambda Y: Y.astype(object), "expected numbers"),
        (lambda Y: np.array([["a"]]), "expected numbers"),
    ],
)
def test_data_that_cannot_be_used_are_refused(recording, data, message):
    Q, Y = recording
    with pytest.raises(NfbenchError, match=message):
        nfbench.localize(data(Y), Q, **TWO)


@pytest.mark.parametrize("array", [np.zeros((4, 2)), np.array(["a"]), np.zeros(3)])
def test_positions_of_another_shape_are_refused(recording, array):
    with pytest.raises(OptionError, match=r"expected positions \[m\] of shape"):
        nfbench.localize(recording[1], array, **TWO)


def test_dead_channels_are_named_by_their_number(recording):
    Q, Y = recording
    dead = Y.copy()
    dead[[7, 31]] *= 1e-4
    assert any("7 and 31" in text and "failed = [7, 31]" in text for text in nfbench.localize(dead, Q, **TWO).warnings)
    found = nfbench.localize(dead, Q, failed=[7, 31], **TWO)
    assert found.warnings == () and found.fit["elements"] == 38


STUDY = """
name = "choice"
scenes = {scenes}
seed = 1
[scenario]
kind = "near-field"
array = {{ kind = "ula", elements = 16, spacing_wavelengths = 0.5, origin = "center" }}
wavelength_m = 0.1
sources = 2
snapshots = 50
snr_db = 20.0
azimuth_deg = [-60, 60]
range_m = [0.4, 1.2]
min_separation_deg = 20.0
[[formulation]]
kind = "neef"
objective = "dml"
[[solver]]
kind = "de"
population = 37
[[solver]]
kind = "random-search"
[budget]
evaluations = 1000
"""


def test_the_method_that_a_study_recommends_is_taken_with_its_options(tmp_path, recording):
    Q, Y = recording
    (tmp_path / "study.toml").write_text(STUDY.format(scenes=10))
    done = command("run", "study.toml", "--jobs", 1, cwd=tmp_path)
    assert "Recommended: neef + de" in " ".join(done.stdout.split())
    how = recommended(tmp_path / "results" / "choice")
    assert how.label == "neef + de" and how.formulation.objective == "dml" and how.solver.population == 37
    assert how.budget.evaluations == 1000
    found = nfbench.localize(Y, Q, method=how, seed=4, **TWO)
    assert np.isfinite(places(found)).all()
    assert found.method == {
        "formulation": "neef",
        "options": {"objective": "dml"},
        "solver": "de",
        "solver_options": {"population": 37},
        "budget": {"evaluations": 1000},
        "seed": 4,
        "study": str(tmp_path / "results" / "choice"),
        "label": "neef + de",
        "swept": {},
    }
    (text,) = [text for text in found.warnings if "may not hold for this recording" in text]
    assert "its wavelength is 0.1 m, that of the recording 0.343 m" in text
    assert "its array has 16 elements, that of the recording 40" in text
    assert "sources" not in text  # both have two


def test_a_study_of_the_same_array_at_the_same_wavelength_has_no_warning(recording):
    Q, Y = recording
    same = {"kind": "custom", "origin": "center", "positions": Q.tolist()}
    scene = {"snapshots": 9, "snr_db": 9.0, "azimuth_deg": [-60, 60], "elevation_deg": [-9, 9], "range_m": [1, 2]}
    array = {key: TWO[key] for key in ("broadside", "up") if key in TWO}
    own = {"array": {**same, **array}, "wavelength_m": 343.0 / 1000.0, "sources": 2, **scene}
    scenario, few = (Registry().make("scenario", "near-field", {**own, **more}) for more in ({}, {"sources": 1}))
    how = replace(procedure("neef + de", evaluations=300), study="mine", scenarios=(few, scenario))
    assert not [text for text in nfbench.localize(Y, Q, method=how, **TWO).warnings if "may not hold" in text]
    how = replace(how, scenarios=(few,), formulation=replace(how.formulation, known_gains=True))
    warnings = nfbench.localize(Y, Q, method=how, **TWO).warnings
    assert any("may not hold for this recording: its number of sources is 1, not 2" in text for text in warnings)
    assert any("knows more than here (known_gains); give gains_file" in text for text in warnings)


def test_a_study_without_a_recommendation_is_an_error(tmp_path):
    (tmp_path / "study.toml").write_text(STUDY.format(scenes=2))
    command("run", "study.toml", "--jobs", 1, cwd=tmp_path)
    with pytest.raises(NfbenchError, match=r"no method yet: 2 scenes cannot rank 2 methods; \d would\. Run more"):
        recommended(tmp_path / "results" / "choice")
    with pytest.raises(NfbenchError):
        recommended(tmp_path / "nothing")


ACCEPTED = {"frequency_hz": 1000.0, "speed_m_s": 344.7, "sources": 2, "broadside": "+z", "up": "+y", **BOX}


def errors_mm(found):
    truth = np.loadtxt(DATA / "sources_m.csv", delimiter=",", skiprows=1)
    return sorted(1e3 * np.linalg.norm(places(found)[:, None] - truth, axis=-1).min(axis=1))


@measured
def test_measured_snapshots_have_the_reference_errors():
    found = nfbench.localize(DATA / "snapshots_1khz.npy", DATA / "positions_m.csv", **ACCEPTED)
    assert errors_mm(found) == pytest.approx([5.5, 7.7], abs=0.3)
    assert found.warnings[0].startswith("the model does not fit: it explains 77.2 % of the signal subspace")


@measured
@pytest.mark.parametrize(("khz", "expected"), [(4, [9.5, 10.7]), (6, [3.0, 8.4]), (8, [7.7, 9.2])])
def test_measured_samples_have_the_reference_errors(khz, expected):
    time = {"data_kind": "samples", "sample_rate_hz": 32_000.0, "frequency_hz": 1000.0 * khz}
    found = nfbench.localize(DATA / "time_data_32khz.npy", DATA / "positions_m.csv", **{**ACCEPTED, **time})
    assert errors_mm(found) == pytest.approx(expected, abs=0.3)


@measured
def test_mistakes_with_measured_data_are_named():
    Y = np.load(DATA / "snapshots_1khz.npy")
    Q = np.loadtxt(DATA / "positions_m.csv", delimiter=",", skiprows=1)
    assert "your phase convention is the opposite one" in " ".join(nfbench.localize(Y.conj(), Q, **ACCEPTED).warnings)
    with pytest.raises(NfbenchError, match="--unit mm"):
        nfbench.localize(Y, 1000 * Q, **ACCEPTED)
    for wrong in ({"broadside": "+x", "up": "+z"}, {"broadside": "+y", "up": "+z"}):
        assert "--broadside +z --up +y" in " ".join(nfbench.localize(Y, Q, **{**ACCEPTED, **wrong}).warnings)
