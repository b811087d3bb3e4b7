"""What a ``[[claim]]`` of the manifest says: a sentence, and the comparison that tests it, a flat table of options."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from nfbench.core import OptionError, Options, build, suggest

__all__ = ["KINDS", "Claim", "Compare", "Names", "claim_of", "claim_problems"]

Names = str | tuple[str, ...]
Value = bool | int | float | str | tuple[Any, ...]

KINDS = ("better", "equal", "grows", "falls", "degrades", "changes", "floor", "exponent", "fails", "runs")
PARTNERS = {"better": "worse", "degrades": "more_than"}  # options that a kind needs beside its own
NEED_KEY = ("grows", "falls", "changes", "floor", "exponent")


@dataclass(frozen=True)
class Compare(Options):
    """The comparison that tests a claim. One of the options from ``better`` to ``runs`` gives its kind.

    better: method whose values are lower than those of ``worse``. worse: the other method, several, or "others".
    equal: two methods whose values are equal within ``factor``.
    grows: method whose values grow along ``key``; several, or "all". falls: the same for values that fall.
    degrades: method that loses more than ``more_than`` does, from ``start`` to ``stop`` of ``key``; without these along
    all its values. Or two methods: from the first to the second. more_than: one method, or two.
    changes: method whose value at ``stop`` of ``key`` is ``at_least`` or ``at_most`` a multiple of that at ``start``.
    floor: method whose value at ``stop`` is still ``at_least`` a multiple of that at ``start``, 0.8 by default.
    exponent: method whose values grow like ``key`` to a power from ``at_least`` to ``at_most``.
    fails: method whose share of failed runs is ``at_least`` or ``at_most`` a number between 0 and 1; with ``status``
    the share of runs with this status; with the measure "hits" the share of runs that miss the first target.
    runs: method of which a share of ``at_least`` or ``at_most`` of the runs made ended with ``status``. This is a fact
    about the runs and not tested.
    measure: what is compared: "error"; "evaluations" or "seconds" to the first target; "hits" of it, for ``better``;
    or a column of the runs.
    key: swept key, such as "scenario.snr_db". values: the values of ``key`` that count, all if empty.
    over: whether the claim must hold everywhere, at every swept point, or overall, with the points added up.
    start: first value of ``key``. stop: last value of ``key``.
    factor: what the ratio of the values is compared with, for ``better``; the tolerated factor for ``equal``.
    at_least: lower limit. at_most: upper limit.
    every_step: whether the values must grow or fall at every step. status: how runs ended, such as "skipped".
    """

    better: Names = ()
    worse: Names = ()
    equal: tuple[str, ...] = ()
    grows: Names = ()
    falls: Names = ()
    degrades: Names = ()
    more_than: Names = ()
    changes: Names = ()
    floor: Names = ()
    exponent: Names = ()
    fails: Names = ()
    runs: Names = ()
    measure: str = "error"
    key: str = ""
    values: tuple[Value, ...] = ()
    over: Literal["everywhere", "overall"] = "everywhere"
    start: Value | None = None
    stop: Value | None = None
    factor: float | None = None
    at_least: float | None = None
    at_most: float | None = None
    every_step: bool = False
    status: str = ""

    @property
    def kind(self) -> str:
        """The kind of the claim, one of ``KINDS``."""
        return next(kind for kind in KINDS if getattr(self, kind))

    def validate(self) -> None:
        """Raise OptionError unless exactly one kind is given, with the options it needs."""
        kinds = [kind for kind in KINDS if getattr(self, kind)]
        if len(kinds) != 1:
            raise _problem("", f"expected one of {', '.join(KINDS)}, got {', '.join(kinds) or 'none'}")
        (kind,) = kinds
        needed = [PARTNERS[kind]] if kind in PARTNERS else []
        needed += ["key"] if kind in NEED_KEY else []
        needed += ["start", "stop"] if kind in ("changes", "floor") else []
        missing = [name for name in needed if getattr(self, name) in ("", (), None)]
        if missing:
            raise _problem(missing[0], f"expected a value, as {kind} compares with it, got none")
        self._check_numbers(kind)
        if kind == "equal" and len(self.equal) != 2:
            raise _problem("equal", f"expected two methods, got {len(self.equal)}")
        if kind == "degrades":
            pairs = [1 if isinstance(names, str) else len(names) for names in (self.degrades, self.more_than)]
            if pairs not in ([1, 1], [2, 2]):
                text = f"expected one method each or two each, got {pairs[0]} and {pairs[1]}"
                raise _problem("degrades, more_than", text)
            if pairs == [1, 1] and not self.key:
                raise _problem("key", "expected the swept key along which the methods degrade, got none")

    def _check_numbers(self, kind: str) -> None:
        if self.values and not self.key:
            raise _problem("key", "expected the swept key that has these values, got none")
        if (self.start is None) != (self.stop is None):
            raise _problem("start, stop", "expected both or none")
        limits = [limit for limit in (self.at_least, self.at_most) if limit is not None]
        if kind in ("changes", "exponent", "fails", "runs") and not limits:
            raise _problem("at_least, at_most", f"expected a limit for {kind}, got none")
        if kind in ("fails", "runs") and not all(0 <= limit <= 1 for limit in limits):
            raise _problem("at_least, at_most", f"expected shares from 0 to 1, got {limits[0]}")
        if kind == "equal" and not (self.factor or 0) > 1:
            raise _problem("factor", f"expected a number above 1 for equal, got {self.factor}")
        if self.factor is not None and not self.factor > 0:
            raise _problem("factor", f"expected a positive number, got {self.factor}")
        if kind in ("changes", "floor") and not all(limit > 0 for limit in limits):
            raise _problem("at_least, at_most", f"expected positive ratios, got {limits[0]}")
        if self.measure == "hits" and kind not in ("better", "fails"):
            raise _problem("measure", f"expected hits only for better and fails, got it for {kind}")


def _problem(name: str, text: str) -> OptionError:
    return OptionError("Compare", [(name, text)])


@dataclass(frozen=True)
class Claim:
    """A claim: its text, and the comparison that tests it."""

    text: str
    compare: Compare


@dataclass(frozen=True)
class _ClaimTable(Options):
    """``[[claim]]``: a statement that the results confirm or contradict.

    text: the statement in words.
    compare: the comparison that tests it.
    """

    text: str
    compare: dict[str, Any]


def claim_of(table: Mapping[str, Any]) -> Claim:
    """Return the claim of a ``[[claim]]`` table. Raises OptionError with every problem of the table."""
    found = build(_ClaimTable, table)
    key = found.compare.get("key")
    if isinstance(key, str) and key and not key.startswith(("scenario.", "budget.")):  # as keys of [sweep] may be
        found = _ClaimTable(found.text, {**found.compare, "key": f"scenario.{key}"})
    try:
        return Claim(found.text, build(Compare, found.compare))
    except OptionError as error:
        problems = [(f"compare.{path}" if path else "compare", text) for path, text in error.problems]
        raise OptionError("Claim", problems) from error


def claim_problems(claim: Claim, methods: Sequence[str], swept: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Yield the methods and the key of a claim that its study does not have, as (path, message) pairs.

    methods: labels of the study's methods. swept: its swept columns.
    """
    compare = claim.compare
    for option in ("better", "worse", "equal", "grows", "falls", "degrades", "more_than", *KINDS[5:]):
        names = getattr(compare, option)
        for name in (names,) if isinstance(names, str) else names:
            if name not in methods and name not in ("all", "others"):
                text = f"expected the label of a method, got {name!r:.80}{suggest(name, methods)}"
                yield f"compare.{option}", f"{text}; known: {', '.join(methods[:20])}"
    if compare.key and compare.key not in swept:
        yield "compare.key", f"expected a swept key ({', '.join(swept) or 'none is swept'}), got {compare.key!r:.80}"
