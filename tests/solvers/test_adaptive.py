"""JADE, SHADE, L-SHADE and jSO against loops over single numbers, written from the papers, fed the same draws."""

import math

import numpy as np
import pytest
from bench_problems import Formula, bowl, ramp
from numpy.testing import assert_allclose, assert_array_equal

from nfbench import Budget, MeteredProblem, OptionError, Status, minimize
from nfbench.solvers._adaptive import (
    Archive,
    Memory,
    Population,
    best_count,
    binomial,
    current_to_pbest,
    draw_crossover_rates,
    draw_factors,
    lehmer,
    lehmer_means,
    midpoint,
    planned_size,
    shares,
)
from nfbench.solvers.jade import JADE
from nfbench.solvers.jso import JSO
from nfbench.solvers.lshade import LSHADE
from nfbench.solvers.shade import SHADE

ALL = [JADE, SHADE, LSHADE, JSO]
BOTTOM = None  # the terminal value ⊥


def rates(mean, rng):
    """Normal(mean, 0.1), clipped to [0, 1]; 0 for ⊥."""
    z = rng.standard_normal(len(mean))
    return [0.0 if m is BOTTOM else min(max(m + 0.1 * z[i], 0.0), 1.0) for i, m in enumerate(mean)]


def factors(mean, rng):
    """Cauchy(mean, 0.1); those not above 0 are redrawn together, and those above 1 are set to 1."""
    F = [m + 0.1 * z for m, z in zip(mean, rng.standard_cauchy(len(mean)), strict=True)]
    while low := [i for i, Fi in enumerate(F) if Fi <= 0]:
        for i, z in zip(low, rng.standard_cauchy(len(low)), strict=True):
            F[i] = mean[i] + 0.1 * z
    return [min(Fi, 1.0) for Fi in F]


def trials(x, pbest, F, Fw, CR, archive, lower, upper, rng):
    N, n = len(x), len(lower)
    first, second = rng.integers(N - 1, size=N), rng.integers(N + len(archive) - 2, size=N)
    rand, j_rand = rng.random((N, n)), rng.integers(n, size=N)
    result = []
    for i in range(N):
        r1 = [r for r in range(N) if r != i][first[i]]
        r2 = [r for r in range(N + len(archive)) if r not in (i, r1)][second[i]]
        xr2 = x[r2] if r2 < N else archive[r2 - N]
        u = list(x[i])
        for j in range(n):
            if rand[i, j] <= CR[i] or j == j_rand[i]:
                v = x[i][j] + Fw[i] * (x[pbest[i]][j] - x[i][j]) + F[i] * (x[r1][j] - xr2[j])
                u[j] = (x[i][j] + lower[j]) / 2 if v < lower[j] else (x[i][j] + upper[j]) / 2 if v > upper[j] else v
        result.append(u)
    return result


def half_up(value):
    return math.floor(value + 0.5)


