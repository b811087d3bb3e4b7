"""A Solution stores columns beside the scores, and cannot replace a score."""

import math

import pytest

import nfbench
from nfbench.execution.storable import Unstorable, plain_columns


def test_columns_are_numbers_and_no_names_of_scores():
    assert plain_columns({"certified": True, "gap_m": 0}, {"rmse_m": 1.0}) == {"certified": 1.0, "gap_m": 0.0}
    for columns in ({"rmse_m": 2.0}, {"status": 1.0}, {"a": "text"}, [1.0]):
        with pytest.raises(Unstorable):
            plain_columns(columns, {"rmse_m": 1.0})


PLUGIN = '''
from dataclasses import dataclass
from typing import ClassVar
import numpy as np
from nfbench import Formulation, Solution
from nfbench.problems.functions import ProblemInstance

@dataclass(frozen=True)
class Telling(Formulation):
    """Says more than its estimate."""
    accepts: ClassVar = ProblemInstance
    needs_solver: ClassVar = False
    column: str = "std_1_m"
    def solve(self, instance, minimize):
        return Solution(np.zeros(2), {self.column: 0.25})

formulations = {"telling": Telling}
'''

MANIFEST = """
name = "s"
scenes = 2
seed = 1
plugins = ["telling.py"]
[scenario]
kind = "functions"
function = "sphere"
dimension = 2
[[formulation]]
kind = "telling"
[[formulation]]
kind = "telling"
column = "gap"
"""


def test_a_study_stores_the_columns_of_a_solution(tmp_path):
    (tmp_path / "telling.py").write_text(PLUGIN)
    (tmp_path / "s.toml").write_text(MANIFEST)
    runs = nfbench.run(nfbench.load_study(tmp_path / "s.toml"), out=tmp_path / "out", jobs=0).runs
    good = runs[runs["status"] == "ok"]
    assert good["std_1_m"].tolist() == [0.25, 0.25]
    bad = runs[runs["status"] == "invalid"]
    assert len(bad) == 2 and bad["message"].str.contains("'gap' is the name of a score").all()
    assert all(math.isnan(value) for value in bad["std_1_m"])
