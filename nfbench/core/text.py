"""Text from plugins and files, made safe to store and to print."""

from __future__ import annotations

import unicodedata

__all__ = ["printable"]

MESSAGE_BYTES = 4096
_MARKS = {"\u2028", "\u2029"}  # line and paragraph separators, which some readers take for the end of a row


def printable(text: object, limit: int = MESSAGE_BYTES) -> str:
    """The text in one line of valid UTF-8, without control characters, and no longer than ``limit`` bytes.

    Line breaks and tabs become blanks, other control characters their escape (``\\x1b``), and lone surrogates a
    question mark. A text that is too long ends in an ellipsis.
    """
    text = str(text)
    if len(text) <= limit and text.isascii() and text.isprintable():  # the usual case, for each run of a study
        return text
    line = "".join(map(_printable_character, text.encode("utf-8", "replace").decode("utf-8")))
    encoded = line.encode("utf-8")
    if len(encoded) <= limit:
        return line
    return encoded[: limit - 3].decode("utf-8", "ignore") + "…"


def _printable_character(character: str) -> str:
    if character in "\n\r\t\v\f" or character in _MARKS:
        return " "
    if unicodedata.category(character) in ("Cc", "Cf") and character not in "\u00ad\u200d":
        return character.encode("unicode_escape").decode("ascii")
    return character
