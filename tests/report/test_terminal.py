"""Whatever text a study contains, reports print it as it is, without markup and control characters."""

import io
import json

import numpy as np
import pytest
from conftest import BASIC
from rich.console import Console

import nfbench
from nfbench import Status, load_study
from nfbench.report import print_comparison, print_report, shown
from nfbench.report.terminal import _interval
from nfbench.results import Store, compare
from nfbench.study import RunRecord

HOSTILE = [
    "[/]",
    "[bold]x",
    "[1",
    "[/red",
    "\\[x]",
    "a\x1b[2J\x1b[31mb",
    "a\rb",
    "a\nb",
    "a\x07\x00b",
    "\u202ecba",
    "$x_1$",
]


def printed(show, *arguments):
    console = Console(file=io.StringIO(), width=400, force_terminal=True, color_system=None)
    show(*arguments, console)
    return console.file.getvalue()


@pytest.fixture
def hostile(manifest, tmp_path):
    """A function that returns results in which every text is this one."""

    def results(text, name="out"):
        study, folder = load_study(manifest(BASIC + "[sweep]\nnoise = [0.0, 0.5]\n", repetitions=2)), tmp_path / name
        folder.mkdir()
        with Store(folder, write=True) as store:
            store.begin(study)
            store.add(
                RunRecord(spec.run_id, Status.FAILED if spec.repetition else Status.OK, text, scores={"rmse_m": 1.0})
                for spec in study.specs()
            )
            store._db.execute("UPDATE plan SET method = ?, formulation = ?", [text, text])
            store._db.execute("UPDATE plan SET swept = ? WHERE swept LIKE '%5%'", [json.dumps({"noise": text})])
            store._db.execute("UPDATE meta SET value = ? WHERE key IN ('title', 'expect')", [text])
            store._db.execute("DELETE FROM meta WHERE key = 'plan_rows'")
            store._db.commit()
        return nfbench.Results(folder)

    return results


@pytest.mark.parametrize("text", HOSTILE)
def test_reports_print_hostile_text(text, hostile):
    results = hostile(text)
    output = printed(print_report, results)
    visible = shown(text).plain
    assert output.count(visible) >= 6  # title, expectation, two tables, two verdicts, a swept value and a failure
    assert f"Expected: {visible}" in output and f"failed × 2: {visible}: {visible}" in output
    assert not set(output) & {"\x1b", "\r", "\x07", "\x00", "\u202e"}
    assert results.failures == [("failed", visible, 2, visible)]


@pytest.mark.parametrize("text", HOSTILE)
def test_comparisons_print_hostile_text(text, hostile, tmp_path):
    hostile(text, "a")
    other = hostile(text, "b")
    with Store(other.folder, write=True) as store:
        store._db.execute('UPDATE results SET objective = 7, scores = \'{"rmse_m": "2"}\'')
        store._db.commit()
    output = printed(print_comparison, compare(tmp_path / "a", tmp_path / "b"))
    assert shown(text).plain in output and not set(output) & {"\x1b", "\r", "\x07", "\x00", "\u202e"}


@pytest.mark.parametrize(
    "low, high, text",
    [(0.9996, 1.0004, "≈ 1"), (0.5, 0.75, "0.5 – 0.75"), (0.0, 0.0, "0 – 0"), (np.nan, np.nan, "")],
)
def test_an_interval_of_rounded_ends_that_are_equal_is_one_number(low, high, text):
    assert _interval(low, high) == text
