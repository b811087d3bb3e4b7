"""Rician fading: a line of sight with scattered waves around it."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Annotated, ClassVar, TypeAlias, final

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

from nfbench import Ge, Gt, Le, Lt, Options

from .wavefronts import Manifold

__all__ = ["IID", "ClusterAroundSource", "Clusters", "Isotropic", "NLoS", "complex_normal", "rician"]

_Degrees: TypeAlias = Annotated[float, Ge(0.0), Le(180.0)]
_Metres: TypeAlias = Annotated[float, Ge(0.0), Lt(math.inf)]


class NLoS(ABC):
    """How the scattered part g of a channel is distributed; its kinds are Options.

    A scene's geometry is drawn once; given it, every g_k is circular complex Gaussian of covariance
    F_kᵀ·F_k*, of trace M.
    """

    @abstractmethod
    def factors(
        self,
        rng: np.random.Generator,
        manifold: Manifold,
        theta: Float[ndarray, "k d"],
        lower: Float[ndarray, " d"],
        upper: Float[ndarray, " d"],
    ) -> Complex[ndarray, "k s m"] | None:
        """Draw the geometry: F_k, one wave a row; g_k is their sum with gains z ~ CN(0, I). None stands for F_k = I.

        theta: the sources; lower, upper: the box they come from [rad, m].
        """

    def draw(
        self,
        rng: np.random.Generator,
        count: int,
        manifold: Manifold,
        theta: Float[ndarray, "k d"],
        lower: Float[ndarray, " d"],
        upper: Float[ndarray, " d"],
    ) -> Complex[ndarray, "count m k"]:
        """``count`` independent draws, in one scene, of G = [g_1 … g_K], each E‖g_k‖² = M.

        The first ones do not depend on ``count``, but for rounding. Arguments as of ``factors``.
        """
        F = self.factors(rng, manifold, theta, lower, upper)
        waves = manifold.elements if F is None else F.shape[1]
        Z = complex_normal(rng, (count, waves, len(theta)))
        if F is None:
            return Z
        G: ndarray = np.ascontiguousarray(np.moveaxis(Z, 2, 0)) @ F  # contiguous for BLAS
        return np.moveaxis(G, 0, 2)

    def covariance(
        self,
        rng: np.random.Generator,
        manifold: Manifold,
        theta: Float[ndarray, "k d"],
        lower: Float[ndarray, " d"],
        upper: Float[ndarray, " d"],
    ) -> Complex[ndarray, "k m m"]:
        """E[g_k·g_kᴴ] of each source, in the scene that ``draw`` makes of a generator in the same state."""
        F = self.factors(rng, manifold, theta, lower, upper)
        if F is None:
            return np.tile(np.eye(manifold.elements, dtype=np.complex128), (len(theta), 1, 1))
        R: ndarray = F.transpose(0, 2, 1) @ F.conj()
        return R


@final
@dataclass(frozen=True)
class IID(Options, NLoS):
    """Rich scattering from everywhere: independent, circular complex Gaussian entries of unit variance."""

    kind: ClassVar[str] = "iid"

    def factors(
        self,
        rng: np.random.Generator,
        manifold: Manifold,
        theta: Float[ndarray, "k d"],
        lower: Float[ndarray, " d"],
        upper: Float[ndarray, " d"],
    ) -> None:
        return None


@final
@dataclass(frozen=True)
class Isotropic(Options, NLoS):
    """Plane waves from all directions alike, in three dimensions: covariance sin(kd)/(kd) of antennas d apart.

    Between the neighbours of a ULA at λ/2 it vanishes, and there this is ``iid``.
    """

    kind: ClassVar[str] = "isotropic"

    def factors(
        self,
        rng: np.random.Generator,
        manifold: Manifold,
        theta: Float[ndarray, "k d"],
        lower: Float[ndarray, " d"],
        upper: Float[ndarray, " d"],
    ) -> Complex[ndarray, "k s m"]:
        Q = manifold.positions
        d = np.linalg.norm(Q[:, None] - Q, axis=-1)
        values, V = np.linalg.eigh(np.sinc(2 * d / manifold.wavelength_m))  # sinc x = sin(πx)/(πx)
        # the symmetric root, which unlike V itself is the same with every LAPACK
        root = (V * np.sqrt(np.maximum(values, 0.0))) @ V.T
        return np.broadcast_to(root.astype(np.complex128), (len(theta), *root.shape))


@final
@dataclass(frozen=True)
class Clusters(Options, NLoS):
    """Clusters of scatterers, other ones for every source, centred anywhere in the scenario's box, in the near field.

    Correlated Rayleigh fading: a sum of the scatterers' responses with independent complex Gaussian gains, covariance
    Σ_c w_c/N_s Σ a·aᴴ. Demir, Kosasih & Björnson 2024 (arXiv:2406.05844) integrate over a density of scatterers what
    is summed here. Without elevation all scatterers lie in the plane.

    clusters: N_c, of each source, their centres uniform in angle and range. scatterers: N_s, of each cluster.
    angular_spread_deg: standard deviation of a scatterer's azimuth (and elevation) from the centre's, Gaussian [°].
    range_spread_m: of its range, Gaussian [m]; default: as deep as wide, the angular spread in radians times the
    centre's range. A range below 0 is reflected. weights: power of each cluster, relative (default: equal).
    """

    kind: ClassVar[str] = "clusters"

    clusters: Annotated[int, Ge(1)] = 3
    angular_spread_deg: _Degrees = 5.0
    range_spread_m: _Metres | None = None
    scatterers: Annotated[int, Ge(1)] = 400
    weights: tuple[Annotated[float, Gt(0.0), Lt(math.inf)], ...] | None = None

    def validate(self) -> None:
        if self.weights is not None and len(self.weights) != self.clusters:
            raise ValueError(f"weights: expected {self.clusters}, one a cluster, got {len(self.weights)}")

    def factors(
        self,
        rng: np.random.Generator,
        manifold: Manifold,
        theta: Float[ndarray, "k d"],
        lower: Float[ndarray, " d"],
        upper: Float[ndarray, " d"],
    ) -> Complex[ndarray, "k s m"]:
        centres = rng.uniform(lower, upper, (len(theta), self.clusters, len(lower)))
        scatterers = _scatter(rng, centres, self.scatterers, self.angular_spread_deg, self.range_spread_m)
        w = np.ones(self.clusters) if self.weights is None else np.array(self.weights)
        amplitude = np.sqrt(w / w.sum() / self.scatterers)
        waves = amplitude[:, None, None] * manifold.response(scatterers)
        return waves.reshape(len(theta), -1, manifold.elements)


@final
@dataclass(frozen=True)
class ClusterAroundSource(Options, NLoS):
    """One cluster of scatterers around each source, as objects near a transmitter make it.

    scatterers: N_s, of each cluster. angular_spread_deg: standard deviation of a scatterer's azimuth (and elevation)
    from the source's, Gaussian [°]. range_spread_m: of its range, Gaussian [m]; default: as deep as wide, the angular
    spread in radians times the source's range. A range below 0 is reflected.
    """

    kind: ClassVar[str] = "cluster-around-source"

    angular_spread_deg: _Degrees = 5.0
    range_spread_m: _Metres | None = None
    scatterers: Annotated[int, Ge(1)] = 400

    def factors(
        self,
        rng: np.random.Generator,
        manifold: Manifold,
        theta: Float[ndarray, "k d"],
        lower: Float[ndarray, " d"],
        upper: Float[ndarray, " d"],
    ) -> Complex[ndarray, "k s m"]:
        scatterers = _scatter(rng, theta, self.scatterers, self.angular_spread_deg, self.range_spread_m)
        return manifold.response(scatterers) / math.sqrt(self.scatterers)


def _scatter(
    rng: np.random.Generator,
    centres: Float[ndarray, "*c d"],
    count: int,
    angular_spread_deg: float,
    range_spread_m: float | None,
) -> Float[ndarray, "*c count d"]:
    """``count`` points around each centre [rad, m]."""
    spread = np.full(centres.shape, math.radians(angular_spread_deg))
    spread[..., -1] = spread[..., -1] * centres[..., -1] if range_spread_m is None else range_spread_m
    offsets = rng.standard_normal((*centres.shape[:-1], count, centres.shape[-1]))
    points = centres[..., None, :] + spread[..., None, :] * offsets
    points[..., -1] = np.abs(points[..., -1])
    return points


def rician(A: Complex[ndarray, "m k"], G: Complex[ndarray, "t m k"], rician_k: float) -> Complex[ndarray, "t m k"]:
    """The channels √(κ/(κ+1))·A + √(1/(κ+1))·G; κ = inf is the line of sight A exactly, whatever G."""
    if math.isinf(rician_k):
        return np.broadcast_to(A, G.shape)
    return math.sqrt(rician_k / (rician_k + 1)) * A + math.sqrt(1 / (rician_k + 1)) * G


def complex_normal(rng: np.random.Generator, shape: tuple[int, ...]) -> Complex[ndarray, "*shape"]:
    """Circular complex Gaussian numbers of unit variance, drawn in the order of ``shape``."""
    pairs = rng.standard_normal((*shape, 2)) * math.sqrt(0.5)
    return pairs.view(np.complex128)[..., 0]
