"""Files with the positions of elements: every format, layout, unit and name is read to the same values or refused."""

import io
import zipfile

import numpy as np
import pytest
from conftest import PROJECT
from numpy.testing import assert_allclose, assert_array_equal
from scipy.io import savemat

from nfbench import OptionError
from nfbench.core.options import build, canonical
from nfbench.problems.near_field.arrays import Custom, read_positions

DATA = PROJECT / ".." / "shared" / "data"
Q = np.array([[0.0, 0.25, -1.5], [0.125, 0.5, 2.0], [-0.75, 1.0, 0.0], [0.3, -0.2, 0.1]])
ROWS = Q.tolist()
IN_MM = (1000 * Q).tolist()
NAMES = ("M1", "M2", "M3", "M4")


def joined(rows, mark=","):
    return "".join(mark.join(map(str, row)) + "\n" for row in rows)


TEXTS = {  # (text, unit, names)
    "commas": (joined(ROWS), None, None),
    "semicolons": (joined(ROWS, ";"), None, None),
    "tabs": (joined(ROWS, "\t"), None, None),
    "blanks": (joined(ROWS, "   "), None, None),
    "blanks after commas and at the ends": (joined(ROWS, " ,  ").replace("\n", "  \r\n"), None, None),
    "commas at the ends": (joined(ROWS).replace("\n", ",\n"), None, None),
    "decimal commas": (joined(ROWS, ";").replace(".", ","), None, None),
    "byte order mark": ("\ufeff" + joined(ROWS), None, None),
    "comments and empty lines": (f"# an array\n\n{joined(ROWS[:1])}\n# more\n{joined(ROWS[1:])}# end", None, None),
    "comments after the numbers": (joined([[*row, "# reference"] for row in ROWS], " "), None, None),
    "a header": ("x,y,z\n" + joined(ROWS), None, None),
    "a header in another order": ("z,x,y\n" + joined([[row[2], *row[:2]] for row in ROWS]), None, None),
    "units in names": ("x_mm,y_mm,z_mm\n" + joined(IN_MM), None, None),
    "units in brackets": ("X [mm]; Y [mm]; Z [mm]\n" + joined(IN_MM, ";"), None, None),
    "units in parentheses": ("x (mm)\ty (mm)\tz (mm)\n" + joined(IN_MM, "\t"), None, None),
    "units in brackets between blanks": ("x [mm]  y [mm]  z [mm]\n" + joined(IN_MM, "  "), None, None),
    "units after a slash": ("x/mm,y/mm,z/mm\n" + joined(IN_MM), None, None),
    "units spelled out": ("pos_x [millimetres],pos_y [mm],pos_z [mm]\n" + joined(IN_MM), None, None),
    "different units": ("x_mm,y_m,z_cm\n" + joined([[1000 * x, y, 100 * z] for x, y, z in ROWS]), None, None),
    "a header as a comment": ("# x_mm y_mm z_mm\n" + joined(IN_MM, " "), None, None),
    "millimetres by option": (joined(IN_MM), "mm", None),
    "millimetres by both": ("x_mm,y_mm,z_mm\n" + joined(IN_MM), "mm", None),
    "a column of names": ("mic,x,y,z\n" + joined([[n, *r] for n, r in zip(NAMES, ROWS, strict=True)]), None, NAMES),
    "names at the end": ("x,y,z,Name\n" + joined([[*r, n] for n, r in zip(NAMES, ROWS, strict=True)]), None, NAMES),
    "names in quotation marks": (joined([[f'"{n}"', *r] for n, r in zip(NAMES, ROWS, strict=True)]), None, NAMES),
    "names without a header": (joined([[n, *r] for n, r in zip(NAMES, ROWS, strict=True)], " "), None, NAMES),
    "numbers as names": (joined([[i + 1, *row] for i, row in enumerate(ROWS)]), None, ("1", "2", "3", "4")),
    "three rows": (joined(Q.T.tolist()), None, None),
}


@pytest.mark.parametrize("name", TEXTS)
@pytest.mark.parametrize("suffix", ["csv", "txt"])
def test_text_is_read_in_every_layout(tmp_path, name, suffix):
    text, unit, names = TEXTS[name]
    path = tmp_path / f"array.{suffix}"
    path.write_text(text, encoding="utf-8")
    found, found_names = read_positions(path, unit)
    assert_array_equal(found, Q)  # to the last bit: 250 mm are 0.25 m
    assert found_names == names


def test_columns_that_are_no_coordinates_and_no_names_are_ignored(tmp_path):
    path = tmp_path / "array.csv"
    path.write_text("gain,x,y,channel,z\n" + joined([[9, r[0], r[1], i, r[2]] for i, r in enumerate(ROWS)]))
    found, names = read_positions(path)
    assert_array_equal(found, Q)
    assert names == ("0", "1", "2", "3")


