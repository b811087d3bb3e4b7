"""Messages of ``localize`` speak of flags, one line per error, and suggest the names that were probably meant."""

import numpy as np
import pytest
from conftest import nfbench as command_line
from typer.testing import CliRunner

import nfbench.cli  # noqa: F401  # registers the commands
from nfbench import NfbenchError
from nfbench.cli.common import app
from nfbench.cli.localize_flags import in_flags
from nfbench.core import nearest

GIVEN = {
    "--positions": ("q.csv",),
    "--broadside": ("+z",),
    "--frequency-hz": (1000,),
    "--speed": (343,),
    "--sources": (1,),
    "--azimuth-deg": (-60, 60),
    "--elevation-deg": (-60, 60),
    "--range-m": (0.4, 2),
}


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """A folder with named elements and snapshots of one source."""
    rng = np.random.default_rng(3)
    Q = np.column_stack([rng.uniform(-0.5, 0.5, (12, 2)), np.zeros(12)])
    rows = [f"M{m:02d},{x},{y},{z}" for m, (x, y, z) in enumerate(Q, start=1)]
    (tmp_path / "q.csv").write_text("name,x_m,y_m,z_m\n" + "\n".join(rows) + "\n")
    d = np.linalg.norm(Q - [0.1, 0.2, 1.0], axis=1)
    parts = rng.standard_normal((2, 13, 30))
    s = 30 * (parts[0, 12] + 1j * parts[1, 12])
    np.save(tmp_path / "y.npy", np.exp(-2j * np.pi * 1000 / 343 * d)[:, None] * s + parts[0, :12] + 1j * parts[1, :12])
    monkeypatch.chdir(tmp_path)
    return tmp_path


def localize(data="y.npy", *more, without=()):
    given = [
        each
        for name, values in GIVEN.items()
        if name not in without and name not in more
        for each in (name, *map(str, values))
    ]
    return CliRunner().invoke(app, ["localize", data, *given, *map(str, more)], env={"COLUMNS": "200"})


def message(*more, without=()):
    done = localize("y.npy", *more, without=without)
    assert isinstance(done.exception, NfbenchError), (done.exception, done.output)
    return str(done.exception)


def test_every_required_option_that_is_missing_has_a_line_with_its_flag():
    assert message(without=("--sources", "--azimuth-deg", "--range-m")).splitlines() == [
        "3 options are missing or wrong:",
        "  --sources NUMBER|estimate is required",
        "  --azimuth-deg LOW HIGH is required",
        "  --range-m LOW HIGH is required",
    ]
    assert message(without=("--range-m",)) == "--range-m LOW HIGH is required"


@pytest.mark.parametrize(
    ("options", "start", "meant"),
    [
        (("--broadside", "z"), "--broadside: expected '+x'", "+z"),
        (("--unit", "CM"), "--unit: expected 'm'", "cm"),
        (("--failed", "M6"), "--failed: expected a number or the name of an element, got 'M6'", "M06"),
        (("--method", "neef + CMA-ES"), "unknown solver 'CMA-ES'", "cmaes"),
        (("--option", "densty=2"), "--option densty: unknown option", "density"),
        (
            ("--method", "neef + de", "--solver-option", "popultion=9"),
            "--solver-option popultion: unknown",
            "population",
        ),
        (("--scenario-option", "truth=1"), "--scenario-option truth: unknown option", "truth_m"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_a_wrong_name_is_reported_with_its_flag_and_the_name_that_was_meant(options, start, meant):
    text = message(*options)
    assert text.startswith(start) and text.endswith(f'; did you mean "{meant}"?')


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (("--range-m", 2, 1), "--range-m: expected [low, high] with low < high, got [2, 1]"),
        (("--failed", "12"), "--failed: expected the number of an element, 0 to 11, got 12"),
        (("--sources", 12), "--sources: expected fewer than the 12 elements that are used, got 12"),
        (("--block", 512), "--block: has an effect only with --sample-rate-hz NUMBER"),
    ],
)
def test_a_wrong_value_is_reported_with_its_flag(options, text):
    assert message(*options) == text


def test_weak_elements_have_names_and_the_flag_that_leaves_them_out(folder):
    Y = np.load("y.npy")
    Y[4] *= 1e-4
    np.save("one.npy", Y)
    Y[10] *= 1e-4
    np.save("two.npy", Y)
    one, two = (" ".join(localize(f"{name}.npy").stdout.split()) for name in ("one", "two"))
    assert "element M05 is at least 40 dB weaker than the median of all" in one
    assert 'leave it out with failed = ["M05"] (--failed M05)' in one
    assert "elements M05 and M11 are at least 40 dB weaker than the median of all" in two
    assert 'leave them out with failed = ["M05", "M11"] (--failed M05,M11)' in two


@pytest.mark.parametrize(
    ("text", "translated"),
    [
        ("try failed = [5, 19]", "try --failed 5,19"),
        ("set sources = 3 or range_m = [0.5, 2]", "set --sources 3 or --range-m 0.5 2"),
        ('set unit = "mm"', "set --unit mm"),
        ("enlarge azimuth_deg, elevation_deg or range_m", "enlarge --azimuth-deg, --elevation-deg or --range-m"),
        ("give frequency_hz and speed_m_s", "give --frequency-hz and --speed"),
        ('give data_kind = "covariance"', "give --covariance"),
        ("set sources = 3 (--sources 3)", "set sources = 3 (--sources 3)"),
        ("std_range_m and --range-m of 2 sources", "std_range_m and --range-m of 2 sources"),
    ],
)
def test_options_in_sentences_become_flags(text, translated):
    assert in_flags(text) == translated


def test_several_errors_of_any_command_have_a_line_each(folder):
    done = command_line("check", "solver", "de", "--option", "population=-1", "--option", "cr=7", cwd=folder)
    assert done.returncode == 2
    assert [line.split(": ")[0] for line in done.stderr.splitlines()] == ["nfbench", "DE"]


def test_the_nearest_name_ignores_case_signs_and_leading_zeros():
    assert nearest("z", ["+x", "-x", "+z", "-z"]) == "+z"
    assert nearest("CMA-ES", ["cmaes", "fcmaes"]) == "cmaes"
    assert nearest("M6", ["M01", "M06", "M60"]) == "M06"
    assert nearest("Grid Refin", ["music", "grid-refine"]) == "grid-refine"
    assert nearest("colour", ["music"]) is None
