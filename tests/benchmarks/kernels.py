"""How fast the objectives are: ``OMP_NUM_THREADS=1 python tests/benchmarks/kernels.py`` prints the tables.

Everything is a ratio of two things timed in turn within one run, the median over rounds. "literal" is the formula as
printed, one point at a time with the projector written out. "zgemm" is the time the machine's BLAS takes for M² complex
multiply-adds a candidate for RLS, and M·K·(3K − 1)/2 for ESF's inner products: 100 % is as fast as that, and more is
possible because the factor is triangular and half of Hermitian matrices is redundant.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy_objectives import NumPyESF, NumPyRLS
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from nfbench import Budget, MeteredProblem, Problem, minimize
from nfbench.environment import describe_environment
from nfbench.problems import kernels, neef, nemo
from nfbench.problems.esf import ESF
from nfbench.problems.instance import NearFieldInstance
from nfbench.problems.neef import Neef
from nfbench.problems.nemo import Nemo
from nfbench.problems.rls import RLS
from nfbench.problems.scenario import NearField
from nfbench.problems.subspace import compress, signal_subspace
from nfbench.problems.wavefronts import Manifold
from nfbench.solvers.de import DE

ROUNDS = 31
BATCH = 100
BLOCK = 4096

PLANE = NearField(
    array={"kind": "ula", "elements": 128, "spacing_wavelengths": 0.25, "origin": "first"},
    wavelength_m=0.02,
    wavefront="paper",
    sources=3,
    snapshots=200,
    snr_db=20.0,
    azimuth_deg=(-60, 60),
    range_m=(1.27, 20.16),
)
SPACE = NearField(
    array={"kind": "upa", "columns": 16, "rows": 16, "spacing_wavelengths": 0.5, "origin": "center"},
    wavelength_m=0.02,
    wavefront="exact",
    sources=3,
    snapshots=100,
    snr_db=20.0,
    azimuth_deg=(-60, 60),
    elevation_deg=(-30, 30),
    range_m=(0.452, 2.56),
)


@dataclass(frozen=True)
class Case:
    """One objective, its plain version, the formula as printed, and complex multiply-adds as (p, inner, columns)."""

    name: str
    fast: Problem
    plain: Problem
    literal: Callable[[np.ndarray], float]
    product: tuple[int, int, int]


def cases(name: str, instance: NearFieldInstance) -> list[Case]:
    manifold, box = instance.manifold, (instance.lower, instance.upper)
    Y, U_s = instance.Y, signal_subspace(instance.Y, instance.sources)
    M, K = U_s.shape

    def literal(data: np.ndarray, columns: int) -> Callable[[np.ndarray], float]:
        def value(x: np.ndarray) -> float:
            A = manifold.response(x.reshape(columns, -1)).T
            P = A @ np.linalg.pinv(A)
            return float(np.linalg.norm((np.eye(M) - P) @ data) ** 2)

        return value

    return [
        Case(f"RLS {name}", RLS(Y, manifold, *box), NumPyRLS(Y, manifold, *box), literal(Y, 1), (BATCH, M, M)),
        Case(
            f"ESF {name}",
            ESF(U_s, manifold, *box),
            NumPyESF(U_s, manifold, *box),
            literal(U_s, K),
            (BATCH, M, K * (3 * K - 1) // 2),
        ),
    ]


def seconds(call: Callable[[], object], number: int) -> float:
    start = time.perf_counter()
    for _ in range(number):
        call()
    return (time.perf_counter() - start) / number


def in_turn(calls: list[Callable[[], object]], numbers: list[int], rounds: int = ROUNDS) -> list[list[float]]:
    """Times [s] of each call, one list a call, one entry a round."""
    timed = [[seconds(c, n) for c, n in zip(calls, numbers, strict=True)] for _ in range(rounds)]
    return [list(times) for times in zip(*timed, strict=True)]


def ratio(slow: list[float], fast: list[float]) -> float:
    """The median over rounds of how many times faster."""
    return statistics.median(s / f for s, f in zip(slow, fast, strict=True))


def batches(all_cases: list[Case]) -> Table:
    table = Table("batch of 100", "µs", "÷ NumPy", "÷ literal", "of zgemm's rate", "agrees to")
    rng = np.random.default_rng(1)
    for case in all_cases:
        X = rng.uniform(case.fast.lower, case.fast.upper, (BATCH, case.fast.dimension))
        p, inner, columns = case.product
        A, C = (rng.normal(size=s) + 1j * rng.normal(size=s) for s in ((p, inner), (inner, columns)))
        calls = [
            lambda f=case.fast, X=X: f.evaluate(X),
            lambda f=case.plain, X=X: f.evaluate(X),
            lambda f=case.literal, x=X[0]: f(x),
            lambda A=A, C=C: A @ C,
        ]
        fast, plain, literal, zgemm = in_turn(calls, [20, 5, 1, 20])
        table.add_row(
            case.name,
            f"{1e6 * statistics.median(fast):.1f}",
            f"{ratio(plain, fast):.1f}",
            f"{BATCH * ratio(literal, fast):.0f}",
            f"{ratio(zgemm, fast):.0%}",
            f"{np.abs(case.fast.evaluate(X) / case.plain.evaluate(X) - 1).max():.0e}",
        )
    return table


def single_points(all_cases: list[Case]) -> Table:
    """The kernel's own cost is that of a point in a batch of 100; all the rest of a metered call is overhead."""
    table = Table(
        "one point", "µs", "÷ NumPy", "in a batch µs", "call adds µs", "meter adds µs", "gradient µs", "÷ NumPy"
    )
    rng = np.random.default_rng(1)
    for case in all_cases:
        X = rng.uniform(case.fast.lower, case.fast.upper, (BATCH, case.fast.dimension))
        x, meter = X[0], MeteredProblem(case.fast, Budget(evaluations=10**9))
        meter(x)
        calls = [
            lambda f=case.fast, x=x: f.value(x),
            lambda f=case.plain, x=x: f.value(x),
            lambda m=meter, x=x: m(x),
            lambda f=case.fast, X=X: f.evaluate(X),
            lambda f=case.fast, x=x: f.value_and_gradient(x),
            lambda f=case.plain, x=x: f.value_and_gradient(x),
        ]
        fast, plain, metered, batch, slope, plain_slope = in_turn(calls, [500, 50, 500, 10, 200, 20])
        table.add_row(
            case.name,
            f"{1e6 * statistics.median(fast):.2f}",
            f"{ratio(plain, fast):.1f}",
            f"{1e6 * statistics.median(batch) / BATCH:.2f}",
            f"{1e6 * statistics.median(f - b / BATCH for f, b in zip(fast, batch, strict=True)):.2f}",
            f"{1e6 * statistics.median(m - f for m, f in zip(metered, fast, strict=True)):.2f}",
            f"{1e6 * statistics.median(slope):.2f}",
            f"{ratio(plain_slope, slope):.1f}",
        )
    return table


