"""Summaries against the definitions, computed another way."""

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


def test_the_columns_are_what_their_names_say():
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
    # the interval of a mean of 199 squares, by the central limit theorem
    spread = 1.96 * np.std(ok**2) / np.sqrt(199)
    assert row["rmse_m_low"] ** 2 == pytest.approx(np.mean(ok**2) - spread, rel=0.1)
    assert row["rmse_m_high"] ** 2 == pytest.approx(np.mean(ok**2) + spread, rel=0.1)


def test_a_source_that_was_missed_is_off():
    """Two runs of three sources and, of another point of the sweep, one of a single one."""
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
    assert row["outlier_rate"] == pytest.approx(5 / 7)  # 1 + 3 missed, 1 off by 2 m
    assert row["gospa_m"] == pytest.approx(np.sqrt(14 / 3))
    assert row["sources_found"] == pytest.approx(2.0)
    assert row["rmse_m"] == pytest.approx(np.sqrt(4.01 / 2))
    assert summarize(runs[1:2], outlier_m=1.0).outlier_rate[0] == 1


def test_the_interval_covers_the_truth_about_as_often_as_it_says():
    rng = np.random.default_rng(7)
    runs = pd.concat([frame(np.abs(rng.normal(size=60)), method=f"m{i}") for i in range(60)], ignore_index=True)
    summary = summarize(runs)
    covered = ((summary.rmse_m_low <= 1) & (summary.rmse_m_high >= 1)).mean()
    assert 0.8 < covered <= 1


def test_a_single_run_has_no_interval_and_none_has_no_error():
    one, none = summarize(frame([0.3])), summarize(frame([np.nan], status="failed"))
    assert np.isnan(one.rmse_m_low[0]) and one.rmse_m[0] == pytest.approx(0.3)
    assert np.isnan(none.rmse_m[0]) and none.failed[0] == 1


def test_by_takes_any_columns_and_names_a_wrong_one():
    runs = pd.concat([frame([1.0, 2.0]), frame([3.0, 4.0], method="b", solver="t")])
    assert summarize(runs, by=["formulation"]).rmse_m.tolist() == [pytest.approx(np.sqrt(30 / 4))]
    with pytest.raises(ValueError, match="by: expected columns of runs, got colour"):
        summarize(runs, by=["colour"])


def test_the_verdict_ranks_only_what_the_pairs_can_tell():
    rng = np.random.default_rng(3)
    base = rng.rayleigh(size=30)
    runs = pd.concat(
        [frame(base, "best"), frame(base * 1.5, "worse"), frame(base * rng.choice([0.9, 1.12], 30), "level")]
    )
    text = verdict(runs, "rmse_m")
    assert text.startswith("best has the smallest error here") and "not told from it: level (" in text
    few = verdict(runs[runs.repetition < 3], "rmse_m")
    assert "3 repetitions do not rank methods" in few
    assert "every other method is worse" in verdict(runs[runs.method != "level"], "rmse_m")
    assert verdict(frame([np.nan], status="failed"), "rmse_m") == "No run ended with an estimate."


def test_the_verdict_goes_by_gospa_where_sources_were_missed():
    """One source of three, the easiest one, has the smaller error; that must not win."""
    all_three = frame(np.full(8, 0.3), "all", sources=3.0, sources_found=3.0, gospa_m=0.5)
    easiest = frame(np.full(8, 0.1), "easiest", sources=3.0, sources_found=1.0, gospa_m=1.1)
    text = verdict(pd.concat([all_three, easiest]), "rmse_m")
    assert text.startswith(
        "Not all found the true number of sources, so by gospa_m: all has the smallest error here (0.5"
    )
    same = verdict(pd.concat([all_three, easiest.assign(sources_found=3.0)]), "rmse_m")
    assert same.startswith("easiest has the smallest error")
    nothing = frame(np.full(8, np.nan), "nothing")
    assert verdict(nothing, "rmse_m") == "No run ended with an estimate."


def test_a_method_that_fails_where_it_is_hard_is_not_named_best():
    hard = np.repeat([0.1, 10.0], 6)
    fragile = frame(0.3 * hard, "fragile")
    fragile.loc[6:, ["status", "rmse_m"]] = ["failed", np.nan]
    text = verdict(pd.concat([frame(hard, "solid"), fragile]), "rmse_m")
    assert text.startswith("solid has the smallest error here") and "not told from it: fragile" in text
    rare = frame(hard, "rare")
    rare.loc[3:, ["status", "rmse_m"]] = ["failed", np.nan]
    text = verdict(pd.concat([frame(hard, "solid"), frame(2 * hard, "double"), rare]), "rmse_m")
    assert "every other method is worse by more than 1\u00a0%; too rarely ok to compare: rare" in text
