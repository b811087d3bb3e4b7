"""The tests of which a claim consists: one per swept point, pair of methods, step or limit, as its kind asks for."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from scipy.stats import binom

from nfbench.study import Compare, Names

from .intervals import Estimate, bounded_mean_interval, mean_pvalue, ratio_interval, share_interval
from .outcomes import Outcomes, Point, common
from .sign_flips import hit_scores, log_ratios, mean_over_points, one_sided, signed_ranks

__all__ = ["Part", "failure_counts", "kendall", "methods_of", "parts_of", "same_value", "values_of"]

FLOOR = 0.8  # default limit of a floor


@dataclass(frozen=True)
class Part:
    """One test: one-sided p-values for the part and against it, an estimate with its interval, number of scenes."""

    p: float
    against: float
    estimate: Estimate
    scenes: int


def parts_of(compare: Compare, points: Sequence[Point]) -> list[Part]:
    """Return the tests of a claim; all must hold. An empty list means that no swept point has its methods.

    Raises ValueError for methods, keys, values or columns that the outcomes do not have.
    """
    points = _chosen(compare, points)
    if not points:
        return []
    tests = {
        "better": _better,
        "equal": _equal,
        "grows": _trend,
        "falls": _trend,
        "degrades": _degrades,
        "changes": _changes,
        "floor": _changes,
        "exponent": _exponent,
        "fails": _fails,
    }
    return list(tests[compare.kind](compare, points))


def _chosen(compare: Compare, points: Sequence[Point]) -> list[Point]:
    """Return the points with the chosen values of the key."""
    if compare.key and points and not all(compare.key in swept for swept, _ in points):
        known = ", ".join(points[0][0]) or "no swept keys"
        raise ValueError(f"key: expected a swept key ({known}), got {compare.key}")
    if not compare.values:
        return list(points)
    chosen = [point for point in points if any(same_value(point[0][compare.key], value) for value in compare.values)]
    for value in compare.values if points else ():
        _find(compare.key, value, [swept[compare.key] for swept, _ in points])
    return chosen


def same_value(stored: Any, wanted: Any) -> bool:
    """Return whether a swept value is the one that a claim names; stored values may be text."""
    if stored == wanted or str(stored) == str(wanted):
        return True
    if isinstance(wanted, tuple | list):
        return _listed(stored) == _listed(wanted)
    try:
        return float(stored) == float(wanted)
    except (TypeError, ValueError):
        return False


def _listed(value: Any) -> list[str]:
    """Return the items of a list, which may be text; numbers are written alike."""
    items = value.strip("[]() ").split(",") if isinstance(value, str) else value
    if not isinstance(items, list | tuple):
        return [str(value)]
    texts = [str(item).strip(" '\"") for item in items]
    with contextlib.suppress(ValueError):
        return [repr(float(text)) for text in texts]
    return texts


def _find(key: str, value: Any, stored: Sequence[Any]) -> int:
    """Return the position of a value among those of a swept key."""
    for position, each in enumerate(stored):
        if same_value(each, value):
            return position
    raise ValueError(f"{key}: expected one of its swept values ({', '.join(map(str, stored))}), got {value}")


def methods_of(names: Names, points: Sequence[Point], but: Sequence[str] = ()) -> list[str]:
    """Return the methods that a claim names; "all" and "others" stand for all of the points, without ``but``."""
    known = list(dict.fromkeys(method for _, each in points for method in each.methods))
    listed = [names] if isinstance(names, str) else list(names)
    if listed in (["all"], ["others"]):
        return [method for method in known if method not in but]
    if wrong := [name for name in listed if name not in known]:
        raise ValueError(f"methods: expected some of {', '.join(known)}, got {wrong[0]}")
    return listed


def values_of(each: Outcomes, method: str, measure: str) -> Float[ndarray, " n"]:
    """Return the values of a method, one per scene, ∞ where there is none."""
    i = each.methods.index(method)
    if measure in ("error", each.error_name):
        return each.error[:, i]
    if measure == "evaluations":
        return each.cost[:, i]
    if measure not in each.columns:
        known = ", ".join(["error", "evaluations", *each.columns])
        raise ValueError(f"measure: expected one of {known}, got {measure}")
    return each.columns[measure][:, i]


def _with(points: Sequence[Point], *methods: str) -> list[Point]:
    """Return the points that have these methods, with these only, all on the same scenes."""
    return common([(s, each.select(methods=methods)) for s, each in points if set(methods) <= set(each.methods)])


def _groups(compare: Compare, points: Sequence[Point], *methods: str) -> list[list[Point]]:
    """Return the points that differ in the key only, ordered along it, for each combination of the other keys."""
    groups: dict[str, list[Point]] = {}
    for swept, each in _with(points, *methods):
        others = {name: value for name, value in swept.items() if name != compare.key}
        groups.setdefault(str(others), []).append((swept, each))

    def place(point: Point) -> float:
        value = point[0][compare.key]
        if compare.values:
            return float(_find(compare.key, value, compare.values))
        try:
            return float(value)
        except (TypeError, ValueError):
            return 0.0  # values without an order keep that of the sweep

    return [sorted(group, key=place) for group in groups.values()]


def _part(
    support: Sequence[Float[ndarray, " n"]], estimate: Estimate, opposed: Sequence[Float[ndarray, " n"]] | None = None
) -> Part:
    """Return the test that numbers, one array of scenes per point, tend to be positive; their scores are summed.

    opposed: the numbers for the opposite, the negative ones of support if None.
    """
    opposed = [-x for x in support] if opposed is None else opposed
    scores, against = (np.sum([signed_ranks(x) for x in each], axis=0) for each in (support, opposed))
    return Part(one_sided(scores), one_sided(against), estimate, len(support[0]))


def _parts(
    compare: Compare, support: Sequence[Float[ndarray, " n"]], logs: Sequence[Float[ndarray, " n"]]
) -> Iterator[Part]:
    """Yield one test per point, or one of all points. logs: logarithms of the ratios to estimate, per point."""
    if compare.over == "overall":
        yield _part(support, ratio_interval(mean_over_points(np.array(logs))))
    else:
        for x, d in zip(support, logs, strict=True):
            yield _part([x], ratio_interval(d))


def _minus(a: Float[ndarray, " n"], b: Float[ndarray, " n"]) -> Float[ndarray, " n"]:
    """Return a − b, with 0 for equal infinities."""
    with np.errstate(invalid="ignore"):
        return np.where(a == b, 0.0, a - b)


def _ratios(compare: Compare, points: Sequence[Point], a: str, b: str, ties: bool) -> list[Float[ndarray, " n"]]:
    m = compare.measure
    return [log_ratios(values_of(each, a, m), values_of(each, b, m), ties=ties) for _, each in points]


def _better(compare: Compare, points: Sequence[Point]) -> Iterator[Part]:
    shift = math.log(compare.factor or 1.0)
    winners = methods_of(compare.better, points)
    for a in winners:
        for b in methods_of(compare.worse, points, winners):
            shared = _with(points, a, b)
            if compare.measure == "hits":
                yield from _more_hits(compare, shared)
                continue
            logs = _ratios(compare, shared, a, b, ties=False)
            d = logs if shift else _ratios(compare, shared, a, b, ties=True)
            yield from _parts(compare, [shift - each for each in d], logs)


def _more_hits(compare: Compare, points: Sequence[Point]) -> Iterator[Part]:
    """Yield the tests that the first of two methods hits the first target more often; the estimate is its share."""
    scores = [hit_scores(o.hits[:, 0], o.runs[0], o.hits[:, 1], o.runs[1]) for _, o in points]
    groups = [points] if compare.over == "overall" else [[point] for point in points]
    parts = [np.sum(scores, axis=0)] if compare.over == "overall" else scores
    for v, group in zip(parts, groups, strict=True):
        share = np.mean([each.hits[:, 0] / each.runs[0] for _, each in group], axis=0)
        estimate = (float(np.mean(share)), *bounded_mean_interval(share)) if len(share) else (math.nan,) * 3
        yield Part(one_sided(v), one_sided(-v), estimate, len(v))


def _equal(compare: Compare, points: Sequence[Point]) -> Iterator[Part]:
    a, b = methods_of(compare.equal, points)
    logs = _ratios(compare, _with(points, a, b), a, b, ties=False)
    limit = math.log(compare.factor or 1.0)
    for sign in (1.0, -1.0):
        yield from _parts(compare, [limit - sign * d for d in logs], logs)


def _trend(compare: Compare, points: Sequence[Point]) -> Iterator[Part]:
    sign = 1.0 if compare.kind == "grows" else -1.0
    for method in methods_of(compare.grows or compare.falls, points):
        groups = [group for group in _groups(compare, points, method) if len(group) > 1]
        rows = [np.array([values_of(each, method, compare.measure) for _, each in group]) for group in groups]
        logs = [log_ratios(row[-1], row[0], ties=False) for row in rows]
        if compare.every_step:
            for step in range(max(map(len, rows), default=1) - 1):
                each = [row for row in rows if len(row) > step + 1]
                d = [log_ratios(row[step + 1], row[step]) for row in each]
                yield from _parts(compare, [sign * x for x in d], d)
        elif rows:
            yield from _parts(compare, [sign * kendall(row) for row in rows], logs)


def kendall(rows: Float[ndarray, "p n"]) -> Int[ndarray, " n"]:
    """Return Kendall's S of each scene over the p points: pairs that rise less pairs that fall; ∞ ranks last."""
    i, j = np.triu_indices(len(rows), 1)
    return np.sum((rows[j] > rows[i]).astype(np.int64) - (rows[j] < rows[i]), axis=0)