def plain(kind, f, lower, upper, N, max_nfe, rng):
    """All four, distinguished where their papers differ; returns every point evaluated."""
    n, locks, kind = len(lower), "overwritten" not in kind, kind.partition(",")[0]
    unit = rng.random((N, n))
    x = [[lower[j] + unit[i, j] * (upper[j] - lower[j]) for j in range(n)] for i in range(N)]
    values, seen, archive = [f(xi) for xi in x], [list(xi) for xi in x], []
    N_init, H = N, {"jade": 1, "shade": 100, "l-shade": 6, "jso": 5}[kind]
    M_F, M_CR = ([0.3] * H, [0.8] * H) if kind == "jso" else ([0.5] * H, [0.5] * H)
    k, rate = 0, {"jade": 1, "shade": 1, "l-shade": 2.6, "jso": 1}[kind]
    while len(seen) < max_nfe:
        spent = len(seen) / max_nfe
        memory = [0] * N if kind == "jade" else list(rng.integers(H, size=N))
        fixed = [kind == "jso" and r == H - 1 for r in memory]
        CR = rates([0.9 if last else M_CR[r] for last, r in zip(fixed, memory, strict=True)], rng)
        F = factors([0.9 if last else M_F[r] for last, r in zip(fixed, memory, strict=True)], rng)
        ranked = sorted(range(N), key=lambda i: values[i])
        if kind == "shade":
            best = [max(half_up(p * N), 2) for p in rng.uniform(min(2 / N, 0.2), 0.2, size=N)]
            pbest = [ranked[r] for r in rng.integers(best)]
        else:
            p = {"jade": 0.05, "l-shade": 0.11, "jso": 0.25 - 0.125 * spent}[kind]
            best = max(half_up(p * N), 2)
            pbest = [ranked[r] for r in rng.integers(best, size=N)]
        Fw = F
        if kind == "jso":
            if spent < 0.5:
                while same := [i for i in range(N) if pbest[i] == i]:
                    for i, r in zip(same, rng.integers(best, size=len(same)), strict=True):
                        pbest[i] = ranked[r]
                CR = [max(c, 0.7 if spent < 0.25 else 0.6) for c in CR]
            if spent < 0.6:
                F = [min(Fi, 0.7) for Fi in F]
            Fw = [(0.7 if spent < 0.2 else 0.8 if spent < 0.4 else 1.2) * Fi for Fi in F]
        u = trials(x, pbest, F, Fw, CR, archive, lower, upper, rng)
        fu = [f(ui) for ui in u]
        seen += u
        won = [i for i in range(N) if fu[i] < values[i]]
        if won:
            gain = [values[i] - fu[i] for i in won]
            w = [1 / len(won) if kind == "jade" else g / sum(gain) for g in gain]
            mean = sum(wi * CR[i] for wi, i in zip(w, won, strict=True))
            squares = sum(wi * CR[i] ** 2 for wi, i in zip(w, won, strict=True))
            mean_F = sum(wi * F[i] ** 2 for wi, i in zip(w, won, strict=True)) / sum(
                wi * F[i] for wi, i in zip(w, won, strict=True)
            )
            if kind == "jade":
                M_CR[0], M_F[0] = 0.9 * M_CR[0] + 0.1 * mean, 0.9 * M_F[0] + 0.1 * mean_F
            elif kind == "shade":
                M_CR[k], M_F[k] = mean, mean_F
            else:
                if (M_CR[k] is BOTTOM and locks) or max(CR[i] for i in won) == 0:
                    M_CR[k] = BOTTOM
                else:
                    M_CR[k] = squares / mean if kind == "l-shade" else (squares / mean + M_CR[k]) / 2
                M_F[k] = mean_F if kind == "l-shade" else (mean_F + M_F[k]) / 2
            k = (k + 1) % H
        size = round(rate * N)
        if kind == "jade":
            archive += [list(x[i]) for i in won]
            archive = [archive[a] for a in rng.permutation(len(archive))[:size]] if len(archive) > size else archive
            won = []
        late = [x[i] for i in won][size - len(archive) :] if len(archive) + len(won) > size else []
        archive += [list(x[i]) for i in won][: size - len(archive)]
        for place, parent in zip(rng.integers(size, size=len(late)), late, strict=True):
            archive[place] = list(parent)
        for i in range(N):
            if fu[i] < values[i] or (fu[i] == values[i] and kind != "jade"):
                x[i], values[i] = u[i], fu[i]
        if kind in ("l-shade", "jso"):
            plan = half_up((4 - N_init) * min(len(seen) / max_nfe, 1) + N_init)
            while len(x) > plan:
                worst = max(range(len(x)), key=lambda i: (values[i], i))
                del x[worst], values[worst]
            N = len(x)
            size = round(rate * N)
            if len(archive) > size:
                archive = [archive[a] for a in rng.permutation(len(archive))[:size]]
    return np.array(seen)


def rugged(X):
    return (X**2).sum(axis=1) + np.cos(7 * X[:, 0]) * X[:, -1]


CASES = {
    "jade": (JADE(), 30, 5, 2900),
    "shade": (SHADE(), 100, 5, 2900),
    "l-shade": (LSHADE(), 54, 5, 2900),
    "l-shade, with ⊥ kept": (LSHADE(population=8), 8, 6, 900),
    "l-shade, with ⊥ overwritten": (LSHADE(population=8, terminal="overwritten"), 8, 6, 900),
    "jso": (JSO(), 48, 5, 2900),
}


