"""Turns our docstrings into reStructuredText for autodoc: what they say of options and arguments becomes a list."""

from __future__ import annotations

import dataclasses
import inspect
import re
from typing import Any

from docstrings import described, docstring, escaped
from sphinx.application import Sphinx

__all__ = ["setup"]


def _names(what: str, thing: Any) -> list[str]:
    """The options of a class or the parameters of a function."""
    if what in ("class", "exception") and dataclasses.is_dataclass(thing):
        return [field.name for field in dataclasses.fields(thing)]
    if what == "attribute" or what == "module":
        return []
    names = [*inspect.get_annotations(thing)] if inspect.isclass(thing) else []
    try:
        return [*names, *(name for name in inspect.signature(thing).parameters if name != "self")]
    except (TypeError, ValueError):
        return names


def _rewritten(app: Sphinx, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    if what == "class" and not docstring(thing):
        lines[:] = []
        return
    text = inspect.cleandoc("\n".join(lines))
    if not text:
        return
    out: list[str] = []
    parts: list[str] = re.split(r"\n\s*\n", text)
    texts: dict[str, str] = {}
    names = _names(what, thing)
    for part in parts:
        if part.startswith("    "):  # an example, after ``::``
            out += [part, ""]
            continue
        found = described(part, names) if names else None
        texts |= found.texts if found else {}
        for prose in found.prose if found else [part]:
            bullets = re.match(r"([*-]) ", prose) or re.search(r"\n[*-] ", prose)
            if bullets:
                items = re.split(r"(?:^|\n)[*-] ", prose)
                out += [*(f"* {escaped(' '.join(item.split()))}" for item in items if item.strip()), ""]
            elif "\n    " in prose and ":" in prose.partition("\n")[0]:
                out += [*(f"| {escaped(line)}" for line in prose.splitlines()), ""]
            else:
                out += [escaped(" ".join(prose.split())), ""]
    for key, value in texts.items():
        out += [f"**{key}**", f"   {escaped(value)}", ""]
    lines[:] = "\n".join(out).splitlines()


def setup(app: Sphinx) -> dict[str, Any]:
    app.connect("autodoc-process-docstring", _rewritten)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