@pytest.mark.parametrize(("header", "axes"), [("x_m,z_m", (0, 2)), ("y,x", (1, 0)), ("z [m]", (2,))])
def test_coordinates_that_the_header_leaves_out_are_0(tmp_path, header, axes):
    path = tmp_path / "array.csv"
    path.write_text(f"{header}\n" + joined(Q[:, axes].tolist()))
    expected = np.zeros_like(Q)
    expected[:, axes] = Q[:, axes]
    assert_array_equal(read_positions(path)[0], expected)


@pytest.mark.parametrize(
    ("unit", "one"),
    [("m", 1.0), ("dm", 0.1), ("cm", 0.01), ("mm", 1e-3), ("um", 1e-6), ("km", 1e3), ("in", 0.0254), ("ft", 0.3048)],
)
def test_units(tmp_path, unit, one):
    path = tmp_path / "array.npy"
    np.save(path, Q)
    assert_allclose(read_positions(path, unit)[0], Q * one, rtol=1e-15)
    path = tmp_path / "array.csv"
    path.write_text(f"x_{unit},y_{unit},z_{unit}\n" + joined(ROWS))
    assert_allclose(read_positions(path)[0], Q * one, rtol=1e-15)
    assert_allclose(Custom(origin="first", positions=ROWS, unit=unit).positions, Q * one, rtol=1e-15)


@pytest.mark.parametrize("transposed", [False, True])
@pytest.mark.parametrize("dtype", [np.float64, np.float32, np.int16])
def test_binary_formats_agree(tmp_path, transposed, dtype):
    values = np.round(8 * Q).astype(dtype)
    stored = values.T if transposed else values
    np.save(tmp_path / "a.npy", stored)
    np.savez(tmp_path / "b.npz", positions=stored, rate=np.float64(48000.0))
    np.savez_compressed(tmp_path / "c.npz", xyz=np.asfortranarray(stored), names=np.array(NAMES))
    savemat(tmp_path / "d.mat", {"mics": stored, "fs": 48000.0, "title": "an array"})
    for file, names in (("a.npy", None), ("b.npz", None), ("c.npz", NAMES), ("d.mat", None)):
        found, found_names = read_positions(tmp_path / file)
        assert_array_equal(found, values.astype(np.float64), err_msg=file)
        assert found_names == names


def test_hdf5_and_matlab_7_3(tmp_path):
    h5py = pytest.importorskip("h5py", reason="the optional library h5py")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["geometry/positions"] = Q
        file["rate"] = 48000.0
    assert_array_equal(read_positions(tmp_path / "a.h5")[0], Q)
    with h5py.File(tmp_path / "b.mat", "w", userblock_size=512) as file:
        file["mics"] = np.eye(3)[:, [1, 2, 0]] + np.arange(3)  # as MATLAB stores the transposed array
    with (tmp_path / "b.mat").open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    assert_array_equal(read_positions(tmp_path / "b.mat")[0], (np.eye(3)[:, [1, 2, 0]] + np.arange(3)).T)


def test_the_variable_is_chosen_by_name_where_several_fit(tmp_path):
    arrays = {"mics": Q, "speakers": Q + 1, "fs": np.float64(48000.0)}
    np.savez(tmp_path / "a.npz", **arrays)
    savemat(tmp_path / "a.mat", arrays)
    for file in ("a.npz", "a.mat"):
        path = tmp_path / file
        assert_array_equal(read_positions(path, variable="speakers")[0], Q + 1)
        with pytest.raises(ValueError, match=r"found 2; set variable to the name of the positions: .*mics 4×3, speak"):
            read_positions(path)
        with pytest.raises(ValueError, match=r"it has no variable 'mic'; known: .*mics 4×3"):
            read_positions(path, variable="mic")
        with pytest.raises(ValueError, match=r"expected real numbers of shape \(M, 3\) or \(3, M\) in fs"):
            read_positions(path, variable="fs")


def test_an_array_of_three_elements_has_one_row_per_element(tmp_path):
    square = np.arange(9.0).reshape(3, 3)
    np.save(tmp_path / "a.npy", square)
    (tmp_path / "a.csv").write_text(joined(square.tolist()))
    for file in ("a.npy", "a.csv"):
        assert_array_equal(read_positions(tmp_path / file)[0], square)


