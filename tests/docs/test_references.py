"""The generated references are complete: options, columns and public names."""

import importlib
import inspect
import json
import pkgutil
import re
import sys

import numpy as np
import pandas as pd
import pytest
from conftest import PLUGINS, PROJECT

import nfbench
import nfbench.analysis
import nfbench.figures
import nfbench.testing
from nfbench.results import export_csv

DOCS = PROJECT / "docs"
PROVING = PLUGINS / "proving.py"
sys.path[:0] = [str(DOCS / "_extensions"), str(DOCS)]

pytest.importorskip("sphinx", reason="the extra docs")

import build  # noqa: E402
import column_tables  # noqa: E402
import docstrings  # noqa: E402
import option_tables  # noqa: E402

CLASSES = dict(option_tables.option_classes())


# options


@pytest.mark.parametrize("title", CLASSES)
def test_every_option_has_a_description_and_a_default(title):
    for key in option_tables.keys(CLASSES[title]):
        assert key.text, (
            f"{CLASSES[title].__name__}.{key.name}: describe it in the class's docstring as '{key.name}: …'"
        )
        assert key.type and key.default, key


@pytest.mark.parametrize(
    ("text", "names", "expected"),
    [
        ("Prose. alpha, delta_min: how far.", ["alpha", "delta_min"], {"alpha": "How far.", "delta_min": "How far."}),
        ("a: one [m]. b: two\nlines; c: three", ["a", "b", "c"], {"a": "One [m].", "b": "two lines.", "c": "Three."}),
        ("mode: either\n    x: none; y.\nsize: s", ["mode", "size"], {"mode": "Either x: none; y.", "size": "s."}),
        ("first: (M, 3) [m], or file: a path.", ["first", "file"], {"first": "(M, 3) [m].", "file": "A path."}),
        ("n: n, 2 to 40.", ["n"], {"n": "n, 2 to 40."}),
    ],
)  # fmt: skip
def test_descriptions_are_read_from_docstrings(text, names, expected):
    found = docstrings.described(text, names).texts
    assert {name: value.lower() for name, value in found.items()} == {k: v.lower() for k, v in expected.items()}
    assert all(value[0] == expected[name][0] for name, value in found.items() if name != "b")


def test_a_list_in_a_docstring_stays_a_list():
    found = docstrings.described("Prose.\n\na: one.\n\n* ``a``: first\n  item\n* second item", ["a"])
    assert found.prose == ("Prose.", "* ``a``: first\n  item\n* second item") and found.texts == {"a": "One."}


def test_units_come_from_names_and_brackets():
    keys = {key.name: key.unit for key in option_tables.keys(CLASSES["scenario near-field"])}
    assert keys["wavelength_m"] == "m" and keys["snr_db"] == "dB" and keys["azimuth_deg"] == "°" and not keys["sources"]
    limits = {key.name: key.unit for key in option_tables.keys(CLASSES["Limits"])}
    assert limits.pop("start") == ""
    assert limits == {"evaluations": "", "seconds": "s", "target": "", "run_timeout_s": "s", "run_memory_mb": "MiB"}


def test_types_and_defaults_are_in_the_words_of_a_manifest():
    limits = {key.name: key for key in option_tables.keys(CLASSES["Limits"])}
    assert limits["target"].type == "number or table" and limits["evaluations"].text.endswith("default: no limit.")
    assert limits["run_timeout_s"].text.endswith("leave it out, or give more than 10^9, for no limit.")
    claims = {key.name: key.type for key in option_tables.keys(CLASSES["Compare"])}
    assert claims["better"] == "text or list of text"
    assert claims["start"] == "boolean or integer or number or text or list"
    for title, cls in CLASSES.items():
        assert not [key for key in option_tables.keys(cls) if "typing" in key.type or "None" in key.text], title


# columns

STUDY = """
name = "columns"
scenes = 1
seed = 1
[scenario]
kind = "near-field"
array = { kind = "ula", elements = 8, spacing_wavelengths = 0.25, origin = "center" }
wavelength_m = 0.02
sources = 2
snapshots = 10
snr_db = 20.0
fading = "block"
azimuth_deg = [-60, 60]
range_m = [0.1, 0.5]
[sweep]
rician_k = [inf, 10.0]
[[formulation]]
kind = "neef"
[[formulation]]
kind = "grid-refine"
[[solver]]
kind = "random-search"
[budget]
evaluations = 50
[[claim]]
text = "The error falls as the line of sight fades"
compare = { falls = "neef + random-search", key = "scenario.rician_k" }
"""
FUNCTIONS = """
name = "columns"
scenes = 1
runs_per_scene = 2
seed = 1
[scenario]
kind = "functions"
[sweep]
"budget.evaluations" = [40, 50]
[[formulation]]
kind = "direct"
[[solver]]
kind = "multistart-lbfgsb"
[budget]
target = { gap = 1e-3 }
[[claim]]
text = "The solver fails rarely"
compare = { fails = "direct + multistart-lbfgsb", at_most = 0.1 }
"""
RECORDED = """
name = "columns"
scenes = 1
seed = 1
[scenario]
kind = "recorded"
data = "data.npy"
array = { kind = "ula", elements = 8, spacing_wavelengths = 0.25, origin = "center" }
wavelength_m = 0.2
sources = 1
azimuth_deg = [-60, 60]
range_m = [0.1, 1.0]
TRUTH
[[formulation]]
kind = "grid-refine"
[[formulation]]
kind = "neef"
[[solver]]
kind = "random-search"
[budget]
evaluations = 50
[[claim]]
text = "Random search is worse"
compare = { better = "grid-refine", worse = "neef + random-search" }
"""


