"""Every file, program and command shown in docs/ works as printed, page by page in the order of the page."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import PROJECT

from nfbench.plugins.groups import GROUPS

PAGES = sorted((PROJECT / "docs").glob("*.md"))
ELSEWHERE = {"clusters", "solvers"}  # the commands of one need a cluster, the other shows none
NEEDS = {"tuning": "optuna"}  # an optional extra
SHOWN_ONLY = "[project.entry-points"  # a piece of a file


def blocks(page):
    return re.findall(r"```(\w+)\n(.*?)```", page.read_text(encoding="utf-8"), flags=re.DOTALL)


@pytest.mark.parametrize("page", [page for page in PAGES if page.stem not in ELSEWHERE], ids=lambda page: page.stem)
def test_what_a_page_shows_works(page, tmp_path):
    if page.stem in NEEDS:
        pytest.importorskip(NEEDS[page.stem])
    environment = {**os.environ, "COLUMNS": "120"}
    done_something = False
    for language, text in blocks(page):
        if text.startswith(SHOWN_ONLY):
            continue
        if named := re.match(r"# file: (\S+)\n", text):
            (tmp_path / named[1]).write_text(text.removeprefix(named[0]))
            continue
        commands = [["-c", text]] if language == "python" else []
        if language == "bash":
            commands = [["-m", *shlex.split(line)] for line in text.splitlines()]
        assert commands, f"a block of {language} that nothing runs:\n{text}"
        for command in commands:
            done = subprocess.run(
                [sys.executable, *command], cwd=tmp_path, capture_output=True, text=True, env=environment, timeout=300
            )
            assert done.returncode == 0, (command, done.stdout, done.stderr)
            done_something = True
    assert done_something


def test_the_group_shown_is_a_study(tmp_path):
    from nfbench import load_study

    page = PROJECT / "docs" / "solvers-and-groups.md"
    (text,) = [text for language, text in blocks(page) if text.startswith("# file: group.toml")]
    (tmp_path / "group.toml").write_text(text)
    kinds = [method.solver.kind for method in load_study(tmp_path / "group.toml").methods]
    assert kinds.count("multistart-lbfgsb") == 1 and "de" in kinds and "scipy-shgo" not in kinds
    assert all(f"`{name}`" in page.read_text(encoding="utf-8") for name in GROUPS)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)#]+)\)", page.read_text(encoding="utf-8")):
        if "://" not in target:
            assert Path(page.parent / target).exists(), target
