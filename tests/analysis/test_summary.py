"""Tests of summaries against independent computations of their definitions."""

import numpy as np
import pandas as pd
import pytest

from nfbench.analysis.summary import summarize


def frame(errors, method="a", solver="s", status="ok", **more):
    n = len(errors)
    return pd.DataFrame(
        {
            "repetition": range(n),
            "formulation": "f",
            "solver": solver,
            "method": method,
            "status": status,
            "rmse_m": errors,
            "evaluations": 10.0,
            "runtime_s": 0.5,
            **more,
        }
    )


def test_the_columns_match_their_definitions():
    rng = np.random.default_rng(1)
    errors = rng.rayleigh(size=200)
    runs = frame(errors, error_1_m=errors, error_2_m=errors / 2, crb_m=0.1)
    runs.loc[3, ["status", "rmse_m", "error_1_m", "error_2_m"]] = ["failed", np.nan, np.nan, np.nan]
    (row,) = summarize(runs, outlier_m=1.0).to_dict("records")
    ok = np.delete(errors, 3)
    assert (row["runs"], row["failed"]) == (200, 1)
    assert row["rmse_m"] == pytest.approx(np.linalg.norm(ok) / np.sqrt(199), rel=1e-12)
    assert row["median_m"] == pytest.approx(np.sort(ok)[99])
    assert row["q90_m"] == pytest.approx(np.percentile(ok, 90))
    assert row["outlier_rate"] == pytest.approx(((ok > 1).sum() + (ok > 2).sum()) / 398)
    assert row["crb_m"] == pytest.approx(0.1)
    assert np.isnan([row["rmse_m_low"], row["rmse_m_high"]]).all()  # no interval of an RMSE is valid


def test_a_source_that_was_not_found_counts_as_an_outlier():
    """Two runs with three sources, and one run with a single source from another point of the sweep."""
    runs = frame(
        [0.1, np.nan, 2.0],
        error_1_m=[0.1, np.nan, 2.0],
        error_2_m=[np.nan, np.nan, np.nan],
        error_3_m=[0.1, np.nan, np.nan],
        sources=[3.0, 3.0, 1.0],
        sources_found=[2.0, 0.0, 4.0],
        gospa_m=[1.0, 2.0, 3.0],
    )
    (row,) = summarize(runs, outlier_m=1.0).to_dict("records")
    assert row["outlier_rate"] == pytest.approx(5 / 7)  # 1 + 3 sources not found, 1 with an error of 2 m
    assert row["gospa_m"] == pytest.approx(np.sqrt(14 / 3))
    assert row["sources_found"] == pytest.approx(2.0)
    assert row["rmse_m"] == pytest.approx(np.sqrt(4.01 / 2))
    assert summarize(runs[1:2], outlier_m=1.0).outlier_rate[0] == 1


def test_the_interval_of_the_median_counts_failures_as_infinite():
    runs = frame(np.arange(1.0, 11.0))
    (row,) = summarize(runs).to_dict("records")
    assert (row["median_m_low"], row["median_m_high"]) == (2.0, 9.0)
    runs.loc[[0, 1], ["status", "rmse_m"]] = ["failed", np.nan]
    (row,) = summarize(runs).to_dict("records")
    assert (row["median_m_low"], row["median_m_high"]) == (4.0, np.inf)


def test_several_runs_on_a_scene_count_as_one_scene():
    once = frame(np.arange(1.0, 11.0), scene=range(10))
    thrice = pd.concat([frame(np.arange(1.0, 11.0) * factor, scene=range(10)) for factor in (0.5, 1.0, 3.0)])
    names = ["median_m_low", "median_m_high"]
    assert summarize(thrice)[names].values.tolist() == summarize(once)[names].values.tolist() == [[2.0, 9.0]]


def test_a_single_run_has_no_interval_and_a_failed_run_has_no_error():
    one, none = summarize(frame([0.3])), summarize(frame([np.nan], status="failed"))
    assert np.isnan(one.median_m_low[0]) and one.rmse_m[0] == pytest.approx(0.3)
    assert np.isnan(none.rmse_m[0]) and none.failed[0] == 1


def test_by_accepts_any_column_and_reports_an_unknown_one():
    runs = pd.concat([frame([1.0, 2.0]), frame([3.0, 4.0], method="b", solver="t")])
    assert summarize(runs, by=["formulation"]).rmse_m.tolist() == [pytest.approx(np.sqrt(30 / 4))]
    with pytest.raises(ValueError, match="by: expected columns of runs, got colour"):
        summarize(runs, by=["colour"])
