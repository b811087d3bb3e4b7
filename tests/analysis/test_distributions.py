"""Curves and tables of cost and progress have their reference values, and those of a second, direct implementation."""

import sys

import numpy as np
import pandas as pd
import pytest

from nfbench.analysis.distributions import (
    aocc,
    aocc_table,
    attainment,
    fixed_budget_table,
    fixed_target_table,
    performance_profile,
    runtime_distribution,
    value_at,
)

RNG = np.random.default_rng(5)


def hits_of(costs, method="a", *, cap=1000.0, target="t", scene=None, run=0):
    """Hits with these costs, one per scene; inf is a miss."""
    costs = np.array(costs, dtype=float)
    scene = np.arange(len(costs)) if scene is None else scene
    frame = {"run_id": [f"{method}-{s}-{run}" for s in scene], "method": method, "scene": scene, "run": run}
    frame |= {"target": target, "number": 0, "hit": np.isfinite(costs), "evaluations": costs}
    frame |= {"seconds": costs / 100, "evaluation_equivalents": 2 * costs, "spent": cap, "spent_s": cap / 100}
    return pd.DataFrame(frame | {"cap": cap})


def progress_of(values, method="a", *, spent=1000.0, run=0, scene=0, cap=1000.0):
    """Progress of one run: a list of (evaluations, value)."""
    evaluations, found = np.array(values, dtype=float).T
    frame = {"run_id": f"{method}-{scene}-{run}", "method": method, "scene": scene, "run": run}
    frame |= {"evaluations": evaluations, "seconds": evaluations / 100, "value": found, "spent": spent, "cap": cap}
    return pd.DataFrame(frame)


# --- runtime distributions --------------------------------------------------------------------------------------------


def test_one_target_and_one_run_give_the_step_function_with_its_clopper_pearson_band():
    curve = runtime_distribution(hits_of([10, 20, 20, 500, np.inf, 40, 50, 60, 70, 80]))
    assert curve["evaluations"].tolist() == [10, 20, 40, 50, 60, 70, 80, 500, 1000]
    assert curve["share"].tolist() == pytest.approx([0.1, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.9])
    last = curve.iloc[-1]
    assert (last["low"], last["high"]) == pytest.approx((0.5550, 0.9975), abs=5e-5)  # 9 of 10, STATISTICS.md §9


def test_scenes_weigh_equally_however_many_runs_they_have():
    often = pd.concat([hits_of([10], run=run, scene=[0]) for run in range(9)])
    rare = pd.concat([hits_of([np.inf], run=0, scene=[1]), hits_of([100], run=0, scene=[2], target="u")])
    curve = runtime_distribution(pd.concat([often, rare]))
    assert curve["evaluations"].tolist() == [10, 100, 1000]
    assert curve["share"].tolist() == pytest.approx([1 / 3, 2 / 3, 2 / 3])
    assert (curve["low"] <= curve["share"]).all()
    assert (curve["share"] <= curve["high"]).all()


def test_several_runs_do_not_narrow_the_band_beyond_that_of_the_scenes():
    hits = pd.concat([hits_of([10] * 6 + [np.inf] * 4, run=run) for run in range(5)])
    curve = runtime_distribution(hits)
    at = curve[curve["evaluations"] == 10].iloc[0]
    assert at["share"] == pytest.approx(0.6)
    assert at["high"] - at["low"] > 0.5  # Clopper–Pearson of 6 in 10 is 0.616 wide, of 30 in 50 only 0.278


