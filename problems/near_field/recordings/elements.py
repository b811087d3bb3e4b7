"""Elements of an array in sentences: their numbers and names, and how to leave them out."""

from __future__ import annotations

from collections.abc import Sequence

__all__ = ["elements_text", "leave_out"]


def elements_text(numbers: Sequence[int], names: Sequence[str]) -> str:
    """Return "element 5 (M06), counted from 0," or "elements 5 (M06) and 19 (M20), counted from 0,".

    names: names of all elements, of which those that are just the numbers are left out.
    """
    listed = [f"{m}" if names[m] == str(m) else f"{m} ({names[m]})" for m in numbers]
    if len(listed) == 1:
        return f"element {listed[0]}, counted from 0,"
    return f"elements {', '.join(listed[:-1])} and {listed[-1]}, counted from 0,"


def leave_out(numbers: Sequence[int]) -> str:
    """Return the remedy for elements that are of no use."""
    which, flag = ", ".join(map(str, numbers)), ",".join(map(str, numbers))
    return f"leave {'it' if len(numbers) == 1 else 'them'} out: failed = [{which}] (--failed {flag})"
