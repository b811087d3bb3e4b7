"""Targets are what the manifest says, and their table has the values of the reference and of a direct count."""

import math

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nfbench.analysis.targets import (
    Target,
    default_targets,
    first_reached,
    parse_targets,
    quantile,
    reached_for_good,
    target_table,
)

CAP = 10_000
EVALUATIONS = [1000, 2000, 1500, CAP, 3000, 2500, CAP, 800, 1200, 4000]  # STATISTICS.md §9; scenes 4 and 7 missed


def hits_frame(evaluations, hit, *, cap=CAP, method="a", target="gap ≤ 1e-02", seconds=None, run=0, scene=None):
    """Hits of one method, one row per scene; ``evaluations`` are those spent until the hit or the end."""
    spent, hit = np.array(evaluations, dtype=float), np.array(hit, dtype=bool)
    seconds = spent / 1000 if seconds is None else np.array(seconds)
    return pd.DataFrame(
        {
            "run_id": [f"{method}{i}-{run}" for i in range(len(spent))],
            "method": method,
            "scene": np.arange(len(spent)) if scene is None else scene,
            "run": run,
            "target": target,
            "number": 0,
            "hit": hit,
            "evaluations": np.where(hit, spent, np.inf),
            "seconds": np.where(hit, seconds, np.inf),
            "evaluation_equivalents": np.where(hit, spent, np.inf),
            "spent": np.where(hit, cap, spent),
            "spent_s": np.where(hit, seconds.max(), seconds),
            "cap": float(cap),
        }
    )


REFERENCE = hits_frame(EVALUATIONS, np.array(EVALUATIONS) < CAP)


@pytest.mark.parametrize(
    ("target", "label"),
    [
        (Target("gap", 1e-4), "gap ≤ 1e-04"),
        (Target("gap", 1.5e-4), "gap ≤ 1.5e-04"),
        (Target("gap", 20), "gap ≤ 2e+01"),
        (Target("error", 0.1), "error ≤ 0.1"),
        (Target("error", 1e-6), "error ≤ 1e-06"),
        (Target("error_in_bounds", 3), "error ≤ 3 bounds"),
        (Target("error_in_bounds", 1), "error ≤ 1 bound"),
        (Target("error_in_bounds", 2.5), "error ≤ 2.5 bounds"),
    ],
)
def test_the_label_states_the_value_exactly(target, label):
    assert target.label == label


@given(st.floats(1e-300, 1e300), st.floats(1e-300, 1e300), st.sampled_from(["gap", "error", "error_in_bounds"]))
def test_different_targets_have_different_labels(a, b, kind):
    assert (Target(kind, a).label == Target(kind, b).label) == (a == b)


@pytest.mark.parametrize("value", [0, -1.0, math.inf, math.nan, True, "3"])
def test_impossible_values_are_refused(value):
    with pytest.raises(ValueError, match="gap: expected a finite number above 0, got"):
        Target("gap", value)


def test_the_table_of_a_manifest_keeps_its_order():
    found = parse_targets({"error_in_bounds": [10, 3], "gap": 1e-4})
    assert found == (Target("error_in_bounds", 10), Target("error_in_bounds", 3), Target("gap", 1e-4))
    with pytest.raises(ValueError, match="expected the keys gap, error, error_in_bounds, got 'gaps'"):
        parse_targets({"gaps": [1]})
    with pytest.raises(ValueError, match=r"targets\.gap: expected different values, got 1\.0 twice"):
        parse_targets({"gap": [1, 1.0]})


def test_the_defaults_fit_the_scenario():
    assert [t.label for t in default_targets("rmse_m", has_bounds=True)] == ["error ≤ 10 bounds", "error ≤ 3 bounds"]
    gaps = ["gap ≤ 1e-02", "gap ≤ 1e-04", "gap ≤ 1e-06"]
    assert [t.label for t in default_targets("gap", has_bounds=False)] == gaps
    found = [t.label for t in default_targets("rmse_m", has_bounds=False, outlier_m=2.0)]
    assert found == ["error ≤ 2", "error ≤ 0.2"]


@given(st.lists(st.floats(0, 1) | st.just(math.inf), max_size=12), st.floats(0, 1))
def test_the_first_row_and_the_row_from_which_on_match_a_search(values, limit):
    array = np.array(values)
    at = [i for i in range(len(values)) if values[i] <= limit]
    for_good = [i for i in range(len(values)) if all(v <= limit for v in values[i:])]
    assert first_reached(array, limit) == (at[0] if at else None)
    assert reached_for_good(array, limit) == (for_good[0] if for_good else None)


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=9), st.sampled_from([0.0, 0.25, 0.5, 0.75, 1.0]))
def test_quantiles_agree_with_numpy_where_all_is_finite(values, q):
    assert quantile(np.array(values), q) == pytest.approx(np.quantile(values, q), rel=1e-12, abs=1e-9)


