"""Rician fading: the line of sight plus scattered waves."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar, TypeAlias, final

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray

from nfbench import Ge, Gt, Le, Options

from .wavefronts import Manifold

__all__ = ["IID", "ClusterAroundSource", "Clusters", "Isotropic", "NLoS", "complex_normal", "rician"]

RADIANS_BELOW = 0.2  # an angular spread [°] that is smaller is taken for one in radians

_Degrees: TypeAlias = Annotated[float, Ge(0.0), Le(180.0)]
_Metres: TypeAlias = Annotated[float, Ge(0.0), Le(1e9)]
_Count: TypeAlias = Annotated[int, Ge(1), Le(100_000)]


class NLoS(ABC):
    """The distribution of the scattered part g of a channel; subclasses are Options.

    The geometry of the scatterers is drawn once per scene. Given the geometry, every g_k is circular complex Gaussian
    with the covariance F_kᵀ·F_k*, whose trace is M.
    """

    def numbers(self, sources: int, elements: int) -> int:
        """Return how many numbers ``factors`` computes at once, which determines the memory of a draw."""
        return 0

    def warnings(self) -> list[str]:
        """Return sentences about options that are valid but probably not what was meant."""
        spread = getattr(self, "angular_spread_deg", 0.0)
        if 0 < spread < RADIANS_BELOW:
            text = f"nlos.angular_spread_deg: {spread:g}° is unusually small; is it in radians?"
            return [f"{text} {spread:g} rad are {math.degrees(spread):.3g}°"]
        return []

    @abstractmethod
    def factors(
        self,
        rngs: Sequence[np.random.Generator],
        manifold: Manifold,
        theta: Float[ndarray, "k d"],
        lower: Float[ndarray, " d"],
        upper: Float[ndarray, " d"],
    ) -> Complex[ndarray, "k s m"] | None:
        """Draw the geometry and return F_k of each source with one wave per row, shape (K, S, M).

        g_k is the sum of the waves with gains z ~ CN(0, I). None stands for F_k = I.

        rngs: random generator of each source, so that its waves do not depend on the other sources.
        manifold: array and wavefront model.
        theta: sources [rad, m], shape (K, d).
        lower: lower bounds of one source [rad, m], shape (d,).
        upper: upper bounds of one source [rad, m], shape (d,).
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
        """Return ``count`` independent draws of G = [g_1 … g_K] in one scene, with E‖g_k‖² = M.

        Each source has its own child of ``rng`` for its geometry, and another for its gains: the first sources do not
        depend on how many there are, nor the first draws on ``count``, except for rounding. The other arguments are
        those of ``factors``.
        """
        for_geometry, for_gains = _streams(rng, len(theta))
        F = self.factors(for_geometry, manifold, theta, lower, upper)
        waves = manifold.elements if F is None else F.shape[1]
        Z = np.stack([complex_normal(own, (count, waves)) for own in for_gains])  # (K, count, waves)
        G: ndarray = Z if F is None else Z @ F
        return np.moveaxis(G, 0, 2)

    def covariance(
        self,
        rng: np.random.Generator,
        manifold: Manifold,
        theta: Float[ndarray, "k d"],
        lower: Float[ndarray, " d"],
        upper: Float[ndarray, " d"],
    ) -> Complex[ndarray, "k m m"]:
        """Return E[g_k·g_kᴴ] of each source, for the scene that ``draw`` draws with a generator in the same state."""
        for_geometry, _ = _streams(rng, len(theta))
        F = self.factors(for_geometry, manifold, theta, lower, upper)
        if F is None:
            return np.tile(np.eye(manifold.elements, dtype=np.complex128), (len(theta), 1, 1))
        R: ndarray = F.transpose(0, 2, 1) @ F.conj()
        return R


@final
@dataclass(frozen=True)
class IID(Options, NLoS):
    """Rich scattering from all directions: independent circular complex Gaussian entries of unit variance."""

    kind: ClassVar[str] = "iid"

    def factors(
        self,
        rngs: Sequence[np.random.Generator],
        manifold: Manifold,
        theta: Float[ndarray, "k d"],
        lower: Float[ndarray, " d"],
        upper: Float[ndarray, " d"],
    ) -> None:
        return None


@final
@dataclass(frozen=True)
class Isotropic(Options, NLoS):
    """Plane waves that arrive uniformly from all directions in three dimensions.

    The covariance of two antennas at a distance d is sin(kd)/(kd) with k = 2π/λ. It vanishes for all pairs of antennas
    of a ULA with a spacing of λ/2, for which this distribution equals ``iid``.
    """

    kind: ClassVar[str] = "isotropic"

    def numbers(self, sources: int, elements: int) -> int:
        return 3 * elements**2

    def factors(
        self,
        rngs: Sequence[np.random.Generator],
        manifold: Manifold,
        theta: Float[ndarray, "k d"],
        lower: Float[ndarray, " d"],
        upper: Float[ndarray, " d"],
    ) -> Complex[ndarray, "k s m"]:
        Q = manifold.positions
        d = np.linalg.norm(Q[:, None] - Q, axis=-1)
        values, V = np.linalg.eigh(np.sinc(2 * d / manifold.wavelength_m))  # sinc x = sin(πx)/(πx)
        # unlike V itself, the symmetric root does not depend on the LAPACK implementation
        root = (V * np.sqrt(np.maximum(values, 0.0))) @ V.T
        return np.broadcast_to(root.astype(np.complex128), (len(theta), *root.shape))


