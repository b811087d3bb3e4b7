"""The description of a plugin, which is its docstring."""

from __future__ import annotations

import inspect
import re

__all__ = ["description"]


def description(cls: type) -> str:
    """Return the class's own docstring with one line per paragraph, list item or option.

    It is empty if the class only has the signature that dataclasses generate.
    """
    doc = inspect.getdoc(cls) or ""
    if doc.startswith(f"{cls.__name__}("):
        return ""
    return _joined(doc)


def _joined(doc: str) -> str:
    """Join wrapped lines, so that the terminal can wrap them; paragraphs, lists and ``name: …`` start a new line.

    An indented line continues the entry or list item above it. Elsewhere it is left alone, as in a block of code.
    """
    lines: list[str] = []
    entry = False  # whether the current line began as an entry ``name: …`` or as a list item
    for line in doc.split("\n"):
        bare = line.strip()
        if not bare or not lines or not lines[-1]:
            entry = _starts_entry(bare)
            lines.append(line.rstrip())
        elif _starts_entry(bare) and not (entry and line[0].isspace()):
            entry = True
            lines.append(line)
        elif line[0].isspace() and not entry:
            lines.append(line)
        else:
            lines[-1] += f" {bare}"
    return "\n".join(lines)


def _starts_entry(line: str) -> bool:
    return re.match(r"(\w[\w, ]*: |[-*•] |\d+[.)] )", line) is not None
