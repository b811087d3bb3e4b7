"""Tests that the meter counts every evaluation, makes none beyond the budget, and keeps the best point."""

import contextlib
import math
import threading
import time
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nfbench import (
    Budget,
    BudgetExhausted,
    Incompatible,
    InvalidEvaluation,
    MeteredProblem,
    OptionError,
    Problem,
    Solver,
    SolverInfo,
    Status,
    minimize,
)
from nfbench.core.trace import MAX_ROWS


class Counted(Problem):
    """A problem that returns the given values in order and counts its evaluations."""

    def __init__(self, values=None, n=2):
        self.lower, self.upper = np.full(n, -1.0), np.full(n, 1.0)
        self.values, self.count = values, 0

    def evaluate(self, X):
        start, self.count = self.count, self.count + len(X)
        return (X**2).sum(axis=1) if self.values is None else np.array(self.values[start : self.count], dtype=float)


def metered(values=None, n=2, **budget):
    problem = Counted(values, n)
    return problem, MeteredProblem(problem, Budget(**(budget or {"evaluations": 1000})))


def test_a_batch_beyond_the_budget_is_truncated():
    problem, meter = metered(values=[5.0, 4.0, 3.0, 2.0, 1.0], evaluations=4)
    meter.evaluate(np.zeros((3, 2)))
    assert meter.remaining == 1
    with pytest.raises(BudgetExhausted):
        meter.evaluate(np.zeros((2, 2)))
    assert problem.count == meter.evaluations == 4
    assert meter.best_value == 2.0
    for call in (lambda: meter(np.zeros(2)), lambda: meter.evaluate(np.zeros((1, 2)))):
        with pytest.raises(BudgetExhausted):
            call()
    assert problem.count == 4


def test_a_batch_that_uses_the_whole_budget_is_returned_and_the_next_call_raises():
    problem, meter = metered(evaluations=3)
    assert len(meter.evaluate(np.zeros((3, 2)))) == 3
    with pytest.raises(BudgetExhausted):
        meter(np.zeros(2))
    assert problem.count == 3


@given(st.lists(st.lists(st.floats(-1, 1), max_size=7), max_size=12), st.integers(1, 30))
def test_count_and_best_value_equal_a_plain_computation(batches, limit):
    problem, meter = metered(n=1, evaluations=limit)
    points = []
    try:
        for batch in batches:
            points += batch
            meter.evaluate(np.array(batch).reshape(-1, 1))
    except BudgetExhausted:
        pass
    done = points[:limit]
    assert meter.evaluations == problem.count == len(done)
    assert meter.best_value == (min(x * x for x in done) if done else math.inf)
    values, best = meter.trace.values, math.inf
    assert list(values) == sorted(values, reverse=True)
    improvements = [(i, best := x * x) for i, x in enumerate(done, 1) if x * x < best]
    rows = list(zip(meter.trace.evaluations, values, strict=True))
    assert rows[: len(improvements)] == improvements
    assert not done or rows[-1][0] == len(done)


@given(st.lists(st.floats(-1, 1), min_size=1, max_size=20), st.integers(1, 20))
def test_batches_and_single_points_give_the_same_trace(points, size):
    _, single = metered(n=1)
    _, batched = metered(n=1)
    for x in points:
        single(np.array([x]))
    for start in range(0, len(points), size):
        batched.evaluate(np.array(points[start : start + size]).reshape(-1, 1))
    for name in ("evaluations", "values", "points"):
        np.testing.assert_array_equal(getattr(single.trace, name), getattr(batched.trace, name))


def test_the_trace_has_fewer_than_a_thousand_rows_including_the_first_and_the_last():
    values = [1e6 / (i + 1) for i in range(20_000)] + [1e9]
    _, meter = metered(values=values, evaluations=30_000)
    for start in range(0, len(values), 97):
        meter.evaluate(np.zeros((len(values[start : start + 97]), 2)))
    trace = meter.trace
    assert 300 < len(trace) <= MAX_ROWS < 1000
    assert (trace.evaluations[0], trace.values[0]) == (1, 1e6)
    assert (trace.evaluations[-1], trace.values[-1]) == (20_001, 1e6 / 20_000)
    assert (np.diff(trace.evaluations) > 0).all()
    thin = trace.thinned(10)
    assert len(thin) == 10 and thin.evaluations[0] == 1 and thin.evaluations[-1] == 20_001


