"""Tests that plausible wrong input gets a warning that names it, and that usual input gets none."""

import importlib.util
import re
import textwrap
from pathlib import Path

import pytest
from conftest import BASIC, PROJECT, nfbench

from nfbench import Formulation, Scenario, load_study

STUDIES = sorted((PROJECT / "studies").rglob("*.toml"))
DATA = PROJECT / ".." / "shared" / "data"  # of the studies of measured data


@pytest.mark.parametrize("path", STUDIES, ids=lambda path: path.stem)
def test_the_studies_have_no_warnings(path, monkeypatch):
    if path.stem == "bbob" and not importlib.util.find_spec("cocoex"):
        pytest.skip("needs COCO")
    if path.stem in ("measured", "recorded"):
        if not DATA.is_dir():
            pytest.skip(f"the measured data are not in {DATA}")
        monkeypatch.setenv("NFBENCH_DATA", str(DATA))
    missing = "which is not installed here"  # of an optional library in a group
    assert [text for text in load_study(path).warnings if missing not in text] == []


def test_the_manifests_of_the_readme_have_no_warnings(tmp_path):
    readme = (PROJECT / "README.md").read_text(encoding="utf-8")
    blocks = [block for block in re.findall(r"```toml\n(.*?)```", readme, flags=re.DOTALL) if "[scenario]" in block]
    assert blocks
    for i, block in enumerate(blocks):
        path = tmp_path / f"{i}.toml"
        path.write_text(block, encoding="utf-8")
        assert load_study(path).warnings == ()


def test_scenarios_and_formulations_have_no_warnings_by_default():
    assert Scenario.warnings(None) == [] and Formulation.warnings(None, None) == []


SUSPICIOUS = """
from dataclasses import dataclass
from typing import ClassVar
import numpy as np
from nfbench import Formulation, Scenario, Instance, Problem

class Empty(Instance):
    def score(self, estimate):
        return {"rmse_m": 0.0}

@dataclass(frozen=True)
class Suspect(Scenario):
    instance = Empty
    size: int = 1
    def draw(self, rng):
        return Empty()
    def warnings(self):
        if self.size == 7:
            raise RuntimeError("no \\x1b idea")
        if self.size == 8:
            return None
        return ["size: same\\x1b[31m\\nfor all", f"size: {self.size}"]

@dataclass(frozen=True)
class Plain(Formulation):
    accepts: ClassVar[type] = Empty
    needs_solver = False
    def solve(self, instance, minimize):
        return np.zeros(1)
    def warnings(self, scenario):
        return [f"grid: {scenario.size}"]

@dataclass(frozen=True)
class Optional(Plain):
    warnings: tuple[str, ...] = ("an option",)
"""


def suspicious(tmp_path, sweep, extra=""):
    (tmp_path / "suspicious.py").write_text(SUSPICIOUS)
    text = f"""
        name = "s"
        repetitions = 2
        seed = 1
        plugins = ["suspicious.py"]
        [scenario]
        kind = "suspect"
        [sweep]
        size = {sweep}
        [[formulation]]
        kind = "plain"
    """
    path = tmp_path / "s.toml"
    path.write_text(textwrap.dedent(text) + extra)
    return path


def test_warnings_are_collected_once_in_one_line_and_printed(tmp_path):
    path = suspicious(tmp_path, [1, 2])
    expected = (
        "scenario: size: same\\x1b[31m for all",
        "scenario: size: 1",
        "scenario: size: 2",
        "plain: grid: 1",
        "plain: grid: 2",
    )
    assert load_study(path).warnings == expected
    done = nfbench("run", path, "--quiet", cwd=tmp_path)
    assert done.returncode == 0
    for text in expected:
        assert f"nfbench: {text}" in done.stderr.splitlines()


def test_a_method_that_fails_to_warn_is_named(tmp_path):
    found = load_study(suspicious(tmp_path, [7, 8])).warnings
    assert found[0].startswith("scenario: its method `warnings` failed: RuntimeError: no \\x1b idea")
    assert found[1].startswith("scenario: its method `warnings` failed: TypeError")


def test_an_option_named_warnings_is_no_method(tmp_path):
    study = load_study(suspicious(tmp_path, [1], '[[formulation]]\nkind = "optional"\nwarnings = ["a"]\n'))
    assert [text for text in study.warnings if "optional" in text] == []


def test_many_warnings_are_counted(tmp_path):
    found = load_study(suspicious(tmp_path, [*range(100, 140)])).warnings
    assert len(found) == 21 and found[-1] == "61 more warnings of the scenario and the formulations"


def test_a_manifest_of_the_toy_plugin_has_no_warnings(manifest):
    assert load_study(manifest(BASIC)).warnings == ()
    assert Path(manifest(BASIC)).exists()


ENDING = """
import os
from dataclasses import dataclass
from nfbench import Formulation, Instance

@dataclass(frozen=True)
class Ending(Formulation):
    \"\"\"Ends the process that asks for warnings.\"\"\"
    accepts = Instance

    def warnings(self, scenario):
        os._exit(3)

    def solve(self, instance, minimize):
        return instance.truth()
"""


def test_a_plugin_that_ends_the_process_when_asked_for_warnings_is_a_warning(manifest, tmp_path):
    (tmp_path / "ending.py").write_text(ENDING)
    study = load_study(manifest(BASIC.replace('"once"', '"ending"'), plugins=[tmp_path / "ending.py"]))
    (warning,) = study.warnings
    assert "ended the process with exit code 3 while it was asked for warnings" in warning


def test_a_formulation_of_a_broken_file_fails_its_own_rows_only(tmp_path):
    (tmp_path / "ending.py").write_text("import nothing_of_this_name\n" + ENDING)
    path = tmp_path / "study.toml"
    path.write_text(
        'name = "broken"\nscenes = 1\nseed = 1\nplugins = ["ending.py"]\n[scenario]\nkind = "functions"\n'
        '[[formulation]]\nkind = "direct"\n[[formulation]]\nkind = "ending"\n[[solver]]\nkind = "de"\n'
        "[budget]\nevaluations = 50\n"
    )
    study = load_study(path)
    assert [method.formulation.broken is None for method in study.methods] == [True, False]
    assert any("ending.py is left out: ModuleNotFoundError" in text for text in study.warnings)
