"""Labels that survive the way through a CSV file: spreadsheets and pandas read them back as they were written."""

from __future__ import annotations

import re
import unicodedata
from contextlib import suppress

__all__ = ["LONGEST", "label_problem", "safe_label"]

LONGEST = 200  # characters
MISSING = frozenset({"n/a", "na", "nan", "null", "none", "nil"})  # with any marks around them, e.g. <NA>, #N/A, -nan
BOOLEANS = frozenset({"true", "false"})
FORMULA = frozenset("=+-@")
MONTH = (
    r"(?:jan(?:uary)?|feb(?:ruary)?|mar(?:ch)?|apr(?:il)?|may|june?|july?|aug(?:ust)?|sept?(?:ember)?|oct(?:ober)?"
    r"|nov(?:ember)?|dec(?:ember)?)"
)
DATE = re.compile(rf"\d{{1,4}}[-/. ]*{MONTH}(?:[-/. ,]*\d{{1,4}})?|{MONTH}[-/. ,]*\d{{1,4}}(?:[-/. ,]+\d{{1,4}})?")
TIME = re.compile(r"\d{1,2}(?::\d{2}){0,2}(?: ?[ap]m| [ap])")
OTHER_NUMBER = re.compile(r"0x[0-9a-f]+|[-+]?[\d.,]+e[-+]?\d+|1\.#\w+")


def label_problem(label: str) -> str | None:
    """Return what is wrong with a label, as ``expected …, got …``; None if nothing is.

    A label must contain a letter, and must not be what pandas or a spreadsheet takes for something else: a missing
    value, a truth value, a number, a date or time, or a formula. It must consist of printable characters, without
    blanks around them.
    """
    if expected := _expected(label):
        return f"expected {expected}, got {label[:LONGEST]!r}"
    return None


def _expected(label: str) -> str | None:
    bare = label.strip().casefold()
    if not bare:
        return "a label that is not empty"
    if any(unicodedata.category(character) in ("Cc", "Cf", "Cs", "Zl", "Zp") for character in label):
        return "a label without control characters, tabs and line breaks"
    if label != label.strip():
        return "a label without blanks around it"
    if len(label) > LONGEST:
        return f"a label of at most {LONGEST} characters"
    if unicodedata.normalize("NFKC", label)[0] in FORMULA:
        return "a label that does not start with =, +, - or @, which a spreadsheet takes for a formula"
    if bare.strip("<>#+-") in MISSING or bare.startswith(("#n/a", "#na ")) or bare == "#na":
        return "a label that pandas does not take for a missing value"
    if bare in BOOLEANS:
        return "a label that is not read back as a truth value"
    if _is_number(bare) or not any(character.isalpha() for character in bare):
        return "a label with letters, which is not read back as a number or date"
    if DATE.fullmatch(bare) or TIME.fullmatch(bare):
        return "a label that a spreadsheet does not take for a date or time"
    return None


def _is_number(text: str) -> bool:
    with suppress(ValueError):
        float(text)
        return True
    return OTHER_NUMBER.fullmatch(text) is not None


def safe_label(label: str, kind: str) -> str:
    """Return a default label as it is, or with the kind of plugin in front if it would be refused as a given label."""
    if not _expected(label):
        return label
    printed = "".join(character if character.isprintable() else " " for character in label).strip()
    return f"{kind} {printed}"[:LONGEST].rstrip()