def test_quantiles_beyond_the_finite_values_are_infinite():
    values = np.array([1.0, 2.0, np.inf, np.inf])
    assert quantile(values, 0.25) == 1.75
    assert quantile(values, 0.5) == np.inf
    assert quantile(np.array([1.0, 2.0, 3.0, np.inf, np.inf]), 0.5) == 3.0
    assert math.isnan(quantile(np.array([]), 0.5))


def test_ert_has_its_reference_value_and_interval():
    (row,) = target_table(REFERENCE).to_dict("records")
    assert row["ert"] == 4500
    assert (row["ert_low"], row["ert_high"]) == pytest.approx((1835, 14596), rel=0.01)
    assert (row["runs"], row["hits"], row["share"]) == (10, 8, 0.8)
    assert (row["share_low"], row["share_high"]) == pytest.approx((0.443905, 0.974789), abs=1e-6)  # Clopper–Pearson
    assert row["ert_s"] == pytest.approx(4.5)
    assert row["median_evaluations"] == 2250  # of 8 hits and 2 misses
    assert (row["q25_evaluations"], row["q75_evaluations"]) == (1275, 3750)
    assert row["median_seconds"] == pytest.approx(2.25)


def test_the_interval_in_seconds_does_not_depend_on_the_unit():
    evaluations = np.array(EVALUATIONS)
    found = []
    for unit in (1e-3, 1e-6):  # a second is far more than a scene takes
        table = target_table(hits_frame(evaluations, evaluations < CAP, seconds=evaluations * unit))
        found.append(table[["ert_s", "ert_s_low", "ert_s_high"]].to_numpy()[0] / unit)
    np.testing.assert_allclose(found[0], found[1], rtol=2e-2)
    np.testing.assert_allclose(found[0], [4500, 1835, 14596], rtol=2e-2)


def test_a_method_that_never_hits_has_an_infinite_ert():
    (row,) = target_table(hits_frame(EVALUATIONS, [False] * 10)).to_dict("records")
    assert row["ert"] == row["ert_high"] == row["median_evaluations"] == np.inf
    assert (row["share"], row["share_low"]) == (0.0, 0.0)
    assert row["share_high"] == pytest.approx(0.308497, abs=1e-6)
    assert 0 < row["ert_low"] < np.inf


def test_a_method_without_evaluations_has_no_ert():
    (row,) = target_table(hits_frame([0] * 6, [True] * 6, cap=0, seconds=[0.5] * 6)).to_dict("records")
    assert math.isnan(row["ert"])
    assert math.isnan(row["ert_low"])
    assert row["ert_s"] == pytest.approx(0.5)


def test_the_interval_of_several_runs_takes_scenes_not_runs():
    """All runs of a scene agree here, so more of them must not narrow any interval."""
    once = target_table(REFERENCE).iloc[0]
    runs = pd.concat([hits_frame(EVALUATIONS, np.array(EVALUATIONS) < CAP, run=run) for run in range(5)])
    five = target_table(runs).iloc[0]
    assert (five["runs"], five["hits"]) == (50, 40)
    assert five["share"] == once["share"]
    assert five["ert"] == once["ert"]
    assert (five["ert_low"], five["ert_high"]) == pytest.approx((once["ert_low"], once["ert_high"]), rel=0.01)
    assert five["share_high"] - five["share_low"] > 0.45
    assert five["share_low"] < 0.8 < five["share_high"]


def test_rows_are_by_point_method_and_target_in_the_order_of_the_runs():
    parts = [
        hits_frame(EVALUATIONS, [True] * 10, method=method, target=target).assign(**{"scenario.snr_db": snr})
        for snr in (20.0, 0.0)
        for method in ("b", "a")
        for target in ("error ≤ 1", "gap ≤ 1e-02")
    ]
    table = target_table(pd.concat(parts, ignore_index=True))
    keys = table[["scenario.snr_db", "method", "target"]].itertuples(index=False, name=None)
    assert list(keys)[:3] == [(20.0, "b", "error ≤ 1"), (20.0, "b", "gap ≤ 1e-02"), (20.0, "a", "error ≤ 1")]
    assert len(table) == 8
    assert (table["runs"] == 10).all()
    assert list(target_table(parts[0], ["method"]).columns[:3]) == ["method", "runs", "hits"]
    with pytest.raises(ValueError, match="groups: expected columns of hits, got nothing"):
        target_table(parts[0], ["nothing"])
