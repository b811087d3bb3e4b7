"""Options: frozen dataclasses whose fields are checked on construction.

Solvers, formulations, scenarios and arrays derive from :class:`Options`. The type of a field determines which values
are allowed; limits are given in ``Annotated``::

    population: Annotated[int, Ge(4)] = 50
    bounds: Literal["resample", "clip"] = "resample"

A field whose type is a subclass of :class:`Options` accepts a table with the options of that class.
"""

from __future__ import annotations

import contextlib
import contextvars
import dataclasses
import functools
import inspect
import math
import os
import re
import reprlib
import typing
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, TypeVar, final

from annotated_types import Ge, Gt, Le, Lt
from pydantic import AfterValidator, ConfigDict, PlainValidator, TypeAdapter, ValidationError

from .errors import NfbenchError, OptionError, PluginError, explain
from .suggestions import nearest, suggest

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

DATA_FOLDER = "NFBENCH_DATA"  # environment variable with a folder in which files of options are looked for
DEPTH = 32  # lists and tables nested deeper than this are refused
SUGGESTIONS = 50  # unknown options for which the nearest known name is looked up, which takes 0.2 ms each


@dataclasses.dataclass(frozen=True)
class Options:
    """Base class of everything that has options. Subclass it as a frozen dataclass.

    Override ``validate`` to check rules that involve more than one field. The place of a file should not be part of the
    identity of a run: declare it as ``path: FilePath = field(metadata={"identifies": False})``, and set another option
    to a hash of the content in ``validate``.
    """

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
        """Raise ValueError or OptionError if fields contradict each other. Each field on its own is already valid."""


def build(cls: type[T], options: Mapping[str, Any]) -> T:
    """Construct ``cls`` from a table of options, as given in a manifest.

    Raises OptionError with every problem at once: unknown options, with the nearest known name, missing options, and
    invalid values.
    """
    fields = {f.name: f for f in dataclasses.fields(cls) if f.init}
    if undeclared := _undeclared(cls):
        text = f"is not a dataclass field: put @dataclass(frozen=True) above class {cls.__name__}"
        raise OptionError(cls.__name__, [(name, text) for name in undeclared])
    unknown = [name for name in options if name not in fields]
    problems = [(str(name), _unknown(cls, str(name), fields)) for name in unknown[:SUGGESTIONS]]
    problems += [(str(name), "unknown option") for name in unknown[SUGGESTIONS:]]
    for name, field in fields.items():
        if field.default is field.default_factory is dataclasses.MISSING and name not in options:
            problems.append((name, _required(cls, name)))
    known = {name: value for name, value in options.items() if name in fields}
    if problems:  # check the values of the known options too, so that one error lists every problem
        for name, value in known.items():
            problems += _checked(cls, name, value)[1]
        raise OptionError(cls.__name__, problems)
    return cls(**known)


def _required(cls: type[Options], name: str) -> str:
    """Return the message for a missing option, with the expected type if it is known."""
    texts = [text for _, text in _checked(cls, name, None)[1] if text.startswith("expected ")]
    return f"is required: {texts[0].rpartition(', got ')[0]}" if texts else "is required"


def _unknown(cls: type[Options], name: str, fields: Iterable[str]) -> str:
    if isinstance(getattr(cls, name, None), bool | int | float | str | tuple):
        return f"is not a dataclass field: give {name} in class {cls.__name__} a type, as in `{name}: float = 0.5`"
    return f"unknown option{suggest(name, fields)}"


def _undeclared(cls: type) -> list[str]:
    """Return the annotated names of a class without the @dataclass decorator that would make them options."""
    if "__dataclass_fields__" in vars(cls):
        return []
    return [name for name, hint in inspect.get_annotations(cls).items() if "ClassVar" not in str(hint)]


def canonical(value: Any, *, defaults: bool = True) -> Any:
    """Convert an option or an Options object to plain data: dicts, lists, strings and numbers.

    defaults: whether to include options that have their default value, at every depth. Without them, the data do not
    change when a class gains an option. Options with the metadata ``{"identifies": False}`` are left out too.
    """
    plain = functools.partial(canonical, defaults=defaults)
    if isinstance(value, PluginOption):
        return {"kind": value.kind, **plain(value.made)}
    if isinstance(value, Options):
        shown = [f for f in dataclasses.fields(value) if f.init and (defaults or _identifies(value, f))]
        table = {f.name: plain(getattr(value, f.name)) for f in shown}
        kind = getattr(type(value), "kind", None)
        return {"kind": kind, **table} if isinstance(kind, str) else table
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return value


