"""The page: collects what it shows, renders the template, and writes the file."""

from __future__ import annotations

import json
import math
from collections import Counter
from importlib.resources import files
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
import pandas as pd
from markupsafe import Markup

from nfbench.analysis import headline, quantity, sentences
from nfbench.core import NfbenchError, Status, printable
from nfbench.results import Results, write_whole

from ..terminal import number_text
from . import comparison, provenance, scenes
from .choices import choices
from .parts import parts
from .redrawn import Redrawn
from .study import Study, numbers

__all__ = ["html_report", "write_html"]

SCRIPTS = ("uPlot.iife.min.js", "base.js", "charts.js", "compare.js", "scenes.js", "tables.js")
STYLES = ("uPlot.min.css", "report.css")
MESSAGES = 200  # kinds of failures that are listed
NAMED = 12  # scenes that a sentence lists
VALUES = 8  # values of a swept key that it lists


def write_html(results: Results, out: Path | None = None) -> Path:
    """Write the report of a study as one HTML file without any reference to other files or hosts; return its path.

    results: the folder. out: the file; None for ``report.html`` in the folder.

    Raises StoreError if the folder holds no results or the file cannot be written, and NfbenchError if no run has
    finished yet.
    """
    path = results.folder / "report.html" if out is None else Path(out)
    text = html_report(results)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, lambda draft: draft.write_text(text, encoding="utf-8"))
    return path


def html_report(results: Results) -> str:
    """Return the report of a study as HTML; see ``write_html``."""
    evidence = results.evidence()
    if evidence.runs.empty:
        raise NfbenchError(f"{results.folder}: nothing to report: no run has finished yet")
    study = Study(results, evidence)
    with np.errstate(all="ignore"):  # numbers may be infinite
        context = _context(study, Redrawn(study))
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("nfbench.report.html"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "first_sentence": lambda text: text.partition(". ")[0].rstrip(".") + ".",
        "number": _number,
        "percent": _percent,
        "printable": printable,
        "range": _range,
        "share": _share,
    }
    return environment.get_template("report.html.j2").render(context)


def _context(study: Study, redrawn: Redrawn) -> dict[str, Any]:
    data, notes = _data(study, redrawn)
    tables = comparison.rank_rows(study)
    data["tables"] = tables
    meta, runs = study.meta, study.runs
    used = parts(study.results.folder)
    left = study.results.counts.get("open", 0)
    return {
        "title": printable(meta["title"] or meta["name"]),
        "name": printable(meta["name"]),
        "expect": printable(meta["expect"]),
        "facts": _facts(study),
        "left": left,
        "done": len(runs),
        "answer": _answer(study),
        "verdicts": _verdicts(study),
        "table": tables[0] if tables else None,
        "methods": [printable(name) for name in study.methods],
        "points": study.points,
        "choices": choices(study),
        "error": "the root mean square distance between the true and the estimated positions [m]"
        if study.error == "rmse_m"
        else f"the column {printable(study.error)} of runs.csv",
        "heads": comparison.headings(study),
        "parts": used,
        "claims": _claims(study),
        "failures": _failures(runs),
        "proofs": _proofs(study),
        "contradicted": _contradicted(study),
        "scenario": provenance.scenario_rows(study.results.folder, study.labels),
        "array": _array_facts(redrawn),
        "reason": redrawn.reason,
        "origin": provenance.origin(study.results.folder, meta["name"], runs["cpu_s"]),
        "extras": ",".join(dict.fromkeys(row["extra"] for row in used if row["extra"])),
        "notes": [printable(note) for note in [*study.evidence.hits.notes, *notes]],
        "data": _script_json(data),
        "scripts": [_static(name) for name in SCRIPTS],
        "styles": [_static(name) for name in STYLES],
    }


