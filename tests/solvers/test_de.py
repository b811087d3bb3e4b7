"""DE against a loop over single numbers that is fed the same draws, and each of its steps by itself."""

import typing

import numpy as np
import pytest
from bench_problems import Formula, bowl, ramp
from numpy.testing import assert_allclose, assert_array_equal

from nfbench import Budget, OptionError, minimize
from nfbench.solvers.de import DE, binomial, choose, exponential, mutate, repair

BLOCK = 16
RULES = ["clip", "midpoint", "reflect", "resample"]
STRATEGIES = typing.get_args(typing.get_type_hints(DE)["strategy"])


def mirrored(v, low, high):
    while not low <= v <= high:
        v = 2 * low - v if v < low else 2 * high - v
    return v


def folded(v, low, high):
    """The same by one remainder, as DE computes it, so that it also rounds the same."""
    t = (v - low) % (2.0 * (high - low))
    return min(max(low + min(t, 2.0 * (high - low) - t), low), high)


def deal(i, N, draws):
    """The individuals dealt to i, one for each draw, as DE documents it."""
    deck = [(i + step) % N for step in range(1, N)]
    return [deck.pop(int(draw * len(deck))) for draw in draws]


def mutant(name, j, x, i, best, r, F):
    """One coordinate, each strategy's formula as its literature prints it; r_1 is r[0]."""
    if name == "rand/1":
        return x[r[0]][j] + F * (x[r[1]][j] - x[r[2]][j])
    if name == "best/1":
        return x[best][j] + F * (x[r[0]][j] - x[r[1]][j])
    if name == "rand/2":
        return x[r[0]][j] + F * (x[r[1]][j] - x[r[2]][j]) + F * (x[r[3]][j] - x[r[4]][j])
    if name == "best/2":
        return x[best][j] + F * (x[r[0]][j] - x[r[1]][j]) + F * (x[r[2]][j] - x[r[3]][j])
    if name == "current-to-best/1":
        return x[i][j] + F * (x[best][j] - x[i][j]) + F * (x[r[0]][j] - x[r[1]][j])
    assert name == "rand-to-best/1"
    return x[r[0]][j] + F * (x[best][j] - x[r[0]][j]) + F * (x[r[1]][j] - x[r[2]][j])


VECTORS = {"rand/1": 3, "best/1": 2, "rand/2": 5, "best/2": 4, "current-to-best/1": 2, "rand-to-best/1": 3}


def taken(crossover, j_rand, rand, CR):
    """The coordinates that come from the mutant."""
    n = len(rand)
    if crossover == "bin":
        return {j for j in range(n) if rand[j] <= CR or j == j_rand}
    coordinates, j = set(), j_rand
    while True:  # Storn & Price 1997: do ... while (rand <= CR and L < n)
        coordinates.add(j)
        j = (j + 1) % n
        if len(coordinates) == n or rand[j] > CR:
            return coordinates


def plain_de(f, lower, upper, N, F, CR, rule, generations, rng, strategy="rand/1/bin", reflect=mirrored):
    """Differential evolution, one number at a time, on the random arrays that DE documents."""
    name, _, crossover = strategy.rpartition("/")
    R, n = VECTORS[name], len(lower)
    unit = rng.random((N, n))
    x = [[lower[j] + unit[i, j] * (upper[j] - lower[j]) for j in range(n)] for i in range(N)]
    seen = [list(xi) for xi in x]
    values = [f(xi) for xi in x]
    for g in range(generations - 1):
        if g % BLOCK == 0:
            draws = rng.random((BLOCK, N, R + 1 + (2 * n if rule == "resample" else n)))
        b, best = g % BLOCK, values.index(min(values))
        trials = []
        for i in range(N):
            r = deal(i, N, draws[b, i, :R])
            assert len({i, *r}) == R + 1
            u = list(x[i])
            for j in taken(crossover, int(draws[b, i, R] * n), draws[b, i, R + 1 : R + 1 + n], CR):
                v = mutant(name, j, x, i, best, r, F)
                if not lower[j] <= v <= upper[j]:
                    bound = lower[j] if v < lower[j] else upper[j]
                    if rule == "clip":
                        v = bound
                    elif rule == "midpoint":
                        v = (x[i][j] + bound) / 2
                    elif rule == "reflect":
                        v = reflect(v, lower[j], upper[j])
                    else:
                        v = lower[j] + draws[b, i, R + 1 + n + j] * (upper[j] - lower[j])
                u[j] = v
            trials.append(u)
        for i, u in enumerate(trials):
            fu = f(u)
            if fu <= values[i]:
                x[i], values[i] = u, fu
        seen += trials
    return np.array(seen), np.array(values)


