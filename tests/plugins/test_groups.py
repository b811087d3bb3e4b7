"""Tests of groups of solvers in manifests and lists, and of solvers whose library is not installed."""

import re

import pytest
from conftest import BASIC, nfbench

from nfbench import ManifestError, MissingExtra, SolverInfo, load_study
from nfbench.plugins.groups import GROUPS
from nfbench.plugins.registry import Registry

PLUGIN = """
from dataclasses import dataclass
from nfbench import Extra, Instance, Scenario, Solver, SolverInfo

@dataclass(frozen=True)
class Slope(Solver):
    \"\"\"Uses the gradient.\"\"\"
    info = SolverInfo(stochastic=False, needs_gradient=True, global_search=False)
    step: float = 1.0

    def minimize(self, problem, rng):
        problem.value_and_gradient(problem.lower)

@dataclass(frozen=True)
class Rare(Solver):
    \"\"\"Wraps a library that does not exist.\"\"\"
    info = SolverInfo(needs_gradient=True, requires=("no_such_library",))
    step: float = 1.0

    def minimize(self, problem, rng):
        import no_such_library

@dataclass(frozen=True)
class Moon(Scenario):
    \"\"\"Needs a library that does not exist.\"\"\"
    instance = Instance
    backend: str = "no_such_library"

    def needed_extra(self):
        return Extra(None, (self.backend,))

    def draw(self, rng):
        raise NotImplementedError
"""


@pytest.fixture
def plugin(tmp_path):
    (tmp_path / "mine.py").write_text(PLUGIN)
    return tmp_path / "mine.py"


def kinds(path):
    return [method.solver.kind for method in load_study(path).methods]


def problems(path):
    with pytest.raises(ManifestError) as caught:
        load_study(path)
    return caught.value.problems


def grouped(entry):
    return BASIC.replace('kind = "sampler"', entry)


def test_a_group_contains_every_installed_solver_with_the_property(manifest):
    registry = Registry()
    found = kinds(manifest(grouped('group = "deterministic"')))
    infos = {name: registry.find("solver", name).resolve().info for name in registry.names("solver")}
    assert found == sorted(name for name, info in infos.items() if not info.stochastic)
    assert {"nlopt-direct", "scipy-direct", "scipy-shgo"} <= {*found} and "de" not in found


def test_excluded_solvers_are_left_out(manifest):
    both = kinds(manifest(grouped('group = "deterministic"')))
    fewer = kinds(manifest(grouped('group = "deterministic"\nexclude = ["scipy-shgo", "nlopt-ags"]')))
    assert {*both} - {*fewer} == {"scipy-shgo", "nlopt-ags"}


def test_included_solvers_join_the_group_if_they_are_installed(manifest, plugin):
    entry = 'group = "deterministic"\n'
    entry += 'include = [{ kind = "de", population = 7 }, { kind = "rare" }, { kind = "rare" }, { kind = "nlopt-ags" }]'
    study = load_study(manifest(grouped(entry), plugins=[plugin]))
    alone = load_study(manifest(grouped('group = "deterministic"'), plugins=[plugin]))
    added = [method.solver for method in study.methods[len(alone.methods) :]]
    assert [(solver.kind, solver.options["population"]) for solver in added] == [
        ("de", 7)
    ]  # nlopt-ags is not added twice
    (warning,) = study.warnings
    assert warning.startswith("solver rare needs no_such_library") and "left out of group deterministic" in warning


def test_a_group_in_a_method_makes_one_method_for_each_solver(manifest):
    text = '[[method]]\nformulation = "once"\nsolver = { group = "gradient" }\nbudget = { evaluations = 9 }\n'
    assert kinds(manifest(text)) == kinds(manifest(grouped('group = "gradient"')))
    labelled = problems(manifest(text + 'label = "x"\n'))
    assert labelled == ["method[0].label: expected no label, as the solver is a group, got 'x'"]


def test_a_group_does_not_repeat_a_solver_that_is_named_on_its_own(manifest):
    text = (
        grouped('kind = "scipy-direct"') + '[[solver]]\ngroup = "deterministic"\n[[solver]]\ngroup = "deterministic"\n'
    )
    found = kinds(manifest(text))
    assert found[0] == "scipy-direct" and len(found) == len({*found})
    other = kinds(manifest(text.replace('"scipy-direct"', '"scipy-direct"\neps = 0.5')))
    assert other.count("scipy-direct") == 2  # with other options it counts as another solver


def test_a_group_has_the_same_runs_as_its_solvers_named_one_by_one(manifest):
    group = load_study(manifest(grouped('group = "deterministic"')))
    names = [method.solver.kind for method in group.methods]
    one_by_one = load_study(manifest(grouped("\n[[solver]]\n".join(f'kind = "{name}"' for name in names))))
    assert [spec.run_id for spec in group.specs()] == [spec.run_id for spec in one_by_one.specs()]


