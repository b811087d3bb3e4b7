"""The number of sources: estimates compared with the printed formulas, and the options of the formulations."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nfbench import Incompatible
from nfbench.core.options import build
from nfbench.problems.near_field.channels import complex_normal
from nfbench.problems.near_field.enumeration import estimate_sources, how_many
from nfbench.problems.near_field.scenario import NearField

MANIFEST = {
    "array": {"kind": "ula", "elements": 16, "spacing_wavelengths": 0.5, "origin": "center"},
    "wavelength_m": 0.02,
    "sources": 2,
    "snapshots": 100,
    "snr_db": 10.0,
    "azimuth_deg": [-60, 60],
    "range_m": [0.3, 3.0],
    "min_separation_deg": 15.0,
}


def counted(criterion: str, scenes: int = 200, **changes) -> np.ndarray:
    """Return the estimated number of sources in each of many scenes."""
    scenario = build(NearField, MANIFEST | changes)
    return np.array([estimate_sources(scenario.draw(np.random.default_rng(i)).Y, criterion) for i in range(scenes)])


def literally(Y: np.ndarray, criterion: str) -> int:
    """Return the estimate by the printed formulas, term by term; few enough eigenvalues that no product overflows."""
    M, T = Y.shape
    l = sorted(np.linalg.eigvalsh(Y @ Y.conj().T / T), reverse=True)  # noqa: E741
    values = []
    for k in range(min(M, T)):
        rest = l[k:]
        if criterion == "ne":
            t = M * ((M - k) * sum(x**2 for x in rest) / sum(rest) ** 2 - (1 + M / T))
            values.append((T / M) ** 2 * t**2 / 2 + 2 * (k + 1))
        else:
            ratio = math.prod(rest) ** (1 / (M - k)) / (sum(rest) / (M - k))
            likelihood = -T * (M - k) * math.log(ratio)
            penalty = {"aic": 2 * k * (2 * M - k), "mdl": k * (2 * M - k) * math.log(T) / 2}[criterion]
            values.append({"aic": 2, "mdl": 1}[criterion] * likelihood + penalty)
    return values.index(min(values))


@settings(deadline=None, database=None, derandomize=True, max_examples=60)
@given(
    seed=st.integers(0, 2**32 - 1),
    M=st.integers(3, 12),
    T=st.integers(2, 60),
    K=st.integers(0, 4),
    power=st.sampled_from([0.3, 1.0, 10.0]),
    criterion=st.sampled_from(["aic", "mdl", "ne"]),
)
def test_the_number_minimizes_the_printed_formula(seed, M, T, K, power, criterion):
    rng = np.random.default_rng(seed)
    Y = math.sqrt(power) * complex_normal(rng, (M, K)) @ complex_normal(rng, (K, T)) + complex_normal(rng, (M, T))
    if criterion != "ne" and T < M:
        words = rf'criterion: expected "ne", because there are fewer snapshots \({T}\) than antennas \({M}\)'
        with pytest.raises(Incompatible, match=words):
            estimate_sources(Y, criterion)
    else:
        found = estimate_sources(Y, criterion)
        assert found == literally(Y, criterion)
        assert found == estimate_sources(1e6 * Y, criterion)  # the power of the noise does not matter


@pytest.mark.parametrize("snr_db", [10.0, pytest.param(20.0, marks=pytest.mark.slow)])
def test_mdl_and_ne_count_separated_sources_correctly(snr_db):
    assert np.mean(counted("mdl", snr_db=snr_db) == 2) >= 0.99
    assert np.mean(counted("ne", snr_db=snr_db) == 2) >= 0.95


def test_aic_sometimes_overestimates():
    found = counted("aic", snapshots=1000)
    assert found.min() == 2
    assert 0.02 < np.mean(found > 2) < 0.2


def test_pure_noise_has_no_source():
    assert (counted("mdl", snr_db=-60.0) == 0).all()
    assert np.mean(counted("ne", snr_db=-60.0) == 0) >= 0.9
    assert np.mean(counted("aic", snr_db=-60.0) == 0) >= 0.9


def test_ne_works_with_fewer_snapshots_than_antennas():
    found = counted("ne", snapshots=10)
    assert found.min() >= 2
    assert np.mean(found == 2) >= 0.8
    assert np.mean(counted("ne", snapshots=10, snr_db=-60.0) == 0) >= 0.9


def test_many_antennas_cause_no_overflow():
    """The product of 256 noise eigenvalues underflows to 0 for the noise power 1e-8 and overflows for 1e8."""
    rng = np.random.default_rng(0)
    Y = complex_normal(rng, (256, 300)) + np.outer(complex_normal(rng, (256,)), complex_normal(rng, (300,)))
    for scale in (1e-4, 1.0, 1e4):
        assert [estimate_sources(scale * Y, criterion) for criterion in ("aic", "mdl", "ne")] == [1, 1, 1]


@pytest.mark.parametrize("Y", [np.full((4, 9), np.nan + 0j), np.zeros((4, 9), complex), np.full((4, 9), np.inf + 0j)])
def test_noiseless_or_nonfinite_data_are_refused(Y):
    for criterion in ("mdl", "ne"):
        with pytest.raises(ValueError, match="Y: expected finite data with noise in every direction"):
            estimate_sources(Y, criterion)


def test_the_number_is_known_assumed_or_estimated():
    instance = build(NearField, MANIFEST).draw(np.random.default_rng(0))
    assert how_many(instance, "known", "ne") == 2
    assert how_many(instance, 5, "ne") == 5
    quiet = build(NearField, MANIFEST | {"snr_db": -60.0}).draw(np.random.default_rng(0))
    assert (how_many(instance, "estimate", "mdl"), how_many(quiet, "estimate", "mdl")) == (2, 0)
    with pytest.raises(Incompatible, match="sources: expected fewer than the 16 elements, got 16"):
        how_many(instance, 16, "ne")
