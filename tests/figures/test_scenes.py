"""Figures of scenes show the scene that the runs had, and LaTeX code has no commands from labels."""

import math
import re

import numpy as np
import pytest

import nfbench
from nfbench.analysis import find_minima
from nfbench.core import NfbenchError
from nfbench.figures import Drawing, figures, styled, write_figures
from nfbench.figures.geometry import planes_of
from nfbench.figures.landscape import STARTS
from nfbench.figures.scenes import picture_of

FIELD = """
name = "field"
title = "Two sources, $5_x$ \\\\input{a} & 50 %"
scenes = 2
seed = 2
[scenario]
kind = "near-field"
array = { kind = "ula", elements = 8, spacing_wavelengths = 0.5, origin = "first" }
wavelength_m = 0.02
sources = 2
snapshots = 20
snr_db = 20.0
azimuth_deg = [-60, 60]
range_m = [0.1, 0.5]
[[formulation]]
kind = "grid-refine"
[[formulation]]
kind = "nemo"
[[solver]]
kind = "random-search"
[budget]
evaluations = 50
"""


@pytest.fixture(scope="module")
def field(tmp_path_factory):
    folder = tmp_path_factory.mktemp("field")
    (folder / "field.toml").write_text(FIELD)
    return nfbench.run(nfbench.load_study(folder / "field.toml"), out=folder / "out", jobs=0)


def drawings(results, **how):
    with styled():
        return dict(figures(results, Drawing(**how)))


def first_instance(results):
    study = nfbench.load_study(results.folder / "manifest.toml")
    seed = int(results.runs["instance_seed"].iloc[0])
    scenario = nfbench.study.load_scenarios(results.folder / "manifest.toml")[0][1]
    return scenario.draw_scene(np.random.default_rng(seed), 0), seed, study


def line(ax, label):
    (found,) = [found for found in ax.lines if found.get_label() == label]
    return np.column_stack([found.get_xdata(), found.get_ydata()])


def test_a_landscape_marks_the_truth_and_the_minima_of_each_plane(field):
    figure = drawings(field, only=("landscape",))["landscape"]
    instance, seed, _ = first_instance(field)
    panels = [ax for ax in figure.axes if ax.get_title("left")]
    assert [ax.get_title("left").partition(":")[0] for ax in panels] == ["RLS", "ESF, source 1", "MUSIC spectrum"]
    degrees = np.column_stack([np.degrees(instance.theta[:, 0]), instance.theta[:, 1]])
    for ax, cut in zip(panels, instance.cuts(), strict=True):
        assert line(ax, "truth") == pytest.approx(degrees)
        found = find_minima(cut.plane(), STARTS, np.random.default_rng(seed), cut.marks)
        assert len(line(ax, "minima")) + 1 == len(found.values)
        assert line(ax, "lowest")[0] == pytest.approx(found.places[0] * cut.scale)
    esf = line(panels[1], "lowest")[0]
    assert abs(esf - degrees[0])[0] < 3  # within a beamwidth of the source that moves


def test_a_level_is_relative_and_a_spectrum_has_its_peak_at_0_db(field):
    figure = drawings(field, only=("landscape",))["landscape"]
    meshes = [ax.collections[0].get_array() for ax in figure.axes if ax.get_title("left")]
    assert meshes[0].min() < 0.02 and meshes[0].max() == pytest.approx(1)
    assert -3 < meshes[2].max() <= 0 and meshes[2].min() == -30


def test_a_geometry_has_the_distances_of_the_array(field):
    (figure,) = drawings(field, only=("geometry",)).values()
    D, wavelength = 7 * 0.01, 0.02
    texts = [text.get_text() for legend in figure.legends for text in legend.get_texts()]
    assert f"Fresnel distance, {0.62 * math.sqrt(D**3 / wavelength):.3g} m" in texts
    assert f"Fraunhofer distance, {2 * D**2 / wavelength:.3g} m" in texts
    scene = figure.axes[0]
    ring = max(
        np.hypot(found.get_xdata(), found.get_ydata()).min() for found in scene.lines if len(found.get_xdata()) > 300
    )
    assert ring == pytest.approx(2 * D**2 / wavelength)
    assert figure.axes[1].get_title("left") == "Array, 8 elements"


