"""Gaps are measured from proven optima, contradictions are reported, and damaged and old folders are still read."""

import sqlite3

import numpy as np
import pandas as pd
import pytest
from commands import command
from conftest import PLUGINS

import nfbench
from nfbench import load_study
from nfbench.results import export_csv, find_progress, merge
from nfbench.results.references import Proof

MANIFEST = """
name = "proofs"
scenes = 4
seed = 3
plugins = ["{plugin}"]
[scenario]
kind = "bowls"
[sweep]
lift = [0.0, 1.0]
[[formulation]]
kind = "proving"
how = "{how}"
[[solver]]
kind = "random-search"
batch = 10
[[solver]]
kind = "random-search"
batch = 20
[budget]
evaluations = 60
[targets]
gap = [0.01, 0.1]
{extra}
"""
PROOF = "[reference]\ncertificate = true\n"


@pytest.fixture
def studied(tmp_path):
    """A function that runs a study with proofs of this kind, and returns its results."""

    def run(how, extra=PROOF, out="out"):
        path = tmp_path / "proofs.toml"
        path.write_text(MANIFEST.format(plugin=PLUGINS / "proving.py", how=how, extra=extra))
        return nfbench.run(load_study(path), out=tmp_path / out, jobs=0)

    return run


def levels(results):
    """The minimum of each run's problem, from the definition of the scenario."""
    runs = results.runs
    drawn = []
    for seed, lift in zip(runs["instance_seed"], runs["scenario.lift"], strict=True):
        rng = np.random.default_rng(seed)
        rng.uniform(-0.9, 0.9, 2)
        drawn.append(rng.uniform(1.0, 2.0) + lift)
    return np.array(drawn)


def test_gaps_are_measured_from_the_certified_value(studied):
    plain = studied("right", extra="")
    before, hits_before = plain.evidence().table, plain.hits()
    best = before.groupby(["scenario.lift", "scene"])["objective"].transform("min")
    np.testing.assert_allclose(before["gap"], before["objective"] - best)
    assert (before["gap"] == 0).any() and "optimum" not in before
    results = studied("right")
    table = pd.read_csv(results.folder / "runs.csv")
    np.testing.assert_allclose(table["optimum"], levels(results), rtol=1e-12)
    np.testing.assert_allclose(table["gap"], table["objective"] - levels(results), rtol=1e-9, atol=1e-12)
    assert (table["gap"] > 0).all()
    hits = results.hits()
    expected = np.array([table["gap"] <= 0.01, table["gap"] <= 0.1]).T.ravel()
    np.testing.assert_array_equal(hits["hit"], expected)
    assert hits["hit"].sum() < hits_before["hit"].sum()  # the file with the hits of before is not used
    progress = find_progress(results, "gap").frame.groupby("run_id", sort=False)["value"].last()
    np.testing.assert_allclose(progress, table["gap"], atol=1e-12)
    export_csv(results, results.folder / "traces.csv")
    traces = pd.read_csv(results.folder / "traces.csv").groupby("run_id", sort=False)["gap"].last()
    np.testing.assert_allclose(traces, table["gap"], atol=1e-12)
    assert results.evidence().origin_of_gaps() == "proven optimum"
    assert plain.folder == results.folder and "contradicted_by" in results.reference_table()
    assert results.contradictions().empty


def test_an_unfinished_proof_gives_a_value_but_no_proof(studied):
    results = studied("open")
    table = results.evidence().table
    np.testing.assert_allclose(table["gap"], table["objective"] - levels(results), atol=1e-12)
    assert "optimum" not in table and results.evidence().origin_of_gaps() == "best known value"
    assert (results.references["step"] == 2).all() and np.isinf(results.references["gap"]).all()


def test_a_value_that_is_worse_than_the_best_run_is_not_used_without_a_proof(studied):
    results = studied("open")
    with sqlite3.connect(results.folder / "runs.sqlite") as db:
        db.execute("UPDATE reference_optima SET value = value + 5")
    table = results.evidence().table
    assert (table.groupby(["scenario.lift", "scene"])["gap"].min() == 0).all() and results.contradictions().empty


def test_a_better_value_than_a_certified_one_is_an_error_of_the_certificate(studied, monkeypatch, capfd):
    results = studied("wrong")
    table, runs = pd.read_csv(results.folder / "references.csv"), results.runs
    assert len(table) == 8
    for row in table.itertuples():
        same = runs[(runs["scene"] == row.scene) & (runs["scenario.lift"] == row._2)]
        better = same[same["objective"] < row.value - 0.01 - 1e-9 * row.value].sort_values("objective")
        assert row.best_found == same["objective"].min()
        assert row.contradicted_by == "; ".join(better["method"]) and len(better)
    assert (results.evidence().table["gap"].groupby([runs["scene"], runs["scenario.lift"]]).min() == 0).all()
    assert "optimum" not in results.evidence().table
    code, text = command(monkeypatch, capfd, "report", results.folder, patience_s=60)
    row = table.iloc[0]
    assert code == 1 and text.count("wrong certificate") == 8
    first, *others = row["contradicted_by"].split("; ")
    also = ", and 1 other method is below it too" * len(others)
    expected = (
        f"wrong certificate: proving, scene 0, lift = 0.0: the certified optimum is {row['value']:.12g} with a gap of "
        f"at most 0.01, but {first} found {row['best_found']:.12g}{also}"
    )
    assert expected in " ".join(text.split()) and "Proven optima: 0 of 8." in text


