"""The entry point of the command line."""

from __future__ import annotations

import sys
from typing import Annotated

import typer
from rich.console import Console

from nfbench import __version__
from nfbench.core import NfbenchError, OptionError, printable

from . import (  # noqa: F401  # importing them registers the commands
    choose_command,
    landscape_command,
    localize_command,
    plugin_commands,
    results_commands,
    study_commands,
    table_command,
    tune_command,
)
from .common import INTERRUPTED, USAGE, app
from .streams import tolerant_streams

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
    """Run the command line. Errors end in a message and an exit code, never in a traceback."""
    with tolerant_streams():
        try:
            app(standalone_mode=True)
        except NfbenchError as error:
            _report("\n".join(error.lines()) if isinstance(error, OptionError) else str(error))
            sys.exit(USAGE)
        except KeyboardInterrupt:
            _report("interrupted")
            sys.exit(INTERRUPTED)
        except (OSError, MemoryError, RecursionError) as error:  # of the machine, such as a full disk
            _report(f"{type(error).__name__}: {error}")
            sys.exit(USAGE)


def _report(text: str) -> None:
    text = "\n".join(printable(line, limit=2**16) for line in text.splitlines())
    Console(stderr=True).print(f"nfbench: {text}", style="red", highlight=False, markup=False, soft_wrap=True)
