"""Times of the estimators on the polar grid, relative to their dominating linear algebra.

OMP_NUM_THREADS=1 python tests/benchmarks/polar_grid.py
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from numpy import ndarray
from scipy.linalg import solve_triangular

from nfbench import Minimum, Problem
from nfbench.core.options import build
from nfbench.problems.near_field.estimators.newtonized_omp import NewtonizedOmp
from nfbench.problems.near_field.estimators.omp import Omp
from nfbench.problems.near_field.estimators.sparse_bayesian import SparseBayesian
from nfbench.problems.near_field.instance import NearFieldInstance
from nfbench.problems.near_field.objectives import kernels
from nfbench.problems.near_field.scenario import NearField
from nfbench.problems.near_field.search import polar_grid
from nfbench.problems.near_field.subspace import compress

ULA = {
    "array": {"kind": "ula", "elements": 128, "spacing_wavelengths": 0.25, "origin": "first"},
    "wavelength_m": 0.02,
    "wavefront": "paper",
    "sources": 3,
    "snapshots": 200,
    "snr_db": 20.0,
    "azimuth_deg": [-60, 60],
    "range_m": [1.27, 20.16],
}
UPA = ULA | {
    "array": {"kind": "upa", "columns": 16, "rows": 16, "spacing_wavelengths": 0.5, "origin": "center"},
    "wavefront": "exact",
    "snapshots": 100,
    "elevation_deg": [-30, 30],
    "range_m": [0.452, 2.56],
}
REPEATS = 7


def shortest(action: Callable[[], object]) -> float:
    """Return the least CPU time of an action [ms]."""
    times = []
    for _ in range(REPEATS):
        start = time.process_time()
        action()
        times.append(time.process_time() - start)
    return 1e3 * min(times)


def update(A: ndarray, L: ndarray) -> None:
    """The matrix products of one update of sparse Bayesian learning."""
    C = np.linalg.cholesky(A @ A.conj().T + np.eye(len(A)))
    B = solve_triangular(C, A, lower=True)
    B.conj().T @ solve_triangular(C, L, lower=True)


def pursue(name: str, instance: NearFieldInstance, pursuit: Omp | NewtonizedOmp) -> None:
    """Print the time of a matching pursuit, and its ratio to K correlations of the grid with the data."""
    manifold, rows = instance.manifold, kernels.pack_rows(compress(instance.Y))
    grid = polar_grid(manifold, instance.lower, instance.upper, pursuit.coherence)
    least = instance.sources * shortest(lambda: kernels.projected_energy(*manifold.packed, rows, grid))
    found = shortest(lambda: pursuit.solve(instance, never))
    print(f"{name}  {type(pursuit).__name__:15} {len(grid):6} points  {found:6.1f} ms  ÷ kernel {found / least:.1f}")


def learn(name: str, instance: NearFieldInstance, formulation: SparseBayesian) -> None:
    """Print the time of sparse Bayesian learning, and its ratio to one update with all grid points."""
    grid = polar_grid(instance.manifold, instance.lower, instance.upper, formulation.coherence)
    A, L = instance.manifold.response(grid).T, compress(instance.Y)
    least, found = shortest(lambda: update(A, L)), shortest(lambda: formulation.solve(instance, never))
    print(f"{name}  SparseBayesian, refine={formulation.refine!s:5} {found:6.1f} ms  ÷ one update {found / least:.1f}")


def never(problem: Problem) -> Minimum:
    """Minimize nothing."""
    raise AssertionError("no solver is needed")


def main() -> None:
    for name, manifest in (("ULA 128", ULA), ("UPA 16 × 16", UPA)):
        instance = build(NearField, manifest).draw(np.random.default_rng(0))
        for pursuit in (Omp(), NewtonizedOmp()):
            pursue(name, instance, pursuit)
        for refine in (False, True):
            learn(name, instance, SparseBayesian(refine=refine))


if __name__ == "__main__":
    main()
