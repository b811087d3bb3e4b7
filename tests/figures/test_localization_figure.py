"""The picture of an estimate: equal scales, ellipses of the right size, and only views that show something."""

import numpy as np
import pytest
from matplotlib.patches import Ellipse

from nfbench.core import NfbenchError, Picture
from nfbench.figures import localization_figure, styled, write_localization_figure


def picture(covariance, *, flat=False, sources=1):
    rng = np.random.default_rng(0)
    Q = rng.uniform(-0.5, 0.5, (20, 3)) * [1, 1, 0]
    corners = np.array([[-1, -1, 0.5], [1, -1, 0.5], [1, 1, 2.0]]) * [1, 1, 0 if flat else 1]
    places = np.tile([0.2, 0.1, 0.0 if flat else 1.0], (sources, 1))
    return Picture(Q, (corners,), places, np.tile(covariance, (sources, 1, 1)), places + np.array([0.01, 0.01, 0.0]))


def panels(figure):
    return [ax for ax in figure.axes if ax.get_visible()]


def test_ellipses_have_two_standard_errors_along_their_axes():
    turn = np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    covariance = turn @ np.diag([0.3**2, 0.1**2, 0.2**2]) @ turn.T
    with styled():
        figure = localization_figure(picture(covariance))
    front, side, top = panels(figure)
    (ellipse,) = [patch for patch in front.patches if isinstance(patch, Ellipse)]
    assert (ellipse.width, ellipse.height) == pytest.approx((4 * 0.3, 4 * 0.1))
    assert np.tan(np.radians(ellipse.angle)) == pytest.approx(0.75)
    assert ellipse.center == pytest.approx((0.2, 0.1))
    assert [(ax.get_xlabel(), ax.get_ylabel()) for ax in (front, side, top)] == [
        ("x [m]", "y [m]"),
        ("z [m]", "y [m]"),
        ("x [m]", "z [m]"),
    ]
    assert all(ax.get_aspect() == 1.0 for ax in (front, side, top))
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    assert "2 standard errors" in texts and "True position" in texts


def test_small_ellipses_are_enlarged_by_a_factor_that_is_stated():
    with styled():
        figure = localization_figure(picture(np.diag([1e-4, 2e-4, 3e-4]) ** 2))
    (ellipse,) = [patch for patch in panels(figure)[0].patches if isinstance(patch, Ellipse)]
    (text,) = [text.get_text() for text in figure.legends[0].get_texts() if "enlarged" in text.get_text()]
    factor = int(text.split("enlarged ")[1].split(" ")[0].replace(",", ""))
    assert ellipse.width == pytest.approx(4 * 2e-4 * factor) and 0.01 < 2 * 3e-4 * factor < 0.5


def test_an_unknown_covariance_has_no_ellipse_and_a_plane_has_one_view():
    with styled():
        figure = localization_figure(picture(np.full((3, 3), np.nan), flat=True, sources=3))
    (ax,) = panels(figure)
    assert not ax.patches and len(ax.texts) == 3
    assert not any("standard errors" in text.get_text() for text in figure.legends[0].get_texts())


def test_no_source_at_all_is_drawn_too(tmp_path):
    nothing = Picture(np.eye(3), (), np.empty((0, 3)), np.empty((0, 3, 3)))
    write_localization_figure(nothing, tmp_path / "a.svg")
    assert (tmp_path / "a.svg").read_text().startswith("<?xml")
    with pytest.raises(NfbenchError, match=r"expected a file that ends in \.png"):
        write_localization_figure(nothing, tmp_path / "a.bmp")
