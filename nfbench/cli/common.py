"""Shared by several commands: the application, common arguments, and output."""

from __future__ import annotations

import contextlib
import os
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from nfbench.core import NfbenchError, StoreError, explain, printable

__all__ = [
    "INTERRUPTED",
    "NOT_ALL_OK",
    "OK",
    "USAGE",
    "Folder",
    "GivenOptions",
    "Jobs",
    "Plugins",
    "app",
    "explained",
    "output",
    "parsed_option",
    "say",
    "warn",
]

app = typer.Typer(no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)

OK, NOT_ALL_OK, USAGE, INTERRUPTED = 0, 1, 2, 130

Plugins = Annotated[
    list[Path] | None, typer.Option("--plugin", help="Plugin file to load; can be given several times.")
]
GivenOptions = Annotated[
    list[str] | None,
    typer.Option(
        "--option", metavar="NAME=VALUE", help="Value of an option of the plugin, e.g. population=50; can be repeated."
    ),
]
Jobs = Annotated[
    int | None,
    typer.Option("--jobs", min=0, help="Number of worker processes (default: one per core; 0: run in this process)."),
]
Folder = Annotated[Path, typer.Argument(metavar="DIR", help="Results folder, e.g. results/quickstart.")]


def output() -> Console:
    """A console on standard output, as wide as the terminal, or wide enough for our tables in a file or pipe."""
    console = Console(highlight=False)
    return console if console.is_terminal or "COLUMNS" in os.environ else Console(highlight=False, width=110)


def say(text: object, *, error: bool = False) -> None:
    """Print a line on standard output or error as it is, but without the control characters of a file or plugin."""
    typer.echo(printable(text, limit=2**16), err=error)


def warn(text: str) -> None:
    """Print a warning on standard error."""
    text = printable(text, limit=2**16)
    Console(stderr=True).print(f"nfbench: {text}", style="yellow", highlight=False, markup=False, soft_wrap=True)


def parsed_option(text: str) -> tuple[str, Any]:
    """Split ``population=50`` into name and value. The value is read as TOML, or as text if it is not valid TOML."""
    name, sign, value = text.partition("=")
    if not sign or not name:
        raise typer.BadParameter(f"expected NAME=VALUE, e.g. population=50, got {text!r}", param_hint="--option")
    try:
        return name, tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        return name, value


@contextlib.contextmanager
def explained(*folders: Path) -> Iterator[None]:
    """Turn an exception that no check has foreseen into a message: the folders may hold values that no run gives."""
    import numpy as np

    try:
        with np.errstate(all="ignore"):  # numbers may be infinite
            yield
    except (NfbenchError, typer.Exit, BrokenPipeError):
        raise
    except Exception as error:
        names = " and ".join(str(folder / "runs.sqlite") for folder in folders)
        raise StoreError(
            f"{names}: the results cannot be processed ({printable(explain(error))}). If values in the file are "
            f"damaged, `nfbench run STUDY.toml --fresh` moves the folder aside and starts over; otherwise please "
            f"report this"
        ) from error
