"""The verdict on a ranking in words, which states only what the data support."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool
from numpy import ndarray
from scipy.special import ndtri

from .intervals import ratio_interval
from .ranking import ALL, ERROR_TIE, SHARES, Block, Ranking, share_solved, typical_errors, typical_seconds
from .sign_flips import hit_scores, log_ratios

__all__ = ["cost_text", "names", "sentence", "sentences", "time_text"]

MOST = 6  # labels that a list names before it counts the rest
TRADES = 2  # trade-offs that a verdict names
POWER = 0.8  # with which a trade-off would be decided


def sentences(ranking: Ranking) -> list[str]:
    """Return the verdict on each block of a ranking, in the order of its blocks."""
    return [sentence(block, stopped=ranking.stopped) for block in ranking.blocks]


def sentence(block: Block, *, stopped: bool = False) -> str:
    """Return the verdict on one block: most reliable, among these most accurate, among these cheapest.

    stopped: whether the runs stopped at a target, so that errors were not ranked.
    """
    n, k = block.n, len(block.methods)
    over = ""
    if len(block.points) > 1 or ALL in block.swept.values():
        over = f"Over all {len(block.points)} swept points: "
    if n == 0:
        return f"{over}{'no' if over else 'No'} scene was finished by all {k} methods, so nothing is ranked."
    parts = [over + _unranked(block)] if not block.stages else _ranked(block, over, stopped)
    if left_out := max(each.left_out for each in block.points):
        reason = "not finished by all methods, or the target does not apply"
        parts.append(f"{_scenes(left_out)} left out: {reason}.")
    return " ".join(parts)


def names(labels: Sequence[str], most: int = MOST) -> str:
    """Return the labels as a list in words: "a, b and c", or the first few "and 12 more"."""
    labels = [f'"{label}"' if "," in label or " and " in label else label for label in labels]
    if len(labels) > most + 1:
        return f"{', '.join(labels[:most])} and {len(labels) - most} more"
    return " and ".join(filter(None, [", ".join(labels[:-1]), *labels[-1:]]))


def _unranked(block: Block) -> str:
    n, k = block.n, len(block.methods)
    if k == 1:
        return f"{block.methods[0]} is the only method; on {_scenes(n)} {_solved(block, 0)}."
    return f"{_scenes(n)} cannot rank {k} methods; {block.needed} would."


def _ranked(block: Block, over: str, stopped: bool) -> list[str]:
    """Return the sentences of a block that has enough scenes."""
    n, k = block.n, len(block.methods)
    if k == 1:
        return [over + _unranked(block), *_no_miss(block)]
    parts = []
    reliable = _members(block, "reliability")
    hit = f"hit {_target(block)}" if block.points[0].target else "end with an estimate"
    if len(reliable) == k:
        parts.append(f"{over}on {_scenes(n)} none of {k} methods is significantly more likely to {hit} than another.")
    else:
        listed = names([block.methods[i] for i in reliable])
        parts.append(f"{over}on {_scenes(n)} {listed} {_is(reliable)} the most likely of {k} methods to {hit}.")
    parts += _no_miss(block)
    if stopped:
        parts.append("The runs stopped at the target, so methods are ranked by cost, not by error.")
    else:
        parts.append(_most_accurate(block, reliable))
    parts.append(_recommended(block))
    parts += _trades(block)
    parts += [
        f"The order by {stage.name} is circular: every method is beaten by another, and the set holds those at the top."
        for stage in block.stages
        if stage.best.circular
    ]
    return [part if part.startswith(block.methods) else part[:1].upper() + part[1:] for part in parts if part]


def _most_accurate(block: Block, reliable: list[int]) -> str:
    accurate, name = _members(block, "error"), _measure(block)
    if len(reliable) == 1:
        return ""
    which = "all" if len(reliable) == len(block.methods) else "these"
    among = f"Among {which} {len(reliable)} methods"
    stage = block.stage("error")
    if stage is not None and len(accurate) == len(reliable) and stage.traded.any():
        return f"{among}, a lower {name} comes with visibly more failures."
    if len(accurate) == len(reliable):
        return f"{among}, no difference in {name} is significant."
    return f"{among}, {names([block.methods[i] for i in accurate])} {_has(accurate)} the lowest {name}."


def _recommended(block: Block) -> str:
    """Name the first method of the final set, what it costs, and the others of the set."""
    first, *rest = block.order
    method, cost = block.methods[first], block.ert[first]
    others = f"; not distinguishable from it: {names([block.methods[i] for i in rest])}" if rest else ""
    if math.isinf(cost):
        return f"No method of the best set has a known cost to hit the target; first by mean rank: {method}{others}."
    how = _reason(block) if rest else "alone in the best set"
    if not rest and len(_members(block, "reliability")) > 1:
        how = "the cheapest of them"
    return f"Recommended: {method}, {how} ({cost_text(block, first)}){others}."


def cost_text(block: Block, i: int) -> str:
    """Return what a hit of a method costs, in words; empty if that is not known."""
    cost = float(block.ert[i])
    if not math.isfinite(cost):
        return ""
    if cost == 0:  # a method without a solver
        return f"typically {time_text(typical_seconds(block.points, i))} from the start of a run to its hit"
    return f"{cost:,.0f} evaluations per hit" if cost >= 10 else f"{cost:.3g} evaluations per hit"


def time_text(seconds: float, *, up: bool = False) -> str:
    """A time with three digits in a unit that suits it. up: whether it is rounded up, as a limit that suffices."""
    if up and seconds > 0:
        step = 10.0 ** (math.floor(math.log10(seconds)) - 2)
        seconds = math.ceil(seconds / step * (1 - 1e-12)) * step
    if seconds == 0:
        return "0 s"
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("µs", 1e-6)):
        if seconds >= 0.9995 * size:
            return f"{float(f'{seconds / size:.3g}'):,.6g} {unit}"
    return f"{seconds / 1e-9:.3g} ns"


def _reason(block: Block) -> str:
    """State what puts the recommended method before the others of the final set, none of which is significant."""
    first, *rest = block.order
    shares = [share_solved(block.points, i) for i in block.order]
    if shares[0] > max(shares[1:]):
        return f"which solved the most of {len(shares)} methods that are not significantly different"
    equal = [i for i, share in zip(rest, shares[1:], strict=True) if share == shares[0]]
    error = typical_errors(block.points)
    if block.stage("error") is not None and all(error[i] > ERROR_TIE * error[first] for i in equal):
        return (
            "the most accurate of those that solved the most" if len(equal) < len(rest) else "the most accurate of them"
        )
    return "the cheapest of those that solved the most" if len(equal) < len(rest) else "the cheapest of them"


def _measure(block: Block) -> str:
    """The error measure in words where there are any."""
    name = block.points[0].error_name
    return {"rmse_m": "error", "gospa_m": "GOSPA"}.get(name, name)


def _trades(block: Block) -> list[str]:
    """State the trade-offs that kept a method in the set: another has the lower error, but fails more often."""
    found: list[str] = []
    for stage in block.stages:
        for i, j in np.argwhere(stage.traded)[: TRADES - len(found)]:
            found.append(_trade(block, stage.name, int(i), int(j)))
    return found


def _trade(block: Block, name: str, i: int, j: int) -> str:
    """State that j has the lower error or cost than i, and i solved more scenes."""
    more, less = _discordant(block, i, j)
    extra = more - less
    a, b, what = block.methods[j], block.methods[i], "cost"
    gain = f"{a} typically costs less than {b}"
    if name == "error":
        what = _measure(block)
        d = [log_ratios(each.error[:, j], each.error[:, i], ties=False) for each in block.points]
        ratio = ratio_interval(d[0])[0] if len(d) == 1 else math.nan
        percent = "" if math.isnan(ratio) else f"{100 * (1 - ratio):.0f} % "
        gain = f"{a} typically has a {percent}lower {what} than {b}"
    one = len(block.points) == 1 and max(block.points[0].runs[[i, j]]) == 1
    solved = (
        f"solved {extra} more of {block.n} scenes" if one else f"hit more often in {extra} more of {block.n} scenes"
    )
    k = len(block.methods)
    z = -float(ndtri(SHARES["reliability"] / (k * (k - 1)))) + float(ndtri(POWER))
    needed = math.ceil(z**2 * (more + less) * block.n / extra**2)
    return f"{gain}, but {b} {solved}: a trade-off; about {needed:,} scenes would decide."


def _discordant(block: Block, i: int, j: int) -> tuple[int, int]:
    """Return the number of scenes in which i hits more often than j, and in which j does."""
    score = sum(hit_scores(each.hits[:, i], each.runs[i], each.hits[:, j], each.runs[j]) for each in block.points)
    return int(np.sum(score > 0)), int(np.sum(score < 0))


def _no_miss(block: Block) -> list[str]:
    """State what no miss of a recommended method still leaves open."""
    inside = block.order or (0,)
    full: list[Bool[ndarray, " k"]] = [(each.hits == each.runs).all(axis=0) for each in block.points]
    clean = [i for i in inside if all(each[i] for each in full)]
    if not clean or block.n <= 3:
        return []
    bound = 3 / block.n
    percent = f"{100 * bound:.0f}" if bound >= 0.01 else f"{100 * bound:.2g}"
    verb = "misses none" if len(clean) == 1 else "miss none"
    return [
        f"{names([block.methods[i] for i in clean])} {verb} of {_scenes(block.n)}; up to {percent} % may still fail."
    ]


def _solved(block: Block, i: int) -> str:
    """State how many runs of a method hit the target."""
    hits = sum(int(each.hits[:, i].sum()) for each in block.points)
    runs = sum(int(each.runs[i]) for each in block.points) * block.n
    target = _target(block)
    return f"{hits} of {runs} runs {f'hit {target}' if target else 'ended with an estimate'}"


def _target(block: Block) -> str:
    """The first target, with its unit if it is an error in metres; empty if there is none."""
    first = block.points[0]
    metres = first.target.startswith("error") and "bound" not in first.target and first.error_name.endswith("_m")
    return f"{first.target} m" if metres else first.target


def _members(block: Block, name: str) -> list[int]:
    stage = block.stage(name)
    return [] if stage is None else np.flatnonzero(stage.best.inside).tolist()


def _scenes(n: int) -> str:
    return f"{n} scene{'' if n == 1 else 's'}"


def _is(which: list[int]) -> str:
    return "is" if len(which) == 1 else "are"


def _has(which: list[int]) -> str:
    return "has" if len(which) == 1 else "have"
