"""Coverage of nfbench's intervals, nominally 95 %: ``python tests/benchmarks/interval_coverage.py [REPEATS]``.

Prints the tables of docs/intervals.md: for each interval, the share of simulated studies whose interval contains the
true value. The standard error of a share is 1 % with the default of 500 simulated studies.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator

import numpy as np
from scipy.stats import binom, gamma

from nfbench.analysis import intervals as iv

SCENES = (10, 30, 100)
Interval = tuple[float, float]


def covers(interval: Interval, true: float) -> bool:
    """Return whether the interval contains the value; a NaN end does not bound it."""
    low, high = interval
    return not (low > true or high < true)


def coverage(draw: Callable[[], Interval], true: float, repeats: int) -> float:
    return float(np.mean([covers(draw(), true) for _ in range(repeats)]))


# shares: exact, for the worst of a grid of true shares


def share_coverage(n: int) -> float:
    """Return the smallest coverage of Clopper–Pearson's interval over true shares from 1 to 99 %."""
    low, high = iv.ecdf_pointwise(np.arange(n + 1), n)
    grid = np.linspace(0.01, 0.99, 197)
    inside = (low <= grid[:, None]) & (grid[:, None] <= high)
    return float(np.min(np.sum(inside * binom.pmf(np.arange(n + 1), n, grid[:, None]), axis=1)))


# quantiles


def quantile_coverage(n: int, q: float, failures: float, repeats: int, seed: int = 0) -> float:
    """Errors are exponential, and infinite in a share of the scenes."""
    rng = np.random.default_rng(seed)
    true = -math.log1p(-q / (1 - failures)) if q < 1 - failures else math.inf

    def draw() -> Interval:
        x = np.where(rng.random(n) < failures, np.inf, rng.exponential(size=n))
        return iv.quantile_interval(x, q)

    return coverage(draw, true, repeats)


# ratios

DIFFERENCES: dict[str, tuple[Callable[[np.random.Generator, tuple[int, ...]], np.ndarray], float]] = {
    "normal": (lambda rng, shape: rng.normal(size=shape), 0.0),
    "skewed": (lambda rng, shape: rng.exponential(size=shape), gamma.ppf(0.5, 2) / 2),
    "5 % outliers": (lambda rng, shape: rng.normal(size=shape) * np.where(rng.random(shape) < 0.05, 100, 1), 0.0),
    "80 % near ties": (lambda rng, shape: rng.normal(size=shape) * np.where(rng.random(shape) < 0.8, 1e-3, 1), 0.0),
    "10 % failures": (lambda rng, shape: np.where(rng.random(shape) < 0.1, np.inf, 1.0) * rng.normal(size=shape), 0.0),
}


def ratio_coverage(n: int, kind: str, repeats: int, seed: int = 0) -> float:
    rng = np.random.default_rng(seed)
    draw, centre = DIFFERENCES[kind]
    return coverage(lambda: iv.ratio_interval(draw(rng, (n,)))[1:], math.exp(centre), repeats)


def table_coverage(n: int, repeats: int, k: int = 9, seed: int = 0) -> float:
    """Return the share of tables of k equal methods in which all ratios are covered at once."""
    rng = np.random.default_rng(seed)
    i, j = np.triu_indices(k, 1)
    level = 1 - 0.05 / len(i)
    hits = 0
    for _ in range(repeats):
        e = rng.normal(size=(k, n))
        hits += all(covers(iv.ratio_interval(d, level)[1:], 1.0) for d in e[i] - e[j])
    return hits / repeats


# means of values in [0, 1]

MEANS: dict[str, tuple[Callable[[np.random.Generator, int], np.ndarray], float]] = {
    "5 runs a scene": (lambda rng, n: rng.binomial(5, rng.beta(4, 1, size=n)) / 5, 0.8),
    "5 runs, scenes alike": (lambda rng, n: rng.binomial(5, 0.97, size=n) / 5, 0.97),
    "beta(2, 5)": (lambda rng, n: rng.beta(2, 5, size=n), 2 / 7),
    "beta(0.2, 5)": (lambda rng, n: rng.beta(0.2, 5, size=n), 0.2 / 5.2),
}


def mean_coverage(n: int, kind: str, repeats: int, seed: int = 0) -> float:
    rng = np.random.default_rng(seed)
    draw, true = MEANS[kind]
    return coverage(lambda: iv.bounded_mean_interval(draw(rng, n)), true, repeats)


# root mean square of the solved scenes

ERRORS: dict[str, Callable[[np.random.Generator, int], np.ndarray]] = {
    "Rayleigh": lambda rng, n: rng.rayleigh(size=n),
    "lognormal": lambda rng, n: rng.lognormal(size=n),
    "3 % five times larger": lambda rng, n: rng.rayleigh(size=n) * np.where(rng.random(n) < 0.03, 5, 1),
}


def solved_coverage(n: int, kind: str, multiple: float, repeats: int, seed: int = 0) -> float:
    """The target is a multiple of the RMSE; 10 % of the scenes fail for another reason."""
    rng = np.random.default_rng(seed)
    many = ERRORS[kind](np.random.default_rng(99), 2_000_000)
    target = multiple * math.sqrt(np.mean(many**2))
    true = math.sqrt(np.mean(many[many <= target] ** 2))

    def draw() -> Interval:
        e = np.where(rng.random(n) < 0.1, np.inf, ERRORS[kind](rng, n))
        return iv.rms_of_solved_interval(e, target)[1:]

    return coverage(draw, true, repeats)


