"""The directive ``command-reference``: every command of ``nfbench`` with its arguments and options."""

from __future__ import annotations

import typing
from collections.abc import Iterator
from enum import Enum
from pathlib import Path
from typing import Any

import typer
from docstrings import escaped
from docutils import nodes
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

__all__ = ["commands", "setup"]


def commands() -> Iterator[tuple[str, Any]]:
    """(name, command) of every command, those of groups with the group's name before them."""
    import nfbench.cli.entry  # noqa: F401  # registers the commands
    from nfbench.cli.common import app

    yield from _below("nfbench", typer.main.get_command(app))


def _below(name: str, command: Any) -> Iterator[tuple[str, Any]]:
    inner = getattr(command, "commands", None)
    if not inner:
        yield name, command
    for child in sorted(inner or {}):
        yield from _below(f"{name} {child}", inner[child])


def _option(parameter: Any, hints: dict[str, Any]) -> str:
    if parameter.param_type_name == "argument":
        return f"``{parameter.metavar or parameter.name.upper()}``"
    names = [*parameter.opts, *parameter.secondary_opts]
    value = "" if parameter.is_flag else f" {parameter.metavar or _value(hints[parameter.name])}"
    return ", ".join(f"``{name}{value}``" for name in names)


def _value(hint: Any) -> str:
    """What an option takes, from the annotation of the command: ``single|double``, ``INTEGER``."""
    while arguments := [part for part in typing.get_args(hint) if part is not type(None)]:
        hint = arguments[0]
    if issubclass(hint, Enum):
        return "|".join(str(choice.value) for choice in hint)
    return {int: "INTEGER", float: "NUMBER", Path: "PATH"}.get(hint, "TEXT")


class CommandReference(SphinxDirective):
    """A section for each command."""

    def run(self) -> list[nodes.Node]:
        lines: list[str] = []
        for name, command in commands():
            title = f"``{name}``"
            lines += [title, "~" * len(title), "", escaped(command.help or ""), ""]
            hints = typing.get_type_hints(command.callback)
            rows = [parameter for parameter in command.params if parameter.name != "help"]
            if rows:
                lines += [".. list-table::", "   :header-rows: 1", "   :class: keys", ""]
                lines += ["   * - argument or option", "     - meaning"]
                for parameter in rows:
                    lines += [f"   * - {_option(parameter, hints)}", f"     - {escaped(parameter.help or '')}"]
                lines.append("")
        holder = nodes.section()
        holder.document = self.state.document
        self.state.nested_parse(StringList(lines, source="<commands>"), self.content_offset, holder, match_titles=True)
        return list(holder.children)


def setup(app: Sphinx) -> dict[str, Any]:
    app.add_directive("command-reference", CommandReference)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
