"""Figures show the tables that they are made from, and have the same bytes every time."""

import dataclasses
import itertools
import json
import math
import os
import subprocess
import sys

import numpy as np
import pytest
from matplotlib.colors import to_rgba

import nfbench
from nfbench.analysis import quantile_interval
from nfbench.cli import main
from nfbench.core.errors import NfbenchError
from nfbench.figures import Drawing, figures, styled, write_figures
from nfbench.figures.axes import error_axis, new_figure
from nfbench.figures.data import drawn
from nfbench.figures.error import error_figures
from nfbench.figures.labels import name_of, places, setting, text_of
from nfbench.figures.style import styles
from nfbench.results.store import Store

TOY = """
[[formulation]]
kind = "once"
[[formulation]]
kind = "twice"
[[solver]]
kind = "sampler"
[[solver]]
kind = "sampler"
batch = 4
[budget]
evaluations = 40
[summary]
outlier_m = 0.3
"""
FIELD = """
name = "field"
title = "Two sources"
repetitions = 3
seed = 2
[scenario]
kind = "near-field"
array = { kind = "KIND", spacing_wavelengths = 0.25, origin = "first", ELEMENTS }
wavelength_m = 0.02
sources = 2
snapshots = 8
snr_db = 20.0
azimuth_deg = [-60, 60]
range_m = [0.1, 0.5]
PLUS
[[formulation]]
kind = "nemo"
[[solver]]
kind = "random-search"
[budget]
evaluations = 50
"""


@pytest.fixture
def study(manifest, tmp_path):
    """A function that runs the toy study with this [sweep] in its own folder."""

    def run(sweep="", *, repetitions=8, extra=TOY):
        path = manifest(f"{extra}\n{f'[sweep]{chr(10)}{sweep}' if sweep else ''}", repetitions=repetitions)
        return nfbench.run(nfbench.load_study(path), out=tmp_path / "out", jobs=0)

    return run


@pytest.fixture
def field(tmp_path):
    """A function that runs a small near-field study in 2D or 3D."""

    def run(three=False):
        text = FIELD.replace("KIND", "upa" if three else "ula")
        text = text.replace("ELEMENTS", "columns = 3, rows = 3" if three else "elements = 8")
        (tmp_path / "field.toml").write_text(text.replace("PLUS", "elevation_deg = [-30, 30]" if three else ""))
        return nfbench.run(nfbench.load_study(tmp_path / "field.toml"), out=tmp_path / "field", jobs=0)

    return run


def drawings(results, **how):
    with styled():
        return dict(figures(results, Drawing(**how)))


def line(ax, label):
    """The data of the line with that label, without the gap before ∞."""
    (found,) = [found for found in ax.lines if found.get_label() == label]
    x, y = np.array(found.get_xdata(), dtype=float), np.array(found.get_ydata(), dtype=float)
    return x[~np.isnan(y)].tolist(), y[~np.isnan(y)].tolist()


def test_lines_show_the_summary_with_its_intervals(study):
    results = study("noise = [0.0, 0.25, 1.0]\n")
    rmse, median, far = drawings(results, only=("error",))["error"].axes
    summary = results.summary()
    assert len(summary) == 12 and len(summary["method"].unique()) == 4
    for ax, column, factor in ((rmse, "rmse_m", 1), (median, "median_m", 1), (far, "outlier_rate", 100)):
        for method, rows in summary.groupby("method"):
            x, y = line(ax, method)
            assert x == [0.0, 0.25, 1.0]
            assert y == pytest.approx(factor * rows[column].to_numpy())
    assert (rmse.get_yscale(), median.get_yscale(), far.get_yscale()) == ("log", "log", "linear")
    assert rmse.get_ylabel() == "RMSE [m]" and far.get_xlabel() == "Noise"
    assert not len(rmse.collections)  # no valid interval of a root mean square is known
    for band, (_, rows) in zip(median.collections[::2], summary.groupby("method", sort=False), strict=True):
        (outline,) = band.get_paths()
        edges = {(round(x, 9), round(y, 9)) for x, y in outline.vertices}
        for end in ("median_m_low", "median_m_high"):
            assert {(x, round(y, 9)) for x, y in zip([0.0, 0.25, 1.0], rows[end], strict=True)} <= edges


