"""What a formulation needs to know of data received by an array, whether they are simulated or recorded."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar, Protocol

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

from nfbench import Cut, Instance, Localization

from .arrays import Array
from .bands import Band
from .calibration import ALL, calibrated
from .cuts import landscape_cuts
from .diagnosis import Reading, describe_sources
from .geometry import Frame
from .wavefronts import Manifold

__all__ = ["ArrayInstance", "ArrayScenario"]


class ArrayInstance(Instance, ABC):
    """The data received by an array, and the box in which the sources that sent them are searched.

    Y: received data, shape (M, T); their noise has approximately unit variance.
    manifold: array and wavefront model that the formulations assume.
    lower: lower bounds of one source [rad, m], shape (d,).
    upper: upper bounds of one source [rad, m], shape (d,).
    frame: coordinates in which the array and the estimates are described.
    notes: sentences that say how the data were read.
    gains: known complex gains of the elements, shape (M,); None: not known, or all 1.
    noise_covariance: known covariance of the noise, shape (M, M), in the units of Y; None: not known, or white.
    further: frequency bins of wideband data besides that of Y.
    coupling: known matrix of mutual coupling, shape (M, M); None: not known, or none.
    failed: indices of elements that are known to receive noise only.
    element_positions: known true positions of the elements relative to the origin [m], shape (M, 3); None: as nominal.
    reading: how the data were read, as far as warnings depend on it.
    is_measured: whether gains and noise were given with the data, so that estimators know them.
    """

    is_measured: ClassVar[bool] = False

    Y: Complex[ndarray, "m t"]
    manifold: Manifold
    lower: Float[ndarray, " d"]
    upper: Float[ndarray, " d"]
    frame: Frame
    notes: tuple[str, ...] = ()
    gains: Complex[ndarray, " m"] | None = None
    noise_covariance: Complex[ndarray, "m m"] | None = None
    coupling: Complex[ndarray, "m m"] | None = None
    failed: tuple[int, ...] = ()
    element_positions: Float[ndarray, "m 3"] | None = None
    further: tuple[Band, ...] = ()
    reading: Reading = Reading()

    @property
    def bands(self) -> tuple[Band, ...]:
        """The data of all frequency bins, those of Y first; narrowband data have one."""
        return Band(self.Y, self.manifold), *self.further

    @property
    @abstractmethod
    def sources(self) -> int:
        """The number K of sources that formulations with ``sources = "known"`` search for."""

    def origin(self) -> Float[ndarray, " 3"]:
        return self.frame.origin

    def cuts(self) -> tuple[Cut, ...]:
        """Return cuts of RLS, ESF and the MUSIC spectrum through the true sources; none where they are not known."""
        theta = self.truth()
        if theta is None or not len(theta):
            return ()
        return landscape_cuts(self.Y, self.manifold, self.lower, self.upper, theta)

    def describe(self, estimate: Float[ndarray, "found d"], columns: Mapping[str, float]) -> Localization:
        """Return the positions, standard errors, goodness of fit and warnings of an estimate (K̂, d) [rad, m].

        The positions are in the coordinates in which the user describes the array; see ``describe_sources``.
        """
        theta = np.asarray(estimate, dtype=np.float64).reshape(-1, self.manifold.dimension)
        bands = calibrated(self, ALL) if self.is_measured else self.bands
        found = describe_sources(
            bands, self.frame, self.lower, self.upper, self.sources, theta, self.truth(), self.reading
        )
        return replace(found, notes=(*self.notes, *found.notes))


class ArrayScenario(Protocol):
    """A scenario that draws such instances, as far as the warnings of formulations need it."""

    @property
    def array(self) -> Array: ...

    @property
    def sources(self) -> int: ...

    @property
    def elevation_deg(self) -> tuple[float, float] | None: ...

    @property
    def bins(self) -> int: ...

    def manifold(self) -> Manifold: ...

    def box(self) -> tuple[Float[ndarray, " d"], Float[ndarray, " d"]]: ...