def test_curves_agree_with_a_direct_count_on_every_axis():
    costs = {method: RNG.choice([*RNG.uniform(1, 900, 40), np.inf], (4, 12)) for method in "ab"}
    hits = pd.concat(
        hits_of(costs[method][i], method, target=f"t{i % 2}", run=i // 2) for method in "ab" for i in range(4)
    )
    for axis in ("evaluations", "evaluation_equivalents", "seconds"):
        curve = runtime_distribution(hits, axis, bands=False)
        for method, of_method in curve.groupby("method"):
            found = hits[hits["method"] == method]
            reached = found[axis].to_numpy()[:, None] <= of_method[axis].to_numpy()  # (runs and targets, x)
            shares = pd.DataFrame(reached).groupby(found["scene"].to_numpy()).mean().mean()
            np.testing.assert_allclose(of_method["share"], shares)


def test_curves_end_at_the_smallest_cap_of_the_methods_at_a_point():
    hits = pd.concat([hits_of([10, 900], "a"), hits_of([20, 30], "b", cap=300.0), hits_of([0, 0], "free", cap=0.0)])
    curve = runtime_distribution(hits)
    assert curve["evaluations"].max() == 300
    assert curve[curve["method"] == "a"]["share"].tolist()[-1] == 0.5
    assert (curve[curve["method"] == "free"]["share"] == 1).all()
    assert runtime_distribution(hits, "seconds")["seconds"].max() == 10.0  # of the longest run


def test_long_curves_are_thinned_to_the_number_of_points():
    curve = runtime_distribution(hits_of(RNG.uniform(1, 999, 500)), points=20)
    assert len(curve) <= 21
    assert curve["evaluations"].iloc[-1] == 1000
    assert curve["share"].iloc[-1] == 1
    assert curve["evaluations"].is_monotonic_increasing


def test_swept_points_have_their_own_curves():
    hits = pd.concat([hits_of([10, 20]).assign(**{"scenario.k": 1}), hits_of([30, np.inf]).assign(**{"scenario.k": 2})])
    curve = runtime_distribution(hits)
    assert curve.groupby("scenario.k")["share"].max().to_dict() == {1: 1.0, 2: 0.5}


def test_an_unknown_axis_is_refused():
    with pytest.raises(ValueError, match="axis: expected one of evaluations, evaluation_equivalents, seconds, got 'x'"):
        runtime_distribution(hits_of([1]), "x")


# --- fixed budget, fixed target ---------------------------------------------------------------------------------------


def test_the_value_after_a_budget_is_that_of_the_last_improvement():
    run = progress_of([(1, 5.0), (10, 2.0), (100, 0.5)])
    assert value_at(run, [0, 1, 9, 10, 99, 100, 1000]).tolist() == [np.inf, 5, 5, 2, 2, 0.5, 0.5]


def test_fixed_budget_quantiles_are_those_of_the_medians_over_runs():
    finals = [1, 2, 3, 4, 5, 6, 7, 8, 9, 10]
    parts = [
        progress_of([(1, 100), (50, f + shift)], scene=f, run=r) for f in finals for r, shift in enumerate((0, 0, 9))
    ]
    row = fixed_budget_table(pd.concat(parts), [50]).iloc[0]
    assert (row["runs"], row["median"], row["median_low"], row["median_high"]) == (30, 5.5, 2, 9)  # STATISTICS.md §9
    assert (row["q25"], row["q75"]) == (3.25, 7.75)
    assert fixed_budget_table(pd.concat(parts), [49]).iloc[0]["median"] == 100


def test_failed_runs_are_infinite_and_budgets_beyond_the_cap_are_unknown():
    ok = [progress_of([(1, 1.0)], scene=s) for s in range(3)]
    failed = [progress_of([(1000, np.inf)], scene=s) for s in range(3, 7)]
    table = fixed_budget_table(pd.concat([*ok, *failed]), [10, 2000])
    assert table["median"].tolist()[0] == np.inf
    assert np.isnan(table["median"].tolist()[1])


def test_the_default_budgets_include_the_smallest_cap():
    parts = [progress_of([(1, 1.0)], "a", cap=3000.0), progress_of([(1, 1.0)], "b", cap=700.0)]
    budgets = fixed_budget_table(pd.concat(parts))["evaluations"].unique().tolist()
    assert budgets == [1, 2, 5, 10, 20, 50, 100, 200, 500, 700, 1000, 2000]


def test_the_fixed_target_table_has_a_column_per_method():
    table = fixed_target_table(pd.concat([hits_of([10, 30], "b"), hits_of([np.inf, np.inf], "a")]))
    assert table.to_dict("records") == [{"target": "t", "b": 20.0, "a": np.inf}]
    assert fixed_target_table(hits_of([10, np.inf]), "share")["a"].tolist() == [0.5]
    with pytest.raises(ValueError, match="column: expected a column of the table of targets, got 'cost'"):
        fixed_target_table(hits_of([10]), "cost")


# --- attainment -------------------------------------------------------------------------------------------------------


def test_surfaces_agree_with_the_share_of_runs_at_every_corner():
    pytest.importorskip("moocore")
    parts = []
    for scene in range(8):
        times = np.sort(RNG.choice(np.arange(1, 900), 12, replace=False))
        parts.append(progress_of(np.column_stack([times, np.sort(RNG.uniform(0, 1, 12))[::-1]]), scene=scene))
    progress = pd.concat(parts)
    surfaces = attainment(progress, [25, 50, 100])
    assert set(surfaces["percentile"]) == {25, 50, 100}

    def attained(t, value):
        return np.mean([value_at(run, [t])[0] <= value for _, run in progress.groupby("run_id")])

    for corner in surfaces.itertuples():
        assert attained(corner.evaluations, corner.value) >= corner.percentile / 100
        assert attained(corner.evaluations - 1, corner.value) < corner.percentile / 100
        assert attained(corner.evaluations, corner.value - 1e-9) < corner.percentile / 100


def test_runs_without_a_value_count_in_the_share():
    pytest.importorskip("moocore")
    parts = [progress_of([(10, 1.0)], scene=0), *(progress_of([(1000, np.inf)], scene=s) for s in (1, 2))]
    surfaces = attainment(pd.concat(parts), [33, 50])
    assert surfaces["percentile"].tolist() == [33]
    assert surfaces[["evaluations", "value"]].to_numpy().tolist() == [[10, 1.0]]


def test_an_error_that_rises_again_is_attained_only_from_then_on():
    pytest.importorskip("moocore")
    surfaces = attainment(progress_of([(1, 5.0), (10, 1.0), (20, 3.0), (30, 2.0)]), [100])
    assert surfaces[["evaluations", "value"]].to_numpy().tolist() == [[1, 5.0], [10, 3.0], [30, 2.0]]


def test_without_moocore_the_message_says_how_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "moocore", None)
    with pytest.raises(ImportError, match="need moocore, which is not installed here: pip install moocore"):
        attainment(progress_of([(1, 1.0)]))


