"""``nfbench show array``: the properties of arrays against formulas, the drawing, and messages for wrong input."""

import math
import re

import numpy as np
import pytest
from conftest import PROJECT
from typer.testing import CliRunner

from nfbench.cli.common import app
from nfbench.core import OptionError
from nfbench.problems.near_field.arrays import ULA, UPA, Custom
from nfbench.problems.near_field.scenario import NearField

DATA = PROJECT / ".." / "shared" / "data"


def show(*arguments):
    return CliRunner().invoke(app, ["show", "array", *map(str, arguments)], env={"COLUMNS": "200"})


def printed(*arguments):
    result = show(*arguments)
    assert result.exit_code == 0, (result.output, result.exception)
    return result.output


def survey(array, **carrier):
    return NearField.survey({"array": array, **carrier})


def numbers(text):
    return [float(part) for part in re.findall(r"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?", text)]


@pytest.fixture
def plane(tmp_path):
    """Sixteen elements 80 mm apart in the x-y plane, in millimetres, with names."""
    rows = [f"m{4 * i + j},{80 * i},{80 * j},0" for i in range(4) for j in range(4)]
    path = tmp_path / "plane.csv"
    path.write_text("\n".join(["mic,x_mm,y_mm,z_mm", *rows]))
    return path


def test_sizes_and_distances_are_those_of_the_formulas():
    wavelength = 0.02
    facts = dict(survey(ULA(elements=129, spacing_wavelengths=0.25, origin="first"), wavelength_m=wavelength).facts)
    D = 128 * 0.005
    assert facts["elements"] == "129"
    assert numbers(facts["extent"])[:3] == [0.0, D, 0.0]
    assert numbers(facts["aperture D"]) == [D, 32.0]
    assert numbers(facts["smallest spacing"]) == numbers(facts["median spacing"]) == [0.005, 0.25]
    assert numbers(facts["Fraunhofer distance"])[0] == pytest.approx(2 * D**2 / wavelength, rel=1e-3)
    assert numbers(facts["Fresnel distance"])[0] == pytest.approx(0.62 * math.sqrt(D**3 / wavelength), rel=1e-3)
    assert facts["shape"].startswith("on a line along +y;")
    upa = UPA(columns=16, rows=16, spacing_wavelengths=0.5, origin="center")
    assert numbers(dict(survey(upa, wavelength_m=0.02).facts)["aperture D"])[0] == pytest.approx(0.2263, abs=1e-4)


@pytest.mark.parametrize(
    ("positions", "shape"),
    [
        ([[0, 0, 0], [1, 1, 0], [2, 2, 0]], "on a line along [0.7071, 0.7071, 0]"),
        ([[0, 0, 0], [1, 0, 0], [0, 0, 1]], "in a plane with the normal +y"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], "in space"),
    ],
)
def test_the_shape_is_that_in_the_coordinates_of_the_user(positions, shape):
    for turned in ({}, {"broadside": "+z", "up": "-x"}):
        array = Custom(origin="center", positions=positions, **turned)
        found = dict(survey(array).facts)["shape"]
        assert found.startswith((shape, shape.replace("+", "-").replace("0.7071, 0.7071", "-0.7071, -0.7071")))


def test_the_survey_has_the_elements_as_they_were_given():
    positions = [[1.0, 2.0, 3.0], [2.0, 2.0, 3.0], [1.0, 5.0, 3.0]]
    found = survey(Custom(origin="first", positions=positions, broadside="-z", up="+x", names=("a", "b", "c")))
    np.testing.assert_allclose(found.elements, positions, atol=1e-12)
    np.testing.assert_allclose(found.broadside, [0, 0, -1], atol=1e-15)
    np.testing.assert_allclose(found.up, [1, 0, 0], atol=1e-15)
    assert found.names == ("a", "b", "c")


def test_a_file_is_described(plane):
    text = printed(plane, "--frequency-hz", 2000, "--speed", 343, "--broadside", "+z", "--up", "+y")
    assert "16 (m0, m1, m2, …, m15)" in text
    assert "0.24 × 0.24 × 0 m" in text and "0.08 m, 0.466 λ" in text
    assert "in a plane with the normal" in text and "+z, +y" in text
    assert "nfbench:" not in text


@pytest.mark.parametrize(
    ("arguments", "warning"),
    [
        (
            ["--frequency-hz", 2000, "--speed", 343],
            'set broadside to the direction in front of the array, for example "+z"',
        ),
        (["--frequency-hz", 4000, "--speed", 343, "--broadside", "+z"], "0.933 λ or more from the nearest other one"),
        (["--frequency-hz", 4000, "--speed", 343, "--broadside", "+z"], "so that grating lobes"),
    ],
)
def test_what_may_be_wrong_is_named(plane, arguments, warning):
    assert warning in printed(plane, *arguments)