def test_the_best_point_is_a_copy_that_the_solver_cannot_change():
    _, meter = metered()
    x = np.array([0.5, 0.0])
    meter(x)
    x[:] = 0.9
    assert meter.best_point.tolist() == [0.5, 0.0]
    with pytest.raises(ValueError, match="read-only"):
        meter.lower[0] = -5


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_nonfinite_value_is_counted_and_never_becomes_the_best(bad):
    _, meter = metered(values=[bad, 3.0, bad, 2.0, bad])
    assert meter(np.zeros(2)) == math.inf
    assert meter.best_point is None
    assert meter.evaluate(np.zeros((3, 2))).tolist() == [3.0, math.inf, 2.0]
    assert meter(np.zeros(2)) == math.inf
    assert (meter.nonfinite, meter.evaluations, meter.best_value) == (3, 5, 2.0)


def test_infinities_of_both_signs_and_huge_values_in_one_batch():
    _, meter = metered(values=[math.inf, -math.inf, 1e200, math.nan])
    assert meter.evaluate(np.zeros((4, 2))).tolist() == [math.inf, math.inf, 1e200, math.inf]
    assert (meter.nonfinite, meter.best_value) == (3, 1e200)


@pytest.mark.parametrize("x", [[1.0000000001, 0], [0, -1.1], [math.nan, 0], [math.inf, 0]])
@pytest.mark.parametrize("n", [2, 40])
def test_a_point_outside_the_box_is_rejected_and_not_evaluated(x, n):
    problem, meter = metered(n=n)
    x = np.concatenate([x, np.zeros(n - 2)])
    with pytest.raises(InvalidEvaluation, match=r"x\[\d+\]: expected a number within \[-1.0, 1.0\]|within"):
        meter(x)
    assert problem.count == meter.evaluations == 0
    assert meter.fault is not None
    with pytest.raises(InvalidEvaluation):  # later calls raise too, even if a library swallowed the first exception
        meter(np.zeros(n))
    _, meter = metered(n=n)
    with pytest.raises(InvalidEvaluation):
        meter.evaluate(np.array([np.zeros(n), x]))


def test_points_on_the_edges_of_the_box_are_accepted():
    _, meter = metered()
    assert meter(np.array([1.0, -1.0])) == 2.0


@pytest.mark.parametrize("x", [np.zeros(3), np.zeros((1, 2)), np.float64(0.0)])
def test_a_point_of_the_wrong_shape_is_rejected(x):
    _, meter = metered()
    with pytest.raises(InvalidEvaluation, match=r"expected a point of shape \(2,\)"):
        meter(x)


@pytest.mark.parametrize("X", [np.zeros(2), np.zeros((4, 3)), np.zeros((1, 1, 2))])
def test_a_batch_of_the_wrong_shape_is_rejected(X):
    _, meter = metered()
    with pytest.raises(InvalidEvaluation, match=r"expected a batch of shape \(p, 2\)"):
        meter.evaluate(X)


def test_the_error_names_a_problem_that_returns_the_wrong_shape():
    _, meter = metered(values=[1.0])
    with pytest.raises(InvalidEvaluation, match=r"the problem: expected values of shape \(3,\), got \(1,\)"):
        meter.evaluate(np.zeros((3, 2)))


def test_the_target_ends_the_run_after_the_evaluation_that_reaches_it():
    problem, meter = metered(values=[3.0, 1.0, 0.5, 0.1], evaluations=10, target=1.0)
    meter(np.zeros(2))
    meter(np.zeros(2))
    with pytest.raises(BudgetExhausted):
        meter(np.zeros(2))
    assert problem.count == 2


def test_the_time_limit_ends_the_run():
    _, meter = metered(seconds=1e-9)
    with pytest.raises(BudgetExhausted):
        meter(np.zeros(2))
    assert meter.evaluations == 0


def test_a_gradient_counts_as_one_evaluation_and_is_an_error_if_the_problem_has_none():
    class Parabola(Counted):
        has_gradient = True

        def value_and_gradient(self, x):
            return float(x @ x), 2 * x

    meter = MeteredProblem(Parabola(), Budget(evaluations=1))
    assert meter.has_gradient
    value, gradient = meter.value_and_gradient(np.array([0.5, 0.0]))
    assert (value, gradient.tolist()) == (0.25, [1.0, 0.0])
    assert (meter.evaluations, meter.gradients) == (1, 1)
    with pytest.raises(BudgetExhausted):
        meter.value_and_gradient(np.zeros(2))
    _, plain = metered()
    assert not plain.has_gradient
    with pytest.raises(Incompatible, match="Counted has no analytic gradient"):
        plain.value_and_gradient(np.zeros(2))


