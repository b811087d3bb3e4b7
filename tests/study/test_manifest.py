"""Tests that a manifest becomes a study or a list of all its errors."""

import pytest
from conftest import BASIC

from nfbench import ManifestError, load_study


def problems(path):
    with pytest.raises(ManifestError) as caught:
        load_study(path)
    return caught.value.problems


def test_a_study_is_the_product_of_points_formulations_and_solvers(manifest):
    study = load_study(
        manifest(
            """
            [sweep]
            dimension = [2, 3]
            noise = [0, 0.5, 1]
            [[formulation]]
            kind = "once"
            [[formulation]]
            kind = "oracle"
            [[solver]]
            kind = "sampler"
            [[solver]]
            kind = "lazy"
            [budget]
            evaluations = 40
            run_timeout_s = 2.5
            """
        )
    )
    assert [point.swept for point in study.points] == [
        {"dimension": d, "noise": n} for d in (2, 3) for n in (0.0, 0.5, 1.0)
    ]
    assert [method.label for method in study.methods] == ["once + sampler", "once + lazy", "oracle"]
    assert study.methods[0].budget == {"evaluations": 40, "seconds": None, "target": None}
    assert study.methods[0].run_timeout_s == 2.5
    assert study.methods[2].solver is study.methods[2].budget is None
    assert len(study) == len(list(study.specs())) == 3 * 6 * 3


def test_differing_options_make_the_labels_unique(manifest):
    study = load_study(
        manifest(
            """
            [[formulation]]
            kind = "once"
            [[formulation]]
            kind = "once"
            shift = 0.5
            [[solver]]
            kind = "sampler"
            [[solver]]
            kind = "sampler"
            batch = 3
            [[solver]]
            kind = "sampler"
            batch = 4
            label = "four"
            [budget]
            evaluations = 40
            """
        )
    )
    assert [m.solver.label for m in study.methods[:3]] == ["sampler(batch=8)", "sampler(batch=3)", "four"]
    assert study.methods[-1].label == "once(shift=0.5) + four"


def test_a_method_may_have_its_own_budget_and_label(manifest):
    study = load_study(
        manifest(
            """
            [[method]]
            formulation = "once"
            solver = { kind = "sampler", batch = 3 }
            label = "short"
            [[method]]
            formulation = { kind = "once" }
            solver = { kind = "sampler", batch = 3 }
            budget = { evaluations = 400, run_timeout_s = 9 }
            [[method]]
            formulation = "oracle"
            [budget]
            evaluations = 40
            """
        )
    )
    assert [(m.label, m.budget and m.budget["evaluations"], m.run_timeout_s) for m in study.methods] == [
        ("short", 40, None),
        ("once + sampler", 400, 9.0),
        ("oracle", None, None),
    ]


def test_a_swept_value_may_be_a_list(manifest):
    study = load_study(manifest('[sweep]\nnames = [[], ["a", "b"]]\n' + BASIC))
    assert [point.swept["names"] for point in study.points] == [[], ["a", "b"]]