def test_a_scene_shows_the_estimates_of_its_runs_and_counts_those_outside(field):
    figure = drawings(field, only=("scene",))["scene"]
    instance, seed, _ = first_instance(field)
    estimates = dict(field.estimates())
    runs = field.runs[field.runs["instance_seed"] == seed]
    whole, *close = figure.axes
    for run in runs.to_dict("records"):
        truth, found = instance.positions(np.array(estimates[run["run_id"]]))
        assert line(whole, run["method"]) == pytest.approx(found[:, :2])
        for k, ax in enumerate(close):
            assert line(ax, run["method"])[0] == pytest.approx(found[k, :2] - truth[k, :2])
    assert [ax.get_title("left") for ax in close] == ["Source 1", "Source 2"]
    methods = [run["method"] for run in runs.to_dict("records")]
    for ax in close:
        outside = sum(np.abs(line(ax, method)[0]).max() > ax.get_xlim()[1] for method in methods)
        assert [text.get_text() for text in ax.texts] == ([f"{outside} outside"] if outside else [])


def test_where_all_estimates_are_far_a_panel_shows_half_of_them(tmp_path):
    """Strong fading moves every estimate by many standard errors of line of sight."""
    (tmp_path / "fading.toml").write_text(
        FIELD.replace("snr_db = 20.0", 'snr_db = 60.0\nrician_k = 1.0\nfading = "block"')
    )
    results = nfbench.run(nfbench.load_study(tmp_path / "fading.toml"), out=tmp_path / "out", jobs=0)
    for ax in drawings(results, only=("scene",))["scene"].axes[1:]:
        inside = [np.abs(line(ax, method)[0]).max() <= ax.get_xlim()[1] for method in set(results.runs["method"])]
        assert np.mean(inside) >= 0.5


def test_the_ellipse_of_a_source_is_that_of_its_standard_errors(field):
    figure = drawings(field, only=("scene",))["scene"]
    instance, *_ = first_instance(field)
    covariance = picture_of(instance).covariances[0][:2, :2]
    (ellipse,) = figure.axes[1].patches
    largest = 4 * math.sqrt(np.linalg.eigvalsh(covariance)[-1])  # two standard errors to each side
    assert max(ellipse.width, ellipse.height) == pytest.approx(largest)


def test_scenes_without_positions_or_cuts_say_so(manifest, tmp_path):
    text = '[[formulation]]\nkind = "once"\n[[solver]]\nkind = "sampler"\n[budget]\nevaluations = 8\n'
    path = manifest(text)
    results = nfbench.run(nfbench.load_study(path), out=tmp_path / "out", jobs=0)
    plugin = path.parent / "toy.py"
    for kind in ("scene", "geometry", "landscape"):
        with pytest.raises(NfbenchError):
            drawings(results, only=(kind,), plugins=(plugin,) if plugin.exists() else ())


@pytest.mark.parametrize(
    ("points", "expected"),
    [
        ([[0, 0, 0], [0, 1, 0]], [(0, 1)]),
        ([[0, 0, 0], [1, 1, 0]], [(0, 1)]),
        ([[0, 0, 0], [0, 1, 1]], [(1, 2)]),
        ([[0, 0, 0], [0, 0, 1]], [(0, 2)]),
        ([[0, 0, 0], [1, 1, 1]], [(0, 1), (0, 2)]),
    ],
)
def test_views_are_planes_in_which_something_extends(points, expected):
    assert planes_of(np.array(points, dtype=float)) == expected


def test_latex_code_needs_no_latex_and_has_no_command_of_a_label(field, tmp_path):
    (path,) = write_figures(field, tmp_path, ["tex"], Drawing(only=("error",)))
    code = path.read_text(encoding="utf-8")
    assert r"\textbackslash{}input\{a\}" in code and r"\input{a}" not in code and r"\$5\_x\$" in code
    body = "\n".join(row for row in code.split("\n") if not row.startswith("%"))
    assert body.count(r"\begin{pgfscope}") == body.count(r"\end{pgfscope}") > 10
    assert "3.500000in" in code and str(tmp_path) not in code
    assert (
        path.read_bytes() == write_figures(field, tmp_path / "again", ["tex"], Drawing(only=("error",)))[0].read_bytes()
    )


def test_images_stand_next_to_the_code_that_includes_them(field, tmp_path):
    (path,) = write_figures(field, tmp_path, ["tex"], Drawing(only=("landscape",)))
    names = re.findall(r"\\includegraphics\[width=([0-9.]+)in,height=[0-9.]+in\]\{([^}]+)\}", path.read_text())
    assert names and all((tmp_path / name).read_bytes().startswith(b"\x89PNG") for _, name in names)
    assert all(float(width) < 3.5 for width, _ in names)
