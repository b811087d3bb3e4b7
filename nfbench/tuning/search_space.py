"""What can be tuned of a plugin: the options whose types, or marks, say where to look."""

from __future__ import annotations

import dataclasses
import math
import types
import typing
from typing import Any, TypeAlias

from nfbench.core import Options, Tune

__all__ = ["Domain", "domains"]

Domain: TypeAlias = Tune | tuple[Any, ...]
"""Where to look for an option: a range, of ints for an int, or the values to choose from."""


def domains(cls: type[Options]) -> dict[str, Domain]:
    """Where to look for each option that can be tuned.

    A bool or Literal has its values; a number the range of its :class:`Tune` mark or, without one, of its
    limits where it has both; one that may be None is tuned as a number. Other options cannot be tuned.
    """
    hints = typing.get_type_hints(cls, include_extras=True)
    found = {field.name: _domain(hints[field.name]) for field in dataclasses.fields(cls) if field.init}
    return {name: domain for name, domain in found.items() if domain is not None}


def _domain(hint: Any) -> Domain | None:
    origin, parts = typing.get_origin(hint), typing.get_args(hint)
    if hint is bool:
        return (False, True)
    if origin is typing.Literal:
        return parts
    if origin in (typing.Union, types.UnionType):
        given = [part for part in parts if part is not types.NoneType]
        return _domain(given[0]) if len(given) == 1 else None
    if origin is typing.Annotated and parts[0] in (int, float):
        return _range(*parts)
    return None


def _range(number: type[int] | type[float], *marks: Any) -> Tune | None:
    for mark in marks:
        if isinstance(mark, Tune):
            return Tune(number(mark.low), number(mark.high), mark.log)
    low, high = -math.inf, math.inf
    for mark in marks:  # an open end is left out
        low = max(low, getattr(mark, "ge", -math.inf), _beyond(getattr(mark, "gt", -math.inf), number, math.inf))
        high = min(high, getattr(mark, "le", math.inf), _beyond(getattr(mark, "lt", math.inf), number, -math.inf))
    return Tune(number(low), number(high)) if -math.inf < low < high < math.inf else None


def _beyond(end: float, number: type[int] | type[float], towards: float) -> float:
    """The next number of that type."""
    if math.isinf(end):
        return end
    return math.nextafter(end, towards) if number is float else end + math.copysign(1, towards)
