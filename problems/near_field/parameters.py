"""Errors and bounds of the single parameters of a source: azimuth, elevation and range."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from .rounding import CERTAIN

__all__ = ["parameter_bounds", "parameter_deviations", "parameter_errors", "parameter_scores", "wrapped"]

_NAMES = {2: (("azimuth", "deg"), ("range", "m")), 3: (("azimuth", "deg"), ("elevation", "deg"), ("range", "m"))}


def wrapped(theta: Float[ndarray, "*p d"]) -> Float[ndarray, "*p d"]:
    """Return the same positions with a range >= 0, an elevation in [−π/2, π/2] and an azimuth of any turn [rad, m].

    theta: sources ``[azimuth, (elevation,) range]`` with any numbers [rad, m].
    """
    theta = np.array(theta, dtype=np.float64)
    if (theta[..., -1] >= 0).all() and (theta.shape[-1] == 2 or (np.abs(theta[..., 1]) <= math.pi / 2).all()):
        return theta
    behind = theta[..., -1] < 0
    theta[..., -1] = np.abs(theta[..., -1])
    if theta.shape[-1] == 3:
        elevation = np.where(behind, -theta[..., 1], theta[..., 1])
        elevation -= 2 * math.pi * np.round(elevation / (2 * math.pi))
        over = np.abs(elevation) > math.pi / 2  # beyond a pole, where the azimuth jumps by half a turn
        theta[..., 1] = np.where(over, np.copysign(math.pi, elevation) - elevation, elevation)
        behind = behind ^ over
    theta[..., 0] += np.where(behind, math.pi, 0.0)
    return theta


def parameter_errors(truth: Float[ndarray, "k d"], matched: Float[ndarray, "k d"]) -> Float[ndarray, "k d"]:
    """Return the signed errors θ̂ − θ of estimates [rad, m]; NaN where there is no estimate.

    Errors of the azimuth lie in [−π, π]. They are NaN for a source on the z axis, which has no azimuth, but not for an
    estimate there, as its azimuth is what was estimated.

    truth: true sources [rad, m], shape (K, d).
    matched: estimate assigned to each of them [rad, m]; a row of NaN where there is none.
    """
    truth = wrapped(truth)
    errors = wrapped(matched) - truth
    errors[:, 0] -= 2 * math.pi * np.round(errors[:, 0] / (2 * math.pi))
    errors[_has_no_azimuth(truth), 0] = math.nan
    return errors


def parameter_scores(truth: Float[ndarray, "k d"], matched: Float[ndarray, "k d"]) -> dict[str, float]:
    """Return the errors of the parameters of an estimate, by column name.

    azimuth_rmse_deg, elevation_rmse_deg, range_rmse_m: root mean squares over the sources that have an estimate; NaN if
        there is none. In the plane, there is no elevation.
    azimuth_error_1_deg, elevation_error_1_deg, range_error_1_m, azimuth_error_2_deg, …: signed errors of the true
        sources in their order: above 0 if the estimate is too large. NaN for a source without an estimate.

    The arguments are those of ``parameter_errors``.
    """
    errors = _in_degrees(parameter_errors(truth, matched))
    known, names = ~np.isnan(errors), _NAMES[errors.shape[1]]
    squares = np.where(known, errors, 0.0) ** 2
    with np.errstate(invalid="ignore"):
        means = np.sqrt(squares.sum(axis=0) / known.sum(axis=0))
    scores = {f"{name}_rmse_{unit}": float(mean) for (name, unit), mean in zip(names, means, strict=True)}
    for k, row in enumerate(errors.tolist(), start=1):
        for (name, unit), error in zip(names, row, strict=True):
            scores[f"{name}_error_{k}_{unit}"] = error
    return scores


def parameter_deviations(covariance: Float[ndarray, "kd kd"], theta: Float[ndarray, "k d"]) -> Float[ndarray, "k d"]:
    """Return the standard deviation of each parameter [rad, m]; that of an azimuth on the z axis is inf.

    covariance: covariance of θ̂, or a bound on it, in the order of ``theta.ravel()`` [rad, m], shape (Kd, Kd).
    theta: sources [rad, m], shape (K, d).
    """
    deviations = np.sqrt(np.diag(covariance)).reshape(theta.shape)
    deviations[_has_no_azimuth(theta), 0] = math.inf
    return deviations


def parameter_bounds(covariance: Float[ndarray, "kd kd"], theta: Float[ndarray, "k d"]) -> dict[str, float]:
    """Return the bounds of the parameters, by column name.

    crb_azimuth_deg, crb_elevation_deg, crb_range_m: root mean squares of the bounds over the sources.
    crb_azimuth_1_deg, crb_elevation_1_deg, crb_range_1_m, crb_azimuth_2_deg, …: bounds of the individual sources.

    All are inf if the sources cannot be distinguished, and that of an azimuth on the z axis always is. Bounds do not
    know that angles are periodic: an error of an azimuth is at most 180°, and on average about 104° if it is random.

    The arguments are those of ``parameter_deviations``.
    """
    deviations = _in_degrees(parameter_deviations(covariance, theta))
    names = _NAMES[theta.shape[1]]
    means = np.sqrt(np.mean(deviations**2, axis=0))
    bounds = {f"crb_{name}_{unit}": float(mean) for (name, unit), mean in zip(names, means, strict=True)}
    for k, row in enumerate(deviations.tolist(), start=1):
        for (name, unit), deviation in zip(names, row, strict=True):
            bounds[f"crb_{name}_{k}_{unit}"] = deviation
    return bounds


def _has_no_azimuth(theta: Float[ndarray, "k d"]) -> ndarray:
    """Whether each source lies on the z axis, up to rounding."""
    if theta.shape[1] == 2:
        return np.zeros(len(theta), dtype=bool)
    on_axis: ndarray = np.abs(np.cos(theta[:, 1])) <= CERTAIN * np.finfo(np.float64).eps
    return on_axis


def _in_degrees(values: Float[ndarray, "k d"]) -> Float[ndarray, "k d"]:
    return np.hstack([np.degrees(values[:, :-1]), values[:, -1:]])
