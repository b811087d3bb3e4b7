"""The options of the command ``localize``, by the part of the help that shows them."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

ARRAY, DATA, BOX, METHOD, RESULT = "The array", "The data", "Where sources are searched", "The method", "The result"


class Origin(StrEnum):
    """The points from which ranges and angles are measured."""

    CENTER = "center"
    FIRST = "first"


class Wavefront(StrEnum):
    """The models of the wavefront."""

    EXACT = "exact"
    FRESNEL = "fresnel"
    PAPER = "paper"
    PLANAR = "planar"


def _option(panel: str, text: str, *names: str, metavar: str | None = None) -> Any:
    return typer.Option(*names, help=text, metavar=metavar, rich_help_panel=panel, show_default=False)


def metavar(option: Any) -> str:
    """Return what stands for the value of an option in its help."""
    return str(option.__metadata__[0].metavar)


DataFile = Annotated[Path, typer.Argument(metavar="DATA", help="File with snapshots, a covariance, or samples.")]

PositionsFile = Annotated[Path | None, _option(ARRAY, "File with the positions of the elements.", metavar="FILE")]
ArrayTable = Annotated[
    str | None, _option(ARRAY, "Array as a table in TOML, e.g. '{kind=\"ula\", elements=8, …}'.", metavar="TABLE")
]
Unit = Annotated[str | None, _option(ARRAY, "Unit of the positions, e.g. m (default), cm, mm or in.")]
Broadside = Annotated[
    str | None,
    _option(ARRAY, "Direction in front of the array: +x (default), -z, …, or x,y,z.", metavar="AXIS"),
]
Up = Annotated[str | None, _option(ARRAY, "Direction upwards, given like --broadside.", metavar="AXIS")]
From = Annotated[Origin | None, _option(ARRAY, "Point from which ranges are measured (default: center).")]
Failed = Annotated[str | None, _option(ARRAY, "Elements to leave out, from 0, e.g. 3,17.", metavar="LIST")]

Frequency = Annotated[float | None, _option(DATA, "Frequency [Hz].")]
Speed = Annotated[float | None, _option(DATA, "Speed of the waves [m/s].")]
Wavelength = Annotated[float | None, _option(DATA, "Wavelength [m], in place of a frequency and a speed.")]
Covariance = Annotated[bool, _option(DATA, "DATA is a covariance (elements × elements).", "--covariance")]
Snapshots = Annotated[int | None, _option(DATA, "Number of snapshots from which the covariance was estimated.")]
SampleRate = Annotated[float | None, _option(DATA, "DATA holds samples over time with this sampling rate [Hz].")]
Block = Annotated[int | None, _option(DATA, "Samples per block of the Fourier transform.")]
Window = Annotated[str | None, _option(DATA, "Window of the blocks, e.g. hann.")]
Overlap = Annotated[float | None, _option(DATA, "Overlap of the blocks, from 0 to below 1.")]
Variable = Annotated[str | None, _option(DATA, "Name of the array in a file with several arrays.", metavar="NAME")]
ElementAxis = Annotated[int | None, _option(DATA, "Axis of the elements in DATA, 0 or 1 (default: the one that fits).")]
Conjugate = Annotated[bool, _option(DATA, "Conjugate the data, for phases that grow with the distance.", "--conjugate")]
ScenarioFile = Annotated[
    Path | None,
    _option(DATA, "TOML file with options of the scenario recorded; other options take precedence.", metavar="FILE"),
]
ScenarioOption = Annotated[
    list[str] | None, _option(DATA, "Further option of the scenario recorded; repeatable.", metavar="NAME=VALUE")
]

Azimuths = Annotated[tuple[float, float] | None, _option(BOX, "Interval of azimuths [°].", metavar="LOW HIGH")]
Elevations = Annotated[
    tuple[float, float] | None,
    _option(BOX, "Interval of elevations [°]; without it, none is estimated.", metavar="LOW HIGH"),
]
Ranges = Annotated[tuple[float, float] | None, _option(BOX, "Interval of ranges [m].", metavar="LOW HIGH")]
Sources = Annotated[str | None, _option(BOX, "Number of sources; estimate: from the data.", metavar="NUMBER|estimate")]

Model = Annotated[Wavefront | None, _option(METHOD, "Model of the wavefront (default: exact).")]
MethodName = Annotated[
    str | None,
    _option(METHOD, "Formulation, or formulation + solver, e.g. 'neef + de' (default: grid-refine).", metavar="NAME"),
]
StudyFolder = Annotated[
    Path | None, _option(METHOD, "Results folder of a study whose recommended method is used.", metavar="DIR")
]
MethodOption = Annotated[
    list[str] | None, _option(METHOD, "Option of the formulation; repeatable.", "--option", metavar="NAME=VALUE")
]
SolverOption = Annotated[list[str] | None, _option(METHOD, "Option of the solver; repeatable.", metavar="NAME=VALUE")]
Evaluations = Annotated[
    int | None, _option(METHOD, "Evaluations that the solver may spend per problem (default: 20,000).")
]
Seconds = Annotated[float | None, _option(METHOD, "Seconds that the solver may spend per problem.")]
Seed = Annotated[int, typer.Option(min=0, help="Seed of the solver.", rich_help_panel=METHOD)]

JsonFile = Annotated[
    str | None, _option(RESULT, "Write JSON to a file; without one, print it alone.", metavar="[FILE]")
]
CsvFile = Annotated[Path | None, _option(RESULT, "Write one row per source to this file.", metavar="FILE")]
FigureFile = Annotated[
    Path | None, _option(RESULT, "Draw array, box and estimates: a .png, .svg or .pdf file.", metavar="FILE")
]