def test_an_interval_that_reaches_infinity_leaves_the_axis_and_does_not_widen_it(study):
    seen = drawn(study("noise = [0.0, 0.25, 1.0]\n"))
    tops, limits = [], []
    for high in (math.inf, seen.table["median_m"]):
        table = seen.table.assign(median_m_high=high)
        with styled():
            ((_, figure),) = error_figures(dataclasses.replace(seen, table=table), "single", "median")
        (ax,) = figure.axes
        limits.append(ax.get_ylim())
        tops.append([band.get_paths()[0].vertices[:, 1].max() for band in ax.collections[::2]])
    assert limits[0] == limits[1]
    assert len(tops[0]) == 4 and min(tops[0]) > 100 * limits[0][1] and max(tops[1]) < limits[1][1]


@pytest.mark.parametrize("known", [(), ("crb_m",), ("crb_m", "floor_m")])
@pytest.mark.parametrize("sweep", ["", "noise = [0.0, 0.25, 1.0]\n", 'names = [["a"], ["b", "c"]]\n'])
def test_bounds_are_drawn_if_the_summary_has_them(study, known, sweep):
    seen = drawn(study(sweep))
    points = seen.table["method"].eq(seen.methods[0]).sum()
    bound = np.repeat(0.01 * np.arange(1.0, points + 1), 4)
    columns = {name: bound * (1 + i) if name in known else math.nan for i, name in enumerate(("crb_m", "floor_m"))}
    seen = dataclasses.replace(seen, table=seen.table.assign(**columns))
    with styled():
        ((_, figure),) = error_figures(seen, "single", None)
    rmse, *others = figure.axes
    labels = [found.get_label() for found in rmse.lines]
    assert {"crb_m", "floor_m"} & set(labels) == set(known)
    for name in known:
        if "noise" in sweep:
            assert line(rmse, name)[1] == pytest.approx(columns[name][::4])
        else:
            at = {value for found in rmse.lines if found.get_label() == name for value in found.get_xdata()}
            assert at == set(columns[name])
        (look,) = {found.get_linestyle() for found in rmse.lines if found.get_label() == name}
        assert look == {"crb_m": "--", "floor_m": ":"}[name]
    assert not any(found.get_label() in columns for ax in others for found in ax.lines)
    legend = [text.get_text() for found in figure.legends for text in found.get_texts()]
    assert ("Cramér–Rao bound" in legend, "Error floor" in legend) == ("crb_m" in known, "floor_m" in known)


def test_without_a_sweep_methods_are_listed_with_the_best_on_top(study):
    results = study()
    rmse, median, *_ = drawings(results, only=("error",))["error"].axes
    summary = results.summary().sort_values("rmse_m")
    names = [text.get_text().replace("\n", " ") for text in rmse.get_yticklabels()]
    assert names == summary["method"].tolist()
    for place, name, error, middle in zip(
        rmse.get_yticks(), names, summary["rmse_m"], summary["median_m"], strict=True
    ):
        assert line(rmse, name) == ([pytest.approx(error)], [place])
        assert line(median, name) == ([pytest.approx(middle)], [place])
    assert list(rmse.get_yticks()) == sorted(rmse.get_yticks(), reverse=True)


def test_run_time_is_drawn_against_error(study):
    results = study("noise = [0.0, 0.25]\n")
    panels, runs = drawings(results, only=("runtime",))["runtime"].axes, results.runs
    assert [ax.get_title("left") for ax in panels] == ["Noise = 0", "Noise = 0.25"]
    for ax, (_, rows) in zip(panels, results.summary().groupby("scenario.noise"), strict=True):
        for row in rows.to_dict("records"):
            (x,), (y,) = line(ax, row["method"])
            times = runs.loc[
                (runs["method"] == row["method"]) & (runs["scenario.noise"] == row["scenario.noise"]), "runtime_s"
            ]
            assert (x, y) == (times.median(), row["rmse_m"])
            (bar,) = [
                bar.get_segments()[0]
                for bar in ax.collections
                if len(bar.get_segments()) and bar.get_segments()[0][0][1] == y
            ]
            assert bar[:, 0].tolist() == list(quantile_interval(times.to_numpy()))
    long = drawings(study("noise = [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6]\n", repetitions=1), only=("runtime",))[
        "runtime"
    ].axes
    assert [ax.get_title("left") for ax in long] == [f"Noise = {x}" for x in ("0", "0.2", "0.4", "0.6")]


