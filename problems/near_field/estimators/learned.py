"""Learned: a small neural network reads the sources from the spectrum of the signal subspace."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nfbench import Formulation, Incompatible, Instance, Minimize

from ..array_instance import ArrayInstance
from ..bands import one_band
from ..calibration import calibrated
from ..enumeration import Criterion, Sources, how_many
from ..learned import Network, from_polar, load_network, training_scenario
from ..objectives.rls import RLS
from ..search import warm_up as warm_up_search
from ..subspace import signal_subspace
from ..wavefronts import Amplitude, Manifold, Wavefront
from .refinement import refine

__all__ = ["Learned"]

SAME_SOURCE = 0.5  # steps of the grid in u between two proposals below which they are one source
PLACE = 1e-6  # [wavelengths] to which elements must be where they were in training
MARGIN = 1e-9  # of the box, for rounding


@final
@dataclass(frozen=True)
class Learned(Formulation):
    """A convolutional network from the signal subspace to sources, in place of a search.

    As in Ramezani, Mousavirad, O'Nils & Björnson 2025 (arXiv:2506.17810), a network learns the map from the
    eigenvectors of the covariance to the positions. Here it reads them through ‖U_sᴴa‖²/M on a coarse grid of sinφ and
    λ/r, which does not depend on the phases of the eigenvectors. At each sinφ of the grid it says how likely there is a
    source, and where exactly it is. The K best proposals that are no duplicates are the estimate.

    The network was trained for one array: the centred ULA along y of 128 elements at λ/4, with azimuths within ±60° and
    ranges from 63.5 to 1008 wavelengths. Everything else may differ from training: three sources at least 2° apart,
    200 snapshots, 0 to 30 dB, line of sight, wavefront "paper". Two sources at the same angle are detected as one. The
    training needs PyTorch, the estimator does not.

    refine: whether to refine each proposal by a local search of the spectrum, as ``music`` refines its peaks.
    wavefront: wavefront model that the estimator assumes, "exact", "fresnel" or "paper"; None: that of the scenario.
        The network was trained with "paper".
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

    refine: bool = False
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
        warm_up_search()
        load_network()

    def solve(self, instance: ArrayInstance, minimize: Minimize) -> Float[ndarray, "k d"]:
        """Return the sources (K, 2) [rad, m], the likeliest first; fewer if the network proposes fewer.

        Raises Incompatible if the array or the box are not those of the training, if a response does not have modulus
        1 at every element, if there are fewer snapshots than sources, or if there are several frequency bins.
        """
        one_band(instance.bands, "learned", "as the network was trained with one wavelength")
        Y, manifold = calibrated(instance, self)[0].received
        if not np.isfinite(Y).all():
            raise ValueError("Y: expected finite data, got NaN or infinite entries")
        _check(instance, manifold)
        K = how_many(instance, self.sources, self.criterion, self)
        if K == 0:
            return np.empty((0, 2))
        U_s = signal_subspace(Y, K)
        estimate = np.clip(_read(load_network(), U_s, manifold, instance, K), instance.lower, instance.upper)
        if not self.refine:
            return estimate
        spectrum = RLS(U_s, manifold, instance.lower, instance.upper)  # minimal where ‖U_sᴴa‖² is maximal
        return np.reshape([refine(spectrum, theta, manifold) for theta in estimate], estimate.shape)


def _read(
    network: Network, U_s: ndarray, manifold: Manifold, instance: ArrayInstance, count: int
) -> Float[ndarray, "k 2"]:
    """Return the sources that the network proposes, the likeliest first; they may be slightly outside the box."""
    scores, x = network.propose(network.grid.spectrum(U_s, manifold))
    low, high = np.sin([instance.lower[0], instance.upper[0]])
    step = network.grid.step_u
    left = (x[:, 0] >= low - step) & (x[:, 0] <= high + step)
    found: list[ndarray] = []
    while len(found) < count and left.any():
        best = np.argmax(np.where(left, scores, -np.inf))
        found.append(x[best])
        left &= np.abs(x[:, 0] - x[best, 0]) > SAME_SOURCE * step
    return from_polar(np.reshape(found, (-1, 2)), manifold)


def _check(instance: ArrayInstance, manifold: Manifold) -> None:
    """Raise Incompatible if the network was not trained for such data."""
    trained = training_scenario()
    training = trained.manifold()
    if instance.manifold.has_elevation:
        raise Incompatible("elevation_deg: expected none, as the network was trained in the plane, got an interval")
    if not manifold.has_unit_modulus:
        raise Incompatible(
            "known_gains, known_coupling, known_noise, amplitude: expected phases only for learned, whose network was "
            "trained with responses of modulus 1 in white noise, got more; leave these options out"
        )
    if manifold.wavefront == "planar":
        raise Incompatible('wavefront: expected "exact", "fresnel" or "paper" for learned, got "planar"')
    _check_array(instance.manifold, training)
    _check_box(instance, training, *trained.box())


def _check_array(manifold: Manifold, training: Manifold) -> None:
    """Raise Incompatible unless the elements are where they were in training, in wavelengths and in any order."""
    Q, trained = (_sorted(each.positions / each.wavelength_m) for each in (manifold, training))
    expected = 'the ULA of 128 elements at λ/4 with origin "center", for which the network was trained'
    if len(Q) != len(trained):
        raise Incompatible(f"array: expected {expected}, got {len(Q)} elements; grid-refine works with any array")
    if not np.allclose(Q, trained, rtol=0, atol=PLACE):
        raise Incompatible(
            f"array: expected {expected}, got elements up to {np.abs(Q - trained).max():.3g} wavelengths elsewhere; "
            "grid-refine works with any array"
        )


def _sorted(Q: Float[ndarray, "m 3"]) -> Float[ndarray, "m 3"]:
    """The elements in the order of their y."""
    return Q[np.argsort(Q[:, 1], kind="stable")]


def _check_box(instance: ArrayInstance, training: Manifold, lower: ndarray, upper: ndarray) -> None:
    """Raise Incompatible unless the box is within that of the training, with ranges in wavelengths."""
    low, high = np.degrees([lower[0], upper[0]])
    if instance.lower[0] < lower[0] - MARGIN or instance.upper[0] > upper[0] + MARGIN:
        got = np.degrees([instance.lower[0], instance.upper[0]])
        raise Incompatible(
            f"azimuth_deg: expected an interval within [{low:g}, {high:g}], in which the network was trained, "
            f"got [{got[0]:g}, {got[1]:g}]"
        )
    ratio = instance.manifold.wavelength_m / training.wavelength_m
    nearest, farthest = ratio * lower[1], ratio * upper[1]
    if instance.lower[1] < nearest * (1 - MARGIN) or instance.upper[1] > farthest * (1 + MARGIN):
        low, high = np.array([lower[1], upper[1]]) / training.wavelength_m
        raise Incompatible(
            f"range_m: expected an interval within [{nearest:.4g}, {farthest:.4g}], {low:g} to {high:g} wavelengths, "
            f"in which the network was trained, got [{instance.lower[1]:.4g}, {instance.upper[1]:.4g}]"
        )
