"""In a real Chromium the page draws its figures without a message in the console, on a phone, and in dark and light."""

import re
import shutil
import subprocess

import numpy as np
import pandas as pd
import pytest
from PIL import Image
from small_study import run_in

from nfbench.report import html_report

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed")
FIGURES = ["figure-measures", "figure-ert", "figure-distribution", "figure-progress", "scene-draw", "scene-detail"]
DARK = "--blink-settings=preferredColorScheme=0"

PROBE = """
addEventListener("load", () => setTimeout(() => {
  const inside = document.querySelector("iframe").contentDocument;
  const find = (selector) => inside.querySelector(selector);
  const say = (name, value) => document.body.setAttribute(`data-${name}`, value);
  say("width", inside.documentElement.scrollWidth);
  const before = find("#figure-measures canvas").toDataURL();
  find("#figure-measures button.key").focus();
  inside.activeElement.click();
  say("pressed", inside.activeElement.getAttribute("aria-pressed"));
  say("redrawn", find("#figure-measures canvas").toDataURL() !== before);
  find("#figure-distribution .plot").dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowRight" }));
  say("read", find("#figure-distribution .readout").textContent);
  find("#methods-table thead th:first-child button").click();
  say("sorted", find("#methods-table tbody th").textContent);
  find("#methods-table thead th:first-child button").click();
  say("reversed", find("#methods-table tbody th").textContent);
  find("#methods input[type=search]").value = "random";
  find("#methods input[type=search]").dispatchEvent(new Event("input"));
  say("filtered", [...inside.querySelectorAll("#methods-table tbody tr")].filter((row) => !row.hidden).length);
  const named = [...inside.querySelectorAll("select, input")].every((each) => each.labels.length === 1);
  say("named", named);
  say("point", find("#scene-map select").selectedOptions[0].textContent);
  say("ert", [...find("#figure-ert .controls").querySelectorAll("select")].at(-1).selectedOptions[0].textContent);
  say("scene", find("#scene-map tbody th").textContent);
  say("far", find("#scene-map tbody tr td:nth-of-type(3)").textContent);
}, 1500));
"""


# The ticks of logarithmic axes of many limits and lengths: the smallest gap between two labels, and the fewest ticks.
TICKS = """
const gaps = [], counts = [];
for (const pixels of [176, 300, 900])
  for (const low of [1e-7, 0.013, 0.2, 3, 70])
    for (const ratio of [1.7, 4, 9, 60, 800, 3e4, 1e12]) {
      const high = low * ratio, ticks = NF.logSplits(low, high, pixels, 50);
      counts.push(ticks.length);
      if (ticks.some((v) => v < low || v > high)) gaps.push(-1);
      ticks.slice(1).forEach((v, i) => gaps.push((Math.log(v / ticks[i]) / Math.log(ratio)) * pixels));
    }
document.body.setAttribute("data-gap", Math.min(...gaps));
document.body.setAttribute("data-fewest", Math.min(...counts));
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with the page, a frame of the width of a phone around it that reports on it, and the results."""
    folder = tmp_path_factory.mktemp("page")
    page = html_report(run_in(folder))
    (folder / "page.html").write_text(page, encoding="utf-8")
    (folder / "ticks.html").write_text(page.replace("</body>", f"<script>{TICKS}</script></body>"), encoding="utf-8")
    frame = '<body style="margin:0"><iframe src="page.html" style="width:390px;height:6000px;border:0"></iframe>'
    (folder / "frame.html").write_text(frame)
    (folder / "phone.html").write_text(f"{frame}<script>{PROBE}</script>")
    return folder