def _data(study: Study, redrawn: Redrawn) -> tuple[dict[str, Any], list[str]]:
    """What the scripts read, and sentences about what is left out."""
    notes = []
    chosen = scenes.chosen_scenes(study)
    found = comparison.progress(study)
    best = comparison.budgets(study)
    if len(best) < len(study.methods):
        notes.append(f"Error against budget is shown for {len(best)} of {len(study.methods)} methods, the best ones.")
    if len(study.shown) < len(study.methods):
        notes.append(
            f"Positions and traces of single scenes are shown for {len(study.shown)} of {len(study.methods)} methods."
        )
    if not study.gaps_compare and any(target.startswith("gap") for target in study.targets):
        notes.append("No method is recommended for a gap, since the gaps of different formulations cannot be compared.")
    total = sum(len(each.scenes) for each in study.outcomes if each is not None)
    if (kept := sum(map(len, chosen.values()))) < total:
        notes.append(f"Positions and traces are shown for {kept} of {total} scenes, the hardest of each point.")
    by = study.runs.drop_duplicates("method").set_index("method")["formulation"].to_dict()
    formulations = list(dict.fromkeys(by[study.methods[i]] for i in study.shown))
    hardest = [(point, each[i]) for i in range(3) for point, each in chosen.items() if i < len(each)]
    try:
        landscapes = redrawn.landscapes(list(dict.fromkeys([_first(chosen), *hardest])) if chosen else [], formulations)
    except NfbenchError as reason:
        landscapes = []
        notes.append(f"Landscapes are missing: {reason}")
    survey = redrawn.array
    data = {
        "methods": [printable(name) for name in study.methods],
        "formulations": [printable(by[name]) for name in study.methods],
        "shown": study.shown,
        "points": study.points,
        "axes": study.axes,
        "targets": [study.goal(target) for target in study.targets],
        "error": study.error_name,
        "measures": comparison.measures(study),
        "bound": comparison.bound_of(study),
        "distributions": comparison.distributions(study),
        "progress": {name: comparison.after_budget(study, each) for name, each in found.items()},
        "scenes": scenes.outcome_tables(study),
        "places": scenes.places(study, redrawn, chosen),
        "traces": {name: scenes.traces(study, each, chosen) for name, each in found.items()},
        "landscapes": landscapes,
        "elements": None if survey is None else [numbers(element) for element in survey.elements[:2000]],
    }
    return data, notes


def _first(chosen: dict[int, list[Any]]) -> tuple[int, Any]:
    """The first point and its scene with the smallest number: the draw that the page shows first."""
    point = next(iter(chosen))
    return point, min(chosen[point], default=0)


def _facts(study: Study) -> list[str]:
    runs = study.runs
    points = [(len(study.points), "swept point")] * bool(study.swept)
    count = [(runs["method"].nunique(), "method"), *points, (runs["scene"].nunique(), "scene")]
    return [f"{n:,} {what}{'' if n == 1 else 's'}" for n, what in [*count, (len(runs), "run")]]


def _answer(study: Study) -> dict[str, Any]:
    """The verdict in two sentences, and where the recommended method fails."""
    block = study.block
    if block is None:
        return {"which": study.evidence.unranked, "sure": "", "fails": "", "best": ""}
    which, sure = headline(study.with_units(block), study.evidence.ranking.frame.tail(len(block.methods)))
    best = block.order[0] if block.order else None
    fails = "" if best is None else _fails(study, block.methods[best])
    return {"which": printable(which), "sure": printable(sure), "fails": printable(fails), "best": best is not None}


def _fails(study: Study, method: str) -> str:
    """Where a method does not reach the target: by swept value, and in which scenes most often."""
    missed: list[tuple[int, Any]] = []
    totals: Counter[int] = Counter()
    target = ""
    for point, each in enumerate(study.outcomes):
        if each is None or method not in each.methods:
            continue
        i = each.methods.index(method)
        totals[point], target = len(each.scenes), each.target or target
        missed += [(point, scene) for scene in np.array(each.scenes)[each.hits[:, i] < each.runs[i]]]
    goal = study.goal(target) or "an estimate"
    single, total = len(study.points) == 1, totals.total()
    scenes_ = f"{total // len(study.points)} scenes"
    if not missed:
        where = scenes_ if single else f"{scenes_} at each of {len(study.points)} swept points"
        return f"Nowhere in this study: {method} reaches {goal} in all {where}."
    often = Counter(scene for _, scene in missed).most_common()
    listed = ", ".join(f"{scene}" if single else f"{scene} ({count})" for scene, count in often[:NAMED])
    more = f" and {len(often) - NAMED} more" if len(often) > NAMED else ""
    if single:
        return f"{method} misses {goal} in {len(missed)} of {total} scenes: {listed}{more}."
    cases = f"{len(missed):,} of {total:,} cases ({scenes_} at each of {len(study.points)} swept points)"
    return f"{method} misses {goal} in {cases}. {_by_value(study, missed, totals)} Scenes (points): {listed}{more}."