def _ends(compare: Compare, group: Sequence[Point], method: str) -> Float[ndarray, " n"]:
    """Return the logarithm of the ratio of the values at stop and start, or at the last and first point."""
    stored = [swept[compare.key] for swept, _ in group]
    first, last = 0, len(group) - 1
    if compare.start is not None:
        first, last = (_find(compare.key, value, stored) for value in (compare.start, compare.stop))
    a, b = (values_of(group[position][1], method, compare.measure) for position in (last, first))
    return log_ratios(a, b, ties=False)


def _degrades(compare: Compare, points: Sequence[Point]) -> Iterator[Part]:
    a, b = methods_of(compare.degrades, points), methods_of(compare.more_than, points)
    if len(a) == 2:
        shared = _with(points, *dict.fromkeys([*a, *b]))
        mine, other = (_ratios(compare, shared, pair[1], pair[0], ties=False) for pair in (a, b))
        contrasts = [_minus(x, y) for x, y in zip(mine, other, strict=True)]
        yield from _parts(compare, contrasts, contrasts)
        return
    groups = [group for group in _groups(compare, points, a[0], b[0]) if len(group) > 1]
    logs = [_minus(_ends(compare, group, a[0]), _ends(compare, group, b[0])) for group in groups]
    support = logs
    if compare.start is None:
        rows = [
            [np.array([values_of(each, method, compare.measure) for _, each in group]) for method in (a[0], b[0])]
            for group in groups
        ]
        support = [(kendall(first) - kendall(second)).astype(np.float64) for first, second in rows]
    if groups:
        yield from _parts(compare, support, logs)