@given(st.integers(0, 2**32))
def test_points_map_from_the_unit_box_to_the_box_and_back(seed):
    rng = np.random.default_rng(seed)
    problem = Counted(n=3)
    problem.lower = rng.normal(size=3) * 10.0 ** rng.integers(-8, 8)
    problem.upper = problem.lower + rng.random(3) + 1e-3
    meter = MeteredProblem(problem, Budget(evaluations=10))
    for U in (rng.random((4, 3)), np.ones((1, 3)), np.zeros((1, 3))):
        X = meter.from_unit(U)
        meter.evaluate(X)
        np.testing.assert_allclose(meter.to_unit(X), U, atol=1e-6)


def test_a_budget_without_a_limit_and_a_problem_with_an_empty_box_are_errors():
    with pytest.raises(OptionError, match="expected a limit on evaluations or seconds, got neither"):
        Budget(target=1.0)
    with pytest.raises(OptionError, match="evaluations: expected greater than or equal to 1, got 0"):
        Budget(evaluations=0)
    problem = Counted()
    problem.upper = problem.lower
    with pytest.raises(ValueError, match="lower < upper"):
        MeteredProblem(problem, Budget(evaluations=1))


class Slow(Counted):
    """A problem that gives other threads a chance to run within an evaluation."""

    def evaluate(self, X):
        time.sleep(0.0002)
        return super().evaluate(X)


@pytest.mark.parametrize("batch", [1, 7])
def test_threads_together_make_no_evaluation_beyond_the_budget(batch):
    problem = Slow()
    meter = MeteredProblem(problem, Budget(evaluations=200))

    def work(seed):
        rng = np.random.default_rng(seed)
        with contextlib.suppress(BudgetExhausted):
            while True:
                X = rng.uniform(-1, 1, (batch, 2))
                meter(X[0]) if batch == 1 else meter.evaluate(X)

    threads = [threading.Thread(target=work, args=(seed,)) for seed in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert meter.evaluations == problem.count == 200
    trace = meter.trace
    assert (np.diff(trace.evaluations) >= 0).all() and (np.diff(trace.values) <= 0).all()
    assert trace.values[-1] == meter.best_value and trace.evaluations[-1] == 200


@pytest.mark.parametrize("name", ["evaluations", "gradients", "nonfinite", "best_value", "best_point", "remaining"])
def test_the_counts_and_the_best_value_cannot_be_assigned(name):
    _, meter = metered()
    with pytest.raises(AttributeError):
        setattr(meter, name, 0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"_limit": 10**9}, "expected at most 20 evaluations, got 50"),
        ({"_evaluations": 0}, "expected at least "),
        ({"_best_value": -1.0}, "expected the best value "),
        ({"_best_value": "abc"}, "expected the best value "),
        ({"_recorder": None}, "the solver damaged the meter: AttributeError"),
        ({"lower": None}, "the solver damaged the meter: "),
    ],
)
def test_a_run_whose_solver_changed_the_meter_is_not_ok(change, message):
    @dataclass(frozen=True)
    class Cheats(Solver):
        def minimize(self, problem, rng):
            for name, value in change.items():
                if name == "_limit":
                    setattr(problem, name, value)
            with contextlib.suppress(BudgetExhausted):
                for _ in range(50 if "_limit" in change else 20):
                    problem(rng.uniform(-1, 1, 2))
            for name, value in change.items():
                setattr(problem, name, value)

    found = minimize(Counted(), Cheats(), 20)
    assert found.status in (Status.INVALID, Status.FAILED) and message in found.message, found.message


def test_a_thread_that_outlives_the_run_cannot_go_on_evaluating():
    problem, threads = Slow(), []

    @dataclass(frozen=True)
    class LeavesAThread(Solver):
        def minimize(self, problem, rng):
            def work():
                with contextlib.suppress(BudgetExhausted):
                    while True:
                        problem(np.zeros(2))

            threads.append(threading.Thread(target=work))
            threads[0].start()
            problem(np.zeros(2))

    found = minimize(problem, LeavesAThread(), 10**6)
    threads[0].join(10)
    assert not threads[0].is_alive() and found.status is Status.OK
    assert problem.count <= found.evaluations + 1


class Clock:
    """A clock that only the test advances."""

    def __init__(self, monkeypatch):
        self.now = 0.0
        monkeypatch.setattr("nfbench.core.meter.time.perf_counter", lambda: self.now)


