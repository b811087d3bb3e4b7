"""Errors of single parameters in the summary, the report and figures, against their definitions."""

import io
import math
import re

import numpy as np
import pandas as pd
import pytest
from rich.console import Console

import nfbench
from nfbench import NfbenchError, load_study
from nfbench.analysis import Parameter, default_groups, parameters, quantile_interval, summarize
from nfbench.figures import Drawing, figures, styled
from nfbench.report import number_text
from nfbench.report.parameters import print_parameters

STUDY = """
name = "p"
scenes = 8
seed = 3
[scenario]
kind = "near-field"
array = { kind = "ula", elements = 16, spacing_wavelengths = 0.25, origin = "center" }
wavelength_m = 0.02
sources = 2
snapshots = 20
azimuth_deg = [-60, 60]
range_m = [0.05, 0.3]
min_separation_deg = 20.0
[sweep]
snr_db = [10.0, 20.0]
[[formulation]]
kind = "grid-refine"
[[formulation]]
kind = "music"
grid = { azimuth = 40, range = 40 }
"""


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    folder = tmp_path_factory.mktemp("parameters")
    (folder / "study.toml").write_text(STUDY)
    return nfbench.run(load_study(folder / "study.toml"), out=folder / "out", jobs=0)


def printed(summary, ranking=None, width=200):
    console = Console(file=io.StringIO(), width=width, force_terminal=True, color_system=None)
    print_parameters(summary, pd.DataFrame() if ranking is None else ranking, console, number_text)
    return console.file.getvalue()


def test_parameters_are_found_by_their_columns():
    columns = [
        "rmse_m",
        "azimuth_rmse_deg",
        "crb_azimuth_deg",
        "range_rmse_m",
        "range_error_12_m",
        "xrmse_m",
        "r2_rmse_m",
    ]
    assert parameters(columns) == [Parameter("azimuth", "deg"), Parameter("range", "m")]
    azimuth, found = parameters(columns)
    assert (azimuth.error, azimuth.bound, azimuth.symbol) == ("azimuth_rmse_deg", "crb_azimuth_deg", "°")
    assert found.signed([*columns, "range_error_1_m", "range_error_x_m"]) == ["range_error_12_m", "range_error_1_m"]


def test_the_summary_has_what_it_says(results):
    runs, summary = results.runs, results.summary()
    for row in summary.to_dict("records"):
        own = runs[(runs.method == row["method"]) & (runs["scenario.snr_db"] == row["scenario.snr_db"])]
        for name, unit in (("azimuth", "deg"), ("range", "m")):
            errors = own[f"{name}_rmse_{unit}"]
            signed = own[[f"{name}_error_1_{unit}", f"{name}_error_2_{unit}"]].to_numpy()
            assert row[f"{name}_rmse_{unit}"] == pytest.approx(np.sqrt((signed**2).mean()), rel=1e-12)
            assert row[f"{name}_rmse_{unit}_median"] == pytest.approx(np.median(errors))
            low, high = quantile_interval(errors.to_numpy())
            assert row[f"{name}_rmse_{unit}_median_low"] == low < row[f"{name}_rmse_{unit}_median"] < high
            assert row[f"{name}_bias_{unit}"] == pytest.approx(np.median(signed))
            bounds = own[[f"crb_{name}_1_{unit}", f"crb_{name}_2_{unit}"]].to_numpy()
            assert row[f"crb_{name}_{unit}"] == pytest.approx(np.sqrt((bounds**2).mean()), rel=1e-12)
    assert not [name for name in summary if "elevation" in name]


def test_failed_runs_and_missed_sources_are_left_out_of_bias_and_rmse_but_not_of_the_interval():
    runs = pd.DataFrame(
        {
            "formulation": "f", "solver": "", "method": "m", "scene": range(8), "status": ["ok"] * 7 + ["failed"],
            "rmse_m": 1.0, "range_rmse_m": [1.0, 2, 3, 4, 5, 6, math.nan, 100],
            "range_error_1_m": [-1.0, -2, -3, -4, -5, -6, math.nan, 100], "range_error_2_m": [7.0] + [math.nan] * 7,
        }
    )  # fmt: skip
    (row,) = summarize(runs).to_dict("records")
    assert row["range_rmse_m"] == pytest.approx(math.sqrt(np.mean(np.arange(1, 7) ** 2)))
    assert row["range_rmse_m_median"] == 3.5 and row["range_bias_m"] == -3.0
    assert row["range_rmse_m_median_high"] == math.inf and row["range_rmse_m_median_low"] == 1.0
    assert "crb_range_m" not in row


