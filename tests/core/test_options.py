"""Tests that options are checked on construction and that errors name the option and both values."""

import functools
import typing
from dataclasses import dataclass, field
from typing import Annotated, ClassVar, Literal

import pytest

from nfbench import Budget, FilePath, Ge, Gt, Le, OneOf, OptionError, Options
from nfbench.core.options import build, canonical, relative_to


@dataclass(frozen=True)
class Line(Options):
    kind: ClassVar[str] = "line"
    elements: Annotated[int, Ge(2)] = 8


@dataclass(frozen=True)
class Ring(Options):
    kind: ClassVar[str] = "ring"
    radius: Annotated[float, Gt(0)]
    tilt: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class Sample(Options):
    size: Annotated[int, Ge(4), Le(1000)] = 50
    F: float = 0.5
    rule: Literal["clip", "resample"] = "clip"
    snr: float | tuple[float, ...] = 20.0
    array: Annotated[Line | Ring, OneOf(Line, Ring)] = field(default_factory=Line)
    start: float | None = None
    stop: float | None = None
    depth = 3

    def validate(self):
        if self.start is not None and self.stop is not None and self.start >= self.stop:
            raise ValueError(f"start: expected less than stop = {self.stop}, got {self.start}")


def test_lists_become_tuples_and_integers_become_floats():
    made = build(Sample, {"snr": [10, 20.5], "F": 1, "array": {"kind": "ring", "radius": 2, "tilt": [1, 2]}})
    assert made == Sample(snr=(10.0, 20.5), F=1.0, array=Ring(2.0, (1.0, 2.0)))
    assert type(made.F) is float and hash(made) == hash(made)


def test_canonical_data_contains_every_default_and_can_be_built_again():
    made = Sample(array=Ring(1.0))
    plain = canonical(made)
    assert plain["array"] == {"kind": "ring", "radius": 1.0, "tilt": [0.0, 0.0]}
    assert build(Sample, plain) == made
    assert canonical(build(Sample, {"snr": 20})) == canonical(Sample())


def test_without_defaults_canonical_data_contains_only_what_was_chosen():
    plain = functools.partial(canonical, defaults=False)
    assert plain(build(Sample, {"snr": 20, "array": {"kind": "line", "elements": 8}})) == {}
    assert plain(Sample(size=51, start=1.0)) == {"size": 51, "start": 1.0}
    assert plain(Sample(array=Line(9))) == {"array": {"kind": "line", "elements": 9}}
    assert plain(Sample(array=Ring(1.0))) == {"array": {"kind": "ring", "radius": 1.0}}  # has no default


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"sise": 5}, [("sise", 'unknown option; did you mean "size"?')]),
        (
            {"depth": 5},
            [("depth", "is not a dataclass field: give depth in class Sample a type, as in `depth: float = 0.5`")],
        ),
        ({"size": 3}, [("size", "expected greater than or equal to 4, got 3")]),
        ({"size": 5.0}, [("size", "expected integer, got 5.0")]),
        ({"size": True}, [("size", "expected integer, got True")]),
        ({"F": "x"}, [("F", "expected number, got 'x'")]),
        ({"F": float("nan")}, [("F", "expected a number, got nan")]),
        ({"rule": "clop"}, [("rule", "expected 'clip' or 'resample', got 'clop'; did you mean \"clip\"?")]),
        ({"snr": "x"}, [("snr", "expected number or list, got 'x'")]),
        ({"array": {"kind": "lin"}}, [("array.kind", "unknown kind 'lin'; did you mean \"line\"?")]),
        ({"array": {}}, [("array.kind", "is required; known: line, ring")]),
        ({"array": {"kind": "ring"}}, [("array.radius", "is required: expected number")]),
        ({"array": {"kind": "line", "elemnts": 3}}, [("array.elemnts", 'unknown option; did you mean "elements"?')]),
        ({"array": 7}, [("array", "expected a table with a kind (line, ring), got 7")]),
        ({"start": 2.0, "stop": 1.0}, [("", "start: expected less than stop = 1.0, got 2.0")]),
    ],
)
def test_each_error_names_the_option_and_both_values(options, expected):
    with pytest.raises(OptionError) as caught:
        build(Sample, options)
    assert caught.value.problems == expected