@pytest.mark.parametrize("kind", CASES)
def test_evaluates_the_same_points_as_a_plain_loop(kind):
    """3,000 evaluations: the archive overflows, the population shrinks to four, and jSO passes all its phases."""
    lower, upper = np.array([-2.0, -1.0, 0.1]), np.array([1.0, 0.5, 3.3])
    problem = Formula(rugged, lower, upper)
    solver, N, seed, alike = CASES[kind]
    budget = 3000
    minimize(problem, solver, budget, seed)
    rng = np.random.default_rng(seed)
    seen = plain(kind, lambda x: float(rugged(np.array([x]))[0]), lower, upper, N, budget, rng)[:budget]
    assert len(problem.points) == budget
    # sums in another order differ in the last digit, which decides between values that have become equal
    assert_allclose(problem.points[:alike], seen[:alike], rtol=0, atol=1e-9)


def test_both_rules_for_the_terminal_value_are_met_here():
    """Otherwise the loop above would not distinguish them."""
    lower, upper = np.array([-2.0, -1.0, 0.1]), np.array([1.0, 0.5, 3.3])
    seen = []
    for rule in ("kept", "overwritten"):
        problem = Formula(rugged, lower, upper)
        solver, _, seed, alike = CASES[f"l-shade, with ⊥ {rule}"]
        minimize(problem, solver, 3000, seed)
        seen.append(problem.points)
    assert 100 < (seen[0] != seen[1]).any(axis=1).argmax() < alike - 500


def test_the_terminal_value_makes_cr_zero():
    CR = draw_crossover_rates(np.repeat([np.nan, 0.5], 1000), np.random.default_rng(0))
    assert (CR[:1000] == 0).all()
    assert_allclose(CR[1000:].mean(), 0.5, atol=0.02)


def test_rates_are_repaired_as_the_papers_say():
    rng = np.random.default_rng(0)
    F = draw_factors(np.full(100_000, 0.1), rng)
    assert F.min() > 0 and F.max() == 1
    # Cauchy(0.1, 0.1) given F > 0: P(F < 0.1) = (1/2 − 1/4)/(3/4), P(F ≥ 1) = (1/2 − arctan(9)/π)/(3/4)
    assert_allclose((F < 0.1).mean(), 1 / 3, atol=0.01)
    assert_allclose((F == 1).mean(), (0.5 - math.atan(9) / math.pi) / 0.75, atol=0.003)
    CR = draw_crossover_rates(np.full(100_000, 0.0), rng)
    assert_allclose((CR == 0).mean(), 0.5, atol=0.01)
    assert_allclose(CR.mean(), 0.1 / math.sqrt(2 * math.pi), atol=0.001)


def test_partners_are_others_and_equally_likely():
    """Of 4 individuals and 2 archived, read off from a mutation without its first term."""
    x, archive = np.diag([1.0, 10.0, 100.0, 1000.0]), np.zeros((2, 4))
    archive[0, 0], archive[1, 1] = 0.5, 0.25
    pairs = {}
    rng = np.random.default_rng(0)
    rounds = 20_000
    for _ in range(rounds):
        v = current_to_pbest(x, np.arange(4), np.ones(4), archive, rng) - x
        key = tuple(v[2])
        pairs[key] = pairs.get(key, 0) + 1
    union = np.vstack([x, archive])
    allowed = {tuple(x[a] - union[b]) for a in (0, 1, 3) for b in range(6) if b not in (2, a)}
    assert set(pairs) == allowed and len(allowed) == 12
    assert max(abs(count - rounds / 12) for count in pairs.values()) < 5 * math.sqrt(rounds / 12)


def test_the_archive_keeps_the_newest_and_a_random_rest():
    rng = np.random.default_rng(0)
    archive = Archive(4, 1)
    archive.add(np.array([[1.0], [2.0], [3.0]]), rng)
    assert archive.members.ravel().tolist() == [1, 2, 3]
    archive.add(np.array([[4.0], [5.0]]), rng)
    assert len(archive.members) == 4 and 5 in archive.members
    archive.resize(2, rng)
    assert len(archive.members) == archive.size == 2
    none = Archive(0, 1)
    none.add(np.array([[1.0]]), rng)
    assert len(none.members) == 0


