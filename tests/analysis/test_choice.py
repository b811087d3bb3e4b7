"""Tests of the recommendation of a method: its costs by hand, and its promises on simulated studies."""

import math

import numpy as np
import pandas as pd
import pytest

from nfbench.analysis import LIKELY, MEETS, MISSES, Request, answer, cells_of, overview, time_text
from nfbench.analysis.choice import budget_of, judge, price_changes, share_pvalue
from nfbench.core import OptionError

TARGET = "error ≤ 1"


def rows(costs, *, seconds=None, inside=0.5, swept=None, caps=None, objective=None, batches=0.0, batched=0.0):
    """Rows of one target. costs: evaluations to the hit by method, (n,) or (n, r), ∞ without a hit."""
    tables = []
    for method, evaluations in costs.items():
        evaluations = np.asarray(evaluations, dtype=float)
        evaluations = evaluations[:, None] if evaluations.ndim == 1 else evaluations
        n, r = evaluations.shape
        cap = (caps or {}).get(method, 1000.0)
        time_s = evaluations / 1e3 if seconds is None else np.broadcast_to(seconds[method], (n, 1)) + 0 * evaluations
        hit = np.isfinite(evaluations)
        spent = np.full((n, r), cap)
        tables.append(
            pd.DataFrame(
                {
                    "method": method,
                    "scene": np.repeat(np.arange(n), r),
                    "run": np.tile(np.arange(r), n),
                    **(swept or {}),
                    "target": TARGET,
                    "hit": hit.ravel(),
                    "evaluations": evaluations.ravel(),
                    "seconds": np.where(hit, time_s, np.inf).ravel(),
                    "spent": spent.ravel(),
                    "spent_s": np.where(hit, np.nan_to_num(time_s, posinf=0.0), cap / 1e3).ravel(),
                    "cap": cap,
                    "inside_share": inside[method] if isinstance(inside, dict) else inside,
                    "per_evaluation": 1.0,
                    "batches": batches,
                    "batched": batched,
                    "all_evaluations": spent.ravel(),
                    "objective": math.nan if objective is None else np.asarray(objective[method], float).ravel(),
                }
            )
        )
    return pd.concat(tables, ignore_index=True)


def verdict(table, **request):
    return judge(cells_of(table, request.get("parallel", 1)), Request(**request))


def test_a_budget_below_that_of_the_study_counts_the_hits_until_then():
    found = verdict(rows({"a": [100.0] * 6 + [300.0] * 3 + [np.inf]}), evaluations=200, reliability=0.5).frame.iloc[0]
    assert (found["share"], found["budget"]) == (0.6, 100.0)
    assert found["verdict"] == LIKELY
    assert verdict(rows({"a": [100.0] * 6 + [300.0] * 3 + [np.inf]}), reliability=0.9).frame.iloc[0]["budget"] == 300.0


def test_the_users_cost_replaces_that_of_the_evaluations_and_keeps_the_solvers_own_time():
    table = rows({"a": [100.0] * 10, "b": [200.0] * 10}, inside={"a": 0.5, "b": 0.9})
    # a: 0.1 s, half of it its own; b: 0.2 s, 0.02 s its own
    costs = verdict(table, evaluation_cost_s=1e-5, reliability=0.5).frame.set_index("method")["budget"]
    assert costs["a"] == pytest.approx(0.05 + 100e-5) and costs["b"] == pytest.approx(0.02 + 200e-5)
    changes = price_changes(cells_of(table), Request(reliability=0.5))
    assert changes["setting"].tolist() == ["b", "a"]
    assert changes["to_us"].iloc[0] == pytest.approx(1e6 * 0.03 / 100, rel=1e-3)  # 0.05 + 100 C = 0.02 + 200 C


def test_batches_share_parallel_evaluations_and_single_points_do_not():
    alone = rows({"a": [1000.0] * 10}, inside=1.0)
    batched = rows({"a": [1000.0] * 10}, inside=1.0, batches=20.0, batched=1000.0)  # batches of 50
    half = rows({"a": [1000.0] * 10}, inside=1.0, batches=10.0, batched=500.0)
    request = {"evaluation_cost_s": 1e-3, "parallel": 20, "reliability": 0.5}
    budgets = [verdict(table, **request).frame["budget"].iloc[0] for table in (alone, batched, half)]
    assert budgets == pytest.approx([1.0, 20 * 3 * 1e-3, 0.5 + 10 * 3 * 1e-3])


