"""The compiled objectives against the plain ones, for every wavefront and kind of array."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import oracles
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from nfbench.problems.near_field.arrays import UCA, ULA, UPA
from nfbench.problems.near_field.channels import complex_normal
from nfbench.problems.near_field.objectives import kernels
from nfbench.problems.near_field.objectives.rls import RLS
from nfbench.problems.near_field.objectives.subspace_fitting import SubspaceFit
from nfbench.problems.near_field.subspace import compress, signal_subspace
from nfbench.problems.near_field.wavefronts import Manifold

sys.path.append(str(Path(__file__).parents[3] / "benchmarks"))
from numpy_objectives import NumPyESF, NumPyRLS

WAVELENGTH = 0.02
ARRAYS = {
    "ula": ULA(elements=37, spacing_wavelengths=0.25, origin="first"),  # no multiple of anything
    "upa": UPA(columns=8, rows=4, spacing_wavelengths=0.5, origin="center"),
    "uca": UCA(elements=9, radius_wavelengths=2.0, origin="center"),
}
LOWER, UPPER = np.array([-1.1, -0.6, 0.4]), np.array([1.1, 0.6, 20.0])
EVERY = pytest.mark.parametrize(
    ("array", "wavefront", "has_elevation"),
    [(a, w, e) for a in ARRAYS for w in ("exact", "fresnel", "paper", "planar") for e in (False, True)],
)


def manifold_of(array: str, wavefront: str, has_elevation: bool) -> Manifold:
    return Manifold(ARRAYS[array].place(WAVELENGTH), WAVELENGTH, wavefront, has_elevation)


def box(manifold: Manifold) -> tuple[np.ndarray, np.ndarray]:
    keep = [0, 1, 2] if manifold.has_elevation else [0, 2]
    return LOWER[keep], UPPER[keep]


def points(lower: np.ndarray, upper: np.ndarray, count: int = 41) -> np.ndarray:
    """Random points of a box, and its corners (64 of them at most)."""
    bits = np.arange(min(2 ** len(lower), 64))[:, None] >> np.arange(len(lower)) & 1
    return np.vstack(
        [np.random.default_rng(1).uniform(lower, upper, (count, len(lower))), np.where(bits, upper, lower)]
    )


def data(manifold: Manifold, sources: int, snapshots: int) -> np.ndarray:
    rng = np.random.default_rng(0)
    theta = rng.uniform(*box(manifold), (sources, manifold.dimension))
    Y = 3 * manifold.response(theta).T @ complex_normal(rng, (sources, snapshots))
    return Y + complex_normal(rng, Y.shape)


@EVERY
@pytest.mark.parametrize("snapshots", [3, 60], ids=["few snapshots", "many"])
def test_rls_agrees_with_numpy_and_with_the_projector(array, wavefront, has_elevation, snapshots):
    manifold = manifold_of(array, wavefront, has_elevation)
    Y, X = data(manifold, 2, snapshots), points(*box(manifold))
    values = RLS(Y, manifold, *box(manifold)).evaluate(X)
    assert_allclose(values, NumPyRLS(Y, manifold, *box(manifold)).evaluate(X), rtol=1e-10)
    assert_allclose(values, [oracles.rls(Y, oracles.response(manifold, x)) for x in X], rtol=1e-10)


@EVERY
def test_esf_agrees_with_numpy_and_with_the_projector(array, wavefront, has_elevation):
    manifold = manifold_of(array, wavefront, has_elevation)
    for sources in range(1, 6):
        U_s = signal_subspace(data(manifold, sources, 50), sources)
        esf = SubspaceFit(U_s, manifold, *box(manifold))
        X = points(esf.lower, esf.upper)
        responses = [np.array([oracles.response(manifold, row) for row in x.reshape(sources, -1)]).T for x in X]
        squared = np.array([np.linalg.cond(A) for A in responses]) ** 2
        known = squared < 1e10  # beyond, NumPy's J has no digits
        error = 1e-10 + 1e-14 * squared[known]
        values = esf.evaluate(X)
        assert known.sum() > 20
        assert (np.abs(values - NumPyESF(U_s, manifold, *box(manifold)).evaluate(X))[known] <= error).all()
        assert (np.abs(values - [oracles.esf(U_s, A) for A in responses])[known] <= error).all()
        assert ((values >= 0) & (values <= sources)).all()


@pytest.mark.parametrize("gap", [0.0, 1e-12, 1e-9, 1e-7, 1e-5])
def test_near_coincident_candidates_stay_between_the_fits_without_and_with_the_twin(gap):
    manifold = manifold_of("ula", "exact", False)
    U_s = signal_subspace(data(manifold, 3, 50), 3)
    esf = SubspaceFit(U_s, manifold, *box(manifold))
    X = points(esf.lower, esf.upper)[:41]
    X[:, 2:4] = X[:, 0:2] + [gap, 0.0]
    for x, J in zip(X, esf.evaluate(X), strict=True):
        without = [oracles.esf(U_s, manifold.response(x.reshape(3, 2)[[twin, 2]]).T) for twin in (0, 1)]
        assert 0 <= J <= max(without) + 1e-9


@EVERY
def test_a_value_does_not_depend_on_what_it_is_evaluated_with(array, wavefront, has_elevation):
    """Bit by bit: alone or in a batch of any size, at any place, whatever the strides."""
    manifold = manifold_of(array, wavefront, has_elevation)
    Y = data(manifold, 3, 60)
    rls = RLS(Y, manifold, *box(manifold), detected=points(*box(manifold))[:2] + 0.01)
    for problem in (rls, SubspaceFit(signal_subspace(Y, 3), manifold, *box(manifold))):
        X = points(problem.lower, problem.upper)
        values = problem.evaluate(X)
        assert_array_equal([problem.value(x) for x in X], values)
        for start, stop in ((0, 1), (3, 20), (7, 41)):
            assert_array_equal(problem.evaluate(X[start:stop]), values[start:stop])
        assert_array_equal(problem.evaluate(X[::-1]), values[::-1])
        assert_array_equal(problem.evaluate(np.asfortranarray(X)), values)
        frozen = X.copy()
        frozen.flags.writeable = False
        assert_array_equal(problem.evaluate(frozen), values)
        assert problem.value(frozen[5]) == problem.value(np.asfortranarray(X)[5]) == values[5]


@EVERY
def test_gradients_agree_with_numpy(array, wavefront, has_elevation):
    manifold = manifold_of(array, wavefront, has_elevation)
    Y, bounds = data(manifold, 3, 60), box(manifold)
    U_s, near = signal_subspace(Y, 3), points(*bounds)[:2] + 0.01
    for fast, plain in (
        (RLS(Y, manifold, *bounds), NumPyRLS(Y, manifold, *bounds)),
        (RLS(Y, manifold, *bounds, detected=near), NumPyRLS(Y, manifold, *bounds, detected=near)),
        (SubspaceFit(U_s, manifold, *bounds), NumPyESF(U_s, manifold, *bounds)),
    ):
        for x in points(fast.lower, fast.upper)[:41]:
            value, gradient = fast.value_and_gradient(x)
            expected_value, expected = plain.value_and_gradient(x)
            condition = np.linalg.cond(manifold.response(x.reshape(-1, manifold.dimension))) ** 2
            assert value == pytest.approx(fast.value(x), rel=1e-12)
            assert value == pytest.approx(expected_value, rel=1e-10)
            assert_allclose(gradient, expected, rtol=1e-10, atol=1e-13 * condition * np.abs(expected).max())


def test_the_music_form_through_the_same_kernel():
    """M − ‖U_sᴴa‖², for a subspace wider than a block of rows."""
    manifold = manifold_of("ula", "exact", False)
    U_s = signal_subspace(data(manifold, 20, 60), 20)
    X = points(*box(manifold))
    explained = kernels.projected_energy(*manifold.packed, kernels.pack_rows(compress(U_s)), X)
    expected = np.linalg.norm(manifold.response(X) @ U_s.conj(), axis=1) ** 2
    assert_allclose(explained, expected, rtol=1e-12)


def test_nothing_is_compiled_after_the_warm_up():
    kernels.warm_up()
    with pytest.raises(TypeError, match="No matching definition"):
        kernels.repulsion(1, 2, 3, 4)


PROBE = (
    "from nfbench.problems.near_field.objectives import kernels\n"
    "kernels.warm_up(); print(kernels.projected_energy.stats.cache_path)"
)


@pytest.mark.slow
def test_the_first_use_says_that_it_compiles_and_the_second_is_silent(tmp_path):
    first, second = (
        subprocess.run(
            [sys.executable, "-c", PROBE],
            env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)},
            capture_output=True,
            text=True,
            check=True,
        )
        for _ in range(2)
    )
    assert first.stderr.startswith("nfbench: compiling kernels")
    assert len(first.stderr.splitlines()) == 1
    assert second.stderr == ""
    assert first.stdout.startswith(str(tmp_path))


def test_where_no_cache_can_be_kept_the_error_says_what_to_do():
    code = (
        "from numba.core import caching; caching.CacheImpl._locator_classes = []\n"
        "from nfbench import NfbenchError\n"
        "try:\n    import nfbench.problems.near_field.objectives.kernels\n"
        "except NfbenchError as error:\n    print(error)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "set NUMBA_CACHE_DIR to a writable folder" in done.stdout


def test_importing_nfbench_does_not_import_numba():
    code = "import sys, nfbench; assert 'numba' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
