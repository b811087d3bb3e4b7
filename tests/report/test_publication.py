"""Tables for papers and pages have the numbers of the study, and print every label literally."""

import io
import sys

import pandas as pd
import pytest

import nfbench
from nfbench.cli import main
from nfbench.core import NfbenchError
from nfbench.report import publication_table

LABEL = r"a|b_c & 5 % <i>\x</i>"
TOY = rf"""
[[formulation]]
kind = "once"
[[solver]]
kind = "sampler"
label = '{LABEL}'
[[solver]]
kind = "sampler"
batch = 4
[budget]
evaluations = 40
[[claim]]
text = "It fails rarely"
compare = {{ fails = "once + sampler", at_most = 0.9 }}
"""


@pytest.fixture
def results(manifest, tmp_path):
    path = manifest(TOY + "[sweep]\nnoise = [0.0, 0.5]\n[labels]\nnoise = 'Noise & more [dB]'\n", repetitions=8)
    return nfbench.run(nfbench.load_study(path), out=tmp_path / "out", jobs=0)


def test_a_markdown_table_has_the_numbers_and_intervals_of_the_summary(results):
    head, rule, *rows = publication_table(results, "summary", "markdown").splitlines()
    summary = results.summary()
    assert head.startswith("| Noise &amp; more [dB] | Method | RMSE [m] | Median [m] |") and rule.startswith(
        "|---|---|---:"
    )
    assert len(rows) == len(summary) == 4
    for row, values in zip(rows, summary.to_dict("records"), strict=True):
        cells = [cell.strip() for cell in row.replace(r"\|", "¦").strip("|").split("|")]
        assert cells[0] == f"{values['scenario.noise']:g}" and float(cells[2]) == pytest.approx(
            values["rmse_m"], rel=0.01
        )
        low, high = (values[f"median_m_{end}"] for end in ("low", "high"))
        median, _, interval = cells[3].partition(" [")
        assert float(median) == pytest.approx(values["median_m"], rel=0.01)
        assert [float(x) for x in interval.rstrip("]").split(", ")] == pytest.approx([low, high], rel=0.01)
    assert (
        "[" not in publication_table(results, "summary", "markdown", intervals=False).splitlines()[2].partition("dB")[2]
    )


def test_labels_are_printed_literally(results):
    markdown = publication_table(results, "summary", "markdown")
    assert r"a\|b\_c &amp; 5 % &lt;i&gt;\\x&lt;/i&gt;" in markdown and "<i>" not in markdown
    latex = publication_table(results, "summary", "latex")
    assert r"a\textbar{}b\_c \& 5 \% \textless{}i\textgreater{}\textbackslash{}x" in latex
    columns = latex.partition(r"\begin{tabular}{")[2].partition("}")[0]
    for row in latex.splitlines():
        if row.endswith(r"\\"):
            assert row.replace(r"\&", "").count("&") == len(columns) - 1


def test_the_best_set_is_bold_in_the_ranking(results):
    frame = results.ranking().frame
    best = frame["in_best_set"].fillna(False).astype(bool).tolist()
    rows = publication_table(results, "ranking", "markdown").splitlines()[2:]
    assert ["**" in row for row in rows] == best


def test_csv_has_all_columns_and_digits(results):
    for which, frame in (
        ("summary", results.summary()),
        ("targets", results.target_table()),
        ("claims", results.claims()),
    ):
        found = pd.read_csv(io.StringIO(publication_table(results, which, "csv")))
        assert list(found) == list(frame) and len(found) == len(frame)
    found = pd.read_csv(io.StringIO(publication_table(results, "summary", "csv", ["rmse_m"])))
    assert list(found) == ["scenario.noise", "method", "rmse_m"]
    assert found["rmse_m"].tolist() == results.summary()["rmse_m"].tolist()


def test_unknown_columns_and_missing_tables_are_errors(results, manifest, tmp_path):
    with pytest.raises(NfbenchError, match="summary has no column 'rmse_n'; did you mean 'rmse_m'"):
        publication_table(results, "summary", "latex", ["rmse_n"])
    text = '[[formulation]]\nkind = "once"\n[[solver]]\nkind = "sampler"\n[budget]\nevaluations = 8\n'
    bare = nfbench.run(nfbench.load_study(manifest(text, file="bare.toml")), out=tmp_path / "bare", jobs=0)
    with pytest.raises(NfbenchError, match="there are no claims to show"):
        publication_table(bare, "claims", "markdown")


def test_the_command_prints_or_writes_the_table(results, tmp_path, monkeypatch, capsys):
    def table(*arguments):
        monkeypatch.setattr(sys, "argv", ["nfbench", "table", str(results.folder), *arguments])
        with pytest.raises(SystemExit) as ended:
            main()
        return ended.value.code, capsys.readouterr().out

    assert table("--which", "claims") == (0, publication_table(results, "claims", "markdown"))
    code, said = table("--to", "latex", "--columns", "rmse_m,failed", "--out", str(tmp_path / "new" / "t.tex"))
    written = (tmp_path / "new" / "t.tex").read_text(encoding="utf-8")
    assert code == 0 and said.strip().endswith("t.tex") and written.startswith("% The preamble needs")
    assert written == publication_table(results, "summary", "latex", ["rmse_m", "failed"])
