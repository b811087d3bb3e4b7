"""The size and power of the tests of claims, by simulation."""

import itertools
import math

import numpy as np
import pytest
from test_claims import INF, SNR, outcome

from nfbench.analysis.claim_parts import parts_of
from nfbench.analysis.claims import Claim, Compare, judge_claims
from nfbench.core import build


def at_most(share, level, repeats):
    return share <= level + 3 * math.sqrt(level * (1 - level) / repeats)


def rate(draw, repeats, level=0.05, seed=0, **table):
    """Share of simulated studies whose one-sided p for the claim is at most the level."""
    rng, compare = np.random.default_rng(seed), build(Compare, table)
    return np.mean([max(part.p for part in parts_of(compare, draw(rng))) <= level for _ in range(repeats)])


def curves(n, ratios):
    """Draw points of two methods with this ratio of errors at each point, σ = 1, and correlation 0.5 over points."""

    def draw(rng):
        scene = rng.normal(size=(2, n)) * math.sqrt(0.5)
        logs = [scene + rng.normal(size=(2, n)) * math.sqrt(0.5) for _ in ratios]
        return [
            ({SNR: p}, outcome({"a": np.exp(x[0]), "b": r * np.exp(x[1])}))
            for p, (r, x) in enumerate(zip(ratios, logs, strict=True))
        ]

    return draw


def walks(n, steps, correlated):
    """Draw errors of one method that do not depend on the point, with neighbouring points correlated."""

    def draw(rng):
        logs = rng.normal(size=(steps, n))
        if correlated:
            for p in range(1, steps):
                logs[p] = 0.8 * logs[p - 1] + 0.6 * logs[p]
        return [({SNR: p}, outcome({"a": np.exp(row)})) for p, row in enumerate(logs)]

    return draw


def test_sizes_and_powers_in_short():
    assert at_most(rate(walks(15, 5, True), 150, grows="a", key=SNR), 0.05, 150)
    assert at_most(rate(curves(15, [2.0, 2.0, 1.0]), 100, better="a", worse="b"), 0.05, 100)
    assert rate(curves(30, [2.0] * 7), 60, better="a", worse="b") == pytest.approx(0.47, abs=0.2)


@pytest.mark.slow
@pytest.mark.parametrize(("n", "power"), [(15, 0.14), (30, 0.47), (100, 0.99)])
def test_better_at_every_value(n, power):
    """Half the error at all of seven points; and equal at one of them (§6)."""
    table = {"better": "a", "worse": "b"}
    assert rate(curves(n, [2.0] * 7), 500, **table) == pytest.approx(power, abs=0.06)
    assert at_most(rate(curves(n, [100.0] * 6 + [1.0]), 500, **table), 0.05, 500)


@pytest.mark.slow
@pytest.mark.parametrize("n", [15, 30, 100])
@pytest.mark.parametrize("correlated", [False, True])
def test_the_size_of_a_trend(n, correlated):
    assert at_most(rate(walks(n, 7, correlated), 800, grows="a", key=SNR), 0.05, 800)
    assert at_most(rate(walks(n, 7, correlated), 800, falls="a", key=SNR), 0.05, 800)


@pytest.mark.slow
@pytest.mark.parametrize("n", [15, 30])
def test_the_size_of_degrading_more(n):
    """Both methods degrade alike, with correlated points."""

    def draw(rng):
        return [
            (swept_at, outcome({"a": 2.0**p * a.error[:, 0], "b": 2.0**p * b.error[:, 0]}))
            for p, ((swept_at, a), (_, b)) in enumerate(
                zip(walks(n, 5, True)(rng), walks(n, 5, True)(rng), strict=True)
            )
        ]

    assert at_most(rate(draw, 800, degrades="a", more_than="b", key=SNR), 0.05, 800)
    assert at_most(rate(draw, 800, degrades="a", more_than="b", key=SNR, start=0, stop=4), 0.05, 800)


@pytest.mark.slow
@pytest.mark.parametrize(("n", "sigma", "power"), [(15, 0.1, 0.94), (30, 0.1, 1.0), (15, 0.3, 0.01), (30, 0.3, 0.08)])
def test_equality_within_ten_percent(n, sigma, power):
    """sigma: standard deviation of the logarithm of the ratio."""

    def draw(shift):
        return lambda rng: [({}, outcome({"a": np.exp(rng.normal(shift, sigma, size=n)), "b": np.ones(n)}))]

    table = {"equal": ["a", "b"], "factor": 1.1}
    assert rate(draw(0.0), 600, **table) == pytest.approx(power, abs=0.05)
    assert at_most(rate(draw(math.log(1.1)), 600, **table), 0.05, 600)


@pytest.mark.slow
@pytest.mark.parametrize("n", [15, 30])
def test_the_size_of_a_floor(n):
    def draw(rng):
        logs = rng.normal(size=(2, n)) * 0.3
        return [({SNR: 0}, outcome({"a": np.exp(logs[0])})), ({SNR: 10}, outcome({"a": 0.8 * np.exp(logs[1])}))]

    assert at_most(rate(draw, 1000, floor="a", key=SNR, start=0, stop=10), 0.05, 1000)


@pytest.mark.slow
@pytest.mark.parametrize("runs", [1, 5])
def test_the_size_of_a_share_of_failures(runs):
    def draw(rng):
        failed = rng.binomial(runs, 0.2, size=(25, 1))
        return [({}, outcome({"a": np.where(failed[:, 0] > 0, INF, 1.0)}, runs=runs, failed=failed))]

    assert at_most(rate(draw, 800, fails="a", at_least=0.2), 0.05, 800)
    assert at_most(rate(draw, 800, fails="a", at_most=0.2), 0.05, 800)


@pytest.mark.slow
def test_a_family_of_true_nulls_is_wrong_in_at_most_5_percent():
    """Ten claims about equal methods, at the levels of the product: either way 2.5 %."""
    rng, wrong = np.random.default_rng(0), 0
    pairs = list(itertools.combinations("abcde", 2))
    claims = [Claim(f"{x} {y}", Compare(better=x, worse=y)) for x, y in pairs]
    for _ in range(500):
        points = [({}, outcome({m: rng.lognormal(size=20) for m in "abcde"}))]
        wrong += any(not v.startswith("not") for v in judge_claims(claims, points)["verdict"])
    assert at_most(wrong / 500, 0.05, 500)
