"""Fixtures and helpers that tests in several folders share."""

import os
import subprocess
import sys
import textwrap
from pathlib import Path

import jaxtyping
import numpy as np
import pytest

# Check array shapes during the tests, except in modules that some test calls with wrong shapes on purpose. The hook
# must be installed before these modules are imported.
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

STATES: dict[str, dict] = {}  # of the generator RNG of each test module, as it was before the first test

PLUGINS = Path(__file__).parent / "toy_plugins"
PROJECT = Path(__file__).parent.parent
COMMAND_ENVIRONMENT = {**os.environ, "COLUMNS": "120", "NO_COLOR": "1"}


def nfbench(*arguments, cwd, timeout=120):
    """Run the command line in a separate process, as a user does."""
    command = [sys.executable, "-m", "nfbench", *map(str, arguments)]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, env=COMMAND_ENVIRONMENT, timeout=timeout)


@pytest.fixture(autouse=True)
def same_random_numbers_in_any_order(request):
    """Each test begins with the same random numbers of its module's generator RNG, whatever ran before."""
    rng = getattr(request.module, "RNG", None)
    if isinstance(rng, np.random.Generator):
        rng.bit_generator.state = STATES.setdefault(request.module.__name__, rng.bit_generator.state)


@pytest.fixture
def toy_plugin():
    """The path of the plugin file with small scenarios, formulations and solvers."""
    return PLUGINS / "toy.py"


@pytest.fixture
def manifest(tmp_path, toy_plugin):
    """A function that writes a manifest for the toy plugin, with ``extra`` at its end, and returns its path."""

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
