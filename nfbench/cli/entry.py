"""The entry point of the command line."""

from __future__ import annotations

import sys
from typing import Annotated

import typer
from rich.console import Console

from nfbench import __version__
from nfbench.core import NfbenchError

from . import plugin_commands, results_commands, study_commands, tune_command  # noqa: F401  # importing them registers the commands
from .common import OK, USAGE, app

__all__ = ["main"]


@app.callback(invoke_without_command=True)
def about(
    version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False,
) -> None:
    """Benchmark optimizers and formulations for near-field source localization."""
    if version:
        typer.echo(f"nfbench {__version__}")
        raise typer.Exit


def main() -> None:
    """Run the command line. Errors of nfbench end in a message and an exit code, never in a traceback."""
    try:
        app(standalone_mode=True)
    except NfbenchError as error:
        Console(stderr=True).print(f"nfbench: {error}", style="red", highlight=False, markup=False, soft_wrap=True)
        sys.exit(USAGE)
    except BrokenPipeError:
        sys.exit(OK)
