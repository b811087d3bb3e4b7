"""Shows and stores what was localized: a table on the terminal, JSON and CSV."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Mapping
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from nfbench.core import Localization

from .terminal import shown

__all__ = ["localization_csv", "localization_json", "print_localization"]

UNITS = {"_m": "m", "_deg": "°", "_db": "dB", "_hz": "Hz"}  # suffixes of names
STD = "std_"  # prefix of the names of standard errors
DIGITS = 6  # significant, where no standard error says how many there are


def print_localization(found: Localization, console: Console) -> None:
    """Print the sources with their standard errors, how well they fit, and the warnings."""
    if found.sources:
        console.print(_table(found))
        console.print(shown("± standard error at the estimate, if the model is right; – is not known.", "dim"))
    else:
        console.print("No source was found.")
    for note in found.notes:
        console.print(shown(note))
    if found.fit:
        facts = [_fact(name, value) for name, value in found.fit.items() if not math.isnan(value)]
        for line in _lines("Fit: ", facts, console.width):
            console.print(shown(line))
    if found.method:
        console.print(shown(f"Method: {_method_text(found.method)}"))
    for warning in found.warnings:
        end = "" if warning.endswith((".", "?")) else "."
        console.print(shown(f"Warning: {warning}{end}", "yellow"))


def localization_json(found: Localization) -> str:
    """Return the sources, the fit and the warnings as JSON; numbers that are not known are null."""
    table = {
        "sources": [_plain(source) for source in found.sources],
        "fit": {name: _counted(value) for name, value in _plain(found.fit).items()},
        "method": dict(found.method),
        "warnings": list(found.warnings),
    }
    return json.dumps(table, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def localization_csv(found: Localization) -> str:
    """Return one row per source as CSV; numbers that are not known are empty."""
    names = list(dict.fromkeys(name for source in found.sources for name in source))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["source", *names])
    for k, source in enumerate(found.sources, start=1):
        values = _plain(source)
        writer.writerow([k, *("" if values.get(name) is None else repr(values[name]) for name in names)])
    return text.getvalue()


def _fact(name: str, value: float) -> str:
    """A number of the fit with its name; a probability that is too small for a float is not 0."""
    return f"{_heading(name)} < 1e-300" if name == "p_value" and value == 0 else f"{_heading(name)} {value:.4g}"


def _lines(start: str, parts: list[str], width: int) -> list[str]:
    """The parts of a list in lines that break only between them."""
    lines = [start]
    for k, part in enumerate(parts):
        text = part + ("," if k + 1 < len(parts) else "")
        if len(f"{lines[-1]}{text}") > width and lines[-1] != start:
            lines[-1] = lines[-1].rstrip()
            lines.append("")
        lines[-1] += f"{text} "
    return [line.rstrip() for line in lines]


def _method_text(method: Mapping[str, Any]) -> str:
    """The method in one line, such as "neef (objective = dml) + de (population = 40), 8,000 evaluations, seed 0"."""
    parts = [method["formulation"] + _options_text(method["options"])]
    if "solver" in method:
        parts[0] += f" + {method['solver']}{_options_text(method['solver_options'])}"
        units = {"evaluations": " evaluations", "seconds": " s", "start": " common starting points"}
        parts += [f"{value:,}{units[name]}" for name, value in method["budget"].items()]
    parts.append(f"seed {method['seed']}")
    if "study" in method:
        points = ", ".join(f"{name.removeprefix('scenario.')} = {value}" for name, value in method["swept"].items())
        parts.append(f"recommended by {method['study']}" + (f" at {points}" if points else ""))
    return ", ".join(parts)


def _options_text(options: Mapping[str, Any]) -> str:
    listed = ", ".join(f"{name} = {value}" for name, value in options.items())
    return f" ({listed})" if listed else ""


def _plain(numbers: Mapping[str, float]) -> dict[str, float | None]:
    """Numbers that JSON can hold: None in place of NaN and inf."""
    return {name: float(value) if math.isfinite(value) else None for name, value in numbers.items()}


def _counted(value: float | None) -> float | int | None:
    """A whole number as an integer."""
    return int(value) if value is not None and value.is_integer() and abs(value) < 2**53 else value


def _table(found: Localization) -> Table:
    """One row per source; a standard error stands below its number."""
    names = [name for name in found.sources[0] if not name.startswith(STD)]
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("source", justify="right")
    for name in names:
        table.add_column(shown(_heading(name)), justify="right")
    for k, source in enumerate(found.sources, start=1):
        cells = [_cell(source[name], source.get(f"{STD}{name}")) for name in names]
        table.add_row(str(k), *map(shown, (first for first, _ in cells)))
        if any(second for _, second in cells):
            table.add_row("", *map(shown, (second for _, second in cells)), end_section=k < len(found.sources))
    return table


def _cell(value: float, std: float | None) -> tuple[str, str]:
    """A number with the digits that its standard error justifies, and that standard error."""
    if math.isnan(value):
        return "–", ""
    if std is None:
        return f"{value:.1f}", ""
    if not math.isfinite(std) or std <= 0:
        return f"{value:.{DIGITS}g}", "± –"
    decimals = min(max(1 - math.floor(math.log10(std)), 0), 9)
    return f"{value:.{decimals}f}", f"± {std:.{decimals}f}"


def _heading(name: str) -> str:
    """``x_m`` becomes "x [m]"."""
    for suffix, unit in UNITS.items():
        if name.endswith(suffix):
            words = name.removesuffix(suffix).replace("_", " ")
            return f"{words.upper() if words == 'snr' else words} [{unit}]"
    return name.replace("_", " ")
