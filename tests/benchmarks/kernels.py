"""Speed of the objectives: ``OMP_NUM_THREADS=1 python tests/benchmarks/kernels.py`` prints the tables.

All results are ratios of two quantities timed alternately in the same run, as medians over rounds. "literal" is the
formula as printed, for one point at a time, with an explicit projector. "zgemm" is the time that BLAS takes for the
complex multiply-adds of one candidate: M² for RLS, and M·K·(3K − 1)/2 for the inner products of ESF. At 100 % the
kernel is as fast as that; more is possible because the factor is triangular and half of a Hermitian matrix is
redundant. "of its peak" counts only the multiply-adds that the kernel really makes. It shows how much could still be
gained: at 100 % the responses would cost nothing.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numba
import numpy as np
from growth import growth
from numpy_objectives import NumPyESF, NumPyRLS, respond
from peers import Watched, optimizers, wrappers
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits
from timing import in_turn, ratio

from nfbench import Budget, MeteredProblem, Minimum, Problem, minimize
from nfbench.execution.environment import describe_environment
from nfbench.problems.near_field.estimators import neef, nemo
from nfbench.problems.near_field.estimators.music import grid_maxima
from nfbench.problems.near_field.estimators.neef import Neef
from nfbench.problems.near_field.estimators.nemo import Nemo
from nfbench.problems.near_field.instance import NearFieldInstance
from nfbench.problems.near_field.objectives import kernels
from nfbench.problems.near_field.objectives.rls import RLS
from nfbench.problems.near_field.objectives.subspace_fitting import SubspaceFit
from nfbench.problems.near_field.scenario import NearField
from nfbench.problems.near_field.subspace import compress, signal_subspace
from nfbench.problems.near_field.wavefronts import Manifold
from nfbench.solvers.de import DE

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
    """One objective in several implementations.

    name: label of the case.
    fast: compiled objective.
    plain: vectorized NumPy version.
    literal: formula as printed, for one point.
    product: complex multiply-adds as the shape (p, inner, columns) of a matrix product.
    made: fraction of these that the kernel makes, because a triangular factor is read only from its diagonal on.
    """

    name: str
    fast: Problem
    plain: Problem
    literal: Callable[[np.ndarray], float]
    product: tuple[int, int, int]
    made: float


def cases(name: str, instance: NearFieldInstance) -> list[Case]:
    manifold, box = instance.manifold, (instance.lower, instance.upper)
    Y, U_s = instance.Y, signal_subspace(instance.Y, instance.sources)
    M, K = U_s.shape

    def literal(data: np.ndarray, columns: int) -> Callable[[np.ndarray], float]:
        def value(x: np.ndarray) -> float:
            A = respond(manifold, x.reshape(columns, -1)).T
            P = A @ np.linalg.pinv(A)
            return float(np.linalg.norm((np.eye(M) - P) @ data) ** 2)

        return value

    rls = RLS(Y, manifold, *box)
    rows = rls._projected_energy.args[4]
    made = sum(rows.shape[2] - j // kernels.LANES * kernels.LANES for j in range(rows.shape[1])) / M**2
    return [
        Case(f"RLS {name}", rls, NumPyRLS(Y, manifold, *box), literal(Y, 1), (BATCH, M, M), made),
        Case(
            f"ESF {name}",
            SubspaceFit(U_s, manifold, *box),
            NumPyESF(U_s, manifold, *box),
            literal(U_s, K),
            (BATCH, M, K * (3 * K - 1) // 2),
            1.0,
        ),
    ]


def batches(all_cases: list[Case]) -> Table:
    table = Table(
        "batch of 100", "µs", "÷ NumPy", "÷ literal", "of zgemm's rate", "of its peak", "÷ NumPy at peak", "agrees to"
    )
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
            f"{ratio(zgemm, fast) * case.made:.0%}",
            f"{ratio(plain, zgemm) / case.made:.1f}",
            f"{np.abs(case.fast.evaluate(X) / case.plain.evaluate(X) - 1).max():.0e}",
        )
    return table


def single_points(all_cases: list[Case]) -> Table:
    """Measure the time of a call for one point, and a lower limit of it.

    "at least" is, for ESF, the time per point in a batch and, for RLS, whose batches read the factor once for 16
    points, the time to read the factor; in both cases plus the call of an empty kernel with the same arguments.
    """
    columns = (
        "µs",
        "÷ NumPy",
        "at least µs",
        "÷ NumPy at that",
        "call adds µs",
        "meter adds µs",
        "gradient µs",
        "÷ NumPy",
    )
    table = Table("one point", *columns)
    rng = np.random.default_rng(1)
    for case in all_cases:
        X = rng.uniform(case.fast.lower, case.fast.upper, (BATCH, case.fast.dimension))
        x, meter = X[0], MeteredProblem(case.fast, Budget(evaluations=10**9))
        kernel = case.fast._projected_energy if isinstance(case.fast, RLS) else case.fast._kernel
        empty = partial(numba.njit(lambda *arguments: np.empty(1)), *kernel.args)
        calls = [
            lambda f=case.fast, x=x: f.value(x),
            lambda f=case.plain, x=x: f.value(x),
            lambda m=meter, x=x: m(x),
            lambda f=case.fast, X=X: f.evaluate(X),
            lambda f=case.fast, x=x: f.value_and_gradient(x),
            lambda f=case.plain, x=x: f.value_and_gradient(x),
            lambda f=empty, x=x: float(f(x[None])[0]),
            lambda rows=kernel.args[4 if isinstance(case.fast, RLS) else 5]: read(rows),  # noqa: B008
        ]
        for call in calls:
            call()
        fast, plain, metered, batch, slope, plain_slope, nothing, reading = in_turn(
            calls, [500, 50, 500, 10, 200, 20, 500, 200]
        )
        inside = reading if isinstance(case.fast, RLS) else [b / BATCH for b in batch]
        least = [i + n for i, n in zip(inside, nothing, strict=True)]
        table.add_row(
            case.name,
            f"{1e6 * statistics.median(fast):.2f}",
            f"{ratio(plain, fast):.1f}",
            f"{1e6 * statistics.median(least):.2f}",
            f"{ratio(plain, least):.1f}",
            f"{1e6 * statistics.median(nothing):.2f}",
            f"{1e6 * statistics.median(m - f for m, f in zip(metered, fast, strict=True)):.2f}",
            f"{1e6 * statistics.median(slope):.2f}",
            f"{ratio(plain_slope, slope):.1f}",
        )
    return table


@numba.njit(fastmath=True, error_model="numpy")
def read(rows: np.ndarray) -> float:
    """Sum the part of a factor that RLS reads: four rows at a time, from the multiple of 16 before the diagonal on."""
    total = 0.0
    for j in range(np.uint64(0), np.uint64(rows.shape[1]), np.uint64(4)):
        for m in range(np.uint64(j // np.uint64(16) * np.uint64(16)), np.uint64(rows.shape[2])):
            for k in range(np.uint64(4)):
                total += rows[0, j + k, m] + rows[1, j + k, m]
    return total


def grids(instances: dict[str, NearFieldInstance], shapes: list[tuple[int, ...]]) -> Table:
    """Measure MUSIC's complete search for maxima, and M − ‖U_sᴴa‖² on every 100th block compared with NumPy.

    The search is made twice: with the spectrum interpolated along the range, and with every point evaluated.
    """
    heading = ("grid", "s", "every point s", "÷", "kernel ÷ NumPy", "agrees to")
    table = Table("MUSIC grid, K = 3", *heading)
    for (name, instance), shape in zip(instances.items(), shapes, strict=True):
        manifold, U_s = instance.manifold, signal_subspace(instance.Y, 3)
        rows = kernels.pack_rows(compress(U_s))
        axes = [np.linspace(*side) for side in zip(instance.lower, instance.upper, shape, strict=True)]
        blocks = range(0, int(np.prod(shape)), BLOCK)

        def points(first: int, axes: list[np.ndarray] = axes, shape: tuple[int, ...] = shape) -> np.ndarray:
            index = np.unravel_index(np.arange(first, min(first + BLOCK, int(np.prod(shape)))), shape)
            return np.stack([axis[i] for axis, i in zip(axes, index, strict=True)], axis=1)

        def fast(X: np.ndarray, manifold: Manifold = manifold, rows: np.ndarray = rows) -> np.ndarray:
            return manifold.elements - kernels.projected_energy(*manifold.packed, rows, X)

        def plain(X: np.ndarray, manifold: Manifold = manifold, U_s: np.ndarray = U_s) -> np.ndarray:
            b = respond(manifold, X) @ U_s.conj()
            return manifold.elements - np.vecdot(b, b).real

        searches = [partial(grid_maxima, [(U_s, manifold)], axes, 1000, interpolate) for interpolate in (True, False)]
        interpolated, whole = in_turn(searches, [1, 1], 3)
        sampled = [points(first) for first in blocks[::100]]
        calls = [lambda s=sampled: [fast(X) for X in s], lambda s=sampled: [plain(X) for X in s]]
        ours, theirs = in_turn(calls, [1, 1], 3)
        error = max(np.abs(fast(X) - plain(X)).max() for X in sampled)
        table.add_row(
            name,
            " × ".join(map(str, shape)),
            f"{np.median(interpolated):.2f}",
            f"{np.median(whole):.2f}",
            f"{ratio(whole, interpolated):.1f}",
            f"{ratio(theirs, ours):.1f}",
            f"{error:.0e}",
        )
    return table


def whole_runs(instances: dict[str, NearFieldInstance]) -> Table:
    """Measure the paper's NEMO-DE and NEEF-DE with the kernels and with NumPy's objectives in their place.

    "outside evaluate" is the fraction of the time that is spent in DE and in the meter, not in the objective.

    "J at the same points" is the relative difference of J between both objectives at the end points of the run with
    kernels. "first J" and "later J" compare the final values of both runs. For NEMO the later ones differ more: a
    minimizer is known only to the square root of the rounding error of J, and the next residual depends on it to first
    order.
    """
    columns = ("s", "NumPy s", "÷ NumPy", "outside evaluate", "J at the same points", "first J", "later J")
    table = Table("whole run", *columns)
    for name, instance in instances.items():
        for formulation, module, fast_class, plain_class, solver, evaluations in (
            (Nemo(), nemo, "RLS", NumPyRLS, DE(population=50), 15_000),
            (Neef(), neef, "SubspaceFit", NumPyESF, DE(population=120), 60_000),
        ):
            compiled = getattr(module, fast_class)
            times: dict[type, list[float]] = {compiled: [], plain_class: []}
            values: dict[type, np.ndarray] = {}
            shares = []
            for _ in range(5):
                for objective in times:
                    setattr(module, fast_class, objective)
                    watch = []

                    def solve(
                        problem: Problem, solver: DE = solver, budget: int = evaluations, watch: list = watch
                    ) -> Minimum:
                        watch.append((problem := Watched(problem), minimize(problem, solver, budget, seed=len(watch))))
                        return watch[-1][1]

                    start = time.perf_counter()
                    formulation.solve(instance, solve)
                    times[objective].append(time.perf_counter() - start)
                    values[objective] = np.array([minimum.value for _, minimum in watch])
                    if objective is compiled:
                        inside, whole = zip(
                            *((problem.seconds, minimum.runtime_s) for problem, minimum in watch), strict=True
                        )
                        shares.append(1 - sum(inside) / sum(whole))
            twins: list[tuple[Problem, Problem]] = []

            def twin(
                *given: Any, twins: list = twins, both: tuple = (compiled, plain_class), **options: Any
            ) -> Problem:
                twins.append(tuple(kind(*given, **options) for kind in both))
                return twins[-1][0]

            setattr(module, fast_class, twin)
            minima = []
            formulation.solve(
                instance,
                lambda p, m=minima, s=solver, e=evaluations: m.append(minimize(p, s, e, len(m))) or m[-1],
            )
            setattr(module, fast_class, compiled)
            same = [abs(f.value(m.x) / p.value(m.x) - 1) for (f, p), m in zip(twins, minima, strict=True)]
            fast, plain = times.values()
            ours, theirs = values.values()
            off = np.abs(ours / theirs - 1)
            table.add_row(
                f"{type(formulation).__name__.upper()}-DE, {name}",
                f"{statistics.median(fast):.3f}",
                f"{statistics.median(plain):.3f}",
                f"{ratio(plain, fast):.1f}",
                f"{statistics.median(shares):.0%}",
                f"{max(same):.0e}",
                f"{off[0]:.0e}",
                f"{off[1:].max():.0e}" if len(off) > 1 else "",
            )
    return table


def main() -> None:
    console = Console(width=120)
    instances = {
        "ULA 128": PLANE.draw(np.random.default_rng(0)),
        "UPA 256": SPACE.draw(np.random.default_rng(0)),
    }
    all_cases = [case for name, instance in instances.items() for case in cases(name, instance)]
    console.print(f"{describe_environment()['cpu']}, one thread, K = 3; ULA 128: λ/4, T = 200, wavefront of the paper")
    console.print("UPA 256: 16 × 16, λ/2, T = 100, exact wavefront")
    for make in (
        lambda: batches(all_cases),
        lambda: single_points(all_cases),
        lambda: whole_runs(instances),
        lambda: grids(instances, [(400, 2000), (200, 200, 400)]),
        growth,
        lambda: optimizers(all_cases[1].fast),
        wrappers,
    ):
        console.print(make())


if __name__ == "__main__":
    with threadpool_limits(1):
        main()