def test_millimetres_read_as_metres_are_suspected(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("".join(f"0,{80 * i},{80 * j}\n" for i in range(4) for j in range(4)))
    for carrier in ([], ["--wavelength-m", 0.1715]):
        assert 'are these millimetres? then set unit = "mm"' in printed(path, *carrier)
        assert "millimetres" not in printed(path, "--unit", "mm", *carrier)


def test_a_kind_is_described_with_its_options():
    text = printed("sunflower", "--option", "elements=64", "--option", "radius_m=0.75")
    assert "in a plane with the normal" in text and "1.495 m" in text.split("aperture D")[1].splitlines()[0]
    text = printed("ula", "--option", "elements=8", "--option", "spacing_wavelengths=0.5", "--wavelength-m", "0.1")
    assert "0.35 m, 3.5 λ" in text


def test_the_arrays_of_a_manifest_are_described_once(tmp_path, plane):
    (tmp_path / "study.toml").write_text(
        'name = "s"\nscenes = 1\nseed = 1\n[scenario]\nkind = "near-field"\nfrequency_hz = 1000\nspeed_m_s = 343\n'
        "sources = 1\nsnapshots = 5\nsnr_db = 1\nazimuth_deg = [-60, 60]\nrange_m = [0.1, 0.5]\n[sweep]\n"
        '"scenario.array" = [ { kind = "custom", file = "plane.csv", origin = "center", broadside = "+z", label = "p" }'
        ', { kind = "ula", elements = 8, spacing_m = 0.1, origin = "center", label = "line" } ]\n'
        '"scenario.snr_db" = [0, 10]\n[[formulation]]\nkind = "grid-refine"\n'
    )
    text = printed(tmp_path / "study.toml")
    assert text.count("elements") == 2 and "array = p" in text and "array = line" in text
    assert "snr_db" not in text
    assert show(tmp_path / "study.toml", "--unit", "mm").exit_code != 0


@pytest.mark.parametrize("suffix", ["svg", "png", "pdf"])
def test_the_drawing_is_written(tmp_path, plane, suffix):
    out = tmp_path / f"picture.{suffix}"
    assert f"Drawn in {out}" in printed(plane, "--broadside", "+z", "--out", out)
    start = {"svg": b"<?xml", "png": b"\x89PNG", "pdf": b"%PDF"}[suffix]
    assert out.read_bytes().startswith(start) and out.stat().st_size > 5000


def test_the_drawing_shows_the_planes_in_which_the_array_extends():
    from nfbench.figures.array import array_figure

    def drawn(positions, **axes):
        figure = array_figure(survey(Custom(origin="center", positions=positions, **axes)))
        return {(ax.get_xlabel(), ax.get_ylabel()): ax for ax in figure.axes}

    assert set(drawn([[0, 0, 0], [1, 0, 0], [0, 0, 1]])) == {("x [m]", "z [m]")}
    assert set(drawn([[0, 0, 0], [1, 0, 0]])) == {("x [m]", "y [m]")}
    cube = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 2]]
    panels = drawn(cube)
    assert set(panels) == {("x [m]", "y [m]"), ("y [m]", "z [m]"), ("x [m]", "z [m]")}
    elements = panels["y [m]", "z [m]"].lines[0]
    np.testing.assert_allclose(elements.get_xydata(), np.array(cube)[:, 1:], atol=1e-12)


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["nothing.csv"], "file: no such file: nothing.csv"),
        (["ulla"], "kind: unknown kind 'ulla'; did you mean \"ula\""),
        (
            ["ula", "--option", "elements=8", "--option", "spacing_wavelengths=0.5"],
            "--wavelength-m: is required, or --freq",
        ),
        (
            ["ula", "--option", "elements=8", "--option", "spacing_m=0.5", "--frequency-hz", "5"],
            "--speed: is required with",
        ),
        (["ula", "--option", "elements=8"], "spacing_wavelengths: expected either"),
        (["PLANE", "--unit", "m"], 'expected unit = "mm" as in the header of column x, got "m"'),
        (["PLANE", "--broadside", "front"], "broadside: expected"),
        (["PLANE", "--broadside", "[0, 0"], "broadside: expected"),
        (["PLANE", "--out", "picture.gif"], "expected a file that ends in .svg, .png, .pdf"),
        (["PLANE", "--out", "no/folder/a.svg"], "No such file or directory"),
        (["nothing.toml"], "nothing.toml"),
    ],
)
def test_wrong_input_is_refused_with_a_remedy(plane, arguments, complaint):
    import subprocess
    import sys

    command = [sys.executable, "-m", "nfbench", "show", "array", *arguments]
    done = subprocess.run([str(plane) if part == "PLANE" else part for part in command], capture_output=True, text=True)
    assert done.returncode == 2, (done.stdout, done.stderr)
    assert complaint in done.stderr and "Traceback" not in done.stderr


def test_options_of_an_array_are_refused_for_other_plugins():
    result = CliRunner().invoke(app, ["show", "solver", "de", "--unit", "mm"])
    assert result.exit_code == 2


def test_a_survey_needs_an_array():
    with pytest.raises(OptionError, match="array: is required"):
        NearField.survey({"wavelength_m": 0.1})


@pytest.mark.skipif(not DATA.is_dir(), reason="the measured data are not there")
def test_the_measured_array():
    carrier = ["--frequency-hz", 1000, "--speed", 344.7]
    text = printed(DATA / "miracle" / "positions_m.csv", *carrier, "--broadside", "+z", "--up", "+y")
    assert "0.3447 m" in text and "1.492 m, 4.33 λ" in text and "nfbench:" not in text
