"""Figures about targets and rankings show the tables of ``Results``, and many methods are readable."""

import dataclasses
import itertools
import re
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_rgba

import nfbench
from nfbench.analysis import attainment
from nfbench.cli import main
from nfbench.core.errors import NfbenchError
from nfbench.figures import Drawing, figures, styled
from nfbench.figures.data import drawn, median_over_scenes
from nfbench.figures.highlights import highlighted
from nfbench.figures.style import styles
from nfbench.figures.tradeoff import efficient
from nfbench.results import find_progress

MANIFEST = """
name = "toy"
scenes = 12
seed = 1
plugins = ["PLUGIN"]
[scenario]
kind = "toy"
[[formulation]]
kind = "once"
[targets]
error = [0.5, 0.1]
"""
SAMPLER = '[[solver]]\nkind = "sampler"\nbatch = {}\n'


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A function that runs a toy study with samplers of these batch sizes, once per test module."""
    done = {}
    plugin = Path(__file__).parents[1] / "toy_plugins" / "toy.py"

    def results(batches, extra="[budget]\nevaluations = 40\n"):
        if (batches, extra) not in done:
            folder = tmp_path_factory.mktemp("kinds")
            text = textwrap.dedent(MANIFEST.replace("PLUGIN", str(plugin)))
            (folder / "toy.toml").write_text(text + "".join(map(SAMPLER.format, batches)) + extra)
            done[batches, extra] = nfbench.run(nfbench.load_study(folder / "toy.toml"), out=folder / "out", jobs=0)
        return done[batches, extra]

    return results


SWEPT = "[sweep]\nbudget.evaluations = [20, 60]\n"
NOISE = "[budget]\nevaluations = 40\n[sweep]\nnoise = [0.0, 0.5]\n"


def draw(results, kind, **how):
    with styled():
        ((_, figure),) = figures(results, Drawing(only=(kind,), **how))
        figure.draw_without_rendering()
    return figure


def line(ax, label):
    (found,) = [found for found in ax.lines if found.get_label() == label]
    return np.array(found.get_xdata(), dtype=float), np.array(found.get_ydata(), dtype=float)


def legend(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_runtime_distributions_are_shares_of_the_hits(run):
    results = run((4, 8))
    figure = draw(results, "distribution")
    (ax,) = figure.axes
    hits = results.hits()
    for method, own in hits.groupby("method"):
        x, y = line(ax, method)
        reached = [100 * (own["hit"] & (own["evaluations"] <= cost)).mean() for cost in x]
        assert y == pytest.approx(reached) and y[-1] > 0 and x[-1] == hits["cap"].min()
    assert "95 % band, pointwise" in legend(figure)
    assert figure.legends[0].get_title().get_text() == "Share of runs and targets: error ≤ 0.5; error ≤ 0.1"
    curve = results.runtime_distribution()
    curve = curve[curve["method"] == "once + sampler(batch=8)"]
    edges = np.concatenate([band.get_paths()[0].vertices[:, 1] for band in ax.collections])
    for end in ("low", "high"):
        assert all(np.abs(edges - 100 * value).min() < 1e-9 for value in curve[end])


def test_one_target_is_chosen_by_number_or_label(run):
    results = run((4, 8))
    table = results.target_table()
    for target in (2, "2", "error ≤ 0.1", "error <= 0.1"):
        (ax,) = draw(results, "ert", target=target).axes
        rows = table[table["target"] == "error ≤ 0.1"].set_index("method")
        shown = [tick.get_text() for tick in ax.get_yticklabels()]
        assert [rows["ert"][name] for name in shown] == sorted(rows["ert"])
        for method, row in rows.iterrows():
            assert line(ax, method)[0] == pytest.approx([row["ert"]])
            spans = [bar.get_segments()[0][:, 0].tolist() for bar in ax.collections]
            assert any(span == pytest.approx([row["ert_low"], row["ert_high"]]) for span in spans)
    with pytest.raises(NfbenchError, match=re.escape("expected one of 1 (error ≤ 0.5), 2 (error ≤ 0.1), got '3'")):
        draw(results, "ert", target=3)
    seconds = draw(results, "ert", axis="seconds")
    first = table[table["target"] == "error ≤ 0.5"].set_index("method")["ert_s"]
    assert line(seconds.axes[0], first.index[0])[0] == pytest.approx([first.iloc[0]])
    assert seconds.get_supxlabel() == "Expected seconds until error ≤ 0.5"


def test_a_method_that_never_hits_says_so(run):
    results = run((4, 8))
    study = drawn(results)
    hits = study.evidence.hits.frame
    never = hits.assign(hit=hits["hit"] & (hits["method"] != "once + sampler(batch=4)"))
    study.evidence.__dict__["hits"] = dataclasses.replace(study.evidence.hits, frame=never)
    with styled():
        (ax,) = nfbench.figures.ert_figure(study, Drawing()).axes
    assert [text.get_text() for text in ax.texts] == ["never"] and ax.texts[0].get_color() == "0.45"
    assert [tick.get_text() for tick in ax.get_yticklabels()][-1] == "once + sampler(batch=4)"


def test_ranks_mark_the_best_set_of_the_ranking(run):
    results = run((1, 4, 8, 40))
    figure = draw(results, "ranks")
    (ax,) = figure.axes
    frame = results.ranking().frame.set_index("method")
    for method, row in frame.iterrows():
        assert line(ax, method)[0] == [row["mean_rank"]]
        (found,) = [found for found in ax.lines if found.get_label() == method]
        assert (found.get_markerfacecolor() != "white") == bool(row["in_best_set"])
    best = frame.loc[frame["in_best_set"].astype(bool), "mean_rank"]
    assert line(ax, "best set")[0] == pytest.approx(sorted(best))
    assert ax.get_title("left") == "12 scenes"
    with pytest.raises(NfbenchError, match="ranks cannot be drawn: there is no scene on which at least 3 methods ran"):
        draw(run((4, 8)), "ranks")


def test_ranks_of_a_sweep_are_those_over_all_points(run):
    results = run((4, 8, 40), NOISE)
    figure = draw(results, "ranks")
    frame = results.ranking().frame
    frame = frame[frame["scenario.noise"] == "all"]
    assert figure.axes[0].get_title("left") == "All swept points: 12 scenes × 2 swept points"
    for row in frame.to_dict("records"):
        assert line(figure.axes[0], row["method"])[0] == [row["mean_rank"]]


def test_efficient_points_are_those_that_no_other_dominates():
    rng = np.random.default_rng(5)
    for _ in range(200):
        costs, errors = rng.integers(1, 6, (2, 8)).astype(float)
        errors[rng.random(8) < 0.2] = np.inf
        expected = [
            np.isfinite(e)
            and not any(a <= c and b <= e and (a, b) != (c, e) for a, b in zip(costs, errors, strict=True))
            for c, e in zip(costs, errors, strict=True)
        ]
        assert efficient(costs, errors).tolist() == expected


def test_the_tradeoff_over_swept_budgets_joins_the_budgets_of_a_method(run):
    results = run((4, 8), SWEPT)
    figure = draw(results, "tradeoff")
    (ax,) = figure.axes
    runs = results.runs
    points = {}
    for method, own in runs.groupby("method"):
        groups = [group for _, group in own.groupby("budget.evaluations")]
        x, y = line(ax, method)
        assert x.tolist() == [group["evaluations"].median() for group in groups]
        assert y == pytest.approx([group["rmse_m"].median() for group in groups])
        points[method] = list(zip(x, y, strict=True))
    everything = [point for own in points.values() for point in own]
    x, y = line(ax, "efficient")
    best = {(a, b) for a, b in everything if not any(c <= a and d <= b and (c, d) != (a, b) for c, d in everything)}
    assert set(zip(x, y, strict=True)) == best and list(x) == sorted(x)
    titles = [ax.get_title("left") for ax in draw(results, "runtime").axes]
    assert titles == ["Budget = 20 evaluations", "Budget = 60 evaluations"]
    assert draw(results, "error").axes[0].get_xlim()[0] < 20


def test_failed_runs_count_as_infinite_in_the_median(run):
    runs = run((4, 8)).runs.iloc[:9].assign(scene=range(9), value=[1.0, 2, 3, 4, 5, 6, np.nan, np.nan, np.nan])
    assert median_over_scenes(runs, "value") == (5.0, 2.0, np.inf)
    twice = runs.assign(scene=[0, 0, 0, 1, 1, 1, 2, 2, 2])
    value, low, high = median_over_scenes(twice, "value")
    assert value == 5.0 and np.isnan([low, high]).all()


def test_attainment_shows_the_surfaces(run):
    results = run((4, 8))
    figure = draw(results, "attainment")
    (ax,) = figure.axes
    progress = find_progress(results, "error").frame
    measure = "error" if not progress["at_end"].any() and np.isfinite(progress["value"]).any() else "gap"
    progress = find_progress(results, measure).frame
    for method, own in attainment(progress, (50,)).groupby("method"):
        x, y = line(ax, method)
        shown = {(a, b) for a, b in zip(x, y, strict=True) if np.isfinite(b)}
        assert {(a, b) for a, b in zip(own["evaluations"], own["value"], strict=True)} <= shown


def test_attainment_without_moocore_says_what_to_install(run, monkeypatch):
    monkeypatch.setitem(sys.modules, "moocore", None)
    with pytest.raises(NfbenchError, match=r"attainment cannot be drawn: .*pip install moocore"):
        draw(run((4, 8)), "attainment")


def test_of_many_methods_the_best_are_in_colour_and_the_rest_is_grey(run):
    results = run(tuple(range(1, 13)))
    study = drawn(results)
    order = [study.evidence.ranking.blocks[0].methods[i] for i in study.evidence.ranking.blocks[0].order]
    ranks = results.ranking().frame.set_index("method")["mean_rank"].sort_values(kind="stable")
    assert len(study.methods) == 12 and set(study.coloured) == set(list(dict.fromkeys([*order, *ranks.index]))[:8])
    for kind in ("runtime", "distribution", "error"):
        figure = draw(results, kind)
        if kind != "error":
            assert legend(figure)[-1] == f"{len(study.others)} other methods"
        for ax in figure.axes:
            shown = {found.get_label(): found.get_color() for found in ax.lines if found.get_label() in study.methods}
            assert set(shown) == set(study.methods)
            colours = [shown[name] for name in study.coloured]
            assert len({to_rgba(colour) for colour in colours}) == len(colours)
            assert {to_rgba(shown[name]) for name in study.others} == {to_rgba("0.72")}
    worst = ranks.index[-1]
    assert worst in drawn(results, methods=[worst]).coloured
    few = drawn(run((4, 8, 40)), methods=["once + sampler(batch=40)"])
    assert "once + sampler(batch=40)" in few.coloured
    with pytest.raises(NfbenchError, match=r"got 'once \+ sampler\(batch=13\)'; did you mean 'once \+ sampler"):
        highlighted(study.methods, ["once + sampler(batch=13)"], study.evidence)


def test_fifty_methods_fit_in_a_column(run):
    seen = drawn(run((1, 4, 8, 40)))
    names = [f"a method with a long label(option={i})" for i in range(50)]
    table = seen.table.iloc[np.zeros(50, dtype=int)].assign(method=names, rmse_m=np.geomspace(0.1, 1, 50))
    study = dataclasses.replace(seen, table=table, styles=styles(names, names[:3]))
    with styled():
        ((_, figure),) = nfbench.figures.error_figures(study, "single", None)
        figure.draw_without_rendering()
        boxes = [tick.get_window_extent() for tick in figure.axes[0].get_yticklabels()]
    assert len(boxes) == 50 and figure.get_figheight() < 9
    assert not any(a.overlaps(b) for a, b in itertools.combinations(boxes, 2)) and min(b.x0 for b in boxes) >= -1


def test_options_of_the_command_line(run, tmp_path, monkeypatch, capsys):
    results = run((1, 4, 8, 40))

    def figure(*arguments):
        monkeypatch.setattr(sys, "argv", ["nfbench", "figure", str(results.folder), "--out", str(tmp_path), *arguments])
        monkeypatch.setenv("COLUMNS", "160")
        with pytest.raises(SystemExit) as ended:
            main()
        return ended.value.code, capsys.readouterr()

    options = ["--only", "ranks,ert", "--axis", "seconds", "--target", "2", "--methods", "once + sampler(batch=8)"]
    code, output = figure(*options, "--format", "svg")
    assert code == 0, output.err
    assert [Path(text).name for text in output.out.split()] == ["ert.svg", "ranks.svg"]
    first = [(tmp_path / name).read_bytes() for name in ("ert.svg", "ranks.svg")]
    figure(*options, "--format", "svg")
    assert first == [(tmp_path / name).read_bytes() for name in ("ert.svg", "ranks.svg")]
    for arguments, message in (
        (["--only", "ert,pie"], "expected some of error, runtime, distribution, ert,"),
        (["--only", "ert", "--axis", "equivalents"], "is known in evaluations and in seconds only"),
        (["--methods", "nobody"], "expected labels of the study's methods, got 'nobody'"),
    ):
        code, output = figure(*arguments)
        assert code == 2 and message in " ".join(output.err.split()), output.err


def test_a_study_without_solvers_has_no_distribution_over_evaluations(tmp_path):
    plugin = Path(__file__).parents[1] / "toy_plugins" / "toy.py"
    text = MANIFEST.replace("PLUGIN", str(plugin)).replace('kind = "once"', 'kind = "oracle"')
    (tmp_path / "toy.toml").write_text(text)
    results = nfbench.run(nfbench.load_study(tmp_path / "toy.toml"), out=tmp_path / "out", jobs=0)
    with styled():
        assert [stem for stem, _ in figures(results)] == ["error", "runtime"]
    with pytest.raises(NfbenchError, match="no method makes evaluations"):
        draw(results, "distribution")
    with pytest.raises(NfbenchError, match="no method makes evaluations"):
        draw(results, "tradeoff", axis="evaluations")
    with pytest.raises(NfbenchError, match="fewer than two methods"):
        draw(results, "tradeoff")
