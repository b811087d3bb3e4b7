"""How a study was made: its manifest, the versions and hardware, and the command that repeats it."""

from __future__ import annotations

import json
import shlex
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from nfbench.analysis import time_text
from nfbench.core import printable

__all__ = ["origin", "scenario_rows"]

LONGEST = 200_000  # characters of a manifest that is shown
FACTS = {
    "python": "Python",
    "platform": "platform",
    "cpu": "processor",
    "cores": "cores",
    "jobs": "worker processes",
    "started": "last session started",
    "ended": "last session ended",
}


def origin(folder: Path, name: str, cpu_s: pd.Series) -> dict[str, Any]:
    """The manifest as text, the environment as rows, and the command that repeats the study.

    cpu_s: processor time of each run [s].
    """
    environment = _environment(folder)
    git = environment.get("git") if isinstance(environment.get("git"), dict) else {}
    commit = str((git or {}).get("commit") or "")
    warning = (
        "The code had local changes, which are not in the commit: results may differ."
        if (git or {}).get("dirty")
        else ""
    )
    rows = [(text, environment[key]) for key, text in FACTS.items() if environment.get(key) is not None]
    earlier = environment.get("earlier")
    if isinstance(earlier, list) and earlier:
        rows.append(("earlier sessions", len(earlier)))
    rows.append(("processor time of all runs", time_text(float(cpu_s.sum()))))
    if commit:
        rows.append(("commit", commit))
    versions = environment.get("versions")
    versions = versions if isinstance(versions, dict) else {}
    return {
        "manifest": _shown(_text(folder / "manifest.toml")),
        "rows": [(key, printable(value)) for key, value in rows],
        "pins": [printable(f"{k}=={v}") for k, v in versions.items() if k != "nfbench"]
        if isinstance(versions, dict)
        else [],
        "command": f"nfbench run manifest.toml --out {shlex.quote('results/' + printable(name))}",
        "commit": printable(commit[:10]),
        "warning": warning if commit else "",
    }


def scenario_rows(folder: Path, labels: Mapping[str, str]) -> list[tuple[str, str]]:
    """The options of the scenario and what is swept, as the manifest has them, with its labels of swept keys."""
    try:
        table = tomllib.loads(_text(folder / "manifest.toml"))
    except tomllib.TOMLDecodeError:
        return []
    scenario, sweep = table.get("scenario"), table.get("sweep")
    rows = [(key, _value(value)) for key, value in scenario.items()] if isinstance(scenario, dict) else []
    if isinstance(sweep, dict):
        named = {key: labels.get(key.removeprefix("scenario."), "") for key in sweep}
        rows += [
            (f"swept: {key}", _value(value) + f" ({named[key]})" * bool(named[key])) for key, value in sweep.items()
        ]
    return [(printable(key), printable(value, 400)) for key, value in rows]


def _value(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key} = {_value(each)}" for key, each in value.items())
    if isinstance(value, list):
        return ", ".join(map(_value, value))
    return str(value)


def _environment(folder: Path) -> dict[str, Any]:
    try:
        found = json.loads(_text(folder / "environment.json"))
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}


def _text(path: Path) -> str:
    """The content of a file; empty if it cannot be read."""
    try:
        return path.read_text(encoding="utf-8", errors="replace") if path.is_file() else ""
    except OSError:
        return ""


def _shown(text: str) -> str:
    """Text of several lines without control characters."""
    return "\n".join(printable(line) for line in text[:LONGEST].splitlines())
