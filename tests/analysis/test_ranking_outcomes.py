"""The outcomes that rankings start from: one number per scene and method, from tables of runs and hits."""

import math

import numpy as np
import pandas as pd
import pytest
from test_ranking import INF, point, spread

from nfbench.analysis.outcomes import common, outcomes
from nfbench.analysis.ranking import rank
from nfbench.analysis.sentences import sentences


def tables(rows):
    """Tables of runs and hits from (method, scene, run, status, error, evaluations to the hit)."""
    runs = pd.DataFrame(rows, columns=["method", "scene", "run", "status", "rmse_m", "hit_at"])
    runs["run_id"] = [f"r{i}" for i in range(len(runs))]
    runs["evaluations"], runs["runtime_s"], runs["scenario.snr_db"] = 100, 0.5, 10.0
    hits = pd.DataFrame(
        {
            "run_id": runs["run_id"],
            "target": "rmse_m ≤ 1",
            "number": 0,
            "hit": runs["hit_at"] < INF,
            "evaluations": runs["hit_at"],
            "seconds": runs["hit_at"] / 1000,
            "spent": 100.0,
            "cap": 100.0,
        }
    )
    later = hits.assign(number=1, hit=False, evaluations=INF)
    return runs.drop(columns="hit_at"), pd.concat([later, hits], ignore_index=True)


def test_outcomes_of_runs_and_hits():
    runs, hits = tables(
        [
            ("a", 7, 0, "ok", 0.5, 10.0),
            ("a", 7, 1, "ok", 0.7, 30.0),
            ("a", 7, 2, "failed", math.nan, INF),
            ("a", 9, 0, "timeout", 0.1, INF),  # an estimate of a run that is not ok does not count
            ("a", 9, 1, "ok", math.nan, 20.0),  # no estimate
            ("a", 9, 2, "ok", 0.3, 5.0),
            ("a", 11, 0, "ok", 0.3, 5.0),  # two more runs of this scene are missing
            ("b", 7, 0, "ok", 2.0, INF),
            ("b", 9, 0, "ok", 0.2, 40.0),
            ("b", 11, 0, "ok", 0.2, 40.0),
        ]
    )
    ((swept, found),) = outcomes(runs, hits, "rmse_m", ["scenario.snr_db"], columns=["runtime_s"])
    assert swept == {"scenario.snr_db": 10.0}
    assert found.methods == ("a", "b")
    assert found.scenes == (7, 9)
    assert found.left_out == 1
    assert found.target == "rmse_m ≤ 1"
    assert found.runs.tolist() == [3, 1]
    assert found.error.tolist() == [[0.7, 2.0], [INF, 0.2]]
    assert found.hits.tolist() == [[2, 0], [2, 1]]
    assert found.cost.tolist() == [[30, INF], [20, 40]]
    assert found.spent.tolist() == [[10 + 30 + 100, 100], [100 + 20 + 5, 40]]
    assert found.cap.tolist() == [100, 100]
    assert found.failed.tolist() == [[1, 0], [2, 0]]
    assert found.columns["seconds"].tolist() == [[0.03, INF], [0.02, 0.04]]
    assert found.columns["runtime_s"].tolist() == [[0.5, 0.5], [0.5, 0.5]]
    assert found.ended["failed"].tolist() == [[1, 0], [0, 0]]


def test_outcomes_without_targets_count_estimates():
    runs, hits = tables([("a", 0, 0, "ok", 0.5, 10.0), ("b", 0, 0, "failed", math.nan, INF)])
    ((swept, found),) = outcomes(runs, hits.head(0), "rmse_m", [])
    assert swept == {}
    assert found.hits.tolist() == [[1, 0]]
    assert np.isinf(found.cost).all()


def test_scenes_to_which_the_target_does_not_apply_are_left_out():
    runs, hits = tables([("a", 0, 0, "ok", 0.5, 10.0), ("a", 1, 0, "ok", 0.5, 10.0)])
    ((_, found),) = outcomes(runs, hits[hits["run_id"] == "r0"], "rmse_m", [])
    assert (found.scenes, found.left_out) == ((0,), 1)
    (text,) = sentences(rank([({}, found)]))
    assert text.endswith("1 scene left out: not finished by all methods, or the target does not apply.")


def test_impossible_outcomes_are_refused():
    runs, hits = tables([("a", 0, 0, "ok", -0.5, 10.0)])
    with pytest.raises(ValueError, match=r"rmse_m: expected errors of at least 0, got -0\.5"):
        outcomes(runs, hits, "rmse_m", [])
    with pytest.raises(ValueError, match=r"runs: expected the columns .*; missing: gospa_m"):
        outcomes(runs, hits, "gospa_m", [])
    with pytest.raises(ValueError, match="error: expected numbers or ∞, got NaN"):
        point(np.array([[math.nan, 1.0]]))
    with pytest.raises(ValueError, match="hits: expected 0 to runs per scene, got 2 to 2"):
        point(np.array([[0.5]]), hits=np.array([[2]]))


def test_points_are_compared_on_common_methods_and_scenes():
    first, second = point(spread(5, 3)), point(spread(4, 2))
    (_, a), (_, b) = common([({}, first), ({}, second)])
    assert a.methods == b.methods == ("A", "B")
    assert a.scenes == b.scenes == (0, 1, 2, 3)
    assert a.error.tolist() == first.error[:4, :2].tolist()
    with pytest.raises(ValueError, match="methods: expected some of A, B, got C"):
        second.select(methods=["C"])
