"""The command ``choose``, which recommends a method for what the user can spend."""

from __future__ import annotations

import json
import tomllib
from typing import Annotated, Any

import typer

from .common import NOT_ALL_OK, OK, Folder, app, explained, output

At = Annotated[
    list[str] | None,
    typer.Option(
        "--at", metavar="KEY=VALUE", help="Only at this swept value, e.g. snr_db=10; repeatable (default: at all)."
    ),
]


@app.command()
def choose(
    folder: Folder,
    evaluations: Annotated[float | None, typer.Option(min=1, help="Most evaluations that a run may spend.")] = None,
    time_ms: Annotated[float | None, typer.Option(help="Longest time of a run [ms].")] = None,
    evaluation_cost_us: Annotated[
        float | None,
        typer.Option(min=0, help="Time of one evaluation of your objective [µs], in place of that in the study."),
    ] = None,
    target: Annotated[
        str | None,
        typer.Option(help="What to reach: error=0.1, bounds=3, gap=1e-4, or a label (default: the study's first)."),
    ] = None,
    reliability: Annotated[float, typer.Option(help="Share of scenes that must reach it.")] = 0.95,
    parallel: Annotated[int, typer.Option(min=1, help="Evaluations that you can make at the same time.")] = 1,
    at: At = None,
    confidence: Annotated[float, typer.Option(help="With which all statements hold together.")] = 0.95,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of text.")] = False,
) -> None:
    """Recommend the cheapest method of a study that reaches a target reliably within what you can spend.

    Budgets below those of the study are read off its traces. The exit code is 1 if no method meets the request.
    """
    from nfbench.report import print_choice
    from nfbench.results import choose as choose_method

    swept = dict(_swept(text) for text in at or ())
    with explained(folder):
        found = choose_method(
            folder,
            target=target,
            evaluations=evaluations,
            time_ms=time_ms,
            evaluation_cost_us=evaluation_cost_us,
            reliability=reliability,
            parallel=parallel,
            at=swept,
            confidence=confidence,
        )
        if as_json:
            typer.echo(json.dumps(found.to_dict(), indent=2))
        else:
            print_choice(found, output())
    raise typer.Exit(OK if found.met else NOT_ALL_OK)


def _swept(text: str) -> tuple[str, Any]:
    """Split ``snr_db=10`` into key and value, which is read as TOML if it is valid TOML."""
    key, sign, value = text.partition("=")
    if not sign or not key:
        raise typer.BadParameter(f"expected KEY=VALUE, e.g. snr_db=10, got {text!r}", param_hint="--at")
    try:
        return key.strip(), tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        return key.strip(), value.strip()
