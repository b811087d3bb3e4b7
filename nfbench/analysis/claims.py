"""Judges what a study is meant to test: every claim is confirmed, contradicted, or not decided by n scenes.

All claims of a study form one family with 5 %: 2.5 % for false confirmations and 2.5 % for false contradictions, each
by Holm's procedure over the claims. A claim that must hold at several points, for several methods or between two limits
is confirmed if each of its tests is, which needs no correction. It is contradicted if one of them is, with Bonferroni's
correction over the tests.

In the manifest a claim is a text and a table ``compare``, whose options are those of ``nfbench.study.Compare``::

    [[claim]]
    text = "NEMO-DE's error lies below 2D MUSIC's at every SNR"
    compare = { better = "nemo + de", worse = "music", measure = "error" }

One option of the table gives the kind of the claim:

* better than another method, at every swept point, at some values, or overall, with the points added up; by a factor,
  or not worse than a factor (``factor = 1.25``)::

    compare = { better = "nemo + de", worse = "music", key = "scenario.snr_db", values = [20] }
    compare = { better = "nemo + de", worse = ["music", "neef + de"], over = "overall" }
    compare = { better = "nemo + de", worse = "neef + de", factor = 1.25 }
    compare = { better = "nemo + de", worse = "neef + de", measure = "runtime_s" }
    compare = { better = "nemo + de", worse = "others", measure = "hits" }

* grows or falls along a swept key; as a trend in each scene, or at every step::

    compare = { grows = "all", key = "scenario.sources" }
    compare = { falls = "nemo + de", key = "scenario.snr_db", every_step = true }

* degrades more than another method along a key, or from one method to a second one more than for another pair::

    compare = { degrades = "nemo + de", more_than = "neef + de", key = "scenario.sources" }
    compare = { degrades = ["fine", "coarse"], more_than = ["modified fine", "modified coarse"], over = "overall" }

* equal within a factor::

    compare = { equal = ["nemo + de", "music"], factor = 1.25 }

* changes between two values of a key by at least or at most a factor; a floor is an error that does not fall below
  0.8 of what it was::

    compare = { changes = "neef + de", key = "scenario.snr_db", start = [20, 20], stop = [0, 40], at_most = 2.0 }
    compare = { floor = "music", key = "scenario.snr_db", start = 20, stop = 30, at_least = 0.8 }

* grows like a power of a key::

    compare = { exponent = "music", key = "scenario.array.elements", measure = "runtime_s", at_least = 1.75 }

* fails in at least, or at most, a share of the runs; or, as a fact about the runs made, ended with a status::

    compare = { fails = "music", at_least = 0.1 }
    compare = { fails = "nemo + de", at_most = 0.05, measure = "hits" }
    compare = { runs = "modified-music", status = "skipped", at_least = 1.0 }
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from nfbench.study import Claim, Compare

from .claim_parts import FLOOR, Part, methods_of, parts_of
from .outcomes import Point
from .sign_flips import holm

__all__ = ["EACH_WAY", "judge_claims", "quantity"]

EACH_WAY = 0.025  # one-sided, after Holm's correction over all claims
COLUMNS = ["text", "verdict", "p", "p_holm", "estimate", "low", "high", "scenes", "p_against", "p_against_holm"]
NOTHING = Part(1.0, 1.0, (math.nan, math.nan, math.nan), 0)


def judge_claims(claims: Sequence[Claim], points: Sequence[Point], *, unfinished: bool = False) -> pd.DataFrame:
    """Judge the claims of a study by its outcomes at all swept points.

    Returns one row per claim with the columns text, verdict, p and p_holm (one-sided, for the claim), p_against and
    p_against_holm (for its opposite), estimate, low and high (of the least favourable of its tests, with its 95 %
    interval: a ratio of typical values, a share, or an exponent), and scenes. Facts about runs have no p.

    unfinished: whether runs are missing, so that a claim about methods or values without a run is not decided.

    Raises ValueError otherwise for a claim whose methods, key, values or measure the outcomes do not have.
    """
    found, facts = [], []
    for claim in claims:
        try:
            fact = _fact(claim.compare, points) if claim.compare.kind == "runs" else None
            found.append(NOTHING if fact is not None else _combined(parts_of(claim.compare, points)))
            facts.append(fact)
        except ValueError as error:
            if not unfinished:
                raise ValueError(f"claim {claim.text!r}: {error}") from error
            found.append(NOTHING)
            facts.append(None)
    tested = [i for i, fact in enumerate(facts) if fact is None]
    adjusted = [np.full(len(claims), math.nan) for _ in range(2)]
    for each, name in zip(adjusted, ("p", "against"), strict=True):
        each[tested] = holm(np.array([getattr(found[i], name) for i in tested]))
    rows = []
    for i, (claim, part, fact) in enumerate(zip(claims, found, facts, strict=True)):
        rows.append(fact | {"text": claim.text} if fact else _row(claim.text, part, adjusted[0][i], adjusted[1][i]))
    return pd.DataFrame(rows, columns=COLUMNS)


def quantity(compare: Compare, target: str = "the first target") -> str:
    """What the estimate of a claim is of, and its limits, in words: "error: better ÷ worse, below 1".

    target: the first target of the study in words.
    """
    kind, least, most = compare.kind, compare.at_least, compare.at_most
    if kind == "floor" and least is None:
        least = FLOOR
    words = ("at least", "at most")
    if kind in ("better", "equal", "grows", "falls", "degrades"):
        words = ("above", "below")
        factor = compare.factor or 1.0
        least = {"grows": 1.0, "degrades": 1.0, "equal": 1 / factor}.get(kind)
        most = {"falls": 1.0, "better": factor, "equal": factor}.get(kind)
    if compare.measure == "hits" and kind == "better":
        return f"share of runs of the better method that reach {target}"
    share = f"share of runs with the status {compare.status}" if compare.status else "share of failed runs"
    what = {
        "better": "better ÷ worse",
        "equal": "first ÷ second",
        "degrades": "its growth ÷ that of the other",
        "exponent": f"exponent of its growth with {compare.key}",
        "fails": f"share of runs that miss {target}" if compare.measure == "hits" else share,
        "runs": share,
    }.get(kind, "next ÷ previous value" if compare.every_step else f"at the last ÷ first {compare.key}")
    if compare.start is not None and kind in ("changes", "floor"):
        what = f"at {compare.stop} ÷ at {compare.start}"
    name = "" if kind in ("fails", "runs") else f"{compare.measure}: "
    limits = [f"{word} {value:.4g}" for word, value in zip(words, (least, most), strict=True) if value is not None]
    return f"{name}{what}, {' and '.join(limits)}"


def _combined(parts: Sequence[Part]) -> Part:
    """Return the test that all parts hold: it is as strong as the weakest for the claim."""
    if not parts:
        return NOTHING
    weakest = max(parts, key=lambda part: part.p)
    against = min(1.0, len(parts) * min(part.against for part in parts))
    return Part(weakest.p, against, weakest.estimate, min(part.scenes for part in parts))


def _row(text: str, part: Part, p_holm: float, against_holm: float) -> dict[str, Any]:
    value, low, high = part.estimate
    return {
        "text": text,
        "verdict": _verdict(p_holm <= EACH_WAY, against_holm <= EACH_WAY, part.scenes),
        "p": part.p,
        "p_holm": p_holm,
        "p_against": part.against,
        "p_against_holm": against_holm,
        "estimate": value,
        "low": low,
        "high": high,
        "scenes": part.scenes,
    }


def _verdict(holds: bool, fails: bool, scenes: int) -> str:
    if holds:
        return "confirmed"
    return "contradicted" if fails else f"not decided by {scenes} scene{'' if scenes == 1 else 's'}"


def _fact(compare: Compare, points: Sequence[Point]) -> dict[str, Any]:
    """Return the row of a claim about the runs made, without its text: the share with a status, which is no estimate
    of anything else and has no interval."""
    status = compare.status or "ok"
    shares, scenes = [], 0
    for method in methods_of(compare.runs, points) if points else []:
        counted = made = 0
        for _, each in points:
            if method in each.methods:
                i = each.methods.index(method)
                counted += int(each.ended[status][:, i].sum()) if status in each.ended else 0
                made += int(each.runs[i]) * len(each.scenes)
                scenes = max(scenes, len(each.scenes))
        shares.append(counted / made if made else math.nan)
    low = -math.inf if compare.at_least is None else compare.at_least
    high = math.inf if compare.at_most is None else compare.at_most
    holds = bool(shares) and all(low <= share <= high for share in shares)
    fails = not holds and not any(math.isnan(share) for share in shares) and bool(shares)
    row: dict[str, Any] = dict.fromkeys(COLUMNS, math.nan)
    return row | {
        "verdict": _verdict(holds, fails, scenes),
        "estimate": next((s for s in shares if not low <= s <= high), shares[0] if shares else math.nan),
        "scenes": scenes,
    }
