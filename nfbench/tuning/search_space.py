"""Finds which options of a plugin can be tuned, and their search ranges, from types, limits and marks."""

from __future__ import annotations

import dataclasses
import math
import types
import typing
from typing import Any, TypeAlias

from nfbench.core import Options, Tune

__all__ = ["Domain", "domains"]

Domain: TypeAlias = Tune | tuple[Any, ...]
"""The search range of an option: a range of numbers (of ints for an int option), or the values to choose from."""


def domains(cls: type[Options]) -> dict[str, Domain]:
    """The search range of each option that can be tuned.

    A bool or Literal option has its values as the search range. A number has the range of its :class:`Tune` mark or,
    without a mark, the range between its limits if it has both. An option that may be None is tuned over its other
    values. Other options cannot be tuned.
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
    for mark in marks:  # a strict limit is not part of the range
        low = max(low, getattr(mark, "ge", -math.inf), _next_number(getattr(mark, "gt", -math.inf), number, math.inf))
        high = min(high, getattr(mark, "le", math.inf), _next_number(getattr(mark, "lt", math.inf), number, -math.inf))
    return Tune(number(low), number(high)) if -math.inf < low < high < math.inf else None


def _next_number(end: float, number: type[int] | type[float], towards: float) -> float:
    """The number of that type next to ``end``, in the direction of ``towards``."""
    if math.isinf(end):
        return end
    return math.nextafter(end, towards) if number is float else end + math.copysign(1, towards)
