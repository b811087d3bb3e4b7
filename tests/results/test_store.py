"""The store survives damaged files, full disks, old schemas and concurrent readers."""

import sqlite3
import subprocess
import sys

import pytest
from conftest import BASIC

import nfbench
from nfbench import StoreError, load_study
from nfbench.results import Results
from nfbench.results.folder import network_file_system
from nfbench.results.store import Store
from nfbench.study.records import RunRecord


@pytest.fixture
def folder(manifest, tmp_path):
    nfbench.run(load_study(manifest(BASIC)), out=tmp_path / "out", jobs=0)
    return tmp_path / "out"


def test_a_closed_folder_is_one_database_file(folder):
    assert {path.name for path in folder.iterdir()} - {".lock"} == {
        "runs.sqlite", "runs.csv", "summary.csv", "targets.csv", "ranking.csv", "hits.npz", "manifest.toml",
        "environment.json", "study.log",
    }  # fmt: skip


def test_a_file_of_schema_1_is_migrated(folder, manifest):
    before = nfbench.Results(folder).runs
    with sqlite3.connect(folder / "runs.sqlite") as db:
        db.execute("ALTER TABLE results DROP COLUMN finished")
        db.execute("UPDATE meta SET value = '1' WHERE key = 'schema'")
    with pytest.raises(StoreError, match="expected schema 2 to 4, found 1; `nfbench run` can update it"):
        nfbench.Results(folder).runs  # noqa: B018
    results = nfbench.run(load_study(manifest(BASIC, repetitions=4)), out=folder, jobs=0)
    assert results.runs.head(3).equals(before) and len(results.runs) == 4
    assert results.origins.finished.notna().tolist() == [False, False, False, True]


def test_a_file_of_a_newer_nfbench_is_refused(folder, manifest):
    with sqlite3.connect(folder / "runs.sqlite") as db:
        db.execute("UPDATE meta SET value = '99' WHERE key = 'schema'")
    with pytest.raises(StoreError, match="found 99; a newer nfbench wrote it"):
        nfbench.run(load_study(manifest(BASIC)), out=folder, jobs=0)


def test_a_damaged_file_is_an_error_and_is_not_changed(folder, manifest):
    path = folder / "runs.sqlite"
    content = bytearray(path.read_bytes())
    content[4096:8192] = b"\xff" * 4096
    path.write_bytes(content)
    with pytest.raises(StoreError, match=r"runs\.sqlite.*(damaged|malformed)"):
        nfbench.run(load_study(manifest(BASIC, repetitions=9)), out=folder, jobs=0)
    assert path.read_bytes() == content


def test_a_full_disk_is_an_error_and_finished_rows_are_kept(folder, manifest):
    study = load_study(manifest(BASIC, repetitions=50))
    with Store(folder, write=True) as store:
        store.begin(study)
        pages = store._db.execute("PRAGMA page_count").fetchone()[0]
        store._db.execute(f"PRAGMA max_page_count = {pages + 1}")  # SQLite then reports a full disk
        with pytest.raises(StoreError, match="database or disk is full; rows written earlier are kept"):
            store.add([RunRecord(spec.run_id, nfbench.Status.OK, "x" * 5000) for spec in study.specs()])
        assert store.counts() == {"ok": 3, "open": 47}
    assert nfbench.Results(folder).counts == {"ok": 3, "open": 47}


def test_tables_that_cannot_be_written_are_an_error_and_no_row_is_lost(folder, manifest):
    (folder / "summary.csv").unlink()
    (folder / "summary.csv" / "in the way").mkdir(parents=True)
    with pytest.raises(StoreError, match=r"summary\.csv: .*; finished rows are kept in runs\.sqlite"):
        nfbench.run(load_study(manifest(BASIC, repetitions=5)), out=folder, jobs=0)
    assert nfbench.Results(folder).counts == {"ok": 5}


def test_readers_work_while_another_process_writes(folder, manifest):
    with Store(folder, write=True) as store:
        store.begin(load_study(manifest(BASIC, repetitions=6)))
        code = f"import nfbench, pathlib; print(nfbench.Results(pathlib.Path({str(folder)!r})).counts)"
        output = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
        assert output.strip() == "{'ok': 3, 'open': 3}"


def test_a_network_file_system_is_recognized_and_written_without_wal(folder, manifest, monkeypatch, tmp_path):
    assert network_file_system(tmp_path) is None
    mounts = tmp_path / "mounts"
    mounts.write_text(f"a / ext4 rw 0 0\nserver:/x {tmp_path} nfs4 rw 0 0\n")
    monkeypatch.setattr("nfbench.results.folder.MOUNTS", mounts)
    assert network_file_system(folder) == "nfs4"
    with Store(folder, write=True) as store:
        assert store._db.execute("PRAGMA journal_mode").fetchone() == ("delete",)
    nfbench.run(load_study(manifest(BASIC, repetitions=4)), out=folder, jobs=0)
    assert "network file system (nfs4)" in (folder / "study.log").read_text()


def test_infinite_scores_are_stored_and_score_columns_are_sorted(folder):
    with Store(folder, write=True) as store:
        first = next(store.runs())[0]
        store.add([RunRecord(first, nfbench.Status.OK, scores={"rmse_m": 0.1, "ratio": float("inf"), "error_10_m": 1.0,
                                                               "error_2_m": 2.0})])  # fmt: skip
    runs = Results(folder).runs
    assert runs.ratio[0] == float("inf") and runs.rmse_m[0] == 0.1
    assert [name for name in runs.columns if name.startswith("error")] == ["error_1_m", "error_2_m", "error_10_m"]


def test_tables_that_lack_rows_are_written_by_the_next_run(folder, manifest):
    study = load_study(manifest(BASIC))
    whole = (folder / "runs.csv").read_text()
    with Store(folder, write=True) as store:
        assert store.tabled()
        store.forget(["ok"])
        store.add([RunRecord(spec.run_id, nfbench.Status.OK, evaluations=7) for spec in list(study.specs())[:2]])
        assert not store.tabled()
        store.add([RunRecord(spec.run_id, nfbench.Status.OK, evaluations=7) for spec in study.specs()])
        store._db.execute("UPDATE meta SET value = '2' WHERE key = 'tabled'")  # as if killed before the last table
        store._db.commit()
    nfbench.run(study, out=folder, jobs=0)
    assert (folder / "runs.csv").read_text() != whole and (nfbench.Results(folder).runs.evaluations == 7).all()


def test_a_folder_that_cannot_be_written_is_an_error(folder, manifest, monkeypatch):
    def refuse(*arguments, **options):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("nfbench.results.folder.FileLock.acquire", refuse)
    with pytest.raises(StoreError, match="cannot be written: Permission denied"):
        nfbench.run(load_study(manifest(BASIC, repetitions=9)), out=folder, jobs=0)