@pytest.mark.parametrize(
    "text",
    [STUDY, FUNCTIONS, RECORDED.replace("TRUTH", ""), RECORDED.replace("TRUTH", "truth_m = [[0.5, 0.1, 0.0]]")],
    ids=["near-field", "functions", "recorded", "recorded with truth"],
)
def test_every_column_that_a_study_writes_is_described(text, tmp_path):
    rng = np.random.default_rng(0)
    np.save(tmp_path / "data.npy", rng.standard_normal((8, 20)) + 1j * rng.standard_normal((8, 20)))
    (tmp_path / "study.toml").write_text(text)
    results = nfbench.run(nfbench.load_study(tmp_path / "study.toml"), out=tmp_path / "out", jobs=0)
    assert set(results.counts) == {"ok"}
    export_csv(results)
    tables = ("runs", "summary", "targets", "ranking", "claims", "traces")
    produced = {name: list(pd.read_csv(tmp_path / "out" / f"{name}.csv")) for name in tables}
    produced["environment"] = list(json.loads((tmp_path / "out" / "environment.json").read_text(encoding="utf-8")))
    missing = [
        f"{file}: {column}"
        for file, names in produced.items()
        for column in names
        if not column_tables.is_described(file, column)
    ]
    assert not missing, f"describe them in docs/reference/columns.toml: {missing}"


def test_every_column_of_proofs_is_described(tmp_path):
    tables = '[scenario]\nkind = "bowls"\n[sweep]\nlift = [0.0]\n[[formulation]]\nkind = "proving"\n'
    tables += '[[solver]]\nkind = "random-search"\n[budget]\nevaluations = 40\n[reference]\ncertificate = true\n'
    (tmp_path / "study.toml").write_text(f'name = "p"\nscenes = 1\nseed = 1\nplugins = ["{PROVING}"]\n{tables}')
    nfbench.run(nfbench.load_study(tmp_path / "study.toml"), out=tmp_path / "out", jobs=0)
    names = list(pd.read_csv(tmp_path / "out" / "references.csv"))
    assert [name for name in names if not column_tables.is_described("references", name)] == ["cuts"]  # of the plugin
    assert {entry["name"] for entry in column_tables.columns("references")} <= {
        *names,
        *("regions", "certificate_evaluations"),  # of the near-field proofs
        "scenario.KEY",
        "x_N",
    }


def test_patterns_of_columns_take_numbers_and_keys_only():
    assert column_tables.is_described("runs", "error_12_m") and column_tables.is_described("traces", "x_0")
    assert column_tables.is_described("runs", "scenario.array.elements")
    assert not column_tables.is_described("runs", "error_x_m") and not column_tables.is_described("runs", "unheard_of")


def test_the_trials_of_a_tuning_are_described():
    from nfbench.tuning import trials

    header = re.search(r'self\._header = \[("[^*]*)\*names\]', inspect.getsource(trials))[1]
    names = re.findall(r'"(\w+)"', header)
    assert names == [entry["name"] for entry in column_tables.columns("trials")][: len(names)] and len(names) >= 4


# public names


@pytest.mark.parametrize(
    ("module", "page"),
    [(nfbench, "api"), (nfbench.testing, "api"), (nfbench.figures, "api"), (nfbench.analysis, "api-analysis")],
    ids=lambda part: getattr(part, "__name__", ""),
)
def test_every_public_name_has_an_entry(module, page):
    page = (DOCS / "reference" / f"{page}.rst").read_text(encoding="utf-8")
    entries = set(re.findall(r"^\.\. (?:auto\w+|py:\w+):: (\w+)", page, flags=re.MULTILINE))
    assert set(module.__all__) <= entries


@pytest.mark.parametrize(
    ("package", "page"), [("nfbench.problems", "api-problems"), ("nfbench.solvers", "api-solvers")]
)
def test_every_module_of_plugins_has_an_entry(package, page):
    text = (DOCS / "reference" / f"{page}.rst").read_text(encoding="utf-8")
    entries = set(re.findall(r"^\.\. automodule:: (\S+)", text, flags=re.MULTILINE))
    found = pkgutil.walk_packages(importlib.import_module(package).__path__, f"{package}.")
    public = {
        module.name for module in found if not module.ispkg and not module.name.rpartition(".")[2].startswith("_")
    }
    public -= {name for name in public if ".kernels" in name}  # compiled helpers of the objectives
    assert public <= entries
    for name in entries:
        module = importlib.import_module(name)
        undocumented = [
            each
            for each in module.__all__
            if inspect.isclass(vars(module).get(each)) and not vars(module)[each].__doc__
        ]
        assert not undocumented, (name, undocumented)


# the checker of links


def test_the_checker_finds_what_is_broken(tmp_path):
    (tmp_path / "a.html").write_text(
        '<a href="b.html#here">x</a><a href="b.html#nowhere">x</a><a href="c.html">x</a><a href="https://x">x</a>'
        '<script src="https://cdn.example.org/x.js"></script><h1 id="top">t</h1><a href="#top">x</a>'
    )
    (tmp_path / "b.html").write_text('<p id="here"></p><img src="data:image/png;base64,AA==">')
    (tmp_path / "s.css").write_text("@font-face { src: url(https://fonts.example.org/f.woff2) }")
    faults = sorted(build.site_faults(tmp_path))
    assert len(faults) == 5
    for part in ("b.html#nowhere", "c.html does not exist", "https://x is not", "cdn.example.org", "fonts.example.org"):
        assert sum(part in fault for fault in faults) == 1


def test_links_of_the_repository_lead_somewhere():
    assert not [*build.markdown_faults(PROJECT)]


# the README


def test_the_readme_is_short():
    assert len((PROJECT / "README.md").read_text(encoding="utf-8").splitlines()) < 150
