"""Collects the warnings of scenarios and formulations about input that is valid but probably not what was meant."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from nfbench.core import Formulation, Scenario, explain, printable
from nfbench.plugins import rehearse

from .records import Method
from .resolve import Resolver
from .sweep import Sweep

__all__ = ["plugin_warnings"]

CALLS = 1000  # of ``warnings`` in one study; further points are not examined
SHOWN = 20
LONGEST = 1000  # bytes of one warning


def plugin_warnings(sweep: Sweep, methods: Iterable[Method], resolver: Resolver) -> list[str]:
    """Return the warnings of the scenario and the formulations of a study, each once, in one line."""
    methods = list(methods)
    formulations: dict[str, Formulation] = {}
    for method in methods:
        made = resolver.made("formulation", method.formulation)
        if isinstance(made, Formulation):
            formulations[method.formulation.label] = made
    examined = [scenario for scenario in sweep.scenarios if scenario][: max(CALLS // (len(formulations) + 1), 1)]
    specs = [("scenario", point.scenario) for point in sweep.points[:1]]
    specs += [("formulation", method.formulation) for method in methods]
    if any(not spec.broken and resolver.registry.find(kind, spec.kind).foreign for kind, spec in specs):

        def ask() -> str:
            for _ in _all(examined, formulations):
                pass
            return ""

        advice = "its method `warnings` must return a list of texts"
        if reason := rehearse(ask, "asked for warnings", advice):  # its code would end or block this process
            return [printable(f"a plugin of the scenario or a formulation {reason}", LONGEST)]
    found = list(dict.fromkeys(_all(examined, formulations)))
    left = len(found) - SHOWN
    return found if left <= 0 else [*found[:SHOWN], f"{left:,} more warnings of the scenario and the formulations"]


def _all(scenarios: list[Scenario], formulations: dict[str, Formulation]) -> Iterator[str]:
    for scenario in scenarios:
        yield from _of("scenario", scenario)
    for label, formulation in formulations.items():
        for scenario in scenarios:
            if issubclass(scenario.instance, formulation.accepts):
                yield from _of(label, formulation, scenario)


def _of(origin: str, plugin: Scenario | Formulation, *scenario: Scenario) -> list[str]:
    """Return the warnings of one plugin; if it fails to give them, that is the warning."""
    method = plugin.warnings
    if not callable(method):  # an option of this name
        return []
    try:
        return [printable(f"{origin}: {text}", LONGEST) for text in list(method(*scenario))[:SHOWN]]
    except Exception as error:  # of the plugin
        return [printable(f"{origin}: its method `warnings` failed: {explain(error)}", LONGEST)]
