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
from ..learned import SETTINGS, Network, Setting, cosines, from_polar, load_network
from ..objectives.rls import RLS
from ..search import warm_up as warm_up_search
from ..subspace import signal_subspace
from ..wavefronts import Amplitude, Manifold, Wavefront
from .refinement import refine

__all__ = ["Learned"]

SAME_SOURCE = 0.5  # steps of the grid in u (and w) between two proposals below which they are one source
PLACE = 1e-6  # [wavelengths] to which elements must be where they were in training
MARGIN = 1e-9  # of the box, for rounding


@final
@dataclass(frozen=True)
class Learned(Formulation):
    """A convolutional network from the signal subspace to sources, in place of a search.

    As in Ramezani, Mousavirad, O'Nils & Björnson 2025 (arXiv:2506.17810), a network learns the map from the
    eigenvectors of the covariance to the positions. Here it reads them through ‖U_sᴴa‖²/M on a coarse grid of
    directions and λ/r, which does not depend on the phases of the eigenvectors. At each direction of the grid it says
    how likely there is a source, and where exactly it is. The K best proposals that are no duplicates are the estimate.

    There are two networks, one for each of two arrays in the centre of the coordinates. The first is for the ULA along
    y of 128 elements at λ/4 in the plane, with azimuths within ±60° and ranges from 63.5 to 1008 wavelengths. It was
    trained with sources at least 2° apart, 200 snapshots and the wavefront "paper". The second is for the UPA of
    16 × 16 elements at λ/2, with azimuths within ±60°, elevations within ±30° and ranges from 22.6 to 128 wavelengths.
    It was trained with sources at least 5° apart, 100 snapshots and the wavefront "exact". Both had three sources in
    line of sight at 0 to 30 dB. Everything but the array and the box may differ from training. Two sources in the same
    direction are detected as one. The training needs PyTorch, the estimator does not.

    refine: whether to refine each proposal by a local search of the spectrum, as ``music`` refines its peaks.
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
        for setting in SETTINGS.values():
            load_network(setting)

    def solve(self, instance: ArrayInstance, minimize: Minimize) -> Float[ndarray, "k d"]:
        """Return the sources (K, d) [rad, m], the likeliest first; fewer if the network proposes fewer.

        Raises Incompatible if there is no network for the array and the box, if a response does not have modulus 1 at
        every element, if there are fewer snapshots than sources, or if there are several frequency bins.
        """
        one_band(instance.bands, "learned", "as the network was trained with one wavelength")
        Y, manifold = calibrated(instance, self)[0].received
        if not np.isfinite(Y).all():
            raise ValueError("Y: expected finite data, got NaN or infinite entries")
        setting = _setting(instance, manifold)
        K = how_many(instance, self.sources, self.criterion, self)
        if K == 0:
            return np.empty((0, manifold.dimension))
        U_s = signal_subspace(Y, K)
        estimate = np.clip(_read(load_network(setting), U_s, manifold, instance, K), instance.lower, instance.upper)
        if not self.refine:
            return estimate
        spectrum = RLS(U_s, manifold, instance.lower, instance.upper)  # minimal where ‖U_sᴴa‖² is maximal
        return np.reshape([refine(spectrum, theta, manifold) for theta in estimate], estimate.shape)


def _read(
    network: Network, U_s: ndarray, manifold: Manifold, instance: ArrayInstance, count: int
) -> Float[ndarray, "k d"]:
    """Return the sources that the network proposes, the likeliest first; they may be slightly outside the box."""
    scores, x = network.propose(network.grid.spectrum(U_s, manifold))
    theta, step = from_polar(x, manifold), network.grid.step_u
    beyond = cosines(theta) - cosines(np.clip(theta, instance.lower, instance.upper))
    left = np.abs(beyond).max(axis=1) <= step
    found: list[int] = []
    while len(found) < count and left.any():
        best = int(np.argmax(np.where(left, scores, -np.inf)))
        found.append(best)
        left &= np.abs(x[:, :-1] - x[best, :-1]).max(axis=1) > SAME_SOURCE * step
    return theta[found]


def _setting(instance: ArrayInstance, manifold: Manifold) -> Setting:
    """Return the setting of the network for such data; raises Incompatible if there is none."""
    if not manifold.has_unit_modulus:
        raise Incompatible(
            "known_gains, known_coupling, known_noise, amplitude: expected phases only for learned, whose networks "
            "were trained with responses of modulus 1 in white noise, got more; leave these options out"
        )
    if manifold.wavefront == "planar":
        raise Incompatible('wavefront: expected "exact", "fresnel" or "paper" for learned, got "planar"')
    setting = _for_array(instance.manifold)
    _check_box(instance, setting)
    return setting


def _for_array(manifold: Manifold) -> Setting:
    """Return the setting whose elements are at the same places, in wavelengths and in any order.

    Raises Incompatible if there is none.
    """
    distances = {}
    for setting in SETTINGS.values():
        Q, trained = (_sorted(each.positions / each.wavelength_m) for each in (manifold, setting.scenario.manifold()))
        if len(Q) == len(trained):
            distances[setting.name] = float(np.abs(Q - trained).max())
            if distances[setting.name] <= PLACE:
                return setting
    expected = " or ".join(setting.array for setting in SETTINGS.values())
    got = f"{len(manifold.positions)} elements"
    if distances:
        name, distance = min(distances.items(), key=lambda each: each[1])
        got += f" up to {distance:.3g} wavelengths from those of the {name.upper()}"
    raise Incompatible(
        f"array: expected {expected}, for which networks were trained, got {got}; grid-refine works with any array"
    )


def _sorted(Q: Float[ndarray, "m 3"]) -> Float[ndarray, "m 3"]:
    """The elements in the order of their y and z, which may differ by rounding errors [wavelengths]."""
    rounded = np.round(Q, 3)
    return Q[np.lexsort((rounded[:, 2], rounded[:, 1]))]


def _check_box(instance: ArrayInstance, setting: Setting) -> None:
    """Raise Incompatible unless the box is within that of the training, with ranges in wavelengths."""
    scenario = setting.scenario
    (lower, upper), trained = scenario.box(), f"in which the network for the {setting.name.upper()} was trained"
    if instance.manifold.has_elevation != (len(lower) == 3):
        expected, got = ("none", "an interval") if len(lower) == 2 else ("an interval", "none")
        raise Incompatible(
            f"elevation_deg: expected {expected} with {setting.array}, whose network was trained "
            f"{'in the plane' if len(lower) == 2 else 'with elevation'}, got {got}"
        )
    for name, i in (("azimuth_deg", 0), ("elevation_deg", 1))[: len(lower) - 1]:
        if instance.lower[i] < lower[i] - MARGIN or instance.upper[i] > upper[i] + MARGIN:
            (low, high), given = np.degrees([lower[i], upper[i]]), np.degrees([instance.lower[i], instance.upper[i]])
            raise Incompatible(
                f"{name}: expected an interval within [{low:g}, {high:g}], {trained}, got [{given[0]:g}, {given[1]:g}]"
            )
    ratio = instance.manifold.wavelength_m / scenario.wavelength
    nearest, farthest = ratio * lower[-1], ratio * upper[-1]
    if instance.lower[-1] < nearest * (1 - MARGIN) or instance.upper[-1] > farthest * (1 + MARGIN):
        low, high = np.array([lower[-1], upper[-1]]) / scenario.wavelength
        raise Incompatible(
            f"range_m: expected an interval within [{nearest:.4g}, {farthest:.4g}], {low:g} to {high:g} wavelengths, "
            f"{trained}, got [{instance.lower[-1]:.4g}, {instance.upper[-1]:.4g}]"
        )