def test_a_second_key_gives_panels_or_files_if_it_has_many_values(study):
    results = study("dimension = [1, 2, 3]\nnoise = [0.0, 0.5]\n", repetitions=2)
    (figure,) = [figure for stem, figure in drawings(results, only=("error",)).items()]
    headings = [ax.get_title("left") for ax in figure.axes]
    assert headings[:2] == ["Noise = 0", "Noise = 0.5"]
    summary = results.summary()
    for ax, noise in zip(figure.axes, (0.0, 0.5), strict=False):
        rows = summary[(summary["scenario.noise"] == noise) & (summary["method"] == "twice + sampler(batch=4)")]
        assert line(ax, "twice + sampler(batch=4)") == ([1, 2, 3], rows["rmse_m"].tolist())
    results = study("dimension = [1, 2, 3, 4]\nnoise = [0.0, 0.1, 0.2, 0.3, 0.4]\n", repetitions=1)
    drawn_ = drawings(results, only=("error", "runtime"))
    stems = [stem for stem in drawn_ if stem.startswith("error")]
    assert stems == [f"error-dimension-{dimension}" for dimension in (1, 2, 3, 4)]  # along the longer list
    looks = {
        (label, found.get_color(), found.get_marker())
        for figure in drawn_.values()
        for ax in figure.axes
        for found in ax.lines
        if not (label := found.get_label()).startswith("_")
    }
    assert len(looks) == 4  # a method looks the same in every panel and file


def test_categories_are_rows_with_one_dot_per_method(study):
    results = study('names = [["a"], ["b", "c"]]\n')
    rmse = drawings(results, only=("error",))["error"].axes[0]
    assert [text.get_text() for text in rmse.get_yticklabels()] == ["a", "b, c"]
    drawn_ = [x for found in rmse.lines for x in found.get_xdata()]
    assert sorted(drawn_) == pytest.approx(sorted(results.summary()["rmse_m"]))


def test_infinity_is_set_apart_from_the_numbers():
    at = places("rician_k", [1.0, 10.0, math.inf, 100.0])
    assert at.log and at.of == {1.0: 1.0, 10.0: 10.0, 100.0: 100.0, math.inf: 1000.0} and at.beyond == 1000.0
    assert not places("snr_db", [1.0, 10.0, 100.0]).log and not places("sources", list(range(1, 12))).log
    assert places("snr_db", [0, 10]).of == {0.0: 0.0, 10.0: 10.0}
    for categories in ([10.0, math.inf], ["a", "b"], [1.0, "[1, 2]"], [True, False], [5]):
        assert places("x", categories) is None


@pytest.mark.parametrize(
    ("key", "label"),
    [
        ("snr_db", "SNR [dB]"),
        ("rician_k", "Rician factor κ"),
        ("array.spacing_wavelengths", "Array spacing [λ]"),
        ("min_separation_deg", "Min separation [°]"),
        ("nlos.angular_spread_deg", "Nlos angular spread [°]"),
        ("my_key", "My key"),
        ("range_m", "Range [m]"),
        ("a$b$", r"A\$b\$"),
    ],
)
def test_axis_labels(key, label):
    assert name_of(key) == label


def test_cells_as_text():
    cells = [math.inf, -5.0, json.dumps([0.0, 20.5]), json.dumps({"kind": "clusters", "count": 3}), "iid", True]
    assert [text_of(cell) for cell in cells] == ["∞", "−5", "0, 20.5", "clusters (count = 3)", "iid", "yes"]
    assert setting("rician_k", math.inf) == "κ = ∞" and setting("snr_db", 20.0) == "SNR = 20 dB"


def test_no_two_methods_have_the_same_colour_or_marker_and_the_rest_is_grey():
    labels = [str(i) for i in range(50)]
    looks = styles(labels)
    own = [looks[label] for label in labels[:8]]
    assert len({look.colour for look in own}) == len({look.marker for look in own}) == 8
    assert all(to_rgba(look.colour) != to_rgba("black") and not look.pale for look in own)
    assert {(looks[label].colour, looks[label].pale) for label in labels[8:]} == {("0.72", True)}
    chosen = styles(labels, ["40", "7"])
    assert [label for label in labels if not chosen[label].pale] == ["7", "40"]
    assert chosen["7"] == own[0] and chosen["40"] == own[1]


