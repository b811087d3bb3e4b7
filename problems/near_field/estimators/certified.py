"""The certified minimum: a fast search for all sources, and a proof that no other configuration lies lower."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

from nfbench import Formulation, Incompatible, Instance, Minimize, Reference, Solution

from .. import search
from ..array_instance import ArrayInstance
from ..bands import one_band
from ..calibration import calibrated
from ..certificate import Certificate, certify, certify_one_source, unproven
from ..certificate import warm_up as warm_up_certificate
from ..enumeration import Criterion, Sources, how_many
from ..subspace import decompose
from ..wavefronts import Amplitude, Manifold, Wavefront

__all__ = ["Certified", "certified_first_source", "certified_minimum"]

DENSITIES = (1.5, 3.0)  # of the grid, in points per beamwidth; the second one where the proof fails with the first
SWEEPS = 5
GAP = 1e-8  # proven for RLS, relative to the energy that the source explains
STARTS = 5  # searches for one source, each from a better point that the proof before it has found


@final
@dataclass(frozen=True)
class Certified(Formulation):
    """ESF minimized by a fast search, with a proof that the result is the global minimum over the whole box.

    The sources are found as by ``grid-refine``. If J is their misfit, every source of every configuration that is as
    good lies where the signal subspace is nearly as close to its response. Branch and bound confines this set to small
    regions. It is then proven that each of them holds one source, and that J has one minimum there. The page "Proof of
    a global minimum" of the documentation (docs/certificate.md) has the proofs. They hold for exact, Fresnel and the
    paper's wavefronts and any array, up to the rounding of the signal subspace. They say nothing about the error of the
    positions.

    The result is stored in columns, besides the standard errors that ``grid-refine`` stores:

    certified: 1 if the minimum is proven, else 0.
    certified_gap: proven upper bound of J minus the minimum of J over the box.
    certificate_step: number of the step at which the proof failed, 0 if it did not.
    regions: number of regions of the box that may hold a source.
    certificate_evaluations: number of evaluations of the distance between a response and the signal subspace.

    wavefront: wavefront model that the estimator assumes, "exact", "fresnel" or "paper"; None: that of the scenario.
    sources: number of sources to search for: "known" is the true number, "estimate" is an estimate from the data by
        ``criterion``, and an integer is used as given, even if it is wrong.
    criterion: criterion by which the number of sources is estimated: "aic", "mdl" or "ne" (Nadakuditi & Edelman); used
        only if ``sources`` is "estimate".
    known_gains: whether the estimator knows the gains and phases of the elements.
    known_coupling: whether the estimator knows the mutual coupling of the elements.
    known_noise: whether the estimator knows the covariance of the noise, and whitens the data with it.
    known_failed: whether the estimator knows which elements have failed, and leaves them out.
    known_positions: whether the estimator knows the true positions of the elements.
    amplitude: amplitude over the array that the estimator assumes, "constant", or "spherical", which is r/‖p − q_m‖.
    """

    accepts: ClassVar[type[Instance]] = ArrayInstance  # type: ignore[type-abstract]  # any subclass
    needs_solver: ClassVar[bool] = False

    wavefront: Wavefront | None = None
    sources: Sources = "known"
    criterion: Criterion = "ne"
    known_gains: bool = False
    known_coupling: bool = False
    known_noise: bool = False
    known_failed: bool = False
    known_positions: bool = False
    amplitude: Amplitude = "constant"

    def warm_up(self) -> None:
        search.warm_up()
        warm_up_certificate()

    def solve(self, instance: ArrayInstance, minimize: Minimize) -> Solution:
        """Return the sources (K, d) [rad, m] with the columns above.

        Raises Incompatible if there are fewer snapshots than sources, if the wavefront is planar, or if there are
        several frequency bins.
        """
        one_band(instance.bands, "certified", "as the proofs hold for one wavelength")
        K = how_many(instance, self.sources, self.criterion, self)
        if K == 0:
            return Solution(np.empty((0, instance.manifold.dimension)))
        (Y, manifold), box = calibrated(instance, self)[0].received, (instance.lower, instance.upper)
        U_s, eigenvalues, noise = decompose(Y, K)
        found = certified_minimum(U_s, manifold, *box)
        deviation, excess = np.sqrt(eigenvalues), eigenvalues - noise
        spread = U_s * np.divide(deviation, excess, out=np.full(K, np.nan), where=excess > 0)
        errors = search.standard_errors(found.theta, manifold, *box, U_s, noise, instance.Y.shape[1], spread)
        columns = {
            "certified": float(found.certified),
            "certified_gap": found.gap,
            "certificate_step": float(found.step),
            "regions": float(found.regions),
            "certificate_evaluations": float(found.evaluations),
        }
        return Solution(found.theta, columns | errors)


def certified_minimum(
    U_s: Complex[ndarray, "m k"], manifold: Manifold, lower: Float[ndarray, " d"], upper: Float[ndarray, " d"]
) -> Certificate:
    """Return the best configuration that the search finds, and what is proven about it.

    Where the proof fails, the search is repeated once on a finer grid, in case it had not found the minimum. Raises
    Incompatible if the wavefront is planar.
    """
    if not manifold.has_unit_modulus:
        raise Incompatible(
            "known_gains, known_coupling, known_noise, amplitude: expected responses of modulus 1, for which the proof "
            "holds, got others; known phases, positions and failed elements are allowed"
        )
    if manifold.wavefront == "planar":
        raise Incompatible("wavefront: expected one in which the range has an effect, got planar")
    best: Certificate | None = None
    for density in DENSITIES:
        grid = search.response_grid(manifold, lower, upper, density)
        found = search.search_greedily(U_s, grid, U_s.shape[1], SWEEPS)
        theta = found.x.reshape(U_s.shape[1], -1)
        if best is not None and found.value >= best.J * (1 - 1e-9):
            break
        try:
            best = certify(U_s, manifold, lower, upper, theta)
        except Incompatible:
            best = unproven(theta, found.value)
        if best.certified:
            break
    assert best is not None
    return best


def certified_first_source(
    L: Complex[ndarray, "m c"], manifold: Manifold, lower: Float[ndarray, " d"], upper: Float[ndarray, " d"]
) -> Reference | None:
    """Return the proven optimum of RLS over one source, of the data or of any factor of them, to a stated gap.

    None if responses have another modulus than 1, for which no proof is known.

    Raises Incompatible where no bound of the phases is known.
    """
    if not manifold.has_unit_modulus:
        return None
    grid = search.response_grid(manifold, lower, upper, DENSITIES[-1])
    theta = search.search_greedily(L, grid, 1, SWEEPS).x
    best = certify_one_source(L, manifold, lower, upper, theta, GAP)
    for _ in range(STARTS - 1):
        if best.certified:
            break
        theta = search.search_locally(L, manifold, lower, upper, best.theta).x
        best = certify_one_source(L, manifold, lower, upper, theta, GAP)
    columns = {"certificate_evaluations": float(best.evaluations)}
    return Reference(best.J, best.gap, best.certified, best.theta, 0 if best.certified else 1, columns)
