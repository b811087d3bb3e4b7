"""The kernels of subspace fitting for candidates whose Gram matrix is nearly singular: sources that run together, or
nearly as many sources as elements.

An orthonormal basis Q of the span of A takes the place of Cholesky's factorization: J = ‖F‖² − ‖QᴴF‖². It is found by
the modified Gram–Schmidt process with column pivoting, and its rank is revealed by the pivots. The sources are first
put in the order of their coordinates, so that a permutation of them gives the same J, bit by bit.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Complex, Float, Int
from numpy import ndarray

from nfbench import compiled

from .inner_products import SUMS, gram_row
from .packing import ArrayModel
from .response_vectors import respond, source_at

__all__ = ["RANK", "orthogonalize", "singular_fit", "source_order"]

RANK = 1e-16
"""The squared distance of a response from the span of others, relative to M, below which it adds nothing to the span.

Phases are rounded to some 1e-15 of an array of a wavelength, and 1e-14 of one of a hundred. That turns the direction in
which such a response leaves the span by 1e-7 to 1e-6."""

_LONGER = 1.0 + 1e-9  # by which a square must exceed another, so that rounding does not decide between equals


@compiled()
def source_order(X: Float[ndarray, "p n"], i: int, K: int) -> Int[ndarray, " k"]:
    """The order of the K sources of candidate i by their coordinates, the first coordinate first."""
    d = X.shape[1] // K
    order = np.arange(K)
    for j in range(1, K):  # insertion
        moved, k = order[j], j
        while k > 0:
            other, c = order[k - 1], 0
            while c < d - 1 and X[i, moved * d + c] == X[i, other * d + c]:
                c += 1
            if not X[i, moved * d + c] < X[i, other * d + c]:
                break
            order[k] = other
            k -= 1
        order[k] = moved
    return order


@compiled()
def orthogonalize(
    V: Complex[ndarray, "n m"],
    least: float,
    Q: Complex[ndarray, "r m"],
    R: Complex[ndarray, "r n"],
    pivots: Int[ndarray, " r"],
) -> int:
    """Return the rank r of the vectors v_k, the rows of V; v_k = Σ_{i<r} R_ik·q_i with r orthonormal rows q_i of Q.

    Modified Gram–Schmidt: the longest remainder comes next, once more orthogonalized (twice is enough; Giraud, Langou &
    Rozložník 2005), until no remainder has a square above ``least``. V takes the remainders. Q and R are zero
    beyond the rank; R_ik is zero for i > j if k is pivots[j], chosen j-th.
    """
    n, m = V.shape
    Q[:] = 0.0
    R[:] = 0.0
    for rank in range(min(n, m)):
        longest, square = 0, 0.0
        for k in range(n):
            s = _product(V, k, V, k).real
            if s > _LONGER * square:
                longest, square = k, s
        if not square > least:
            return rank
        for i in range(rank):
            R[i, longest] += _subtract_projection(Q, i, V, longest)
        root = math.sqrt(_product(V, longest, V, longest).real)
        for c in range(m):
            Q[rank, c] = V[longest, c] / root
            V[longest, c] = 0.0
        R[rank, longest], pivots[rank] = root, longest
        for k in range(n):
            R[rank, k] += _subtract_projection(Q, rank, V, k)
    return min(n, m)


@compiled(SUMS)
def _product(Q: Complex[ndarray, "r m"], i: int, V: Complex[ndarray, "n m"], k: int) -> complex:
    """q_iᴴv_k."""
    s = 0.0j
    for c in range(V.shape[1]):
        s += Q[i, c].conjugate() * V[k, c]
    return s


@compiled(SUMS)
def _subtract_projection(Q: Complex[ndarray, "r m"], i: int, V: Complex[ndarray, "n m"], k: int) -> complex:
    """v_k ← v_k − q_i·(q_iᴴv_k); returns q_iᴴv_k."""
    s = _product(Q, i, V, k)
    for c in range(V.shape[1]):
        V[k, c] -= s * Q[i, c]
    return s


@compiled()
def _decompose(
    array: ArrayModel,
    rows: Float[ndarray, "2 rows padded"],
    h: Complex[ndarray, " rows"],
    W: Complex[ndarray, "k c"],
    X: Float[ndarray, "p n"],
    i: int,
    order: Int[ndarray, " k"],
    R: Complex[ndarray, "k k"],
) -> tuple[int, float]:
    """The rank of A and ‖QᴴF‖² of candidate i; leaves Q in ``rows`` after F, W = QᴴF, and R = QᴴA in this order."""
    K, columns = W.shape
    d = X.shape[1] // K
    A, Q = np.empty((K, array.M), np.complex128), np.empty((K, array.M), np.complex128)
    for j in range(K):
        respond(array, source_at(X, i, order[j] * d, d, array.wavelength), rows, columns)
        for m in range(array.M):
            A[j, m] = complex(rows[0, columns, m], rows[1, columns, m])
    rank = orthogonalize(A, RANK * array.M, Q, R, np.empty(K, np.int64))
    explained = 0.0
    for j in range(K):
        for m in range(array.M):  # what is beyond M stays zero
            rows[0, columns + j, m], rows[1, columns + j, m] = Q[j, m].real, Q[j, m].imag
        gram_row(rows, columns, j, h)
        for c in range(columns):
            W[j, c] = h[c]
            explained += h[c].real * h[c].real + h[c].imag * h[c].imag
    return rank, explained


@compiled()
def singular_fit(
    array: ArrayModel,
    energy: float,
    rows: Float[ndarray, "2 rows padded"],
    h: Complex[ndarray, " rows"],
    W: Complex[ndarray, "k c"],
    X: Float[ndarray, "p n"],
    i: int,
    amplitudes: bool,
) -> tuple[float, Complex[ndarray, "k c"], Int[ndarray, " k"]]:
    """J of candidate i, the rows of C = A⁺F and the sources that they belong to; C has no rows unless ``amplitudes``.

    Leaves Q in ``rows`` after F, and W = QᴴF.

    A⁺ = R⁺Qᴴ is the pseudo-inverse: sources that coincide share one amplitude equally. With Rᴴ = Z·S, again by
    Gram–Schmidt, R⁺ = Z·S⁻ᴴ.
    """
    K, columns = W.shape
    order, R = source_order(X, i, K), np.empty((K, K), np.complex128)
    rank, explained = _decompose(array, rows, h, W, X, i, order, R)
    J = max(energy - explained, 0.0)
    if not amplitudes:
        return J, np.empty((0, columns), np.complex128), order
    rows_of_R = R[:rank].conj()  # the columns of Rᴴ
    Z, S, pivots = np.empty((rank, K), np.complex128), np.empty((rank, rank), np.complex128), np.empty(rank, np.int64)
    C, y = np.zeros((K, columns), np.complex128), np.zeros((rank, columns), np.complex128)
    for j in range(orthogonalize(rows_of_R, 0.0, Z, S, pivots)):
        for c in range(columns):
            w = W[pivots[j], c]
            for k in range(j):  # y = S⁻ᴴW
                w -= S[k, pivots[j]].conjugate() * y[k, c]
            y[j, c] = w / S[j, pivots[j]].real
            for k in range(K):
                C[k, c] += Z[j, k] * y[j, c]
    return J, C, order
