"""The conformance suite of solvers: what every solver must do, as checks whose failures say how to mend them.

In a plugin's tests::

    from nfbench.testing import check_solver

    def test_conformance():
        check_solver(MySolver(population=20))
"""

from __future__ import annotations

from .checks import CheckResult, check_names, check_solver, solver_checks
from .probe import Probe

__all__ = ["CheckResult", "Probe", "check_names", "check_solver", "solver_checks"]
