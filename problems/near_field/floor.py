"""The error floor under fading: the error that remains without noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray
from scipy.optimize import Bounds, minimize

from .bands import Band
from .bounds import information_root
from .search import BandFit, search_bands_locally
from .wavefronts import Manifold

__all__ = ["floor_of_bands", "local_fit", "noise_free_columns"]


def noise_free_columns(H: Complex[ndarray, "draws m k"], symbols: Complex[ndarray, "k t"]) -> Complex[ndarray, "m c"]:
    """Return the columns to which a least-squares fit is made when there is no noise.

    If one channel holds for the whole block, data without noise determine the span of H, whatever the powers of the
    sources. The columns are then those of H, so that all sources have the same weight, and c = K. If the channel
    changes, each snapshot determines only the sum of its columns, weighted by the symbols. The columns are then the
    snapshots H_t·s_t, so that the scattering of a strong source can mask a weak one, and c = T.

    H: channel of the block, shape (1, M, K), or of each snapshot, shape (T, M, K).
    symbols: symbols S including their amplitudes, shape (K, T).
    """
    columns: ndarray = H[0] if len(H) == 1 else np.einsum("tmk,kt->mt", H, symbols)
    return columns


def local_fit(
    columns: Complex[ndarray, "m c"],
    manifold: Manifold,
    theta: Float[ndarray, "k d"],
    lower: Float[ndarray, " d"],
    upper: Float[ndarray, " d"],
) -> Float[ndarray, "k d"]:
    """Return the local minimizer of ‖(I − P_A(θ))·columns‖²_F within the box that L-BFGS-B reaches from ``theta``.

    The variables are scaled by the Gauss–Newton curvature at the starting point, which makes radians and metres
    comparable.

    columns: data to fit, shape (M, c).
    manifold: array and wavefront model.
    theta: starting point [rad, m], shape (K, d).
    lower: lower bounds of one source [rad, m], shape (d,).
    upper: upper bounds of one source [rad, m], shape (d,).
    """
    energy = np.vdot(columns, columns).real

    def residual(theta: ndarray) -> tuple[ndarray, ndarray, ndarray]:
        """Return E = (I − P_A)·columns, the amplitudes Z = A⁺·columns, and ∂a/∂θ."""
        a, derivatives = manifold.response_and_derivatives(theta)
        Z = np.linalg.pinv(a.T, rcond=1e-12) @ columns  # the minimum-norm solution if two sources coincide
        return columns - a.T @ Z, Z, derivatives

    def objective(x: ndarray) -> tuple[float, ndarray]:
        E, Z, derivatives = residual(x.reshape(theta.shape) * scale)
        EZ = E @ Z.conj().T  # ∂J = −2Re tr(Zᴴ·∂Aᴴ·E), and θ_k changes only column k of A
        gradient = -2 * np.einsum("kdm,mk->kd", derivatives.conj(), EZ).real
        return np.vdot(E, E).real / energy, (gradient * scale).ravel() / energy

    _, Z, _ = residual(theta)
    J, _ = information_root(manifold, theta, np.linalg.qr(Z.conj().T).R.conj().T)
    with np.errstate(divide="ignore"):  # a column of J is 0 if the data do not determine its parameter
        scale = np.minimum(np.sqrt(energy) / np.linalg.norm(J, axis=0).reshape(theta.shape), upper - lower)
    box = Bounds(*(np.ravel(side / scale) for side in (lower, upper)))
    found = minimize(
        objective,
        (theta / scale).ravel(),
        jac=True,
        method="L-BFGS-B",
        bounds=box,
        options={"maxiter": 200, "ftol": 1e-13, "gtol": 1e-8, "maxcor": 20},
    )
    fitted: ndarray = found.x.reshape(theta.shape) * scale
    return np.clip(fitted, lower, upper)  # scaling back may round a point out of the box


def floor_of_bands(
    bands: Sequence[Band], theta: Float[ndarray, "k d"], lower: Float[ndarray, " d"], upper: Float[ndarray, " d"]
) -> Float[ndarray, "k d"]:
    """Return the local minimizer of the sum of ‖(I − P_A(θ))·columns‖²_F over frequency bins, from ``theta``.

    bands: bins with known channels and symbols.
    theta: starting point [rad, m], shape (K, d).
    lower: lower bounds of one source [rad, m], shape (d,).
    upper: upper bounds of one source [rad, m], shape (d,).
    """
    fits = [
        BandFit(noise_free_columns(band.H, band.symbols), band.manifold)
        for band in bands
        if band.H is not None and band.symbols is not None
    ]
    return search_bands_locally(fits, lower, upper, theta.ravel()).x.reshape(theta.shape)
