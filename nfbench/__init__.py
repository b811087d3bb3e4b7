"""nfbench: which optimizer, on which formulation, localizes near-field sources best for what you can spend?

The contracts of plugins and the few calls a notebook needs, in one import.
"""

from __future__ import annotations

from .budget import Budget, Status
from .errors import (
    BudgetExhausted,
    Incompatible,
    InvalidEvaluation,
    ManifestError,
    NfbenchError,
    OptionError,
    PluginError,
    StoreError,
)
from .formulation import Formulation, Minimize
from .meter import MeteredProblem
from .minimize import Minimum, minimize
from .options import FilePath, Ge, Gt, Le, Lt, OneOf, Options
from .problem import Problem
from .scenario import Instance, Scenario
from .solver import AskTell, AskTellSolver, Solver, SolverInfo
from .trace import Trace

__version__ = "0.1.0"

__all__ = [
    "AskTell",
    "AskTellSolver",
    "Budget",
    "BudgetExhausted",
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
    "NfbenchError",
    "OneOf",
    "OptionError",
    "Options",
    "PluginError",
    "Problem",
    "Scenario",
    "Solver",
    "SolverInfo",
    "Status",
    "StoreError",
    "Trace",
    "minimize",
]