def test_all_errors_are_reported_at_once():
    with pytest.raises(OptionError) as caught:
        build(Sample, {"size": 1, "F": "x", "ruel": "clip", "array": {"kind": "line", "elements": 0}})
    assert [path for path, _ in caught.value.problems] == ["ruel", "size", "F", "array.elements"]


def test_direct_construction_is_checked_too():
    with pytest.raises(OptionError, match="Sample: size: expected greater than or equal to 4, got 1"):
        Sample(size=1)


def test_a_file_is_resolved_relative_to_the_manifest(tmp_path):
    @dataclass(frozen=True)
    class Reader(Options):
        file: FilePath

    (tmp_path / "data.csv").write_text("1")
    with relative_to(tmp_path):
        assert Reader("data.csv").file == str(tmp_path / "data.csv")
        with pytest.raises(OptionError, match="no such file"):
            Reader("other.csv")
    with pytest.raises(OptionError, match=r"no such file: data\.csv"):
        Reader("data.csv")


def test_a_missing_file_is_looked_for_in_the_folder_that_the_environment_names(tmp_path, monkeypatch):
    @dataclass(frozen=True)
    class Reader(Options):
        file: FilePath

    there, here = tmp_path / "there", tmp_path / "here"
    for folder in (there, here):
        folder.mkdir()
    (there / "data.csv").write_text("1")
    monkeypatch.setenv("NFBENCH_DATA", str(there))
    with relative_to(here):
        assert Reader("data.csv").file == str(there / "data.csv")
        (here / "data.csv").write_text("2")
        assert Reader("data.csv").file == str(here / "data.csv")
        with pytest.raises(OptionError, match=r"no such file: .*there/other\.csv; .*NFBENCH_DATA"):
            Reader("other.csv")


def test_an_option_that_does_not_identify_is_left_out_of_the_identity():
    @dataclass(frozen=True)
    class Placed(Options):
        place: str = field(metadata={"identifies": False})
        size: int = 1

    assert canonical(Placed("a", 2)) == {"place": "a", "size": 2}
    assert canonical(Placed("a", 2), defaults=False) == canonical(Placed("b", 2), defaults=False) == {"size": 2}


def test_the_classes_of_one_of_may_share_a_base_class():
    @dataclass(frozen=True)
    class Shape(Options): ...

    @dataclass(frozen=True)
    class Disc(Shape):
        kind: ClassVar[str] = "disc"

    @dataclass(frozen=True)
    class Holder(Options):
        shape: Annotated[Shape, OneOf(Disc)] = field(default_factory=Disc)

    assert build(Holder, {"shape": {"kind": "disc"}}).shape == Disc()


@dataclass(frozen=True)
class Nested(Options):
    line: Line = Line()  # frozen


def test_a_field_of_an_options_class_accepts_a_table():
    made = build(Nested, {"line": {"elements": 3}})
    assert made == Nested(line=Line(3)) and made.line.elements == 3
    assert build(Nested, {}) == Nested()
    assert build(Nested, {"line": Line(5)}).line == Line(5)


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ({"elements": 1}, ("line.elements", "expected greater than or equal to 2, got 1")),
        ({"element": 3}, ("line.element", 'unknown option; did you mean "elements"?')),
        (3, ("line", "expected a table (elements), got 3")),
    ],
)
def test_an_invalid_table_is_reported_with_its_path(line, expected):
    with pytest.raises(OptionError) as caught:
        build(Nested, {"line": line})
    assert caught.value.problems == [expected]


@dataclass(frozen=True)
class Loose(Options):
    table: dict[str, typing.Any] = field(default_factory=dict)
    numbers: tuple[float, ...] = ()
    anything: typing.Any = None


