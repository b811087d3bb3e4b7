"""Options: frozen dataclasses whose fields are checked when they are constructed.

A solver, formulation, scenario or array is an :class:`Options`. A field's type says what is allowed, with limits in
``Annotated``::

    population: Annotated[int, Ge(4)] = 50
    bounds: Literal["resample", "clip"] = "resample"

A field whose type is itself an :class:`Options` takes a table of that class's options.
"""

from __future__ import annotations

import contextlib
import contextvars
import dataclasses
import difflib
import functools
import inspect
import typing
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, TypeVar, final

from annotated_types import Ge, Gt, Le, Lt
from pydantic import AfterValidator, ConfigDict, PlainValidator, TypeAdapter, ValidationError

from .errors import OptionError

__all__ = [
    "FilePath",
    "Ge",
    "Gt",
    "Le",
    "Lt",
    "OneOf",
    "Options",
    "PluginOption",
    "Tune",
    "build",
    "canonical",
    "relative_to",
    "suggest",
]

T = TypeVar("T", bound="Options")

_known_adapters: dict[type, dict[str, TypeAdapter[Any]]] = {}
_folder: contextvars.ContextVar[Path | None] = contextvars.ContextVar("folder", default=None)


@dataclasses.dataclass(frozen=True)
class Options:
    """Base of everything with options. Subclass as a frozen dataclass; ``validate`` is for rules across fields."""

    def __post_init__(self) -> None:
        problems = []
        for name in _adapters(type(self)):
            value, found = _checked(type(self), name, getattr(self, name))
            problems += found
            object.__setattr__(self, name, value)
        if problems:
            raise OptionError(type(self).__name__, problems)
        try:
            self.validate()
        except OptionError:
            raise
        except ValueError as error:
            raise OptionError(type(self).__name__, [("", str(error))]) from error

    def validate(self) -> None:
        """Raise ValueError or OptionError where fields contradict each other; fields are each valid by now."""


def build(cls: type[T], options: Mapping[str, Any]) -> T:
    """Make ``cls`` from a table of options, as a manifest has them.

    Raises OptionError with every problem at once: unknown names (with the nearest known one), missing ones, values.
    """
    fields = {f.name: f for f in dataclasses.fields(cls) if f.init}
    if forgotten := _undeclared(cls):
        text = f"is no option yet: put @dataclass(frozen=True) above class {cls.__name__}"
        raise OptionError(cls.__name__, [(name, text) for name in forgotten])
    problems = [(name, _unknown(cls, name, fields)) for name in options if name not in fields]
    for name, field in fields.items():
        if field.default is field.default_factory is dataclasses.MISSING and name not in options:
            problems.append((name, _required(cls, name)))
    known = {name: value for name, value in options.items() if name in fields}
    if problems:  # still check the values of what is known, so that one pass shows every error
        for name, value in known.items():
            problems += _checked(cls, name, value)[1]
        raise OptionError(cls.__name__, problems)
    return cls(**known)


def _required(cls: type[Options], name: str) -> str:
    """That it is, and what is expected of it."""
    told = [text for _, text in _checked(cls, name, None)[1] if text.startswith("expected ")]
    return f"is required: {told[0].rpartition(', got ')[0]}" if told else "is required"


def _unknown(cls: type[Options], name: str, fields: Iterable[str]) -> str:
    if isinstance(getattr(cls, name, None), bool | int | float | str | tuple):
        return f"is no option yet: give {name} in class {cls.__name__} a type, as in `{name}: float = 0.5`"
    return f"unknown option{suggest(name, fields)}"


def _undeclared(cls: type) -> list[str]:
    """Annotated names that look like options of a class that lacks the @dataclass to make them so."""
    if "__dataclass_fields__" in vars(cls):
        return []
    return [name for name, hint in inspect.get_annotations(cls).items() if "ClassVar" not in str(hint)]


def canonical(value: Any, *, defaults: bool = True) -> Any:
    """Plain data (dicts, lists, text, numbers) that says everything an option or Options object holds.

    defaults: with the options that have their default value, at every depth; without them, data stay what they are
    when a class gains an option.
    """
    plain = functools.partial(canonical, defaults=defaults)
    if isinstance(value, PluginOption):
        return {"kind": value.kind, **plain(value.made)}
    if isinstance(value, Options):
        shown = [f for f in dataclasses.fields(value) if f.init and (defaults or not _at_default(value, f))]
        table = {f.name: plain(getattr(value, f.name)) for f in shown}
        kind = getattr(type(value), "kind", None)
        return {"kind": kind, **table} if isinstance(kind, str) else table
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return value


def _at_default(made: Options, field: dataclasses.Field[Any]) -> bool:
    default = field.default if field.default_factory is dataclasses.MISSING else field.default_factory()
    if default is dataclasses.MISSING:
        return False
    return bool(canonical(getattr(made, field.name)) == canonical(_checked(type(made), field.name, default)[0]))


def suggest(name: str, known: Iterable[str]) -> str:
    """``; did you mean "x"?`` for the nearest of ``known``, or what there is to choose from."""
    known = sorted(known)
    near = difflib.get_close_matches(name, known, n=1)
    if near:
        return f'; did you mean "{near[0]}"?'
    return f"; known: {', '.join(known)}" if known else ""


@final
@dataclasses.dataclass(frozen=True)
class Tune:
    """Annotation of a number: the range in which ``nfbench tune`` looks for it, both ends included; no limit on it.

    log: an octave counts as much at the low end as at the high one.
    """

    low: float
    high: float
    log: bool = False

    def __post_init__(self) -> None:
        if not self.low < self.high or (self.log and self.low <= 0):
            raise ValueError(f"Tune: expected low < high, and low > 0 where log, got {self}")


