"""Names of swept tables, such as arrays, under which their results appear in tables, figures and files."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import PurePath
from typing import Any

from .labels import LONGEST, label_problem, safe_label

__all__ = ["SweptNames"]

LONG = 200  # characters of a table in JSON; a longer one is described instead of shown


@dataclass
class SweptNames:
    """The names of the values of one swept key.

    key: swept key.
    values: its values, as in the manifest.

    A table is named by its ``label``. Without one, it stands for itself, unless it is long or has a list of lists, such
    as the coordinates of an array: then it is described in a few words.
    """

    key: str
    values: Sequence[Any]
    _described: dict[str, str] = field(default_factory=dict)

    def problems(self) -> Iterator[tuple[str, str]]:
        """Yield the errors in the labels: where they are below the key, and what is wrong."""
        seen: dict[str, int] = {}
        for i, value in enumerate(self.values):
            label = value.get("label") if isinstance(value, dict) else None
            if not isinstance(label, str):
                continue  # that it is no string is reported where the table is used
            if problem := label_problem(label):
                yield f"[{i}].label", problem
            elif seen.setdefault(label, i) != i:
                yield f"[{i}].label", f"{label!r} is also the label of {self.key}[{seen[label]}]"

    def name(self, value: Any, canonical: Any) -> Any:
        """Return what stands for a value in tables: its label, itself in canonical form, or a description."""
        if not isinstance(value, dict) or not isinstance(canonical, dict):
            return canonical
        label = value.get("label")
        if isinstance(label, str) and "label" not in canonical:  # else it is an option of this name
            return label
        canonical = _given(canonical)
        text = json.dumps(canonical, sort_keys=True)
        if len(text) <= LONG and not any(map(_is_nested, canonical.values())):
            return canonical
        if text not in self._described:
            self._described[text] = self._unused(_described(value, canonical, self.values))
        return self._described[text]

    def _unused(self, name: str) -> str:
        """Return the name, with a number if another value has it already."""
        taken = {value["label"] for value in self.values if isinstance(value, dict) and "label" in value}
        taken |= set(self._described.values())
        found, number = name, 2
        while found in taken:
            found, number = f"{name} no. {number}", number + 1
        return found


def _described(value: dict[str, Any], canonical: dict[str, Any], values: Sequence[Any]) -> str:
    """Return a table in a few words: its kind, files, sizes of lists, and the options in which the values differ."""
    words = []
    tables = [other for other in values if isinstance(other, dict)]
    nested = {name: option for name, option in canonical.items() if _is_nested(option)}
    for name, option in {**value, **nested}.items():
        if name == "file" and isinstance(option, str):
            words.append(PurePath(option).name)
        elif _is_nested(option):
            words.append(f"{len(option)} {name}")
        elif name != "kind" and any(other.get(name) != option for other in tables) and not isinstance(option, dict):
            words.append(f"{name} = {option}")
    kind = str(value.get("kind", "table"))
    return safe_label(f"{kind} ({', '.join(words)})" if words else kind, "table")[: LONGEST - 10]


def _given(option: Any) -> Any:
    """Return a table without the options that are not given, at any depth."""
    if isinstance(option, dict):
        return {name: _given(item) for name, item in option.items() if item is not None}
    return option


def _is_nested(option: Any) -> bool:
    """Whether an option is a list of lists or tables."""
    return isinstance(option, list | tuple) and any(isinstance(item, list | tuple | dict) for item in option)
