"""nfbench: which optimizer, on which formulation, localizes near-field sources best for what you can spend?

The contracts of plugins and the few calls a notebook needs, in one import.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from .budget import Budget, Status
from .errors import (
    BudgetExhausted,
    Incompatible,
    InvalidEvaluation,
    ManifestError,
    MissingExtra,
    NfbenchError,
    OptionError,
    PluginError,
    StoreError,
)
from .formulation import Formulation, Minimize
from .meter import MeteredProblem
from .minimize import Minimum, minimize
from .options import FilePath, Ge, Gt, Le, Lt, OneOf, Options, Tune
from .problem import Problem
from .scenario import Extra, Instance, ProblemInstance, Scenario
from .solver import AskTell, AskTellSolver, Solver, SolverInfo
from .trace import Trace

__version__ = "0.1.0"

__all__ = [
    "AskTell",
    "AskTellSolver",
    "Budget",
    "BudgetExhausted",
    "Extra",
    "FilePath",
    "Formulation",
    "Ge",
    "Gt",
    "Incompatible",
    "Instance",
    "InvalidEvaluation",
    "Le",
    "Lt",
    "ManifestError",
    "MeteredProblem",
    "Minimize",
    "Minimum",
    "MissingExtra",
    "NfbenchError",
    "OneOf",
    "OptionError",
    "Options",
    "PluginError",
    "Problem",
    "ProblemInstance",
    "Results",
    "Scenario",
    "Solver",
    "SolverInfo",
    "Status",
    "StoreError",
    "Study",
    "Trace",
    "Tune",
    "load_study",
    "minimize",
    "run",
    "solver",
]

if TYPE_CHECKING:
    from .manifest import load_study
    from .results import Results, run
    from .study import Study

_LAZY = {"load_study": "manifest", "Results": "results", "run": "results", "Study": "study"}


def __getattr__(name: str) -> Any:
    """What brings in pandas comes only when asked for, so that ``import nfbench`` stays quick."""
    if name in _LAZY:
        return getattr(importlib.import_module(f".{_LAZY[name]}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def solver(name: str, **options: Any) -> Solver:
    """A registered solver by name, e.g. ``nfbench.solver("de", population=120)``.

    Raises PluginError for an unknown name, OptionError for unknown or impossible options.
    """
    from .registry import Registry

    made = Registry().make("solver", name, options)
    assert isinstance(made, Solver)
    return made
