"""Nine copies of one solver, compared through the command line, are called different as rarely as promised."""

import pandas as pd
import pytest
from scipy.stats import binom
from typer.testing import CliRunner

from nfbench.cli.entry import app

PLUGIN = '''
from dataclasses import dataclass
from nfbench import Solver, SolverInfo

@dataclass(frozen=True)
class Copy(Solver):
    """Samples the box.

    unused: has no effect, except on the seed.
    """

    unused: int = 0
    info = SolverInfo(global_search=True)

    def minimize(self, problem, rng):
        problem.evaluate(rng.uniform(problem.lower, problem.upper, (problem.remaining, problem.dimension)))
'''
STUDY = """
name = "copies"
scenes = 15
seed = {seed}
plugins = ["copy_solver.py"]
[scenario]
kind = "functions"
[targets]
gap = [5.0]
[[formulation]]
kind = "direct"
[budget]
evaluations = 30
"""


def ranked(tmp_path, seed: int, copies: int = 9) -> tuple[pd.DataFrame, str]:
    """Run the study and return ``ranking.csv`` and what the command printed."""
    (tmp_path / "copy_solver.py").write_text(PLUGIN)
    solvers = "".join(f'[[solver]]\nkind = "copy"\nunused = {i}\n' for i in range(copies))
    path = tmp_path / "copies.toml"
    path.write_text(STUDY.format(seed=seed) + solvers)
    out = tmp_path / f"out-{seed}"
    done = CliRunner().invoke(app, ["run", str(path), "--out", str(out), "--jobs", "0"])
    assert done.exit_code == 0, done.output
    return pd.read_csv(out / "ranking.csv"), done.output


def test_equal_methods_stay_in_the_best_set(tmp_path):
    table, output = ranked(tmp_path, seed=1)
    assert len(table) == 9 and table["in_best_set"].all() and table["worse_than"].isna().all()
    assert "not distinguishable from it: " in " ".join(output.split())


@pytest.mark.slow
def test_equal_methods_are_called_different_in_at_most_5_percent_of_studies(tmp_path):
    wrong = 0
    for seed in range(40):
        table, _ = ranked(tmp_path, seed)
        wrong += not table["in_best_set"].all() or bool(table["worse_than"].notna().any())
    assert binom.sf(wrong - 1, 40, 0.05) > 0.001  # as many or more would be very unlikely
