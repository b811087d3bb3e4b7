"""CSV files give back what is in the store, in pandas with its defaults and in spreadsheets."""

import csv
import json

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

import nfbench
from nfbench import Status, Trace, load_study
from nfbench.results import Store, cell, export_csv, from_cell
from nfbench.results.cells import csv_text
from nfbench.study import RunRecord

HOSTILE = [
    *("NA", "N/A", "null", "NULL", "None", "nan", "NaN", "<NA>", "#N/A", "n/a", "-nan", "1.#IND", "True", "false"),
    *("inf", "-inf", "Infinity", "10", "1e5", "0x10", "1,5", "1_000", "٣", " x", "x ", "1/2", "2026-11-26", "10:30 pm"),
    *("MARCH1", "may 3", "3 Jan", "5%", "=1+1", '=HYPERLINK("http://x")', "+1", "-1", "@SUM(A1)", "\t=1", "\r=1", "'x"),
    *(
        '"quoted"',
        '"',
        "[/]",
        "[1",
        "[1]",
        "{",
        '{"a": 1}',
        "a\nb",
        "a\r\nb",
        "a\rb",
        "a,b",
        "a;b",
        "a\x1b[2Jb",
        "a\x00b",
    ),
    *("\ufeffx", "\u2028", "λ/4", "日本", "🛰", "%s", "\\", "\\n", "x" * 500),
]
HARMLESS = [
    "de",
    "2D MUSIC",
    "nemo + de(F=0.5)",
    "May flies",
    "3d",
    "e5",
    "λ/4",
    "ValueError: x, y (f.py:3)",
    "A-1",
    "_x",
]


def decoded(found):
    """A text in a CSV file, as the documentation says that it is to be read."""
    return json.loads(found) if isinstance(found, str) and found.startswith('"') else found


def test_ordinary_text_stays_as_it_is():
    assert [csv_text(text) for text in HARMLESS] == HARMLESS
    assert csv_text("") == "" and csv_text("", is_cell=True) == '""'


@pytest.mark.parametrize("text", HOSTILE)
def test_no_cell_is_a_formula_a_number_a_date_or_nothing(text):
    found = csv_text(text)
    assert decoded(found) == text
    assert found[0] not in "=+-@\t\r\n'" and found.isprintable()


@given(st.text(st.characters(exclude_categories=["Cs"])))
def test_every_text_is_read_back(tmp_path_factory, text):
    path = tmp_path_factory.getbasetemp() / "text.csv"
    pd.DataFrame({"text": [csv_text(text), "x"], "cell": [csv_text(cell(text), True), "x"]}).to_csv(path, index=False)
    found = pd.read_csv(path)
    assert (decoded(found["text"][0]) if text else "") == text
    assert from_cell(found["cell"][0]) == text
    with path.open(encoding="utf-8", newline="") as file:
        assert len(list(csv.reader(file))) == 3


def test_swept_text_lists_and_tables_are_told_apart():
    values = ["[1]", [1], '{"a": 1}', {"a": 1}, '"x"', "x", 1.5, True, "[/]", "[1", ""]
    cells = [cell(value) for value in values]
    assert len(set(map(repr, cells))) == len(values)
    assert [from_cell(found) for found in cells] == values


@pytest.fixture
def hostile(manifest, tmp_path):
    """Results whose messages, labels and swept values are hostile, written to the store as they are."""
    path = manifest(
        '[[formulation]]\nkind = "once"\n[[solver]]\nkind = "sampler"\n[budget]\nevaluations = 1\n'
        "[sweep]\nnoise = [0.0, 0.5]\n",
        repetitions=len(HOSTILE),
    )
    study, folder = load_study(path), tmp_path / "out"
    folder.mkdir()
    trace = Trace(np.array([1]), np.array([0.5]), np.array([2.0]), np.array([[0.25]]))
    with Store(folder, write=True) as store:
        store.begin(study)
        records = [
            RunRecord(spec.run_id, Status.FAILED, HOSTILE[spec.repetition], 1.0, 1, 1.0, 1.0, traces=(trace,))
            for spec in study.specs()
        ]
        store.add(records)
        for ordinal in range(len(study)):
            text = HOSTILE[ordinal // 2]
            swept = json.dumps({"noise": text if ordinal % 2 else [text]})
            store._db.execute("UPDATE plan SET swept = ?, method = ?  WHERE ordinal = ?", [swept, text, ordinal])
        store._db.execute("DELETE FROM meta WHERE key = 'plan_rows'")
        store._db.commit()
    return nfbench.Results(folder)


def test_runs_csv_gives_back_the_store(hostile):
    hostile.write_tables()
    table, runs = pd.read_csv(hostile.folder / "runs.csv"), hostile.runs
    assert list(table.columns) == list(runs.columns) and len(table) == len(runs) == 2 * len(HOSTILE)
    assert table["message"].map(decoded).tolist() == runs["message"].tolist() == [t for t in HOSTILE for _ in "01"]
    assert table["method"].map(decoded).tolist() == runs["method"].tolist()
    swept = [[text] if i == 0 else text for text in HOSTILE for i in (0, 1)]
    assert table["scenario.noise"].map(from_cell).tolist() == swept
    assert runs["scenario.noise"].map(from_cell).tolist() == swept
    for name in ("run_id", "study", "repetition", "status", "objective", "evaluations", "instance_seed"):
        assert table[name].tolist() == runs[name].tolist(), name
    summary = pd.read_csv(hostile.folder / "summary.csv")
    assert summary["method"].map(decoded).tolist() == hostile.summary()["method"].tolist()


def test_traces_csv_gives_back_the_store(hostile):
    export_csv(hostile)
    table = pd.read_csv(hostile.folder / "traces.csv")
    assert table["method"].map(decoded).tolist() == hostile.runs["method"].tolist()
    assert table["scenario.noise"].map(from_cell).tolist() == hostile.runs["scenario.noise"].map(from_cell).tolist()


def test_no_field_of_any_csv_file_starts_a_formula_or_spans_lines(hostile):
    hostile.write_tables(), export_csv(hostile)
    for name in ("runs.csv", "summary.csv", "traces.csv"):
        with (hostile.folder / name).open(encoding="utf-8", newline="") as file:
            lines = file.read().split("\n")
        assert lines.pop() == "" and len(list(csv.reader(lines))) == len(lines), name
        for row in csv.reader(lines[1:]):
            assert not any(field[:1] in ("=", "+", "@", "\t", "\r") for field in row), name


def test_an_undisturbed_study_is_written_as_before(manifest, tmp_path):
    extra = '[[formulation]]\nkind = "once"\n[[solver]]\nkind = "sampler"\n[budget]\nevaluations = 40\n[sweep]\n'
    study = load_study(manifest(extra + 'names = [["a"], ["b", "c"]]\n'))
    results = nfbench.run(study, out=tmp_path / "out", jobs=0)
    plain = results.evidence().table.to_csv(index=False)
    assert (tmp_path / "out" / "runs.csv").read_text() == plain
