"""The misfit of responses of any modulus: the path that the objectives take where the compiled kernels do not apply."""

from __future__ import annotations

from typing import final

import numpy as np
from jaxtyping import Bool, Complex, Float
from numpy import ndarray

from ..subspace import compress
from ..wavefronts import Manifold

__all__ = ["GeneralFit", "orthonormalize", "squared_lengths"]

BLOCK = 2**21  # complex numbers of responses computed at once


@final
class GeneralFit:
    """J(x) = ‖(I − P_[B, A(x)])F‖²_F for any manifold, with B the responses of other sources, which are given.

    It is computed with NumPy, as J = ‖F⊥‖² − ‖QᴴF⊥‖² where Q is an orthonormal basis of P⊥A, by Gram–Schmidt, twice. A
    response whose squared distance from the span of those before it is at most ``least`` of its squared length adds
    nothing.

    F: factor, shape (M, c). manifold: array and wavefront model. sources: number K of sources in x. least: see above.
    others: the other sources [rad, m], shape (k, d); None: there are none.
    """

    def __init__(
        self,
        F: Complex[ndarray, "m c"],
        manifold: Manifold,
        sources: int = 1,
        *,
        least: float,
        others: Float[ndarray, "k d"] | None = None,
    ) -> None:
        self._manifold, self._sources, self._least = manifold, sources, least
        given = np.empty((0, manifold.dimension)) if others is None else others
        self._B = manifold.response(given)
        Q, kept = orthonormalize(self._B[None], least)
        self._Q = Q[0][kept[0]]  # (k, M), one vector per row
        self._F = compress(F) if F.shape[1] > F.shape[0] else F
        for _ in range(2):  # the second projection removes what rounding leaves of a large F
            self._F = self._F - self._Q.T @ (self._Q.conj() @ self._F)
        self.energy = float(np.vdot(self._F, self._F).real)

    def evaluate(self, X: Float[ndarray, "p n"]) -> Float[ndarray, " p"]:
        """J of many candidates."""
        return np.maximum(self.energy - self.explained(X), 0.0)

    def value(self, x: Float[ndarray, " n"]) -> float:
        """J of one candidate."""
        return float(self.evaluate(x[None])[0])

    def value_and_gradient(self, x: Float[ndarray, " n"]) -> tuple[float, Float[ndarray, " n"]]:
        """J and its gradient at one candidate."""
        explained, gradient = self.explained_and_gradient(x)
        return max(self.energy - explained, 0.0), -gradient

    def explained(self, X: Float[ndarray, "p n"]) -> Float[ndarray, " p"]:
        """‖QᴴF⊥‖² of many candidates."""
        count = max(BLOCK // (self._sources * self._manifold.elements), 1)
        blocks = [self._explained(X[first : first + count]) for first in range(0, len(X), count)]
        return np.concatenate(blocks) if blocks else np.empty(0)

    def explained_and_gradient(self, x: Float[ndarray, " n"]) -> tuple[float, Float[ndarray, " n"]]:
        """‖QᴴF⊥‖² and its gradient 2·Re(∂a_kᴴ·E·c_kᴴ), E = P⊥F and C = [B, A]⁺F (Golub & Pereyra 1973)."""
        a, derivatives = self._manifold.response_and_derivatives(x.reshape(self._sources, -1))
        Q, kept = orthonormalize(a[None], self._least, self._Q)
        projected = Q[0].conj() @ self._F
        E = self._F - Q[0].T @ projected
        if not kept.all():  # the response of one source alone does not leave the span
            a = np.where(kept[0][:, None], a, 0.0)
        C = np.linalg.pinv(np.vstack([self._B, a]).T, rcond=np.sqrt(self._least)) @ self._F
        gradient: ndarray = 2 * np.einsum("kdm,mk->kd", derivatives.conj(), E @ C[len(self._B) :].conj().T).real
        return float(np.vdot(projected, projected).real), gradient.ravel()

    def _explained(self, X: Float[ndarray, "p n"]) -> Float[ndarray, " p"]:
        A = self._manifold.response(X.reshape(len(X), self._sources, -1))
        Q, _ = orthonormalize(A, self._least, self._Q)
        projected = Q.reshape(-1, Q.shape[-1]).conj() @ self._F
        return np.sum(np.abs(projected) ** 2, axis=1).reshape(Q.shape[:2]).sum(axis=1)


def orthonormalize(
    A: Complex[ndarray, "p k m"], least: float, given: Complex[ndarray, "r m"] | None = None
) -> tuple[Complex[ndarray, "p k m"], Bool[ndarray, "p k"]]:
    """Return orthonormal bases of the rows of each A, orthogonal to the rows of ``given``, and which rows are kept.

    A row whose squared distance from the span of those before it is at most ``least`` of its squared length is 0.
    """
    Q, kept = np.empty_like(A), np.empty(A.shape[:2], dtype=bool)
    for k in range(A.shape[1]):
        v = A[:, k].copy()
        size = squared_lengths(v)
        for _ in range(2):
            if given is not None and len(given):
                v -= (v @ given.conj().T) @ given
            if k:
                v -= ((v[:, None] @ Q[:, :k].conj().swapaxes(1, 2)) @ Q[:, :k])[:, 0]
        left = squared_lengths(v)
        kept[:, k] = left > least * size
        Q[:, k] = v * np.divide(1.0, np.sqrt(left), out=np.zeros_like(left), where=kept[:, k])[:, None]
    return Q, kept


def squared_lengths(v: Complex[ndarray, "p c"]) -> Float[ndarray, " p"]:
    """Return the squared length of each row."""
    squares: ndarray = np.sum(v.real**2 + v.imag**2, axis=1)
    return squares
