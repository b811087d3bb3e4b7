"""The numbers of efficient methods in the figure of error against cost cover neither each other nor the edge."""

import itertools

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

from nfbench.figures.tradeoff import _write_numbers


def panel(costs, errors):
    figure = Figure(figsize=(1.7, 1.5), dpi=100)
    ax = figure.subplots()
    ax.set(xscale="log", yscale="log", xlim=(1e-3, 1), ylim=(1e-4, 1))
    names = [f"m{i}" for i in range(len(costs))]
    table = pd.DataFrame({"method": names, "cost": costs, "error": errors})
    written = _write_numbers(ax, table, {name: i for i, name in enumerate(names, start=8)})
    figure.draw_without_rendering()
    return ax, written, [text.get_window_extent() for text in ax.texts]


@pytest.mark.parametrize("count, factor", [(3, 1.05), (6, 1.3), (12, 1.02)])
def test_numbers_of_close_points_do_not_cover_each_other(count, factor):
    steps = factor ** np.arange(count)
    _, written, boxes = panel(0.02 * steps, 0.05 / steps)
    assert 2 <= len(boxes) == len(written)
    for one, other in itertools.combinations(boxes, 2):
        assert not one.padded(-0.5).overlaps(other.padded(-0.5))


def test_a_number_at_the_edge_stays_in_the_panel():
    ax, written, (box,) = panel([0.02], [0.95])
    assert written == {"m0"} and box.y1 <= ax.get_window_extent().y1 + 1


def test_points_with_room_have_their_numbers_above_them():
    ax, _, boxes = panel([0.005, 0.2], [0.1, 0.001])
    for (x, y), box in zip(ax.transData.transform([(0.005, 0.1), (0.2, 0.001)]), boxes, strict=True):
        assert box.y0 > y and box.x0 < x < box.x1