def test_restarts_take_the_run_with_the_best_value_and_cost_all_of_them():
    hits = np.tile([100.0, np.inf, np.inf], (20, 1))
    values = np.tile([0.0, 1.0, 2.0], (20, 1))
    frame = verdict(rows({"a": hits}, objective={"a": values}), evaluations=3000, reliability=0.9).frame
    found = frame.set_index("starts")
    assert found["share"].to_dict() == pytest.approx({1: 1 / 3, 2: 2 / 3, 3: 1.0})
    assert found["budget"][3] == 3000.0 and frame["setting"].iloc[0] == "a, best of 3 runs"
    frame = verdict(rows({"a": hits}, objective={"a": -values}), reliability=0.9).frame
    assert frame["starts"].tolist() == [1], "where the best value is a miss, restarts do not pay"
    tight = verdict(rows({"a": hits}, objective={"a": values}), evaluations=2999, reliability=0.9).frame
    assert 3 not in tight["starts"].tolist()


def test_every_swept_point_must_meet_the_request_and_the_worst_one_is_named():
    good = rows({"a": [10.0] * 100, "b": [20.0] * 100}, swept={"scenario.snr_db": 20.0})
    bad = rows({"a": [10.0] * 80 + [np.inf] * 20, "b": [20.0] * 100}, swept={"scenario.snr_db": 0.0})
    frame = verdict(pd.concat([good, bad]), reliability=0.9).frame.set_index("method")
    assert frame["verdict"].to_dict() == {"b": MEETS, "a": MISSES}
    assert frame["worst"].to_dict() == {"b": "every swept point", "a": "snr_db = 0"}
    assert frame["share"]["a"] == 0.8


def test_nothing_and_too_few_scenes_are_said():
    table = rows({"a": [100.0] * 50, "b": [np.inf] * 50})
    few = answer({TARGET: cells_of(table)}, TARGET, Request(reliability=0.95))
    assert few.recommended == "a" and few.met and not few.sure
    # .95^n ≤ .04 / 2 at n = 77
    assert "As 2 methods are tested at once, that is too few scenes to be sure: about 27 more" in few.sentences[0]
    none = answer({TARGET: cells_of(table)}, TARGET, Request(evaluations=50, reliability=0.95))
    assert none.recommended is None and none.sentences[0].startswith("Nothing in this study reaches")
    assert none.steps["change"].tolist() == ["half the evaluations", "twice the evaluations"]
    assert none.steps["verdict"].tolist() == [MISSES, LIKELY]
    assert none.to_dict()["methods"][0]["budget"] is None
    assert none.sentences[1] == "The same share is reached by b."


def test_methods_without_evaluations_are_compared_in_seconds():
    table = rows({"grid": [0.0] * 80, "de": [500.0] * 80}, seconds={"grid": 2.0, "de": 0.5}, caps={"grid": 0.0})
    found = answer({TARGET: cells_of(table)}, TARGET, Request(reliability=0.5))
    assert found.unit == "s" and found.recommended == "de"
    assert any("no evaluations" in note for note in found.notes)


def test_a_limit_of_evaluations_names_no_method_that_makes_none():
    """Nothing reaches the target often enough, so costs are in evaluations; grid makes none and has the same share."""
    costs = {"de": [400.0] * 45 + [900.0] * 15 + [np.inf] * 20, "grid": [0.0] * 60 + [np.inf] * 20}
    table = rows(costs, caps={"grid": 0.0})
    found = overview({TARGET: cells_of(table)}, TARGET, Request(reliability=0.95))
    assert found.choice.unit == "evaluations"
    assert set(found.ladder["setting"]) == {"de"} and found.solvers.empty


def test_the_share_is_tested_exactly():
    assert share_pvalue(np.ones(59), 0.95) == pytest.approx(0.95**59)
    assert share_pvalue(np.zeros(10), 0.5) == 1.0
    assert share_pvalue(np.array([1.0] * 9 + [0.0]), 0.5) == pytest.approx(11 / 1024)
    assert share_pvalue(np.full(100, 0.99), 0.5) < 1e-3 < share_pvalue(np.full(4, 0.7), 0.5)
    assert budget_of(np.array([[3.0], [1.0], [np.inf], [2.0]]), 0.75) == 3.0


