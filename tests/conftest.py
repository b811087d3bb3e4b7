"""What tests of several folders share."""

import textwrap
from pathlib import Path

import jaxtyping
import pytest

# array shapes are checked while tests run, where no test feeds wrong shapes on purpose; before these are imported
jaxtyping.install_import_hook(
    [
        f"nfbench.problems.{name}"
        for name in ("bounds", "channels", "enumeration", "floor", "geometry", "refine", "subspace", "wavefronts")
    ],
    "beartype.beartype",
)

PLUGINS = Path(__file__).parent / "plugins"
PROJECT = Path(__file__).parent.parent


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
