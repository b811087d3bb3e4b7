"""Every file, program and command shown in docs/ works as printed, page by page in the order of the page.

A block that is not run has a comment above it that says why: ``<!-- not run: needs a cluster -->``.
"""

import os
import re
import shlex
import subprocess
import sys

import pytest
from conftest import PROJECT

from nfbench.plugins.groups import GROUPS

PAGES = sorted((PROJECT / "docs").glob("*.md"))
NEEDS = {"tuning": "optuna"}  # an optional extra
DIRECTIVES = {"{figure}", "{toctree}", "{eval-rst}"}  # of Sphinx: no code
TIMEOUT_S = 300  # for one block


def blocks(page):
    """(language, text) of every block of code that is to run."""
    text = page.read_text(encoding="utf-8")
    found = re.findall(r"(<!-- not run: [^>]+ -->\n)?^```(\S*)[^\n]*\n(.*?)^```$", text, flags=re.DOTALL | re.MULTILINE)
    return [(language, block) for reason, language, block in found if not reason and language not in DIRECTIVES]


RUNNING = [page for page in PAGES if blocks(page)]


@pytest.mark.parametrize("page", RUNNING, ids=lambda page: page.stem)
def test_what_a_page_shows_works(page, tmp_path):
    if page.stem in NEEDS:
        pytest.importorskip(NEEDS[page.stem])
    environment = {**os.environ, "COLUMNS": "120"}
    for language, text in blocks(page):
        if named := re.match(r"# file: (\S+)\n", text):
            (tmp_path / named[1]).write_text(text.removeprefix(named[0]))
            continue
        commands = [["-c", text]] if language == "python" else []
        if language == "bash":
            commands = [["-m", *shlex.split(line)] for line in text.splitlines()]
        assert commands, f"a block of {language} that nothing runs:\n{text}"
        for command in commands:
            done = subprocess.run(
                [sys.executable, *command],
                cwd=tmp_path,
                capture_output=True,
                text=True,
                env=environment,
                timeout=TIMEOUT_S,
            )
            assert done.returncode == 0, (command, done.stdout, done.stderr)


def test_the_pages_that_show_code_are_found():
    expected = {"your-own-solver", "your-own-problem", "solvers-and-groups", "figures", "tuning", "export", "start"}
    assert expected <= {page.stem for page in RUNNING}


def test_every_block_of_the_reference_says_why_it_is_not_run():
    for page in (PROJECT / "docs" / "reference").glob("*.rst"):
        text = page.read_text(encoding="utf-8")
        assert len(re.findall(r"^\.\. code-block::", text, flags=re.MULTILINE)) == len(
            re.findall(r"^\.\. not run: .+\n\n\.\. code-block::", text, flags=re.MULTILINE)
        )
        assert not re.search(r"[^:.]::\n\n ", text), page


def test_the_group_shown_is_a_study(tmp_path):
    from nfbench import load_study

    page = PROJECT / "docs" / "solvers-and-groups.md"
    (text,) = [text for language, text in blocks(page) if text.startswith("# file: group.toml")]
    (tmp_path / "group.toml").write_text(text)
    kinds = [method.solver.kind for method in load_study(tmp_path / "group.toml").methods]
    assert kinds.count("multistart-lbfgsb") == 1 and "de" in kinds and "scipy-shgo" not in kinds
    assert all(f"`{name}`" in page.read_text(encoding="utf-8") for name in GROUPS)


def test_the_name_of_a_solver_is_chosen_as_the_guide_says(tmp_path):
    from nfbench.plugins import Registry

    page = PROJECT / "docs" / "your-own-solver.md"
    (text,) = [text for language, text in blocks(page) if text.startswith("# file: drift.py")]
    (tmp_path / "drift.py").write_text(text)
    assert Registry([tmp_path / "drift.py"]).names("solver").count("uniform") == 1
