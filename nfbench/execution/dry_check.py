"""Finds formulations that cannot solve any scene of a study, before the study runs."""

from __future__ import annotations

import functools
import time
from collections import Counter
from typing import Any, Never

import numpy as np

from nfbench.core import Formulation, Incompatible, NfbenchError, Problem, Scenario, message_of
from nfbench.plugins import Registry, rehearse
from nfbench.study import PluginSpec, Study, scene_seed

__all__ = ["dead_formulations", "refuse_dead"]

SCENES = 3  # that a formulation must decline at every swept point
EACH_S, ALL_S = 3.0, 10.0  # time limits for one formulation and for all; what is not known by then is left to the runs
DECLINED = "declined: "


class _Asked(BaseException):
    """Ends a formulation that asks for the minimizer of its first problem: it can solve the scene so far."""


def _no_minimize(problem: Problem) -> Never:
    raise _Asked


def refuse_dead(study: Study) -> None:
    """Raise NfbenchError, with the reasons, if a formulation of the study cannot solve any of its scenes."""
    if dead := dead_formulations(study):
        listed = "; ".join(f"{label}: {reason}" for label, reason in dead.items())
        plural = "formulations" if len(dead) > 1 else "formulation"
        raise NfbenchError(
            f"{study.name}: nothing was run, as all runs of {len(dead)} {plural} would be skipped: {listed}. "
            f"Remove {'them' if len(dead) > 1 else 'it'} from the manifest, or use --keep-skipped to run the rest"
        )


def dead_formulations(study: Study) -> dict[str, str]:
    """Return the reason by label of each formulation that declines the first scenes at every swept point.

    A formulation with a solver is stopped at its first problem, and one without solves a scene. All of this happens in
    forked copies of this process; where one hangs or ends, nothing is found, and the runs will show why.
    """
    specs = {repr(method.formulation): (method.formulation, method.solver is None) for method in study.methods}
    kinds: Counter[str] = Counter()
    order: list[tuple[int, bool, int, PluginSpec]] = []
    for spec, slow in specs.values():  # each kind once before other options of it, and first what is stopped early
        order.append((kinds[spec.kind], slow, len(order), spec))
        kinds[spec.kind] += 1
    found: dict[str, str] = {}
    end = time.monotonic() + ALL_S
    for *_, spec in sorted(order, key=lambda each: each[:3]):
        if (left := end - time.monotonic()) <= 0:
            break
        act = functools.partial(_declined, study, spec)
        answer = rehearse(act, "checked", "it must return", min(EACH_S, left))
        if answer.startswith(DECLINED):  # otherwise the copy has ended
            found[spec.label] = answer.removeprefix(DECLINED)
    return found


def _declined(study: Study, spec: PluginSpec) -> str:
    reason = _reason(study, Registry(study.plugins), spec)
    return f"{DECLINED}{reason}" if reason else ""


def _reason(study: Study, registry: Registry, spec: PluginSpec) -> str:
    """Why the formulation declines the first scenes of all points; empty if it does not."""
    formulation = _made(registry, "formulation", spec)
    if not isinstance(formulation, Formulation):
        return ""
    reason = ""
    for scene in range(min(SCENES, study.scenes)):
        for point in study.points:
            scenario = _made(registry, "scenario", point.scenario)
            if not isinstance(scenario, Scenario):
                return ""
            try:
                instance = scenario.draw_scene(np.random.default_rng(scene_seed(study.seed, scene)), scene)
                formulation.solve(instance, _no_minimize)
                return ""
            except Incompatible as error:
                reason = reason or message_of(error)
            except (_Asked, Exception):  # a failure is a result of the study
                return ""
    return reason


def _made(registry: Registry, kind: str, spec: PluginSpec) -> Any:
    try:
        return None if spec.broken else registry.make(kind, spec.kind, spec.options)
    except NfbenchError:
        return None
