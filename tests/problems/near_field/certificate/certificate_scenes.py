"""Scenes, plain formulas and random points that the tests of the certificate share."""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from nfbench.core.options import build
from nfbench.problems.near_field.certificate import Certificate, certify
from nfbench.problems.near_field.certificate.chart import Chart, chart_of
from nfbench.problems.near_field.estimators.grid_refine import GridRefine
from nfbench.problems.near_field.estimators.refinement import refine
from nfbench.problems.near_field.instance import NearFieldInstance
from nfbench.problems.near_field.objectives.subspace_fitting import SubspaceFit
from nfbench.problems.near_field.scenario import NearField
from nfbench.problems.near_field.subspace import decompose
from nfbench.problems.near_field.wavefronts import Manifold

LINE = {
    "array": {"kind": "ula", "elements": 128, "spacing_wavelengths": 0.25, "origin": "center"},
    "wavelength_m": 0.02,
    "wavefront": "exact",
    "sources": 3,
    "snapshots": 200,
    "snr_db": 20.0,
    "azimuth_deg": [-60, 60],
    "range_m": [1.27, 20.16],
    "min_separation_deg": 2.0,
}
PAPER = LINE | {"array": LINE["array"] | {"origin": "first"}, "wavefront": "paper"}
PLANE = LINE | {
    "array": {"kind": "upa", "columns": 16, "rows": 16, "spacing_wavelengths": 0.5, "origin": "center"},
    "elevation_deg": [-30, 30],
    "range_m": [0.452, 2.56],
}
SHORT = LINE | {"array": LINE["array"] | {"elements": 32, "spacing_wavelengths": 0.5}, "range_m": [0.3, 4.0]}
SCATTERED = tuple((x * 0.02, y * 0.02, z * 0.02) for x, y, z in np.random.default_rng(3).uniform(-4, 4, (24, 3)))
CUSTOM = SHORT | {"array": {"kind": "custom", "origin": "center", "positions": SCATTERED}}


def draw(manifest: dict, seed: int, **changes) -> NearFieldInstance:
    return build(NearField, manifest | changes).draw(np.random.default_rng(seed))


def subspace(instance: NearFieldInstance) -> ndarray:
    return decompose(instance.Y, instance.sources).U_s


def local_minimum(U: ndarray, instance: NearFieldInstance, theta: ndarray) -> ndarray:
    """Return the sources (K, d) at which a local search from ``theta`` ends."""
    fit = SubspaceFit(U, instance.manifold, instance.lower, instance.upper)
    clipped = np.clip(theta, instance.lower, instance.upper)
    return refine(fit, clipped.ravel(), instance.manifold).reshape(theta.shape)


def estimate(instance: NearFieldInstance) -> ndarray:
    found = GridRefine().solve(instance, None)
    return local_minimum(subspace(instance), instance, getattr(found, "estimate", found))


def certify_scene(instance: NearFieldInstance, theta: ndarray | None = None) -> Certificate:
    theta = estimate(instance) if theta is None else theta
    return certify(subspace(instance), instance.manifold, instance.lower, instance.upper, theta)


def misfit(U: ndarray, manifold: Manifold, theta: ndarray) -> float:
    """Return J = ‖(I − P_A)U‖² by the singular vectors of A."""
    left, values, _ = np.linalg.svd(manifold.response(theta).T, full_matrices=False)
    Q = left[:, values > 1e-9 * values[0]]
    return float(np.linalg.norm(U - Q @ (Q.conj().T @ U)) ** 2)


def chart(instance: NearFieldInstance) -> Chart:
    return chart_of(instance.manifold, instance.lower, instance.upper)


def random_coordinates(chart: Chart, n: int, rng: np.random.Generator) -> ndarray:
    return rng.uniform(chart.lower, chart.upper, (n, chart.dimension))


def advances(chart: Chart, c: ndarray) -> ndarray:
    """Return 2π(r − d) (n, M) in the precision of c (n, d), by the printed distances."""
    c = np.asarray(c)
    Q, r = chart.Q.astype(c.dtype), 1 / c[:, -1:]
    if chart.is_sine:
        u = np.stack([0 * c[:, 0], c[:, 0], 0 * c[:, 0]], axis=1)
    else:
        elevation = c[:, 1] if chart.dimension == 3 else 0 * c[:, 0]
        horizontal = np.cos(elevation)
        u = np.stack([horizontal * np.cos(c[:, 0]), horizontal * np.sin(c[:, 0]), np.sin(elevation)], axis=1)
    s, w = u @ Q.T, np.sum(Q**2, axis=1)
    match chart.manifold.wavefront:
        case "exact":
            d = np.sqrt(r**2 - 2 * r * s + w)
        case "fresnel":
            d = r - s + (w - s**2) / (2 * r)
        case _:
            d = r - s + w / (2 * r)
    return 2 * np.arccos(c.dtype.type(-1)) * (r - d)


def phases(chart: Chart, c: ndarray) -> ndarray:
    """Return ψ (n, M) in the centred gauge."""
    psi = advances(chart, c)
    return psi - psi.mean(axis=1, keepdims=True)


def responses(chart: Chart, c: ndarray) -> ndarray:
    """Return the unit responses â (n, M) in the centred gauge."""
    return np.exp(1j * phases(chart, c)) / np.sqrt(len(chart.Q))


def distances(U: ndarray, chart: Chart, c: ndarray) -> ndarray:
    """Return D = 1 − ‖Uᴴâ‖² (n,)."""
    return 1 - np.sum(np.abs(responses(chart, c) @ U.conj()) ** 2, axis=1)


def in_unit_ball(n: int, d: int, rng: np.random.Generator) -> ndarray:
    """Return n points uniform in the unit ball, the first third of them on its surface."""
    x = rng.standard_normal((n, d))
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    radius = rng.random(n) ** (1 / d)
    radius[: n // 3] = 1.0
    return x * radius[:, None]
