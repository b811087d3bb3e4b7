"""Speed of the methods for uniform lines: ``OMP_NUM_THREADS=1 python tests/benchmarks/line_methods.py`` prints a table.

Each call is timed alternately with the eigenvalue decomposition of the covariance that the methods are described with,
which is the linear algebra that dominates them; the implementations replace it by a power iteration.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from timing import in_turn, ratio

sys.path.insert(0, str(Path(__file__).parents[1]))

from line_scenes import scene

from nfbench.problems.near_field.estimators.generalized_esprit import GeneralizedEsprit
from nfbench.problems.near_field.estimators.linear_prediction import LinearPrediction
from nfbench.problems.near_field.estimators.modified_music import ModifiedMusic
from nfbench.problems.near_field.estimators.reduced_dimension_music import ReducedDimensionMusic
from nfbench.problems.near_field.estimators.subarray_music import SubarrayMusic

METHODS = (SubarrayMusic, GeneralizedEsprit, ReducedDimensionMusic, LinearPrediction, ModifiedMusic)


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
            eigh, *times = in_turn(calls, [1, 1, 1])
            table.add_row(method.__name__, str(K), *(f"{ratio(each, eigh):.2g}" for each in times))
    Console().print(table)


if __name__ == "__main__":
    main()
