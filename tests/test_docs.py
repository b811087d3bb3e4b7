"""Every file, program and command shown in docs/ works as printed, page by page in the order of the page.

A block that is not run has a comment above it that says why: ``<!-- not run: needs a cluster -->``. A block of output
has the comment ``<!-- output: of the study above -->``, and must be part of what the blocks above it print. Numbers may
differ by a few percent, as the last digits depend on the machine, and times are not compared.
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
WIDTH = 110  # of the terminal whose output is shown
TOLERANCE = 0.05  # of a number in an output


def blocks(page):
    """(language, text) of every block of code that is to run; the language of a block of output is "output"."""
    text = page.read_text(encoding="utf-8")
    pattern = r"(?:<!-- (not run|output): [^>]+ -->\n)?^```(\S*)[^\n]*\n(.*?)^```$"
    found = re.findall(pattern, text, flags=re.DOTALL | re.MULTILINE)
    return [
        (mark or language, block) for mark, language, block in found if mark != "not run" and language not in DIRECTIVES
    ]


def words(text):
    """The words of an output without rules and without the column of times."""
    found, time = [], 0
    for line in text.splitlines():
        cells = re.split(r"\s{2,}", line.strip())
        if "time" in cells:
            time = cells.index("time") - len(cells)
            del cells[time]
        elif time and len(cells) >= -time and cells[0] and cells[time] != "s":
            del cells[time]
        time = time if line.strip() else 0
        found += [word for cell in cells for word in cell.split() if word.strip("─")]
    return found


def alike(shown, printed):
    """Whether two words are equal, except for small differences of the numbers in them."""
    number = r"\d[\d,]*(?:\.\d+)?(?:e[-+]?\d+)?"
    if re.sub(number, "0", shown) != re.sub(number, "0", printed):
        return False
    pairs = zip(re.findall(number, shown), re.findall(number, printed), strict=True)
    both = [[float(part.replace(",", "")) for part in pair] for pair in pairs]
    return all(abs(one - two) <= TOLERANCE * max(one, two) for one, two in both)


def is_part(shown, printed):
    """Whether the words of an output occur in what was printed, one after the other."""
    parts, whole = words(shown), words(printed)
    starts = range(len(whole) - len(parts) + 1)
    return any(all(map(alike, parts, whole[start : start + len(parts)])) for start in starts)


RUNNING = [page for page in PAGES if blocks(page)]


@pytest.mark.parametrize("page", RUNNING, ids=lambda page: page.stem)
def test_what_a_page_shows_works(page, tmp_path):
    if page.stem in NEEDS:
        pytest.importorskip(NEEDS[page.stem])
    environment = {**os.environ, "COLUMNS": str(WIDTH)}
    printed = ""
    for language, text in blocks(page):
        if language == "output":
            assert is_part(text, printed), f"{text}is not part of\n{printed}"
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
                [sys.executable, *command],
                cwd=tmp_path,
                capture_output=True,
                text=True,
                env=environment,
                timeout=TIMEOUT_S,
            )
            assert done.returncode == 0, (command, done.stdout, done.stderr)
            printed += f"{done.stdout}\n"


def test_outputs_are_compared_word_by_word():
    table = " method   RMSE    time   runs\n             m       s\n ────────\n a + b    1.23   0.456      4\n"
    assert is_part(table.replace("0.456", "7e-03"), f"title\n{table}\n the end")
    assert is_part(table.replace("1.23", "1.24"), table) and not is_part(table.replace("1.23", "1.5"), table)
    assert not is_part(table.replace("a + b", "a + c"), table) and not is_part(table.replace("4\n", "5\n"), table)
    assert is_part("up to 10 % may\nfail.", "so up to 10 % may fail. Then") and not is_part("10 %", "10.8 % and 9 %")


def test_the_pages_that_show_code_are_found():
    expected = {"your-own-solver", "your-own-problem", "solvers-and-groups", "figures", "tuning", "export", "start"}
    expected |= {"reading", "claims", "budgets"}
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
