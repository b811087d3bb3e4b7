"""Which methods a figure shows in colour: all of a few methods, and the best ones of many."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

from nfbench.analysis import ALL, Block
from nfbench.core import NfbenchError, nearest
from nfbench.results import Evidence

from .style import MANY

__all__ = ["best_first", "by_mean_rank", "highlighted", "listed"]

LISTED, BEST = 50, 30  # methods that all have a row, and the best ones of more
FEW = 5  # methods in colour where there are too few scenes to rank


def highlighted(
    methods: Sequence[str], named: Sequence[str], evidence: Evidence, families: Mapping[str, object] | None = None
) -> list[str]:
    """The methods in colour: the named ones and the best set, or all if none is named and there are at most eight.

    methods: labels, in the study's order. named: labels of methods that must be in colour. families: family of each
    method; None: each method is its own.

    The best set is that of the ranking over all swept points, followed by methods that are in the best set at single
    points, as far as there are colours. The colours that are left are those of the methods with the best mean ranks,
    one of each family first, which has the same formulation and solver,
    whatever the budget. Raises NfbenchError if a method is unknown or more are named than there are colours.
    """
    for name in named:
        if name not in methods:
            near = nearest(name, methods)
            hint = f"; did you mean {near!r}?" if near else f"; known: {', '.join(methods[:10])}"
            raise NfbenchError(f"methods: expected labels of the study's methods, got {name!r}{hint}")
    if len(named) > MANY:
        raise NfbenchError(f"methods: expected at most {MANY} methods to show in colour, got {len(named)}")
    if not named and len(methods) <= MANY:
        return list(methods)
    best = list(dict.fromkeys([*named, *best_first(evidence)]))[:MANY]
    seen = {_family(name, families) for name in best}
    ranked = by_mean_rank(evidence)
    for name in ranked:
        if (family := _family(name, families)) not in seen:
            seen.add(family)
            best.append(name)
    return list(dict.fromkeys([*best, *ranked]))[:MANY]


def _family(name: str, families: Mapping[str, object] | None) -> object:
    return name if families is None else families.get(name, name)


def listed(order: Sequence[str], coloured: Sequence[str]) -> tuple[list[str], list[str]]:
    """The methods that have a row of their own, and the others, which share one row: none of up to fifty methods.

    order: all methods, the best first. Of more than fifty, the best thirty and those in colour have a row.
    """
    if len(order) <= LISTED:
        return list(order), []
    own = set(order[:BEST]) | set(coloured)
    return [name for name in order if name in own], [name for name in order if name not in own]


def best_first(evidence: Evidence) -> list[str]:
    """The methods of the best sets, the best first."""
    blocks = evidence.ranking.blocks
    overall = [block for block in blocks if _is_overall(block)] or list(blocks[:1])
    found = [block.methods[i] for block in overall for i in block.order]
    often = Counter(block.methods[i] for block in blocks for i in block.order)
    found += [name for name, _ in often.most_common()]
    if found or not blocks:
        return found
    return by_mean_rank(evidence)[:FEW]


def by_mean_rank(evidence: Evidence) -> list[str]:
    """All methods that have a rank, the smallest mean over the swept points first."""
    frame = evidence.ranking.frame
    if frame.empty:
        return []
    means = frame.groupby("method", sort=False)["mean_rank"].mean().dropna()
    return [str(name) for name in means.sort_values(kind="stable").index]


def _is_overall(block: Block) -> bool:
    return any(isinstance(value, str) and value == ALL for value in block.swept.values())
