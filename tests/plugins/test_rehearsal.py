"""Guards the process that reads a manifest: constructing or describing a plugin of a file may not end or hang it."""

import contextlib
import os
import subprocess
import sys
import time
import warnings
from pathlib import Path

import pytest

from nfbench import OptionError, PluginError
from nfbench.plugins import Registry, registry, rehearsal, rehearse

ACTS = '''
import ctypes, faulthandler, os, signal, sys, time
from dataclasses import dataclass
from typing import Annotated
from pydantic import AfterValidator
from nfbench import BudgetExhausted, Incompatible, OptionError, Solver

class Unreadable(Exception):
    def __str__(self):
        raise KeyboardInterrupt

def raises(error):
    raise error

def odd():
    error = OptionError("x", [("a", "b")])
    error.problems = [1]
    return error

def fork_a_sleeper():
    if not os.fork():
        time.sleep(3600)

def wait():
    while True:
        try:
            time.sleep(1)
        except BaseException:
            pass

ACTS = {
    "nothing": lambda: None,
    "exit 0": lambda: os._exit(0),
    "exit 3": lambda: os._exit(3),
    "kill": lambda: os.kill(os.getpid(), 9),
    "real-time": lambda: os.kill(os.getpid(), 40),
    "terminate group": lambda: os.kill(0, 15),
    "segfault": lambda: ctypes.string_at(0),
    "sys.exit": lambda: sys.exit("bye"),
    "interrupt": lambda: raises(KeyboardInterrupt()),
    "generator": lambda: raises(GeneratorExit()),
    "memory": lambda: raises(MemoryError()),
    "base": lambda: raises(BaseException("\\x1b[31m [/]")),
    "budget": lambda: raises(BudgetExhausted()),
    "incompatible": lambda: raises(Incompatible("no")),
    "unreadable": lambda: raises(Unreadable()),
    "odd": lambda: raises(odd()),
    "key": lambda: raises(KeyError("k")),
    "value": lambda: raises(ValueError("too much")),
    "later": lambda: faulthandler.dump_traceback_later(0.2, exit=True),
    "directory": lambda: os.chdir("/"),
    "descriptors": lambda: os.closerange(0, 4096),
    "a file": lambda: os.close(max(number for number in range(3, 60) if os.path.exists(f"/proc/self/fd/{number}"))),
    "sleeper": fork_a_sleeper,
    "sleeper and exit": lambda: (fork_a_sleeper(), os._exit(4)),
    "wait": wait,
    "stop": lambda: os.kill(os.getpid(), signal.SIGSTOP),
}

def act(what):
    ACTS[what]()
    return what

class Base(Solver):
    def minimize(self, problem, rng):
        problem(problem.lower)

@dataclass(frozen=True)
class Validates(Base):
    """Acts in validate."""
    what: str = "nothing"

    def validate(self):
        act(self.what)

@dataclass(frozen=True)
class Starts(Base):
    """Acts in __post_init__."""
    what: str = "nothing"

    def __post_init__(self):
        super().__post_init__()
        act(self.what)

@dataclass(frozen=True)
class Checks(Base):
    """Acts in the check of an option."""
    what: Annotated[str, AfterValidator(act)] = "nothing"
'''
PLUGINS = ["validates", "starts", "checks"]
ENDS = {
    "exit 0": "ended the process with exit code 0 while it was made; ",
    "exit 3": "ended the process with exit code 3 while it was made; ",
    "kill": "ended the process by signal 9 (SIGKILL) while it was made; ",
    "real-time": "ended the process by signal 40 (SIGRTMIN+6) while it was made; ",
    "terminate group": "ended the process by signal 15 (SIGTERM) while it was made; ",
    "segfault": "ended the process by signal 11 (SIGSEGV) while it was made; ",
    "interrupt": "KeyboardInterrupt",
    "memory": "MemoryError",
    "base": "BaseException: \\x1b[31m [/] (acts.py:",
    "unreadable": "KeyboardInterrupt",
    "directory": "changes its process (the working directory) while it is made; ",
    "descriptors": "ended the process ",
    "a file": "changes its process (a standard stream) while it is made; ",
    "later": "changes its process (the timer of faulthandler) while it is made; ",
    "sleeper": "changes its process (a child process that is left) while it is made; ",
    "sleeper and exit": "ended the process with exit code 4 while it was made; ",
}
RAISES = {
    "sys.exit": "SystemExit: bye",
    "generator": "GeneratorExit",
    "budget": "BudgetExhausted",
    "incompatible": "Incompatible: no",
}


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "acts.py"
    path.write_text(f"{ACTS}\n# {tmp_path}\n")  # a version of its own, as results are remembered by version
    return path