@pytest.mark.parametrize(
    "values", [[0.013, 0.015], [0.02, 0.09], [1e-3, 3.0], [1e-30, 1.0], [5.0], [0.0, 1e-9, 1.0], [1e5, 1.2e5]]
)
@pytest.mark.parametrize("width", [1.5, 3.5])
def test_a_log_axis_always_has_labels_and_they_do_not_overlap(values, width):
    with styled():
        figure = new_figure(width, 1.5, "")
        ax = figure.subplots()
        error_axis([ax], "x", values)
        figure.draw_without_rendering()
        boxes = [text.get_window_extent() for text in ax.get_xticklabels() if text.get_text()]
    assert 2 <= len(boxes) <= 9
    assert all(left.x1 < right.x0 for left, right in itertools.pairwise(boxes))
    low, high = ax.get_xlim()
    assert all(low < value < high for value in values)


@pytest.mark.parametrize("width", ["single", "double"])
@pytest.mark.parametrize(
    "sweep",
    [
        *("", "noise = [0.0, 0.25, 1.0]\n", 'names = [["a"], ["b", "c"]]\n'),
        pytest.param("dimension = [1, 9]\nnoise = [0.0, 0.5]\n", marks=pytest.mark.slow),
    ],
)
def test_no_label_covers_another_or_leaves_the_page(study, sweep, width):
    for stem, figure in drawings(study(sweep), width=width, traces=True).items():
        with styled():
            figure.draw_without_rendering()
            for ax in figure.axes:
                for axis in (ax.xaxis, ax.yaxis):
                    texts = [text for tick in axis.get_major_ticks() for text in (tick.label1, tick.label2)]
                    texts = [text for text in texts if text.get_text() and text.get_visible() and ax.get_visible()]
                    boxes = [text.get_window_extent() for text in texts]
                    assert not any(a.overlaps(b) for a, b in itertools.combinations(boxes, 2)), (stem, ax)
                    if axis.label.get_text():
                        boxes.append(axis.label.get_window_extent())
                    assert all(box.x0 >= -1 and box.x1 <= figure.bbox.x1 + 1 for box in boxes), (stem, ax)
            (legend,) = figure.legends or [None]
            if legend:
                box = legend.get_window_extent()
                assert box.x0 >= 0 and box.x1 <= figure.bbox.x1
                assert all(box.y1 <= ax.get_window_extent().y0 for ax in figure.axes if ax.get_visible())


def test_a_perfect_score_is_drawn_at_zero(study):
    results = study(extra=TOY + '[[formulation]]\nkind = "oracle"\n')
    rmse = drawings(results, only=("error",))["error"].axes[0]
    assert line(rmse, "oracle")[0] == [0.0]
    assert rmse.get_xlim()[0] < 0 and rmse.get_xticklabels()[0].get_text() == "0"


def test_methods_that_fail_are_named(study):
    results = study("noise = [0.0, 0.5]\n", extra=TOY + '[[solver]]\nkind = "raises"\n', repetitions=1)
    legend = drawings(results, only=("error",))["error"].legends[0]
    assert "once + raises (no successful run)" in [text.get_text() for text in legend.get_texts()]


@pytest.mark.parametrize("three", [False, True])
def test_positions_link_the_truth_to_its_estimates(field, three):
    results = field(three)
    figure = drawings(results, only=("positions",))["positions"]
    axes = [ax for ax in figure.axes if ax.get_visible()]
    assert len(axes) == (4 if three else 2)  # one per source, and two views in 3D
    assert [ax.get_ylabel() for ax in axes[::2]] == (["y [m]", "z [m]"] if three else ["y [m]"])
    top, below = axes[:2], axes[2:]
    runs = results.runs
    for k, ax in enumerate(top):
        (x, y), (x_hat, y_hat) = line(ax, "truth"), line(ax, "nemo + random-search")
        squares = (np.array(x) - x_hat) ** 2 + (np.array(y) - y_hat) ** 2
        if three:
            (_, z), (_, z_hat) = line(below[k], "truth"), line(below[k], "nemo + random-search")
            squares += (np.array(z) - z_hat) ** 2
        assert np.sqrt(squares) == pytest.approx(runs[f"error_{k + 1}_m"].to_numpy())
        links = [found.get_xydata().tolist() for found in ax.lines if len(found.get_xdata()) == 2]
        assert [*zip(zip(x, y, strict=True), zip(x_hat, y_hat, strict=True), strict=True)] == [
            tuple(map(tuple, link)) for link in links
        ]


