"""Tests of summaries and verdicts against independent computations of their definitions."""

import numpy as np
import pandas as pd
import pytest

from nfbench.analysis.summary import summarize
from nfbench.analysis.verdicts import verdict


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
    # interval of the mean of 199 squares by the central limit theorem
    spread = 1.96 * np.std(ok**2) / np.sqrt(199)
    assert row["rmse_m_low"] ** 2 == pytest.approx(np.mean(ok**2) - spread, rel=0.1)
    assert row["rmse_m_high"] ** 2 == pytest.approx(np.mean(ok**2) + spread, rel=0.1)


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


def test_the_coverage_of_the_interval_is_close_to_nominal():
    rng = np.random.default_rng(7)
    runs = pd.concat([frame(np.abs(rng.normal(size=60)), method=f"m{i}") for i in range(60)], ignore_index=True)
    summary = summarize(runs)
    covered = ((summary.rmse_m_low <= 1) & (summary.rmse_m_high >= 1)).mean()
    assert 0.8 < covered <= 1


def test_a_single_run_has_no_interval_and_a_failed_run_has_no_error():
    one, none = summarize(frame([0.3])), summarize(frame([np.nan], status="failed"))
    assert np.isnan(one.rmse_m_low[0]) and one.rmse_m[0] == pytest.approx(0.3)
    assert np.isnan(none.rmse_m[0]) and none.failed[0] == 1


def test_by_accepts_any_column_and_reports_an_unknown_one():
    runs = pd.concat([frame([1.0, 2.0]), frame([3.0, 4.0], method="b", solver="t")])
    assert summarize(runs, by=["formulation"]).rmse_m.tolist() == [pytest.approx(np.sqrt(30 / 4))]
    with pytest.raises(ValueError, match="by: expected columns of runs, got colour"):
        summarize(runs, by=["colour"])


def test_the_verdict_ranks_only_significant_differences():
    rng = np.random.default_rng(3)
    base = rng.rayleigh(size=30)
    runs = pd.concat(
        [frame(base, "best"), frame(base * 1.5, "worse"), frame(base * rng.choice([0.9, 1.12], 30), "similar")]
    )
    text = verdict(runs, "rmse_m")
    assert text.startswith("best has the smallest error here") and "not significantly different: similar (" in text
    few = verdict(runs[runs.repetition < 3], "rmse_m")
    assert "3 repetitions are too few to rank methods" in few
    assert "every other method is worse" in verdict(runs[runs.method != "similar"], "rmse_m")
    assert verdict(frame([np.nan], status="failed"), "rmse_m") == "No run ended with an estimate."


def test_the_verdict_compares_gospa_if_sources_were_not_found():
    """A method that finds only the easiest of three sources has the smallest error, but it must not win."""
    all_three = frame(np.full(8, 0.3), "all", sources=3.0, sources_found=3.0, gospa_m=0.5)
    easiest = frame(np.full(8, 0.1), "easiest", sources=3.0, sources_found=1.0, gospa_m=1.1)
    text = verdict(pd.concat([all_three, easiest]), "rmse_m")
    assert text.startswith(
        "Not all runs found the true number of sources, so methods are compared by gospa_m: "
        "all has the smallest error here (0.5"
    )
    same = verdict(pd.concat([all_three, easiest.assign(sources_found=3.0)]), "rmse_m")
    assert same.startswith("easiest has the smallest error")
    nothing = frame(np.full(8, np.nan), "nothing")
    assert verdict(nothing, "rmse_m") == "No run ended with an estimate."


def test_a_method_that_fails_on_hard_instances_is_not_named_best():
    hard = np.repeat([0.1, 10.0], 6)
    fragile = frame(0.3 * hard, "fragile")
    fragile.loc[6:, ["status", "rmse_m"]] = ["failed", np.nan]
    text = verdict(pd.concat([frame(hard, "solid"), fragile]), "rmse_m")
    assert text.startswith("solid has the smallest error here") and "not significantly different: fragile" in text
    rare = frame(hard, "rare")
    rare.loc[3:, ["status", "rmse_m"]] = ["failed", np.nan]
    text = verdict(pd.concat([frame(hard, "solid"), frame(2 * hard, "double"), rare]), "rmse_m")
    worse = "every other method with enough runs is worse by more than 1\u00a0%"
    assert f"{worse}; too few successful runs to compare: rare" in text
    text = verdict(pd.concat([frame(hard, "solid"), rare]), "rmse_m")
    assert "; too few successful runs to compare: rare (" in text and "worse" not in text
