"""Which methods a figure shows in colour: all of a few methods, and the best ones of many."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from nfbench.analysis import ALL, Block
from nfbench.core import NfbenchError, nearest
from nfbench.results import Evidence

from .style import MANY

__all__ = ["best_first", "highlighted"]

FEW = 5  # methods in colour where there are too few scenes to rank


def highlighted(methods: Sequence[str], named: Sequence[str], evidence: Evidence) -> list[str]:
    """The methods in colour: the named ones and the best set, or all if none is named and there are at most eight.

    methods: labels, in the study's order. named: labels of methods that must be in colour.

    The best set is that of the ranking over all swept points, followed by methods that are in the best set at single
    points, as far as there are colours. Where there are too few scenes to rank, those with the best mean rank take
    their place. Raises NfbenchError if a method is unknown or more are named than there are colours.
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
    return list(dict.fromkeys([*named, *best_first(evidence)]))[:MANY]


def best_first(evidence: Evidence) -> list[str]:
    """The methods of the best sets, the best first."""
    blocks = evidence.ranking.blocks
    overall = [block for block in blocks if _is_overall(block)] or list(blocks[:1])
    found = [block.methods[i] for block in overall for i in block.order]
    often = Counter(block.methods[i] for block in blocks for i in block.order)
    found += [name for name, _ in often.most_common()]
    if found or not blocks:
        return found
    frame = evidence.ranking.frame
    return list(frame.groupby("method", sort=False)["mean_rank"].mean().sort_values(kind="stable").index[:FEW])


def _is_overall(block: Block) -> bool:
    return any(isinstance(value, str) and value == ALL for value in block.swept.values())
