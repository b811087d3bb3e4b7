"""Speed of the methods for uniform lines: ``OMP_NUM_THREADS=1 python tests/benchmarks/line_methods.py`` prints a table.

The processor time of each call is measured alternately with that of the eigenvalue decomposition of the covariance that
the methods are described with, which is the linear algebra that dominates them; the implementations replace it by a
power iteration. Ratios are medians over rounds.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from timing import ROUNDS, ratio

sys.path.insert(0, str(Path(__file__).parents[1]))

from line_scenes import scene

from nfbench.problems.near_field.estimators.generalized_esprit import GeneralizedEsprit
from nfbench.problems.near_field.estimators.linear_prediction import LinearPrediction
from nfbench.problems.near_field.estimators.modified_music import ModifiedMusic
from nfbench.problems.near_field.estimators.reduced_dimension_music import ReducedDimensionMusic
from nfbench.problems.near_field.estimators.subarray_music import SubarrayMusic

METHODS = (SubarrayMusic, GeneralizedEsprit, ReducedDimensionMusic, LinearPrediction, ModifiedMusic)


def seconds(call: Callable[[], object]) -> float:
    """Return the processor time of a call [s]."""
    start = time.thread_time()
    call()
    return time.thread_time() - start


def main() -> None:
    table = Table(
        "method", "K", "÷ eigh", "÷ eigh, refined", title="Time of a localization, ULA of 128 elements at λ/4"
    )
    for K in (1, 3, 5):
        instance = scene(0, sources=K, min_separation_deg=10.0)
        Y = instance.Y
        for method in METHODS:
            plain, refined = method(), method(refine=True)
            calls = [
                lambda Y=Y: np.linalg.eigh(Y @ Y.conj().T),
                lambda instance=instance, plain=plain: plain.solve(instance, None),
                lambda instance=instance, refined=refined: refined.solve(instance, None),
            ]
            for call in calls:
                call()
            eigh, *times = zip(*[[seconds(call) for call in calls] for _ in range(ROUNDS)], strict=True)
            table.add_row(method.__name__, str(K), *(f"{ratio(list(each), list(eigh)):.2g}" for each in times))
    Console().print(table)


if __name__ == "__main__":
    main()