def _identifies(made: Options, field: dataclasses.Field[Any]) -> bool:
    return field.metadata.get("identifies", True) and not _at_default(made, field)


def _at_default(made: Options, field: dataclasses.Field[Any]) -> bool:
    default = field.default if field.default_factory is dataclasses.MISSING else field.default_factory()
    if default is dataclasses.MISSING:
        return False
    return bool(canonical(getattr(made, field.name)) == canonical(_checked(type(made), field.name, default)[0]))


@final
@dataclasses.dataclass(frozen=True)
class Tune:
    """Annotation of a numeric option: the range that ``nfbench tune`` searches. It does not limit the option's value.

    low: lower end of the range, included, in the option's unit.
    high: upper end of the range, included, in the option's unit.
    log: whether to search on a logarithmic scale.
    """

    low: float
    high: float
    log: bool = False

    def __post_init__(self) -> None:
        if not self.low < self.high or (self.log and self.low <= 0):
            raise ValueError(f"Tune: expected low < high, and low > 0 if log is true, got {self}")


@final
@dataclasses.dataclass(frozen=True)
class PluginOption:
    """A plugin that is the value of another plugin's option.

    kind: name under which the plugin is registered.
    made: plugin object.
    version: version of the plugin.
    """

    kind: str
    made: Options
    version: str


class OneOf:
    """Annotation of a field that holds an object of one of several Options classes, selected by ``kind``.

    ``array: Annotated[Array, OneOf(ULA, UPA)]`` accepts ``{"kind": "ula", "elements": 128}`` or a ``ULA`` object.
    Each class defines its name in the class variable ``kind``. A ``label`` in a table names it in the tables and
    figures of a study that sweeps it, and has no effect on the object.
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
            raise ValueError(f"expected a table with a kind ({', '.join(self.classes)}), got {_shown(value)}")
        kind = value.get("kind")
        if not isinstance(kind, str) or kind not in self.classes:
            hint = suggest(kind, self.classes) if isinstance(kind, str) else f"; known: {', '.join(self.classes)}"
            problem = "is required" if kind is None else f"unknown kind {_shown(kind)}"
            raise OptionError("", [("kind", f"{problem}{hint}")])
        table = {name: item for name, item in value.items() if name != "kind"}
        return build(self.classes[kind], _without_label(self.classes[kind], table))


@contextlib.contextmanager
def relative_to(folder: Path) -> Iterator[None]:
    """Within this context, resolve relative :data:`FilePath` options against ``folder``, the folder of the manifest."""
    token = _folder.set(folder)
    try:
        yield
    finally:
        _folder.reset(token)


def _resolve(path: str) -> str:
    resolved = (_folder.get() or Path()) / path
    try:
        if (elsewhere := os.environ.get(DATA_FOLDER)) and not resolved.exists():
            resolved = Path(elsewhere) / path
        is_file, exists = resolved.is_file(), resolved.exists()
    except OSError as error:  # e.g. a name that is too long, or a folder without permission
        raise ValueError(f"cannot be read: {error.strerror}: {_shown(str(resolved))}") from error
    if exists and not is_file:
        raise ValueError(f"expected a regular file, got a folder or device: {resolved}")
    if not is_file:
        raise ValueError(f"no such file: {resolved}; correct the path, or set {DATA_FOLDER} to the folder")
    return str(resolved)


FilePath = Annotated[str, AfterValidator(_resolve)]
"""An option that is the path of an existing file, absolute or relative to the manifest's folder.

A file that is not there is looked for in the folder that the environment variable ``NFBENCH_DATA`` names.
"""


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
    if typing.get_origin(hint) is tuple:  # of tables, too
        return tuple[tuple(part if part is ... else _schema(part) for part in typing.get_args(hint))]  # type: ignore[misc]
    return Annotated[Any, marks[0]] if marks else hint


def _table(cls: type[Options], value: Any) -> Options:
    """An object of this class, as it is or from its table."""
    if isinstance(value, cls):
        return value
    if not isinstance(value, Mapping):
        names = ", ".join(f.name for f in dataclasses.fields(cls))
        raise ValueError(f"expected a table ({names}), got {_shown(value)}")
    return build(cls, _without_label(cls, value))


def _without_label(cls: type[Options], table: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return a table without its ``label``, which is not an option, unless the class has such an option."""
    if "label" not in table or any(field.name == "label" for field in dataclasses.fields(cls)):
        return table
    if not isinstance(table["label"], str):
        raise OptionError("", [("label", f"expected a string, got {_shown(table['label'])}")])
    return {name: item for name, item in table.items() if name != "label"}


