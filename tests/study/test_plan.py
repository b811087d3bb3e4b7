"""Tests that run identities and seeds depend only on what is computed."""

import json
import pickle
from dataclasses import asdict, replace

import pytest
from conftest import BASIC

from nfbench import ManifestError, load_study

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


PINNED = ("b994129259c7fa0e62f9", 6871100851758048780, 8528600120412109636)


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


def test_points_and_methods_share_the_seeds_of_scenes_but_not_those_of_solvers(manifest):
    specs = list(load_study(manifest(MORE + "[sweep]\ndimension = [2, 3]\n")).specs())
    assert len({(spec.instance_seed, spec.repetition) for spec in specs}) == 3
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


def test_a_study_runs_its_stochastic_methods_several_times_on_each_scene(manifest):
    text = MORE + '[[solver]]\nkind = "scipy-direct"\n[sweep]\ndimension = [2, 3]\n'
    path = manifest(text)
    once = load_study(path)
    path.write_text(path.read_text().replace("repetitions = 3", "scenes = 3\nruns_per_scene = 4"))
    study = load_study(path)
    stochastic = [method.label for method in study.methods if method.is_stochastic]
    assert len(stochastic) == 2 and len(study.methods) == 3
    specs = list(study.specs())
    assert len(study) == len(specs) == 3 * 2 * (2 * 4 + 1)
    cells = [(spec.repetition, spec.point.swept["dimension"], spec.method.label) for spec in specs]
    assert len(set(cells)) == len({spec.run_id for spec in specs}) == len({spec.solver_seed for spec in specs}) == 54
    assert {(number, label) for number, _, label in cells if label not in stochastic} == {
        (4 * scene, "once + scipy-direct") for scene in range(3)
    }
    scenes = {spec.repetition // 4: spec.instance_seed for spec in specs}
    assert all(spec.instance_seed == scenes[spec.repetition // 4] for spec in specs)
    first = {spec.run_id: spec.solver_seed for spec in specs if spec.repetition % 4 == 0}
    assert first == {spec.run_id: spec.solver_seed for spec in once.specs()}  # more runs change no other run


def test_limits_of_the_budget_can_be_swept_and_do_not_change_the_scenes(manifest):
    study = load_study(manifest(BASIC + '[sweep]\n"budget.evaluations" = [10, 1000]\n"scenario.noise" = [0.0, 0.5]\n'))
    assert study.swept == ["budget.evaluations", "noise"]
    specs = list(study.specs())
    assert [spec.method.budget["evaluations"] for spec in specs[:4]] == [10, 10, 1000, 1000]
    assert [spec.point.swept["budget.evaluations"] for spec in specs[:4]] == [10, 10, 1000, 1000]
    assert len({spec.run_id for spec in specs}) == 12
    assert len({spec.instance_seed for spec in specs}) == 3


@pytest.mark.parametrize(
    ("sweep", "message"),
    [
        ('"budget.evaluations" = [10, 0]', "sweep.budget.evaluations[1]: expected greater than or equal to 1, got 0"),
        ('"budget.run_timeout_s" = [1.0]', "sweep.budget.run_timeout_s[0]: cannot be swept"),
        ('"budget.evaluations" = [10, 10]', "sweep.budget.evaluations[1]: gives the same scenario as"),
        ('"scenario.noise" = [0.0]\nnoise = [0.5]', "is given twice, as noise and as scenario.noise"),
    ],
)
def test_invalid_swept_limits_are_reported_at_their_value(manifest, sweep, message):
    with pytest.raises(ManifestError) as caught:
        load_study(manifest(f"{BASIC}\n[sweep]\n{sweep}\n"))
    assert any(message in text for text in caught.value.problems), caught.value.problems


def test_a_limit_of_a_method_that_is_also_swept_is_refused(manifest):
    own = BASIC.replace('kind = "once"', 'kind = "once"\nbudget = { evaluations = 7 }')
    with pytest.raises(ManifestError, match=r"formulation\[0\].budget.evaluations: is swept by"):
        load_study(manifest(own + '[sweep]\n"budget.evaluations" = [10, 20]\n'))


def test_scenes_and_its_old_name_are_not_both_given(manifest):
    path = manifest(BASIC)
    path.write_text("scenes = 2\n" + path.read_text())
    with pytest.raises(ManifestError, match="repetitions: is the old name of scenes; give only one of the two"):
        load_study(path)


def test_all_labels_of_a_group_name_the_budget_if_one_must(tmp_path):
    """The first solver runs with both budgets, the others of its group with the smaller one only."""
    text = """
name = "labels"
scenes = 1
seed = 1
[scenario]
kind = "functions"
[[method]]
formulation = "direct"
solver = "scipy-direct"
budget = { evaluations = 500 }
[[method]]
formulation = "direct"
solver = { group = "deterministic" }
budget = { evaluations = 100 }
[[method]]
formulation = "direct"
solver = "de"
budget = { evaluations = 900 }
"""
    path = tmp_path / "labels.toml"
    path.write_text(text, encoding="utf-8")
    labels = [method.label for method in load_study(path).methods]
    assert labels[0] == "direct + scipy-direct" and labels[-1] == "direct + de"
    assert "direct + scipy-direct @100" in labels and "direct + nlopt-direct @100" in labels
    assert all(label.endswith(" @100") for label in labels[1:-1])