@pytest.mark.parametrize(
    ("text", "unit", "complaint"),
    [
        ("x_mm,y_mm,z_mm\n0,0,0\n0,1,0\n", "m", 'expected unit = "mm" as in the header of column x, got "m"'),
        ("x_mm,y,z\n0,0,0\n0,1,0\n", None, "units of some coordinates, but not of y, z"),
        ("x [furlong],y,z\n0,0,0\n0,1,0\n", None, "unknown unit 'furlong' of x; known: m, dm"),
        ("x,y,x\n0,0,0\n0,1,0\n", None, "names coordinate x twice"),
        ("a,b,c\n0,0,0\n0,1,0\n", None, "the header names no coordinate x, y or z"),
        ("x,y,z\n0,0,0\n0,one,0\n", None, "line 3: expected a number, got 'one'"),
        ("x,y,z\n0,0,0\n\n0,1\n", None, "line 4: expected 3 columns as in the lines before, got 2"),
        ("x,y,z\n", None, "expected at least 2 rows"),
        ("0,0\n0,1\n", None, "use a text file whose first line names them, such as x_m,y_m"),
        ("0,0,0,0,0\n0,1,0,0,0\n", None, r"got an array of shape \(2, 5\)"),
        ("name,x,y,z\na,0,0,0\na,0,1,0\n", None, "expected a different name for each element, got 'a' twice"),
        ("name,x,y,z\na,0,0,0\n,0,1,0\n", None, "expected names of 1 to 100 printable characters, got ''"),
        ("x_mm,y_mm,z_mm\n0,0,0\n0,inf,0\n", None, "expected finite positions, got .*inf.* in row 1"),
        ('"0,0,0\n0,1,0\n0,2,0\n', None, "expected rows of coordinates, but reading it failed"),
        ("\0\0\0", None, "expected"),
    ],
)
def test_text_that_is_no_table_of_positions_is_refused_with_the_reason(tmp_path, text, unit, complaint):
    path = tmp_path / "array.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=complaint) as caught:
        read_positions(path, unit)
    assert "array.csv" in str(caught.value)


def hostile(folder):
    """Write files that are not what their names say."""
    pickled = io.BytesIO()
    np.save(pickled, np.array([[0, 0, 0], [0, 1, 0]], dtype=object), allow_pickle=True)
    good = io.BytesIO()
    np.save(good, Q)
    promised = io.BytesIO()
    np.lib.format.write_array_header_1_0(promised, {"descr": "<f8", "fortran_order": False, "shape": (90_000, 3)})
    savemat(folder / "good.mat", {"q": Q})
    mat = (folder / "good.mat").read_bytes()
    contents = {
        "pickle.npy": pickled.getvalue(),
        "truncated.npy": good.getvalue()[:-8],
        "promise.npy": promised.getvalue() + b"\0" * 48,
        "text.npy": b"0,0,0\n0,1,0\n",
        "empty.npy": b"",
        "empty.npz": b"",
        "text.mat": b"0,0,0\n0,1,0\n",
        "empty.mat": b"",
        "truncated.mat": mat[: len(mat) // 2],
        "text.h5": b"0,0,0\n",
        "binary.csv": bytes(range(256)),
        "array.xlsx": b"PK",
    }
    for name, content in contents.items():
        (folder / name).write_bytes(content)
    for name, inner in (("pickle.npz", pickled), ("truncated.npz", promised)):
        with zipfile.ZipFile(folder / name, "w") as archive:
            archive.writestr("q.npy", inner.getvalue())
    with zipfile.ZipFile(folder / "bomb.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("q.npy", good.getvalue())
        archive.writestr("zeros.npy", b"\0" * (2**26 + 1))
    np.savez(folder / "complex.npz", q=Q * 1j)
    return [*contents, "pickle.npz", "truncated.npz", "bomb.npz", "complex.npz"]


def test_damaged_and_hostile_files_are_refused_with_their_name(tmp_path):
    for name in hostile(tmp_path):
        with pytest.raises(ValueError, match="expected") as caught:
            read_positions(tmp_path / name)
        assert name in str(caught.value)
        assert len(str(caught.value)) < 1000


def test_an_array_is_what_its_file_contains(tmp_path):
    path = tmp_path / "array.csv"
    path.write_text("mic,x_mm,y_mm,z_mm\n" + joined([[n, *r] for n, r in zip(NAMES, IN_MM, strict=True)]))
    array = build(Custom, {"origin": "center", "file": str(path), "unit": "mm"})
    assert array == Custom(origin="center", positions=ROWS, names=NAMES)
    assert array.element_names == NAMES
    assert (array.unit, array.file, array.variable) == (None, None, None)
    assert build(Custom, {k: v for k, v in canonical(array).items() if k != "kind"}) == array  # as in a worker
    assert Custom(origin="center", positions=ROWS).element_names == ("0", "1", "2", "3")


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ({"positions": ROWS, "names": ["a", "b"]}, "names: expected 4 names, one per element, got 2"),
        ({"positions": ROWS, "names": ["a", "b", "c", "a"]}, "got 'a' twice"),
        ({"positions": ROWS, "unit": "parsec"}, "unit: .*got 'parsec'"),
        ({"positions": ROWS, "variable": "q"}, "variable: expected none without a file, got 'q'"),
    ],
)
def test_invalid_options_of_positions_are_refused(options, complaint):
    with pytest.raises(OptionError, match=complaint):
        build(Custom, {"origin": "center", **options})


@pytest.mark.skipif(not DATA.is_dir(), reason="the measured data are not there")
def test_the_files_of_the_measured_data():
    Q, names = read_positions(DATA / "miracle" / "positions_m.csv")
    assert Q.shape == (64, 3) and names is None
    assert_allclose(Q[0], [0.171669218, 0.017056542, 0.0], rtol=0, atol=0)
    Q, _ = read_positions(DATA / "rs-mnmf" / "positions_m.csv")
    assert_allclose(Q, [[0, 0, 0.03 * m] for m in range(32)], atol=1e-12)
