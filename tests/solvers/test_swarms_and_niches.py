"""PSO, crowding DE, basin hopping, and NLopt's methods that need a gradient."""

import math
import random

import numpy as np
import pytest
from bench_problems import Formula, bowl, ramp, two_valleys
from numpy.testing import assert_allclose, assert_array_equal

from nfbench import Budget, MeteredProblem, OptionError, Status, minimize
from nfbench.problems.functions import Functions
from nfbench.problems.near_field.objectives.subspace_fitting import SubspaceFit
from nfbench.problems.near_field.scenario import NearField
from nfbench.problems.near_field.subspace import signal_subspace
from nfbench.solvers.basin_hopping import BasinHopping
from nfbench.solvers.crowding_de import CrowdingDE, compete
from nfbench.solvers.nlopt_global import MLSLLBFGS, StoGO, StoGORand
from nfbench.solvers.pso import PSO


def plain_pso(f, lower, upper, N, topology, steps, rng):
    """Bratton & Kennedy's standard, one number at a time; returns the points evaluated."""
    n = len(lower)
    a, b = rng.random((N, n)), rng.random((N, n))
    x = [[lower[j] + a[i, j] * (upper[j] - lower[j]) for j in range(n)] for i in range(N)]
    v = [[(lower[j] + b[i, j] * (upper[j] - lower[j]) - x[i][j]) / 2 for j in range(n)] for i in range(N)]
    p, best = [list(xi) for xi in x], [f(xi) for xi in x]
    seen = [list(xi) for xi in x]
    for _ in range(steps):
        e1, e2 = rng.random((N, n)), rng.random((N, n))
        around = [range(N) if topology == "global" else (i, (i - 1) % N, (i + 1) % N) for i in range(N)]
        g = [list(p[min(around[i], key=lambda k: best[k])]) for i in range(N)]
        for i in range(N):
            for j in range(n):
                pull = 2.05 * e1[i, j] * (p[i][j] - x[i][j]) + 2.05 * e2[i, j] * (g[i][j] - x[i][j])
                v[i][j] = 0.72984 * (v[i][j] + pull)
                x[i][j] += v[i][j]
            if all(lower[j] <= x[i][j] <= upper[j] for j in range(n)):
                seen.append(list(x[i]))
                if (value := f(x[i])) < best[i]:
                    p[i], best[i] = list(x[i]), value
    return np.array(seen)


@pytest.mark.parametrize("topology", ["global", "ring"])
def test_pso_evaluates_the_same_points_as_a_plain_loop(topology):
    lower, upper = np.array([-2.0, -1.0, 0.1]), np.array([1.0, 0.5, 3.3])

    def rugged(X):
        return (X**2).sum(axis=1) + np.cos(7 * X[:, 0]) * X[:, -1]

    problem = Formula(rugged, lower, upper)
    minimize(problem, PSO(swarm=12, topology=topology), 700, 3)
    f = lambda x: float(rugged(np.array([x]))[0])  # noqa: E731
    seen = plain_pso(f, lower, upper, 12, topology, 120, np.random.default_rng(3))
    assert len(seen) < 120 * 12  # some flew out
    assert_allclose(problem.points, seen[:700], rtol=0, atol=1e-9)


def test_pso_constriction_is_clerc_and_kennedys():
    phi = PSO().c1 + PSO().c2
    assert_allclose(PSO().chi, 2 / abs(2 - phi - np.sqrt(phi**2 - 4 * phi)), atol=5e-6)


def plain_crowding(f, lower, upper, N, m, steps, rng):
    """Thomsen's crowding DE with Qu, Suganthan & Liang's m neighbours (None: all), one number at a time."""
    n, F, CR = len(lower), 0.5, 0.9

    def distance(a, b):
        return sum(((a[j] - lower[j]) / w[j] - (b[j] - lower[j]) / w[j]) ** 2 for j in range(n))

    w = [upper[j] - lower[j] for j in range(n)]
    unit = rng.random((N, n))
    x = [[lower[j] + unit[i, j] * w[j] for j in range(n)] for i in range(N)]
    values, seen = [f(xi) for xi in x], [list(xi) for xi in x]
    for _ in range(steps):
        partners = []
        draws = rng.random((N, m or N - 1))
        for i in range(N):
            others = [(i + k) % N for k in range(1, N)]
            if m is not None:
                near = sorted(others, key=lambda k, i=i: distance(x[k], x[i]))[:m]
                d = [-1.0 if k == i else distance(x[k], x[i]) for k in range(N)]
                others = [k for k in np.argpartition(d, m)[: m + 1] if k != i]  # the same ones; draws go by this order
                assert set(others) == set(near)
            order = sorted(range(len(others)), key=lambda k, i=i: draws[i, k])
            partners.append([others[k] for k in order[:3]])
        rand, j_rand = rng.random((N, n)), rng.integers(n, size=N)
        trials = []
        for i, (r1, r2, r3) in enumerate(partners):
            u = list(x[i])
            for j in range(n):
                if rand[i, j] <= CR or j == j_rand[i]:
                    v = x[r1][j] + F * (x[r2][j] - x[r3][j])
                    u[j] = (x[i][j] + lower[j]) / 2 if v < lower[j] else (x[i][j] + upper[j]) / 2 if v > upper[j] else v
            trials.append(u)
        for u in trials:
            nearest = min(range(N), key=lambda k, u=u: distance(u, x[k]))
            if (value := f(u)) <= values[nearest]:
                x[nearest], values[nearest] = list(u), value
        seen += trials
    return np.array(seen)