class Timed(Counted):
    """A problem whose evaluations take ``cost`` seconds each on a clock."""

    def __init__(self, clock, cost, n=2):
        super().__init__(n=n)
        self.clock, self.cost = clock, cost

    def evaluate(self, X):
        self.clock.now += self.cost * len(X)
        return super().evaluate(X)


def tolerated(seconds):
    """The latest end of a run, 10 % + 1 ms after its deadline."""
    return 1.1 * seconds + 0.001


@pytest.mark.parametrize("seconds", [0.005, 0.1, 1.0])
@pytest.mark.parametrize("cost", [1e-7, 1e-5, 3e-4])
@pytest.mark.parametrize("size", [1, 256, 20_000])
def test_a_batch_ends_at_the_deadline_and_counts_only_what_was_evaluated(monkeypatch, seconds, cost, size):
    problem = Timed(clock := Clock(monkeypatch), cost)
    meter = MeteredProblem(problem, Budget(seconds=seconds))
    X = np.zeros((size, 2))
    with contextlib.suppress(BudgetExhausted):
        for _ in range(500):
            assert len(meter.evaluate(X)) == size
    assert clock.now <= tolerated(seconds)
    if cost * size * 500 > 1.1 * seconds:  # the time limit ended the run, and not early
        assert clock.now >= seconds - cost
        assert meter.spent
        with pytest.raises(BudgetExhausted):
            meter.evaluate(X)
    assert problem.count == meter.evaluations


def test_a_batch_in_parts_has_the_same_values_and_trace(monkeypatch):
    X = np.random.default_rng(3).uniform(-1, 1, (400, 2))
    whole = MeteredProblem(Counted(), Budget(evaluations=400))
    parts = MeteredProblem(problem := Timed(Clock(monkeypatch), 1e-5), Budget(seconds=0.005))
    sizes, evaluate = [], problem.evaluate
    problem.evaluate = lambda X: sizes.append(len(X)) or evaluate(X)
    np.testing.assert_array_equal(whole.evaluate(X), parts.evaluate(X))
    assert len(sizes) > 2 and sum(sizes) == 400
    for name in ("evaluations", "values", "points"):
        np.testing.assert_array_equal(getattr(whole.trace, name), getattr(parts.trace, name))


@pytest.mark.parametrize("limit", [1, 2, 3, 399])
def test_parts_keep_the_limit_on_evaluations(monkeypatch, limit):
    problem = Timed(Clock(monkeypatch), 1e-4)
    meter = MeteredProblem(problem, Budget(evaluations=limit, seconds=0.05))
    with pytest.raises(BudgetExhausted):
        meter.evaluate(np.zeros((400, 2)))
    assert problem.count == meter.evaluations == limit


def test_the_target_never_ends_a_batch_in_its_middle_so_that_the_clock_does_not_decide(monkeypatch):
    problem = Timed(Clock(monkeypatch), 1e-5)
    meter = MeteredProblem(problem, Budget(seconds=0.01, target=0.5))
    meter.evaluate(np.zeros((300, 2)))
    assert problem.count == 300 and meter.reached
    with pytest.raises(BudgetExhausted):
        meter.evaluate(np.zeros((1, 2)))


@pytest.mark.parametrize("single", [True, False])
def test_a_solver_whose_next_call_would_come_too_late_is_stopped_now(monkeypatch, single):
    meter = MeteredProblem(Timed(clock := Clock(monkeypatch), 1e-6), Budget(seconds=0.1))
    with pytest.raises(BudgetExhausted):
        for _ in range(100):
            meter(np.zeros(2)) if single else meter.evaluate(np.zeros((5, 2)))
            clock.now += 0.03
    assert 0.09 < clock.now < 0.1  # after 0.09 s, the next call would come at 0.12 s
    assert meter.spent and meter.remaining_s == 0.0


def test_the_time_before_the_first_call_says_nothing_about_later_steps(monkeypatch):
    meter = MeteredProblem(Timed(clock := Clock(monkeypatch), 1e-3), Budget(seconds=0.1))
    clock.now += 0.08
    with pytest.raises(BudgetExhausted):
        for _ in range(100):
            meter(np.zeros(2))
    assert meter.evaluations == 20


