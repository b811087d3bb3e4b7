"""Every format is read to the numbers that were written, and hostile files give a sentence, never a traceback."""

import io
import os
import pickle
import struct
import zipfile

import numpy as np
import pytest
import scipy.io
from scipy.io import wavfile

from nfbench.problems.near_field.recordings.files import content_hash, read_array
from nfbench.problems.near_field.recordings.points import read_points

RNG = np.random.default_rng(5)
X = RNG.standard_normal((4, 6)) + 1j * RNG.standard_normal((4, 6))


def as_npy(path):
    np.save(path, X)


def as_npz(path):
    np.savez(path, snapshots=X, rate=np.array(3.0))


def as_compressed_npz(path):
    np.savez_compressed(path, snapshots=X)


def as_mat(path):
    scipy.io.savemat(path, {"snapshots": X, "note": "text", "rate": 3.0})


def as_hdf5(path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        file["group/snapshots"] = X
        file["rate"] = 3.0


def as_mat_73(path):
    """As MATLAB writes it: a header of 512 bytes, complex numbers as real and imag, columns first."""
    h5py = pytest.importorskip("h5py")
    pairs = np.zeros(X.T.shape, dtype=[("real", "f8"), ("imag", "f8")])
    pairs["real"], pairs["imag"] = X.T.real, X.T.imag
    with h5py.File(path, "w", userblock_size=512) as file:
        file["snapshots"] = pairs
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(512))


def as_csv(path):
    path.write_text("\n".join(",".join(str(z).strip("()") for z in row) for row in X.tolist()))


def as_csv_in_pairs(path):
    names = ",".join(f"re_{t},im_{t}" for t in range(6))
    rows = [",".join(f"{z.real!r},{z.imag!r}" for z in row) for row in X.tolist()]
    path.write_text("# a recording\n" + "\n".join([names, *rows, ""]))


def as_text_with_i(path):
    path.write_text("\n".join("\t".join(str(z).strip("()").replace("j", "i") for z in row) for row in X.tolist()))


@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("x.npy", as_npy),
        ("x.npz", as_npz),
        ("x.npz", as_compressed_npz),
        ("x.mat", as_mat),
        ("x.h5", as_hdf5),
        ("x.HDF5", as_hdf5),
        ("x.mat", as_mat_73),
        ("x.csv", as_csv),
        ("x.csv", as_csv_in_pairs),
        ("x.tsv", as_text_with_i),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_the_numbers_come_back_as_they_were_written(name, write, tmp_path):
    path = tmp_path / name
    write(path)
    found = read_array(str(path)).array
    np.testing.assert_array_equal(found, X)
    assert found.dtype == np.complex128
    assert not found.flags.writeable


@pytest.mark.parametrize(
    ("kind", "stored", "scale"), [("int16", [[100, -200], [32767, -32768]], 2**15), ("int32", [[5, -(2**31)]], 2**31)]
)
def test_the_samples_of_a_wav_file_are_scaled_to_one(kind, stored, scale, tmp_path):
    path = tmp_path / "x.wav"
    wavfile.write(path, 8000, np.array(stored, dtype=kind))
    found, rate = read_array(str(path))
    np.testing.assert_allclose(found, np.array(stored) / scale, rtol=1e-15)
    assert rate == 8000


def test_the_samples_of_a_wav_file_of_bytes_and_of_floats(tmp_path):
    wavfile.write(tmp_path / "a.wav", 100, np.array([[0, 128], [255, 64]], dtype=np.uint8))
    np.testing.assert_allclose(read_array(str(tmp_path / "a.wav")).array, [[-1, 0], [127 / 128, -0.5]])
    wavfile.write(tmp_path / "b.wav", 100, np.array([[0.25, -3.0]], dtype=np.float32))
    np.testing.assert_allclose(read_array(str(tmp_path / "b.wav")).array, [[0.25, -3.0]])


def test_one_of_several_arrays_is_chosen_by_name_or_by_the_number_of_elements(tmp_path):
    path = str(tmp_path / "x.npz")
    np.savez(path, h=X, other=np.ones((5, 5)))
    np.testing.assert_array_equal(read_array(path, "other").array, np.ones((5, 5)))
    np.testing.assert_array_equal(read_array(path, length=4).array, X)
    with pytest.raises(ValueError, match=r"name it with variable; found: h \(4, 6\), other \(5, 5\)"):
        read_array(path)
    with pytest.raises(ValueError, match=r"variable: expected the name of an array .*h \(4, 6\).*got 'g'"):
        read_array(path, "g")


def test_a_name_makes_no_sense_in_a_file_with_one_array(tmp_path):
    np.save(tmp_path / "x.npy", X)
    with pytest.raises(ValueError, match="variable: a file of this format holds one array"):
        read_array(str(tmp_path / "x.npy"), "h")


class Bomb:
    def __reduce__(self):
        return os.mkdir, ("unpickled",)


def pickled_npy(path):
    with path.open("wb") as file:
        np.lib.format.write_array(file, np.array([Bomb()], dtype=object), allow_pickle=True)


def pickled_npz(path):
    data = io.BytesIO()
    np.lib.format.write_array(data, np.array([Bomb()], dtype=object), allow_pickle=True)
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("h.npy", data.getvalue())


def pickle_named_npy(path):
    path.write_bytes(pickle.dumps(Bomb()))


def truncated_npy(path):
    as_npy(path)
    path.write_bytes(path.read_bytes()[:200])