def rugged(X):
    return (X**2).sum(axis=1) + np.cos(7 * X[:, 0]) * X[:, -1]


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize(
    ("N", "n", "F", "CR"), [(4, 1, 0.5, 0.8), (11, 3, 0.5, 0.8), (20, 2, 2.0, 1.0), (7, 5, 1.3, 0.0)]
)
def test_evaluates_the_same_points_as_a_plain_loop(rule, N, n, F, CR):
    lower, upper = np.linspace(-2.0, 0.3, n), np.linspace(1.0, 3.3, n)
    problem = Formula(rugged, lower, upper)
    minimum = minimize(problem, DE(population=N, F=F, CR=CR, bounds=rule, generations=40), N * 100, 5)
    seen, values = plain_de(
        lambda x: float(rugged(np.array([x]))[0]), lower, upper, N, F, CR, rule, 40, np.random.default_rng(5)
    )
    assert len(problem.points) == 40 * N
    if rule == "reflect":  # mirrored step by step and by one remainder: rounded differently, and F = 2 doubles errors
        assert_allclose(problem.points, seen, rtol=0, atol=1e-10)
        assert_allclose(minimum.value, values.min(), rtol=0, atol=1e-10)
    else:
        assert_array_equal(problem.points, seen)
        assert minimum.value == values.min()


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("strategy", STRATEGIES)
def test_every_strategy_and_rule_agrees_with_a_plain_loop_to_the_last_bit(strategy, rule):
    least = max(4, VECTORS[strategy.rpartition("/")[0]] + 1)
    for N, n, F, CR in [(least, 1, 1.3, 0.5), (least + 3, 5, 0.9, 0.6), (20, 2, 0.5, 0.9), (12, 10, 2.0, 0.3)]:
        lower, upper = np.linspace(-2.0, 0.3, n), np.linspace(1.0, 3.3, n)
        problem = Formula(rugged, lower, upper)
        solver = DE(population=N, strategy=strategy, F=F, CR=CR, bounds=rule, generations=40)
        minimum = minimize(problem, solver, N * 100, 5)
        f = lambda x: float(rugged(np.array([x]))[0])  # noqa: E731
        rng = np.random.default_rng(5)
        seen, values = plain_de(f, lower, upper, N, F, CR, rule, 40, rng, strategy, folded)
        assert_array_equal(problem.points, seen)
        assert_array_equal(minimum.population_values, np.sort(values))


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_every_strategy_converges_in_one_valley(strategy):
    assert minimize(bowl(3), DE(strategy=strategy), 15_000).value < 1e-6


def test_the_plain_loop_leaves_the_box_often_enough_to_test_the_rules():
    lower, upper = np.full(3, -1.0), np.full(3, 1.0)
    runs = {
        rule: plain_de(lambda x: -sum(x), lower, upper, 11, 0.5, 0.8, rule, 40, np.random.default_rng(5))[0]
        for rule in RULES
    }
    for rule in RULES[1:]:
        assert np.abs(runs[rule] - runs["clip"]).max() > 0.1


def chosen(draws, R, best=0):
    """What choose makes of these draws."""
    parents = np.empty((len(draws), R + 2), int)
    choose(draws, best, parents)
    return parents


