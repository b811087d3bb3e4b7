"""The search over several frequency bins: as for one, with the misfits and their derivatives added over the bins."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Complex, Float, Int
from numpy import ndarray

from ..geometry import cartesian
from ..objectives.conditional_fit import ConditionalFit
from ..objectives.sum_of_fits import SumOfFits
from ..wavefronts import Manifold
from . import general, kernels
from .grid import resolution_grid
from .levenberg_marquardt import Box, State, minimize
from .local_search import LocalMinimum, unit_of

__all__ = ["BandFit", "covariance_of_bands", "search_bands_greedily", "search_bands_locally"]

CANDIDATES = 2000  # grid points among which lobes are distinguished
LOBES = 6  # from which a source is searched
PROMISING = 0.9  # gain of a lobe on the finer grid, relative to the best, from which it is searched
FINER = 7  # points of the finer grid along each axis
LOBE = 0.6  # range of the path differences over the array within the main lobe, in wavelengths; its null is at 1
CERTAIN = 1e-10  # least pivot of AᴴA, relative to M, and least eigenvalue of the scaled curvature for a covariance


class BandFit(NamedTuple):
    """What is fitted in one frequency bin: a factor of its data, and the array at its wavelength."""

    F: Complex[ndarray, "m c"]
    manifold: Manifold


def _at(fits: Sequence[BandFit], unit: Float[ndarray, " d"], x: Float[ndarray, " n"]) -> State:
    """Return the sum over the bins, and the least pivot of AᴴA in any of them."""
    J, g, H, pivot = zip(*[_in_bin(fit.F, fit.manifold, unit, x) for fit in fits], strict=True)
    return State(sum(J), np.sum(g, axis=0), np.sum(H, axis=0), min(pivot))


def _in_bin(
    F: Complex[ndarray, "m c"], manifold: Manifold, unit: Float[ndarray, " d"], x: Float[ndarray, " n"]
) -> tuple[float, Float[ndarray, " n"], Float[ndarray, "n n"], float]:
    """Return J of one bin, half of its gradient and curvature, and the least pivot of AᴴA."""
    if manifold.has_unit_modulus:
        J, g, H, pivot = kernels.misfit_and_derivatives(*manifold.packed, F, unit, x)
    else:
        J, g, H, pivot = general.derivatives(manifold, F, x, unit)
    return J, g, H, pivot


def search_bands_locally(
    fits: Sequence[BandFit],
    lower: Float[ndarray, " d"],
    upper: Float[ndarray, " d"],
    x: Float[ndarray, " n"],
    fixed: int = 0,
) -> LocalMinimum:
    """Return a local minimizer of Σ_f ‖(I − P_A,f)F_f‖² within the box; see ``search_locally``, whose steps these are.

    Coordinates are measured in the beamwidths and depths of focus of the shortest wavelength.

    fits: what is fitted in each bin.
    lower: lower bounds of one source [rad, m], shape (d,).
    upper: upper bounds of one source [rad, m], shape (d,).
    x: starting point [rad, m], shape (K·d,), inside the box.
    fixed: number of sources at the beginning of x that keep their positions.
    """
    kernels.warm_up()
    unit = unit_of(_shortest(fits))
    energy = sum(float(np.vdot(F, F).real) for F, _ in fits)
    found, state, steps = minimize(
        lambda x: _at(fits, unit, x), Box(lower, upper, unit, len(x)), x, fixed * len(lower), energy
    )
    return LocalMinimum(found, state.J, state.H, steps, state.pivot)


def _shortest(fits: Sequence[BandFit]) -> Manifold:
    return min((manifold for _, manifold in fits), key=lambda manifold: manifold.wavelength_m)


def search_bands_greedily(
    fits: Sequence[BandFit],
    lower: Float[ndarray, " d"],
    upper: Float[ndarray, " d"],
    sources: int,
    density: float,
    sweeps: int,
) -> LocalMinimum:
    """Return a minimizer of Σ_f ‖(I − P_A,f)F_f‖² within the box, found as by ``search_greedily``.

    The grid is that of the shortest wavelength, which has the finest beams. Where the elements are far apart, a source
    has aliases that differ from it by less than a point of the grid from its peak: each choice is the best of the local
    minima near several points.

    fits: what is fitted in each bin.
    lower: lower bounds of one source [rad, m], shape (d,).
    upper: upper bounds of one source [rad, m], shape (d,).
    sources: number K of sources.
    density: number of grid points per beamwidth and depth of focus.
    sweeps: maximum number of sweeps, in each of which every source is chosen again once.
    """
    array = _shortest(fits)
    points = resolution_grid(array, lower, upper, density)

    def choose(others: Float[ndarray, "k d"]) -> Float[ndarray, " d"]:
        """Return where one more source lowers the misfit most, given the other sources."""
        misfit = SumOfFits(ConditionalFit(F, manifold, lower, upper, others) for F, manifold in fits)
        J = misfit.evaluate(points)
        near = [_around(array, point, density, lower, upper) for point in _lobes(array, points[_least(J, CANDIDATES)])]
        values = [misfit.evaluate(each) for each in near]
        gains = J.max() - np.array([each.min() for each in values])
        starts = [each[np.argmin(value)] for each, value in zip(near, values, strict=True)]
        ends = [
            search_bands_locally(fits, lower, upper, np.append(others, start), fixed=len(others))
            for start, gain in zip(starts, gains, strict=True)
            if gain >= PROMISING * gains.max()
        ]
        best: ndarray = min(ends, key=lambda end: end.value).x[others.size :]
        return best

    theta = np.empty((0, len(lower)))
    for _ in range(sources):
        theta = np.vstack([theta, choose(theta)])
    best = search_bands_locally(fits, lower, upper, theta.ravel())
    for _ in range(sweeps):
        before = best.value
        for k in range(sources):
            theta = best.x.reshape(sources, -1).copy()
            point = choose(np.delete(theta, k, axis=0))
            if _in_lobe(array, point, theta[k : k + 1]).any():
                continue
            theta[k] = point
            trial = search_bands_locally(fits, lower, upper, theta.ravel())
            if trial.value < best.value:
                best = trial
        if not best.value < before * (1 - 1e-9):
            break
    return best


def _least(J: Float[ndarray, " p"], count: int) -> Int[ndarray, " count"]:
    """Return the indices of the smallest values in ascending order."""
    chosen = np.argpartition(J, count)[:count] if len(J) > count else np.arange(len(J))
    ascending: ndarray = chosen[np.argsort(J[chosen], kind="stable")]
    return ascending


def _lobes(array: Manifold, points: Float[ndarray, "p d"]) -> list[Float[ndarray, " d"]]:
    """Return the first of the points, and those that follow in other lobes, at most LOBES."""
    found = points[:1]
    while len(found) < LOBES and len(points):
        points = points[~_in_lobe(array, found[-1], points)]
        found = np.vstack([found, points[:1]])
    return list(found)


def _around(
    array: Manifold,
    point: Float[ndarray, " d"],
    density: float,
    lower: Float[ndarray, " d"],
    upper: Float[ndarray, " d"],
) -> Float[ndarray, "p d"]:
    """Return a finer grid around a grid point, as far as its neighbours."""
    unit = unit_of(array)
    offsets = np.stack(np.meshgrid(*[np.linspace(-1, 1, FINER)] * len(point), indexing="ij"), axis=-1) * unit / density
    fine = point + offsets.reshape(-1, len(point))
    inverse = np.clip(1 / point[-1] + offsets[..., -1].ravel(), 1 / upper[-1], 1 / lower[-1])
    fine[:, -1] = 1 / inverse
    return np.clip(fine, lower, upper)


def _in_lobe(array: Manifold, source: Float[ndarray, " d"], points: Float[ndarray, "p d"]) -> Bool[ndarray, " p"]:
    """Whether points are in the main lobe of a source: a local search from there may end at it.

    Aliases are in other lobes, although their responses are alike: what counts is the path, not its phase.
    """
    ahead = [np.linalg.norm(cartesian(each)[..., None, :] - array.positions, axis=-1) for each in (source, points)]
    return np.ptp(ahead[1] - ahead[0], axis=-1) < LOBE * array.wavelength_m


def covariance_of_bands(
    theta: Float[ndarray, "k d"],
    fits: Sequence[BandFit],
    lower: Float[ndarray, " d"],
    upper: Float[ndarray, " d"],
    variances: Sequence[float],
    spreads: Sequence[Complex[ndarray, "m c"]],
) -> Float[ndarray, "kd kd"]:
    """Return the covariance of minimizers of Σ_f ‖(I − P_A,f)F_f‖² for white noise; see ``covariance``.

    The curvature H = Σ_f H_f(F_f) and the covariance Σ_f σ_f²/(2T_f)·H_f(G_f) of the slope are sums over the bins,
    because their data are independent. A bin of weight w, F_f = √w·F, has the spread G_f = w·G.

    theta: estimated sources [rad, m], shape (K, d).
    fits: what was fitted in each bin.
    lower: lower bounds of one source [rad, m], shape (d,); a coordinate on a bound is considered known.
    upper: upper bounds of one source [rad, m], shape (d,).
    variances: σ_f²/(2T_f) of each bin.
    spreads: factor G_f of each bin.
    """
    kernels.warm_up()
    unit, x = unit_of(_shortest(fits)), theta.ravel()
    now = _at(fits, unit, x)
    slopes = [_in_bin(G, fit.manifold, unit, x)[2] for fit, G in zip(fits, spreads, strict=True)]
    meat = np.sum([variance * slope for variance, slope in zip(variances, slopes, strict=True)], axis=0)
    free = ((lower < theta) & (theta < upper)).ravel()
    size = np.sqrt(np.diag(now.H))[free]
    scaled = now.H[np.ix_(free, free)] / np.outer(size, size)
    nothing = np.full((len(x), len(x)), math.nan)
    if not (now.pivot > CERTAIN and np.isfinite(scaled).all() and np.linalg.eigvalsh(scaled).min(initial=1) > CERTAIN):
        return nothing
    inverse = np.linalg.inv(scaled) / np.outer(size, size)
    metres = np.tile(unit, len(theta))
    metres[len(lower) - 1 :: len(lower)] *= -(theta[:, -1] ** 2)  # ∂r/∂z
    C = np.zeros((len(x), len(x)))
    C[np.ix_(free, free)] = inverse @ meat[np.ix_(free, free)] @ inverse
    covariance: ndarray = C * np.outer(metres, metres)
    return covariance