@pytest.fixture
def plugins(file):
    return Registry([file])


@pytest.mark.parametrize("name", PLUGINS)
def test_what_would_end_this_process_is_reported_with_the_plugin_and_its_options(plugins, name):
    for what, reason in ENDS.items():
        with pytest.raises(PluginError) as raised:
            plugins.make("solver", name, {"what": what})
        assert str(raised.value).startswith(f"solver {name} of acts.py cannot be made with what = {what!r}: {reason}")
    assert plugins.make("solver", name, {}).what == "nothing"  # it is the options' fault, not the class's


@pytest.mark.parametrize("name", PLUGINS)
def test_any_exception_is_an_error_of_the_plugin(plugins, name):
    for what, reason in RAISES.items():
        with pytest.raises(PluginError, match=f"^solver {name} cannot be made: {reason}.* \\(acts.py:"):
            plugins.make("solver", name, {"what": what})


ALL = """
import gc, os, sys
from nfbench import PluginError
from nfbench.plugins import Registry
registry = Registry([sys.argv[1]])
for what in sys.argv[2:]:
    try:
        registry.make("solver", "validates", {"what": what})
        print("made", what)
    except PluginError:
        pass
if sys.argv[2] != "nothing":
    del registry
    gc.collect()
    try:
        os.waitpid(-1, os.WNOHANG)
        print("a child is left")
    except ChildProcessError:
        pass
"""


