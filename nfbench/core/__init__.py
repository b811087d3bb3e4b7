"""The contracts that plugins implement, and the classes they use.

Nothing in this package depends on studies, results or processes.
"""

from __future__ import annotations

from .budget import Budget, TargetOption, TargetTable
from .cut import Cut, Plane
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
    explain,
    message_of,
)
from .formulation import Formulation, Minimize, Solution
from .latex import latex_text
from .localization import Localization, Picture
from .meter import MeteredProblem
from .minimization import budget_problem, budget_warning, common_start, minimize, start_problem
from .minimum import Minimum
from .options import (
    FilePath,
    Ge,
    Gt,
    Le,
    Lt,
    OneOf,
    Options,
    PluginOption,
    Tune,
    build,
    canonical,
    relative_to,
)
from .problem import Problem
from .process import cause_of_end, die_with_parent, end_group_at_eof
from .reference import Reference
from .scenario import Extra, Instance, ProblemInstance, Scenario
from .solver import AskTell, AskTellSolver, Solver, SolverInfo
from .status import Status
from .suggestions import nearest, suggest
from .survey import Survey
from .text import printable
from .trace import MAX_ROWS, Trace

__all__ = [
    "MAX_ROWS",
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
    "NfbenchError",
    "OneOf",
    "OptionError",
    "Options",
    "Picture",
    "Plane",
    "PluginError",
    "PluginOption",
    "Problem",
    "ProblemInstance",
    "Reference",
    "Scenario",
    "Solution",
    "Solver",
    "SolverInfo",
    "Status",
    "StoreError",
    "Survey",
    "TargetOption",
    "TargetTable",
    "Trace",
    "Tune",
    "budget_problem",
    "budget_warning",
    "build",
    "canonical",
    "cause_of_end",
    "common_start",
    "die_with_parent",
    "end_group_at_eof",
    "explain",
    "latex_text",
    "message_of",
    "minimize",
    "nearest",
    "printable",
    "relative_to",
    "start_problem",
    "suggest",
]
