"""Tests that ``choose`` reads a results folder rightly: targets, swept values, the time of evaluations, restarts."""

import json

import numpy as np
import pandas as pd
import pytest
from conftest import nfbench as command

import nfbench
from nfbench import OptionError, load_study
from nfbench.analysis import Target
from nfbench.results.choosing import _about_gaps, _inside_share, target_named
from nfbench.results.results import Results

STUDY = """
name = "choice"
scenes = 12
runs_per_scene = 2
seed = 3
[scenario]
kind = "functions"
function = "rastrigin"
dimension = 2
[sweep]
SWEEP
[targets]
gap = [1.0, 1e-2]
[[formulation]]
kind = "direct"
[[solver]]
kind = "de"
population = 10
[[solver]]
kind = "multistart-lbfgsb"
[budget]
evaluations = 400
"""
KNOWN = (Target("error_in_bounds", 3.0), Target("error", 0.1))


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    def run(sweep):
        folder = tmp_path_factory.mktemp("choice")
        path = folder / "choice.toml"
        path.write_text(STUDY.replace("SWEEP", sweep), encoding="utf-8")
        return nfbench.run(load_study(path), out=folder / "out", jobs=0)

    return run


@pytest.fixture(scope="module")
def swept(results):
    return results("dimension = [2, 3]")


def test_the_share_is_that_of_the_runs_that_hit_within_the_budget(swept):
    hits = swept.hits()
    found = nfbench.choose(swept, evaluations=150, reliability=0.5)
    for row in found.frame[found.frame["starts"] == 1].to_dict("records"):
        own = hits[(hits["method"] == row["method"]) & (hits["number"] == 0)]
        share = (own["hit"] & (own["evaluations"] <= 150)).groupby(own["scenario.dimension"]).mean()
        assert row["share"] == pytest.approx(share.min())
        if share.nunique() > 1:
            assert row["worst"] == f"dimension = {share.idxmin()}"


def test_a_swept_value_and_another_target_can_be_chosen(swept):
    at = nfbench.choose(swept, at={"dimension": 2}, target="gap=0.5", reliability=0.5)
    assert at.target == "gap ≤ 5e-01" and (at.frame["worst"] == "").all()
    assert [change for change in at.steps["change"] if "target" in change] == [
        "target gap ≤ 1e+00",
        "target gap ≤ 1e-02",
    ]
    json.dumps(at.to_dict(), allow_nan=False)
    with pytest.raises(OptionError, match=r"at: expected a swept key \(scenario.dimension\), got 'snr'"):
        nfbench.choose(swept, at={"snr": 2})
    with pytest.raises(OptionError, match=r"one of its swept values \(2, 3\), got 4"):
        nfbench.choose(swept, at={"dimension": 4})


def test_restarts_cost_all_runs_and_count_the_best_value(swept):
    frame = nfbench.choose(swept, target="gap=1", at={"dimension": 3}, reliability=0.01).frame
    twice = frame[(frame["method"] == "direct + de") & (frame["starts"] == 2)]
    hits = swept.hits()
    own = hits[(hits["method"] == "direct + de") & (hits["scenario.dimension"] == 3) & (hits["number"] == 0)]
    either = own.groupby("scene")["hit"].any().mean()
    once = own["hit"].mean()
    assert either > once, "otherwise this study shows nothing"
    assert twice["share"].tolist() == pytest.approx([either])  # the smaller gap is the better value


@pytest.mark.parametrize(
    "kind, formulations, warnings",
    [("gap", ["neef", "nemo", "neef"], 1), ("gap", ["neef", "neef"], 0), ("error", ["neef", "nemo"], 0)],
)
def test_gaps_of_several_formulations_come_with_a_warning(kind, formulations, warnings):
    notes = _about_gaps(Target(kind, 1e-3), pd.DataFrame({"formulation": formulations}))
    assert sum("does not compare neef, nemo with each other" in note for note in notes) == warnings == len(notes)


def test_swept_budgets_are_methods(results):
    found = nfbench.choose(results('"budget.evaluations" = [100, 400]'), reliability=0.5)
    assert "direct + de (evaluations = 100)" in set(found.frame["method"])
    assert not found.frame["worst"].any()


def test_the_users_cost_counts_evaluations_and_the_solvers_own_time(swept):
    runs, hits = swept.runs, swept.hits()
    frame = nfbench.choose(swept, evaluation_cost_us=1000.0, reliability=0.01, at={"dimension": 2}).frame
    own = hits[(hits["method"] == "direct + de") & (hits["scenario.dimension"] == 2) & (hits["number"] == 0)]
    own = own.merge(runs[["run_id", "evaluation_s", "runtime_s"]], on="run_id")
    cost = own["seconds"] * (1 - own["evaluation_s"] / own["runtime_s"]) + own["evaluations"] * 1e-3
    budget = frame.loc[(frame["method"] == "direct + de") & (frame["starts"] == 1), "budget"].iloc[0]
    assert budget == pytest.approx(cost[own["hit"]].min())


def test_the_time_of_evaluations_is_estimated_where_it_is_not_recorded(swept):
    runs = swept.runs
    assert _inside_share(runs, runs["evaluations"].to_numpy(float))[1] == []
    old = runs.drop(columns=["evaluation_s"])
    share, notes = _inside_share(old, old["evaluations"].to_numpy(float))
    assert "fastest method" in notes[0] and ((share > 0) & (share <= 1)).all()
    each = (old["runtime_s"] / old["evaluations"]).groupby([old["scenario.dimension"], old["method"]]).median()
    row = int(np.argmax(old["runtime_s"] / old["evaluations"]))
    fastest = each[old["scenario.dimension"].iloc[row]].min()
    assert share[row] == pytest.approx(fastest * old["evaluations"].iloc[row] / old["runtime_s"].iloc[row])


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (None, KNOWN[0]),
        ("error ≤ 0.1", KNOWN[1]),
        ("error=0.1", KNOWN[1]),
        ("bounds=3", KNOWN[0]),
        ("error ≤ 3 bounds", KNOWN[0]),
        ("error <= 2 bounds", Target("error_in_bounds", 2.0)),
        ("gap = 1e-4", Target("gap", 1e-4)),
        (Target("gap", 0.5), Target("gap", 0.5)),
    ],
)
def test_a_target_is_named_in_several_ways(text, expected):
    assert target_named(text, KNOWN) == expected


@pytest.mark.parametrize("text", ["", "gapp=1", "gap=x", "gap=-1", "bounds"])
def test_what_is_no_target_is_refused(text):
    with pytest.raises(OptionError, match="choose: target: expected"):
        target_named(text, KNOWN)


def test_impossible_values_are_refused_by_name(swept):
    with pytest.raises(OptionError, match="reliability: expected a number between 0 and 1, got 2"):
        nfbench.choose(swept, reliability=2.0)


def test_the_command_prints_the_answer_or_json_and_says_whether_there_is_one(swept, tmp_path):
    folder = str(swept.folder)
    answered = command("choose", folder, "--reliability", "0.3", "--at", "dimension=2", "--json", cwd=tmp_path)
    table = json.loads(answered.stdout)
    assert answered.returncode == 0 and table["recommended"] == table["methods"][0]["setting"]
    nothing = command("choose", folder, "--evaluations", "1", cwd=tmp_path)
    assert nothing.returncode == 1 and nothing.stdout.startswith("Nothing in this study reaches gap ≤ 1e+00")
    wrong = command("choose", folder, "--at", "dimension=9", cwd=tmp_path)
    assert wrong.returncode == 2 and "expected one of its swept values" in wrong.stderr
    assert Results(swept.folder).counts  # nothing was changed