@pytest.mark.parametrize("acts", [["nothing", "exit 3"], ["sleeper", "sleeper and exit", "descriptors"], ["nothing"]])
def test_no_process_is_left(file, acts, monkeypatch):
    monkeypatch.setenv("NFBENCH_TEST", str(file))
    done = subprocess.run([sys.executable, "-c", ALL, file, *acts], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0 and done.stdout.replace("made nothing\n", "") == "", done.stdout + done.stderr
    environments = []
    for path in Path("/proc").glob("[0-9]*/environ"):
        with contextlib.suppress(OSError):
            environments.append(path.read_bytes())
    marker = f"NFBENCH_TEST={file}".encode()
    assert sum(marker in text for text in environments) <= 1  # this process itself may have it


def test_an_exception_in_the_check_of_an_option_names_the_option(plugins):
    with pytest.raises(PluginError, match=r"Checks: what: the check of this option failed: KeyError: 'k' \(acts.py"):
        plugins.make("solver", "checks", {"what": "key"})


@pytest.mark.parametrize(("name", "path"), [("validates", ""), ("checks", "what")])
def test_an_ordinary_error_is_still_one_of_the_option(plugins, name, path):
    with pytest.raises(OptionError) as raised:
        plugins.make("solver", name, {"what": "value"})
    assert raised.value.problems == [(path, "too much")]


def test_an_option_error_that_holds_anything_is_reported(plugins):
    with pytest.raises(PluginError, match=r"solver validates.* cannot be made.*TypeError"):
        plugins.make("solver", "validates", {"what": "odd"})


@pytest.mark.parametrize("what", ["wait", "stop"])
def test_a_hang_has_a_time_limit_which_does_not_add_up(plugins, what, monkeypatch):
    monkeypatch.setattr(registry, "MAKE_S", 0.5)
    monkeypatch.setattr(rehearsal, "AFTER_HANG_S", 0.1)
    for name, seconds in (("validates", 0.5), ("validates", 0.0), ("starts", 0.1)):
        start = time.monotonic()
        with pytest.raises(PluginError, match="was not made within 0"):
            plugins.make("solver", name, {"what": what})
        assert seconds <= time.monotonic() - start < seconds + 0.4
    assert plugins.make("solver", "checks", {}).what == "nothing"


def test_many_deaths_are_not_tried_again(plugins):
    for _ in range(rehearsal.ENDS):
        with pytest.raises(PluginError, match="exit code 3"):
            plugins.make("solver", "validates", {"what": "exit 3"})
    with pytest.raises(PluginError, match="exit code 3"):
        plugins.make("solver", "validates", {"what": "nothing"})


def test_one_child_tries_all_points_and_built_in_classes_need_none(plugins, monkeypatch):
    forks = []
    fork = os.fork
    monkeypatch.setattr(os, "fork", lambda: forks.append(1) or fork())
    for population in range(5, 15):
        plugins.make("solver", "de", {"population": population})
    assert len(forks) == 0
    for number in range(10):
        with pytest.raises(OptionError):
            plugins.make("solver", "validates", {"what": number})  # expects text
    assert len(forks) == 1
    plugins.make("solver", "validates", {})
    again = Registry(plugins.files)
    again.make("solver", "validates", {})
    assert len(forks) == 1  # the same options of the same file need not be tried again


def test_a_child_without_questions_ends_and_is_replaced(plugins, monkeypatch):
    monkeypatch.setattr(rehearsal, "IDLE_S", 0.01)
    plugins.make("solver", "validates", {})
    time.sleep(0.3)
    with pytest.raises(PluginError, match="exit code 3"):
        plugins.make("solver", "validates", {"what": "exit 3"})
    time.sleep(0.3)
    assert plugins.make("solver", "starts", {}).what == "nothing"


def test_a_question_of_any_size_is_answered(plugins):
    with pytest.raises(OptionError, match="what: expected string, got "):
        plugins.make("solver", "validates", {"what": ["x" * 100] * 100_000})
    with pytest.raises(OptionError, match="what: expected string, got <function"):
        plugins.make("solver", "validates", {"what": lambda: 0})  # cannot be pickled


def test_an_interrupt_of_this_process_is_passed_on_and_the_next_answer_is_not_the_last_ones():
    with rehearsal.Rehearsal(lambda question: time.sleep(question) or str(question), "made", "") as rehearsed:
        assert rehearsed.ask(0.01, 5) == "0.01"
        select = rehearsal.select.select
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(rehearsal.select, "select", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
            with pytest.raises(KeyboardInterrupt):
                rehearsed.ask(0.2, 5)
        assert rehearsal.select.select is select
        assert rehearsed.ask(0.02, 5) == "0.02"


def test_what_is_rehearsed_prints_nothing_and_changes_nothing_here(capfd):
    found = []
    assert rehearse(lambda: print("x", flush=True) or os.system("echo y") or found.append(1) or "", "made", "") == ""
    assert capfd.readouterr() == ("", "") and not found


IMPORT = """
import os, sys, warnings
import numpy as np
from dataclasses import dataclass
from nfbench import Solver
os.environ["NFBENCH_LEFT"] = "1"
os.environ["NFBENCH_CHANGED"] = "after"
os.environ.pop("NFBENCH_REMOVED", None)
{change}
np.seterr(all="raise")
os.chdir("/")

@dataclass(frozen=True)
class Mine(Solver):
    found = os.environ["NFBENCH_LEFT"]

    def minimize(self, problem, rng):
        problem(problem.lower)
"""
FILTERS = ['warnings.simplefilter("error")', "warnings.resetwarnings()", 'warnings.filterwarnings("ignore")']


@pytest.mark.parametrize("change", FILTERS)
def test_a_file_leaves_no_variables_filters_or_folder_to_other_plugins(change, tmp_path, monkeypatch):
    monkeypatch.setenv("NFBENCH_CHANGED", "before")
    monkeypatch.setenv("NFBENCH_REMOVED", "not")
    (tmp_path / "first.py").write_text(IMPORT.format(change=change) + f"# {tmp_path}")
    (tmp_path / "second.py").write_text(
        IMPORT.format(change='warnings.warn("old", DeprecationWarning, stacklevel=2)\nassert "x" != 1').replace(
            "Mine", "Other"
        )
        + f"# {tmp_path}"
    )
    filters, folder = list(warnings.filters), Path.cwd()
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        before = list(warnings.filters)
        with pytest.warns(DeprecationWarning, match="old"):
            found = Registry([tmp_path / "first.py", tmp_path / "second.py"])
        assert not found.broken and {"mine", "other"} <= {*found.names("solver")}
        assert list(warnings.filters) == before
    assert list(warnings.filters) == filters and Path.cwd() == folder
    assert found.find("solver", "mine").load.found == "1"  # the file itself sees what it has set
    assert "NFBENCH_LEFT" not in os.environ
    assert (os.environ["NFBENCH_CHANGED"], os.environ["NFBENCH_REMOVED"]) == ("before", "not")
