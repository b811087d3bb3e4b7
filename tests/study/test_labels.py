"""Tests that every label and study name is read back from a CSV file as it was written."""

# ruff: noqa: E501  # long lists of labels

import io
import random
import string

import pandas as pd
import pytest
from conftest import BASIC, PLUGINS

from nfbench import ManifestError, load_study
from nfbench.study.labels import label_problem, safe_label

REFUSED = {
    "not empty": ["", " ", "\t", "\u00a0"],
    "without control characters": ["a\tb", "a\nb", "a\rb", "\x1b[31mred", "a\x00", "a\u202eb", "a\u200bb", "\ufeffa", "a\u2028b", "\ta", "a\n"],
    "without blanks around it": [" a", "a ", "\u00a0a"],
    "at most 200 characters": ["a" * 201],
    "does not start with =": ["=1+1", "+a", "-a", "@a", "=cmd|' /C calc'!A0", "＝a", "－a", "-nan", "+inf", "-1", "@SUM(A1)"],
    "missing value": ["NA", "N/A", "n/a", "na", "null", "NULL", "nan", "NaN", "None", "none", "<NA>", "#N/A", "#NA", "#N/A N/A", "nil"],
    "truth value": ["true", "True", "TRUE", "false", "False"],
    "number or date": ["1", "007", "3.14", "1e5", "1E-3", "1,000", "1 000", "50%", "$5", "5 €", "1/2", "2024-01-01", "10:30", "inf", "Infinity", "0x1F", "1_000", "(5)", "٣", "1.#IND", "1.#QNAN"],
    "date or time": ["mar 1", "MARCH1", "1-Mar", "SEPT2", "may 2026", "1 jan 2024", "Dec-5", "10 AM", "3 p", "5pm"],
}  # fmt: skip
ACCEPTED = [
    *("de", "NEMO-DE", "3D MUSIC 200×200×400", "λ/4", "de(population=120)", "neef + de @60000", "2 × nemo", "K=3", "a=b", "a-b"),
    *("NEMO + DE, F = 0.5", "market 5", "decay 2", "may be", "mars", "nano", "nullspace", "true positive", "nan-safe", "1st", "4x4"),
    *("e5", "x1e5", '"quoted"', "it's", "a;b", "ДЭ", "差分進化", "DE ✓", "(nemo)", "[x]", "5 kg", "None of them", "no", "yes"),
]  # fmt: skip


@pytest.mark.parametrize(("rule", "label"), [(rule, label) for rule, labels in REFUSED.items() for label in labels])
def test_a_label_is_refused_by_its_rule(rule, label):
    problem = label_problem(label)
    assert problem is not None and rule in problem
    assert problem.isprintable() and repr(label)[1:-1][:150] in problem


@pytest.mark.parametrize("label", ACCEPTED)
def test_an_ordinary_label_is_accepted(label):
    assert label_problem(label) is None


def read_back(label):
    """The label after a round trip through a CSV file, alone in its column, where pandas converts most."""
    text = io.StringIO()
    pd.DataFrame({"label": [label]}).to_csv(text, index=False)
    return pd.read_csv(io.StringIO(text.getvalue()))["label"][0]


@pytest.mark.parametrize("label", ACCEPTED)
def test_an_accepted_label_is_read_back_by_pandas(label):
    assert read_back(label) == label


def test_any_label_that_pandas_changes_is_refused():
    from pandas._libs.parsers import STR_NA_VALUES

    rng = random.Random(1)
    pieces = [*STR_NA_VALUES, *string.digits, *".,+-eE_xX#%/: ", "inf", "nan", "True", "false", "a", "1e", "NA"]
    for label in [*STR_NA_VALUES, *("".join(rng.choices(pieces, k=rng.randint(1, 4))) for _ in range(1500))]:
        if label_problem(label) is None:
            assert read_back(label) == label, label


@pytest.mark.parametrize("label", [label for labels in REFUSED.values() for label in labels])
def test_a_default_label_is_always_made_safe(label):
    assert label_problem(safe_label(label, "solver")) is None


@pytest.mark.parametrize("label", ["NA", "=1", "7", "true", " x", "a\\tb", "a\\u001bb", ""])
def test_labels_are_refused_wherever_they_stand(manifest, label):
    method = f'[[method]]\nformulation = "oracle"\nlabel = "{label}"\n'
    for text, path in (
        (BASIC.replace('"sampler"', f'"sampler"\nlabel = "{label}"'), "solver[0].label: "),
        (BASIC.replace('"once"', f'"once"\nlabel = "{label}"'), "formulation[0].label: "),
        (BASIC + method, "method[0].label: "),
    ):
        with pytest.raises(ManifestError) as caught:
            load_study(manifest(text))
        assert path in str(caught.value) or "control" in str(caught.value)
    with pytest.raises(ManifestError, match=r"scenario\.label: |control"):
        load_study(manifest(BASIC, scenario=f'label = "{label}"'))


@pytest.mark.parametrize("name", ["NA", "nan", "null", "None", "true", "2026", "1e5", "0x10", "may1", "007"])
def test_names_of_studies_are_refused(manifest, name):
    with pytest.raises(ManifestError, match=rf"name: expected a label .*got '{name}'"):
        load_study(manifest(BASIC, name=name))


ODD_NAMES = """
from dataclasses import dataclass
from nfbench import Solver, SolverInfo


@dataclass(frozen=True)
class Null(Solver):
    info = SolverInfo()
    text: str = "a"
    def minimize(self, problem, rng):
        problem(problem.lower)

@dataclass(frozen=True)
class Seven(Null):
    name = "7"
"""


def test_default_labels_of_oddly_named_plugins_are_safe(manifest, tmp_path):
    plugin = tmp_path / "odd.py"
    plugin.write_text(ODD_NAMES)
    solvers = '[[solver]]\nkind = "null"\n[[solver]]\nkind = "7"\n[[solver]]\nkind = "7"\ntext = "b\\nc"\n'
    study = load_study(manifest(BASIC + solvers, plugins=[plugin]))
    labels = [method.solver.label for method in study.methods]
    assert labels == ["sampler", "solver null", "7(text=a)", "solver 7(text=b c)"]
    for method in study.methods:
        assert label_problem(method.label) is None and label_problem(method.formulation.label) is None


def test_default_labels_of_all_plugins_are_accepted():
    from nfbench.plugins import Registry

    assert PLUGINS.exists()
    for kind in ("scenario", "formulation", "solver"):
        for name in Registry().names(kind):
            assert safe_label(name, kind) == name
