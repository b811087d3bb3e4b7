"""Tests that run identities and seeds depend only on what is computed."""

import json
import pickle
from dataclasses import asdict, replace

import pytest
from conftest import BASIC

from nfbench import load_study

MORE = BASIC + '[[solver]]\nkind = "sampler"\nbatch = 3\n'


def ids(path):
    return [spec.run_id for spec in load_study(path).specs()]


def by_id(path):
    return {spec.run_id: spec for spec in load_study(path).specs()}


def test_specs_are_plain_data_and_reproducible(manifest):
    study = load_study(manifest(MORE))
    specs = list(study.specs())
    assert specs == list(study.specs()) == list(load_study(manifest(MORE)).specs())
    assert len({spec.run_id for spec in specs}) == len(specs) == 6
    assert pickle.loads(pickle.dumps(specs)) == specs
    assert json.loads(json.dumps(asdict(specs[0])))["run_id"] == specs[0].run_id


def test_an_identity_is_stable_across_versions_of_the_code(manifest):
    study = load_study(manifest(BASIC, repetitions=1))
    point, method = study.points[0], study.methods[0]
    pinned = replace(
        study,
        points=(replace(point, scenario=replace(point.scenario, version="1")),),
        methods=(
            replace(
                method,
                formulation=replace(method.formulation, version="1"),
                solver=replace(method.solver, version="1"),
            ),
        ),
    )
    (spec,) = pinned.specs()
    assert (spec.run_id, spec.instance_seed, spec.solver_seed) == PINNED


PINNED = ("66f014b937cf8ff0b10a", 6866092018086572425, 7474588578027608012)


def test_a_new_option_of_a_plugin_does_not_change_the_seeds(manifest, tmp_path):
    plugin = tmp_path / "mine.py"
    before, after = {}, {}
    for found, more in ((before, ""), (after, "    patience: int = 3\n")):
        plugin.write_text(PLUGIN_SOURCE.replace("    # more\n", more))
        study = load_study(manifest(BASIC.replace('"sampler"', '"mine"\nbatch = 3'), plugins=[plugin]))
        found.update({spec.repetition: (spec.instance_seed, spec.solver_seed) for spec in study.specs()})
        assert ("patience" in study.methods[0].solver.options) == bool(more)
    assert before == after and len(before) == len({*before.values()}) == 3


PLUGIN_SOURCE = """
from dataclasses import dataclass
from nfbench import Solver, SolverInfo

@dataclass(frozen=True)
class Mine(Solver):
    \"\"\"Does nothing.\"\"\"
    batch: int = 8
    # more
    info = SolverInfo()

    def minimize(self, problem, rng):
        problem(problem.lower)
"""


def test_methods_share_instance_seeds_but_not_solver_seeds(manifest):
    specs = list(load_study(manifest(MORE + "[sweep]\ndimension = [2, 3]\n")).specs())
    instances = {(spec.point.swept["dimension"], spec.repetition) for spec in specs}
    assert len({spec.instance_seed for spec in specs}) == len(instances) == 6
    assert len({spec.solver_seed for spec in specs}) == len(specs) == 12
    assert all(0 <= spec.solver_seed < 2**63 for spec in specs)


@pytest.mark.parametrize(
    "change",
    [
        {"extra": MORE},
        {"extra": BASIC, "repetitions": 7},
        {"extra": BASIC + "[sweep]\nnoise = [0.0, 0.5]\n"},
    ],
)
def test_adding_to_a_study_does_not_change_its_runs(manifest, change):
    before = by_id(manifest(BASIC))
    after = by_id(manifest(**change))
    assert len(after) > len(before)
    for run_id, spec in before.items():
        other = after[run_id]
        assert (other.instance_seed, other.solver_seed) == (spec.instance_seed, spec.solver_seed)


@pytest.mark.parametrize(
    "same",
    [
        {"extra": BASIC + "run_timeout_s = 3.0"},
        {"extra": BASIC.replace('"sampler"', '"sampler"\nbatch = 8')},
        {"extra": BASIC.replace('"sampler"', '"sampler"\nlabel = "mine"')},
        {"extra": BASIC, "scenario": "noise = 0"},
        {"extra": BASIC, "name": "other"},
    ],
)
def test_changes_that_do_not_affect_the_result_keep_the_run_ids(manifest, same):
    assert ids(manifest(**same)) == ids(manifest(BASIC))


@pytest.mark.parametrize(
    "other",
    [
        {"extra": BASIC, "seed": 2},
        {"extra": BASIC.replace("= 40", "= 41")},
        {"extra": BASIC, "scenario": "noise = 0.5"},
        {"extra": BASIC.replace('"sampler"', '"sampler"\nbatch = 9')},
        {"extra": BASIC.replace('"once"', '"once"\nshift = 1.0')},
    ],
)
def test_changes_that_affect_the_result_change_the_run_ids(manifest, other):
    assert not set(ids(manifest(**other))) & set(ids(manifest(BASIC)))
