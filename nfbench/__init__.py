"""nfbench benchmarks optimizers on near-field source localization.

It answers which optimizer, on which formulation, localizes the sources best within a given budget. This module
exports the base classes for plugins and the functions that a script or notebook needs.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from .core import (
    AskTell,
    AskTellSolver,
    Budget,
    BudgetExhausted,
    Cut,
    Extra,
    FilePath,
    Formulation,
    Ge,
    Gt,
    Incompatible,
    Instance,
    InvalidEvaluation,
    Le,
    Localization,
    Lt,
    ManifestError,
    MeteredProblem,
    Minimize,
    Minimum,
    MissingExtra,
    NfbenchError,
    OneOf,
    OptionError,
    Options,
    Picture,
    PluginError,
    Problem,
    ProblemInstance,
    Reference,
    Scenario,
    Solution,
    Solver,
    SolverInfo,
    Status,
    StoreError,
    Survey,
    Trace,
    Tune,
    minimize,
    nearest,
)

__version__ = "0.1.0"

__all__ = [
    "AskTell",
    "AskTellSolver",
    "Budget",
    "BudgetExhausted",
    "Cut",
    "Extra",
    "FilePath",
    "Formulation",
    "Ge",
    "Gt",
    "Incompatible",
    "Instance",
    "InvalidEvaluation",
    "Le",
    "Localization",
    "Lt",
    "ManifestError",
    "MeteredProblem",
    "Minimize",
    "Minimum",
    "MissingExtra",
    "NestedFormulation",
    "NestedSolver",
    "NfbenchError",
    "OneOf",
    "OptionError",
    "Options",
    "Picture",
    "PluginError",
    "Problem",
    "ProblemInstance",
    "Reference",
    "Results",
    "Scenario",
    "Solution",
    "Solver",
    "SolverInfo",
    "Status",
    "StoreError",
    "Study",
    "Survey",
    "Trace",
    "Tune",
    "choose",
    "combined_info",
    "compiled",
    "formulation_of",
    "load_kernels",
    "load_study",
    "localize",
    "minimize",
    "nearest",
    "nested_formulation",
    "nested_solver",
    "procedure",
    "run",
    "run_part",
    "solver",
    "solver_of",
]

if TYPE_CHECKING:
    from .core.jit import compiled, load_kernels
    from .execution import localize, procedure, run
    from .plugins import (
        NestedFormulation,
        NestedSolver,
        combined_info,
        formulation_of,
        nested_formulation,
        nested_solver,
        run_part,
        solver_of,
    )
    from .results import Results, choose
    from .study import Study, load_study

_PACKAGES = {
    "NestedFormulation": "plugins",
    "NestedSolver": "plugins",
    "Results": "results",
    "Study": "study",
    "choose": "results",
    "combined_info": "plugins",
    "compiled": "core.jit",
    "formulation_of": "plugins",
    "load_kernels": "core.jit",
    "load_study": "study",
    "localize": "execution",
    "nested_formulation": "plugins",
    "nested_solver": "plugins",
    "procedure": "execution",
    "run": "execution",
    "run_part": "plugins",
    "solver_of": "plugins",
}


def __getattr__(name: str) -> Any:
    """Import names that need pandas, Numba or the registry on first use, so that ``import nfbench`` stays fast."""
    if name in _PACKAGES:
        return getattr(importlib.import_module(f".{_PACKAGES[name]}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def solver(name: str, **options: Any) -> Solver:
    """Return a registered solver by name, e.g. ``nfbench.solver("de", population=120)``.

    Raises PluginError if the name is unknown and OptionError if an option is unknown or invalid.
    """
    from .plugins import Registry

    return Registry().make("solver", name, options)
