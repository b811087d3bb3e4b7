"""The floor under fading: the error that stays when the noise is gone."""

from __future__ import annotations

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray
from scipy.optimize import Bounds, minimize

from .bounds import information_root
from .wavefronts import Manifold

__all__ = ["local_fit", "noise_free_columns"]


def noise_free_columns(H: Complex[ndarray, "draws m k"], symbols: Complex[ndarray, "k t"]) -> Complex[ndarray, "m c"]:
    """What data without noise reveal, as the columns of a least-squares fit.

    H: one channel for the block, or one a snapshot. symbols: S with its amplitudes. Of a channel that stays, data
    without noise reveal the span of H, whatever the powers of the sources: the columns are those of H, each source
    counts alike, and c = K. Of a channel that changes, every snapshot reveals only the sum of its columns, weighted by
    the symbols: the columns are the snapshots H_t·s_t, the scattering of a strong source hides a weak one, and c = T.
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
    """The local minimum, within the box, of ‖(I − P_A(θ))·columns‖²_F that L-BFGS-B reaches from ``theta`` [rad, m].

    Variables are scaled by the Gauss–Newton curvature at the start, which makes radians and metres comparable.
    """
    energy = np.vdot(columns, columns).real

    def residual(theta: ndarray) -> tuple[ndarray, ndarray, ndarray]:
        """E = (I − P_A)·columns, the amplitudes Z = A⁺·columns, and ∂a/∂θ."""
        a, derivatives = manifold.response_and_derivatives(theta)
        Z = np.linalg.pinv(a.T, rcond=1e-12) @ columns  # the shortest where two sources coincide
        return columns - a.T @ Z, Z, derivatives

    def objective(x: ndarray) -> tuple[float, ndarray]:
        E, Z, derivatives = residual(x.reshape(theta.shape) * scale)
        pull = E @ Z.conj().T  # ∂J = −2Re tr(Zᴴ·∂Aᴴ·E), and θ_k moves column k of A alone
        gradient = -2 * np.einsum("kdm,mk->kd", derivatives.conj(), pull).real
        return np.vdot(E, E).real / energy, (gradient * scale).ravel() / energy

    _, Z, _ = residual(theta)
    J, _ = information_root(manifold, theta, np.linalg.qr(Z.conj().T).R.conj().T)
    with np.errstate(divide="ignore"):  # what the data do not tell
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
    return np.clip(fitted, lower, upper)  # the way back from the scale rounds
