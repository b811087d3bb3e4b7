"""Linear prediction along the anti-diagonals of the covariance, and oblique projections that isolate each source."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, NamedTuple, final

import numpy as np
from jaxtyping import Complex, Float, Int
from numpy import ndarray

from nfbench import Formulation, Ge, Incompatible, Instance, Minimize, Solution

from ..array_instance import ArrayInstance
from ..enumeration import Criterion, Sources, how_many
from ..search import warm_up as warm_up_search
from ..subspace import decompose, signal_subspace
from ..wavefronts import Amplitude, Manifold, Wavefront
from .mirrored import data_of_mirrored_line
from .refinement import refine_jointly
from .uniform_line import azimuth_of_sine, inverse_range_scale, regress, sine_interval

__all__ = ["LinearPrediction"]

TITLE = "linear prediction"
RANGES = 400  # of the first search, uniform in inverse range
OFFSETS = 9  # anti-diagonals from which an isolated source is estimated
CONVERGED = 1e-8  # change of a sine and of κ·D in a sweep that is none
DEPENDENT = 1e-6  # length of a response, relative to others, that is left when the isolated one is projected off


@final
@dataclass(frozen=True)
class LinearPrediction(Formulation):
    """Linear prediction and oblique projection (Zuo, Xin, Liu et al. 2019, IEEE Trans. Signal Process. 67(2)).

    In a centred ULA with y_m + y_n = pδ on the p-th anti-diagonal of the covariance, its entries without noise are R_mn
    = Σ P_k·exp(jk(y_m − y_n)·q_k) for sources of the powers P_k, with the auxiliary sines q_k = sinφ_k − κ_k·pδ/2 and κ
    = cos²φ/r, or 1/r for the wavefront "paper". Such a sum of exponentials is predicted by its predecessors, and the
    zeros of the prediction polynomial on the unit circle are exp(j2kδ·q_k).

    The coefficients are the least-squares solution of smallest norm with a truncated singular value decomposition of
    rank K (Tufts & Kumaresan 1982). The zeros of p = 0 closest to the unit circle are the angles. The range of each
    angle is where the polynomials of four other anti-diagonals are jointly the closest to zero, which pairs the
    parameters.

    With a finite number of snapshots the correlations of different sources are not zero, so that the error does not
    fall beyond some SNR. For each source in turn I − E removes the others, where E is the oblique projection onto their
    responses along that of the source, and its auxiliary sines are estimated again, from first-order predictors with
    the weights of Kay (1989). Their regression on p gives angle and range. Sweeps repeat this until nothing changes.

    The cubic phase of an exact wavefront is odd, and biases the estimate. Two sources at the same angle are detected as
    one. Coherent sources violate the model.

    sweeps: maximum number of sweeps in which every source is isolated and estimated again; 0: none.
    refine: whether to refine all sources together by a local search of weighted subspace fitting, which removes the
        bias; then there are standard errors.
    wavefront: wavefront model that the estimator assumes, "exact", "fresnel" or "paper"; None: that of the scenario.
    sources: number of sources to search for: "known" is the true number, "estimate" is an estimate from the data by
        ``criterion``, and an integer is used as given, even if it is wrong.
    criterion: criterion by which the number of sources is estimated: "aic", "mdl" or "ne" (Nadakuditi & Edelman); used
        only if ``sources`` is "estimate".
    known_gains: whether the estimator knows the gains and phases of the elements.
    known_coupling: whether the estimator knows the mutual coupling of the elements.
    known_noise: whether the estimator knows the covariance of the noise, and whitens the data with it.
    known_failed: whether the estimator knows which elements have failed, and leaves them out.
    known_positions: whether the estimator knows the true positions of the elements.
    amplitude: amplitude over the array that the estimator assumes, "constant", or "spherical", which is r/‖p − q_m‖.
    """

    accepts: ClassVar[type[Instance]] = ArrayInstance  # type: ignore[type-abstract]  # any subclass
    needs_solver: ClassVar[bool] = False

    sweeps: Annotated[int, Ge(0)] = 20
    refine: bool = False
    wavefront: Wavefront | None = None
    sources: Sources = "known"
    criterion: Criterion = "ne"
    known_gains: bool = False
    known_coupling: bool = False
    known_noise: bool = False
    known_failed: bool = False
    known_positions: bool = False
    amplitude: Amplitude = "constant"

    def warm_up(self) -> None:
        warm_up_search()

    def solve(self, instance: ArrayInstance, minimize: Minimize) -> Float[ndarray, "k d"] | Solution:
        """Return the sources (K, 2) [rad, m]; fewer if the polynomial has fewer zeros at angles of the box.

        Raises Incompatible if there are several frequency bins, elevation or fewer snapshots than sources, if the
        array is not a centred ULA along y with a spacing below λ/(4·sinφ_max), or if it has 2K + 2 elements or fewer.
        """
        Y, manifold = data_of_mirrored_line(instance, self, "linear-prediction", TITLE)
        K, M = how_many(instance, self.sources, self.criterion, self), len(Y)
        if K == 0:
            return np.empty((0, 2))
        if M <= 2 * K + 2:
            raise Incompatible(f"array: expected more than {2 * K + 2} elements for {K} sources, got {M}")
        noise = decompose(Y, K).noise
        line = _Line(manifold, instance.lower, instance.upper, min(M // 2, M - 2 * K - 2))
        R = Y @ Y.conj().T / Y.shape[1] - noise * np.eye(M)
        theta, diagonals = _predict(R, line, K), _Antidiagonals.of(M, line.offset)
        for _ in range(self.sweeps):
            before = theta.copy()
            for k in range(len(theta)):
                theta[k] = _isolate(R, line, diagonals, theta, k)
            if np.allclose(_scaled(theta, line), _scaled(before, line), rtol=0, atol=CONVERGED):
                break
        return refine_jointly(Y, manifold, line.lower, line.upper, theta) if self.refine else theta


class _Line(NamedTuple):
    """A centred ULA, the box of the sources, and the largest offset p of the anti-diagonals that are used."""

    manifold: Manifold
    lower: Float[ndarray, " d"]
    upper: Float[ndarray, " d"]
    offset: int

    @property
    def spacing(self) -> float:
        """δ [m], which is negative if y falls."""
        y = self.manifold.positions[:, 1]
        return float(y[-1] - y[0]) / (len(y) - 1)

    @property
    def turn(self) -> float:
        """2kδ, the phase from one entry of an anti-diagonal to the next for a sine of 1 [rad]."""
        return 4 * np.pi / self.manifold.wavelength_m * self.spacing

    def source(self, sine: float, curvature: float) -> Float[ndarray, " d"]:
        """Return the source with this sinφ and κ [1/m], moved into the box."""
        azimuth = azimuth_of_sine(np.array([sine]), self.lower, self.upper)
        scale = float(inverse_range_scale(self.manifold.wavefront, azimuth)[0])
        r = scale / curvature if curvature > 0 else np.inf
        return np.clip([azimuth[0], r], self.lower, self.upper)

    def sine_and_curvature(self, theta: Float[ndarray, "*p d"]) -> tuple[Float[ndarray, "*p"], Float[ndarray, "*p"]]:
        """Return sinφ and κ [1/m] of sources."""
        azimuth, r = theta[..., 0], theta[..., 1]
        return np.sin(azimuth), inverse_range_scale(self.manifold.wavefront, azimuth) / r


def _scaled(theta: Float[ndarray, "k d"], line: _Line) -> Float[ndarray, "two k"]:
    """Return sinφ and κ·D, which have similar errors at all ranges."""
    sine, curvature = line.sine_and_curvature(theta)
    return np.stack([sine, curvature * abs(line.spacing) * line.manifold.elements])


def _antidiagonal(R: Complex[ndarray, "m m"], p: int) -> Complex[ndarray, " n"]:
    """Return the entries R_mn with y_m + y_n = pδ, m ascending, shape (M − |p|,)."""
    z: ndarray = np.diagonal(R[:, ::-1], -p)
    return z


def _polynomial(z: Complex[ndarray, " n"], K: int) -> Complex[ndarray, " coefficients"]:
    """Return the prediction polynomial x^L − b_(L−1)·x^(L−1) − … − b_0, L = ⌊N/2⌋, divided by its norm."""
    L = len(z) // 2
    windows = np.lib.stride_tricks.sliding_window_view(z, L + 1)
    past, following = windows[:, :-1], windows[:, -1]
    U = signal_subspace(past, K)  # the least-squares solution b has no part outside its rank K
    b = np.linalg.pinv(U.conj().T @ past) @ (U.conj().T @ following)
    coefficients = np.append(1.0, -b[::-1])
    polynomial: ndarray = coefficients / np.linalg.norm(coefficients)
    return polynomial


def _predict(R: Complex[ndarray, "m m"], line: _Line, K: int) -> Float[ndarray, "k d"]:
    """Return the sources from the prediction polynomials of five anti-diagonals; fewer if there are fewer angles."""
    zeros = np.roots(_polynomial(_antidiagonal(R, 0), K))
    sines = np.angle(zeros) / line.turn
    beamwidth = line.manifold.wavelength_m / (len(R) * abs(line.spacing))
    low, high = sine_interval(line.lower, line.upper)
    inside = (sines >= low - beamwidth) & (sines <= high + beamwidth)
    zeros, sines = zeros[inside], sines[inside]
    sines = sines[np.argsort(np.abs(np.abs(zeros) - 1), kind="stable")[:K]]
    offsets = [p for p in {line.offset, -line.offset, line.offset // 2, -(line.offset // 2)} if p]
    polynomials = [(p, _polynomial(_antidiagonal(R, p), K)) for p in sorted(offsets)]
    ranges = 1 / np.linspace(1 / line.upper[1], 1 / line.lower[1], RANGES)
    theta = np.empty((len(sines), 2))
    theta[:, 0] = np.clip(azimuth_of_sine(sines, line.lower, line.upper), line.lower[0], line.upper[0])
    for k, azimuth in enumerate(theta[:, 0]):
        curvature = inverse_range_scale(line.manifold.wavefront, azimuth) / ranges
        misfit = np.zeros(RANGES)
        for p, polynomial in polynomials:
            auxiliary = sines[k] - curvature * p * line.spacing / 2  # q_k
            misfit += np.abs(np.polyval(polynomial, np.exp(1j * line.turn * auxiliary))) ** 2
        theta[k, 1] = ranges[np.argmin(misfit)]
    return theta


class _Antidiagonals(NamedTuple):
    """Where the entries R_mn of some anti-diagonals are, one in each row, and the weights of Kay (1989) for each pair.

    A row has the first half of its anti-diagonal, m ascending, since a Hermitian R has the conjugates in the other
    half, where the pairs of neighbours have the same products. What follows in the row has the weight 0.
    """

    p: Int[ndarray, " o"]
    m: Int[ndarray, "o h"]
    n: Int[ndarray, "o h"]
    weights: Float[ndarray, "o h-1"]

    @classmethod
    def of(cls, M: int, offset: int) -> _Antidiagonals:
        """Return the anti-diagonals from which an isolated source is estimated; the outermost are ±offset."""
        p, i = np.unique(np.round(np.linspace(-offset, offset, OFFSETS)).astype(int)), np.arange(M // 2 + 1)
        m, n = i + np.maximum(p, 0)[:, None], M - 1 - i - np.maximum(-p, 0)[:, None]
        pairs, length = i[1:], M - np.abs(p)[:, None]  # pairs are counted from 1 to length − 1
        twice = np.sign(length - 2 * pairs) + 1.0  # 1 for a pair in the middle, 0 beyond it
        return cls(p, np.minimum(m, M - 1), np.maximum(n, 0), twice * pairs * (length - pairs))


def _isolate(
    R: Complex[ndarray, "m m"], line: _Line, diagonals: _Antidiagonals, theta: Float[ndarray, "k d"], k: int
) -> Float[ndarray, " d"]:
    """Return source k, estimated again after the others are removed by an oblique projection.

    Of the covariance (I − E)R(I − E)ᴴ = R − A_o·B − C·A_oᴴ, B = G·R, C = (R − A_o·B)·Gᴴ, only the entries on the
    anti-diagonals are computed.
    """
    A = line.manifold.response(theta).T
    a, others = A[:, k], np.delete(A, k, axis=1)
    across = np.linalg.qr(others - np.outer(a, a.conj() @ others) / len(a))  # P⊥ of a, applied to the others
    G = _inverse(across.R) @ across.Q.conj().T  # E = A_o·G with G = (A_oᴴP⊥A_o)⁻¹A_oᴴP⊥
    B = G @ R
    C = B.conj().T - others @ (B @ G.conj().T)  # R is Hermitian
    p, m, n, weights = diagonals
    left, right = np.hstack([others, C]), np.hstack([B.T, others.conj()])  # of the projection that is subtracted from R
    z = R[m, n] - np.einsum("ohk,ohk->oh", left.take(m, axis=0), right.take(n, axis=0))
    sine, curvature = line.sine_and_curvature(theta[k])
    centres = p * line.spacing / 2
    turns = _turns(z, weights, line.turn * (sine - curvature * centres))
    return line.source(*regress(turns / line.turn, centres, (len(R) - np.abs(p)) ** 3.0))


def _inverse(R: Complex[ndarray, "k k"]) -> Complex[ndarray, "k k"]:
    """Return R⁻¹, or the pseudoinverse if a singular value is below DEPENDENT times the largest."""
    if np.diag(R).all():
        inverse: ndarray = np.linalg.inv(R)
        if np.linalg.norm(R) * np.linalg.norm(inverse) < 1 / DEPENDENT:
            return inverse
    pseudoinverse: ndarray = np.linalg.pinv(R, rcond=DEPENDENT)
    return pseudoinverse


def _turns(
    z: Complex[ndarray, "o h"], weights: Float[ndarray, "o h-1"], expected: Float[ndarray, " o"]
) -> Float[ndarray, " o"]:
    """Return the phase from one entry of an exponential to the next, near the expected one [rad], for each row.

    The weighted linear predictor of Kay (1989, doi:10.1109/29.45547), whose weights make its variance the smallest.
    """
    products = np.sum(weights * z[:, 1:] * z[:, :-1].conj(), axis=1)
    turns: ndarray = expected + np.angle(np.exp(-1j * expected) * products)
    return turns
