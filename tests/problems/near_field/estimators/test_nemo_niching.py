"""NEMO with niching: all sources from one population."""

import numpy as np
import pytest

from nfbench import Budget, Incompatible, minimize
from nfbench.problems.near_field.estimators.nemo_niching import NemoNiching
from nfbench.problems.near_field.scenario import NearField
from nfbench.solvers.crowding_de import CrowdingDE
from nfbench.solvers.random_search import RandomSearch


def scene(**options):
    array = {"kind": "ula", "elements": 64, "spacing_wavelengths": 0.25, "origin": "first"}
    sources = {"azimuth_deg": [-60, 60], "range_m": [0.5, 4.0], "positions": [[-35.0, 0.9], [5.0, 1.6], [40.0, 1.2]]}
    common = {"wavelength_m": 0.02, "wavefront": "exact", "snapshots": 50, "snr_db": 20.0, "sources": 3}
    return NearField(array=array, **common, **{**sources, **options}).draw(np.random.default_rng(1))


def solve(formulation, instance, solver, counts=None):
    def run(problem):
        found = minimize(problem, solver, Budget(evaluations=9000), 1)
        if counts is not None:
            counts.append(found.evaluations)
        return found

    return formulation.solve(instance, run)


@pytest.mark.parametrize("neighbors", [None, 10])
def test_three_sources_from_one_run_of_one_problem(neighbors):
    counts = []
    estimate = solve(NemoNiching(refine=True), scene(), CrowdingDE(neighbors=neighbors), counts)
    assert counts == [9000]
    assert estimate.shape == (3, 2)
    assert scene().score(estimate)["rmse_m"] < 0.05


def test_individuals_are_near_their_refined_minima():
    instance, solver = scene(), CrowdingDE(neighbors=10)
    individuals, minima = (solve(NemoNiching(refine=r), instance, solver) for r in (False, True))
    assert 0 < np.abs(individuals - minima).max() < 0.2


def test_a_solver_without_population_is_declined():
    with pytest.raises(Incompatible, match=r"solver: expected one that keeps its last population, .* keeps none; use"):
        solve(NemoNiching(), scene(), RandomSearch())