def test_parents_are_distinct_and_every_choice_is_equally_likely():
    counts = np.zeros((5, 5, 5, 5))
    rounds = 20_000
    for draws in np.random.default_rng(0).random((rounds, 5, 4)):
        for i, (r1, r2, r3, *_) in enumerate(chosen(draws, 3)):
            counts[i, r1, r2, r3] += 1
    allowed = [(i, a, b, c) for i, a, b, c in np.ndindex(5, 5, 5, 5) if len({i, a, b, c}) == 4]
    observed = np.array([counts[key] for key in allowed])
    assert observed.sum() == 5 * rounds == counts.sum()
    assert_allclose(observed, rounds / 24, atol=5 * np.sqrt(rounds / 24))


@pytest.mark.parametrize("R", [2, 3, 4, 5])
@pytest.mark.parametrize("more", [1, 2, 20])
def test_parents_are_dealt_like_cards_and_the_best_and_the_target_follow(R, more):
    N = R + more
    for draws in np.random.default_rng(0).random((200, N, R + 4)):
        assert chosen(draws, R, best=1).tolist() == [[*deal(i, N, draws[i, :R]), 1, i] for i in range(N)]


def test_every_choice_of_parents_comes_from_one_interval_of_draws():
    """All 7·6·5·4·3·2 choices of five parents among seven individuals, from the middle of each interval."""
    N, R = 7, 5
    draws = np.zeros((N, R + 2))
    found = [set() for _ in range(N)]
    for cards in np.ndindex(6, 5, 4, 3, 2):
        draws[:, :R] = (np.array(cards) + 0.5) / [6, 5, 4, 3, 2]
        for i, parents in enumerate(chosen(draws, R)[:, :R].tolist()):
            assert len({i, *parents}) == R + 1
            found[i].add(tuple(parents))
    assert {len(choices) for choices in found} == {6 * 5 * 4 * 3 * 2}


@pytest.mark.parametrize("columns", [(0, 1, 2), (-2, 0, 1), (0, 1, 2, 3, 4), (-1, -2, -1, 0, 1), (0, -2, 0, 1, 2)])
def test_the_mutant_is_the_base_plus_scaled_differences(columns):
    rng = np.random.default_rng(2)
    x = rng.random((9, 3))
    parents, v = chosen(rng.random((9, 8)), 5, best=4), np.empty_like(x)
    mutate(x, parents, np.array(columns), 0.7, v)
    base, *rest = (x[parents[:, column]] for column in columns)
    for plus, minus in zip(rest[::2], rest[1::2], strict=True):
        base = base + 0.7 * (plus - minus)
    assert_array_equal(v, base)


def test_exponential_crossover_takes_a_run_of_geometric_length():
    x = np.random.default_rng(1).random((50, 8))
    u, counts = np.empty_like(x), np.zeros(9)
    for draws in np.random.default_rng(0).random((400, 50, 12)):
        exponential(x, x + 1, 0.6, draws, 3, u)
        assert_array_equal(u, np.where(crossed := u != x, x + 1, x))
        assert ((crossed != np.roll(crossed, 1, axis=1)).sum(axis=1) <= 2).all()  # one run, cyclically
        assert crossed[np.arange(50), (8 * draws[:, 3]).astype(int)].all()
        counts += np.bincount(crossed.sum(axis=1), minlength=9)
    expected = 20_000 * np.array([0, *(0.4 * 0.6 ** np.arange(7)), 0.6**7])
    assert_allclose(counts, expected, atol=5 * np.sqrt(5000))


def test_binomial_crossover_takes_cr_of_the_coordinates_and_at_least_one():
    x = np.random.default_rng(1).random((50, 8))
    u = np.empty_like(x)

    def crossed(CR, rounds):
        for draws in np.random.default_rng(0).random((rounds, 50, 12)):
            binomial(x, x + 1, CR, draws, 3, u)
            assert_array_equal(u, np.where(u != x, x + 1, x))
            yield u != x

    cross = np.array(list(crossed(0.3, 400)))
    assert cross.any(axis=2).all()
    assert_allclose(cross.mean(), 1 / 8 + 7 / 8 * 0.3, atol=0.005)
    assert_array_equal(next(crossed(0.0, 1)).sum(axis=1), 1)
    assert next(crossed(1.0, 1)).all()


