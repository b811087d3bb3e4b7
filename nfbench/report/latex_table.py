"""Tables in LaTeX that fit a column or a page of a paper, with the rules of booktabs and no other package."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import final

from nfbench.core import latex_text

__all__ = ["latex_table"]

COLUMN, PAGE = 248.0, 510.0  # width of a column and of a page of IEEEtran [pt]
GAP = 8.0  # between columns [pt]
TALL = 58  # lines of one table; more would not fit a page
CHARACTERS = (("mwMW@%&+=÷×→∞≤≥", 6.4), ("ijltfr.,;:'|!()[]{}/ ", 2.7), ("ABCDEFGHKNOPQRUVXYZÄÖÜŁÅ", 5.9))  # at 8 pt
OTHER = 4.1  # width of any other character [pt]
WIDE = 9.0  # of those outside Latin and Greek
NARROWER = (130.0, 100.0, 80.0, 62.0, 48.0)  # widths that text may be wrapped to [pt]
HEAD = 44.0  # width that a heading may have at least [pt]


@final
@dataclass(frozen=True)
class _Cells:
    """Cells as lines of text. heads: one list per column. rows: the same for each row."""

    heads: list[list[str]]
    rows: list[list[list[str]]]

    @property
    def width(self) -> float:
        """The width of the table [pt], as estimated from its characters."""
        columns = zip(self.heads, *self.rows, strict=True)
        return sum(max(_width(line) for cell in column for line in cell) + GAP for column in columns)


def latex_table(
    heads: Sequence[str], rows: Sequence[Sequence[str]], left: int, grouped: int, bold: Sequence[bool], title: str
) -> str:
    """A table as LaTeX code: in a column if it fits, else across both columns, with long text in several lines.

    left: number of columns of text. grouped: number of leading columns whose values are not repeated in the next row.
    bold: whether the last column of text is bold, by row. Tables that are longer than a page are split.
    """
    cells, wide = _fitted(heads, rows, left)
    head = " & ".join(_cell(lines, "l" if i < left else "r", "b") for i, lines in enumerate(cells.heads))
    environment = "table*" if wide else "table"
    parts = []
    for number, part in enumerate(_parts(cells)):
        parts += [
            f"\\begin{{{environment}}}",
            "  \\centering",
            f"  \\caption{{{latex_text(title)}{' (continued)' if number else ''}}}",
            "  \\footnotesize",
            f"  \\setlength{{\\tabcolsep}}{{{GAP / 2:g}pt}}",
            f"  \\begin{{tabular}}{{{'l' * left}{'r' * (len(heads) - left)}}}",
            "    \\toprule",
            f"    {head} \\\\",
            "    \\midrule",
            *_body(cells, part, left, grouped, bold),
            "    \\bottomrule",
            "  \\end{tabular}",
            f"\\end{{{environment}}}",
            "",
        ]
    return "\n".join(["% The preamble needs \\usepackage{booktabs}.", *parts])


def _fitted(heads: Sequence[str], rows: Sequence[Sequence[str]], left: int) -> tuple[_Cells, bool]:
    """The cells, with text wrapped as far as needed, and whether they need the width of a page."""
    choices = [_wrapped(heads, rows, left, most) for most in (math.inf, *NARROWER)]
    for cells in choices[:3]:
        if cells.width <= COLUMN:
            return cells, False
    return next((cells for cells in choices if cells.width <= PAGE), choices[-1]), True


def _wrapped(heads: Sequence[str], rows: Sequence[Sequence[str]], left: int, most: float) -> _Cells:
    cells = [[_lines(cell, most) if i < left else [cell] for i, cell in enumerate(row)] for row in rows]
    widest = [max((_width(line) for row in cells for line in row[i]), default=0.0) for i in range(len(heads))]
    return _Cells([_lines(head, max(width, HEAD)) for head, width in zip(heads, widest, strict=True)], cells)


def _width(text: str) -> float:
    """The width of a line in the font of footnotes [pt], as estimated."""
    return sum(
        next((width for known, width in CHARACTERS if character in known), OTHER if ord(character) < 0x400 else WIDE)
        for character in text
    )


def _lines(text: str, most: float) -> list[str]:
    """The text in lines of about this width at most, broken at spaces, or within a longer word."""
    lines = [""]
    for word in text.split(" "):
        longer = f"{lines[-1]} {word}" if lines[-1] else word
        if _width(longer) <= most:
            lines[-1] = longer
            continue
        lines.append("")
        for character in word:
            if lines[-1] and _width(lines[-1] + character) > most:
                lines.append("")
            lines[-1] += character
    return [line for line in lines if line] or [""]


def _parts(cells: _Cells) -> Iterator[range]:
    """The rows of each table, so that none is longer than a page."""
    start, tall = 0, 0
    for number, row in enumerate(cells.rows):
        lines = max(map(len, row))
        if number > start and tall + lines > TALL:
            yield range(start, number)
            start, tall = number, 0
        tall += lines
    yield range(start, len(cells.rows))


def _body(cells: _Cells, part: range, left: int, grouped: int, bold: Sequence[bool]) -> Iterator[str]:
    """The rows; leading values that do not change stand in the first row only, with a gap above it."""
    before: list[list[str]] = []
    for number in part:
        row = cells.rows[number]
        same = next((i for i in range(grouped) if before[i : i + 1] != row[i : i + 1]), grouped)
        if before and same < grouped and len(cells.rows) > 2:
            yield "    \\addlinespace"
        texts = []
        for i, cell in enumerate(row):
            text = "" if i < same else _cell(cell, "l" if i < left else "r", "t", strong=bold[number] and i == left - 1)
            texts.append(text)
        yield "    " + " & ".join(texts) + " \\\\"
        before = row


def _cell(lines: list[str], side: str, place: str, *, strong: bool = False) -> str:
    """A cell of one line or, as a table within the table, of several."""
    safe = [re.sub(r"^(?=[\[*])", "{}", latex_text(line)) for line in lines]  # [ and * would be options of a line end
    if strong:
        safe = [f"\\textbf{{{line}}}" for line in safe]
    if len(safe) == 1:
        return safe[0]
    return f"\\begin{{tabular}}[{place}]{{@{{}}{side}@{{}}}}" + " \\\\ ".join(safe) + "\\end{tabular}"