@pytest.mark.parametrize("neighbors", [None, 10])
def test_crowding_evaluates_the_same_points_as_a_plain_loop(neighbors):
    lower, upper = np.array([-2.0, -1.0, 0.1]), np.array([1.0, 0.5, 3.3])

    def rugged(X):
        return (X**2).sum(axis=1) + np.cos(7 * X[:, 0]) * X[:, -1]

    problem = Formula(rugged, lower, upper)
    minimize(problem, CrowdingDE(population=30, neighbors=neighbors), 3000, 3)
    f = lambda x: float(rugged(np.array([x]))[0])  # noqa: E731
    seen = plain_crowding(f, lower, upper, 30, neighbors, 99, np.random.default_rng(3))
    assert_allclose(problem.points, seen, rtol=0, atol=1e-9)


def test_crowding_replaces_the_nearest_and_only_by_no_worse():
    x, f = np.array([[0.0, 0.0], [1.0, 0.0]]), np.array([1.0, 2.0])
    u, fu = np.array([[0.9, 0.0], [0.1, 0.0], [0.8, 0.0]]), np.array([2.0, 1.5, 1.9])
    compete(x, f, u, fu, np.ones(2))
    assert_array_equal(x, [[0.0, 0.0], [0.8, 0.0]])  # 0.9 took the place of 1, then 0.8 that of 0.9
    assert_array_equal(f, [1.0, 1.9])


def test_crowding_measures_in_widths_of_the_box():
    x, f = np.array([[0.0, 0.0], [0.3, 90.0]]), np.array([1.0, 1.0])
    compete(x, f, np.array([[0.3, 10.0]]), np.zeros(1), np.array([1.0, 100.0]))
    assert_array_equal(f, [0.0, 1.0])
    assert x[0].tolist() == [0.3, 10.0]  # √(0.3² + 0.1²) from the first, 0.8 from the second


def test_crowding_replaces_as_inspyred_does():
    """inspyred by Garrett, with the whole population as its crowd; it differs only at ties, and there are none here."""
    ec = pytest.importorskip("inspyred.ec")
    N, width = 20, np.array([1.0, 100.0, 0.01])

    def individuals(points, values):
        made = [ec.Individual(point, maximize=False) for point in points.tolist()]
        for individual, value in zip(made, values.tolist(), strict=True):
            individual.fitness = value
        return made

    def distance(a, b):
        return math.dist(a / width, b / width)

    for seed in range(50):
        rng = np.random.default_rng(seed)
        x, f, u, fu = rng.random((N, 3)) * width, rng.random(N), rng.random((3 * N, 3)) * width, rng.random(3 * N)
        crowd = {"distance_function": distance, "crowding_distance": N}
        theirs = ec.replacers.crowding_replacement(
            random.Random(seed), individuals(x, f), [], individuals(u, fu), crowd
        )
        compete(x, f, u, fu, width)
        ours = [[*point, value] for point, value in zip(x.tolist(), f.tolist(), strict=True)]
        assert sorted(ours) == sorted([*one.candidate, one.fitness] for one in theirs)


def himmelblau():
    """Its four minima are all 0; see Himmelblau 1972."""
    return Formula(
        lambda X: (X[:, 0] ** 2 + X[:, 1] - 11) ** 2 + (X[:, 0] + X[:, 1] ** 2 - 7) ** 2, [-5.0, -5.0], [5.0, 5.0]
    )


HIMMELBLAU = np.array([[3.0, 2.0], [-2.805118, 3.131312], [-3.779310, -3.283186], [3.584428, -1.848126]])


@pytest.mark.parametrize("neighbors", [None, 10])
@pytest.mark.parametrize("seed", range(3))
def test_crowding_holds_all_four_minima_of_himmelblau(neighbors, seed):
    found = minimize(himmelblau(), CrowdingDE(neighbors=neighbors), 20_000, seed)
    distance = np.linalg.norm(found.population[:, None] - HIMMELBLAU, axis=2)
    assert (distance.min(axis=0) < 0.05).all()
    best_of = distance.argmin(axis=1)
    assert np.bincount(best_of, minlength=4).min() >= 5


