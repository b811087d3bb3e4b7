"""Tests that plugins are found by entry point and by file, and that failed imports are reported and left out."""

import signal
import time
from importlib.metadata import EntryPoint

import pytest

import nfbench
from nfbench import OptionError, PluginError
from nfbench.plugins import importing
from nfbench.plugins import registry as registry_module
from nfbench.plugins.registry import Registry

SOLVER = """
from dataclasses import dataclass
from nfbench import Solver

@dataclass(frozen=True)
class {name}(Solver):
    def minimize(self, problem, rng):
        problem(problem.lower)
"""


def test_the_built_in_plugins_are_registered_by_entry_points():
    registry = Registry()
    assert {"de"} <= set(registry.names("solver"))
    assert {"nemo", "neef", "direct"} <= set(registry.names("formulation"))
    assert {"near-field", "functions"} <= set(registry.names("scenario"))
    assert registry.find("solver", "de").origin == f"nfbench {nfbench.__version__}"


def test_every_plugin_in_a_file_is_registered_by_its_name(toy_plugin):
    registry = Registry([toy_plugin])
    assert registry.make("solver", "sampler", {"batch": 3}).batch == 3
    assert "not-a-number" in registry.names("formulation")
    assert registry.find("scenario", "toy").origin == "toy.py"
    assert len(registry.find("scenario", "toy").version) == 16


def test_the_version_of_a_file_depends_on_its_content(tmp_path):
    file = tmp_path / "mine.py"
    versions = set()
    for comment in ("", "# changed", ""):
        file.write_text(SOLVER.format(name="Mine") + comment)
        versions.add(Registry([file]).find("solver", "mine").version)
    assert len(versions) == 2


@pytest.mark.parametrize(
    ("source", "error"),
    [
        ("def broken(:", "SyntaxError"),
        ("import no_such_module", "ModuleNotFoundError: No module named 'no_such_module'"),
        ("raise SystemExit(1)", "SystemExit"),
        (SOLVER.replace("(frozen=True)", "").format(name="Mine"), "put @dataclass(frozen=True) above its classes"),
        ("x = 1", "defines no class derived from nfbench.Solver, Formulation or Scenario"),
    ],
)
def test_a_file_that_fails_is_listed_with_its_error_and_the_others_are_available(tmp_path, toy_plugin, source, error):
    bad = tmp_path / "bad.py"
    bad.write_text(source)
    registry = Registry([bad, toy_plugin])
    assert error in registry.broken[bad]
    assert "sampler" in registry.names("solver")


def test_the_import_of_a_file_has_a_time_limit(tmp_path, monkeypatch):
    (tmp_path / "waits.py").write_text(
        "import time\nwhile True:\n    try: time.sleep(9)\n    except BaseException: pass\n"
    )
    monkeypatch.setattr(importing, "IMPORT_S", 0.3)
    start, handler = time.monotonic(), signal.getsignal(signal.SIGALRM)
    registry = Registry([tmp_path / "waits.py"])
    (reason,) = registry.broken.values()
    assert reason.startswith("was not imported within 0.3 s") and time.monotonic() - start < 5
    assert signal.getsignal(signal.SIGALRM) is handler and signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)


def test_two_plugins_with_the_same_name_are_an_error(tmp_path):
    (tmp_path / "one.py").write_text(SOLVER.format(name="Mine"))
    (tmp_path / "two.py").write_text(SOLVER.format(name="Mine") + "# other")
    with pytest.raises(PluginError, match=r"two solvers are named 'mine': one from one\.py and one from two\.py"):
        Registry([tmp_path / "one.py", tmp_path / "two.py"])
    (tmp_path / "one.py").write_text(SOLVER.format(name="DE"))
    with pytest.raises(PluginError, match=r"two solvers are named 'de': one from nfbench .* and one from one\.py"):
        Registry([tmp_path / "one.py"])


def test_a_missing_file_and_an_unknown_name_are_reported(tmp_path):
    with pytest.raises(PluginError, match=r"no\.py: No such file"):
        Registry([tmp_path / "no.py"])
    with pytest.raises(PluginError, match="unknown formulation 'nemmo'; did you mean \"nemo\""):
        Registry().find("formulation", "nemmo")
    with pytest.raises(PluginError, match=r"unknown solver 'mine'; known: .*; to use your own, pass --plugin FILE"):
        Registry().find("solver", "mine")


def test_an_entry_point_that_fails_is_reported_when_it_is_resolved(monkeypatch):
    points = {
        "nfbench.solvers": [
            EntryPoint("gone", "no_such_module:X", "nfbench.solvers"),
            EntryPoint("wrong", "math:pi", "nfbench.solvers"),
        ]
    }
    monkeypatch.setattr(registry_module, "entry_points", lambda group: points.get(group, []))
    registry = Registry()
    with pytest.raises(PluginError, match="solver gone of unknown failed to import: ModuleNotFoundError"):
        registry.find("solver", "gone").resolve()
    with pytest.raises(PluginError, match=r"expected a frozen dataclass derived from nfbench\.Solver, got 3\.14"):
        registry.find("solver", "wrong").resolve()


def test_solver_returns_a_solver_by_name():
    assert nfbench.solver("de", population=120).population == 120
    with pytest.raises(OptionError, match='populatoin: unknown option; did you mean "population"'):
        nfbench.solver("de", populatoin=120)
