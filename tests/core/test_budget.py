"""Tests that a budget accepts each kind of target and refuses what is none."""

import math

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from nfbench import Budget, Incompatible, OptionError, Problem
from nfbench.core import TargetTable, build, canonical
from nfbench.core.budget import objective_target


class WithMinimum(Problem):
    def __init__(self, minimum):
        self.minimum = minimum

    def evaluate(self, X):
        raise NotImplementedError


@pytest.mark.parametrize("kind", ["gap", "error", "error_in_bounds"])
def test_a_target_is_a_number_or_a_table(kind):
    assert Budget(evaluations=1, target=-2).target == -2.0
    table = Budget(evaluations=1, target={kind: 0.5}).target
    assert (table.kind, table.value) == (kind, 0.5)
    assert table == TargetTable(**{kind: 0.5})


@pytest.mark.parametrize("target", [None, 1.5, {"gap": 1e-6}, {"error_in_bounds": 3}])
def test_plain_data_give_the_same_budget_again(target):
    budget = Budget(evaluations=7, target=target)
    assert build(Budget, canonical(budget)) == budget


@pytest.mark.parametrize(
    ("target", "message"),
    [
        (math.inf, "target: expected a finite number or a table with gap, error or error_in_bounds, got inf"),
        (math.nan, "target: expected a number, got nan"),
        (10**400, "target: expected a finite number or a table with gap, error or error_in_bounds, got an integer of"),
        (True, "target: expected a finite number or a table with gap, error or error_in_bounds, got True"),
        ("1", "target: expected a finite number or a table with gap, error or error_in_bounds, got '1'"),
        ({}, "target: expected one of gap, error and error_in_bounds, got none"),
        ({"gap": 1.0, "error": 1.0}, "target: expected one of gap, error and error_in_bounds, got gap, error"),
        ({"gap": 0.0}, r"target.gap: expected greater than 0, got 0.0"),
        ({"gaps": 0.1}, 'target.gaps: unknown option; did you mean "gap"?'),
    ],
)
def test_the_error_names_a_target_that_is_none(target, message):
    with pytest.raises(OptionError) as caught:
        Budget(evaluations=1, target=target)
    assert message in str(caught.value)


@given(st.floats(-1e3, 1e3), st.floats(1e-9, 1e3))
@example(1e300, 0.1)
@example(-1e9, 1e-12)
@example(5e-324, 1e5)
def test_the_objective_value_of_a_gap_is_the_largest_that_meets_it(minimum, gap):
    value = objective_target(WithMinimum(minimum), Budget(evaluations=1, target={"gap": gap}), None)
    assert value - minimum <= gap < math.nextafter(value, math.inf) - minimum


def test_a_gap_needs_a_known_minimum_and_an_error_needs_a_predicate():
    with pytest.raises(Incompatible, match="no reference optimum is known"):
        objective_target(WithMinimum(None), Budget(evaluations=1, target={"gap": 1.0}), None)
    with pytest.raises(ValueError, match=r"budget.target: error needs the function `reached`, got none"):
        objective_target(WithMinimum(0.0), Budget(evaluations=1, target={"error": 1.0}), None)
