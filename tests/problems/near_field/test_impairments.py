"""Each impairment has the right value: sample covariances, statistics and formulas of an independent model."""

import math
from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import nfbench
from nfbench import OptionError
from nfbench.problems.near_field.impairments import Impairments, mixing_matrix
from nfbench.problems.near_field.scenario import NearField

WAVELENGTH = 0.02
ELEMENTS = 8
SCENE = {
    "array": {"kind": "ula", "elements": ELEMENTS, "spacing_wavelengths": 0.5, "origin": "center"},
    "wavelength_m": WAVELENGTH,
    "sources": 2,
    "snapshots": 50,
    "snr_db": (3.0, -2.0),
    "azimuth_deg": (-60, 60),
    "range_m": (0.1, 1.0),
    "positions": ((-20.0, 0.12), (30.0, 0.2)),
}
EVERYTHING = {
    "gain_error_db": 3.0,
    "phase_error_deg": 50.0,
    "position_error_wavelengths": 0.2,
    "failed_elements": (2, 5),
    "amplitude": "spherical",
    "coupling_db": -6.0,
    "coupling_phase_deg": 40.0,
    "noise_level_db": 3.0,
    "noise_correlation_wavelengths": 0.8,
    "source_correlation": 0.7,
    "source_correlation_phase_deg": 25.0,
}


def draw(seed=3, *, impairments=None, **changes):
    options = SCENE | changes | ({} if impairments is None else {"impairments": impairments})
    return NearField(**options).draw(np.random.default_rng(seed))


def wrong(impairments, **changes) -> str:
    with pytest.raises(OptionError) as caught:
        draw(impairments=impairments, **changes)
    return str(caught.value)


def modelled_covariance(instance, **impairments) -> np.ndarray:
    """Γ·C·A·P·Aᴴ·Cᴴ·Γᴴ + R_n, entry by entry from the definitions, for the impairments that were drawn."""
    sources = [range_m * np.array([math.cos(angle), math.sin(angle), 0.0]) for angle, range_m in instance.theta]
    k = 2 * math.pi / WAVELENGTH
    A = np.array([[np.linalg.norm(p - q) for p in sources] for q in instance.element_positions])
    ranges = instance.theta[:, 1]
    A = ranges / A * np.exp(1j * k * (ranges - A))
    powers = np.sqrt(10 ** (np.array(SCENE["snr_db"]) / 10))
    chi = math.radians(impairments["source_correlation_phase_deg"])
    rho = impairments["source_correlation"] * np.exp(-1j * chi)  # of sources 0 and 1: k − l = −1
    P = np.array([[1, rho], [rho.conjugate(), 1]]) * np.outer(powers, powers)
    nominal = instance.manifold.positions
    distance = np.abs(np.subtract.outer(nominal[:, 1], nominal[:, 1]))
    c = 10 ** (impairments["coupling_db"] / 20) * np.exp(1j * math.radians(impairments["coupling_phase_deg"]))
    C = np.abs(c) ** (distance / (WAVELENGTH / 2)) * np.exp(1j * np.angle(c) * distance / (WAVELENGTH / 2))
    G = np.diag([0 if m in impairments["failed_elements"] else g for m, g in enumerate(instance.gains)])
    levels = np.sqrt(np.diag(instance.noise_covariance).real)
    length = impairments["noise_correlation_wavelengths"] * WAVELENGTH
    noise = np.outer(levels, levels) * np.exp(-distance / length)
    return G @ C @ A @ P @ A.conj().T @ C.conj().T @ G.conj().T + noise


def test_the_sample_covariance_of_many_snapshots_is_that_of_the_model():
    instance = draw(impairments=EVERYTHING, snapshots=200_000)
    sample = instance.Y @ instance.Y.conj().T / 200_000
    expected = modelled_covariance(instance, **EVERYTHING)
    deviation = np.sqrt(np.outer(np.diag(expected).real, np.diag(expected).real))
    assert_allclose(sample / deviation, expected / deviation, rtol=0, atol=5 / math.sqrt(200_000))
    wrong_sign = modelled_covariance(instance, **EVERYTHING | {"source_correlation_phase_deg": -25.0})
    assert np.abs((sample - wrong_sign) / deviation).max() > 0.02