@pytest.mark.parametrize(
    ("entry", "expected"),
    [
        ('group = "globl"', "solver[0].group: unknown group 'globl'; did you mean \"global\"?"),
        (
            'group = "global"\nexclude = ["scipy-sgho"]',
            "solver[0].exclude[0]: unknown solver 'scipy-sgho'; did you mean \"scipy-shgo\"?",
        ),
        ('group = "global"\ninclude = ["de"]', "solver[0].include[0]: expected table, got 'de'"),
        ('group = "global"\ninclude = [{ F = 0.5 }]', "solver[0].include[0].kind: is required"),
        (
            'group = "global"\ninclude = [{ kind = "d" }]',
            "solver[0].include[0].kind: unknown solver 'd'; did you mean \"de\"?",
        ),
        (
            'group = "global"\ninclude = [{ kind = "de", populaton = 3 }]',
            'solver[0].include[0].populaton: unknown option; did you mean "population"?',
        ),
        ('group = "global"\nexlude = []', 'solver[0].exlude: unknown option; did you mean "exclude"?'),
        ('group = "global"\nkind = "de"', "solver[0]: expected a kind or a group, got both: 'de' and 'global'"),
        ("group = 3", "solver[0].group: expected string, got 3"),
    ],
)
def test_an_invalid_group_is_reported(manifest, entry, expected):
    assert expected in problems(manifest(grouped(entry)))


def test_a_solver_of_a_group_with_a_required_option_is_reported(manifest, plugin):
    plugin.write_text(PLUGIN.replace("step: float = 1.0", "step: float"))
    (problem, *_) = problems(manifest(grouped('group = "gradient"'), plugins=[plugin]))
    assert problem == "solver[0].group: slope.step: is required: expected number"


def test_every_group_contains_some_solvers_and_not_others():
    fast, slow = SolverInfo(batched=True, stochastic=False, uses_gradient=True, global_search=False), SolverInfo()
    assert {name for name, has in GROUPS.items() if has(fast)} == {
        "all",
        "local",
        "gradient",
        "batched",
        "deterministic",
    }
    assert {name for name, has in GROUPS.items() if has(slow)} == {"all", "global", "derivative-free", "stochastic"}


# --- a library that is not installed ---------------------------------------------------------------------------------


def test_a_solver_without_its_library_is_an_error_of_the_manifest(manifest, plugin):
    found = problems(manifest(grouped('kind = "rare"'), plugins=[plugin]))
    assert found == [
        "solver[0].kind: solver rare needs no_such_library, which is not installed here: pip install no_such_library"
    ]
    wrong = problems(manifest(grouped('kind = "rare"\nstep = "x"'), plugins=[plugin]))
    assert wrong == ["solver[0].step: expected number, got 'x'"]


def test_a_group_contains_only_installed_solvers(manifest, plugin):
    found = kinds(manifest(grouped('group = "gradient"'), plugins=[plugin]))
    assert {"multistart-lbfgsb", "nlopt-stogo", "slope"} <= set(found) and not {"rare", "de"} & set(found)


def test_the_list_hides_solvers_that_are_not_installed_and_names_them(tmp_path, plugin):
    shown = nfbench("list", "solvers", "--needs-gradient", "yes", "--plugin", plugin, cwd=tmp_path).stdout
    assert "│ slope" in shown and "│ rare" not in shown and "│ de " not in shown
    assert "Not installed: rare (nfbench list solvers --all)" in shown
    every = nfbench("list", "--group", "gradient", "--all", "--plugin", plugin, cwd=tmp_path).stdout
    assert "rare" in every and "(not" in every and "near-field" not in every
    page = nfbench("show", "solver", "rare", "--plugin", plugin, cwd=tmp_path).stdout
    assert "rare needs no_such_library, which is not installed here: pip install no_such_library" in page
    assert "step" in page


def test_the_options_of_a_scenario_determine_the_library_that_it_needs(tmp_path, plugin):
    message = "needs no_such_library, which is not installed here: pip install no_such_library"
    registry = Registry([plugin])
    with pytest.raises(MissingExtra, match=re.escape(f"scenario moon {message}")):
        registry.make("scenario", "moon", {})
    assert registry.make("scenario", "moon", {"backend": "numpy"}).backend == "numpy"
    shown = nfbench("list", "scenarios", "--plugin", plugin, cwd=tmp_path).stdout
    assert "│ near-field" in shown and "│ moon" not in shown
    assert re.search(r"Not installed: (bbob, )?moon \(nfbench list scenarios --all\)", shown)
    every = nfbench("list", "scenarios", "--all", "--plugin", plugin, cwd=tmp_path).stdout
    assert "Needs a library that does not exist. (not installed)" in every
    assert f"moon {message}" in nfbench("show", "scenario", "moon", "--plugin", plugin, cwd=tmp_path).stdout


def test_filters_apply_only_to_solvers(tmp_path):
    listed = nfbench("list", "--batched", "yes", "--stochastic", "no", cwd=tmp_path)
    assert listed.returncode == 0 and "scipy-direct" not in listed.stdout
    wrong = nfbench("list", "scenarios", "--batched", "yes", cwd=tmp_path)
    assert wrong.returncode == 2 and "expected solvers" in wrong.stderr
    unknown = nfbench("list", "--group", "globl", cwd=tmp_path)
    assert unknown.returncode == 2 and "unknown group 'globl'; did you mean \"global\"?" in unknown.stderr
