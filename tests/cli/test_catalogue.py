"""The catalogue shows text of plugins literally, joins wrapped lines, and reports what is missing."""

import io
import textwrap

import pytest
from rich.console import Console

from nfbench.cli.catalogue import Filter, print_catalogue, print_plugin
from nfbench.core import PluginError
from nfbench.plugins import Registry, description
from nfbench.testing import check_scenario

PLUGINS = '''
"""Plugins whose text and attributes are unusual."""
from dataclasses import dataclass, field
from nfbench import Formulation, Instance, Scenario, Solver, SolverInfo


class Empty(Instance):
    def score(self, estimate):
        return {}


@dataclass(frozen=True)
class Marked(Solver):
    """Speeds [m/s], a closing tag [/], [bold]brackets[/bold], :smile: and \\x1b[31mcolour.

    rate: a rate [1/s] with a description that goes on and on until it
        needs a second line [/] in the source, and
        a third one.
    name_of_it: a name [/x].
    """

    rate: float = 1.0
    name_of_it: str = "[/x]"
    info = SolverInfo(reference="Who [s] knows [/] :smile:")

    def minimize(self, problem, rng):
        problem(problem.lower)


@dataclass(frozen=True)
class MarkedScenario(Scenario):
    """Times [s], [/] and [red]."""

    instance = Empty
    error = "[/error]"

    def draw(self, rng):
        return Empty()


@dataclass(frozen=True)
class Unfinished(Scenario):
    """Has no instance [/]."""

    def draw(self, rng):
        return Empty()


@dataclass(frozen=True)
class UnfinishedFormulation(Formulation):
    """Has no accepts [/]."""

    def solve(self, instance, minimize):
        return None


@dataclass(frozen=True)
class Partly(Solver):
    """Some of its algorithms do not work."""

    algorithm: str = "a"
    info = SolverInfo()

    @classmethod
    def unusable(cls):
        return {"b": "needs [gpu]", "c": "needs [gpu]", "d": "is [/] slow"}

    def minimize(self, problem, rng):
        problem(problem.lower)


@dataclass(frozen=True)
class Raises(Partly):
    """Cannot say which of its algorithms work."""

    @classmethod
    def unusable(cls):
        raise KeyError("[/boom]")


@dataclass(frozen=True)
class UnknownType(Solver):
    """Has an option of an unknown type."""

    x: "Undefined" = 1
    info = SolverInfo()

    def minimize(self, problem, rng):
        problem(problem.lower)


@dataclass(frozen=True)
class DefaultRaises(Solver):
    """Has an option whose default raises."""

    x: int = field(default_factory=lambda: 1 // 0)
    info = SolverInfo()

    def minimize(self, problem, rng):
        problem(problem.lower)
'''


@pytest.fixture(scope="module")
def registry(tmp_path_factory):
    file = tmp_path_factory.mktemp("plugins") / "unusual.py"
    file.write_text(PLUGINS)
    return Registry([file])


def shown(function, *arguments, width=200):
    console = Console(width=width, highlight=False, force_terminal=False)
    with console.capture() as capture:
        function(*arguments, console)
    return capture.get()


@pytest.mark.parametrize("width", [40, 60, 200])
def test_text_of_a_plugin_is_shown_literally(registry, width):
    text = shown(print_plugin, registry, "solver", "marked", width=width)
    words = " ".join(text.split())
    assert "Speeds [m/s], a closing tag [/], [bold]brackets[/bold], :smile: and \\x1b[31mcolour." in words
    assert "rate: a rate [1/s] with a description" in words and "Who [s] knows [/] :smile:" in words
    assert "│ [/x]" in text and "\x1b" not in text


def test_a_description_is_one_line_however_the_source_wraps_it(registry):
    lines = shown(print_plugin, registry, "solver", "marked", width=300).splitlines()
    assert (
        "rate: a rate [1/s] with a description that goes on and on until it needs a second line [/] in the source, "
        "and a third one." in [line.rstrip() for line in lines]
    )
    narrow = shown(print_plugin, registry, "solver", "marked", width=40).splitlines()
    start = next(i for i, line in enumerate(narrow) if line.startswith("rate:"))
    assert [line[:1].isspace() for line in narrow[start : start + 4]] == [False] * 4


