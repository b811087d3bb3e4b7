"""The command ``localize``: its table, files and exit codes, as a user sees them."""

import json

import numpy as np
import pandas as pd
import pytest
from conftest import PROJECT
from conftest import nfbench as command_line
from typer.testing import CliRunner

import nfbench.cli  # noqa: F401  # registers the commands
from nfbench.cli.common import app
from nfbench.core import NfbenchError

DATA = PROJECT / ".." / "shared" / "data" / "miracle"
measured = pytest.mark.skipif(not DATA.is_dir(), reason=f"the measured data are not in {DATA}")
SOURCES = np.array([[-0.4, -0.1, 1.1], [0.3, 0.2, 0.9]])
BOX = ("--azimuth-deg", -60, 60, "--elevation-deg", -60, 60, "--range-m", 0.4, 2)
WAVE = ("--frequency-hz", 1000, "--speed", 343)
ARRAY = ("--positions", "q.csv", "--broadside", "+z", "--up", "+y")
SOURCE_COLUMNS = ("x_m", "y_m", "z_m", "azimuth_deg", "elevation_deg", "range_m")


def normal(rng, shape):
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with positions, snapshots, their covariance, and samples over time of two sources."""
    rng = np.random.default_rng(3)
    Q = np.column_stack([rng.uniform(-0.7, 0.7, (40, 2)), np.zeros(40)])
    pd.DataFrame(Q, columns=["x_m", "y_m", "z_m"]).to_csv(tmp_path / "q.csv", index=False)
    d = np.linalg.norm(Q[:, None] - SOURCES, axis=-1)
    Y = 10 * np.exp(-2j * np.pi * 1000 / 343 * d) @ normal(rng, (2, 100)) + normal(rng, (40, 100))
    np.save(tmp_path / "y.npy", Y)
    np.save(tmp_path / "r.npy", Y @ Y.conj().T / 100)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def localize(*arguments):
    """Run the command in this process, which is faster; nfbench's own errors come back as exceptions."""
    return CliRunner().invoke(app, ["localize", *map(str, arguments)], env={"COLUMNS": "120", "NO_COLOR": "1"})


def places(table):
    return np.array(sorted([source[name] for name in SOURCE_COLUMNS[:3]] for source in table["sources"]))


def test_the_table_and_the_files_agree(folder):
    files = ("--json", "o.json", "--csv", "o.csv", "--figure", "o.png")
    done = localize("y.npy", *ARRAY, *WAVE, *BOX, "--sources", 2, "--method", "grid-refine", *files)
    assert done.exit_code == 0, (done.output, done.exception)
    table = json.loads((folder / "o.json").read_text())
    assert list(table) == ["sources", "fit", "method", "warnings"] and table["warnings"] == []
    expected = [*SOURCE_COLUMNS, *(f"std_{name}" for name in SOURCE_COLUMNS), "snr_db"]
    assert [list(source) for source in table["sources"]] == [expected, expected]
    assert places(table) == pytest.approx(SOURCES, abs=0.01)
    assert (table["fit"]["elements"], table["fit"]["snapshots"]) == (40, 100)
    rows = pd.read_csv(folder / "o.csv")
    assert rows["source"].tolist() == [1, 2]
    assert rows[list(SOURCE_COLUMNS)].to_numpy() == pytest.approx(
        np.array([[source[name] for name in SOURCE_COLUMNS] for source in table["sources"]])
    )
    assert (folder / "o.png").read_bytes().startswith(b"\x89PNG")
    for source in table["sources"]:
        assert f"{source['range_m']:.4f}"[:5] in done.stdout
    assert "azimuth [°]" in done.stdout and "±" in done.stdout and "Warning" not in done.stdout


def test_json_without_a_file_is_all_that_is_printed(folder):
    done = localize("y.npy", *ARRAY, *WAVE, "--json", *BOX, "--sources", 2)
    assert places(json.loads(done.stdout)) == pytest.approx(SOURCES, abs=0.01)
    last = localize("y.npy", *ARRAY, *WAVE, *BOX, "--sources", 2, "--json")
    assert last.stdout == done.stdout