def promising_npy(path):
    """A header that promises 10^15 numbers."""
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000000,), }"
    header = header.ljust(118) + b"\n"
    path.write_bytes(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header)


def truncated(write):
    def cut(path):
        write(path)
        path.write_bytes(path.read_bytes()[:-40])

    cut.__name__ = f"truncated_{write.__name__}"
    return cut


def truncated_wav(path):
    wavfile.write(path, 8000, np.zeros((50, 2), dtype=np.int16))
    path.write_bytes(path.read_bytes()[:30])


def with_nan(path):
    Z = X.copy()
    Z[2, 3] = np.nan
    np.save(path, Z)


def of_text(path):
    np.save(path, np.array(["a", "b"]))


@pytest.mark.parametrize(
    ("name", "write", "text"),
    [
        ("x.npy", pickled_npy, "x.npy: "),
        ("x.npz", pickled_npz, "found: none"),
        ("x.npy", pickle_named_npy, "damaged or not of this format"),
        ("x.npy", truncated_npy, "x.npy: "),
        ("x.npy", promising_npy, "x.npy: "),
        ("x.npz", truncated(as_npz), "x.npz: "),
        ("x.mat", truncated(as_mat), "x.mat: "),
        ("x.h5", truncated(as_hdf5), "x.h5: "),
        ("x.wav", truncated_wav, "x.wav: "),
        ("x.npy", with_nan, r"expected finite numbers, got \(?nan.* at \[2, 3\]"),
        ("x.npy", of_text, "expected numbers, got <U1"),
        ("x.csv", lambda path: path.write_text("1,2\n3,x\n"), "expected a number in line 2, column 2, got 'x'"),
        ("x.csv", lambda path: path.write_text("1,2\n3\n"), "expected 2 numbers in line 2, as in the first row, got 1"),
        ("x.csv", lambda path: path.write_text(""), "expected a table of numbers, got no lines"),
        ("x.csv", lambda path: path.write_text("a,b\n"), "got a header only"),
        ("x.csv", lambda path: path.write_bytes(b"\xff\xfe\x00"), "x.csv: "),
        ("x.csv", lambda path: path.write_text("re,re\n1,2\n"), "as many columns of real as of imaginary parts"),
        ("x.csv", lambda path: path.write_text("1,inf\n"), r"expected finite numbers, got inf at \[0, 1\]"),
        ("x.docx", as_npy, r"expected a file with the suffix \.npy, .*got \.docx"),
        ("x.npz", lambda path: path.write_bytes(b""), "x.npz: "),
        ("x.mat", lambda path: path.write_bytes(b"MATLAB 5.0 MAT-file".ljust(200)), "x.mat: "),
        ("x.h5", lambda path: path.write_bytes(os.urandom(300)), "x.h5: "),
        ("x.wav", lambda path: path.write_bytes(b"RIFF"), "x.wav: "),
    ],
    ids=lambda value: getattr(value, "__name__", None),
)
def test_a_hostile_file_gives_a_sentence(name, write, text, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    if name.endswith("h5"):
        pytest.importorskip("h5py")
    path = tmp_path / name
    if write is as_npy:
        path.write_bytes(b"x")
    else:
        write(path)
    with pytest.raises(ValueError, match=text):
        read_array(str(path))
    assert not (tmp_path / "unpickled").exists()


def test_a_zip_bomb_is_not_decompressed(tmp_path):
    path = tmp_path / "x.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("h.npy", b"")
    raw = bytearray(path.read_bytes())
    place = raw.rfind(b"PK\x01\x02")
    raw[place + 24 : place + 28] = struct.pack("<I", 0xFFFFFFF0)  # the uncompressed size that the archive states
    path.write_bytes(bytes(raw))
    with pytest.raises(ValueError, match="expected arrays of at most"):
        read_array(str(path))


def test_links_to_other_files_are_not_followed(tmp_path):
    h5py = pytest.importorskip("h5py")
    as_hdf5(tmp_path / "secret.h5")
    with h5py.File(tmp_path / "x.h5", "w") as file:
        file["h"] = h5py.ExternalLink("secret.h5", "/group/snapshots")
    with pytest.raises(ValueError, match="found: none"):
        read_array(str(tmp_path / "x.h5"))


def test_a_changed_file_is_read_again(tmp_path):
    path = tmp_path / "x.npy"
    np.save(path, X)
    first, before = read_array(str(path)).array, content_hash(str(path))
    np.save(path, np.vstack([X, X]))
    assert read_array(str(path)).array.shape == (8, 6)
    assert first.shape == (4, 6)
    assert content_hash(str(path)) != before


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1,2,3\n4,5,6\n", [[1, 2, 3], [4, 5, 6]]),
        ("x_m,z_m\n1,3\n4,6\n", [[1, 0, 3], [4, 0, 6]]),
        ("y [mm]; x [mm]; z [mm]\n1;2;3\n", [[0.002, 0.001, 0.003]]),
    ],
)
def test_points_are_read_with_the_axes_and_units_of_their_header(text, expected, tmp_path):
    path = tmp_path / "p.csv"
    path.write_text(text)
    np.testing.assert_allclose(read_points(str(path)), expected, rtol=1e-15)


def test_points_without_axes_are_refused(tmp_path):
    path = tmp_path / "p.csv"
    path.write_text("1,2\n3,4\n")
    with pytest.raises(ValueError, match=r"p\.csv: expected rows"):
        read_points(str(path))
