"""`portfolio` and `restarts`: the slices and generators of the nested solvers, compared with plain functions."""

import numpy as np
import pytest

import nfbench
from nfbench import Budget, BudgetExhausted, InvalidEvaluation, ManifestError, MeteredProblem, OptionError, Status
from nfbench.core.options import canonical
from nfbench.plugins.groups import members
from nfbench.plugins.registry import Registry
from nfbench.study.manifest import load_study
from nfbench.testing import Probe

DE = {"kind": "de", "population": 10}
SHORT_DE = {"kind": "de", "population": 10, "generations": 3}  # 30 evaluations
RANDOM = {"kind": "random-search", "batch": 7}


class Recorded(Probe):
    """A probe that records every evaluated point."""

    def __init__(self, n=3, **more):
        super().__init__(-np.ones(n), np.linspace(1.0, 2.0, n), **more)
        self.points = []

    def evaluate(self, X):
        self.points += [x.copy() for x in X]
        return super().evaluate(X)


def made(table):
    return nfbench.solver(table["kind"], **{name: value for name, value in table.items() if name != "kind"})


def alone(slices, seed):
    """Return the points of solvers that run one after another, each with its own budget and child generator."""
    rng, problem = np.random.default_rng(seed), Recorded()
    for table, evaluations in slices:
        nfbench.minimize(problem, made(table), evaluations, rng.spawn(1)[0])
    return np.array(problem.points)


@pytest.mark.parametrize(
    ("solvers", "weights", "slices"),
    [
        ([DE, RANDOM], None, [(DE, 100), (RANDOM, 100)]),
        ([DE, RANDOM], [1.0, 3.0], [(DE, 50), (RANDOM, 150)]),
        ([SHORT_DE, DE, RANDOM], None, [(SHORT_DE, 30), (DE, 85), (RANDOM, 85)]),  # 37 of the first slice's 67 are left
        ([RANDOM, SHORT_DE, DE, SHORT_DE], [2.0, 1.0, 1.0, 1.0], None),
        ([SHORT_DE, SHORT_DE], None, [(SHORT_DE, 30), (SHORT_DE, 30)]),  # both solvers end early
    ],
)
def test_a_portfolio_runs_its_solvers_on_slices(solvers, weights, slices):
    if slices is None:  # 80 of 200; 30 of 40; 45 of 90; 30 of 45; the two stopped solvers share the last 15 as 2 : 1
        slices = [(RANDOM, 80), (SHORT_DE, 30), (DE, 45), (SHORT_DE, 30), (RANDOM, 10), (DE, 5)]
    problem = Recorded()
    found = nfbench.minimize(problem, nfbench.solver("portfolio", solvers=solvers, weights=weights), 200, seed=3)
    expected = alone(slices, seed=3)
    assert np.array_equal(np.array(problem.points), expected)
    assert found.status is Status.OK and found.evaluations == len(expected) == sum(spent for _, spent in slices)
    values = Recorded().evaluate(expected)
    assert found.value == values.min() and np.array_equal(found.x, expected[values.argmin()])
    best_so_far = np.minimum.accumulate(values)
    assert np.array_equal(found.trace.values, best_so_far[found.trace.evaluations - 1])
    assert set(np.flatnonzero(np.diff(best_so_far)) + 2) <= set(found.trace.evaluations)


@pytest.mark.parametrize(
    ("solver", "evaluations", "starts"),
    [(SHORT_DE, None, [30] * 6 + [20]), (DE, 64, [64, 64, 64, 8]), (SHORT_DE, 25, [25] * 8)],
)
def test_restarts_use_independent_generators_and_budgets(solver, evaluations, starts):
    problem = Recorded()
    restarts = nfbench.solver("restarts", solver=solver, evaluations=evaluations)
    found = nfbench.minimize(problem, restarts, 200, seed=5)
    assert np.array_equal(np.array(problem.points), alone([(solver, spent) for spent in starts], seed=5))
    assert found.evaluations == 200
    if starts[-1] >= 10:  # the last start has a population
        assert np.isin(found.population, np.array(problem.points)[-starts[-1] :]).all()


def test_composed_solvers_can_be_nested():
    inner = {"kind": "restarts", "solver": SHORT_DE}
    problem = Recorded()
    nfbench.minimize(problem, nfbench.solver("portfolio", solvers=[inner, RANDOM]), 100, seed=1)
    first = np.random.default_rng(1).spawn(1)[0]
    expected = Recorded()
    for spent in (30, 20):
        nfbench.minimize(expected, made(SHORT_DE), spent, first.spawn(1)[0])
    assert np.array_equal(np.array(problem.points[:50]), np.array(expected.points))


def test_the_target_ends_all_slices():
    problem = Recorded()
    budget = Budget(evaluations=5000, target=0.05)
    found = nfbench.minimize(problem, nfbench.solver("portfolio", solvers=[DE, RANDOM]), budget, seed=1)
    assert found.value <= 0.05 and found.evaluations < 2500  # within the first slice


def test_a_part_has_its_share_of_the_remaining_evaluations():
    meter = MeteredProblem(Recorded(), Budget(evaluations=100, seconds=1000.0))
    meter.evaluate(np.zeros((20, 3)))
    part = meter.part(0.25)
    assert part.remaining == 20 and meter.part(evaluations=7).remaining == 7 and meter.part(1e-9).remaining == 1
    with pytest.raises(BudgetExhausted):
        part.evaluate(np.zeros((21, 3)))
    assert part.spent and part.remaining == 0 and not meter.spent and meter.remaining == 60
    meter.part().evaluate(np.zeros((60, 3)))
    with pytest.raises(BudgetExhausted):
        meter.part()


