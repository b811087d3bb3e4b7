"""Grid and refinement: a greedy search on a coarse grid, followed by a local search over all sources."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar, final

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

from nfbench import Formulation, Ge, Gt, Instance, Le, Minimize

from ..enumeration import Criterion, Sources, how_many
from ..geometry import direction_derivatives
from ..instance import NearFieldInstance
from ..objectives import kernels
from ..objectives.subspace_fitting import SubspaceFit
from ..scenario import NearField
from ..subspace import compress, signal_subspace
from ..wavefronts import Manifold, Wavefront
from .music import SLOW_S, search_s
from .refinement import refine, resolution

__all__ = ["GridRefine", "resolution_grid"]

MANY = 10**8  # grid points that may not fit in memory
SAMPLES = 61  # directions along each angle at which the beamwidth is computed


@final
@dataclass(frozen=True)
class GridRefine(Formulation):
    """ESF minimized by a grid search and local refinement: a baseline for global optimizers.

    Sources are chosen one by one from a grid whose spacing matches the resolution of the array. Each is placed where it
    reduces ESF most, given the sources chosen before (orthogonal least squares; Chen, Billings & Luo 1989). All sources
    are then refined together by L-BFGS-B. After that, as in alternating projection (Ziskind & Wax 1988), each source in
    turn is chosen again given the others and all are refined again, until a sweep over the sources brings no
    improvement.

    density: number of grid points per beamwidth in each angle, and per depth of focus in inverse range.
    sweeps: maximum number of sweeps, in each of which every source is chosen again once.
    wavefront: wavefront model that the estimator assumes, "exact", "fresnel", "paper" or "planar"; None: that of the
        scenario.
    sources: number of sources to search for: "known" is the true number, "estimate" is an estimate from the data by
        ``criterion``, and an integer is used as given, even if it is wrong.
    criterion: criterion by which the number of sources is estimated: "aic", "mdl" or "ne" (Nadakuditi & Edelman); used
        only if ``sources`` is "estimate".
    """

    accepts: ClassVar[type[Instance]] = NearFieldInstance
    needs_solver: ClassVar[bool] = False

    density: Annotated[float, Gt(0.0), Le(100.0)] = 2.0
    sweeps: Annotated[int, Ge(0)] = 5
    wavefront: Wavefront | None = None
    sources: Sources = "known"
    criterion: Criterion = "ne"

    def warnings(self, scenario: NearField) -> list[str]:
        counts = _grid_size(scenario.manifold(), *scenario.box(), self.density)
        M, K, points = scenario.array.count, scenario.sources, math.prod(counts)
        searches = 2 * K * (1 + min(self.sweeps, 2)) - 1  # one for the first source; two to exclude others
        seconds = search_s(points, M, K) * searches
        size = f"{' × '.join(map(str, counts))} points"
        if points > MANY:
            return [f"density: {self.density:g} gives a grid of about {size}, which may not fit in memory; reduce it"]
        if seconds <= SLOW_S or self.density != type(self).density:
            return []
        text = f"density: the default, {self.density:g}, gives a grid of about {size}"
        return [f"{text}, which takes about {seconds:,.0f} s per run with {M} elements and {K} sources; reduce it"]

    def solve(self, instance: NearFieldInstance, minimize: Minimize) -> Float[ndarray, "k d"]:
        """Return the sources (K, d) [rad, m]; raises Incompatible if there are fewer snapshots than sources."""
        K = how_many(instance, self.sources, self.criterion)
        if K == 0:
            return np.empty((0, instance.manifold.dimension))
        manifold = instance.manifold.under(self.wavefront)
        U_s = signal_subspace(instance.Y, K)
        esf = SubspaceFit(U_s, manifold, instance.lower, instance.upper)
        grid = resolution_grid(manifold, instance.lower, instance.upper, self.density)

        theta = np.empty((0, manifold.dimension))
        for _ in range(K):
            theta = np.vstack([theta, grid[np.argmax(_gains(U_s, manifold, theta, grid))]])
        theta = refine(esf, theta.ravel(), manifold).reshape(K, -1)
        best = esf.value(theta.ravel())
        for _ in range(self.sweeps):
            before = best
            for k in range(K):
                others = np.delete(theta, k, axis=0)
                new = grid[np.argmax(_gains(U_s, manifold, others, grid))]
                trial = refine(esf, np.insert(others, k, new, axis=0).ravel(), manifold)
                value = esf.value(trial)
                if value < best:
                    theta, best = trial.reshape(K, -1), value
            if best > before - 1e-9:
                break
        return theta


def resolution_grid(
    manifold: Manifold, lower: Float[ndarray, " d"], upper: Float[ndarray, " d"], density: float
) -> Float[ndarray, "p d"]:
    """Return a grid of points (p, d) [rad, m] in the box, including its ends.

    The beamwidth at direction u in an angle is λ/E, where E is the extent of q_m·∂u/∂angle over the array; for a ULA
    the points are therefore uniform in sinφ. The spacing of elevations is fine enough for every azimuth, and vice
    versa.

    manifold: array and wavefront model.
    lower: lower bounds of one source [rad, m], shape (d,).
    upper: upper bounds of one source [rad, m], shape (d,).
    density: number of grid points per beamwidth in each angle, and per depth of focus in inverse range.
    """
    axes = []
    for axis, beamwidths in _beamwidths(manifold, lower, upper):
        axes.append(np.interp(_uniform(0.0, beamwidths[-1], density), beamwidths, axis))
    depth = resolution(manifold)[1]
    axes.append(1 / (_uniform(1 / upper[-1] / depth, 1 / lower[-1] / depth, density) * depth))
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(lower))


def _beamwidths(
    manifold: Manifold, lower: Float[ndarray, " d"], upper: Float[ndarray, " d"]
) -> list[tuple[Float[ndarray, " samples"], Float[ndarray, " samples"]]]:
    """Return, for each angle, samples of it [rad] and the number of beamwidths from the first of them to each."""
    angles = manifold.dimension - 1
    fine = [np.linspace(low, high, SAMPLES) for low, high in zip(lower[:angles], upper[:angles], strict=True)]
    directions = np.stack([*np.meshgrid(*fine, indexing="ij"), np.ones([SAMPLES] * angles)], axis=-1)
    slopes = direction_derivatives(directions.reshape(-1, angles + 1)) @ manifold.positions.T  # q_m·∂u [m/rad]
    beams = np.ptp(slopes, axis=-1).reshape(*[SAMPLES] * angles, angles) / manifold.wavelength_m  # [1/rad]
    found = []
    for i, axis in enumerate(fine):
        rate = beams[..., i].max(axis=tuple(j for j in range(angles) if j != i))
        found.append((axis, np.concatenate([[0.0], np.cumsum((rate[1:] + rate[:-1]) / 2 * np.diff(axis))])))
    return found


def _grid_size(
    manifold: Manifold, lower: Float[ndarray, " d"], upper: Float[ndarray, " d"], density: float
) -> list[int]:
    """Return about how many points ``resolution_grid`` has along each side, from the outermost elements."""
    Q = manifold.positions
    outermost = np.unique(np.argmax(Q @ (np.indices((3, 3, 3)).reshape(3, -1) - 1), axis=0))
    few = Manifold(Q[outermost], manifold.wavelength_m, manifold.wavefront, manifold.has_elevation)
    extents = [beamwidths[-1] for _, beamwidths in _beamwidths(few, lower, upper)]
    extents.append((1 / lower[-1] - 1 / upper[-1]) / resolution(manifold)[1])
    return [max(math.ceil(extent * density), 1) + 1 for extent in extents]


def _uniform(first: float, last: float, density: float) -> Float[ndarray, " n"]:
    return np.linspace(first, last, max(math.ceil((last - first) * density), 1) + 1)


def _gains(
    U_s: Complex[ndarray, "m k"], manifold: Manifold, theta: Float[ndarray, "j d"], grid: Float[ndarray, "p d"]
) -> Float[ndarray, " p"]:
    """Return ‖U_sᴴP⊥a‖²/‖P⊥a‖² of each grid point, by which it would lower ESF if added to the sources ``theta``."""
    M = manifold.elements
    if not len(theta):
        return kernels.projected_energy(*manifold.packed, kernels.pack_rows(compress(U_s)), grid) / M
    Q = np.linalg.qr(manifold.response(theta).T).Q
    residual = U_s - Q @ (Q.conj().T @ U_s)
    gained = kernels.projected_energy(*manifold.packed, kernels.pack_rows(compress(residual)), grid)
    norm = M - kernels.projected_energy(*manifold.packed, kernels.pack_rows(compress(Q)), grid)
    return np.where(norm > 1e-6 * M, gained / np.maximum(norm, 1e-6 * M), 0.0)