@final
@dataclasses.dataclass(frozen=True)
class PluginOption:
    """A plugin as an option of another holds it: what was made, the name it is registered by, and its version."""

    kind: str
    made: Options
    version: str


class OneOf:
    """Annotation of a field that holds one of several Options, told apart by ``kind``.

    ``array: Annotated[Array, OneOf(ULA, UPA)]`` takes ``{"kind": "ula", "elements": 128}`` or a ``ULA`` object.
    Each class names itself in a class variable ``kind``.
    """

    def __init__(self, *classes: type[Options]) -> None:
        self.classes: dict[str, type[Options]] = {vars(cls)["kind"]: cls for cls in classes}

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        from pydantic_core import core_schema

        return core_schema.no_info_plain_validator_function(self._build)

    def _build(self, value: Any) -> Options:
        if isinstance(value, Options) and isinstance(value, tuple(self.classes.values())):
            return value
        if not isinstance(value, Mapping):
            raise ValueError(f"expected a table with a kind ({', '.join(self.classes)}), got {value!r}")
        kind = value.get("kind")
        if kind not in self.classes:
            hint = suggest(str(kind), self.classes) if kind is not None else f"; known: {', '.join(self.classes)}"
            raise OptionError("", [("kind", f"{'is required' if kind is None else f'unknown kind {kind!r}'}{hint}")])
        return build(self.classes[kind], {name: item for name, item in value.items() if name != "kind"})


@contextlib.contextmanager
def relative_to(folder: Path) -> Iterator[None]:
    """Within this context, relative :data:`FilePath` options are taken from ``folder`` (the manifest's)."""
    token = _folder.set(folder)
    try:
        yield
    finally:
        _folder.reset(token)


def _resolve(path: str) -> str:
    resolved = (_folder.get() or Path()) / path
    if not resolved.is_file():
        raise ValueError(f"no such file: {resolved}")
    return str(resolved)


FilePath = Annotated[str, AfterValidator(_resolve)]
"""An option that names an existing file, relative to the manifest."""


def _adapters(cls: type[Options]) -> dict[str, TypeAdapter[Any]]:
    if cls in _known_adapters:
        return _known_adapters[cls]
    hints = {name: _schema(hint) for name, hint in typing.get_type_hints(cls, include_extras=True).items()}
    strict = ConfigDict(strict=True, arbitrary_types_allowed=True)
    adapters = {f.name: TypeAdapter(hints[f.name], config=strict) for f in dataclasses.fields(cls) if f.init}
    return _known_adapters.setdefault(cls, adapters)


def _schema(hint: Any) -> Any:
    """The type as pydantic is to see it: tables become objects, which check themselves."""
    marks = [mark for mark in getattr(hint, "__metadata__", ()) if isinstance(mark, OneOf | PlainValidator)]
    if isinstance(hint, type) and issubclass(hint, Options):
        return Annotated[Any, PlainValidator(functools.partial(_table, hint))]
    return Annotated[Any, marks[0]] if marks else hint


def _table(cls: type[Options], value: Any) -> Options:
    """An object of this class, as it is or from its table."""
    if isinstance(value, cls):
        return value
    if not isinstance(value, Mapping):
        raise ValueError(f"expected a table ({', '.join(f.name for f in dataclasses.fields(cls))}), got {value!r}")
    return build(cls, value)


def _checked(cls: type[Options], name: str, value: Any) -> tuple[Any, list[tuple[str, str]]]:
    """A field's value as its type wants it, and what is wrong with it as (path, message) pairs."""
    value = _frozen(value)
    if isinstance(value, float) and value != value:
        return value, [(name, "expected a number, got nan")]
    try:
        return _adapters(cls)[name].validate_python(value), []
    except ValidationError as error:
        return value, _explain(name, error)


def _frozen(value: Any) -> Any:
    """Lists become tuples, so that options can be hashed and compared."""
    if isinstance(value, list | tuple):
        return tuple(_frozen(item) for item in value)
    return value


def _explain(name: str, error: ValidationError) -> list[tuple[str, str]]:
    """A ValidationError of one field as (path, message) pairs in our words."""
    problems: dict[str, list[str]] = {}
    for item in error.errors(include_url=False):
        # positions within a list are numbers; what else pydantic puts there names branches of a union
        path = name + "".join(f"[{part}]" for part in item["loc"] if isinstance(part, int))
        inner = item.get("ctx", {}).get("error")
        if isinstance(inner, OptionError):
            for sub, text in inner.problems:
                problems.setdefault(f"{path}.{sub}" if sub else path, []).append(text)
            continue
        if item["type"] == "string_pattern_mismatch":
            item["msg"] = f"text that matches {item['ctx']['pattern']}"
        if item["type"] in ("too_long", "too_short"):
            item["msg"] = "a list of another length: " + item["msg"].split("should have ")[1].split(" after")[0]
        expected = item["msg"].removeprefix("Input should be ").removeprefix("a valid ").replace("tuple", "list")
        expected = expected.replace("dictionary", "table")
        came = list(item["input"]) if isinstance(item["input"], tuple) else item["input"]
        text = str(inner) if inner is not None else f"expected {expected}, got {came!r}"
        problems.setdefault(path, []).append(text)
    return [(path, _joined(texts)) for path, texts in problems.items()]


def _joined(texts: list[str]) -> str:
    """The alternatives of a union as one message: "expected number or tuple, got 'x'"."""
    texts = list(dict.fromkeys(texts))
    tails = {text.rpartition(", got ")[2] for text in texts}
    if len(texts) > 1 and len(tails) == 1 and all(text.startswith("expected ") for text in texts):
        heads = (text.rpartition(", got ")[0].removeprefix("expected ") for text in texts)
        return f"expected {' or '.join(heads)}, got {tails.pop()}"
    return "; ".join(texts)
