"""Shows an array: ``nfbench show array``, for a file with positions, a kind with options, or a manifest."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.table import Table
from rich.text import Text

from nfbench.core import NfbenchError, OptionError, PluginError, Scenario, Survey, canonical, printable
from nfbench.plugins import Registry
from nfbench.study import load_scenarios

from .common import output, parsed_option, say, warn

__all__ = ["ArrayOptions", "show_array"]

SCENARIO = "near-field"  # that describes arrays given by a file or kind
_NAMES = {"frequency_hz": "--frequency-hz", "speed_m_s": "--speed", "wavelength_m": "--wavelength-m"}


@dataclass(frozen=True)
class ArrayOptions:
    """The options of the command; None where they are not given.

    frequency_hz, speed_m_s, wavelength_m: as in a scenario.
    unit, variable, broadside, up: of a file with positions, as in a table of kind "custom".
    options: NAME=VALUE of further options of the array.
    out: file for the drawing.
    """

    frequency_hz: float | None = None
    speed_m_s: float | None = None
    wavelength_m: float | None = None
    unit: str | None = None
    variable: str | None = None
    broadside: str | None = None
    up: str | None = None
    options: Sequence[str] | None = None
    out: Path | None = None

    @property
    def carrier(self) -> dict[str, Any]:
        """The given options that determine the wavelength."""
        return {name: getattr(self, name) for name in _NAMES if getattr(self, name) is not None}

    @property
    def array(self) -> dict[str, Any]:
        """The given options of the array."""
        axes = {"broadside": _axis(self.broadside), "up": _axis(self.up)}
        given = {"unit": self.unit, "variable": self.variable, **axes}
        named = {name: value for name, value in given.items() if value is not None}
        return {**named, **dict(parsed_option(text) for text in self.options or ())}

    @property
    def is_empty(self) -> bool:
        """Whether none is given."""
        return not self.carrier and not self.array and self.out is None


def show_array(name: str, given: ArrayOptions, plugins: Sequence[Path] = ()) -> None:
    """Print what is worth knowing about an array, and draw it if a file is given for that."""
    surveys = list(_surveys(name, given, plugins))
    if given.out and len(surveys) > 1:
        say(f"The drawing shows the first of {len(surveys)} arrays.")
    for title, survey in surveys:
        _print(title, survey)
    if given.out:
        from nfbench.figures import write_array_figure

        write_array_figure(surveys[0][1], given.out)
        say(f"Drawn in {given.out}")


def _surveys(name: str, given: ArrayOptions, plugins: Sequence[Path]) -> Iterator[tuple[str, Survey]]:
    """Yield the title and survey of each array: one of a file or kind, or those of the points of a manifest."""
    registry = Registry(plugins)
    if name.endswith(".toml"):
        if given.carrier or given.array:
            raise NfbenchError(f"{name}: its own options describe the array; give no others than --out")
        yield from _of_manifest(Path(name), plugins)
        return
    is_file = Path(name).is_file() or "/" in name or Path(name).suffix != ""
    table = {"kind": "custom", "file": name} if is_file else {"kind": name}
    try:
        scenario = registry.find("scenario", SCENARIO).resolve()
        assert issubclass(scenario, Scenario)
        survey = scenario.survey({"array": {"origin": "center", **table, **given.array}, **given.carrier})
    except OptionError as error:
        raise _with_flags(error) from error
    assert survey is not None
    yield Path(name).name if is_file else name, survey


def _of_manifest(path: Path, plugins: Sequence[Path]) -> Iterator[tuple[str, Survey]]:
    seen = set()
    for swept, scenario in load_scenarios(path, plugins):
        table: dict[str, Any] = canonical(scenario)
        wanted = {name: table[name] for name in ("array", *_NAMES) if table.get(name) is not None}
        key = json.dumps(wanted, sort_keys=True)
        survey = scenario.survey(wanted)
        if survey is None:
            raise PluginError(f"{path}: this scenario describes no array")
        if key in seen:
            continue
        seen.add(key)
        about = {name: value for name, value in swept.items() if name.split(".")[0] in wanted}
        yield ", ".join([path.name, *(f"{name} = {_shown(value)}" for name, value in about.items())]), survey


def _shown(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)


def _with_flags(error: OptionError) -> OptionError:
    """Return the errors under the names of the command's options."""
    problems: list[tuple[str, str]] = []
    for place, text in error.problems:
        path = place.removeprefix("array.")
        for name, flag in _NAMES.items():
            path, text = (flag if path == name else path), text.replace(name, flag)
        problems.append((path, text))
    return OptionError("array", problems)


def _axis(text: str | None) -> Any:
    """Return an axis by name, or a vector such as [0, 0, 1]."""
    if text is None or not text.startswith("["):
        return text
    try:
        return [float(part) for part in tomllib.loads(f"axis = {text}")["axis"]]
    except (tomllib.TOMLDecodeError, TypeError, ValueError):
        return text


def _print(title: str, survey: Survey) -> None:
    console = output()
    table = Table(box=None, show_header=False, title=Text(printable(title), "bold"), title_justify="left")
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for name, text in survey.facts:
        table.add_row(Text(printable(name)), Text(printable(text)))
    console.print(table)
    for text in survey.warnings:
        warn(text)