def test_a_covariance_gives_the_same_positions(folder):
    first = json.loads(localize("y.npy", *ARRAY, *WAVE, *BOX, "--sources", 2, "--json").stdout)
    options = ("--covariance", "--snapshots", 100)
    second = json.loads(localize("r.npy", *ARRAY, *WAVE, *BOX, "--sources", 2, *options, "--json").stdout)
    assert places(second) == pytest.approx(places(first), abs=1e-6)
    assert second["sources"][0]["std_x_m"] == pytest.approx(first["sources"][0]["std_x_m"], rel=1e-3)


def test_samples_over_time_give_snapshots_at_the_frequency(folder):
    rng = np.random.default_rng(4)
    Q = pd.read_csv("q.csv").to_numpy()
    N, rate = 16_000, 8_000.0
    spectra = np.fft.rfft(rng.standard_normal((2, N)))
    f = np.fft.rfftfreq(N, 1 / rate)
    d = np.linalg.norm(Q[:, None] - SOURCES, axis=-1)
    x = sum(np.fft.irfft(spectra[k] * np.exp(-2j * np.pi * f / 343 * d[:, k, None]), N) for k in (0, 1))
    np.save("x.npy", (x + 0.1 * rng.standard_normal(x.shape)).T.astype(np.float32))
    time = ("--sample-rate-hz", rate, "--block", 512, "--overlap", 0.5, "--window", "hann")
    done = localize("x.npy", *ARRAY, *WAVE, *BOX, "--sources", 2, *time)
    assert "at 1000 Hz from blocks of 512 samples" in done.stdout
    table = json.loads(localize("x.npy", *ARRAY, *WAVE, *BOX, "--sources", 2, *time, "--json").stdout)
    assert places(table) == pytest.approx(SOURCES, abs=0.03)


def test_the_other_convention_and_other_units_have_options(folder):
    np.save("c.npy", np.load("y.npy").conj())
    Q = pd.read_csv("q.csv").to_numpy()
    np.savetxt("mm.csv", 1e3 * Q, delimiter=",", fmt="%.12g")
    wrong = localize("c.npy", *ARRAY, *WAVE, *BOX, "--sources", 2)
    assert "your phase convention is the opposite one" in " ".join(wrong.stdout.split()) and wrong.exit_code == 0
    array = ("--positions", "mm.csv", "--unit", "mm", "--broadside", "0,0,2", "--up", "+y", "--origin", "first")
    table = json.loads(localize("c.npy", *array, *WAVE, *BOX, "--sources", 2, "--conjugate", "--json").stdout)
    assert places(table) == pytest.approx(SOURCES, abs=0.01) and table["warnings"] == []


def test_a_method_and_a_scenario_with_options(folder):
    (folder / "s.toml").write_text(
        '[scenario]\nkind = "recorded"\nfrequency_hz = 1000.0\nspeed_m_s = 100.0\nrange_m = [0.4, 2.0]\n'
        "azimuth_deg = [-60, 60]\nelevation_deg = [-60, 60]\nsources = 2\n"
    )
    method = ("--method", "neef + de", "--option", "objective=wsf", "--solver-option", "population=40")
    more = ("--scenario", "s.toml", "--speed", 343, "--scenario-option", "failed=[3]", "--evaluations", 9000)
    table = json.loads(localize("y.npy", *ARRAY, *method, *more, "--json").stdout)
    assert places(table) == pytest.approx(SOURCES, abs=0.02) and table["fit"]["elements"] == 39


def test_numbers_that_are_not_known_are_null(folder):
    box = (*BOX[:6], "--range-m", 0.4, 0.8)
    table = json.loads(localize("y.npy", *ARRAY, *WAVE, *box, "--sources", 2, "--json").stdout)
    assert any(source["range_m"] == pytest.approx(0.8) and source["std_x_m"] is None for source in table["sources"])
    assert any("--range-m" in text for text in table["warnings"])


