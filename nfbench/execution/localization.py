"""Localizes the sources in one recording with one method, and describes what was found."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray

from nfbench.core import (
    Formulation,
    Instance,
    Localization,
    Minimum,
    NfbenchError,
    OptionError,
    Problem,
    Scenario,
    Solution,
    Status,
    common_start,
    explain,
    minimize,
    start_problem,
)
from nfbench.plugins import Registry

from .procedures import Procedure, procedure
from .storable import Unstorable, plain_estimate

__all__ = ["localize"]

SCENARIO = "recorded"
SOUND = ".wav"  # suffix of files that hold samples over time, with their rate
OF_ARRAY = ("broadside", "up", "unit", "origin")  # options of an array that is given by its positions
FILES_KNOWN = {"gains_file": "known_gains", "noise_file": "known_noise"}  # what a formulation knows from files


def localize(
    data: ndarray | str | Path,
    array: ndarray | str | Path | Mapping[str, Any],
    *,
    method: str | Procedure = "grid-refine",
    seed: int = 0,
    plugins: Iterable[str | Path] = (),
    **options: Any,
) -> Localization:
    """Localize the sources in a recording, and say how well they explain it and what may be wrong.

    data: snapshots (elements, T), complex, or whatever ``data_kind`` says; or the path of a file.
    array: positions of the elements [m], shape (M, 3), or the path of a file with them, or a table like ``array`` in a
        manifest, such as ``{"kind": "upa", …}``. Ranges and angles are measured from the centre of the positions.
    method: name of a formulation, or of a formulation and a solver, such as "neef + de", which gets 20,000 evaluations
        per problem; or the result of ``procedure``, which has options.
    seed: seed of the solver; the same seed gives the same result.
    plugins: plugin files that the method needs.
    options: options of the scenario ``recorded``, such as ``frequency_hz``, ``speed_m_s``, ``sources``,
        ``azimuth_deg``, ``elevation_deg`` and ``range_m``, and ``broadside``, ``up``, ``unit`` and ``origin`` of the
        array. ``sources="estimate"`` estimates the number of sources. The default of ``data_kind`` is "samples" for a
        .wav file and with ``sample_rate_hz``.

    Raises OptionError for invalid options, and NfbenchError if the method finds no estimate; the message says why.
    """
    registry = Registry(plugins)
    with _stored(data) as path:
        if "data_kind" not in options and ("sample_rate_hz" in options or path.lower().endswith(SOUND)):
            options["data_kind"] = "samples"
        table = _array_table(array, options)
        estimated = options.get("sources") == "estimate"
        if estimated:
            options["sources"] = 1
        scenario = registry.make("scenario", SCENARIO, {"data": path, "array": table, **options})
        how = procedure(method, plugins=plugins) if isinstance(method, str) else method
        how = _knowing(_estimating(how) if estimated else how, options)
        scenario.warm_up()
        instance = scenario.draw(np.random.default_rng(seed))
    found = _described(scenario, instance, how, seed)
    warnings = [*how.unlike(scenario), *_unknown(how, options), *found.warnings]
    return replace(found, warnings=tuple(dict.fromkeys(warnings)), method=how.described(seed))


def _described(scenario: Scenario, instance: Instance, how: Procedure, seed: int) -> Localization:
    """Solve an instance and describe the estimate, with the warnings of the scenario and the formulation.

    Raises NfbenchError if there is no estimate; the message includes what may be wrong with the data.
    """
    if not isinstance(instance, how.formulation.accepts):
        accepts, own = how.formulation.accepts.__name__, type(instance).__name__
        raise NfbenchError(f"method: expected a formulation that solves {own}, got one for {accepts}")
    warnings = [*scenario.warnings(), *how.formulation.warnings(scenario)]
    try:
        estimate, columns = _solved(instance, how, seed)
        plain_estimate(estimate)
    except (NfbenchError, Unstorable) as error:
        raise _with_causes(str(error), instance, warnings) from error
    except MemoryError:
        raise
    except Exception as error:  # of the formulation
        raise _with_causes(explain(error), instance, warnings) from error
    found = instance.describe(estimate, columns)
    if found is None:
        raise NfbenchError(f"{type(instance).__name__} does not describe its estimates")
    return replace(found, warnings=_combined(warnings, found))


def _combined(warnings: Iterable[str], found: Localization) -> tuple[str, ...]:
    """Return the warnings before and after the fit; a tested cause comes first, without guesses that it replaces."""
    if not found.replaces:
        return tuple(dict.fromkeys([*warnings, *found.warnings]))
    others = [text for text in warnings if not text.startswith(found.replaces)]
    return tuple(dict.fromkeys([*found.warnings, *others]))


def _solved(instance: Instance, how: Procedure, seed: int) -> tuple[ndarray, Mapping[str, float]]:
    number = 0

    def minimize_next(problem: Problem) -> Minimum:
        nonlocal number
        if how.solver is None or how.budget is None:
            raise NfbenchError("the formulation declares `needs_solver = False` but called `minimize`")
        if how.start and (reason := start_problem(how.solver)):
            raise NfbenchError(reason)
        sample = common_start(problem, how.start, [seed, number]) if how.start else None
        found = minimize(problem, how.solver, how.budget, np.random.default_rng([seed, number]), start=sample)
        number += 1
        if found.status is not Status.OK:
            raise NfbenchError(f"the solver ended with the status {found.status}: {found.message}")
        return found

    how.formulation.warm_up()
    solution = how.formulation.solve(instance, minimize_next)
    return (solution.estimate, solution.columns) if isinstance(solution, Solution) else (solution, {})


def _with_causes(message: str, instance: Instance, warnings: Iterable[str]) -> NfbenchError:
    """An error with what may be wrong with the data, found without an estimate."""
    causes = list(warnings)
    try:
        nothing = instance.describe(np.empty((0,)), {})
        causes = [*_combined(causes, nothing)] if nothing else causes
    except Exception:  # the first error matters
        return NfbenchError(message)
    return NfbenchError("\n".join([message, *(f"  {cause}" for cause in dict.fromkeys(causes))]))


def _estimating(how: Procedure) -> Procedure:
    """The same method, which estimates the number of sources."""
    if not _has(how.formulation, "sources"):
        raise NfbenchError(f"sources: {type(how.formulation).__name__} cannot estimate the number of sources; give it")
    return replace(how, formulation=_with(how.formulation, sources="estimate"))


def _knowing(how: Procedure, options: Mapping[str, Any]) -> Procedure:
    """The same method, which knows what the files of the scenario say about the array and the noise."""
    known = {name: True for file, name in FILES_KNOWN.items() if options.get(file) and _has(how.formulation, name)}
    return replace(how, formulation=_with(how.formulation, **known))


def _unknown(how: Procedure, options: Mapping[str, Any]) -> list[str]:
    """Return a warning if a study has chosen a method that knows what the recording does not say."""
    missing = [
        file for file, name in FILES_KNOWN.items() if getattr(how.formulation, name, False) and not options.get(file)
    ]
    if not how.study or not missing:
        return []
    known = ", ".join(FILES_KNOWN[file] for file in missing)
    return [
        f"in the study the method knows more than here ({known}); give {' and '.join(missing)}, or simulate without"
    ]


def _has(formulation: Formulation, option: str) -> bool:
    return option in {field.name for field in fields(formulation)}


def _with(formulation: Formulation, **options: Any) -> Formulation:
    """A formulation with other values of some options."""
    return replace(formulation, **options)


@contextmanager
def _stored(data: ndarray | str | Path) -> Iterator[str]:
    """The path of a file with the data, which exists within the context."""
    if isinstance(data, str | Path):
        yield str(data)
        return
    numbers = np.asarray(data)
    if numbers.dtype.kind not in "iufc":
        raise OptionError("localize", [("data", f"expected numbers or a path, got {numbers.dtype}")])
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "data.npy"
        np.save(path, numbers, allow_pickle=False)
        yield str(path)


def _array_table(array: ndarray | str | Path | Mapping[str, Any], options: dict[str, Any]) -> dict[str, Any]:
    """The table of an array; the options that belong to it are moved into it."""
    own: dict[str, Any] = {name: options.pop(name) for name in OF_ARRAY if name in options}
    if isinstance(array, Mapping):
        return {**array, **own}
    if isinstance(array, str | Path):
        return {"kind": "custom", "origin": "center", "file": str(array), **own}
    positions = np.asarray(array)
    if positions.ndim != 2 or positions.shape[1] != 3 or positions.dtype.kind not in "iuf":
        text = f"expected positions [m] of shape (M, 3), a path or a table, got {positions.dtype} {positions.shape}"
        raise OptionError("localize", [("array", text)])
    return {"kind": "custom", "origin": "center", "positions": positions.astype(np.float64).tolist(), **own}
