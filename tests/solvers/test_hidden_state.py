"""Libraries with hidden state: a run does not depend on the runs before it, nor does it change the process."""

import importlib.util
import subprocess
import sys
import threading

import nlopt
import numpy as np
import pandas as pd
import pytest
from conftest import nfbench as command

import nfbench
from nfbench import BudgetExhausted, OptionError, Status
from nfbench.solvers import _nevergrad
from nfbench.testing import Probe

fcmaes = pytest.mark.skipif(importlib.util.find_spec("fcmaes") is None, reason="pip install 'nfbench[fcmaes]'")
nevergrad = pytest.mark.skipif(importlib.util.find_spec("nevergrad") is None, reason="pip install 'nfbench[nevergrad]'")


def points(solver, n, evaluations, seed, **options):
    """The digest of the points of a run."""
    probe = Probe(np.resize([-1 / 3, 0.1, -7.7], n), np.resize([0.7, 3.3, 0.1], n), **options)
    nfbench.minimize(probe, solver, evaluations, seed)
    return probe.digest


@fcmaes
@pytest.mark.parametrize(("algorithm", "population"), [("CRFMNES", None), ("ACMA", None), ("ACMA", 7), ("PGPE", 6)])
@pytest.mark.parametrize("n", [3, 6, 7])
def test_runs_of_fcmaes_do_not_depend_on_a_cached_normal_deviate(algorithm, population, n):
    solver = nfbench.solver("fcmaes", algorithm=algorithm, population=population)
    first = points(solver, n, 300, 7)
    for m in (1, 2, 3, 5, 8):
        for evaluations in (1, 3, 33, 100):
            points(solver, m, evaluations, 3)
            assert points(solver, n, 300, 7) == first
    points(solver, 5, 200, 3, stop=ValueError, stop_at=80)
    assert points(solver, n, 300, 7) == first


@fcmaes
def test_the_cache_of_fcmaes_is_emptied_whatever_its_state():
    from nfbench.solvers import fcmaes as module

    for algorithm in module.ODD_DRAWS:
        reference = module._from_empty_cache(algorithm)
        for odd_runs in range(4):
            for _ in range(odd_runs):
                module._odd_run(algorithm, seed=5)
            module._empty_cache(algorithm)
            assert module._odd_run(algorithm, seed=0) == reference
            assert module._odd_run(algorithm, seed=0) != reference  # begins with what the previous one left


@fcmaes
def test_a_first_run_of_fcmaes_is_what_the_library_computes(tmp_path):
    """The remedy changes no number of a run in a new process: its first points are those of the bare library."""
    code = """
import numpy as np
from fcmaes.crfmnescpp import CRFMNES_C
from scipy.optimize import Bounds
rng = np.random.default_rng(7)
state = CRFMNES_C(6, bounds=Bounds(np.zeros(6), np.ones(6)), rg=rng, x0=rng.random(6), input_sigma=0.3)
print(np.array(state.ask()).tobytes().hex())
"""
    bare = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    expected = np.frombuffer(bytes.fromhex(bare.stdout)).reshape(-1, 6)
    seen = []

    class Box(Probe):
        def evaluate(self, X):
            seen.append(X.copy())
            return super().evaluate(X)

    nfbench.minimize(Box(np.zeros(6), np.ones(6)), nfbench.solver("fcmaes", algorithm="CRFMNES"), 32, 7)
    assert np.array_equal(np.concatenate(seen), expected)


@fcmaes
def test_the_import_of_fcmaes_leaves_the_print_options_of_numpy():
    code = """
import numpy as np, nfbench
before = np.get_printoptions()
nfbench.solver("fcmaes").warm_up()
import sys
print("fcmaes" in sys.modules, np.get_printoptions() == before)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    assert done.stdout.split() == ["True", "True"]


@nevergrad
@pytest.mark.parametrize("algorithm", ["CmaFmin2", "Carola13", "NLOPT_GN_CRS2_LM", "NLOPT_GN_ISRES", "BAR", "DSproba"])
def test_algorithms_of_nevergrad_that_were_seeded_by_the_clock_or_kept_state_repeat_their_runs(algorithm):
    solver = nfbench.solver("nevergrad", algorithm=algorithm)
    first = points(solver, 3, 61, 7)
    for n, evaluations in ((1, 3), (2, 33)):
        points(solver, n, evaluations, 3)
        assert points(solver, 3, 61, 7) == first
    assert points(solver, 3, 61, 8) != first


@nevergrad
@pytest.mark.parametrize("stop", [BudgetExhausted, ValueError])
def test_no_thread_of_nevergrad_survives_a_run(stop):
    points(nfbench.solver("nevergrad", algorithm="Cobyla"), 3, 40, 1, stop=stop, stop_at=20)
    assert threading.enumerate() == [threading.main_thread()]


@nevergrad
def test_the_libraries_that_nevergrad_calls_are_left_as_they_were():
    import nlopt
    from cma.options_parameters import cma_default_options

    before = nlopt.opt, cma_default_options["seed"]
    points(nfbench.solver("nevergrad", algorithm="CmaFmin2"), 3, 40, 1, stop=ValueError, stop_at=20)
    assert (nlopt.opt, cma_default_options["seed"]) == before


@nevergrad
@pytest.mark.parametrize(
    ("algorithm", "reason"),
    [
        ("NgIohRS", "it waits forever for a value that Nevergrad does not pass on"),
        ("VoxelizeMetaModelOnePlusOne", "it trains for a number of seconds, so that its runs cannot be repeated"),
    ],
)
def test_an_algorithm_that_cannot_work_is_refused_before_it_runs(algorithm, reason):
    with pytest.raises(OptionError) as caught:
        nfbench.solver("nevergrad", algorithm=algorithm)
    assert caught.value.problems == [
        ("algorithm", f"expected an optimizer that works here, got {algorithm!r}: {reason}")
    ]


@nevergrad
def test_surrogate_models_are_refused_exactly_where_numpy_refuses_the_conversion():
    from importlib.metadata import version

    try:
        float(np.ones(1))
        expected = ""
    except TypeError:
        expected = (
            f"the surrogate models of Nevergrad {version('nevergrad')} fail with NumPy {np.__version__}; "
            "pip install 'numpy<2.4' or choose another algorithm"
        )
    assert _nevergrad.surrogates_fail() == expected
    assert _nevergrad.cannot_be_used().get("MetaModel", "") == expected
    if expected:
        with pytest.raises(OptionError, match=r"got 'NgIoh4': the surrogate models of Nevergrad .* fail with NumPy"):
            nfbench.solver("nevergrad", algorithm="NgIoh4")


@nevergrad
def test_the_unusable_algorithms_are_known_without_importing_nevergrad():
    code = """
