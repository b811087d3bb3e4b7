"""Rician fading: a line of sight with scattered waves around it."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

from nfbench import Options

from .wavefronts import Manifold

__all__ = ["IID", "NLoS", "complex_normal", "rician"]


class NLoS(ABC):
    """How the scattered part g of a channel is distributed; its kinds are Options."""

    @abstractmethod
    def draw(
        self,
        rng: np.random.Generator,
        count: int,
        manifold: Manifold,
        theta: Float[ndarray, "k d"],
        lower: Float[ndarray, " d"],
        upper: Float[ndarray, " d"],
    ) -> Complex[ndarray, "count m k"]:
        """``count`` independent draws of G = [g_1 … g_K], each E‖g_k‖² = M; the first ones do not depend on ``count``.

        theta: the sources; lower, upper: the box they come from [rad, m].
        """


@dataclass(frozen=True)
class IID(Options, NLoS):
    """Rich scattering from everywhere: independent, circular complex Gaussian entries of unit variance."""

    kind: ClassVar[str] = "iid"

    def draw(
        self,
        rng: np.random.Generator,
        count: int,
        manifold: Manifold,
        theta: Float[ndarray, "k d"],
        lower: Float[ndarray, " d"],
        upper: Float[ndarray, " d"],
    ) -> Complex[ndarray, "count m k"]:
        return complex_normal(rng, (count, manifold.elements, len(theta)))


def rician(A: Complex[ndarray, "m k"], G: Complex[ndarray, "t m k"], rician_k: float) -> Complex[ndarray, "t m k"]:
    """The channels √(κ/(κ+1))·A + √(1/(κ+1))·G; κ = inf is the line of sight A exactly, whatever G."""
    if math.isinf(rician_k):
        return np.broadcast_to(A, G.shape)
    return math.sqrt(rician_k / (rician_k + 1)) * A + math.sqrt(1 / (rician_k + 1)) * G


def complex_normal(rng: np.random.Generator, shape: tuple[int, ...]) -> Complex[ndarray, "*shape"]:
    """Circular complex Gaussian numbers of unit variance, drawn in the order of ``shape``."""
    pairs = rng.standard_normal((*shape, 2)) * math.sqrt(0.5)
    return pairs.view(np.complex128)[..., 0]