def test_without_impairments_the_streams_and_the_data_are_those_of_the_four_first_children():
    instance = draw(seed=11)
    _, _, for_symbols, for_noise = np.random.default_rng(11).spawn(4)
    S, N = (
        np.stack([own.standard_normal((50, 2)).view(complex)[:, 0] * math.sqrt(0.5) for own in rng.spawn(rows)])
        for rng, rows in ((for_symbols, 2), (for_noise, ELEMENTS))
    )
    A = instance.manifold.response(instance.theta).T
    expected = A @ (np.sqrt(instance.snr)[:, None] * S) + N
    assert_allclose(instance.Y, expected, rtol=0, atol=1e-12)
    assert instance.gains is instance.coupling is instance.noise_covariance is instance.correlation is None
    assert instance.failed == () and instance.element_positions is None


@pytest.mark.parametrize("name", [name for name in EVERYTHING if not name.endswith("phase_deg")])
def test_an_impairment_leaves_symbols_and_noise_of_the_scene_as_they_are(name):
    plain, changed = draw(), draw(impairments={name: EVERYTHING[name]})
    assert_array_equal(plain.theta, changed.theta)
    assert not np.array_equal(plain.Y, changed.Y)
    if name != "source_correlation":
        assert_array_equal(plain.symbols, changed.symbols)
    if "noise" not in name:
        noise = [each.Y - each.H[0] @ each.symbols for each in (plain, changed)]
        assert_allclose(noise[0], noise[1], rtol=0, atol=1e-12)


def test_an_impairment_of_size_zero_changes_no_bit():
    zeros = {
        "gain_error_db": 0.0,
        "failed_elements": (),
        "noise_correlation_wavelengths": 0.0,
        "coupling_phase_deg": 9.0,
    }
    assert_array_equal(draw().Y, draw(impairments=zeros).Y)


def test_random_errors_have_the_stated_standard_deviations():
    many = {"array": {"kind": "ula", "elements": 3000, "spacing_wavelengths": 0.5, "origin": "center"}, "snapshots": 1}
    sizes = {"gain_error_db": 2.0, "phase_error_deg": 10.0, "position_error_wavelengths": 0.1, "noise_level_db": 4.0}
    instance = draw(impairments=sizes, **many)
    decibels = 20 * np.log10(np.abs(instance.gains))
    degrees = np.degrees(np.angle(instance.gains))
    shifts = (instance.element_positions - instance.manifold.positions) / WAVELENGTH
    levels = 10 * np.log10(np.diag(instance.noise_covariance).real)
    for values, size in ((decibels, 2.0), (degrees, 10.0), (shifts, 0.1), (levels, 4.0)):
        assert_allclose(values.std(), size, rtol=0.05)
        assert abs(values.mean()) < 0.08 * size
    assert abs(np.corrcoef(decibels, degrees)[0, 1]) < 0.06


def test_random_errors_scale_with_their_size_and_do_not_depend_on_further_elements():
    small, large = (draw(impairments={"gain_error_db": size, "phase_error_deg": size}).gains for size in (1.0, 3.0))
    assert_allclose(np.log(large), 3 * np.log(small), rtol=1e-10)
    bigger = {"array": SCENE["array"] | {"elements": ELEMENTS + 3}}
    more = draw(impairments={"gain_error_db": 1.0, "phase_error_deg": 1.0}, **bigger).gains
    assert_array_equal(more[:ELEMENTS], small)
    failures = [set(draw(impairments={"failed_elements": n}).failed) for n in range(6)]
    assert [len(each) for each in failures] == list(range(6))
    assert all(few < many for few, many in pairwise(failures))
    assert draw(1, impairments={"failed_elements": 3}).failed != draw(2, impairments={"failed_elements": 3}).failed


def test_errors_along_the_axes_of_the_array_stay_on_its_line():
    shift = draw(impairments={"position_error_wavelengths": 0.1, "position_error_axes": "array"}).element_positions
    assert_allclose(shift[:, [0, 2]], 0.0, atol=1e-12)
    assert np.abs(shift[:, 1] - draw().manifold.positions[:, 1]).max() > 0.01 * WAVELENGTH