@pytest.mark.parametrize("rule", RULES)
def test_repair_changes_only_what_is_outside_the_box(rule):
    rng = np.random.default_rng(3)
    lower, upper = np.array([-1.0, 0.0, 2.0]), np.array([1.0, 5.0, 2.5])
    lower.flags.writeable = upper.flags.writeable = False  # as the meter's are
    x, v = rng.uniform(lower, upper, (40, 3)), rng.uniform(lower - 9, upper + 9, (40, 3))
    v[:2] = lower, upper
    draws, u = rng.random((40, 10)), v.copy()
    repair(u, x, lower, upper, RULES.index(rule), draws)
    bound = np.where(v < lower, lower, upper)
    expected = {
        "clip": bound,
        "midpoint": (x + bound) / 2,
        "reflect": [[mirrored(*numbers) for numbers in zip(row, lower, upper, strict=True)] for row in v],
        "resample": lower + draws[:, -3:] * (upper - lower),
    }[rule]
    inside = (lower <= v) & (v <= upper)
    assert 5 < inside.sum() < 100
    assert_array_equal(u[inside], v[inside])
    assert_allclose(u, np.where(inside, v, expected), rtol=0, atol=1e-12)


def test_selection_accepts_equal_values_so_that_a_plateau_is_crossed():
    problem = Formula(lambda X: np.zeros(len(X)), [0.0, 0.0], [1.0, 1.0])
    minimize(problem, DE(population=10, bounds="resample", generations=30), 1000)
    first, last = problem.points[:10], problem.points[-10:]
    assert not np.isin(last, first).any()


def test_the_papers_setting_spends_15000_evaluations_and_converges():
    minimum = minimize(bowl(2), DE(generations=300), 10**6)
    assert DE() == DE(population=50, F=0.5, CR=0.8)
    assert minimum.evaluations == 15_000
    assert minimum.value < 1e-25


def test_without_generations_the_budget_ends_it():
    assert minimize(bowl(2), DE(), 1234).evaluations == 1234
    assert minimize(bowl(2), DE(), Budget(evaluations=5000, target=1e-3)).value <= 1e-3


@pytest.mark.parametrize("rule", RULES)
def test_every_rule_stays_inside_and_reaches_a_corner(rule):
    problem = ramp(3)
    minimum = minimize(problem, DE(bounds=rule, F=0.9), 20_000)
    assert minimum.status == "ok"
    assert (problem.points >= -1).all()
    assert (problem.points <= 2).all()
    assert_allclose(minimum.value, -6, atol=1e-3)


def test_only_clip_lands_on_the_bound_itself():
    share = {}
    for rule in RULES:
        problem = ramp(3)
        minimize(problem, DE(bounds=rule), 2000)
        share[rule] = (problem.points == 2).mean()
    assert share["clip"] > 0.3
    assert share["reflect"] == share["resample"] == 0
    assert share["midpoint"] == 0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"population": 3}, "population: expected greater than or equal to 4, got 3"),
        ({"strategy": "rand/2/bin", "population": 5}, "population: expected at least 6 for rand/2/bin, got 5"),
        ({"F": 2.1}, "F: expected less than or equal to 2, got 2.1"),
        ({"CR": -0.1}, "CR: expected greater than or equal to 0, got -0.1"),
        ({"bounds": "wrap"}, "bounds: expected 'clip', 'midpoint', 'reflect' or 'resample', got 'wrap'"),
        ({"generations": 0}, "generations: expected greater than or equal to 1, got 0"),
    ],
)
def test_impossible_options_are_named(options, message):
    with pytest.raises(OptionError) as caught:
        DE(**options)
    assert message in str(caught.value)