import sys
from nfbench.plugins import Registry
broken = Registry().find("solver", "nevergrad").resolve().unusable()
print(len(broken) > 5, "nevergrad" in sys.modules, "pymoo" in sys.modules)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    assert done.stdout.split()[:2] == ["True", "False"]


@nevergrad
def test_every_name_of_an_unusable_algorithm_is_in_the_registry():
    from nfbench.solvers.nevergrad import _registry

    listed = {*_nevergrad.EXCLUDED, *_nevergrad.REQUIRES, *_nevergrad.SURROGATE.split()}
    assert listed <= {*_registry()}
    assert {name for name in _registry() if "MetaModel" in name} <= listed


class Chooses:
    """An optimizer with the interface of Nevergrad that raises ``error`` when it is asked for the eleventh point."""

    error: Exception

    def __init__(self, box, budget):
        self.box, self.asked = box, 0

    def ask(self):
        self.asked += 1
        if self.asked > 10:
            raise self.error
        return self.box.sample()

    def tell(self, candidate, value):
        pass


@nevergrad
@pytest.mark.parametrize(
    ("error", "status", "message"),
    [
        (
            TypeError("only 0-dimensional arrays can be converted to Python scalars"),
            Status.SKIPPED,
            "for this budget and number of unknowns, the models fail here",
        ),
        (
            ModuleNotFoundError("No module named 'smac'", name="smac"),
            Status.SKIPPED,
            "for this budget and number of unknowns, it needs the module smac, which is not installed here",
        ),
        (nlopt.RoundoffLimited("rounding"), Status.OK, ""),
        (TypeError("unhashable type"), Status.FAILED, "TypeError: unhashable type"),
    ],
)
def test_what_an_optimizer_chooses_itself_may_not_work_here(monkeypatch, error, status, message):
    """An optimizer may choose its method by the budget; this is known only when it does."""
    from nfbench.solvers import nevergrad as module

    monkeypatch.setattr(module, "surrogates_fail", lambda: "the models fail here")
    monkeypatch.setattr(module, "_registry", lambda: {"TwoPointsDE": type("Choice", (Chooses,), {"error": error})})
    minimum = nfbench.minimize(Probe(np.zeros(2), np.ones(2)), nfbench.solver("nevergrad"), 50)
    assert minimum.status == status
    assert minimum.message.startswith(message) and minimum.evaluations == 10


@nevergrad
@pytest.mark.slow
def test_every_refused_surrogate_fails_and_every_missing_module_is_needed(monkeypatch):
    """The lists are measured, not guessed: without the refusal, most of these algorithms fail in one of a few runs."""
    from nfbench.solvers import nevergrad as module

    refused = {name: why for name, why in _nevergrad.cannot_be_used().items() if name not in _nevergrad.EXCLUDED}
    monkeypatch.setattr(module, "cannot_be_used", dict)
    works = []
    for name in refused:
        solver = nfbench.solver("nevergrad", algorithm=name)
        cases = ((3, 120, 7), (2, 60, 1), (6, 200, 2))
        probes = [(Probe(np.resize([-1 / 3, 0.1], n), np.resize([0.7, 3.3], n)), count, s) for n, count, s in cases]
        if all(nfbench.minimize(probe, solver, count, s).status is Status.OK for probe, count, s in probes):
            works.append(name)
    # the models of these are not always good enough to be used
    assert [name for name in works if "SVM" not in name and "RF" not in name] == []


@fcmaes
def test_the_number_of_workers_does_not_change_the_rows(tmp_path):
    """CR-FM-NES in an odd number of unknowns: each run used to begin with a deviate of the run before it."""
    manifest = tmp_path / "study.toml"
    manifest.write_text(
        """
name = "study"
repetitions = 4
seed = 3
[scenario]
kind = "functions"
function = "sphere"
[sweep]
dimension = [6, 7]
[[formulation]]
kind = "direct"
[[solver]]
kind = "fcmaes"
algorithm = "CRFMNES"
[[solver]]
kind = "fcmaes"
algorithm = "ACMA"
[budget]
evaluations = 301
"""
    )
    tables = []
    for jobs in (1, 2):
        out = tmp_path / f"jobs-{jobs}"
        done = command("run", manifest, "--jobs", jobs, "--out", out, "--quiet", cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        tables.append(
            pd.read_csv(out / "runs.csv").sort_values("run_id").drop(columns=["runtime_s", "cpu_s", "evaluation_s"])
        )
    assert (tables[0].status == "ok").all() and len(tables[0]) == 16
    pd.testing.assert_frame_equal(*(table.reset_index(drop=True) for table in tables))
