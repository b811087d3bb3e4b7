"""Two small studies with traces, and changes of their folders, for the tests of hits."""

import shutil
import sqlite3

import nfbench
from nfbench import load_study
from nfbench.analysis.targets import Target

FUNCTIONS = """
name = "functions"
scenes = 4
seed = 3
[scenario]
kind = "functions"
function = "sphere"
[sweep]
dimension = [2, 3]
[[formulation]]
kind = "direct"
[[solver]]
kind = "de"
population = 10
[[solver]]
kind = "random-search"
[budget]
evaluations = 400
"""
NEAR_FIELD = """
name = "near-field"
scenes = 3
seed = 3
[scenario]
kind = "near-field"
array = { kind = "ula", elements = 16, spacing_wavelengths = 0.5, origin = "first" }
wavelength_m = 0.1
wavefront = "exact"
sources = 2
snapshots = 20
snr_db = 15.0
rician_k = inf
azimuth_deg = [-60, 60]
range_m = [1.0, 5.0]
[[formulation]]
kind = "neef"
[[formulation]]
kind = "neef"
label = "refined"
refine = true
[[formulation]]
kind = "nemo"
[[formulation]]
kind = "music"
grid = { azimuth = 40, range = 30 }
[[solver]]
kind = "de"
population = 10
[[solver]]
kind = "random-search"
[budget]
evaluations = 300
"""
GAPS = [Target("gap", value) for value in (1.0, 1e-2, 1e-5)]
ERRORS = [Target("error_in_bounds", 30), Target("error", 0.3), Target("error", 5.0)]


def studied(folder, text):
    (folder / "study.toml").write_text(text)
    return nfbench.run(load_study(folder / "study.toml"), out=folder / "out", jobs=0)


def copied(results, folder):
    shutil.copytree(results.folder, folder / "copy")
    (folder / "copy" / "hits.npz").unlink(missing_ok=True)
    return nfbench.Results(folder / "copy")


def changed(results, *statements):
    """Change the store behind our back, as an older version of nfbench would have written it."""
    with sqlite3.connect(results.folder / "runs.sqlite") as db:
        for statement in statements:
            db.execute(*statement)
        db.execute("DELETE FROM meta WHERE key = 'plan_rows'")
    db.close()
    return results
