"""Texts of figures are no wider than their place: lines break, names are cut, and nothing leaves the figure."""

import itertools

import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text

import nfbench
from nfbench.figures import Drawing, figures, styled
from nfbench.figures.labels import plain
from nfbench.figures.text import fitted, fitted_apart, text_width, wrapped

LONG = "A label of a method WITH WIDE LETTERS, as long as this sentence"
STUDY = f"""
[labels]
noise = "{LONG} [dB]"
rmse = "{LONG} [m]"
runtime = "{LONG} [s]"
[sweep]
noise = [0.0, 0.5]
[[method]]
formulation = "once"
solver = "sampler"
label = "{LONG} 1"
[[method]]
formulation = "once"
solver = {{ kind = "sampler", batch = 4 }}
label = "{LONG} 2"
[[method]]
formulation = "once"
solver = {{ kind = "sampler", batch = 2 }}
label = "$50 \\\\% & <b>_x</b>"
[budget]
evaluations = 40
"""


@pytest.mark.parametrize("text", ["RMSE [m]", "WWWiii", "$x_1$ & 50 %", "Größe λ"])
def test_the_width_of_a_text_is_that_which_is_drawn(text):
    with styled():
        figure = Figure(dpi=200)
        FigureCanvasAgg(figure)
        drawn = figure.text(0, 0, plain(text), fontsize=9).get_window_extent()
    assert text_width(text, 9) == pytest.approx(drawn.width / figure.dpi, rel=0.05)


@pytest.mark.parametrize("inches", [0.4, 0.9, 2.0])
def test_lines_are_no_wider_than_their_place_and_have_all_words(inches):
    text = "Share of runs and targets: WWWWWWWWWWWWWWWWWWWWWWWWWWWWWWWWWWWWWWWWWWWWWW reached"
    lines = wrapped(text, inches, 7)
    assert all(text_width(line, 7) <= inches for line in lines)
    assert "".join(lines).replace(" ", "") == text.replace(" ", "")
    assert lines[0].split(" ")[0] == "Share" and not any(line.startswith(" ") or line.endswith(" ") for line in lines)


def test_lines_break_between_values_before_they_break_within_one():
    text = "SNR\N{NO-BREAK SPACE}=\N{NO-BREAK SPACE}20, K\N{NO-BREAK SPACE}=\N{NO-BREAK SPACE}3"
    parts = [part.rstrip(",") for part in text.split(" ")]
    lines = wrapped(text, text_width(parts[0] + ",", 7) + 0.02, 7)
    assert [line.rstrip(",") for line in lines] == parts


def test_a_name_is_cut_only_if_it_is_too_wide():
    assert fitted("neef + de", 2.0, 7) == "neef + de"
    found = fitted(LONG, 1.2, 7)
    assert text_width(found, 7) <= 1.2 < text_width(found.replace("…", "xxxx"), 7)
    assert found.startswith("A label") and found.endswith("sentence") and "…" in found


def test_names_that_differ_in_the_middle_stay_apart():
    names = [f"nemo + de(population={n}, strategy=current-to-best/1/bin)" for n in (10, 20, 40)]
    assert len({fitted(name, 1.2, 7) for name in names}) == 1
    found = fitted_apart(names, 1.2, 7)
    assert len(set(found)) == 3 and all(text_width(name, 7) <= 1.2 * 1.45 for name in found)


EDGE = 3  # pixels, of 100 per inch, by which the room for numbers of a width that depends on the times may be too small


@pytest.mark.parametrize("width", ["single", "double"])
def test_no_long_text_leaves_a_figure_or_covers_another(manifest, tmp_path, width):
    study = nfbench.load_study(manifest(STUDY))
    results = nfbench.run(study, out=tmp_path / "out", jobs=0)
    with styled():
        for stem, figure in figures(results, Drawing(width=width)):
            figure.draw_without_rendering()
            boxes = [
                text.get_window_extent()
                for text in figure.findobj(Text)
                if len(text.get_text()) > 8 and text.get_visible() and (text.axes is None or text.axes.get_visible())
            ]
            assert len(boxes) > 3
            for box in boxes:
                assert box.x0 >= -EDGE and box.x1 <= figure.bbox.x1 + EDGE and box.y0 >= -EDGE, stem
                assert box.y1 <= figure.bbox.y1 + EDGE, stem
            for a, b in itertools.combinations(boxes, 2):
                assert min(a.x1, b.x1) - max(a.x0, b.x0) < 1 or min(a.y1, b.y1) - max(a.y0, b.y0) < 3, stem