def test_means_and_weights():
    assert lehmer(np.array([0.2, 0.8]), np.array([0.5, 0.5])) == pytest.approx(0.68)
    assert_allclose(shares(np.array([1.0, 3.0])), [0.25, 0.75])
    assert_array_equal(shares(np.array([1.0, np.inf, np.inf])), [0, 0.5, 0.5])
    assert_allclose(shares(np.array([1e308, 1e308])), [0.5, 0.5])


def test_the_terminal_value_is_the_mean_of_rates_that_are_all_zero():
    F, gain = np.array([0.2, 0.8]), np.array([1.0, 1.0])
    assert lehmer_means(F, np.array([0.0, 0.5]), gain) == pytest.approx((0.68, 0.5))
    mean_F, mean_CR = lehmer_means(F, np.zeros(2), gain)
    assert mean_F == pytest.approx(0.68) and math.isnan(mean_CR)


def test_the_memory_is_overwritten_in_turn():
    M = Memory(3, F=0.5, CR=0.8)
    for number in range(4):
        M.overwrite(F=number / 10, CR=1 - number / 10)
    assert_allclose(M.F, [0.3, 0.1, 0.2])
    assert_allclose(M.CR, [0.7, 0.9, 0.8])
    assert M.k == 1


def test_midpoint_repair_and_binomial_crossover_agree_with_plain_loops():
    problem, N, n = ramp(3), 40, 3
    lower, upper = problem.lower, problem.upper
    rng = np.random.default_rng(0)
    x, v, CR = rng.uniform(-1, 2, (N, n)), rng.uniform(-4, 5, (N, n)), rng.random(N)
    rand, j_rand = (same := np.random.default_rng(1)).random((N, n)), same.integers(n, size=N)
    repaired = [
        [
            (x[i, j] + lower[j]) / 2
            if v[i, j] < lower[j]
            else (x[i, j] + upper[j]) / 2
            if v[i, j] > upper[j]
            else v[i, j]
            for j in range(n)
        ]
        for i in range(N)
    ]
    assert_array_equal(midpoint(v, x, problem), repaired)
    for rates in (CR, 0.0, 0.4, 1.0):
        limits = np.broadcast_to(rates, N)
        crossed = [
            [v[i, j] if rand[i, j] <= limits[i] or j == j_rand[i] else x[i, j] for j in range(n)] for i in range(N)
        ]
        assert_array_equal(binomial(x, v, rates, np.random.default_rng(1)), crossed)


def test_a_generation_returns_what_succeeded_and_archives_the_parents_it_replaces():
    meter = MeteredProblem(bowl(2), Budget(evaluations=1000))
    rng = np.random.default_rng(0)
    P = Population(20, 2.0, meter, rng)
    before, f = P.x.copy(), P.f.copy()
    F, CR = np.linspace(0.3, 0.7, 20), np.linspace(0.1, 0.9, 20)
    S_F, S_CR, gain = P.evolve(P.ranking()[:1].repeat(20), F, CR)
    better = P.f < f
    assert 0 < better.sum() < 20
    assert_array_equal(S_F, F[better])
    assert_array_equal(S_CR, CR[better])
    assert_array_equal(gain, f[better] - P.f[better])
    assert_array_equal(P.A.members, before[better])
    assert_array_equal(P.x[~better], before[~better])
    assert meter.population is P.x and meter.population_values is P.f


def test_trial_vectors_of_equal_value_replace_their_parents_but_do_not_succeed():
    flat = Formula(lambda X: np.zeros(len(X)), [0.0, 0.0], [1.0, 1.0])
    P = Population(10, 1.0, MeteredProblem(flat, Budget(evaluations=1000)), np.random.default_rng(0))
    before = P.x.copy()
    successes = P.evolve(np.arange(10), np.full(10, 0.5), np.ones(10))
    assert [len(part) for part in (*successes, P.A.members)] == [0, 0, 0, 0]
    assert (P.x != before).all()