@final
@dataclass(frozen=True)
class Clusters(Options, NLoS):
    """Clusters of near-field scatterers around random centres in the scenario's box, drawn separately for each source.

    The result is correlated Rayleigh fading: a sum of the scatterers' responses with independent complex Gaussian
    gains, whose covariance is Σ_c w_c/N_s Σ a·aᴴ with Σ_c w_c = 1. Demir, Kosasih & Björnson 2024 (arXiv:2406.05844)
    integrate over a density of scatterers instead of summing. Without elevation, all scatterers lie in the plane.
    Negative ranges are replaced by their absolute values.

    clusters: number N_c of clusters per source; their centres are uniform in angle and range.
    angular_spread_deg: standard deviation [°] of the Gaussian offsets of scatterers from their cluster's centre in
        azimuth (and elevation).
    range_spread_m: standard deviation [m] of the Gaussian offsets of scatterers from their cluster's centre in range;
        None: the angular spread in radians times the range of the centre, so that a cluster is as deep as it is wide.
    scatterers: number N_s of scatterers per cluster.
    weights: relative power of each cluster, N_c positive numbers; None: equal powers.
    """

    kind: ClassVar[str] = "clusters"

    clusters: _Count = 3
    angular_spread_deg: _Degrees = 5.0
    range_spread_m: _Metres | None = None
    scatterers: _Count = 400
    weights: tuple[Annotated[float, Gt(0.0), Le(1e100)], ...] | None = None

    def validate(self) -> None:
        if self.weights is not None and len(self.weights) != self.clusters:
            raise ValueError(f"weights: expected {self.clusters} numbers, one per cluster, got {len(self.weights)}")

    def numbers(self, sources: int, elements: int) -> int:
        return sources * self.clusters * self.scatterers * elements

    def factors(
        self,
        rngs: Sequence[np.random.Generator],
        manifold: Manifold,
        theta: Float[ndarray, "k d"],
        lower: Float[ndarray, " d"],
        upper: Float[ndarray, " d"],
    ) -> Complex[ndarray, "k s m"]:
        centres = np.stack([own.uniform(lower, upper, (self.clusters, len(lower))) for own in rngs])
        scatterers = _scatter(rngs, centres, self.scatterers, self.angular_spread_deg, self.range_spread_m)
        w = np.ones(self.clusters) if self.weights is None else np.array(self.weights)
        amplitude = np.sqrt(w / w.sum() / self.scatterers)
        waves = amplitude[:, None, None] * manifold.response(scatterers)
        return waves.reshape(len(theta), -1, manifold.elements)


@final
@dataclass(frozen=True)
class ClusterAroundSource(Options, NLoS):
    """One cluster of scatterers around each source, which models objects near a transmitter.

    Negative ranges are replaced by their absolute values.

    angular_spread_deg: standard deviation [°] of the Gaussian offsets of scatterers from the source in azimuth (and
        elevation).
    range_spread_m: standard deviation [m] of the Gaussian offsets of scatterers from the source in range; None: the
        angular spread in radians times the range of the source, so that the cluster is as deep as it is wide.
    scatterers: number N_s of scatterers per cluster.
    """

    kind: ClassVar[str] = "cluster-around-source"

    angular_spread_deg: _Degrees = 5.0
    range_spread_m: _Metres | None = None
    scatterers: _Count = 400

    def numbers(self, sources: int, elements: int) -> int:
        return sources * self.scatterers * elements

    def factors(
        self,
        rngs: Sequence[np.random.Generator],
        manifold: Manifold,
        theta: Float[ndarray, "k d"],
        lower: Float[ndarray, " d"],
        upper: Float[ndarray, " d"],
    ) -> Complex[ndarray, "k s m"]:
        scatterers = _scatter(rngs, theta, self.scatterers, self.angular_spread_deg, self.range_spread_m)
        return manifold.response(scatterers) / math.sqrt(self.scatterers)


def _streams(rng: np.random.Generator, sources: int) -> tuple[list[np.random.Generator], list[np.random.Generator]]:
    """Return the generators of each source's geometry and of its gains."""
    for_geometry, for_gains = zip(*(child.spawn(2) for child in rng.spawn(sources)), strict=True)
    return list(for_geometry), list(for_gains)


def _scatter(
    rngs: Sequence[np.random.Generator],
    centres: Float[ndarray, "k *c d"],
    count: int,
    angular_spread_deg: float,
    range_spread_m: float | None,
) -> Float[ndarray, "k *c count d"]:
    """Draw ``count`` points around each centre [rad, m]; each source has its own generator."""
    spread = np.full(centres.shape, math.radians(angular_spread_deg))
    spread[..., -1] = spread[..., -1] * centres[..., -1] if range_spread_m is None else range_spread_m
    shape = (*centres.shape[1:-1], count, centres.shape[-1])
    offsets = np.stack([own.standard_normal(shape) for own in rngs])
    points = centres[..., None, :] + spread[..., None, :] * offsets
    points[..., -1] = np.abs(points[..., -1])
    return points


def rician(A: Complex[ndarray, "m k"], G: Complex[ndarray, "t m k"], rician_k: float) -> Complex[ndarray, "t m k"]:
    """Return the channels √(κ/(κ+1))·A + √(1/(κ+1))·G; for κ = inf they are exactly the line of sight A."""
    if math.isinf(rician_k):
        return np.broadcast_to(A, G.shape)
    return math.sqrt(rician_k / (rician_k + 1)) * A + math.sqrt(1 / (rician_k + 1)) * G


def complex_normal(rng: np.random.Generator, shape: tuple[int, ...]) -> Complex[ndarray, "*shape"]:
    """Draw circular complex Gaussian numbers of unit variance, in C order of ``shape``."""
    pairs = rng.standard_normal((*shape, 2)) * math.sqrt(0.5)
    return pairs.view(np.complex128)[..., 0]
