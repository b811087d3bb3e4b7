"""The known name that was probably meant, for error messages."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable

__all__ = ["nearest", "suggest"]


def suggest(name: str, known: Iterable[str]) -> str:
    """Return ``; did you mean "x"?`` with the nearest name of ``known``, or else ``; known: …`` with all names."""
    known = sorted(known)
    if near := nearest(name, known):
        return f'; did you mean "{near}"?'
    return f"; known: {', '.join(known)}" if known else ""


def nearest(name: str, known: Iterable[str]) -> str | None:
    """Return the name of ``known`` that was probably meant; None if there is none.

    Case, signs and leading zeros do not matter: "CMA-ES" is nearest to "cmaes", "M6" to "M06" and "z" to "+z".
    """
    if len(name) > 100:
        return None
    bare = {each: _bare(each) for each in known}
    same = [each for each, own in bare.items() if own and own == _bare(name)]
    near = same or difflib.get_close_matches(name, bare, n=1)
    if not near:  # the closest of those that are the same but for a few letters
        found = difflib.get_close_matches(_bare(name), bare.values(), n=1)
        near = [each for each, own in bare.items() if own in found]
    return near[0] if near else None


def _bare(name: str) -> str:
    """A name in lower case without signs and leading zeros."""
    return re.sub(r"0+(?=[0-9])", "", re.sub(r"[\W_]+", "", name.casefold()))