def test_the_report_prints_each_number_once_per_method_and_point(results):
    summary = results.summary()
    text = printed(summary)
    lines = [line for line in text.splitlines() if line.startswith((" grid-refine", " music"))]
    assert len(lines) == 4 and text.count("snr_db = ") == 2 and "Errors per parameter" in text
    assert re.search(r"azimuth \[°\] +range \[m\]", text)
    for line, row in zip(lines, summary.to_dict("records"), strict=True):
        names = [f"{p}_{n}" for p, n in (("azimuth", "deg"), ("range", "m"))]
        expected = []
        for name in names:
            parameter, _, unit = name.partition("_")
            columns = f"{parameter}_rmse_{unit}_median", f"{parameter}_rmse_{unit}", f"{parameter}_bias_{unit}"
            expected += [number_text(row[c]) for c in (*columns, f"crb_{parameter}_{unit}")]
        assert line.split()[1:] == expected


def test_a_narrow_terminal_keeps_the_root_mean_squares(results):
    summary = results.summary()
    heads = {width: printed(summary, width=width) for width in (200, 75, 60, 40)}
    assert [sum(head in heads[w] for head in ("bias", "median", "bound", "RMSE")) for w in heads] == [4, 3, 2, 1]
    assert all("RMSE" in text for text in heads.values())


def test_large_studies_show_the_best_methods_only(results):
    summary = pd.concat([results.summary().assign(**{"scenario.k": k}) for k in range(10)], ignore_index=True)
    order = [*default_groups(summary)[:-3], "method"]
    ranking = summary[order].assign(in_best_set=[name == "music" for name in summary.method])
    text = printed(summary, ranking)
    assert text.count("music") == 20 and "grid-refine" not in text and "summary.csv has all" in text
    assert printed(summary, ranking.assign(in_best_set=None)).count("grid-refine") == 20
    assert printed(summary).count("grid-refine") == 20


def test_scenarios_without_parameters_print_nothing(results):
    kept = [name for name in results.summary() if not name.startswith(("azimuth", "range"))]
    assert printed(results.summary()[kept]) == ""


def test_hostile_labels_are_printed_without_markup(results):
    summary = results.summary().assign(method="[/]\x1b[2J")
    assert "\x1b" not in printed(summary).replace("\x1b[1m", "").replace("\x1b[0m", "") and "[/]" in printed(summary)


@pytest.mark.parametrize(("metric", "unit"), [("azimuth", "deg"), ("range", "m")])
def test_figures_of_a_parameter_show_its_errors_and_its_bound(results, metric, unit):
    with styled():
        ((_, figure),) = figures(results, Drawing(metric=metric, only=("error",)))
    summary = results.summary()
    above, below = figure.axes
    drawn = {line.get_label(): line.get_ydata() for line in above.lines}
    for method, rows in summary.groupby("method"):
        np.testing.assert_array_equal(drawn[method], rows[f"{metric}_rmse_{unit}"])
        (median,) = [line.get_ydata() for line in below.lines if line.get_label() == method]
        np.testing.assert_array_equal(median, rows[f"{metric}_rmse_{unit}_median"])
    bound = summary[summary.method == "music"][f"crb_{metric}_{unit}"]
    np.testing.assert_array_equal(drawn[f"crb_{metric}_{unit}"], bound)
    assert "crb_m" not in drawn and f"[{'m' if unit == 'm' else '°'}]" in above.get_ylabel()


def test_the_run_time_is_drawn_against_the_wanted_parameter(results):
    with styled():
        ((_, figure),) = figures(results, Drawing(metric="range", only=("runtime",)))
    labels = {line.get_label() for ax in figure.axes for line in ax.lines}
    assert "crb_range_m" in labels and "crb_m" not in labels


def test_a_parameter_without_errors_is_refused(results):
    with styled(), pytest.raises(NfbenchError, match="expected rmse, median, azimuth, range, got 'elevation'"):
        list(figures(results, Drawing(metric="elevation", only=("error",))))


def test_the_methods_are_in_the_order_of_the_tables_above(results):
    console = Console(file=io.StringIO(), width=200)
    order = {"snr_db = 10.0": ["music", "grid-refine"], "snr_db = 20.0": ["grid-refine", "music"]}
    print_parameters(results.summary(), pd.DataFrame(), console, number_text, order)
    rows = re.findall(r"^ *(music|grid-refine)", console.file.getvalue(), re.MULTILINE)
    assert rows == [*order["snr_db = 10.0"], *order["snr_db = 20.0"]]