def grids(instances: dict[str, NearFieldInstance], shapes: list[tuple[int, ...]]) -> Table:
    """MUSIC's M − ‖U_sᴴa‖² through the kernel of RLS, streamed in blocks; NumPy's on every 100th block."""
    table = Table("MUSIC grid, K = 3", "grid", "ns a point", "s in all", "÷ NumPy", "agrees to")
    for (name, instance), shape in zip(instances.items(), shapes, strict=True):
        manifold, U_s = instance.manifold, signal_subspace(instance.Y, 3)
        rows = kernels.pack_rows(compress(U_s))
        axes = [np.linspace(*side) for side in zip(instance.lower, instance.upper, shape, strict=True)]
        blocks = range(0, int(np.prod(shape)), BLOCK)

        def points(first: int, axes: list[np.ndarray] = axes, shape: tuple[int, ...] = shape) -> np.ndarray:
            index = np.unravel_index(np.arange(first, min(first + BLOCK, int(np.prod(shape)))), shape)
            return np.stack([axis[i] for axis, i in zip(axes, index, strict=True)], axis=1)

        def fast(X: np.ndarray, manifold: Manifold = manifold, rows: np.ndarray = rows) -> np.ndarray:
            return manifold.elements - kernels.explained(*manifold.packed, rows, X)

        def plain(X: np.ndarray, manifold: Manifold = manifold, U_s: np.ndarray = U_s) -> np.ndarray:
            b = manifold.response(X) @ U_s.conj()
            return manifold.elements - np.vecdot(b, b).real

        start = time.perf_counter()
        for first in blocks:
            fast(points(first))
        whole = time.perf_counter() - start
        some = [points(first) for first in blocks[::100]]
        ours, theirs = in_turn([lambda s=some: [fast(X) for X in s], lambda s=some: [plain(X) for X in s]], [1, 1], 3)
        error = max(np.abs(fast(X) - plain(X)).max() for X in some)
        table.add_row(
            name,
            " × ".join(map(str, shape)),
            f"{1e9 * whole / np.prod(shape):.0f}",
            f"{whole:.2f}",
            f"{ratio(theirs, ours):.1f}",
            f"{error:.0e}",
        )
    return table


