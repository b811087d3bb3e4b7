"""Reads the "name: text" paragraphs in which our docstrings describe options and arguments."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

__all__ = ["Described", "described", "docstring", "escaped"]


@dataclass(frozen=True)
class Described:
    """A docstring in two parts: paragraphs of prose, and the text of each name that it describes."""

    prose: tuple[str, ...]
    texts: dict[str, str]


def described(docstring: str, names: Iterable[str]) -> Described:
    """Split a docstring (indentation already removed) into prose and the descriptions of these names.

    A description begins with one name or several ("alpha, delta_min: …"), at the start of a line or of a sentence, and
    ends at the next one or at the end of the paragraph. Names that share a description get the same text.
    """
    known = "|".join(sorted(map(re.escape, names), key=len, reverse=True))
    prose: list[str] = []
    texts: dict[str, str] = {}
    for paragraph in re.split(r"\n\s*\n", docstring.strip()):
        if re.match(r"[*-] ", paragraph):  # a list, whose lines are its items
            prose.append(paragraph)
            continue
        pieces = list(_pieces(paragraph, known)) if known else [((), paragraph)]
        for found, text in pieces:
            flat = " ".join(text.split())
            if not found and flat:
                prose.append(text if "\n    " in text and len(pieces) == 1 else flat)
            for name in found:
                texts[name] = _sentence(flat)
    return Described(tuple(prose), texts)


def docstring(cls: type) -> str:
    """A class's own docstring; empty where it has none but the signature that ``@dataclass`` makes up."""
    text = inspect.cleandoc(vars(cls).get("__doc__") or "")
    return "" if text.startswith(f"{cls.__name__}(") else text


def _pieces(paragraph: str, known: str) -> Iterator[tuple[tuple[str, ...], str]]:
    """(names, text) in order; what precedes the first name has no names."""
    start = re.compile(rf"(?:(?<=^)|(?<=\n)|(?<=[.;)] )|(?<=\.\n)|(?<=, or ))\s*((?:{known})(?:, (?:{known}))*):\s")
    matches = list(start.finditer(paragraph))
    yield (), paragraph[: matches[0].start()] if matches else paragraph
    for match, following in zip(matches, [*matches[1:], None][: len(matches)], strict=True):
        end = following.start() if following else len(paragraph)
        yield tuple(match[1].split(", ")), paragraph[match.end() : end]


def _sentence(text: str) -> str:
    """A description as a sentence of its own: a capital first, a full stop at the end."""
    text = re.sub(r"(,| or|;|, or)+$", "", text.strip()).rstrip(".;,")
    if re.match(r"(a|an|[a-z]{3,})\b(?![_(=])", text) and not text.startswith(("scipy", "nlopt")):
        text = text[0].upper() + text[1:]
    return f"{text}." if text else ""


def escaped(text: str) -> str:
    """Text in which only double backquotes and Sphinx roles keep their meaning in reStructuredText."""
    parts = re.split(r"(``.+?``|:\w+:`[^`]+`)", text, flags=re.DOTALL)
    out = []
    for i, part in enumerate(parts):
        if i % 2:  # a literal may touch letters, which reStructuredText allows after an escaped space
            before, after = parts[i - 1][-1:], parts[i + 1][:1]
            out.append(f"{'' if _ends(before) else chr(92) + ' '}{part}{'' if _ends(after) else chr(92) + ' '}")
        else:
            plain = re.sub(r"([*|\\]|(?<!`)`(?!`)|_(?=\W|$))", r"\\\1", part)
            out.append(re.sub(r"\b(?!https?:|mailto:)(\w+)://", r"\1\\://", plain))  # no link to an address of ours
    return "".join(out)


def _ends(character: str) -> bool:
    """Whether markup may begin or end beside this character."""
    return not character or character in " \n-:/'\"<([{>)]}.,;!?"
