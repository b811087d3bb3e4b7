"""The entry point of the command line."""

from __future__ import annotations

import sys
from typing import Annotated

import typer
from rich.console import Console

from nfbench import __version__
from nfbench.core import NfbenchError

from . import plugin_commands, results_commands, study_commands, tune_command  # noqa: F401  # they register themselves
from .common import OK, USAGE, app

__all__ = ["main"]


@app.callback(invoke_without_command=True)
def about(
    version: Annotated[bool, typer.Option("--version", help="Print the version and stop.")] = False,
) -> None:
    """Which optimizer, on which formulation, localizes near-field sources best for what you can spend?"""
    if version:
        typer.echo(f"nfbench {__version__}")
        raise typer.Exit


def main() -> None:
    """The entry point: every error of ours is a message and an exit code, never a traceback."""
    try:
        app(standalone_mode=True)
    except NfbenchError as error:
        Console(stderr=True).print(f"nfbench: {error}", style="red", highlight=False, markup=False, soft_wrap=True)
        sys.exit(USAGE)
    except BrokenPipeError:
        sys.exit(OK)