WRONG = [
    (("missing.npy",), "missing.npy"),
    ((".",), ""),
    (("q.csv",), "no phase"),
    (("y.npy", "--positions", "none.csv"), "none.csv"),
    (("y.npy", "--positions", "."), ""),
    (("y.npy", "--sources", 0), "sources"),
    (("y.npy", "--sources", "many"), "sources"),
    (("y.npy", "--sources", 40), "sources"),
    (("y.npy", "--broadside", "q"), "broadside"),
    (("y.npy", "--failed", "99"), "failed"),
    (("y.npy", "--method", "neef"), '"neef + de"'),
    (("y.npy", "--method", "grid-refin"), 'did you mean "grid-refine"'),
    (("y.npy", "--option", "densty=2"), 'did you mean "density"'),
    (("y.npy", "--range-m", 2, 1), "--range-m"),
    (("y.npy", "--range-m", "nan", 1), "--range-m"),
    (("y.npy", "--scenario-option", "colour=3"), "colour"),
    (("y.npy", "--scenario", "q.csv"), "q.csv"),
    (("y.npy", "--study", "."), ""),
    (("y.npy", "--json", "no/such/folder/o.json"), "no/such/folder"),
    (("y.npy", "--figure", "no/such/folder/o.png"), "no/such/folder"),
]


@pytest.mark.parametrize(("arguments", "part"), WRONG, ids=lambda value: " ".join(map(str, value))[:40])
def test_bad_input_ends_in_a_message(folder, arguments, part):
    options = {"--positions": ("q.csv",), "--broadside": ("+z",), "--sources": (2,), "--range-m": (0.4, 2)}
    given = [argument for name, values in options.items() if name not in arguments for argument in (name, *values)]
    done = localize(*arguments, *given, *WAVE, *BOX[:6])
    assert done.exit_code != 0
    if isinstance(done.exception, SystemExit):
        assert done.exit_code == 2 and part in done.output
    else:  # raised to ``main``, which prints it and ends with 2
        assert isinstance(done.exception, (NfbenchError, OSError)), done.exception
        assert part in str(done.exception)


def test_files_that_are_damaged_end_in_a_message_and_not_in_a_traceback(folder):
    whole = (folder / "y.npy").read_bytes()
    (folder / "short.npy").write_bytes(whole[: len(whole) // 2])
    (folder / "text.npy").write_text("not numbers")
    np.save("pickle.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    for name in ("short.npy", "text.npy", "pickle.npy"):
        done = localize(name, *ARRAY, *WAVE, *BOX, "--sources", 2)
        assert isinstance(done.exception, NfbenchError) and name in str(done.exception)
    done = command_line("localize", "short.npy", *ARRAY, *WAVE, *BOX, "--sources", 2, cwd=folder)
    assert done.returncode == 2 and "short.npy" in done.stderr and "Traceback" not in done.stderr + done.stdout


@measured
def test_the_command_of_the_documentation_on_measured_data(tmp_path):
    command = (
        f"localize {DATA / 'snapshots_1khz.npy'} --positions {DATA / 'positions_m.csv'} --frequency-hz 1000 "
        "--speed 344.7 --broadside +z --up +y --sources 2 --azimuth-deg -60 60 --elevation-deg -60 60 --range-m 0.4 2 "
        "--method grid-refine --json"
    )
    done = command_line(*command.split(), cwd=tmp_path)
    truth = np.loadtxt(DATA / "sources_m.csv", delimiter=",", skiprows=1)
    errors = np.linalg.norm(places(json.loads(done.stdout))[:, None] - truth, axis=-1).min(axis=1)
    assert sorted(1e3 * errors) == pytest.approx([5.5, 7.7], abs=1.0)