def test_positions_of_other_instances_are_refused(field):
    results = field()
    path = results.folder / "manifest.toml"
    path.write_text(path.read_text().replace("range_m = [0.1, 0.5]", "range_m = [0.1, 0.6]"))
    with pytest.raises(NfbenchError, match="positions cannot be redrawn: rmse_m of run"):
        drawings(results, positions=True)
    warnings = []
    with styled():
        stems = [stem for stem, _ in figures(results, Drawing(), warnings.append)]
    assert stems == ["error", "runtime", "distribution", "ert"] and warnings[0].startswith(
        "positions are not drawn: positions cannot be"
    )


def test_instances_without_positions_are_an_error_only_if_positions_are_requested(study, toy_plugin):
    results = study()
    assert "positions" not in drawings(results, plugins=(toy_plugin,))
    with pytest.raises(NfbenchError, match="the scenario's instances have none"):
        drawings(results, positions=True, plugins=(toy_plugin,))


def test_convergence_is_the_median_gap_over_scenes(study):
    results = study()
    figure = drawings(results, only=("convergence",))["convergence"]
    assert [ax.get_title("left") for ax in figure.axes] == ["once", "twice"]
    runs, traces = results.runs, results.traces
    first = traces[traces["problem"] == 0].merge(runs[["run_id", "method", "scene", "formulation"]], on="run_id")
    best = first.groupby(["formulation", "scene"])["value"].transform("min")  # each formulation has its own objective
    first["gap"] = first["value"] - best
    own = first[first["method"] == "once + sampler(batch=4)"]
    points = list(zip(*line(figure.axes[0], "once + sampler(batch=4)"), strict=True))
    assert len(points) > 20
    for evaluations, value in points:
        so_far = own[own["evaluations"] <= evaluations].groupby("run_id")["gap"].min()
        assert value == pytest.approx(so_far.median(), abs=1e-12)


