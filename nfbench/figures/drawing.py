"""What the user may choose about figures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeAlias, final, get_args

from nfbench.analysis import Axis
from nfbench.core import NfbenchError

__all__ = ["KINDS", "Drawing", "Kind", "NotDrawnError", "Wanted"]

Kind: TypeAlias = Literal[
    "error",
    "runtime",
    "distribution",
    "ert",
    "ranks",
    "tradeoff",
    "attainment",
    "convergence",
    "positions",
    "geometry",
    "scene",
    "landscape",
]
KINDS: tuple[Kind, ...] = get_args(Kind)
Wanted: TypeAlias = Literal["rmse", "median", "azimuth", "elevation", "range"]


class NotDrawnError(NfbenchError):
    """A kind of figure has nothing to show for a study; the message is the reason."""


@final
@dataclass(frozen=True)
class Drawing:
    """How figures are drawn.

    width: "single" for the width of an IEEE column (3.5 in), "double" for that of a page (7.16 in).
    metric: the error measure to show, or a parameter, whose RMSE and median are shown; None: RMSE, median, and the
        outlier rate if there are outliers.
    title: whether to print the study's title above each figure.
    positions: whether to draw true and estimated positions; None: only if the study is small.
    traces: whether to draw convergence.
    manifest: manifest from which the scenario is read to draw positions; None: the copy in the study's folder.
    plugins: plugin files that the scenario needs; those that the manifest names are not imported.
    only: kinds of figures to draw; empty: those that suit the study.
    target: the target of ``ert`` and ``distribution``, by its label or its number from 1; None: the first target for
        ``ert``, and all targets for ``distribution``.
    axis: cost in ``distribution``, ``ert``, ``attainment`` and ``tradeoff``; None: evaluations, except
        for ``tradeoff`` of methods that do not all make evaluations, where it is seconds.
    methods: labels of methods to show in colour in addition to the best ones, with all others in grey. If empty, all
        are in colour, or the best ones if there are more than eight.
    """

    width: Literal["single", "double"] = "single"
    metric: Wanted | None = None
    title: bool = True
    positions: bool | None = None
    traces: bool = False
    manifest: Path | None = None
    plugins: tuple[Path, ...] = ()
    only: tuple[Kind, ...] = ()
    target: int | str | None = None
    axis: Axis | None = None
    methods: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for kind in self.only:
            if kind not in KINDS:
                raise NfbenchError(f"only: expected some of {', '.join(KINDS)}, got {kind!r}")