def _checked(cls: type[Options], name: str, value: Any) -> tuple[Any, list[tuple[str, str]]]:
    """Return the value converted to the type of the field, and the problems found as (path, message) pairs."""
    value, problems = _frozen(value, name)
    if problems:
        return value, problems
    try:
        return _adapters(cls)[name].validate_python(value), []
    except ValidationError as error:
        return value, _explain(name, error)
    except (NfbenchError, MemoryError):
        raise
    except Exception as error:  # of a validator in the annotation, which raises anything but ValueError
        raise PluginError(f"{cls.__name__}: {name}: the check of this option failed: {explain(error)}") from error


def _frozen(value: Any, path: str, depth: int = 0) -> tuple[Any, list[tuple[str, str]]]:
    """Convert lists to tuples, so that options can be hashed and compared; also return the problems found.

    NaN, and lists and tables nested too deeply, are refused wherever they stand.
    """
    if isinstance(value, float) and math.isnan(value):
        return value, [(path, "expected a number, got nan")]
    if not isinstance(value, list | tuple | Mapping):
        return value, []
    if depth == DEPTH:
        return value, [(path, f"expected at most {DEPTH} nested lists or tables, got more")]
    is_table = isinstance(value, Mapping)
    places = [f"{path}.{key}" for key in value] if is_table else [f"{path}[{i}]" for i in range(len(value))]
    frozen, problems = [], []
    for place, item in zip(places, value.values() if isinstance(value, Mapping) else value, strict=True):
        inner, found = _frozen(item, place, depth + 1)
        problems += found
        frozen.append(inner)
    return value if is_table else tuple(frozen), problems


class _Short(reprlib.Repr):
    """Like ``repr``, but short for any value, also for integers that Python refuses to print."""

    def __init__(self) -> None:
        super().__init__()
        self.maxlevel, self.maxtuple, self.maxlist, self.maxdict = 4, 12, 12, 12
        self.maxstring = self.maxother = 160

    def repr_tuple(self, x: tuple[Any, ...], level: int) -> str:
        return self.repr_list(list(x), level)

    def repr_int(self, x: int, level: int) -> str:
        return repr(x) if x.bit_length() <= 256 else f"an integer of {x.bit_length()} bits"


_shown = _Short().repr


def _explain(name: str, error: ValidationError) -> list[tuple[str, str]]:
    """Convert the ValidationError of one field to (path, message) pairs with the messages of nfbench."""
    problems: dict[str, list[str]] = {}
    meant: dict[str, str] = {}
    for item in error.errors(include_url=False):
        # integers are positions in a list; pydantic's other entries name the branches of a union
        path = name + "".join(f"[{part}]" for part in item["loc"] if isinstance(part, int))
        if item["type"] == "literal_error" and isinstance(item["input"], str):
            allowed = re.findall(r"'([^']*)'", item["ctx"]["expected"])
            if near := nearest(item["input"], allowed):
                meant[path] = f'; did you mean "{near}"?'
        inner = item.get("ctx", {}).get("error")
        if isinstance(inner, OptionError):
            for sub, text in inner.problems:
                problems.setdefault(f"{path}.{sub}" if sub else path, []).append(text)
            continue
        if item["type"] == "string_pattern_mismatch":
            item["msg"] = f"a string that matches {item['ctx']['pattern']}"
        if item["type"] in ("too_long", "too_short"):
            item["msg"] = "a list with " + item["msg"].split("should have ")[1].split(" after")[0]
        expected = item["msg"].removeprefix("Input should be ").removeprefix("a valid ").replace("tuple", "list")
        expected = expected.replace("dictionary", "table")
        text = str(inner) if inner is not None else f"expected {expected}, got {_shown(item['input'])}"
        problems.setdefault(path, []).append(text)
    if any(path.startswith(f"{name}[") for path in problems):  # a list: the other branches of a union do not matter
        problems.pop(name, None)
    return [(path, _joined(texts) + meant.get(path, "")) for path, texts in problems.items()]


def _joined(texts: list[str]) -> str:
    """Combine the messages for the alternatives of a union: "expected number or list, got 'x'"."""
    texts = list(dict.fromkeys(texts))
    tails = {text.rpartition(", got ")[2] for text in texts}
    if len(texts) > 1 and len(tails) == 1 and all(text.startswith("expected ") for text in texts):
        heads = (text.rpartition(", got ")[0].removeprefix("expected ") for text in texts)
        return f"expected {' or '.join(heads)}, got {tails.pop()}"
    return "; ".join(texts)