def test_neighborhood_mutation_sharpens_sooner():
    gaps = {}
    for neighbors in (None, 10):
        found = [minimize(himmelblau(), CrowdingDE(neighbors=neighbors), 6000, seed) for seed in range(5)]
        gaps[neighbors] = np.median([np.median(m.population_values) for m in found])
    assert gaps[10] < 0.5 * gaps[None]


def test_a_population_is_handed_over_best_first_and_may_not_be_malformed():
    found = minimize(bowl(2), CrowdingDE(population=20), 333)
    assert found.population.shape == (20, 2)
    assert_array_equal(found.population_values, bowl(2).formula(found.population))
    assert (np.diff(found.population_values) >= 0).all()
    assert minimize(bowl(2), BasinHopping(), 100).population is None
    meter = MeteredProblem(bowl(2), Budget(evaluations=10))
    with pytest.raises(Exception, match=r"expected a population \(p, 2\) and p values, got shapes \(3, 2\), \(2,\)"):
        meter.keep_population(np.zeros((3, 2)), np.zeros(2))


def rastrigin(n=3):
    return Functions(function="rastrigin", dimension=n, rotated=True).draw(np.random.default_rng(0)).problem


@pytest.mark.parametrize("solver", [BasinHopping(), MLSLLBFGS(), MLSLLBFGS(sampling="random"), StoGO(), StoGORand()])
def test_the_gradient_is_used_and_counts_as_one_evaluation(solver):
    minimum = minimize(rastrigin(), solver, 3000)
    assert minimum.status is Status.OK
    assert minimum.evaluations == 3000
    assert minimum.gradients > 1000
    assert minimum.value < 12  # second-best valleys are 1, 2, 3 …; the mean is some 50


@pytest.mark.parametrize("sampling", ["low-discrepancy", "random"])
def test_mlsl_restarts_where_lbfgs_gives_up(sampling):
    """ESF, in whose narrow valleys NLopt's L-BFGS ends with a failure."""
    array = {"kind": "ula", "elements": 64, "spacing_wavelengths": 0.25, "origin": "first"}
    box = {"azimuth_deg": [-60, 60], "range_m": [0.5, 4.0]}
    scenario = NearField(array=array, **box, wavelength_m=0.02, wavefront="exact", sources=3, snapshots=50, snr_db=20.0)
    instance = scenario.draw(np.random.default_rng(0))
    esf = SubspaceFit(signal_subspace(instance.Y, 3), instance.manifold, instance.lower, instance.upper)
    minimum = minimize(esf, MLSLLBFGS(sampling=sampling), 10_000)
    assert (minimum.status, minimum.evaluations) == (Status.OK, 10_000)


@pytest.mark.parametrize("cls", [MLSLLBFGS, StoGO, StoGORand])
def test_without_a_gradient_they_are_skipped(cls):
    minimum = minimize(bowl(2), cls(), 100)
    assert (minimum.status, minimum.evaluations) == (Status.SKIPPED, 0)


@pytest.mark.parametrize("cls", [MLSLLBFGS, StoGO, StoGORand])
def test_the_budget_in_seconds_ends_what_has_no_limit_in_evaluations(cls):
    minimum = minimize(rastrigin(), cls(), Budget(seconds=0.1))
    assert minimum.status is Status.OK
    assert minimum.runtime_s < 5


def test_basin_hopping_stays_inside_and_hops_out_of_the_wide_valley():
    assert minimize(two_valleys(width=0.2), BasinHopping(), 4000, 1).value < -1.9
    problem = ramp(3)
    assert_allclose(minimize(problem, BasinHopping(step=1.0), 1000).value, -6)
    assert (np.abs(problem.points - 0.5) <= 1.5).all()


def test_basin_hopping_accepts_by_metropolis():
    points = []
    for temperature in (0.0, 100.0):
        problem = two_valleys(width=0.1)
        minimize(problem, BasinHopping(step=0.05, temperature=temperature, patience=1000), 2000, 0)
        points.append(problem.points)
    assert not np.array_equal(points[0], points[1])
    assert np.ptp(points[1], axis=0).min() > np.ptp(points[0], axis=0).min()  # it wanders


@pytest.mark.parametrize(
    ("cls", "options", "message"),
    [
        (CrowdingDE, {"neighbors": 100}, "neighbors: expected fewer than the population of 100, got 100"),
        (PSO, {"topology": "star"}, "topology: expected 'global' or 'ring', got 'star'"),
        (BasinHopping, {"step": 0.0}, "step: expected greater than 0, got 0.0"),
    ],
)
def test_impossible_options_are_named(cls, options, message):
    with pytest.raises(OptionError) as caught:
        cls(**options)
    assert message in str(caught.value)
