"""Every command and code block of the README works as printed."""

import importlib.util
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pandas as pd
import pytest
from conftest import PROJECT

from nfbench.plugins.registry import Registry

README = (PROJECT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```(\w+)\n(.*?)```", README, flags=re.DOTALL)


def blocks(language):
    return [text for name, text in BLOCKS if name == language]


@pytest.fixture
def clone(tmp_path):
    """A folder as a reader has it after following the README: the studies, and the README's own files."""
    shutil.copytree(PROJECT / "studies", tmp_path / "studies")
    quickstart = tmp_path / "studies" / "quickstart.toml"
    text, changed = re.subn(r"scenes = \d+", "scenes = 1", quickstart.read_text(encoding="utf-8"))
    assert changed == 1
    quickstart.write_text(re.sub(r"evaluations = \d+", "evaluations = 500", text), encoding="utf-8")
    (solver,) = [text for text in blocks("python") if "Solver)" in text]
    (tmp_path / "one_plus_one.py").write_text(solver)
    (study,) = blocks("toml")
    (tmp_path / "my-array.toml").write_text(study)
    return tmp_path


def run(arguments, cwd):
    environment = {**os.environ, "COLUMNS": "120"}
    return subprocess.run(arguments, cwd=cwd, capture_output=True, text=True, timeout=300, env=environment)


def test_the_two_lines_are_there_and_ci_calls_the_second():
    lines = [line for text in blocks("bash") for line in text.splitlines()]
    setups = [line for line in lines if line.startswith("python3 -m venv")]
    assert len(setups) == 2
    assert setups[0].endswith("nfbench run studies/quickstart.toml")
    assert setups[1].endswith(".venv/bin/pytest -n 2 --dist worksteal")
    script = (PROJECT / ".ci" / "run").read_text(encoding="utf-8")
    pattern = re.search(r"grep -m1 -E '(.*)' README\.md", script)[1]
    assert [line for line in README.splitlines() if re.search(pattern, line)] == [setups[1]]


def test_every_nfbench_command_works(clone):
    commands = [line for text in blocks("bash") for line in text.splitlines() if "nfbench " in line]
    commands = [line[line.index("nfbench ") :] for line in commands]
    assert len(commands) >= 3
    for command in commands:
        done = run([sys.executable, "-m", *shlex.split(command)], clone)
        assert done.returncode == 0, (command, done.stdout, done.stderr)
    runs = pd.read_csv(clone / "results" / "quickstart" / "runs.csv")
    assert set(runs.status) == {"ok"} and len(runs) == 16


def test_inline_commands_work(clone):
    inline = set(re.findall(r"`(nfbench (?:list|show)[^`]*)`", README))
    assert inline == {"nfbench list", "nfbench show solver de"}
    for command in inline:
        assert run([sys.executable, "-m", *shlex.split(command)], clone).returncode == 0


def test_the_solver_of_the_readme_is_found_by_its_name_and_in_a_study(clone):
    text = next(text for text in blocks("python") if "Solver)" in text)
    code = [line for line in text.splitlines() if line.strip()]
    assert len(code) <= 17
    registry = Registry([clone / "one_plus_one.py"])
    assert "one-plus-one" in registry.names("solver")
    study = (clone / "my-array.toml").read_text() + '\n[[solver]]\nkind = "one-plus-one"\n'
    (clone / "my-array.toml").write_text(study)
    command = ["run", "my-array.toml", "--plugin", "one_plus_one.py", "--out", "out"]
    done = run([sys.executable, "-m", "nfbench", *command], clone)
    assert done.returncode == 0 and "nemo + one-plus-one" in done.stdout


def test_python_blocks_run(clone):
    for text in blocks("python"):
        done = run([sys.executable, "-c", text], clone)
        assert done.returncode == 0, (text, done.stderr)


def test_the_mistake_shown_is_reported_so(clone):
    study = (clone / "my-array.toml").read_text().replace('kind = "de"\n', 'kind = "de"\npopulatoin = 3\n')
    (clone / "my-array.toml").write_text(study)
    done = run([sys.executable, "-m", "nfbench", "run", "my-array.toml"], clone)
    assert done.returncode == 2
    shown = re.search(r"`(solver\[0\]\.populatoin: .*?)`", README)[1]
    assert shown in done.stderr


def test_links_lead_somewhere():
    for target in re.findall(r"\]\(([^)#]+)\)", README):
        if "://" not in target:
            assert (PROJECT / target).exists(), target


def test_the_optimizers_study_holds_every_solver_of_the_base_install():
    study = tomllib.loads((PROJECT / "studies" / "optimizers.toml").read_text(encoding="utf-8"))
    registry = Registry()
    plugins = {name: registry.find("solver", name) for name in registry.names("solver")}
    ours = {name for name, plugin in plugins.items() if plugin.origin.startswith("nfbench ")}
    ours -= {name for name in ours if plugins[name].resolve().info.extra}
    assert {solver["kind"] for solver in study["solver"]} == ours


@pytest.mark.parametrize("path", sorted((PROJECT / "studies").rglob("*.toml")), ids=lambda path: path.stem)
def test_every_study_is_valid(path, monkeypatch):
    from nfbench import ManifestError, load_study

    data = PROJECT / ".." / "shared" / "data"
    if path.stem in ("measured", "recorded"):
        if not data.is_dir():
            pytest.skip(f"the measured data are not in {data}")
        monkeypatch.setenv("NFBENCH_DATA", str(data))
    if path.stem == "bbob" and not importlib.util.find_spec("cocoex"):
        with pytest.raises(ManifestError, match=r"not installed here: pip install 'nfbench\[coco\]'") as caught:
            load_study(Path(path))
        assert len(caught.value.problems) == 1
        return
    study = load_study(Path(path))
    assert study.expect and study.title and len(list(study.specs())) == len(study)