@pytest.mark.parametrize("batch", [1, 4])
def test_a_predicate_decides_at_improvements_only_and_stops_the_run(batch):
    values, seen = [5.0, 7.0, 4.0, 4.0, 3.0, 9.0, 2.0, 1.0], []

    def reached(x, value):
        seen.append(value)
        return value <= 3.0

    problem = Counted(values)
    meter = MeteredProblem(problem, Budget(evaluations=8), reached)
    with pytest.raises(BudgetExhausted):
        for _ in range(8):
            meter(np.zeros(2)) if batch == 1 else meter.evaluate(np.zeros((batch, 2)))
    assert meter.reached and meter.spent
    assert (seen, problem.count) == (([5.0, 4.0, 3.0], 5) if batch == 1 else ([4.0, 1.0], 8))


def test_the_predicate_holds_for_the_best_point_at_the_end():
    meter = MeteredProblem(Counted([2.0, 1.0]), Budget(evaluations=8), lambda x, value: value > 1.5)
    meter.evaluate(np.zeros((2, 2)))  # the second point is better, and the predicate is false there
    assert (meter.best_value, meter.reached) == (1.0, False)


def test_a_first_population_consists_of_the_best_points_of_the_start_and_random_points():
    rng = np.random.default_rng(0)
    start = np.array([[0.5, 0.0], [0.1, 0.0], [0.9, 0.0], [0.2, 0.0]])
    _, meter = metered()
    meter.begin(start)
    assert meter.evaluations == 4 and meter.start_values.tolist() == (start**2).sum(axis=1).tolist()
    x, f = meter.first_population(3, rng)
    assert x.tolist() == start[[0, 1, 3]].tolist() and f.tolist() == (x**2).sum(axis=1).tolist()
    assert meter.evaluations == 4  # nothing is evaluated twice
    x, f = meter.first_population(6, rng)
    assert x[:4].tolist() == start.tolist() and f.tolist() == (x**2).sum(axis=1).tolist()
    assert meter.evaluations == 6
    np.testing.assert_allclose(meter.from_unit(meter.first_point(rng)), start[1], atol=1e-15)


def test_without_a_start_the_first_population_is_uniform_in_the_box():
    _, meter = metered()
    x, f = meter.first_population(5, np.random.default_rng(1))
    np.testing.assert_array_equal(x, meter.from_unit(np.random.default_rng(1).random((5, 2))))
    assert f.tolist() == (x**2).sum(axis=1).tolist()
    assert meter.first_point(np.random.default_rng(2)).tolist() == np.random.default_rng(2).random(2).tolist()


def test_a_part_has_no_start_and_no_target_of_its_own():
    _, meter = metered(evaluations=20, target=-1.0)
    meter.begin(np.zeros((2, 2)))
    part = meter.part(evaluations=5)
    assert part.start is None and not part.reached and part.minimum is None


class OnTheClock(Problem):
    """A problem in the plane whose evaluations take the fake clock a second each, and gradients three."""

    has_gradient = True

    def __init__(self, clock):
        self.lower, self.upper, self.clock = np.full(2, -1.0), np.full(2, 1.0), clock

    def evaluate(self, X):
        self.clock.now += len(X)
        return (X**2).sum(axis=1)

    def value_and_gradient(self, x):
        self.clock.now += 3.0
        return float(x @ x), 2 * x


def test_the_time_inside_the_problem_leaves_out_that_of_the_solver(monkeypatch):
    clock = Clock(monkeypatch)
    meter = MeteredProblem(OnTheClock(clock), Budget(evaluations=1000))
    assert math.isclose(meter.spending.inside_s(0, 0), 0.0)
    meter(np.zeros(2))
    assert math.isnan(meter.spending.inside_s(1, 0)), "one point is not timed"
    for size in (50, 7):
        clock.now += 100.0  # the solver's own work
        meter.evaluate(np.zeros((size, 2)))
    assert meter.spending.inside_s(58, 0) == 58.0, "the single point counts like those of the batches"
    for _ in range(64):
        clock.now += 100.0
        meter(np.zeros(2))
    meter.value_and_gradient(np.zeros(2))
    assert (meter.evaluations, meter.spending.timed) == (123, 4)
    assert meter.spending.inside_s(123, 1) == 122 + 3
    assert (meter.spending.batches, meter.spending.batched) == (2, 57)


def test_the_minimum_says_what_the_evaluations_took(monkeypatch):
    clock = Clock(monkeypatch)

    class Thinks(Solver):
        info = SolverInfo()

        def minimize(self, problem, rng):
            clock.now += 9.0
            problem.evaluate(rng.random((20, 2)))
            problem.part(evaluations=5).evaluate(rng.random((5, 2)))

    found = minimize(OnTheClock(clock), Thinks(), 100)
    assert (found.evaluation_s, found.runtime_s, found.batches, found.batched) == (25.0, 34.0, 2, 25)
