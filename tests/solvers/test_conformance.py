"""Every solver of the base installation passes the conformance suite, and its options survive serialization."""

from importlib.metadata import entry_points

import pytest

from nfbench import Solver
from nfbench.core.options import build, canonical
from nfbench.testing import check_names, solver_checks

SOLVERS = {point.name: point for point in entry_points(group="nfbench.solvers") if not point.load().info.extra}


@pytest.mark.parametrize("check", check_names())
@pytest.mark.parametrize("name", SOLVERS)
def test_solver_passes(name, check):
    (result,) = solver_checks(SOLVERS[name].load()(), only=[check])
    assert result.passed, f"{name}: {result.message}"


@pytest.mark.parametrize("name", SOLVERS)
def test_default_options_survive_a_round_trip_through_plain_data(name):
    cls = SOLVERS[name].load()
    assert issubclass(cls, Solver)
    assert build(cls, canonical(cls())) == cls()
    assert cls.info.reference
