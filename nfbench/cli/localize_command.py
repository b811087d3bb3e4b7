"""The command ``localize``: where the sources in a recording are."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer
from typer.core import TyperCommand

from nfbench.core import Localization, NfbenchError, Picture

from . import localize_options as opt
from .common import Plugins, app, output, parsed_option, say
from .localize_flags import in_flags, naming_flags, naming_method_flags

if TYPE_CHECKING:
    from nfbench.execution import Procedure

STDOUT = "-"
LARGEST_TOML = 2**20  # bytes of a file with options
RENAMED = {"speed": "speed_m_s"}  # options whose names in the scenario are others
OF_SCENARIO = (
    *("frequency_hz", "speed", "wavelength_m", "snapshots", "sample_rate_hz", "block", "window", "overlap"),
    *("variable", "element_axis", "azimuth_deg", "elevation_deg", "range_m", "wavefront"),
)


class _Command(TyperCommand):
    """A command whose option ``--json`` may come without a file."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        completed: list[str] = []
        for i, argument in enumerate(args):
            completed.append(argument)
            following = args[i + 1] if i + 1 < len(args) else None
            if argument == "--json" and (following is None or (following.startswith("-") and following != STDOUT)):
                completed.append(STDOUT)
        return super().parse_args(ctx, completed)


@app.command(cls=_Command)
def localize(
    data: opt.DataFile,
    positions: opt.PositionsFile = None,
    array: opt.ArrayTable = None,
    unit: opt.Unit = None,
    broadside: opt.Broadside = None,
    up: opt.Up = None,
    origin: opt.From = None,
    failed: opt.Failed = None,
    frequency_hz: opt.Frequency = None,
    speed: opt.Speed = None,
    wavelength_m: opt.Wavelength = None,
    covariance: opt.Covariance = False,
    snapshots: opt.Snapshots = None,
    sample_rate_hz: opt.SampleRate = None,
    block: opt.Block = None,
    window: opt.Window = None,
    overlap: opt.Overlap = None,
    variable: opt.Variable = None,
    element_axis: opt.ElementAxis = None,
    conjugate: opt.Conjugate = False,
    scenario: opt.ScenarioFile = None,
    scenario_option: opt.ScenarioOption = None,
    sources: opt.Sources = None,
    azimuth_deg: opt.Azimuths = None,
    elevation_deg: opt.Elevations = None,
    range_m: opt.Ranges = None,
    method: opt.MethodName = None,
    study: opt.StudyFolder = None,
    option: opt.MethodOption = None,
    solver_option: opt.SolverOption = None,
    evaluations: opt.Evaluations = None,
    seconds: opt.Seconds = None,
    wavefront: opt.Model = None,
    seed: opt.Seed = 0,
    json: opt.JsonFile = None,
    csv: opt.CsvFile = None,
    figure: opt.FigureFile = None,
    plugin: Plugins = None,
) -> None:
    """Localize the sources in a recording, with standard errors, goodness of fit and warnings."""
    given = locals()
    from nfbench.execution import localize as localize_sources
    from nfbench.report import localization_csv, localization_json, print_localization

    _check_figure(figure)
    options = _scenario_options(given)
    table = options.pop("array", None) or _array(given)
    how = _procedure(given)
    with naming_flags():
        found = _in_flags(localize_sources(data, table, method=how, seed=seed, plugins=plugin or (), **options))
    if json == STDOUT:
        typer.echo(localization_json(found), nl=False)
    else:
        print_localization(found, output())
    _write(None if json in (None, STDOUT) else Path(str(json)), localization_json(found))
    _write(csv, localization_csv(found))
    if figure is not None and found.picture is not None:
        _draw(found.picture, figure, data.name)


def _check_figure(path: Path | None) -> None:
    if path is not None and path.suffix.lower() not in (".png", ".svg", ".pdf"):
        raise typer.BadParameter(f"expected a .png, .svg or .pdf file, got {path.name}", param_hint="--figure")


def _in_flags(found: Localization) -> Localization:
    return replace(found, warnings=tuple(map(in_flags, found.warnings)))


def _draw(picture: Picture, path: Path, title: str) -> None:
    from nfbench.figures import write_localization_figure

    write_localization_figure(picture, path, title)


