"""Whether ``nfbench choose`` is right: ``python tests/benchmarks/choices.py [--requests N] [--scenes N] [--new N]``.

A small study is run: five solvers on NEEF, 100 scenes. Random requests are answered from it, and each recommended
method is run on new scenes with the budget of the request. A recommendation is wrong if the share of new scenes that
reach the target lies significantly below the wanted reliability (one-sided exact test at 1 %); the table shows the
shares as well.
The exit code is 1 if more than one in twenty of the recommendations that are called sure is wrong.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.stats import binom

from nfbench import choose, load_study, run
from nfbench.results import Results

SOLVERS = ("de", "cmaes", "nlopt-crs2-lm", "pso", "basin-hopping")
TARGETS = ("bounds=3", "bounds=10", "error=0.3")
STUDY = """
name = "{name}"
scenes = {scenes}
seed = {seed}
[scenario]
kind = "near-field"
array = {{ kind = "ula", elements = 16, spacing_wavelengths = 0.5, origin = "center" }}
wavelength_m = 0.1
wavefront = "exact"
sources = 2
snapshots = 50
snr_db = 15.0
azimuth_deg = [-50, 50]
range_m = [1.0, 4.0]
[targets]
error_in_bounds = [3, 10]
error = [0.3]
[[formulation]]
kind = "neef"
[budget]
evaluations = {evaluations}
"""


def study(folder: Path, name: str, scenes: int, seed: int, evaluations: int, solvers: tuple[str, ...]) -> Results:
    """Run a study and return its results."""
    text = STUDY.format(name=name, scenes=scenes, seed=seed, evaluations=evaluations)
    text += "".join(f'[[solver]]\nkind = "{solver}"\n' for solver in solvers)
    path = folder / f"{name}.toml"
    path.write_text(text, encoding="utf-8")
    return run(load_study(path), out=folder / name, jobs=1)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--requests", type=int, default=20)
    parser.add_argument("--scenes", type=int, default=100)
    parser.add_argument("--new", type=int, default=200, help="new scenes on which a recommendation is run")
    arguments = parser.parse_args()
    rng = np.random.default_rng(2026)
    table = Table("target", "evaluations", "reliability", "recommended", "answer", "share before", "on new scenes", "")
    wrong = sure = 0
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        known = study(folder, "known", arguments.scenes, 1, 3000, SOLVERS)
        for number in range(arguments.requests):
            target = str(rng.choice(TARGETS))
            evaluations = int(10 ** rng.uniform(2.3, 3.48))
            reliability = float(rng.choice([0.5, 0.6, 0.7, 0.8, 0.9]))
            found = choose(known, target=target, evaluations=evaluations, reliability=reliability)
            share = found.frame["share"].iloc[0]
            row = [found.target, f"{evaluations:,}", f"{reliability:g}", found.recommended or "none"]
            if found.recommended is None:
                table.add_row(*row, "nothing does", f"{share:.1%}", "", "")
                continue
            solver = next(name for name in SOLVERS if f"+ {name}" in f"{found.recommended} ")
            fresh = study(folder, f"new-{number}", arguments.new, 1000 + number, evaluations, (solver,))
            again = choose(fresh, target=target, reliability=reliability).frame["share"].iloc[0]
            bad = bool(binom.cdf(round(again * arguments.new), arguments.new, reliability) < 0.01)
            sure += found.sure
            wrong += bad and found.sure
            answer = "sure" if found.sure else "likely"
            table.add_row(*row, answer, f"{share:.1%}", f"{again:.1%}", "too low" if bad else "")
    Console(width=120).print(table)
    print(f"{sure} recommendations are called sure, of which {wrong} reach too few new scenes")
    return 1 if wrong > max(1, sure / 20) else 0


if __name__ == "__main__":
    sys.exit(main())
