"""The lines of the terminal report about proven optima: how many there are, why others are not, and which are wrong."""

from __future__ import annotations

import pandas as pd
from rich.console import Console
from rich.text import Text

from nfbench.core import Status, printable
from nfbench.results import label_of

__all__ = ["print_proofs"]

SHOWN = 20  # contradictions that are printed


def print_proofs(references: pd.DataFrame, left: int, console: Console) -> None:
    """Print what is known about the proven optima of a study; nothing if it has none.

    references: the columns of ``references.csv``. left: number of proofs that are not finished.
    """
    if not (total := len(references) + left):
        return
    wrong = references[references["contradicted_by"] != ""]
    certified = int(references["certified"].sum()) - len(wrong)
    console.print()
    text = f"Proven optima: {certified} of {total}."
    console.print(text if certified == total else f"{text} Other gaps are measured from the best value known.")
    if left:
        console.print(Text(f"{left} proofs are not finished.", "yellow"))
    open_ = references[(references["status"] == Status.OK) & ~references["certified"]]
    for (label, step), rows in open_.groupby(["formulation", "step"], sort=False):
        where = f" in step {step}" if step else ""
        console.print(Text(f"not certified × {len(rows)}: {printable(label)}: the proof ended{where}", "yellow"))
    bad = references[references["status"] != Status.OK]
    for (status, label), rows in bad.groupby(["status", "formulation"], sort=False):
        text = f" × {len(rows)}: optimum of {printable(label)}: {printable(rows['message'].iloc[0])}"
        console.print(Text(str(status), "red") + Text(text))
    _print_contradictions(wrong, console)


def _print_contradictions(wrong: pd.DataFrame, console: Console) -> None:
    for row in wrong.head(SHOWN).to_dict("records"):
        first, *others = row["contradicted_by"].split("; ")
        too = f", and {len(others)} other method{'s are' if len(others) > 1 else ' is'} below it too" if others else ""
        console.print(
            Text("wrong certificate", "bold red")
            + Text(
                printable(
                    f": {label_of(row)}: the certified optimum is {row['value']:.12g} with a gap of at most "
                    f"{row['gap']:.3g}, but {first} found {row['best_found']:.12g}{too}",
                    1000,
                )
            )
        )
    if len(wrong) > SHOWN:
        console.print(f"… and {len(wrong) - SHOWN} more wrong certificates")
    if len(wrong):
        console.print(
            "Their gaps are measured from the best value known. Report the error to the formulation's author."
        )
