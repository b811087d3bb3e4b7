"""The file with the hits of a folder is used, replaced when it is stale or damaged, and never needed."""

import json

import numpy as np
import pandas as pd
import pytest
from traced_studies import ERRORS, GAPS, NEAR_FIELD, changed, copied, studied

import nfbench
from nfbench.plugins import Registry
from nfbench.results import curves, hits
from nfbench.results.hits import find_hits


@pytest.fixture(scope="module")
def near_field(tmp_path_factory):
    return studied(tmp_path_factory.mktemp("near_field"), NEAR_FIELD)


@pytest.fixture
def counted(monkeypatch):
    """How often the traces were read."""
    calls = []
    monkeypatch.setattr(hits, "Curves", lambda *args: calls.append(1) or curves.Curves(*args))
    return calls


def test_hits_are_found_once(near_field, tmp_path, counted):
    results = copied(near_field, tmp_path)
    first = find_hits(results, ERRORS)
    again = find_hits(results, ERRORS)
    assert len(counted) == 1
    pd.testing.assert_frame_equal(first.frame, again.frame)
    assert first.notes == again.notes
    pd.testing.assert_frame_equal(find_hits(results, ERRORS, cached=False).frame, first.frame)
    assert len(counted) == 2
    find_hits(results, ERRORS[:2])  # other targets
    assert len(counted) == 3


def test_other_runs_make_the_file_stale(near_field, tmp_path, counted):
    results = copied(near_field, tmp_path)
    first = find_hits(results, GAPS).frame
    changed(results, ("UPDATE results SET status = 'failed' WHERE run_id = ?", (first["run_id"][0],)))
    second = find_hits(results, GAPS).frame
    assert len(counted) == 2
    assert not second[second["run_id"] == first["run_id"][0]]["hit"].any()


@pytest.mark.parametrize("damage", ["empty", "cut", "flipped", "pickle", "shape", "folder"])
def test_a_damaged_file_is_ignored_and_replaced(near_field, tmp_path, damage, counted):
    results = copied(near_field, tmp_path)
    good = find_hits(results, GAPS).frame
    path = results.folder / "hits.npz"
    content = path.read_bytes()
    path.unlink()
    if damage == "folder":
        path.mkdir()
    elif damage == "pickle":
        with path.open("wb") as file:
            np.savez(file, head=np.array([{"key": "x"}], dtype=object))
    elif damage == "shape":
        with path.open("wb") as file:
            head = json.dumps({"key": hits._key(results, results.runs, GAPS, "rmse_m"), "notes": [], "reasons": {}})
            arrays = {name: np.zeros((2, 2)) for name in ("evaluations", "seconds", "spent")}
            both = {name: np.zeros((2, 2), dtype=bool) for name in ("kept", "hit")}
            np.savez(file, head=np.frombuffer(head.encode(), dtype=np.uint8), **arrays, **both)
    else:
        middle = len(content) // 2
        flip = bytes(byte ^ 255 for byte in content[middle : middle + 64])  # more than the head of an array
        flipped = content[:middle] + flip + content[middle + 64 :]
        path.write_bytes({"empty": b"", "cut": content[:middle], "flipped": flipped}[damage])
    pd.testing.assert_frame_equal(find_hits(results, GAPS).frame, good)
    assert len(counted) == 2
    pd.testing.assert_frame_equal(find_hits(results, GAPS).frame, good)
    assert len(counted) == (3 if damage == "folder" else 2)


def test_a_folder_that_cannot_be_written_is_read(near_field, tmp_path, monkeypatch):
    results = copied(near_field, tmp_path)

    def refuse(*_, **__):
        raise nfbench.StoreError("read-only")

    monkeypatch.setattr(hits.hit_cache, "write_whole", refuse)
    assert len(find_hits(results, GAPS).frame)
    assert not (results.folder / "hits.npz").exists()


def test_a_plugin_that_becomes_available_makes_the_file_stale(near_field, tmp_path, monkeypatch, counted):
    results = copied(near_field, tmp_path)
    make = Registry.make

    def lacking(self, kind, name, options):
        if name == "neef":
            raise nfbench.PluginError("neef is broken")
        return make(self, kind, name, options)

    with monkeypatch.context() as patched:
        patched.setattr(Registry, "make", lacking)
        without = find_hits(results, ERRORS)
        find_hits(results, ERRORS)
        assert len(counted) == 1
    assert "neef is broken" in without.notes[0]
    assert set(find_hits(results, ERRORS).frame["evaluations"]) != set(without.frame["evaluations"])
    assert len(counted) == 2
