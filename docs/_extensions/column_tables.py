"""The directive ``column-table``: the columns of one output file, from ``docs/reference/columns.toml``."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

from docstrings import escaped
from docutils import nodes
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

__all__ = ["columns", "is_described", "setup"]

FILE = Path(__file__).parents[1] / "reference" / "columns.toml"


def columns(file: str) -> list[dict[str, str]]:
    """The described columns of a file: name (with N for a number, KEY for a key), unit and meaning."""
    found: list[dict[str, str]] = tomllib.loads(FILE.read_text(encoding="utf-8"))[file]
    return found


def is_described(file: str, column: str) -> bool:
    """Whether the reference has this column of this file, by its name or by a pattern."""
    patterns = (re.escape(entry["name"]) for entry in columns(file))
    patterns = (re.sub(r"(?<![A-Z])N(?![A-Z])", r"\\d+", pattern).replace("KEY", ".+") for pattern in patterns)
    return any(re.fullmatch(pattern, column) for pattern in patterns)


class ColumnTable(SphinxDirective):
    """A table of the columns of one file."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        self.env.note_dependency(str(FILE))
        lines = [".. list-table::", "   :header-rows: 1", "   :class: keys", ""]
        lines += ["   * - name", "     - unit", "     - meaning"]
        for entry in columns(self.arguments[0]):
            lines.append(f"   * - ``{entry['name']}``")
            lines += [f"     - {escaped(entry.get('unit', ''))}", f"     - {escaped(entry['meaning'])}"]
        holder = nodes.container()
        self.state.nested_parse(StringList(lines, source=str(FILE)), self.content_offset, holder)
        return list(holder.children)


def setup(app: Sphinx) -> dict[str, Any]:
    app.add_directive("column-table", ColumnTable)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
