"""The command ``table``, which writes a study's tables for papers and pages."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from nfbench.core import NfbenchError

from .common import Folder, app, explained, output, say


class Which(StrEnum):
    """The tables of a study."""

    SUMMARY = "summary"
    RANKING = "ranking"
    TARGETS = "targets"
    CLAIMS = "claims"


class Format(StrEnum):
    """The formats of a table."""

    LATEX = "latex"
    MARKDOWN = "markdown"
    CSV = "csv"


@app.command()
def table(
    folder: Folder,
    to: Annotated[Format, typer.Option(help="Format of the table; csv has all digits.")] = Format.MARKDOWN,
    which: Annotated[Which, typer.Option(help="Table to write.")] = Which.SUMMARY,
    columns: Annotated[
        str | None,
        typer.Option(metavar="NAME[,NAME]", help="Columns after the swept values and the method, by their CSV names."),
    ] = None,
    intervals: Annotated[bool, typer.Option(help="Print 95 % intervals after the values.")] = True,
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="File to write (default: standard output).")] = None,
) -> None:
    """Write a table of a study as LaTeX or Markdown for a paper or page, with units and rounded numbers.

    The methods of the best set are bold in the ranking.
    """
    from nfbench.report import publication_table
    from nfbench.results import Results

    chosen = [name.strip() for name in columns.split(",") if name.strip()] if columns else []
    with explained(folder):
        text = publication_table(Results(folder), which.value, to.value, chosen, intervals)
        if out is None:
            output().file.write(text)
            return
        try:
            out.parent.mkdir(parents=True, exist_ok=True)
            out.write_text(text, encoding="utf-8", newline="\n")
        except OSError as error:
            raise NfbenchError(f"{out}: {error.strerror or error}") from error
        say(out)