def test_a_part_has_its_share_of_the_remaining_seconds():
    meter = MeteredProblem(Recorded(), Budget(seconds=600.0))
    part = meter.part(1e-5)
    with pytest.raises(BudgetExhausted):
        while True:
            part(np.zeros(3))
    assert part.spent and not meter.spent


def test_a_fault_in_a_part_is_a_fault_of_the_whole_run():
    meter = MeteredProblem(Recorded(), Budget(evaluations=9))
    with pytest.raises(InvalidEvaluation):
        meter.part(0.5)(np.full(3, 7.0))
    assert "got 7.0" in meter.fault


def test_info_is_combined_from_the_nested_solvers():
    gradient = nfbench.solver("portfolio", solvers=[{"kind": "nlopt-mlsl-lbfgs"}, {"kind": "scipy-direct"}])
    assert gradient.info.needs_gradient
    assert nfbench.minimize(Recorded(), gradient, 50).status is Status.SKIPPED
    assert nfbench.minimize(Recorded(gradient=True), gradient, 500).status is Status.OK
    direct = nfbench.solver("portfolio", solvers=[{"kind": "scipy-direct"}])
    assert not (direct.info.stochastic or direct.info.needs_gradient)
    assert nfbench.solver("portfolio").info.stochastic


def test_no_group_contains_portfolio_or_restarts():
    tables, _ = members(Registry(), {"group": "all"})
    names = {table["kind"] for table in tables.values()}
    assert not {"portfolio", "restarts"} & set(names) and "de" in names


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ('kind = "portfolio"\nsolvers = [{ kind = "de" }, { kind = "cmase" }]', "[0].solvers[1].kind: unknown solver"),
        ('kind = "portfolio"\nsolvers = [{ kind = "cmase" }]', 'did you mean "cmaes"?'),
        (
            'kind = "portfolio"\nsolvers = [{ kind = "de", popluation = 9 }]',
            "[0].solvers[0].popluation: unknown option",
        ),
        ('kind = "portfolio"\nsolvers = [{ population = 9 }]', "[0].solvers[0].kind: is required; known: "),
        ('kind = "portfolio"\nsolvers = []', "[0].solvers: expected one or more solvers"),
        ('kind = "portfolio"\nweights = [1.0]', "[0].weights: expected 2 numbers"),
        ('kind = "restarts"\nsolver = "de"', "[0].solver: expected a table with the kind of a solver, got 'de'"),
        ('kind = "restarts"\nsolver = { kind = "de", population = 3 }', "[0].solver.population: expected"),
        ('kind = "restarts"\nsolver = { kind = "scipy-direct" }', "[0].solver.kind: expected a stochastic solver"),
        (
            'kind = "restarts"\nsolver = { kind = "portfolio", solvers = [{ kind = "de", F = 3.0 }] }',
            "[0].solver.solvers[0].F: expected",
        ),
    ],
)
def test_errors_in_nested_tables_are_reported_with_their_path(manifest, table, message):
    path = manifest(f'[[formulation]]\nkind = "once"\n[budget]\nevaluations = 9\n[[solver]]\n{table}\n')
    with pytest.raises(ManifestError) as raised:
        load_study(path)
    assert any(f"solver{message}" in text or message in text for text in raised.value.problems)


def test_a_study_runs_nested_plugins_and_records_their_version(manifest, tmp_path):
    file = tmp_path / "mine.py"
    source = (
        "from dataclasses import dataclass\nfrom nfbench import Solver\n"
        "@dataclass(frozen=True)\nclass Mine(Solver):\n"
        "    def minimize(self, problem, rng):\n        problem.evaluate(problem.from_unit(rng.random((5, 2))))\n"
    )
    text = """
        [[formulation]]
        kind = "once"
        [[solver]]
        kind = "restarts"
        solver = { kind = "mine" }
        [[solver]]
        kind = "portfolio"
        solvers = [{ kind = "sampler" }, { kind = "mine" }]
        [budget]
        evaluations = 40
    """
    ids = []
    for revision in ("# 1\n", "# 2\n"):
        file.write_text(source + revision)
        study = load_study(manifest(text, plugins=[file]))
        ids.append([spec.run_id for spec in study.specs()])
        results = nfbench.run(study, out=tmp_path / revision[2], jobs=0)
        assert set(results.runs["status"]) == {"ok"} and set(results.runs["evaluations"]) == {40}
    assert not set(ids[0]) & set(ids[1])  # a new version of a nested plugin gives new run ids


def test_options_survive_a_round_trip():
    solver = nfbench.solver("portfolio", solvers=[DE, {"kind": "restarts", "solver": SHORT_DE}], weights=[1.0, 2.0])
    plain = canonical(solver)
    assert plain["solvers"][1]["solver"]["generations"] == 3 and plain["solvers"][0]["kind"] == "de"
    assert nfbench.solver("portfolio", **plain) == solver
    with pytest.raises(OptionError, match="unknown solver"):
        nfbench.solver("restarts", solver={"kind": "dee"})
