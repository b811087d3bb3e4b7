"""A localization as a table, JSON and CSV: digits, units, and numbers that are not known."""

import csv
import io
import json
import math

import pytest
from rich.console import Console

from nfbench.core import Localization
from nfbench.report import localization_csv, localization_json, print_localization

FOUND = Localization(
    ({"x_m": 0.123456, "range_m": 2.0, "std_x_m": 0.00123, "std_range_m": math.nan, "snr_db": 20.06},),
    {"misfit": 0.25, "p_value": math.nan, "elements": 64.0, "noise_power": math.inf},
    ("something [bold]odd[/bold]; fix it", "is it metres?"),
)


def printed(found):
    console = Console(file=io.StringIO(), width=100)
    print_localization(found, console)
    return console.file.getvalue()


def test_the_table_has_units_and_the_digits_of_the_standard_error():
    text = printed(FOUND)
    assert "x [m]" in text and "range [m]" in text and "SNR [dB]" in text
    assert "0.1235" in text and "± 0.0012" in text and "0.12346" not in text
    assert "± –" in text and "20.1" in text
    assert "misfit 0.25, elements 64" in text and "p value" not in text
    assert "Warning: something [bold]odd[/bold]; fix it." in text and "Warning: is it metres?\n" in text


def test_json_has_null_for_what_is_not_known():
    table = json.loads(localization_json(FOUND))
    assert list(table) == ["sources", "fit", "method", "warnings"]
    assert table["sources"][0]["std_range_m"] is None and table["sources"][0]["x_m"] == 0.123456
    assert table["fit"] == {"misfit": 0.25, "p_value": None, "elements": 64, "noise_power": None}


def test_csv_has_one_row_per_source_with_all_digits():
    (row,) = csv.DictReader(io.StringIO(localization_csv(FOUND)))
    assert float(row["x_m"]) == 0.123456 and row["std_range_m"] == "" and row["source"] == "1"


@pytest.mark.parametrize("write", [localization_json, localization_csv, printed])
def test_no_source_is_a_result(write):
    assert "No source was found." in write(Localization(())) or write is not printed


def test_the_fit_breaks_between_its_facts_only_and_a_probability_is_never_0():
    fit = {"misfit": 0.25, "p_value": 0.0, "significant_eigenvalues": 3.0, "sources": 2.0}
    console = Console(file=io.StringIO(), width=60)
    print_localization(Localization((), fit), console)
    lines = [line.rstrip() for line in console.file.getvalue().splitlines()]
    assert lines[1:] == ["Fit: misfit 0.25, p value < 1e-300,", "significant eigenvalues 3, sources 2"]


def test_the_method_is_one_line():
    method = {"formulation": "neef", "options": {"objective": "dml"}, "solver": "de", "solver_options": {}, "seed": 3}
    study = {"study": "results/a", "label": "neef + de", "swept": {"scenario.snr_db": "all"}}
    found = Localization((), method={**method, "budget": {"evaluations": 8000}, **study})
    text = "Method: neef (objective = dml) + de, 8,000 evaluations, seed 3, recommended by results/a at snr_db = all"
    assert text in " ".join(printed(found).split())
    assert json.loads(localization_json(found))["method"] == found.method
