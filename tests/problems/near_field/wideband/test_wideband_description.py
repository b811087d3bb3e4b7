"""What is said about an estimate from several frequency bins: fit, standard errors and warnings of all of them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import kstest
from wideband_scenes import SPARSE, WIDEBAND, misfit, scene

from nfbench.problems.near_field.bands import bounds_of_bands
from nfbench.problems.near_field.estimators.grid_refine import GridRefine


def described(instance):
    estimate = GridRefine(objective="wsf").solve(instance, None).estimate
    return estimate, instance.describe(estimate, {})


@pytest.fixture(scope="module")
def simulated():
    """The estimates and descriptions of 100 scenes with 3 bins."""
    instances = [scene(seed, WIDEBAND) for seed in range(100)]
    return [(instance, *described(instance)) for instance in instances]


def test_p_values_of_all_bins_together_are_uniform(simulated):
    p = np.array([found.fit["p_value"] for _, _, found in simulated])
    assert kstest(p, "uniform").pvalue > 0.005
    assert not any(found.warnings for _, _, found in simulated[:20])


def test_standard_errors_are_those_of_all_bins(simulated):
    """The errors, in standard errors, have unit variance; standard errors are those of the bound on known powers."""
    ratios = []
    for instance, estimate, found in simulated:
        std = np.array([[np.radians(s["std_azimuth_deg"]), s["std_range_m"]] for s in found.sources])
        bound, _ = bounds_of_bands(instance.bands, instance.theta, 100.0 * np.ones(2))
        order = np.argsort(estimate[:, 0])
        true = np.argsort(instance.theta[:, 0])
        assert std[order].ravel() == pytest.approx(np.sqrt(np.diag(bound)).reshape(2, 2)[true].ravel(), rel=0.35)
        ratios.append(((estimate[order] - instance.theta[true]) / std[order]).ravel())
        assert all(s["snr_db"] == pytest.approx(20.0, abs=1.5) for s in found.sources)
    assert np.mean(np.square(ratios)) == pytest.approx(1.0, abs=0.2)


def test_the_misfit_is_that_of_all_bins():
    instance = scene(1, WIDEBAND)
    estimate, found = described(instance)
    rest = [misfit(band.Y, band.manifold.response(estimate).T) for band in instance.bands]
    assert found.fit["misfit"] == pytest.approx(sum(rest) / sum(np.linalg.norm(band.Y) ** 2 for band in instance.bands))
    assert (found.fit["bins"], found.fit["snapshots"]) == (3.0, 60.0)


def test_bins_that_disagree_about_the_positions_are_noticed():
    """Each bin alone fits its own sources perfectly."""
    first, second = scene(1, WIDEBAND), scene(2, WIDEBAND)
    mixed = replace(first, further=second.further)
    texts = described(mixed)[1].warnings
    assert any(text.startswith("the model does not fit") for text in texts)


def test_aliases_of_one_frequency_are_not_named_if_there_are_others():
    many, alone = scene(0, SPARSE, bandwidth_relative=0.2), scene(0, SPARSE, bins=1)
    assert any("is ambiguous" in text for text in alone.describe(alone.theta, {}).warnings)
    assert not any("is ambiguous" in text for text in many.describe(many.theta, {}).warnings)


def test_damage_in_any_bin_is_named():
    instance = scene(1, WIDEBAND)
    second = instance.further[0]
    damaged = second.Y.copy()
    damaged[3, 7] = np.nan
    broken = replace(instance, further=(replace(second, Y=damaged), *instance.further[1:]))
    assert "first at element 3, snapshot 7" in broken.describe(instance.theta, {}).warnings[0]