def _write(path: Path | None, text: str) -> None:
    if path is None:
        return
    try:
        path.write_text(text, encoding="utf-8", newline="")
    except OSError as error:
        raise NfbenchError(f"{path}: {error.strerror or error}") from error


def _scenario_options(given: Mapping[str, Any]) -> dict[str, Any]:
    """The options of the scenario: those of a file, then those of the command line."""
    options = _file_options(given["scenario"]) if given["scenario"] else {}
    for name in OF_SCENARIO:
        if given[name] is not None:
            value = given[name]
            options[RENAMED.get(name, name)] = str(value) if name == "wavefront" else value
    if given["covariance"]:
        options["data_kind"] = "covariance"
    if given["conjugate"]:
        options["conjugate"] = True
    if given["failed"] is not None:
        options["failed"] = [_number(part) for part in given["failed"].replace(",", " ").split()]
    if given["sources"] is not None:
        options["sources"] = _number(given["sources"])
    return options | dict(parsed_option(text) for text in given["scenario_option"] or ())


def _number(text: str) -> int | str:
    """A number, or the name that it is instead."""
    try:
        return int(text)
    except ValueError:
        return text


def _file_options(path: Path) -> dict[str, Any]:
    """The options in a TOML file, or in its table ``[scenario]`` if it has one."""
    try:
        if path.stat().st_size > LARGEST_TOML:
            raise NfbenchError(f"{path}: expected at most {LARGEST_TOML:,} bytes of options, got more")
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise NfbenchError(f"{path}: {error.strerror or error}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise NfbenchError(f"{path}: expected options as in a manifest: {error}") from error
    options = table.get("scenario", table)
    if not isinstance(options, dict):
        raise NfbenchError(f"{path}: expected a table [scenario], got {options!r:.80}")
    return {name: value for name, value in options.items() if name not in ("kind", "data")}


def _array(given: Mapping[str, Any]) -> dict[str, Any]:
    """The table of the array, from a file with positions or from ``--array``."""
    if (given["positions"] is None) == (given["array"] is None):
        text = "expected a file with the positions of the elements, or --array with a table"
        raise typer.BadParameter(
            f"{text}, got {'none' if given['array'] is None else 'both'}", param_hint="--positions"
        )
    own = {name: _axis(given[name]) for name in ("broadside", "up") if given[name] is not None}
    if given["unit"] is not None:
        own["unit"] = given["unit"]
    if given["origin"] is not None:
        own["origin"] = str(given["origin"])
    if given["positions"] is not None:
        return {"kind": "custom", "origin": "center", "file": str(given["positions"])} | own
    text = given["array"].strip()
    try:
        table = tomllib.loads(f"array = {text}" if text.startswith("{") else f"array = {{ {text} }}")["array"]
    except tomllib.TOMLDecodeError as error:
        raise typer.BadParameter(
            f"expected a table in TOML, got {text!r:.200}: {error}", param_hint="--array"
        ) from error
    return {"origin": "center"} | table | own


def _axis(text: str) -> Any:
    """An axis by name, or a vector ``x,y,z``."""
    if "," not in text:
        return text
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        return text


def _procedure(given: Mapping[str, Any]) -> Procedure:
    """The method that is asked for."""
    from nfbench.execution import procedure, recommended

    plugins = given["plugin"] or ()
    own = ("method", "option", "solver_option", "evaluations", "seconds")
    if given["study"] is not None:
        if named := [name for name in own if given[name] is not None]:
            flag = f"--{named[0].replace('_', '-')}"
            raise typer.BadParameter(f"takes the method from the study, so {flag} is not allowed", param_hint="--study")
        how = recommended(given["study"], plugins)
        say(f"Method of the study: {how.label}", error=given["json"] == STDOUT)
        return how
    options, solver_options = (
        dict(parsed_option(text) for text in given[name] or ()) for name in ("option", "solver_option")
    )
    limits = {"evaluations": given["evaluations"], "seconds": given["seconds"]}
    with naming_method_flags(given["solver_option"] or ()):
        return procedure(given["method"] or "grid-refine", options, solver_options, plugins=plugins, **limits)