@pytest.mark.parametrize(
    ("source", "joined"),
    [
        ("one\ntwo\n\nthree", "one two\n\nthree"),
        ("a: first\n    second\nb: third\nfourth", "a: first second\nb: third fourth"),
        ("a, b: first\n    with c: in it\nd: e", "a, b: first with c: in it\nd: e"),
        ("text\n\n- one\n  more\n- two", "text\n\n- one more\n- two"),
        ("text::\n\n    code\n    more code\n\nend", "text::\n\n    code\n    more code\n\nend"),
        ("1. one\n   more\n2. two", "1. one more\n2. two"),
        ("", ""),
    ],
)
def test_wrapped_lines_are_joined(source, joined):
    described = type("Described", (), {"__doc__": source})
    assert description(described) == joined


@pytest.mark.parametrize("kind", ["solver", "formulation", "scenario"])
def test_a_list_has_a_row_for_every_plugin(registry, kind):
    text = listed(registry, kind)
    assert all(f"│ {name} " in text for name in registry.names(kind))
    assert listed(registry, kind, width=50)


def listed(registry, kind, width=250):
    console = Console(width=width, highlight=False)
    with console.capture() as capture:
        print_catalogue(registry, [kind], console, Filter(uninstalled=True))
    return capture.get()


def test_a_list_shows_marked_text_and_the_number_of_unusable_algorithms(registry):
    solvers = listed(registry, "solver")
    assert "Who [s] knows [/] :smile:" in solvers
    assert "partly: 3 algorithms do not work here (nfbench show solver partly)" in solvers
    assert "cannot be described: KeyError: '[/boom]' (unusual.py:" in solvers
    scenarios = listed(registry, "scenario")
    assert "[/error]" in scenarios and "Times [s], [/] and [red]." in scenarios


def test_unusable_algorithms_are_shown_by_reason(registry):
    text = shown(print_plugin, registry, "solver", "partly")
    assert "Algorithms that do not work here:\n  needs [gpu]:\n    b, c\n  is [/] slow:\n    d\n" in text


@pytest.mark.parametrize(
    ("kind", "name", "reason"),
    [
        ("scenario", "unfinished", "expected the class variable `instance` to be a type, got None"),
        ("formulation", "unfinished-formulation", "expected the class variable `accepts` to be a type, got None"),
    ],
)
def test_a_class_without_a_required_variable_is_reported(registry, kind, name, reason):
    assert reason in " ".join(listed(registry, kind).replace("│", " ").split())
    with pytest.raises(PluginError, match=f"{kind} {name} of unusual.py: {reason}"):
        print_plugin(registry, kind, name, Console(file=io.StringIO()))


def test_the_checks_name_a_missing_instance(registry):
    cls = registry._plugins["scenario", "unfinished"].load
    with pytest.raises(AssertionError) as caught:
        check_scenario(cls(), [])
    for check in ("described", "draw", "formulations"):
        assert f"  {check}: expected Unfinished.instance to be the class that draw returns, got None. Add" in str(
            caught.value
        )


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("raises", r"KeyError: '\[/boom\]'"),
        ("unknown-type", "NameError: name 'Undefined' is not defined"),
        ("default-raises", "ZeroDivisionError"),
    ],
)
def test_a_plugin_that_cannot_be_described_is_reported(registry, name, reason):
    with pytest.raises(PluginError, match=f"solver {name} cannot be described: {reason}"):
        print_plugin(registry, "solver", name, Console(file=io.StringIO()))


def test_every_docstring_of_our_own_plugins_is_joined():
    registry = Registry()
    for kind in ("solver", "formulation", "scenario"):
        for name in registry.names(kind):
            lines = shown(print_plugin, registry, kind, name, width=2000).splitlines()
            options = [line for line in lines if line.startswith(("algorithm: ", "population: ", "solver: "))]
            assert all(textwrap.dedent(line).rstrip().endswith((".", "…")) for line in options), name