def test_run_ends_with_1_at_a_contradiction(studied, monkeypatch, capfd, tmp_path):
    studied("wrong")
    arguments = ("run", tmp_path / "proofs.toml", "--out", tmp_path / "out", "--jobs", 0, "--quiet")
    code, text = command(monkeypatch, capfd, *arguments, patience_s=60)
    assert code == 1 and "wrong certificate × 8: see the column contradicted_by in" in text


def test_runs_that_are_not_ok_can_contradict_and_invalid_ones_cannot(studied):
    results = studied("wrong")
    for status, expected in (("failed", 8), ("invalid", 0)):
        with sqlite3.connect(results.folder / "runs.sqlite") as db:
            db.execute("UPDATE results SET status = ?", [status])
        assert len(results.contradictions()) == expected


@pytest.mark.parametrize(
    ("best", "holds"), [(1.0, True), (2.0, True), (0.9, True), (0.9 - 5e-10, True), (0.9 - 2e-9, False), (0.5, False)]
)
def test_the_gap_and_rounding_are_not_a_contradiction(best, holds):
    assert Proof(1.0, 0.1, True).holds(best) is holds
    assert Proof(1.0, 0.1, True).reference(best) == (1.0 if holds else best)
    large = Proof(1e6, 0.0, True)
    assert large.holds(1e6 - 5e-4) and not large.holds(1e6 - 2e-3)
    assert not Proof(1.0, 0.1, False).holds(best) and Proof(1.0, 0.1, False).reference(best) == min(best, 1.0)


def test_a_folder_of_schema_2_is_read_and_gets_proofs(studied):
    results = studied("right", extra="")
    before = results.runs
    with sqlite3.connect(results.folder / "runs.sqlite") as db:
        for table in ("reference_plan", "reference_optima"):
            db.execute(f"DROP TABLE {table}")
        db.execute("UPDATE meta SET value = '2' WHERE key = 'schema'")
        db.execute("DELETE FROM meta WHERE key = 'reference'")
    assert results.references.empty and results.reference_counts == {} and results.contradictions().empty
    pd.testing.assert_frame_equal(results.runs, before, check_exact=True)
    assert len(results.evidence().references) == 0
    assert len(studied("right").references) == 8
    pd.testing.assert_frame_equal(results.runs, before, check_exact=True)


def test_proofs_are_rescued_from_a_damaged_folder(studied, tmp_path):
    results = studied("right")
    before = results.references
    content = bytearray((results.folder / "runs.sqlite").read_bytes())
    content[:100] = b"\xff" * 100  # the header: SQLite refuses the file
    (results.folder / "runs.sqlite").write_bytes(content)
    warnings = []
    merged = merge([results.folder], tmp_path / "merged", warnings.append)
    assert len(warnings) == 1 and "16 results were read" in warnings[0]
    found = merged.references
    assert len(found) == 8
    pd.testing.assert_frame_equal(found, before, check_exact=True)


@pytest.mark.parametrize(
    "damage",
    [
        "UPDATE reference_optima SET value = 'text'",
        "UPDATE reference_optima SET status = 'proven'",
        "UPDATE reference_optima SET columns = '[1]'",
        "UPDATE reference_optima SET point = '{'",
        "UPDATE reference_optima SET certified = -1",
        "UPDATE reference_optima SET point = '[[1.0]]'",
    ],
)
def test_damaged_proofs_are_a_message(studied, damage, monkeypatch, capfd):
    folder = studied("right").folder
    with sqlite3.connect(folder / "runs.sqlite") as db:
        db.execute(damage)
    with pytest.raises(nfbench.StoreError, match=r"runs\.sqlite is damaged"):
        nfbench.Results(folder).references  # noqa: B018
    code, text = command(monkeypatch, capfd, "report", folder, patience_s=60)
    assert code == 2 and "is damaged" in text and "Traceback" not in text


def test_a_damaged_plan_of_proofs_is_noticed_and_written_again(studied):
    results = studied("right")
    before = results.references
    with sqlite3.connect(results.folder / "runs.sqlite") as db:
        db.execute("UPDATE reference_plan SET swept = '{}'")
    with pytest.raises(nfbench.StoreError, match="has changed since it was written; `nfbench run"):
        results.runs  # noqa: B018
    pd.testing.assert_frame_equal(studied("right").references, before, check_exact=True)


def test_the_note_of_a_figure_says_what_gaps_are_measured_from(studied):
    from nfbench.figures import Drawing, figures, styled

    for how, origin in (("right", "proven optimum"), ("open", "best known value")):
        with styled():
            drawn = dict(figures(studied(how, out=how), Drawing(only=("convergence", "distribution"))))
        for figure in drawn.values():
            texts = [text.get_text() for text in figure.findobj(lambda artist: hasattr(artist, "get_text"))]
            assert any(f"gap to the {origin}" in text.replace("\n", " ") for text in texts), texts
