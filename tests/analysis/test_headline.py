"""The two sentences at the top of a report say what the ranking says, and scenes are ordered by their difficulty."""

import numpy as np
import pandas as pd
import pytest

from nfbench.analysis import Outcomes, headline, rank, scene_table


def outcomes(hits, error=None, cost=100.0):
    hits = np.asarray(hits)
    n, k = hits.shape
    error = np.where(hits > 0, 1.0, 10.0) if error is None else np.asarray(error)
    costs = np.where(hits > 0, cost, np.inf)
    spent = np.where(hits > 0, np.minimum(costs, 1000.0), 1000.0)
    names = tuple(f"method {i}" for i in range(k))
    runs, cap = np.ones(k, dtype=int), np.full(k, 1000.0)
    return Outcomes(names, tuple(range(n)), error, runs, hits, costs, spent, cap, target="error ≤ 3 bounds")


def said(each):
    ranking = rank([({}, each)])
    return headline(ranking.blocks[0], ranking.frame)


def test_one_method_that_beats_the_others_is_recommended():
    hits = np.zeros((40, 3), dtype=int)
    hits[:, 1] = 1
    which, sure = said(outcomes(hits))
    assert which == (
        "Use method 1: it reached error ≤ 3 bounds in 100 % of its runs (95 % interval 91 to 100 %) and needs "
        "100 evaluations per hit."
    )
    assert sure == (
        "On 40 scenes, the other 2 methods are significantly less reliable (the risk of any wrong exclusion is at most "
        "5 %)."
    )


def test_the_methods_that_each_stage_excludes_are_counted():
    hits = np.ones((40, 5), dtype=int)
    hits[:, [3, 4]] = 0
    error = np.tile([1.0, 1.0, 5.0, 50.0, 50.0], (40, 1))
    cost = np.tile([100.0, 300.0, 100.0, 100.0, 100.0], (40, 1))
    which, sure = said(outcomes(hits, error, cost))
    assert which.startswith("Use method 0: it reached")
    assert sure.startswith(
        "On 40 scenes, 2 of the other 4 methods are significantly less reliable, 1 less accurate and 1 more expensive ("
    )


def test_methods_that_cannot_be_distinguished_are_named():
    hits = np.ones((40, 3), dtype=int)
    hits[:, 2] = 0
    which, sure = said(outcomes(hits))
    first, other = ("method 0", "method 1") if "method 0" in which else ("method 1", "method 0")
    assert which.startswith(f"Use {first}: it reached")
    assert sure.startswith(f"On 40 scenes, {other} cannot be distinguished from it; the other method is significantly")


def test_without_losers_no_risk_is_stated():
    assert said(outcomes(np.ones((40, 2), dtype=int)))[1].endswith("cannot be distinguished from it.")


def test_too_few_scenes_give_no_recommendation():
    hits = np.ones((3, 2), dtype=int)
    hits[:, 0] = 0
    which, sure = said(outcomes(hits))
    assert which.startswith("No method can be recommended yet: 3 scenes cannot rank 2 methods,")
    assert sure.startswith("So far, method 1 reached error ≤ 3 bounds in 100 % of its runs")


def test_one_method_is_not_compared():
    which, sure = said(outcomes(np.ones((10, 1), dtype=int)))
    assert which.startswith("method 0 reached error ≤ 3 bounds in 100 % of its runs")
    assert sure == "It is the only method, so nothing is compared; 10 scenes."


def test_no_common_scene_ranks_nothing():
    which, _ = said(outcomes(np.ones((0, 2), dtype=int)))
    assert which == "No scene was finished by all 2 methods."


def test_the_hardest_scene_comes_first():
    hits = [[1, 1, 1], [0, 0, 1], [0, 1, 1], [0, 0, 1]]
    error = [[1, 2, 3], [9, 8, 1], [9, 1, 1], [20, 30, 2.0]]
    table = scene_table(outcomes(hits, error))
    expected = pd.DataFrame(
        {
            "scene": [3, 1, 2, 0],
            "share": [1 / 3, 1 / 3, 2 / 3, 1.0],
            "solved_by": [1, 1, 2, 3],
            "median_error": [20.0, 8.0, 1.0, 2.0],
            "best_error": [2.0, 1.0, 1.0, 1.0],
        }
    )
    pd.testing.assert_frame_equal(table, expected, check_dtype=False)
    assert table["share"].tolist() == pytest.approx([1 / 3, 1 / 3, 2 / 3, 1])
