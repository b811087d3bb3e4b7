"""The conformance suite for plugins: checks of what every solver must do, each with a hint how to fix a failure.

In a plugin's tests::

    from nfbench.testing import check_solver

    def test_conformance():
        check_solver(MySolver(population=20))

``check_problem(problem)`` and ``check_scenario(scenario, formulations)`` do the same for problems and scenarios.
"""

from __future__ import annotations

from .checks import CheckResult, check_names, check_solver, solver_checks
from .probe import Probe
from .problem_checks import check_problem, problem_checks
from .scenario_checks import check_scenario, scenario_check_names, scenario_checks
from .watch import check_jobs, watched_checks

__all__ = [
    "CheckResult",
    "Probe",
    "check_jobs",
    "check_names",
    "check_problem",
    "check_scenario",
    "check_solver",
    "problem_checks",
    "scenario_check_names",
    "scenario_checks",
    "solver_checks",
    "watched_checks",
]
