"""``nfbench new`` writes files that pass their checks and tests; ``nfbench check`` survives hangs and crashes."""

import subprocess
import sys

import pytest
from conftest import nfbench

BROKEN = """
import os, time
from dataclasses import dataclass
from nfbench import Solver, SolverInfo

@dataclass(frozen=True)
class Waits(Solver):
    \"\"\"Waits for two points with different values. crash: whether to end the process instead of waiting.\"\"\"
    info = SolverInfo(global_search=False, converges=False)
    crash: bool = False

    def minimize(self, problem, rng):
        while True:
            first, second = (problem(problem.from_unit(u)) for u in rng.random((2, problem.dimension)))
            while first == second:
                if self.crash:
                    os._exit(7)
"""


@pytest.mark.parametrize("kind", ["solver", "problem"])
def test_a_new_plugin_passes_its_checks_and_its_tests(kind, tmp_path):
    wrote = nfbench("new", kind, "my-own", cwd=tmp_path)
    assert wrote.returncode == 0 and wrote.stdout.startswith("Wrote my_own.py and test_my_own.py")
    assert {path.name for path in tmp_path.iterdir()} == {"my_own.py", "test_my_own.py"}
    checked = nfbench("check", kind, "my_own.py", cwd=tmp_path)
    assert checked.returncode == 0 and "FAIL" not in checked.stdout, checked.stdout
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "test_my_own.py"]
    tested = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert tested.returncode == 0, tested.stdout
    assert "my-own" in nfbench("list", "--plugin", "my_own.py", cwd=tmp_path).stdout


@pytest.mark.parametrize("kind", ["solver", "problem"])
def test_the_files_written_have_no_placeholders_and_no_long_lines(kind, tmp_path):
    nfbench("new", kind, "my-own", "--out", "other.py", cwd=tmp_path)
    for text in ((tmp_path / name).read_text() for name in ("other.py", "test_other.py")):
        assert "{" not in text.replace("{{", "") or 'f"' in text or '{"' in text
        assert all(len(line) <= 120 for line in text.splitlines())
        assert "from other import" in text or "my-own" in text


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["solver", "de"], "name: expected a new name, got 'de', which is a solver of nfbench"),
        (["problem", "near-field"], "name: expected a new name, got 'near-field', which is a scenario of nfbench"),
        (["solver", "MySolver"], "name: expected lower-case words joined by hyphens, e.g. my-solver, got 'MySolver'"),
        (["solver", "mine", "--out", "mine.txt"], "--out: expected a Python file like my_solver.py, got mine.txt"),
        (["solver", "mine", "--out", "no/mine.py"], "--out: expected an existing folder, got no"),
        (["solver", "taken"], "taken.py already exists and was not changed"),
    ],
)
def test_new_reports_why_it_writes_nothing(arguments, message, tmp_path):
    (tmp_path / "taken.py").write_text("mine")
    done = nfbench("new", *arguments, cwd=tmp_path)
    assert done.returncode == 2 and message in done.stderr and "Traceback" not in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["taken.py"]
    assert (tmp_path / "taken.py").read_text() == "mine"


def test_a_check_that_hangs_is_stopped_and_the_others_continue(tmp_path):
    (tmp_path / "waits.py").write_text(BROKEN)
    done = nfbench("check", "solver", "waits.py", "--timeout", 5, cwd=tmp_path)
    lines = {line.split()[1].rstrip(":"): line for line in done.stdout.splitlines()[1:]}
    assert done.returncode == 1 and len(lines) == 19
    assert {name for name, line in lines.items() if "FAIL" in line} == {
        *("nan-plateau", "constant", "quiet", "leaves-no-trace")
    }
    reasons = [line.partition(": ")[2] for line in lines.values() if "FAIL" in line]
    assert "expected the check to end within 5 s, got no result. Call problem.evaluate" in reasons[0]
    assert all(reason.startswith("the same as in ") for reason in reasons[1:])


def test_a_check_that_crashes_does_not_affect_the_others(tmp_path):
    (tmp_path / "waits.py").write_text(BROKEN)
    done = nfbench("check", "solver", "waits.py", "--option", "crash=true", cwd=tmp_path)
    failed = [line for line in done.stdout.splitlines() if "FAIL" in line]
    assert done.returncode == 1 and len(failed) == 4
    assert "exit code 7" in failed[0] and "leaves-no-trace" in failed[0]
    assert "expected the process of the check to stay alive, got its end by exit code 7" in "".join(failed)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["solver", "deh"], "unknown solver 'deh'; did you mean \"de\"?"),
        (["solver", "de", "--option", "population"], "expected NAME=VALUE"),
        (["solver", "de", "--option", "population=3"], "population: expected greater than or equal to 4, got 3"),
        (["problem", "near-field"], "array: is required"),
        (["problem", "no.toml"], "cannot be read: No such file"),
    ],
)
def test_check_reports_invalid_arguments(arguments, message, tmp_path):
    done = nfbench("check", *arguments, cwd=tmp_path)
    assert done.returncode == 2 and message in done.stderr.replace("\n", " "), done.stderr


def test_a_missing_dataclass_decorator_is_reported(tmp_path, manifest):
    text = BROKEN.replace("@dataclass(frozen=True)\n", "")
    (tmp_path / "forgot.py").write_text(text)
    done = nfbench("check", "solver", "forgot.py", cwd=tmp_path)
    assert done.returncode == 2
    assert "crash: is not a dataclass field: put @dataclass(frozen=True) above class Waits" in done.stderr
    study = manifest(
        '[[formulation]]\nkind = "once"\n[[solver]]\nkind = "waits"\ncrash = true\n[budget]\nevaluations = 9',
        plugins=[tmp_path / "forgot.py"],
    )
    done = nfbench("run", study, cwd=tmp_path)
    assert "solver[0].crash: is not a dataclass field: put @dataclass(frozen=True) above class Waits" in done.stderr