def test_failed_elements_receive_noise_only():
    instance = draw(impairments={"failed_elements": (1, 6)}, snr_db=40.0, snapshots=2000)
    power = np.mean(np.abs(instance.Y) ** 2, axis=1)
    assert_allclose(power[[1, 6]], 1.0, rtol=0.15)
    assert (np.delete(power, [1, 6]) > 1e3).all()


def test_a_spherical_amplitude_is_the_ratio_of_the_distances():
    instance = draw(impairments={"amplitude": "spherical"})
    p = 0.12 * np.array([math.cos(math.radians(-20)), math.sin(math.radians(-20)), 0])
    distances = np.linalg.norm(p - instance.manifold.positions, axis=1)
    assert_allclose(np.abs(instance.H[0, :, 0]), 0.12 / distances, rtol=1e-12)
    assert np.ptp(0.12 / distances) > 0.1


def test_coupling_reaches_as_far_as_stated():
    C = draw(impairments={"coupling_db": -20.0, "coupling_phase_deg": 90.0, "coupling_reach": 2}).coupling
    assert_allclose(C[3, :6], [0, -0.01, 0.1j, 1, 0.1j, -0.01], atol=1e-12)
    assert C[0, 3] == 0


def test_levels_may_be_listed():
    levels = tuple(float(m) for m in range(ELEMENTS))
    R = draw(impairments={"noise_level_db": levels}).noise_covariance
    assert_allclose(R, np.diag(10 ** (np.arange(ELEMENTS) / 10)), rtol=1e-12)


def test_coherent_sources_send_one_symbol_with_the_stated_phase():
    instance = draw(impairments={"source_correlation": 1.0, "source_correlation_phase_deg": 90.0}, sources=2)
    assert_allclose(instance.symbols[1] / np.sqrt(instance.snr[1]), 1j * instance.symbols[0] / np.sqrt(instance.snr[0]))
    assert_array_equal(instance.symbols[0], draw().symbols[0])  # the first source does not depend on the others


@pytest.mark.parametrize("rho", [-0.5, 0.3, 1.0])
def test_a_mixing_matrix_is_a_root_of_the_correlation(rho):
    P = Impairments(source_correlation=rho, source_correlation_phase_deg=20.0).correlation(3)
    L = mixing_matrix(P)
    assert_allclose(L @ L.conj().T, P, atol=1e-12)
    assert_allclose(P[0, 2], rho * np.exp(-1j * math.radians(40)), atol=1e-12)
    assert_allclose(np.triu(L, 1), 0)


def test_a_correlation_matrix_may_be_listed_with_complex_entries():
    P = Impairments(source_correlation=((1.0, (0.3, 0.4)), ((0.3, -0.4), 1.0))).correlation(2)
    assert_array_equal(P, [[1, 0.3 + 0.4j], [0.3 - 0.4j, 1]])


@pytest.mark.parametrize(
    ("impairments", "message"),
    [
        ({"failed_elements": (1, 8)}, "impairments.failed_elements: expected indices from 0 to 7, got 8"),
        ({"failed_elements": 7}, "expected at most 6 of 8, got 7"),
        ({"failed_elements": (1, 1)}, "expected distinct indices"),
        ({"noise_level_db": (1.0, 2.0)}, "expected one number, or 8 (one per element), got 2"),
        ({"source_correlation": ((1.0, 0.5), (0.4, 1.0))}, "expected a Hermitian matrix"),
        (
            {"source_correlation": ((1.0, 1.5), (1.5, 1.0))},
            "positive semidefinite matrix, got one with the eigenvalue -0.5",
        ),
        ({"source_correlation": ((2.0, 0.5), (0.5, 1.0))}, "expected ones on the diagonal, got [2.0, 1.0]"),
        ({"source_correlation": ((1.0, 0.5, 0.1), (0.5, 1.0, 0.1))}, "or 2 rows of 2 entries, got 2 rows of 3"),
        ({"gain_error_db": -1.0}, "gain_error_db"),
        ({"gain_eror_db": 1.0}, 'did you mean "gain_error_db"?'),
        ({"coupling_db": 3.0}, "coupling_db"),
    ],
)
def test_impossible_impairments_are_refused(impairments, message):
    assert message in wrong(impairments)


def test_three_sources_cannot_be_strongly_anticorrelated():
    positions = (*SCENE["positions"], (5.0, 0.3))
    assert "eigenvalue -0.8" in wrong({"source_correlation": -0.9}, sources=3, positions=positions, snr_db=0.0)


