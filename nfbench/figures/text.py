"""Text that fits: its width as it is printed, and lines and names that are no wider than their place."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

from matplotlib.font_manager import FontProperties
from matplotlib.textpath import text_to_path

from .labels import plain, short

__all__ = ["fitted", "fitted_apart", "text_width", "wrapped"]

FONT = "DejaVu Sans"
LEAST = 8  # characters that a shortened name keeps
WIDER = (1.0, 1.15, 1.3, 1.45)  # times the width of names that would otherwise be cut to the same


@lru_cache(maxsize=20_000)
def text_width(text: str, points: float) -> float:
    """The width of a line of text [in] in our font at a size [pt]; nothing in it is mathematics."""
    if not text:
        return 0.0
    font = FontProperties(family=FONT, size=points)
    measure: Any = text_to_path.get_text_width_height_descent  # without types in some versions of matplotlib
    return float(measure(text, font, ismath=False)[0]) / 72


def wrapped(text: str, inches: float, points: float) -> list[str]:
    """The lines of a text that are no wider than this: broken at spaces, or within a word that is wider than a line.

    A no-break space keeps what it joins together where there is room. Spaces at the ends of lines are left out.
    """
    if "\n" in text:
        return [line for part in text.split("\n") for line in wrapped(part, inches, points)]
    lines: list[str] = []
    line = ""
    for word in re.findall("[^ ]+", text):
        longer = f"{line} {word}" if line else word
        if text_width(longer, points) <= inches:
            line = longer
            continue
        if line:
            lines.append(line)
        *whole, line = _pieces(word, inches, points)
        lines += whole
    return [*lines, line] if line else lines


def _pieces(word: str, inches: float, points: float) -> list[str]:
    """A word in pieces that are no wider than this, broken at its no-break spaces where possible."""
    if text_width(word, points) <= inches:
        return [word]
    parts = word.split("\N{NO-BREAK SPACE}")
    if len(parts) > 1:
        return wrapped(" ".join(parts), inches, points)
    most = next((n for n in range(len(word), 1, -1) if text_width(word[:n], points) <= inches), 1)
    return [word[:most], *(_pieces(word[most:], inches, points) if word[most:] else [])]


def fitted(name: str, inches: float, points: float) -> str:
    """A method's name in one line that is no wider than this, for matplotlib: cut in the middle if it is too wide."""
    for most in range(len(name), LEAST - 1, -1):
        found = short(name, most)
        if text_width(found.replace(r"\$", "$"), points) <= inches:
            return found
    return plain(name) if len(name) <= LEAST else found


def fitted_apart(names: Sequence[str], inches: float, points: float) -> list[str]:
    """Names that are no wider than this, or up to half wider where they would be the same otherwise."""
    for factor in WIDER:
        found = [fitted(name, factor * inches, points) for name in names]
        if len(set(found)) == len(set(names)):
            break
    return found