def chromium(folder, name, *options):
    """Open a file; returns what is printed, and the messages of the console."""
    flags = ["--headless", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr", "--hide-scrollbars"]
    profile = [f"--user-data-dir={folder / 'profile'}", "--virtual-time-budget=8000", "--allow-file-access-from-files"]
    command = [CHROMIUM, *flags, *profile, *options, (folder / name).as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    return done.stdout, re.findall(r".*CONSOLE.*", done.stderr)


def test_all_figures_are_drawn_without_a_message(folder):
    document, messages = chromium(folder, "page.html", "--dump-dom", "--window-size=1280,2000")
    assert messages == []
    parts = {name: document.split(f'id="{name}"', 1)[1][:200_000] for name in FIGURES}
    for name, part in parts.items():
        assert "<canvas" in part.split("<section", 1)[0], name
    assert 'href="data:image/png;base64,' in document
    shown = document.split('<script type="application/json"', 1)[0]
    assert "[object" not in shown and "undefined" not in shown
    landscapes = shown.split('id="scene-landscapes"', 1)[1].split("</section", 1)[0]
    assert landscapes.count("<image") == 3 and landscapes.count("<path") == 2 * 3  # a star has a dark outline
    assert re.search(r'id="methods-table">.*?<tbody><tr.*?neef \+ de', document, re.DOTALL)


def test_a_message_would_be_noticed(folder):
    (folder / "broken.html").write_text("<script>missing()</script>")
    assert "missing is not defined" in chromium(folder, "broken.html", "--dump-dom")[1][0]


def test_a_phone_shows_all_without_scrolling_sideways_and_controls_work(folder):
    document, messages = chromium(folder, "phone.html", "--dump-dom", "--window-size=800,6000")
    assert messages == []
    found = dict(re.findall(r'data-(\w+)="([^"]*)"', document))
    assert int(found["width"]) <= 390
    assert found["pressed"] == "false"  # the button that was pressed keeps the focus
    assert found["redrawn"] == "true"
    assert re.search(r"neef \+ .*: runs that reach error ≤ 3 bounds \[%\] \S+ at evaluations", found["read"])
    assert found["sorted"].endswith("neef + de") and found["reversed"].endswith("neef + random-search")
    assert (found["filtered"], found["named"]) == ("1", "true")


def test_the_table_of_scenes_opens_where_most_scenes_are_missed(folder):
    hits = pd.read_csv(folder / "out" / "targets.csv").query("target == 'error ≤ 3 bounds'")
    shares = hits.groupby("scenario.snr_db")["hits"].sum()
    assert shares.idxmin() != shares.index[0]  # not the point that comes first anyway
    document, _ = chromium(folder, "phone.html", "--dump-dom", "--window-size=800,6000")
    places = dict(re.findall(r'data-(point|ert)="([^"]*)"', document))
    assert places["point"] == places["ert"] == f"SNR = {shares.idxmin():.0f} dB"


def test_the_table_of_scenes_says_how_far_the_sources_are(folder):
    document, _ = chromium(folder, "phone.html", "--dump-dom", "--window-size=800,6000")
    found = dict(re.findall(r'data-(scene|far)="([^"]*)"', document))
    positions = pd.read_csv(folder / "out" / "positions.csv").query(f"scene == {found['scene']}").iloc[0]
    distance = np.linalg.norm(positions[["true_x_m", "true_y_m", "true_z_m"]].to_numpy(dtype=float))
    assert float(found["far"]) == pytest.approx(distance, rel=0.01)


def test_labels_of_logarithmic_axes_do_not_overlap(folder):
    document, messages = chromium(folder, "ticks.html", "--dump-dom", "--window-size=800,2000")
    found = dict(re.findall(r'data-(gap|fewest)="([^"]*)"', document))
    assert messages == [] and float(found["gap"]) >= 45 and int(found["fewest"]) >= 1


@pytest.mark.parametrize("name, width", [("page.html", 1280), ("frame.html", 500)])
def test_dark_and_light_pages_have_dark_and_light_pixels(folder, name, width):
    means = []
    for options in ([], [DARK]):
        picture = folder / "shot.png"
        chromium(folder, name, f"--screenshot={picture}", f"--window-size={width},3000", *options)
        pixels = np.asarray(Image.open(picture).convert("L"), dtype=float)[:, : min(width, 390)]
        assert pixels.std() > 10  # there is text and there are figures
        means.append(pixels.mean())
    assert means[0] > 170 and means[1] < 90
