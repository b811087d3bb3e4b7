"""Figures of many methods and of given labels: rows, names at lines, headings, and the choice of swept points."""

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

import nfbench
from nfbench.figures import Drawing, figures, styled
from nfbench.figures.data import chosen, drawn
from nfbench.figures.direct import spread
from nfbench.figures.error import BIAS, below_bound, error_figures
from nfbench.figures.highlights import highlighted, listed
from nfbench.figures.labels import setting, short
from nfbench.figures.style import styles

TOY = """
[[formulation]]
kind = "once"
[[solver]]
kind = "sampler"
batch = 1
[[solver]]
kind = "sampler"
batch = 4
[budget]
evaluations = 40
"""


@pytest.fixture
def study(manifest, tmp_path):
    """A function that runs the toy study with this text at its end."""

    def run(extra="", *, repetitions=2):
        return nfbench.run(
            nfbench.load_study(manifest(TOY + extra, repetitions=repetitions)), out=tmp_path / "out", jobs=0
        )

    return run


def drawings(results, **how):
    with styled():
        return dict(figures(results, Drawing(**how)))


@pytest.mark.parametrize("places", [[0.5] * 8, [0.0, 0.01, 0.9], np.linspace(1, 0, 11).tolist(), [0.99, 1.0, 1.0]])
def test_names_at_lines_are_a_gap_apart_in_the_order_of_the_lines(places):
    found = spread(places, 0.08)
    order = np.argsort(places, kind="stable")
    assert (np.diff(found[order]) >= 0.08 - 1e-12).all() and found.min() >= -1e-12 and found.max() <= 1 + 1e-12


def test_names_that_have_room_stay_where_they_are():
    assert spread([0.1, 0.5, 0.9], 0.1).tolist() == [0.1, 0.5, 0.9]


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("neef + de", "neef + de"),
        ("neef + minionpy(algorithm=IMODE)", "neef + minionpy(IMODE)"),
        ("a method with a very long name, number 12", "a method wi…e, number 12"),
        ("a method with a very long name, number 13", "a method wi…e, number 13"),
    ],
)
def test_a_long_name_keeps_its_end_where_similar_ones_differ(name, expected):
    found = short(name, 24)
    assert found == expected and len(found) <= 24


def test_of_more_than_fifty_methods_the_best_and_the_coloured_have_rows():
    names = [f"m{i}" for i in range(60)]
    own, rest = listed(names, ["m55", "m2"])
    assert own == [*names[:30], "m55"] and len(rest) == 29 and not set(own) & set(rest)
    assert listed(names[:50], ["m1"]) == (names[:50], [])


def test_the_rows_of_an_error_figure_are_the_best_methods_and_one_for_the_others(study):
    seen = drawn(study())
    names = [f"method {i}" for i in range(80)]
    table = seen.table.iloc[np.zeros(80, dtype=int)].assign(method=names, rmse_m=np.geomspace(0.1, 1, 80), failed=0)
    many = dataclasses.replace(seen, table=table, styles=styles(names, names[70:73]))
    with styled():
        ((_, figure),) = error_figures(many, "single", None)
    rows = [text.get_text() for text in figure.axes[0].get_yticklabels()]
    assert rows == [*names[:30], *names[70:73], "47 other methods"]
    shown = {line.get_label(): line.get_ydata()[0] for line in figure.axes[0].lines if line.get_label() in names}
    assert len(shown) == 80 and len({shown[name] for name in set(names) - set(rows)}) == 1


def test_the_colours_that_are_left_go_to_one_method_of_each_family():
    names = [f"m{i}" for i in range(12)]
    frame = pd.DataFrame({"method": names, "mean_rank": np.arange(12.0)})
    block = SimpleNamespace(swept={}, methods=tuple(names), order=(0,))
    evidence = SimpleNamespace(ranking=SimpleNamespace(frame=frame, blocks=(block,)))
    families = {name: "first" if i < 6 else name for i, name in enumerate(names)}
    assert highlighted(names, [], evidence, families) == ["m0", "m6", "m7", "m8", "m9", "m10", "m11", "m1"]
    assert highlighted(names, ["m4"], evidence, families)[:3] == ["m4", "m0", "m6"]


def test_an_error_is_drawn_along_the_key_with_the_most_numbers(study):
    results = study("[sweep]\ndimension = [1, 2]\nnoise = [0.0, 0.1, 0.2]\n")
    assert drawn(results).along[0] == "scenario.noise"
    (figure,) = drawings(results, only=("error",)).values()
    assert [ax.get_title("left") for ax in figure.axes[:2]] == ["Dimension = 1", "Dimension = 2"] or [
        ax.get_title("left") for ax in figure.axes[:2]
    ] == ["n = 1", "n = 2"]


def test_of_two_swept_keys_the_ends_of_both_are_chosen(study):
    parts = drawn(study("[sweep]\ndimension = [1, 2, 3]\nnoise = [0.0, 0.1, 0.2]\n", repetitions=1))
    found = [tuple(value for _, value in part.where) for part in chosen(parts.by(parts.swept))]
    assert found == [(1, 0.0), (1, 0.2), (3, 0.0), (3, 0.2)]


def test_labels_of_the_manifest_are_on_axes_and_in_headings(study):
    results = study(
        '[sweep]\nnoise = [0.0, 0.1]\n[labels]\nnoise = "Rauschen [dB]"\nrmse = "Fehler [m]"\nruntime = "$t$"\n'
    )
    found = drawings(results, only=("error", "runtime"))
    rmse = found["error"].axes[0]
    assert rmse.get_ylabel() == "Fehler [m]" and found["error"].axes[-1].get_xlabel() == "Rauschen [dB]"
    heads = [ax.get_title("left") for ax in found["runtime"].axes]
    assert heads == ["Rauschen = 0 dB", "Rauschen = 0.1 dB"] and found["runtime"].axes[0].get_xlabel() == r"\$t\$"


def test_degrees_follow_their_number():
    assert setting("min_separation_deg", 2.0) == "Min separation = 2°" and setting("snr_db", 2.0) == "SNR = 2 dB"


def test_an_error_below_the_bound_is_explained(study):
    seen = drawn(study())
    (metric, *_) = seen.metrics(None)
    bounded = dataclasses.replace(metric, bounds=("crb_m",))
    for crb, note in ((0.9, ""), (1.02, ""), (1.5, BIAS), (math.nan, "")):
        part = dataclasses.replace(seen, table=seen.table.assign(crb_m=crb * seen.table[metric.column]))
        assert below_bound([part], [bounded]) == note


def test_more_than_four_lines_are_named_at_their_ends(manifest, tmp_path):
    batches = "".join(f'[[solver]]\nkind = "sampler"\nlabel = "b{i}"\nbatch = {i}\n' for i in range(1, 7))
    text = f'[[formulation]]\nkind = "once"\n{batches}[budget]\nevaluations = 40\n[sweep]\nnoise = [0.0, 0.5, 1.0]\n'
    results = nfbench.run(nfbench.load_study(manifest(text)), out=tmp_path / "out", jobs=0)
    figure = drawings(results, only=("error",))["error"]
    names = [text.get_text() for text in figure.axes[0].texts]
    assert sorted(names) == sorted(drawn(results).methods) and len(names) == 6
    assert not any(
        name in [text.get_text() for legend in figure.legends for text in legend.get_texts()] for name in names
    )