WRONG = {
    "every error at once": (
        """
        repetitions = 0
        sed = 3
        [scenario]
        kind = "toy"
        noise = 2.0
        [sweep]
        dimension = [1, "x", 0]
        [[formulation]]
        kind = "onec"
        [[formulation]]
        kind = "once"
        shift = "a"
        [[solver]]
        kind = "sampler"
        batch = 3.5
        bacth = 1
        [budget]
        evaluations = 0
        """,
        [
            'sed: unknown option; did you mean "seed"?',
            "name: is required: expected string",
            "seed: is required: expected integer",
            "repetitions: expected greater than or equal to 1, got 0",
            "scenario.noise: expected less than or equal to 1, got 2.0",
            "sweep.dimension[1]: expected integer, got 'x'",
            "sweep.dimension[2]: expected greater than or equal to 1, got 0",
            "budget.evaluations: expected greater than or equal to 1, got 0",
            "formulation[0].kind: unknown formulation 'onec'; did you mean \"once\"?",
            "formulation[1].shift: expected number, got 'a'",
            'solver[0].bacth: unknown option; did you mean "batch"?',
            "solver[0].batch: expected integer, got 3.5",
        ],
    ),
    "no kinds": (
        'name = "a"\nrepetitions = 1\nseed = 1\n[scenario]\nnoise = 1\n[[formulation]]\n[[solver]]\nkind = 3',
        [
            "scenario.kind: is required; known: bbob, functions, measured-responses, near-field, recorded, toy",
            "formulation[0].kind: is required;",
        ],
    ),
    "an impossible name": (
        'name = "../../etc"\nrepetitions = 1\nseed = 1\n[scenario]\nkind = "toy"\n[[formulation]]\nkind = "oracle"',
        ["name: expected a string that matches", "got '../../etc'"],
    ),
    "a table for a list": (
        'name = "a"\nrepetitions = 1\nseed = 1\n[scenario]\nkind = "toy"\n[formulation]\nkind = "oracle"',
        ["formulation: expected a list of tables, got one table; write [[formulation]] instead of [formulation]"],
    ),
    "a formulation without solver or budget": (
        'name = "a"\nrepetitions = 1\nseed = 1\n[scenario]\nkind = "toy"\n[[formulation]]\nkind = "once"',
        ["formulation[0]: once needs a solver; add a [[solver]]"],
    ),
    "no budget": (
        'name="a"\nrepetitions=1\nseed=1\n[scenario]\nkind="toy"\n[[formulation]]\nkind="once"\n'
        '[[solver]]\nkind="sampler"',
        ["budget: is required: give evaluations or seconds"],
    ),
    "nothing to run": (
        'name = "a"\nrepetitions = 1\nseed = 1\n[scenario]\nkind = "toy"',
        ["formulation: expected at least one [[formulation]] or [[method]], got none"],
    ),
    "a formulation of another scenario": (
        'name="a"\nrepetitions=1\nseed=1\n[scenario]\nkind="toy"\n[[formulation]]\nkind="direct"\n'
        '[[solver]]\nkind="sampler"\n[budget]\nevaluations=9',
        ["formulation[0].kind: direct solves", "but the scenario draws ToyInstance"],
    ),
    "the same twice": (
        'name="a"\nrepetitions=1\nseed=1\n[scenario]\nkind="toy"\n[[formulation]]\nkind="once"\n'
        '[[solver]]\nkind="sampler"\n[[solver]]\nkind="sampler"\nbatch=8\n[sweep]\nnoise=[0, 0.0]\n'
        "[budget]\nevaluations=9",
        ["solver[1]: is the same as solver[0]", "sweep.noise[1]: gives the same scenario as sweep.noise[0]"],
    ),
    "an empty sweep and a wrong one": (
        'name="a"\nrepetitions=1\nseed=1\n[scenario]\nkind="toy"\n[[formulation]]\nkind="oracle"\n'
        "[sweep]\nnoise=[]\ndimension=3\nnose=[1]",
        [
            "sweep.noise: expected a list of one or more values, got []",
            "sweep.dimension: expected a list of one or more values, got 3",
            'sweep.nose[0]: unknown option; did you mean "noise"?',
        ],
    ),
    "a method with the wrong solver": (
        'name="a"\nrepetitions=1\nseed=1\n[scenario]\nkind="toy"\n[[method]]\nformulation="oracle"\nsolver="sampler"\n'
        '[[method]]\nformulation="once"\nbudget={evaluations=3}\n[[method]]\nsolver="sampler"',
        [
            "method[0].solver: oracle needs no solver, but got one",
            "method[1].solver: once needs a solver, but got none",
            "method[2].formulation: is required",
        ],
    ),
    "one label twice": (
        'name="a"\nrepetitions=1\nseed=1\n[scenario]\nkind="toy"\n[[formulation]]\nkind="once"\n'
        '[[solver]]\nkind="sampler"\nlabel="x"\n[[solver]]\nkind="lazy"\nlabel="x"\n[budget]\nevaluations=9',
        ["solver: two solvers are labelled 'x'"],
    ),
    "not TOML": ("name = ", ["is not valid TOML: Invalid value (at end of document)"]),
    "numbers out of range": (
        'name="a"\nrepetitions=1\nseed=-1\n[scenario]\nkind="toy"\nnoise=nan\n[[formulation]]\nkind="oracle"\n'
        "[summary]\noutlier_m=0\n[budget]\nrun_timeout_s=-1",
        [
            "seed: expected greater than or equal to 0, got -1",
            "scenario.noise: expected a number, got nan",
            "summary.outlier_m: expected greater than 0, got 0",
            "budget.run_timeout_s: expected greater than 0, got -1",
        ],
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_every_error_is_reported_with_its_path(case, tmp_path, toy_plugin):
    text, expected = WRONG[case]
    path = tmp_path / "study.toml"
    lines = text.strip("\n").splitlines()
    path.write_text(f"plugins = ['{toy_plugin}']\n" + "\n".join(line.strip() for line in lines))
    found = problems(path)
    for part in expected:
        assert any(part in line for line in found), (part, found)


def test_a_manifest_with_many_errors_is_reported_without_spurious_ones(tmp_path, toy_plugin):
    text, expected = WRONG["every error at once"]
    path = tmp_path / "study.toml"
    path.write_text(f"plugins = ['{toy_plugin}']\n" + "\n".join(line.strip() for line in text.splitlines()))
    assert sorted(problems(path)) == sorted(expected)


def test_a_missing_manifest_or_plugin_file_is_reported(tmp_path, manifest):
    assert problems(tmp_path / "no.toml") == ["cannot be read: No such file or directory"]
    assert any("no.py: No such file" in text for text in problems(manifest(BASIC, plugins=["no.py"])))


def test_a_plugin_that_fails_to_import_causes_a_warning_and_its_solver_is_planned_as_broken(tmp_path, manifest):
    (tmp_path / "bad.py").write_text("def broken(:")
    study = load_study(manifest(BASIC + '[[solver]]\nkind = "mine"\n', plugins=["bad.py"]))
    assert "bad.py is left out: SyntaxError" in study.warnings[0]
    assert [m.solver.broken is None for m in study.methods] == [True, False]
    assert "SyntaxError" in study.methods[1].solver.broken


def test_a_formulation_may_have_its_own_budget(manifest):
    text = BASIC + '[[formulation]]\nkind = "twice"\nbudget = { evaluations = 7, seconds = 2.0 }\n'
    study = load_study(manifest(text))
    assert [method.budget["evaluations"] for method in study.methods] == [40, 7]
    assert study.methods[1].budget["seconds"] == 2.0
    assert problems(manifest(text.replace("= 7,", "= 0,"))) == [
        "formulation[1].budget.evaluations: expected greater than or equal to 1, got 0"
    ]
    assert problems(manifest(text.replace("{ evaluations = 7, seconds = 2.0 }", "7"))) == [
        "formulation[1].budget: expected a table, got 7"
    ]


def test_a_swept_path_through_a_number_is_an_unknown_option(manifest):
    path = manifest(BASIC + "[sweep]\n'noise.floor' = [1]\n", scenario="noise = 0.5")
    (problem,) = problems(path)
    assert problem.startswith("sweep.noise.floor[0]: unknown option")


def test_points_that_are_ranked_by_different_scores_are_refused(manifest, tmp_path):
    plugin = tmp_path / "blind.py"
    plugin.write_text(
        "from dataclasses import dataclass\nfrom typing import ClassVar\nfrom nfbench import Instance, Scenario\n"
        "from nfbench.problems.functions import FunctionInstance\n"
        "@dataclass(frozen=True)\nclass Blind(Scenario):\n"
        '    """Ranked by another score.\n\n    seeing: whether.\n    """\n'
        '    name: ClassVar[str] = "blind"\n    instance: ClassVar[type[Instance]] = FunctionInstance\n'
        "    seeing: bool = True\n"
        '    def ranked_by(self):\n        return "rmse_m" if self.seeing else "misfit"\n'
        "    def draw(self, rng):\n        raise NotImplementedError\n"
    )
    text = (
        '[sweep]\nseeing = {}\n[[formulation]]\nkind = "direct"\n[[solver]]\nkind = "de"\n[budget]\nevaluations = 100\n'
    )
    path = manifest(text.format("[true, false]"), plugins=[plugin])
    path.write_text(path.read_text().replace('kind = "toy"', 'kind = "blind"'))
    assert "sweep: expected points with one measure of the error, got rmse_m, misfit" in problems(path)
    path.write_text(path.read_text().replace("[true, false]", "[false]"))
    assert load_study(path).error == "misfit"