# expected running time


def ert_simulated(n: int, share: float, repeats: int, runs: int = 1, seed: int = 0) -> tuple[list[bool], list[int]]:
    """Return whether each interval covers the truth, and the number of hits.

    A run hits with this probability, after a beta-distributed part of the cap; otherwise it spends the cap.
    """
    rng = np.random.default_rng(seed)
    cap = 1000.0
    true = cap * (share * 1.5 / 5 + (1 - share)) / share
    covered, counts = [], []
    for _ in range(repeats):
        hit = rng.random((n, runs)) < share
        spent = np.where(hit, cap * rng.beta(1.5, 3.5, size=hit.shape), cap).sum(axis=1)
        covered.append(covers(iv.ert_interval(spent, hit.sum(axis=1), runs, cap), true))
        counts.append(int(hit.sum()))
    return covered, counts


def ert_coverage(n: int, share: float, repeats: int, runs: int = 1) -> float:
    return float(np.mean(ert_simulated(n, share, repeats, runs)[0]))


# distribution functions


def band_coverage(n: int, simultaneous: bool, repeats: int, seed: int = 0) -> float:
    """Return the share of bands that contain the distribution function of uniform values everywhere."""
    rng = np.random.default_rng(seed)
    low, high = iv.ecdf_pointwise(np.arange(n + 1), n)
    if simultaneous:
        half, steps = iv.ecdf_band(n), np.arange(n + 1) / n
        low, high = steps - half, steps + half
    x = np.sort(rng.random((repeats, n)), axis=1)
    # between the i-th and next value the empirical function is i/n, and the true one rises from x_i to x_(i+1)
    start = np.concatenate([np.zeros((repeats, 1)), x], axis=1)
    end = np.concatenate([x, np.ones((repeats, 1))], axis=1)
    return float(np.mean(np.all((low <= start) & (end <= high), axis=1)))


def rows(repeats: int) -> Iterator[tuple[str, str, list[str]]]:
    """Yield the quantity, the simulated case, and the coverage for each number of scenes."""

    def row(quantity: str, case: str, of: Callable[[int], float]) -> tuple[str, str, list[str]]:
        return quantity, case, [f"{of(n):.3f}" for n in SCENES]

    yield row("share solved", "worst true share (exact)", share_coverage)
    for q, name in ((0.5, "median"), (0.9, "90 % quantile")):
        yield row(name, "exponential", lambda n: quantile_coverage(n, q, 0.0, 5 * repeats))  # noqa: B023
        yield row(name, "5 % failures", lambda n: quantile_coverage(n, q, 0.05, 5 * repeats))  # noqa: B023
    for kind in DIFFERENCES:
        yield row("ratio", kind, lambda n: ratio_coverage(n, kind, 2 * repeats))  # noqa: B023
    yield row("ratio", "all 36 pairs of 9 methods at once", lambda n: table_coverage(n, 2 * repeats))
    for kind in MEANS:
        yield row("mean in [0, 1]", kind, lambda n: mean_coverage(n, kind, repeats))  # noqa: B023
    for kind in ERRORS:
        for multiple in (3.0, 7.0):
            case = f"{kind}, target {multiple:g} × RMSE"
            yield row("RMSE of solved", case, lambda n: solved_coverage(n, kind, multiple, repeats))  # noqa: B023
    for share in (0.02, 0.1, 0.3, 0.6, 0.9, 1.0):
        yield row("ERT", f"{share:.0%} of runs hit", lambda n: ert_coverage(n, share, repeats))  # noqa: B023
    yield row("ERT", "30% hit, 5 runs a scene", lambda n: ert_coverage(n, 0.3, repeats, runs=5))
    yield row("runtime distribution", "simultaneous band", lambda n: band_coverage(n, True, 20 * repeats))
    yield row("runtime distribution", "pointwise band, at all points", lambda n: band_coverage(n, False, 20 * repeats))


def given_hits(repeats: int) -> Iterator[str]:
    """Yield the coverage of the ERT given the number of hits, over many shares and numbers of scenes."""
    found = [ert_simulated(n, share, repeats // 2, seed=1) for n in SCENES for share in np.linspace(0.03, 0.97, 8)]
    covered = np.concatenate([np.array(c) for c, _ in found])
    counts = np.concatenate([np.array(c) for _, c in found])
    for low, high in ((0, 0), (1, 2), (3, 4), (5, 9), (10, 19), (20, 100)):
        chosen = (counts >= low) & (counts <= high)
        if chosen.any():
            name = str(low) if low == high else f"{low} to {high}"
            yield f"| {name} | {np.mean(covered[chosen]):.3f} | {chosen.sum():,} |"


def main() -> None:
    repeats = int(sys.argv[1]) if len(sys.argv) > 1 else 500
    print(f"| interval of | simulated | {' | '.join(f'{n} scenes' for n in SCENES)} |\n|---|---|{'---|' * len(SCENES)}")
    for quantity, case, shares in rows(repeats):
        print(f"| {quantity} | {case} | {' | '.join(shares)} |", flush=True)
    print("\n| hits in the study | coverage of the ERT | studies |\n|---|---|---|")
    for line in given_hits(repeats):
        print(line, flush=True)
    print(f"\nStandard error of a share of 95 % at {repeats:,} studies: {math.sqrt(0.95 * 0.05 / repeats):.3f}")


if __name__ == "__main__":
    main()
