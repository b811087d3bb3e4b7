"""Plugins are found by entry point and by file; what fails to import is named and left out."""

import signal
import time
from importlib.metadata import EntryPoint

import pytest

import nfbench
from nfbench import OptionError, PluginError
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


def test_the_built_in_plugins_register_like_anyones():
    registry = Registry()
    assert {"de"} <= set(registry.names("solver"))
    assert {"nemo", "neef", "direct"} <= set(registry.names("formulation"))
    assert {"near-field", "functions"} <= set(registry.names("scenario"))
    assert registry.find("solver", "de").origin == f"nfbench {nfbench.__version__}"


def test_a_file_gives_every_plugin_in_it_by_its_name(toy_plugin):
    registry = Registry([toy_plugin])
    assert registry.make("solver", "sampler", {"batch": 3}).batch == 3
    assert "not-a-number" in registry.names("formulation")
    assert registry.find("scenario", "toy").origin == "toy.py"
    assert len(registry.find("scenario", "toy").version) == 16


def test_the_version_of_a_file_is_its_content(tmp_path):
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
def test_a_file_that_fails_is_kept_with_its_error_and_the_rest_goes_on(tmp_path, toy_plugin, source, error):
    bad = tmp_path / "bad.py"
    bad.write_text(source)
    registry = Registry([bad, toy_plugin])
    assert error in registry.broken[bad]
    assert "sampler" in registry.names("solver")


def test_a_file_whose_import_does_not_end_is_given_up(tmp_path, monkeypatch):
    (tmp_path / "waits.py").write_text("import time\nwhile True:\n    try: time.sleep(9)\n    except Exception: pass\n")
    monkeypatch.setattr(registry_module, "IMPORT_S", 0.3)
    began, before = time.monotonic(), signal.getsignal(signal.SIGALRM)
    registry = Registry([tmp_path / "waits.py"])
    (why,) = registry.broken.values()
    assert why.startswith("was not imported within 0.3 s") and time.monotonic() - began < 5
    assert signal.getsignal(signal.SIGALRM) is before and signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)


def test_two_plugins_of_one_name_are_an_error(tmp_path):
    (tmp_path / "one.py").write_text(SOLVER.format(name="Mine"))
    (tmp_path / "two.py").write_text(SOLVER.format(name="Mine") + "# other")
    with pytest.raises(PluginError, match=r"two solvers are named 'mine': one from one\.py, one from two\.py"):
        Registry([tmp_path / "one.py", tmp_path / "two.py"])
    (tmp_path / "one.py").write_text(SOLVER.format(name="DE"))
    with pytest.raises(PluginError, match=r"two solvers are named 'de': one from nfbench .*, one from one\.py"):
        Registry([tmp_path / "one.py"])


def test_a_missing_file_and_an_unknown_name_are_named(tmp_path):
    with pytest.raises(PluginError, match=r"no\.py: No such file"):
        Registry([tmp_path / "no.py"])
    with pytest.raises(PluginError, match="unknown formulation 'nemmo'; did you mean \"nemo\""):
        Registry().find("formulation", "nemmo")
    with pytest.raises(PluginError, match=r"unknown solver 'mine'; known: .*; your own is found by --plugin FILE"):
        Registry().find("solver", "mine")


def test_an_entry_point_that_fails_is_named_when_asked_for(monkeypatch):
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


def test_solver_makes_one_by_name():
    assert nfbench.solver("de", population=120).population == 120
    with pytest.raises(OptionError, match='populatoin: unknown option; did you mean "population"'):
        nfbench.solver("de", populatoin=120)