def test_the_same_results_give_the_same_bytes_in_another_process(field):
    results = field()
    how = Drawing(traces=True)
    first = {
        path.name: path.read_bytes() for path in write_figures(results, results.folder, ["svg", "pdf", "png"], how)
    }
    assert set(first) == {
        f"{stem}.{kind}"
        for stem in ("error", "runtime", "distribution", "ert", "positions", "convergence")
        for kind in ("svg", "pdf", "png")
    }
    command = [sys.executable, "-m", "nfbench", "figure", str(results.folder), "--out", str(results.folder / "again")]
    environment = {**os.environ, "PYTHONHASHSEED": "7", "MPLBACKEND": "svg", "SOURCE_DATE_EPOCH": "1"}
    done = subprocess.run(
        [*command, "--format", "svg,pdf,png", "--traces"], env=environment, capture_output=True, text=True, timeout=120
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert [line.rsplit("/", 1)[1] for line in done.stdout.splitlines()] == list(first)
    for name, content in first.items():
        assert (results.folder / "again" / name).read_bytes() == content, name
        assert len(content) < 300_000
    assert b"<dc:date>" not in first["error.svg"] and b"CreationDate" not in first["error.pdf"]
    assert b"/Type3" not in first["error.pdf"]


def test_wrong_use_is_exit_code_2_with_a_message(study, tmp_path, monkeypatch, capsys, toy_plugin):
    def figure(*arguments):
        monkeypatch.setattr(sys, "argv", ["nfbench", "figure", *map(str, arguments)])
        monkeypatch.setenv("COLUMNS", "160")
        with pytest.raises(SystemExit) as ended:
            main()
        return ended.value.code, capsys.readouterr().err

    results = study(repetitions=2)
    for arguments, message in (
        (["nowhere"], "expected a results folder with runs.sqlite, found none"),
        ([results.folder, "--format", "svg,eps"], "expected svg, pdf, png, tex, got 'eps'"),
        ([results.folder, "--width", "triple"], "'triple' is not one of"),
        ([results.folder, "--out", results.folder / "runs.csv"], "runs.csv"),
        ([results.folder, "--positions"], f"pass those that you trust with --plugin: {toy_plugin}"),
        (
            [results.folder, "--positions", "--plugin", toy_plugin],
            "positions cannot be drawn: the scenario's instances have none",
        ),
    ):
        code, errors = figure(*arguments)
        assert code == 2 and message in errors, errors
    with Store(results.folder, write=True) as store:
        store._db.execute("DELETE FROM results WHERE run_id = ?", [results.runs["run_id"][0]])
        store._db.commit()
    code, errors = figure(results.folder, "--out", tmp_path / "drawn", "--no-positions")
    assert code == 0 and (tmp_path / "drawn" / "error.svg").is_file()
    assert errors == "nfbench: the study is unfinished; the figures show 7 of 8 runs\n"
    with Store(results.folder, write=True) as store:
        store.forget(["ok"])
    code, errors = figure(results.folder)
    assert code == 2 and "nothing to draw: no run has finished yet" in errors


def test_the_command_line_does_not_import_matplotlib():
    code = "import sys, nfbench.cli, nfbench.results; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], timeout=60).returncode == 0


EVIL = "from pathlib import Path\nPath({proof!r}).write_text('executed')\n"


def test_reading_runs_no_file_of_the_folder(study, tmp_path, toy_plugin, monkeypatch, capfd):
    """A folder from elsewhere is data: no command imports the plugins that its manifest names, unless told to."""
    results = study(repetitions=2)
    folder, proof = results.folder, tmp_path / "executed"
    (folder / "evil.py").write_text(EVIL.format(proof=str(proof)) + toy_plugin.read_text())
    for names in ('["evil.py"]', f'["{folder / "evil.py"}"]'):
        text = (folder / "manifest.toml").read_text()
        head, _, rest = text.partition("plugins = ")
        (folder / "manifest.toml").write_text(f"{head}plugins = {names}\n{rest.partition(chr(10))[2]}")
        for arguments in (
            ("figure", folder, "--traces"),
            ("figure", folder, "--positions"),
            ("figure", folder, "--manifest", folder / "manifest.toml"),
            ("status", folder),
            ("report", folder),
            ("compare", folder, folder),
            ("merge", folder, "--out", tmp_path / "merged"),
            ("export", folder, "--to", "csv", "--out", tmp_path / f"{len(names)}.csv"),
            ("export", folder, "--to", "ioh", "--out", tmp_path / f"{len(names)}"),
        ):
            monkeypatch.setattr(sys, "argv", ["nfbench", *map(str, arguments)])
            with pytest.raises(SystemExit) as ended:
                main()
            output = "".join(capfd.readouterr())
            assert ended.value.code == (2 if "--positions" in arguments else 0), output
            assert ("pass those that you trust with --plugin: " in output) == (arguments[0] == "figure"), output
            assert not proof.exists(), arguments
    drawings(results, plugins=(folder / "evil.py",))
    assert proof.exists()  # it would have run


def test_swept_text_that_looks_like_json_or_markup_is_drawn_as_it_is(study, monkeypatch):
    texts = ["[1", "[/]", "{", '"', "[1]", "a\x1b[2Jb", "$x_1$", "_a", "日本"]
    results = study(f"names = {[[f'text {i}'] for i in range(len(texts))]}\n", repetitions=1)
    with Store(results.folder, write=True) as store:
        for i, text in enumerate(texts):
            swept = [json.dumps({"names": value}) for value in (text, [f"text {i}"])]
            store._db.execute("UPDATE plan SET swept = ? WHERE swept = ?", swept)
        store._db.execute("DELETE FROM meta WHERE key = 'plan_rows'")
        store._db.commit()
    seen = drawn(results)
    column, at = seen.along
    assert column == "scenario.names" and at is None
    shown = [text_of(part.where[-1][1]) for part in seen.by([column])]
    assert shown == ["[1", "[/]", "{", '"', "[1]", r"a\x1b[2Jb", r"\$x_1\$", "\N{THIN SPACE}_a", "日本"]
    written = write_figures(
        results, results.folder / "drawn", ["svg", "pdf"], Drawing(only=("error", "runtime", "convergence"))
    )
    assert all(path.stat().st_size for path in written) and len(written) == 6


def test_equal_file_names_of_different_values_are_numbered(study):
    results = study("dimension = [1, 2, 3, 4, 5]\nnoise = [0.1, 0.10000001, 0.10000002, 0.10000003]\n", repetitions=1)
    stems = [stem for stem in drawings(results, only=("error",)) if stem.startswith("error")]
    assert stems == ["error-noise-0.1", *(f"error-noise-0.1-{number}" for number in (2, 3, 4))]


def test_a_manifest_with_another_scenario_does_not_stop_the_figures(field):
    results = field()
    (results.folder / "manifest.toml").write_text(FIELD.partition("[scenario]")[0] + '[scenario]\nkind = "functions"\n')
    told = []
    with styled():
        stems = [stem for stem, _ in figures(results, Drawing(), told.append)]
    assert stems == ["error", "runtime", "distribution", "ert"] and len(told) == 1 and "manifest.toml" in told[0]