def whole_runs(instances: dict[str, NearFieldInstance]) -> Table:
    """DE of 50 individuals and 300 generations a problem; NumPy's objectives take the kernels' place by name."""
    table = Table("DE, 15 000 evaluations a problem", "s", "NumPy s", "÷ NumPy", "outside evaluate", "J differs by")
    for name, instance in instances.items():
        for formulation, module, fast_class, plain_class in (
            (Nemo(), nemo, "RLS", NumPyRLS),
            (Neef(), neef, "ESF", NumPyESF),
        ):
            compiled = getattr(module, fast_class)
            times: dict[type, list[float]] = {compiled: [], plain_class: []}
            values: dict[type, list[float]] = {}
            shares = []
            for _ in range(3):
                for objective in times:
                    setattr(module, fast_class, objective)
                    minima, inside = [], []

                    def solve(problem: Problem, minima: list = minima, inside: list = inside) -> object:
                        evaluate = problem.evaluate

                        def timed(X: np.ndarray) -> np.ndarray:
                            start = time.perf_counter()
                            values = evaluate(X)
                            inside.append(time.perf_counter() - start)
                            return values

                        problem.evaluate = timed
                        minima.append(minimize(problem, DE(), 15_000, seed=len(minima)))
                        return minima[-1]

                    start = time.perf_counter()
                    formulation.solve(instance, solve)
                    times[objective].append(time.perf_counter() - start)
                    values[objective] = [m.value for m in minima]
                    if objective is compiled:
                        shares.append(1 - sum(inside) / times[objective][-1])
            setattr(module, fast_class, compiled)
            fast, plain = times.values()
            ours, theirs = (np.array(v) for v in values.values())
            table.add_row(
                f"{type(formulation).__name__}-DE, {name}",
                f"{statistics.median(fast):.3f}",
                f"{statistics.median(plain):.3f}",
                f"{ratio(plain, fast):.1f}",
                f"{statistics.median(shares):.0%}",
                f"{np.abs(ours / theirs - 1).max():.0e}",
            )
    return table


def main() -> None:
    console = Console()
    instances = {
        "ULA 128, T = 200, paper": PLANE.draw(np.random.default_rng(0)),
        "UPA 256, T = 100, exact": SPACE.draw(np.random.default_rng(0)),
    }
    all_cases = [case for name, instance in instances.items() for case in cases(name, instance)]
    console.print(f"{describe_environment()['cpu']}, one thread, K = 3")
    for table in (batches(all_cases), single_points(all_cases), whole_runs(instances)):
        console.print(table)
    console.print(grids(instances, [(400, 2000), (200, 200, 400)]))


if __name__ == "__main__":
    with threadpool_limits(1):
        main()