def test_a_planar_wave_has_no_decay():
    assert 'expected "constant" for a planar wavefront' in wrong({"amplitude": "spherical"}, wavefront="planar")


def test_matrices_are_read_from_files(tmp_path):
    rng = np.random.default_rng(0)
    B = rng.normal(size=(ELEMENTS, ELEMENTS)) + 1j * rng.normal(size=(ELEMENTS, ELEMENTS))
    R, C = B @ B.conj().T + np.eye(ELEMENTS), np.eye(ELEMENTS) + 0.1 * B
    np.save(tmp_path / "R.npy", R)
    np.save(tmp_path / "C.npy", C)
    files = {"noise_covariance_file": str(tmp_path / "R.npy"), "coupling_file": str(tmp_path / "C.npy")}
    instance = draw(impairments=files, snapshots=20_000)
    assert_array_equal(instance.coupling, C)
    assert_allclose(instance.noise_covariance, R * ELEMENTS / np.trace(R).real)
    N = instance.Y - instance.H[0] @ instance.symbols
    assert_allclose(N @ N.conj().T / 20_000, instance.noise_covariance, atol=0.1)

    built = NearField(**SCENE, impairments=files).impairments
    np.save(tmp_path / "C.npy", 2 * C)
    with pytest.raises(OptionError, match="the file has changed since the study was started"):
        Impairments(**files, coupling_digest=built.coupling_digest)


def test_damaged_and_unsuitable_files_are_refused(tmp_path):
    def refused(content, name="noise_covariance_file") -> str:
        path = tmp_path / "given.npy"
        if isinstance(content, bytes):
            path.write_bytes(content)
        else:
            np.save(path, content, allow_pickle=True)
        return wrong({name: str(path)})

    assert "expected shape (8, 8), one row per element, got (3, 3)" in refused(np.eye(3))
    assert "got NaN or infinite" in refused(np.full((ELEMENTS, ELEMENTS), np.nan))
    assert "expected a positive definite matrix, got eigenvalues" in refused(np.ones((ELEMENTS, ELEMENTS)))
    assert "expected a Hermitian matrix" in refused(np.triu(np.ones((ELEMENTS, ELEMENTS))) + np.eye(ELEMENTS))
    assert "can be inverted" in refused(np.ones((ELEMENTS, ELEMENTS)), "coupling_file")
    assert "given.npy" in refused(np.array([[1, "x"], [None, 2]], dtype=object))  # a pickle
    assert "expected numbers" in refused(np.array([["a", "b"], ["c", "d"]]))
    assert "given.npy" in refused(b"")
    assert "given.npy" in refused(b"\x93NUMPY\x01\x00v\x00" + b"{'descr': '<c16', 'fortran_order': False, 'shape'")
    truncated = b"\x93NUMPY\x01\x00\x46\x00{'descr': '<c16', 'fortran_order': False, 'shape': (8, 8), }           \n"
    assert "given.npy" in refused(truncated)
    assert "expected a regular file" in wrong({"coupling_file": str(tmp_path)})


def test_a_study_sweeps_an_impairment(tmp_path):
    lines = ['name = "s"', "scenes = 2", "seed = 1", "[scenario]", 'kind = "near-field"', "wavelength_m = 0.02"]
    lines += ['array = { kind = "ula", elements = 8, spacing_wavelengths = 0.5, origin = "center" }', "sources = 1"]
    lines += ["snapshots = 20", "snr_db = 10", "azimuth_deg = [-60, 60]", "range_m = [0.1, 1.0]", "[sweep]"]
    lines += ['"impairments.failed_elements" = [0, 2, [1, 3]]', "[[method]]", 'formulation = "grid-refine"']
    path = tmp_path / "s.toml"
    path.write_text("\n".join(lines), encoding="utf-8")
    runs = nfbench.run(nfbench.load_study(path), out=tmp_path / "out", jobs=0).runs
    assert (runs["status"] == "ok").all() and len(runs) == 6
    bounds = runs.groupby("scenario.impairments.failed_elements")["crb_m"].mean()
    assert len(bounds) == 3 and bounds.nunique() == 3  # a failed element costs information
