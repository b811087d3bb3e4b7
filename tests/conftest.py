"""What tests of several folders share."""

import os
import subprocess
import sys
import textwrap
from pathlib import Path

import jaxtyping
import pytest

# array shapes are checked while tests run, where no test feeds wrong shapes on purpose; before these are imported
jaxtyping.install_import_hook(
    [
        f"nfbench.problems.near_field.{name}"
        for name in (
            *("bounds", "channels", "enumeration", "floor", "geometry", "subspace", "wavefronts"),
            "estimators.refinement",
        )
    ],
    "beartype.beartype",
)

PLUGINS = Path(__file__).parent / "toy_plugins"
PROJECT = Path(__file__).parent.parent
COMMAND_ENVIRONMENT = {**os.environ, "COLUMNS": "120", "NO_COLOR": "1"}


def nfbench(*arguments, cwd):
    """The command line as a user meets it: in a process of its own."""
    command = [sys.executable, "-m", "nfbench", *map(str, arguments)]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, env=COMMAND_ENVIRONMENT, timeout=120)


@pytest.fixture
def toy_plugin():
    """The file of small scenarios, formulations and solvers."""
    return PLUGINS / "toy.py"


@pytest.fixture
def manifest(tmp_path, toy_plugin):
    """Writes a manifest for the toy plugin: ``manifest(extra)`` returns its path; ``extra`` goes below."""

    def write(extra="", *, repetitions=3, seed=1, scenario="", name="toy", plugins=(), file="toy.toml"):
        files = [str(toy_plugin), *map(str, plugins)]
        head = f'name = "{name}"\nrepetitions = {repetitions}\nseed = {seed}\nplugins = {files!r}\n'
        text = head + f'[scenario]\nkind = "toy"\n{scenario}\n' + textwrap.dedent(extra)
        path = tmp_path / file
        path.write_text(text)
        return path

    return write


BASIC = """
[[formulation]]
kind = "once"
[[solver]]
kind = "sampler"
[budget]
evaluations = 40
"""