def _by_value(study: Study, missed: list[tuple[int, Any]], totals: Counter[int]) -> str:
    """How many cases are missed at each value of each swept key; of many values those with the most misses."""
    found = []
    for axis in study.axes:
        misses = Counter(axis["texts"][point] for point, _ in missed)
        of = Counter[str]()
        for point, count in totals.items():
            of[axis["texts"][point]] += count
        worst = set(sorted(of, key=lambda text: -misses[text] / of[text])[:VALUES])
        parts = [f"{misses[text]:,} of {of[text]:,} at {text}" for text in of if text in worst]
        found.append(f"{axis['name']}: {', '.join(parts)}{', …' if len(of) > VALUES else ''}.")
    return " ".join(found)


def _verdicts(study: Study) -> list[tuple[str, str]]:
    """The full verdict on each block of the ranking, that over all points first."""
    ranking = study.evidence.ranking
    found = []
    for block, text in zip(ranking.blocks, sentences(ranking), strict=True):
        place = study.place(block.swept) if len(block.points) == 1 else -1
        found.append((place, "All points together" if place < 0 else study.points[place], printable(text)))
    return [(label, text) for _, label, text in sorted(found, key=lambda each: each[0])]


def _claims(study: Study) -> list[dict[Any, Any]]:
    """The rows of ``claims.csv``, and what each estimate is of."""
    rows = study.evidence.claims().to_dict("records")
    target = study.goal(study.targets[0]) if study.targets else "the first target"
    what = [quantity(each.compare, target) for each in study.evidence.stated]
    return [row | {"quantity": text, "shares": text.startswith("share")} for row, text in zip(rows, what, strict=True)]


def _failures(runs: pd.DataFrame) -> list[dict[str, Any]]:
    """Each status other than ok with its methods and messages, the most frequent first."""
    bad = runs[runs["status"] != Status.OK]
    found: list[dict[str, Any]] = []
    for (status, method, message), group in bad.groupby(["status", "method", "message"], sort=False):
        scenes_ = ", ".join(map(str, sorted(group["scene"].unique())[:NAMED]))
        texts = {"status": status, "method": method, "message": message, "scenes": scenes_}
        found.append({**{key: printable(text) for key, text in texts.items()}, "runs": len(group)})
    return sorted(found, key=lambda each: -each["runs"])[:MESSAGES]


def _proofs(study: Study) -> str:
    references = study.evidence.references
    if not len(references):
        return ""
    proven = int(references["certified"].sum()) - len(study.evidence.contradictions)
    return f"In this study, {proven} of {len(references)} optima are proven."


def _contradicted(study: Study) -> list[str]:
    return [
        f"A certificate is wrong: {printable(row['contradicted_by'])} found a value below the certified optimum of "
        f"scene {row['scene']}."
        for row in study.evidence.contradictions.head(NAMED).to_dict("records")
    ]


def _array_facts(redrawn: Redrawn) -> list[tuple[str, str]]:
    survey = redrawn.array
    if survey is None:
        return []
    facts = [("array", survey.title.removeprefix("array ")), *survey.facts]
    return [(printable(name), printable(text)) for name, text in facts]


def _number(value: Any) -> str:
    if value is None or value == "":
        return "–"
    size = abs(float(value))
    return f"{float(f'{value:.3g}'):,.0f}" if 1e4 <= size < 1e7 else number_text(float(value)).replace("inf", "∞")


def _range(low: Any, high: Any) -> str:
    first, last = _number(low), _number(high)
    return f"≈ {first}" if first == last != "0" else f"{first} – {last}"


def _percent(value: Any) -> str:
    return "–" if value is None else f"{100 * float(value):.0f} %"


def _share(value: Any) -> str:
    """A share in per cent with one decimal place."""
    return "–" if value is None or value == "" or math.isnan(value) else f"{float(f'{100 * value:.1f}'):g} %"


def _static(name: str) -> Markup:
    """A file of the package, which is trusted."""
    return Markup((files("nfbench.report.html") / "static" / name).read_text(encoding="utf-8"))


def _script_json(data: Any) -> Markup:
    """JSON that is safe inside a script element, whatever text it contains."""
    text = json.dumps(data, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    for character in "<>&":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return Markup(text)
