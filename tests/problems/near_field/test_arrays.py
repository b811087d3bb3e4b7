"""Antenna arrays: positions, origins, files and validation."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from nfbench import OptionError
from nfbench.core.options import build, canonical
from nfbench.problems.near_field.arrays import UCA, ULA, UPA, Custom

WAVELENGTH = 0.02


def test_ula_runs_along_y_from_its_first_element():
    Q = ULA(elements=128, spacing_wavelengths=0.25, origin="first").place(WAVELENGTH)
    assert_allclose(Q, [[0.0, 0.005 * m, 0.0] for m in range(128)], rtol=0, atol=1e-15)
    assert Q[-1, 1] - Q[0, 1] == pytest.approx(0.635, abs=1e-12)  # the paper's aperture at λ/4


def test_a_centred_ula_is_symmetric():
    Q = ULA(elements=4, spacing_wavelengths=0.5, origin="center").place(WAVELENGTH)
    assert_allclose(Q[:, 1], [-0.015, -0.005, 0.005, 0.015], atol=1e-15)


def test_upa_runs_along_y_first_then_along_z():
    Q = UPA(columns=3, rows=2, spacing_wavelengths=0.5, origin="first").place(WAVELENGTH)
    assert_allclose(Q, [[0, 0.01 * y, 0.01 * z] for z in range(2) for y in range(3)], atol=1e-15)


def test_the_upa_of_the_paper_has_a_diagonal_of_15_spacings_not_16():
    Q = UPA(columns=16, rows=16, spacing_wavelengths=0.5, origin="center").place(WAVELENGTH)
    diagonal = np.linalg.norm(Q[-1] - Q[0])
    assert diagonal == pytest.approx(math.sqrt(2) * 15 * 0.01, abs=1e-12)
    assert diagonal * 16 / 15 == pytest.approx(0.226, abs=5e-4)  # the aperture stated in the paper


def test_uca_lies_on_its_circle_in_the_horizontal_plane():
    Q = UCA(elements=8, radius_wavelengths=3.0, origin="center").place(WAVELENGTH)
    assert_allclose(np.linalg.norm(Q, axis=1), 0.06, rtol=1e-14)
    assert_allclose(Q[[0, 2]], [[0.06, 0, 0], [0, 0.06, 0]], atol=1e-15)
    gaps = np.linalg.norm(Q - np.roll(Q, 1, axis=0), axis=1)
    assert_allclose(gaps, 2 * 0.06 * math.sin(math.pi / 8), rtol=1e-13)


@pytest.mark.parametrize(
    "array",
    [
        ULA(elements=5, spacing_wavelengths=0.3, origin="first"),
        UPA(columns=3, rows=4, spacing_wavelengths=0.3, origin="first"),
        UCA(elements=5, radius_wavelengths=1.0, origin="first"),
        Custom(origin="first", positions=((1.0, 2.0, 3.0), (4.0, 5.0, 7.0), (0.0, 0.5, 0.0))),
    ],
    ids=lambda array: array.kind,
)
def test_the_origin_moves_an_array_without_changing_it(array):
    first, center = array.place(WAVELENGTH), replace(array, origin="center").place(WAVELENGTH)
    assert_allclose(first[0], 0.0, atol=1e-15)
    assert_allclose(center.mean(axis=0), 0.0, atol=1e-15)
    assert_allclose(first - first.mean(axis=0), center, atol=1e-15)


def test_custom_positions_do_not_depend_on_the_wavelength():
    array = Custom(origin="first", positions=((1.0, 2.0, 3.0), (1.5, 2.0, 2.0)))
    assert_allclose(array.place(0.02), [[0, 0, 0], [0.5, 0, -1.0]], atol=1e-15)
    assert_allclose(array.place(0.02), array.place(1.0))


@pytest.mark.parametrize("suffix", ["npy", "csv"])
def test_a_file_is_replaced_by_its_positions(tmp_path, suffix):
    path = tmp_path / f"elements.{suffix}"
    Q = np.array([[0.0, 0.0, 0.0], [0.0, 0.1, 0.2], [1 / 3, 0.2, 0.0]])
    if suffix == "npy":
        np.save(path, Q)
    else:
        path.write_text("".join(f"{x!r}, {y!r}, {z!r}\n" for x, y, z in Q.tolist()))
    array = build(Custom, {"origin": "first", "file": str(path)})
    assert array == Custom(origin="first", positions=tuple(map(tuple, Q.tolist())))
    assert canonical(array, defaults=False) == {"kind": "custom", "origin": "first", "positions": Q.tolist()}
    path.unlink()
    assert replace(array, origin="center").positions == array.positions


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        ("0,0,0\n", r"file elements.csv: expected at least 2 rows of x, y, z, got an array of shape \(1, 3\)"),
        ("", "expected at least 2 rows"),
        ("0,0\n0,1\n", r"shape \(2, 2\)"),
        ("0,0,0\n0,1\n", "expected rows of coordinates"),
        ("a,b,c\n0,0,0\n0,1,0\n", "expected rows of coordinates, but reading it failed: the header names no coord"),
        ("0,0,0\n0,nan,0\n", "expected finite positions, got .*nan.* in row 1"),
        ("0,0,0\n0,1,0\n0,inf,0\n", "expected finite positions, got .*inf.* in row 2"),
        ("0,1,0\n0,2,0\n0,1,0\n", "expected distinct positions"),
    ],
)
def test_an_invalid_file_is_refused_with_the_reason(tmp_path, content, complaint):
    path = tmp_path / "elements.csv"
    path.write_text(content)
    with pytest.raises(OptionError, match=complaint):
        Custom(origin="first", file=str(path))


def test_a_pickle_is_not_loaded(tmp_path):
    path = tmp_path / "elements.npy"
    np.save(path, np.array([[0, 0, 0], [0, 1, 0]], dtype=object), allow_pickle=True)
    with pytest.raises(OptionError, match="expected rows of coordinates"):
        Custom(origin="first", file=str(path))


@pytest.mark.parametrize(
    ("cls", "options", "complaint"),
    [
        (ULA, {"elements": 1, "spacing_wavelengths": 0.5, "origin": "first"}, "elements: .*2.*got 1"),
        (ULA, {"elements": 8, "spacing_wavelengths": 0.5}, "origin: is required"),
        (ULA, {"elements": 8, "spacing_wavelengths": 0.0, "origin": "first"}, "spacing_wavelengths: .*got 0"),
        (ULA, {"elements": 8, "spacing_wavelengths": math.inf, "origin": "first"}, "spacing_wavelengths: .*got inf"),
        (ULA, {"elements": 8, "spacing_wavelengths": 0.5, "origin": "last"}, "origin: .*'last'"),
        (UPA, {"columns": 1, "rows": 1, "spacing_wavelengths": 0.5, "origin": "first"}, "at least 2 elements"),
        (UCA, {"elements": 8, "radius_wavelengths": -1.0, "origin": "center"}, "radius_wavelengths: .*got -1"),
        (Custom, {"origin": "first"}, "either positions or file, got neither"),
        (Custom, {"origin": "first", "file": "no such file.csv"}, "no such file"),
        (Custom, {"origin": "first", "positions": [[0, 0, 0], [0, 0]]}, r"positions\[1\]"),
        (Custom, {"origin": "first", "positions": [[0, 0, 0], [0, 0, 0]]}, "expected distinct positions"),
        (Custom, {"origin": "first", "positions": [[0, 0, 0], [0, math.inf, 0]]}, "finite"),
        (Custom, {"origin": "first", "positions": [[0, 0, 0], [0, math.nan, 0]]}, r"positions\[1\]\[1\]: .*got nan"),
    ],
)
def test_invalid_arrays_are_refused(cls, options, complaint):
    with pytest.raises(OptionError, match=complaint):
        build(cls, options)


def test_positions_and_file_exclude_each_other(tmp_path):
    path = tmp_path / "elements.csv"
    path.write_text("0,0,0\n0,1,0\n")
    with pytest.raises(OptionError, match="got both"):
        Custom(origin="first", positions=((0.0, 0.0, 0.0), (0.0, 1.0, 0.0)), file=str(path))


@pytest.mark.parametrize(
    ("cls", "options", "complaint"),
    [
        (ULA, {"elements": 10**12, "spacing_wavelengths": 0.5, "origin": "first"}, "elements: .*100000, got 10000000"),
        (UCA, {"elements": 10**6, "radius_wavelengths": 0.5, "origin": "first"}, "elements: .*100000, got 1000000"),
        (UPA, {"columns": 10**5, "rows": 10**5, "spacing_wavelengths": 0.5, "origin": "first"}, "at most 100,000 .*"),
        (ULA, {"elements": 8, "spacing_wavelengths": 1e9, "origin": "first"}, "spacing_wavelengths: .*got 1000000000"),
        (Custom, {"origin": "first", "positions": [[0, 0, 0], [1e300, 0, 0]]}, r"within ±1e\+09 m, got 1e\+300 m"),
        (Custom, {"origin": "first", "positions": [[0.0, 0.0, float(i)] for i in range(100_001)]}, "at most 100,000"),
    ],
)
def test_an_array_that_is_too_large_is_refused_before_it_is_placed(cls, options, complaint, monkeypatch):
    monkeypatch.setattr(cls, "place", lambda *_: pytest.fail("placed"))
    with pytest.raises(OptionError, match=complaint):
        build(cls, options)


@pytest.mark.parametrize(
    "array",
    [
        ULA(elements=5, spacing_wavelengths=0.3, origin="first"),
        UPA(columns=3, rows=4, spacing_wavelengths=0.3, origin="first"),
        UCA(elements=5, radius_wavelengths=1.0, origin="first"),
        Custom(origin="first", positions=((1.0, 2.0, 3.0), (4.0, 5.0, 7.0), (0.0, 0.5, 0.0))),
    ],
    ids=lambda array: array.kind,
)
def test_the_number_of_elements_is_known_before_they_are_placed(array):
    assert array.count == len(array.place(WAVELENGTH))


def test_a_file_that_promises_more_than_it_holds_is_refused(tmp_path):
    path = tmp_path / "elements.npy"
    with path.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, {"descr": "<f8", "fortran_order": False, "shape": (10**12, 3)})
        file.write(b"\0" * 48)
    with pytest.raises(OptionError, match=r"file elements.npy: expected rows of coordinates, but reading it failed"):
        Custom(origin="first", file=str(path))


@pytest.mark.parametrize(
    ("values", "complaint"),
    [(np.eye(3) * 1j, "complex128, not real numbers"), (np.zeros((100_001, 3)), "100,001 rows, more than 100,000")],
)
def test_a_file_of_other_numbers_or_too_many_is_refused(tmp_path, values, complaint):
    path = tmp_path / "elements.npy"
    np.save(path, values)
    with pytest.raises(OptionError, match=complaint):
        Custom(origin="first", file=str(path))


def test_a_large_file_is_refused_unread(tmp_path):
    path = tmp_path / "elements.csv"
    with path.open("wb") as file:
        file.truncate(2**40)  # sparse
    with pytest.raises(OptionError, match="it has more than 67,108,864 bytes"):
        Custom(origin="first", file=str(path))
    path.write_text("0,0,0\n" * 100_001)
    with pytest.raises(OptionError, match="it has 100,001 rows, more than 100,000"):
        Custom(origin="first", file=str(path))