def _changes(compare: Compare, points: Sequence[Point]) -> Iterator[Part]:
    floor = compare.kind == "floor"
    for method in methods_of(compare.changes or compare.floor, points):
        logs = [_ends(compare, group, method) for group in _groups(compare, points, method)]
        lower = FLOOR if floor and compare.at_least is None else compare.at_least
        for limit, sign in ((lower, 1.0), (None if floor else compare.at_most, -1.0)):
            if limit is not None:
                yield from _parts(compare, [sign * (d - math.log(limit)) for d in logs], logs)


def _exponent(compare: Compare, points: Sequence[Point]) -> Iterator[Part]:
    """Yield the tests of the slope of ln value over ln key, by least squares in each scene."""
    for method in methods_of(compare.exponent, points):
        for group in _groups(compare, points, method):
            x = np.log([float(swept[compare.key]) for swept, _ in group])
            y = np.array([values_of(each, method, compare.measure) for _, each in group])
            known = (np.isfinite(y) & (y > 0)).all(axis=0)
            centred = (x - x.mean()) / np.sum((x - x.mean()) ** 2)
            slope = centred @ np.log(np.where(known, y, 1.0))
            found = ratio_interval(slope[known])
            estimate = tuple(math.log(end) for end in found)
            for limit, sign in ((compare.at_least, 1.0), (compare.at_most, -1.0)):
                if limit is None:
                    continue
                # a scene without a slope speaks neither for nor against the claim: it counts against both
                both = [np.where(known, s * (slope - limit), -np.inf) for s in (sign, -sign)]
                yield _part(both[:1], estimate, both[1:])  # type: ignore[arg-type]


def failure_counts(compare: Compare, each: Outcomes, i: int) -> Int[ndarray, " n"]:
    """Return the number of runs per scene of method i that failed, missed the target, or ended with the status."""
    if compare.status:
        return np.asarray(each.ended.get(compare.status, np.zeros_like(each.hits)))[:, i]
    if compare.measure == "hits":
        return each.runs[i] - each.hits[:, i]
    return np.isinf(each.error[:, i]).astype(np.int64) if each.failed is None else each.failed[:, i]


def _fails(compare: Compare, points: Sequence[Point]) -> Iterator[Part]:
    for method in methods_of(compare.fails, points):
        shared = _with(points, method)
        for group in [shared] if compare.over == "overall" else [[point] for point in shared]:
            counts = [failure_counts(compare, each, 0) for _, each in group]
            runs = [int(each.runs[0]) for _, each in group]
            for limit, above in ((compare.at_least, True), (compare.at_most, False)):
                if limit is not None:
                    yield _share_part(counts, runs, limit, above)


def _share_part(counts: Sequence[Int[ndarray, " n"]], runs: Sequence[int], limit: float, above: bool) -> Part:
    """Return the test that a share lies above, or below, the limit; exact for one run per scene and one point."""
    n = len(counts[0])
    if n == 0:
        return Part(1.0, 1.0, (math.nan,) * 3, 0)
    if len(runs) == 1 and runs[0] == 1:
        h = int(counts[0].sum())
        p = float(binom.sf(h - 1, n, limit)), float(binom.cdf(h, n, limit))
        estimate = h / n, *share_interval(h, n)
    else:
        share = np.mean([count / r for count, r in zip(counts, runs, strict=True)], axis=0)
        p = mean_pvalue(share, limit), mean_pvalue(1 - share, 1 - limit)
        estimate = float(share.mean()), *bounded_mean_interval(share)
    return Part(p[0], p[1], estimate, n) if above else Part(p[1], p[0], estimate, n)
