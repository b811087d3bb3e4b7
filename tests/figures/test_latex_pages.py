"""Figures and tables in LaTeX compile in a two-column paper and fit its columns, whatever the labels contain."""

import shutil
import subprocess
from dataclasses import replace

import pytest

import nfbench
from nfbench.core import latex_text
from nfbench.figures import Drawing, write_figures
from nfbench.report import publication_table

LATEX = shutil.which("pdflatex")
NEEDED = ("IEEEtran.cls", "pgf.sty", "booktabs.sty")
HOSTILE = r"""50 % & <b>$x_1^2$</b> #1 ~ "{\typeout{EXECUTED}} 数 Größe Łódź ąđ β→∞ ‖ \end{document}"""
AXIS = r"""50 % & $x_1^2$ #1 ~ "{\typeout{EXECUTED}} 数 ß β"""
LONG = "A label of a method that is as long as a sentence and has 70 characters"
STUDY = f"""
name = "paper"
title = '{HOSTILE}'
scenes = 2
seed = 2
[scenario]
kind = "near-field"
array = {{ kind = "ula", elements = 8, spacing_wavelengths = 0.5, origin = "first" }}
wavelength_m = 0.02
sources = 2
snapshots = 20
snr_db = 20.0
azimuth_deg = [-60, 60]
range_m = [0.1, 0.5]
[sweep]
snr_db = [0, 20]
[labels]
snr_db = '{AXIS} [dB]'
rmse = '{AXIS} [m]'
[[method]]
formulation = "neef"
solver = "random-search"
label = '{HOSTILE}'
[[method]]
formulation = "neef"
solver = {{ kind = "random-search", batch = 7 }}
label = '{LONG}'
[[method]]
formulation = "grid-refine"
[budget]
evaluations = 50
"""


def installed():
    find = shutil.which("kpsewhich")
    if LATEX is None or find is None:
        return False
    return all(subprocess.run([find, name], capture_output=True, check=False).stdout for name in NEEDED)


needs_latex = pytest.mark.skipif(not installed(), reason="pdfLaTeX with IEEEtran, PGF and booktabs is not installed")


def compiled(folder, body):
    """Compile a paper with this body, and return what LaTeX printed."""
    head = "\\documentclass[journal]{IEEEtran}\n\\usepackage{pgf}\n\\usepackage{booktabs}\n\\begin{document}\n"
    (folder / "paper.tex").write_text(f"{head}{body}\n\\typeout{{REACHED THE END}}\n\\end{{document}}\n", "utf-8")
    command = [LATEX, "-interaction=nonstopmode", "-no-shell-escape", "paper.tex"]
    subprocess.run(command, cwd=folder, capture_output=True, check=False, timeout=300)
    return (folder / "paper.log").read_text("utf-8", errors="replace")


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    folder = tmp_path_factory.mktemp("paper")
    (folder / "paper.toml").write_text(STUDY, "utf-8")
    return nfbench.run(nfbench.load_study(folder / "paper.toml"), out=folder / "out", jobs=0)


def check(log):
    assert [line for line in log.splitlines() if line.startswith("!")] == []
    assert "\nREACHED THE END\n" in log and "\nEXECUTED\n" not in log
    assert "Overfull" not in log and "Missing character" not in log


@needs_latex
def test_figures_compile_and_fit_a_column(results, tmp_path):
    how = Drawing(only=("error", "ert", "ranks", "landscape"))
    written = write_figures(results, tmp_path, ["tex"], how)
    assert len(written) > 3
    floats = [f"\\begin{{figure}}\\input{{{path.name}}}\\caption{{A}}\\end{{figure}}\\clearpage" for path in written]
    check(compiled(tmp_path, "\n".join(floats)))


@needs_latex
def test_figures_compile_and_fit_a_page(results, tmp_path):
    written = write_figures(results, tmp_path, ["tex"], replace(Drawing(only=("error", "runtime")), width="double"))
    floats = [f"\\begin{{figure*}}\\input{{{path.name}}}\\caption{{A}}\\end{{figure*}}\\clearpage" for path in written]
    check(compiled(tmp_path, "\n".join(floats)))


@needs_latex
def test_tables_compile_and_fit_a_page(results, tmp_path):
    for which in ("summary", "ranking", "targets"):
        (tmp_path / f"{which}.tex").write_text(publication_table(results, which, "latex"), "utf-8")
    check(compiled(tmp_path, "\\input{summary.tex}\\clearpage\\input{ranking.tex}\\clearpage\\input{targets.tex}"))


@needs_latex
def test_no_character_stops_a_document(tmp_path):
    some = [*range(1, 0x530), *range(0x1E00, 0x2000, 7), *range(0x2010, 0x2300, 3), 0x301, 0x6570, 0x1F600]
    check(compiled(tmp_path, "\n\n".join(f"a{latex_text(chr(code))}b" for code in some)))


def test_letters_that_pdflatex_lacks_have_a_substitute():
    assert latex_text("数") == r"{\ifdefined\Umathchar 数\else ?\fi}"
    assert latex_text("ą") == r"{\ifdefined\Umathchar ą\else a\fi}"
    assert latex_text("Größe, Łódź") == latex_text("Gro\u0308ße, Łódz\u0301") == "Größe, Łódź"
    assert latex_text('"β"') == r"\textquotedblright{}\ensuremath{\beta}\textquotedblright{}"
