"""What the formulations and solvers of a study are, from the descriptions of installed plugins."""

from __future__ import annotations

from pathlib import Path

from nfbench.core import NfbenchError, Solver, explain, printable
from nfbench.plugins import Registry, description
from nfbench.study import load_methods

__all__ = ["parts"]

NAMED = 4  # methods that a row lists


def parts(folder: Path) -> list[dict[str, str]]:
    """Return a row for each formulation and then for each solver of the manifest in a folder.

    A row has the name, what it is, the methods that use it, and of a solver the reference and the optional extra of
    nfbench that installs its library. There are no rows if the
    manifest needs something that is not installed: as for scenes, code that comes with the folder is not run.
    """
    try:
        methods = load_methods(folder / "manifest.toml")
    except NfbenchError:
        return []
    users: dict[tuple[str, str], list[str]] = {}
    for kind in ("formulation", "solver"):
        for method in methods:
            spec = method.formulation if kind == "formulation" else method.solver
            if spec is not None:
                users.setdefault((kind, spec.kind), []).append(method.label)
    registry = Registry.present()
    return [_row(registry, kind, name, labels) for (kind, name), labels in users.items()]


def _row(registry: Registry, kind: str, name: str, labels: list[str]) -> dict[str, str]:
    row = {"kind": kind, "name": name, "reference": "", "extra": "", "methods": " · ".join(labels[:NAMED])}
    if len(labels) > NAMED:
        row["methods"] += f" and {len(labels) - NAMED} more"
    try:
        found = registry.find(kind, name).resolve()
        row["text"] = description(found).partition("\n")[0].replace("``", "")
        if issubclass(found, Solver):
            row |= {"reference": found.info.reference, "extra": found.info.extra or ""}
    except Exception as error:  # of a plugin
        row["text"] = explain(error)
    return {key: printable(value) for key, value in row.items()}