@pytest.mark.parametrize(
    "wrong", [{"evaluations": 0}, {"seconds": math.inf}, {"reliability": 1.0}, {"parallel": 0}, {"confidence": 0.0}]
)
def test_impossible_requests_are_refused(wrong):
    with pytest.raises(OptionError, match=next(iter(wrong))):
        Request(**wrong)


def drawn(rng, reliabilities, scenes, r=1):
    """A study whose methods reach the target with known probabilities, correlated over scenes."""
    hard = rng.random(scenes)
    costs = {}
    for i, each in enumerate(reliabilities):
        own = rng.random((scenes, r))
        mixed = np.where(rng.random(scenes) < 0.5, hard, own[:, 0])[:, None] if r == 1 else own
        costs[f"m{i}"] = np.where(mixed < each, rng.lognormal(5 + 0.02 * i, 0.5, (scenes, r)).clip(1, 1000), np.inf)
    return costs


@pytest.mark.parametrize(
    "case",
    [
        "all just below",
        "one good",
        *(pytest.param(case, marks=pytest.mark.slow) for case in ("two points", "several runs")),
    ],
)
def test_what_is_said_to_meet_the_request_does_so_in_at_least_95_percent_of_studies(case):
    """At a reliability of 0.8: methods just below it must not be called reliable, however many there are."""
    rng = np.random.default_rng(7)
    good = [0.7999] * 20 if case != "one good" else [0.7999] * 19 + [0.97]
    r = 2 if case == "several runs" else 1
    wrong = found = 0
    studies = 60 if case == "several runs" else 200
    for _ in range(studies):
        if case == "two points":
            parts = [rows(drawn(rng, each, 60), swept={"scenario.k": k}) for k, each in ((1, [0.999] * 20), (2, good))]
            table = pd.concat(parts)
        else:
            table = rows(drawn(rng, good, 60, r))
        frame = verdict(table, reliability=0.8).frame
        sure = frame[(frame["verdict"] == MEETS) & (frame["starts"] == 1)]["method"]
        wrong += any(method != "m19" or case != "one good" for method in sure)
        found += "m19" in sure.tolist()
    assert wrong / studies <= 0.05 + 2 * math.sqrt(0.05 * 0.95 / studies)
    if case == "one good":
        assert found / studies > 0.4, "a method that is much better must often be recognized"


def test_equal_methods_stay_in_the_cheapest_set():
    """Each of several equally expensive methods is left out with a probability of at most 1 % altogether."""
    rng = np.random.default_rng(3)
    out = 0
    for _ in range(200):
        costs = {f"m{i}": rng.lognormal(4, 1, 60).clip(1, 1000) for i in range(5)}
        frame = verdict(rows(costs), reliability=0.5).frame
        assert (frame["verdict"] == MEETS).all()
        out += not frame["cheapest"].all()
    assert out <= 6  # at most 1 % of 200, and three standard errors


def test_a_much_cheaper_method_is_alone_in_the_cheapest_set():
    rng = np.random.default_rng(4)
    base = rng.lognormal(3, 1, 60).clip(1, 300)
    found = verdict(rows({"dear": 3 * base, "cheap": base}), reliability=0.5)
    assert found.frame["method"].tolist() == ["cheap", "dear"]
    assert found.frame["cheapest"].tolist() == [True, False] and found.ranked


@pytest.mark.parametrize(
    ("seconds", "nearest", "enough"),
    [(0.01002, "10 ms", "10.1 ms"), (0.01, "10 ms", "10 ms"), (0.0119, "11.9 ms", "11.9 ms"), (0.99951, "1 s", "1 s"),
     (123.4, "123 s", "124 s"), (1.2345e-6, "1.23 µs", "1.24 µs"), (0.0, "0 s", "0 s")],
)  # fmt: skip
def test_a_time_that_suffices_is_rounded_up(seconds, nearest, enough):
    assert (time_text(seconds), time_text(seconds, up=True)) == (nearest, enough)
