"""Reads the rows of runs in pages, so that a slow reader neither fills the memory nor blocks the writer."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from typing import Any

__all__ = ["pages"]

PAGE = 256  # runs that are read at once, with their traces
Rows = Iterator[tuple[list[Any], tuple[Any, ...]]]


def pages(
    checked: Callable[[str, Sequence[str], str, Sequence[Any]], Rows],
    names: Sequence[str],
    only: Sequence[str] | None = None,
) -> Iterator[list[list[Any]]]:
    """Yield ``ordinal``, ``run_id`` and the columns ``names`` of the finished runs of the plan, page by page.

    checked: ``Store.checked``. only: identifiers of runs, which are yielded in this order; unknown ones are left out.
    None for all runs, in the order of the plan.
    """
    columns, source = ("ordinal", "run_id", *names), "FROM plan JOIN results USING (run_id) WHERE"
    if only is None:
        page: list[list[Any]] = [[-1]]
        while page:
            rows = checked("results", columns, f"{source} ordinal > ? ORDER BY ordinal LIMIT ?", [page[-1][0], PAGE])
            yield (page := [values for values, _ in rows])
        return
    for start in range(0, len(only), PAGE):
        place = {run_id: i for i, run_id in enumerate(only[start : start + PAGE])}
        wanted = [json.dumps(list(place))]
        rows = checked("results", columns, f"{source} run_id IN (SELECT value FROM json_each(?))", wanted)
        yield sorted((values for values, _ in rows), key=lambda values: place[values[1]])
