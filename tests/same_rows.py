"""Shows that a change of the code changed no result: makes the same studies with two revisions and compares the rows.

    python tests/same_rows.py REVISION [--folder DIR]

Both the given git revision and the checkout as it stands are installed into DIR, without their dependencies. Each then
runs the quickstart study, ten scenes of studies/niching.toml, and a small study of every registered solver on every
scenario that needs no extra. Every column of ``runs.csv`` is compared as text, except times, which no two runs share,
and messages, whose wording may change. What DIR already holds of the revision is not computed again.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import pandas as pd

from nfbench.plugins import Registry

REPOSITORY = Path(__file__).parents[1]
IGNORED = ("runtime_s", "cpu_s", "message", "evaluation_s", "batches", "batched")
NEAR_FIELD = """
kind = "near-field"
array = { kind = "ula", elements = 32, spacing_wavelengths = 0.5, origin = "center" }
wavelength_m = 0.02
wavefront = "exact"
sources = 2
snapshots = 20
snr_db = 15.0
azimuth_deg = [-60, 60]
range_m = [0.5, 5.0]
"""
FUNCTIONS = """
kind = "functions"
function = "rastrigin"
dimension = 3
"""


def manifests(folder: Path) -> list[Path]:
    """The manifests that both revisions run, written to ``folder``."""
    quickstart = (REPOSITORY / "studies/quickstart.toml").read_text(encoding="utf-8")
    niching = (REPOSITORY / "studies/niching.toml").read_text(encoding="utf-8")
    registry = Registry()
    solvers = [name for name in registry.names("solver") if not registry.find("solver", name).missing()]
    texts = {
        "quickstart": quickstart,
        "niching": re.sub(r"(?m)^(repetitions|scenes) = \d+", r"\1 = 10", niching),
        "every-near-field": small_study("every-near-field", NEAR_FIELD, ("nemo", "neef"), solvers)
        + '[[formulation]]\nkind = "nemo-niching"\n[[formulation]]\nkind = "grid-refine"\n'
        + '[[formulation]]\nkind = "music"\ngrid = { azimuth = 60, range = 80 }\n',
        "every-function": small_study("every-function", FUNCTIONS, ("direct",), solvers),
    }
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, text in texts.items():
        paths.append(folder / f"{name}.toml")
        paths[-1].write_text(text, encoding="utf-8")
    return paths


def small_study(name: str, scenario: str, formulations: tuple[str, ...], solvers: list[str]) -> str:
    """Two scenes of one scenario for every solver."""
    parts = [f'name = "{name}"\nrepetitions = 2\nseed = 5\n[budget]\nevaluations = 300\n[scenario]{scenario}']
    parts += [f'[[solver]]\nkind = "{solver}"\n' for solver in solvers]
    parts += [f'[[formulation]]\nkind = "{formulation}"\n' for formulation in formulations]
    return "".join(parts)


def installed(folder: Path, source: Path) -> Path:
    """The folder into which ``source`` is installed, without dependencies."""
    site = folder / "site"
    subprocess.run(
        [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--upgrade", "--target", site, source], check=True
    )
    return site


def exported(revision: str, folder: Path) -> Path:
    """The files of a git revision."""
    source = folder / "source"
    source.mkdir(parents=True)
    archive = subprocess.run(["git", "-C", REPOSITORY, "archive", revision], check=True, stdout=subprocess.PIPE).stdout
    subprocess.run(["tar", "-x", "-C", source], input=archive, check=True)
    return source


def rows(site: Path, manifest: Path, out: Path) -> pd.DataFrame:
    """The rows of a study as text, made by the package in ``site``."""
    environment = {**os.environ, "PYTHONPATH": str(site), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "nfbench", "run", str(manifest), "--out", str(out), "--quiet"]
    subprocess.run(command, env=environment, cwd=out.parent, check=False)
    return pd.read_csv(out / "runs.csv", dtype=str, keep_default_na=False).drop(columns=list(IGNORED), errors="ignore")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("revision", help="the git revision to compare with")
    parser.add_argument("--folder", type=Path, help="where to work; default: a temporary folder")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = (arguments.folder or Path(temporary)).resolve()
        base, here = folder / f"base-{arguments.revision}", Path(tempfile.mkdtemp(dir=temporary))
        base_site = base / "site" if (base / "site").is_dir() else installed(base, exported(arguments.revision, base))
        here_site = installed(here, REPOSITORY)
        different = 0
        for manifest in manifests(base / "manifests"):
            old = rows(base_site, manifest, base / manifest.stem)
            new = rows(here_site, manifest, here / manifest.stem)
            same = old.equals(new)
            different += not same
            print(f"{manifest.stem}: {len(new)} rows, {'identical' if same else 'DIFFERENT'}", flush=True)
            if not same:
                report(old, new)
    return 1 if different else 0


def report(old: pd.DataFrame, new: pd.DataFrame) -> None:
    """Print which columns and methods differ."""
    if list(old.columns) != list(new.columns) or len(old) != len(new):
        print(f"  {len(old)} and {len(new)} rows; columns {sorted({*old.columns} ^ {*new.columns})} on one side only")
        return
    unequal = old != new
    for column in unequal.columns[unequal.any()]:
        print(f"  {column}: {', '.join(sorted(set(old['method'][unequal[column]])))}")


if __name__ == "__main__":
    sys.exit(main())