# --- area over the convergence curve ----------------------------------------------------------------------------------


def test_aocc_has_its_reference_value():
    assert aocc(np.array([1, 10, 100]), np.array([1.0, 0.1, 0.01]), 1000, -4, 1) == pytest.approx(0.5778, abs=1e-12)


def test_aocc_is_a_hypervolume():
    moocore = pytest.importorskip("moocore")
    t = np.array([3.0, 20.0, 70.0, 400.0])
    g = np.array([200.0, 0.5, 1e-3, 1e-9])
    points = np.column_stack([t, np.clip(np.log10(g), -4, 1)])
    volume = moocore.hypervolume(points, ref=[1000, 1]) / (1000 * 5)
    assert aocc(t, g, 1000, -4, 1) == pytest.approx(volume, rel=1e-12)


def test_aocc_agrees_with_a_sum_over_evaluations():
    t, g = np.array([1, 4, 9, 30]), np.array([3.0, 0.2, 1e-2, 0.0])
    steps = [value_at(pd.DataFrame({"evaluations": t, "value": g}), [j])[0] for j in range(50)]
    with np.errstate(divide="ignore"):
        shares = 1 - np.clip((np.log10(steps) + 3) / 4, 0, 1)
    assert aocc(t, g, 50, -3, 1) == pytest.approx(shares.mean())
    assert aocc(t, g, 50, -3, 1, log_time=True) > aocc(t, g, 2, -3, 1)


def test_aocc_ignores_what_lies_beyond_the_budget():
    t, g = np.array([1, 10, 500]), np.array([1.0, 0.1, 1e-8])
    assert aocc(t, g, 100, -4, 1) == aocc(t[:2], g[:2], 100, -4, 1)
    with pytest.raises(ValueError, match="low, high: expected low < high"):
        aocc(t, g, 100, 1, 1)
    with pytest.raises(ValueError, match="budget: expected more than 1, got 1"):
        aocc(t, g, 1, -4, 1, log_time=True)


def test_the_table_of_areas_averages_over_runs_then_scenes_and_ends_at_the_smallest_cap():
    steps = [(1, 1.0), (10, 0.1), (100, 0.01)]
    parts = [progress_of(steps, scene=0, run=run) for run in range(3)]
    parts += [progress_of([(1000, np.inf)], scene=1), progress_of([(1, 1e-9)], "b", cap=5000.0)]
    table = aocc_table(pd.concat(parts), -4, 1).set_index("method")
    assert table.loc["a", "aocc"] == pytest.approx(0.5778 / 2)
    assert table.loc["a", "runs"] == 4
    assert table.loc["b", "aocc"] == pytest.approx(0.999)
    assert table.loc["a", "aocc_low"] < table.loc["a", "aocc"] < table.loc["a", "aocc_high"]


# --- performance profiles ---------------------------------------------------------------------------------------------


def test_profiles_of_two_methods_by_hand():
    hits = pd.concat([hits_of([10, 40, np.inf, np.inf], "a"), hits_of([20, 10, 30, np.inf], "b")])
    profile = performance_profile(hits)
    assert profile[profile["method"] == "a"][["ratio", "share"]].to_numpy().tolist() == [[1, 0.25], [4, 0.5]]
    assert profile[profile["method"] == "b"][["ratio", "share"]].to_numpy().tolist() == [[1, 0.5], [2, 0.75]]


def test_profiles_take_the_expected_or_the_median_cost_over_the_runs_of_a_scene():
    runs = [hits_of([cost], "a", run=run) for run, cost in enumerate((10, 30, np.inf))]
    hits = pd.concat([*runs, hits_of([10], "b")])
    found = {cost: performance_profile(hits, cost=cost) for cost in ("ert", "median")}
    last = {cost: profile[profile["method"] == "a"]["ratio"].max() for cost, profile in found.items()}
    assert last == {"ert": 52.0, "median": 3.0}  # (10 + 30 + 1000)/2 ÷ 10, and 30 ÷ 10


def test_profiles_leave_out_problems_that_a_method_has_not_run():
    hits = pd.concat([hits_of([10, 20], "a"), hits_of([20], "b")])
    profile = performance_profile(hits)
    assert profile.groupby("method")["share"].max().to_dict() == {"a": 1.0, "b": 1.0}
    assert profile[profile["method"] == "a"]["ratio"].tolist() == [1]
    assert profile[profile["method"] == "b"]["ratio"].tolist() == [1, 2]
