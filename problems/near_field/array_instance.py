"""What a formulation needs to know of data received by an array, whether they are simulated or recorded."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Protocol

from jaxtyping import Complex, Float
from numpy import ndarray

from nfbench import Instance

from .arrays import Array
from .wavefronts import Manifold

__all__ = ["ArrayInstance", "ArrayScenario"]


class ArrayInstance(Instance, ABC):
    """The data received by an array, and the box in which the sources that sent them are searched.

    Y: received data, shape (M, T); their noise has approximately unit variance.
    manifold: array and wavefront model that the formulations assume.
    lower: lower bounds of one source [rad, m], shape (d,).
    upper: upper bounds of one source [rad, m], shape (d,).
    gains: known complex gains of the elements, shape (M,); None: not known, or all 1.
    noise_covariance: known covariance of the noise, shape (M, M), in the units of Y; None: not known, or white.
    """

    Y: Complex[ndarray, "m t"]
    manifold: Manifold
    lower: Float[ndarray, " d"]
    upper: Float[ndarray, " d"]
    gains: Complex[ndarray, " m"] | None = None
    noise_covariance: Complex[ndarray, "m m"] | None = None

    @property
    @abstractmethod
    def sources(self) -> int:
        """The number K of sources that formulations with ``sources = "known"`` search for."""


class ArrayScenario(Protocol):
    """A scenario that draws such instances, as far as the warnings of formulations need it."""

    @property
    def array(self) -> Array: ...

    @property
    def sources(self) -> int: ...

    @property
    def elevation_deg(self) -> tuple[float, float] | None: ...

    def manifold(self) -> Manifold: ...

    def box(self) -> tuple[Float[ndarray, " d"], Float[ndarray, " d"]]: ...
