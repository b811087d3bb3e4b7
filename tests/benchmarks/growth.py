"""Growth of the kernels' time: fitted exponents next to the complexities stated in the paper."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from rich.table import Table
from timing import best_seconds

from nfbench.problems.near_field.arrays import ULA
from nfbench.problems.near_field.objectives import kernels
from nfbench.problems.near_field.objectives.rls import RLS
from nfbench.problems.near_field.objectives.subspace_fitting import SubspaceFit
from nfbench.problems.near_field.subspace import compress, signal_subspace
from nfbench.problems.near_field.wavefronts import Manifold

LOWER, UPPER = np.array([-1.0, 1.27]), np.array([1.0, 20.16])


def manifold_of(M: int) -> Manifold:
    return Manifold(ULA(elements=M, spacing_wavelengths=0.25, origin="first").place(0.02), 0.02, "paper", False)


def noise(M: int, T: int) -> np.ndarray:
    rng = np.random.default_rng(M + T)
    return rng.normal(size=(M, T)) + 1j * rng.normal(size=(M, T))


def points(p: int, sources: int = 1) -> np.ndarray:
    return np.random.default_rng(p).uniform(np.tile(LOWER, sources), np.tile(UPPER, sources), (p, 2 * sources))


def rls(M: int = 128, T: int = 128, p: int = 100) -> Callable[[], object]:
    problem, X = RLS(noise(M, T), manifold_of(M), LOWER, UPPER), points(p)
    return lambda: problem.evaluate(X)


def esf(M: int = 128, K: int = 3, p: int = 100) -> Callable[[], object]:
    problem, X = SubspaceFit(signal_subspace(noise(M, 64), K), manifold_of(M), LOWER, UPPER), points(p, K)
    return lambda: problem.evaluate(X)


def music(M: int = 128, K: int = 3, p: int = 4096) -> Callable[[], object]:
    manifold, rows, X = manifold_of(M), kernels.pack_rows(compress(signal_subspace(noise(M, 64), K))), points(p)
    return lambda: kernels.projected_energy(*manifold.packed, rows, X)


def preparation(M: int) -> Callable[[], object]:
    Y = noise(M, M)
    return lambda: signal_subspace(Y, 3)


CASES: list[tuple[str, str, str, tuple[int, ...], Callable[[int], Callable[[], object]]]] = [
    ("RLS, T = 32", "M", "1", (128, 256, 512, 1024), lambda M: rls(M=M, T=32)),
    ("RLS, M = 256", "T ≤ M", "1", (32, 64, 128, 256), lambda T: rls(M=256, T=T)),
    ("RLS, M = 64", "T > M", "1", (128, 256, 512, 1024), lambda T: rls(M=64, T=T)),
    ("RLS", "M = T", "2", (64, 128, 256, 512), lambda M: rls(M=M, T=M)),
    ("RLS", "batch", "1", (64, 256, 1024, 4096), lambda p: rls(p=p)),
    ("ESF, K = 3", "M", "1", (128, 256, 512, 1024), lambda M: esf(M=M)),
    ("ESF", "K", "2", (2, 4, 6, 8), lambda K: esf(K=K)),
    ("ESF, K = 3", "batch", "1", (64, 256, 1024, 4096), lambda p: esf(p=p)),
    ("MUSIC grid, K = 3", "points", "1", (1024, 4096, 16384, 65536), lambda p: music(p=p)),
    ("MUSIC grid, K = 3", "M", "2", (128, 256, 512, 1024), lambda M: music(M=M)),
    ("MUSIC grid, M = 128", "K", "0", (2, 4, 8, 16), lambda K: music(K=K)),
    ("subspace of Y, M × M", "M", "3", (64, 128, 256, 512), preparation),
]


def growth() -> Table:
    """Fit the exponents b of time ∝ nᵇ by least squares on logarithms."""
    table = Table("growth of", "with", "over", "exponent", "paper", title="time ∝ nᵇ")
    for name, what, claim, values, make in CASES:
        times = [best_seconds(make(value)) for value in values]
        exponent = np.polyfit(np.log(values), np.log(times), 1)[0]
        table.add_row(name, what, f"{values[0]} … {values[-1]}", f"{exponent:.2f}", claim)
    return table
