"""
Run a study and draw its figures
================================

A manifest describes scenes, methods and budgets. Running it writes a folder with one row per run. Tables and
figures are made from that folder.
"""

# %%
# A small study: two sources in front of 32 elements, three SNRs, three methods, eight scenes at each SNR. On the
# command line it would be ``nfbench run small.toml``.

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt

import nfbench
from nfbench.figures import Drawing, write_figures

MANIFEST = """
name = "small"
title = "Two sources, 32 elements"
scenes = 8
seed = 1

[scenario]
kind = "near-field"
array = { kind = "ula", elements = 32, spacing_wavelengths = 0.25, origin = "center" }
wavelength_m = 0.02
sources = 2
snapshots = 100
snr_db = 10.0
azimuth_deg = [-60, 60]
range_m = [0.2, 1.0]
min_separation_deg = 5.0

[sweep]
snr_db = [0, 10, 20]

[[formulation]]
kind = "nemo"
budget = { evaluations = 3000 }
[[formulation]]
kind = "neef"
budget = { evaluations = 6000 }
[[formulation]]
kind = "music"
grid = { azimuth = 200, range = 200 }

[[solver]]
kind = "de"
"""

folder = Path(tempfile.mkdtemp())
(folder / "small.toml").write_text(MANIFEST)
study = nfbench.load_study(folder / "small.toml")
print(len(study), "runs")

# %%
# ``jobs=0`` runs in this process, which suits a notebook. Without it, each run has a worker process of its own.

results = nfbench.run(study, out=folder / "results", jobs=0)
results.summary()[["scenario.snr_db", "method", "rmse_m", "median_m", "crb_m", "evaluations"]].round(4)

# %%
# Two of the figures of ``nfbench figure DIR``. The first one shows the error against what was swept, with the
# Cramér–Rao bound. With eight scenes, and a box that limits the range, an RMSE can lie below the bound.

how = Drawing(width="double", only=("error", "runtime"))
error, runtime = write_figures(results, folder / "figures", ["png"], how)


def show(path):
    image = plt.imread(path)
    figure = plt.figure(figsize=(8, 8 * image.shape[0] / image.shape[1]))
    axes = figure.add_axes((0, 0, 1, 1))
    axes.imshow(image)
    axes.set_axis_off()
    plt.show()


show(error)

# %%
# The second one shows the time per run against the error, with one panel per SNR.

show(runtime)

# %%
# ``results.runs`` has every run, as a pandas frame. The columns are explained in :doc:`/reference/columns`.

runs = results.runs
runs[["method", "scene", "scenario.snr_db", "rmse_m", "error_1_m", "error_2_m", "status"]].head(6).round(4)