def test_a_shrinking_population_keeps_its_best_in_order():
    meter = MeteredProblem(bowl(2), Budget(evaluations=1000))
    P = Population(20, 1.5, meter, np.random.default_rng(0))
    for _ in range(20):
        P.evolve(P.ranking(), np.full(20, 0.5), np.full(20, 0.9))
    x, f = P.x.copy(), P.f.copy()
    assert len(P.A.members) == P.A.size == 30
    P.shrink(7)
    kept = [i for i in range(20) if sorted(f).index(f[i]) < 7]
    assert len(P) == 7 and len(P.A.members) == P.A.size == 10
    assert_array_equal(P.x, x[kept])
    assert_array_equal(P.f, f[kept])
    assert meter.population is P.x and meter.population_values is P.f


def test_population_sizes_are_the_papers():
    def batches(solver, n, budget):
        problem = bowl(n)
        minimize(problem, solver, budget)
        return [len(batch) for batch in problem.batches]

    assert [batches(JADE(), n, 500)[0] for n in (2, 10, 30, 31)] == [30, 30, 100, 400]
    assert batches(SHADE(), 6, 500)[0] == 100
    assert [batches(LSHADE(), n, 3000)[0] for n in (1, 2, 6)] == [18, 36, 108]
    assert [batches(JSO(), n, 3000)[0] for n in (2, 6, 10, 30)] == [25, 110, 182, 466]  # 25·ln n·√n
    shrinking = batches(LSHADE(), 2, 3000)
    assert shrinking == sorted(shrinking[:-1], reverse=True) + shrinking[-1:]
    assert planned_size(36, 4, 0.0) == 36 and planned_size(36, 4, 1.0) == 4 and planned_size(36, 4, 0.5) == 20
    assert (best_count(0.05, 30), best_count(0.05, 100), best_count(0.11, 108)) == (2, 5, 12)


def test_the_share_of_the_budget_spent_needs_a_budget_in_evaluations():
    for cls in (LSHADE, JSO):
        minimum = minimize(bowl(2), cls(), Budget(seconds=1.0))
        assert minimum.status is Status.SKIPPED
        assert minimum.message.startswith(f"{cls.__name__} needs a limit on evaluations")
        assert not cls(evaluations=500).info.needs_evaluations
        problem = bowl(2)
        assert minimize(problem, cls(evaluations=500), 1000).evaluations == 1000
        assert {len(batch) for batch in problem.batches[-50:-1]} == {4}


def test_jade_without_archive_is_another():
    runs = [bowl(3), bowl(3)]
    for problem, archive in zip(runs, (True, False), strict=True):
        minimize(problem, JADE(archive=archive), 600)
    assert_array_equal(runs[0].points[:60], runs[1].points[:60])
    assert not np.array_equal(runs[0].points, runs[1].points)


def test_jade_keeps_a_parent_of_equal_value_and_its_descendants_do_not():
    for cls in ALL:
        flat = Formula(lambda X: np.zeros(len(X)), [0.0, 0.0], [1.0, 1.0])
        minimum = minimize(flat, cls(population=10), 50)
        kept = np.isin(minimum.population, flat.batches[0]).all()
        assert kept == (cls is JADE)


@pytest.mark.parametrize("cls", ALL)
def test_the_last_population_is_handed_over_best_first(cls):
    problem = bowl(2)
    minimum = minimize(problem, cls(), 2000)
    assert_array_equal(minimum.population_values, problem.formula(minimum.population))
    assert (np.diff(minimum.population_values) >= 0).all()
    assert minimum.population_values[0] <= 1.1 * minimum.value + 1e-12


@pytest.mark.parametrize(
    ("cls", "options", "message"),
    [
        (JADE, {"p": 0.0}, "p: expected greater than 0, got 0.0"),
        (SHADE, {"memory": 0}, "memory: expected greater than or equal to 1, got 0"),
        (LSHADE, {"archive_rate": -1.0}, "archive_rate: expected greater than or equal to 0, got -1.0"),
        (JSO, {"memory": 1}, "memory: expected greater than or equal to 2, got 1"),
    ],
)
def test_impossible_options_are_named(cls, options, message):
    with pytest.raises(OptionError) as caught:
        cls(**options)
    assert message in str(caught.value)