def problems(cls, **options):
    with pytest.raises(OptionError) as caught:
        build(cls, options)
    return caught.value.problems


def test_nan_is_refused_at_any_depth():
    nan = float("nan")
    assert problems(Loose, numbers=[1.0, nan]) == [("numbers[1]", "expected a number, got nan")]
    assert problems(Loose, table={"a": [0, {"b": nan}]}) == [("table.a[1].b", "expected a number, got nan")]
    assert problems(Loose, anything=[[nan], nan]) == [
        ("anything[0][0]", "expected a number, got nan"),
        ("anything[1]", "expected a number, got nan"),
    ]


def test_endless_nesting_is_refused():
    deep: list = []
    deep.append(deep)
    (problem,) = problems(Loose, anything=deep)
    assert problem[1] == "expected at most 32 nested lists or tables, got more"
    table: dict = {}
    table["a"] = table
    assert "at most 32 nested" in problems(Loose, table=table)[0][1]


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        ([1, [2, "x"]], "[1, [2, 'x']]"),
        (list(range(20)), "[0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, ...]"),
        ([[[[[[1]]]]]], "[[[[[...]]]]]"),
        pytest.param(10**5000, "an integer of 16610 bits", id="5,001 digits"),
        ("\x1b[31m", "'\\x1b[31m'"),
    ],
)
def test_values_in_messages_are_short_and_printable(value, shown):
    assert problems(Sample, rule=value) == [("rule", f"expected 'clip' or 'resample', got {shown}")]
    assert len(problems(Sample, rule="x" * 10**6)[0][1]) < 250


def test_the_kind_of_one_of_may_be_anything():
    for kind in ([1], {"a": 1}, 3, float("inf"), True):
        ((path, text),) = problems(Sample, array={"kind": kind})
        assert path == "array.kind" and text.startswith("unknown kind ") and text.endswith("; known: line, ring")


def test_many_errors_are_kept_and_the_first_50_shown():
    with pytest.raises(OptionError) as caught:
        build(Sample, {f"option{i}": 1 for i in range(20_000)})
    assert len(caught.value.problems) == 20_000
    assert str(caught.value).endswith("; … and 19,950 more (the first 50 of 20,000 are shown)")
    assert str(caught.value).count("unknown option") == 50


def test_messages_have_no_control_characters_of_names():
    with pytest.raises(OptionError) as caught:
        build(Sample, {"a\x1b[31m\nb": 1})
    assert str(caught.value).isprintable()


def test_wrong_items_of_a_list_are_reported_without_its_other_types():
    assert problems(Sample, snr=["x", 1.0]) == [("snr[0]", "expected number, got 'x'")]


@pytest.mark.parametrize("path", ["a" * 5000, "\0", ".", "/dev/null"])
def test_a_path_that_is_no_file_is_refused(path):
    @dataclass(frozen=True)
    class Reader(Options):
        file: FilePath

    with pytest.raises(OptionError, match=r"file: (no such file|cannot be read|expected a regular file)"):
        Reader(path)


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (
            {"evaluations": 10**16},
            "evaluations: expected less than or equal to 1000000000000000, got 10000000000000000",
        ),
        ({"evaluations": 10**5000}, "evaluations: .* got an integer of 16610 bits"),
        ({"seconds": float("inf")}, "seconds: expected less than or equal to 1000000000, got inf"),
        (
            {"evaluations": 1, "target": float("inf")},
            "target: expected a finite number or a table with gap, error or error_in_bounds, got inf",
        ),
        (
            {"evaluations": 1, "target": float("-inf")},
            "target: expected a finite number or a table with gap, error or error_in_bounds, got -inf",
        ),
    ],
)
def test_a_budget_that_no_machine_can_spend_is_refused(options, complaint):
    with pytest.raises(OptionError, match=complaint):
        Budget(**options)
