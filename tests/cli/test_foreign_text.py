"""Guards the terminal: no command is ended by a plugin, and none prints control characters or reads text as markup."""

import io
import shutil
import sqlite3
import sys

import pytest
from conftest import BASIC, nfbench
from rich.console import Console
from typer.testing import CliRunner

import nfbench as library
from nfbench import PluginError, load_study
from nfbench.cli import main
from nfbench.cli.catalogue import print_catalogue, print_plugin
from nfbench.cli.common import app
from nfbench.plugins import Registry

CLASSES = '''
import os, time
from dataclasses import dataclass, field
from nfbench import Instance, Scenario, Solver


class Nothing(Instance):
    def score(self, estimate):
        return {}


class Minimizes(Solver):
    def minimize(self, problem, rng):
        problem(problem.lower)


@dataclass(frozen=True)
class EndsValidate(Minimizes):
    """Ends [/] [red] its process."""
    def validate(self):
        os._exit(0)


@dataclass(frozen=True)
class EndsDefault(Minimizes):
    """Has a default that ends the process."""
    x: int = field(default_factory=lambda: os._exit(5))


@dataclass(frozen=True)
class EndsUnusable(Minimizes):
    """Ends its process when asked for its algorithms."""
    @classmethod
    def unusable(cls):
        os.kill(os.getpid(), 11)


@dataclass(frozen=True)
class InterruptsUnusable(Minimizes):
    """Raises KeyboardInterrupt when asked for its algorithms."""
    @classmethod
    def unusable(cls):
        raise KeyboardInterrupt("[/] \\x1b[31m")


@dataclass(frozen=True)
class EndsScenario(Scenario):
    """Ends its process."""
    instance = Nothing
    def needed_extra(self):
        os._exit(6)
    def draw(self, rng):
        return None
'''
CONTROL = "a\x1b[2Jb\rc\x07[/] [red]d :smile:"
LITERAL = r"a\x1b[2Jb c\x07[/] [red]d :smile:"


@pytest.fixture(scope="module")
def classes(tmp_path_factory):
    file = tmp_path_factory.mktemp("plugins") / "classes.py"
    file.write_text(CLASSES)
    return file


def test_list_has_a_row_for_every_plugin_whatever_its_methods_do(classes):
    console = Console(file=io.StringIO(), width=1000)
    print_catalogue(Registry([classes]), ["solver", "scenario"], console)
    words = " ".join(console.file.getvalue().replace("│", " ").split())
    assert "ends-validate global single yes no" in words  # nothing needs to be constructed for its row
    assert "solver ends-unusable of classes.py cannot be described: ended the process by signal 11 (SIGSEGV)" in words
    assert r"cannot be described: KeyboardInterrupt: [/] \x1b[31m (classes.py:" in words
    assert "scenario ends-scenario of classes.py cannot be described: ended the process with exit code 6" in words


@pytest.mark.parametrize(
    ("kind", "name", "reason"),
    [
        ("solver", "ends-default", "ended the process with exit code 5 while it was described"),
        ("solver", "ends-unusable", "ended the process by signal 11 (SIGSEGV) while it was described"),
        ("solver", "interrupts-unusable", r"KeyboardInterrupt: [/] \x1b[31m (classes.py:"),
        ("scenario", "ends-scenario", "ended the process with exit code 6 while it was described"),
    ],
)
def test_show_reports_what_would_end_it(classes, kind, name, reason):
    with pytest.raises(PluginError) as raised:
        print_plugin(Registry([classes]), kind, name, Console(file=io.StringIO()))
    assert str(raised.value).startswith(f"{kind} {name} of classes.py cannot be described: {reason}")


def test_show_says_which_file_could_not_be_imported(tmp_path):
    (tmp_path / "bad.py").write_text("import no_such_module")
    with pytest.raises(PluginError, match=r"unknown solver 'mine'.*; plugin bad\.py could not be imported: ModuleNot"):
        print_plugin(Registry([tmp_path / "bad.py"]), "solver", "mine", Console(file=io.StringIO()))


def test_a_solver_that_cannot_be_made_costs_its_own_rows_and_fails_its_checks(classes, manifest, tmp_path):
    tables = '[[solver]]\nkind = "ends-validate"\n[[solver]]\nkind = "ends-default"\n'
    done = nfbench("run", manifest(BASIC + tables, plugins=[classes]), "--jobs", 1, cwd=tmp_path)
    assert done.returncode == 1 and "Traceback" not in done.stderr, done.stderr
    runs = library.Results(tmp_path / "results" / "toy").runs
    assert list(runs[runs.solver == "sampler"].status) == ["ok"] * 3
    for name, code in (("ends-validate", 0), ("ends-default", 5)):
        rows = runs[runs.solver == name]
        assert list(rows.status) == ["failed"] * 3
        assert (
            f"solver {name} of classes.py cannot be made: ended the process with exit code {code}"
            in rows.message.iloc[0]
        )
    done = nfbench("check", "solver", "ends-validate", "--plugin", classes, cwd=tmp_path)
    assert done.returncode == 2 and "cannot be made: ended the process with exit code 0" in done.stderr


@pytest.mark.parametrize("command", [[], ["check"], ["new"], ["run"], ["check", "solver"]])
def test_help_is_plain_text(command):
    done = CliRunner().invoke(app, [*command, "--help"])
    assert done.exit_code == 0 and "Usage: " in done.stdout and "╭" not in done.stdout


@pytest.fixture(scope="module")
def crafted(tmp_path_factory, request):
    """A results folder of which every text holds control characters and markup, and the same study unchanged."""
    folder = tmp_path_factory.mktemp("crafted")
    toy = request.config.rootpath / "tests" / "toy_plugins" / "toy.py"
    head = f'name = "toy"\ntitle = "title"\nexpect = "more"\nrepetitions = 8\nseed = 1\nplugins = ["{toy}"]\n'
    tables = '[[solver]]\nkind = "raises"\n[sweep]\nnoise = [0.0, 0.5]\n'
    (folder / "toy.toml").write_text(f'{head}[scenario]\nkind = "toy"\n{BASIC}{tables}')
    library.run(load_study(folder / "toy.toml"), out=folder / "good", jobs=0)
    shutil.copytree(folder / "good", folder / "bad")
    with sqlite3.connect(folder / "bad" / "runs.sqlite") as db:
        db.execute("UPDATE results SET message = ? || message", [CONTROL])
        db.execute("UPDATE meta SET value = ? WHERE key IN ('title', 'expect', 'name')", [CONTROL])
    return folder


READING = {
    "status": ("status", "{bad}"),
    "report": ("report", "{bad}"),
    "figure": ("figure", "{bad}", "--out", "{out}", "--format", "svg"),
    "csv": ("export", "{bad}", "--to", "csv", "--out", "{out}/x.csv"),
    "ioh": ("export", "{bad}", "--to", "ioh", "--out", "{out}/ioh"),
    "compare": ("compare", "{bad}", "{good}"),
    "merge": ("merge", "{bad}", "--out", "{out}/merged"),
}


@pytest.mark.parametrize("name", READING)
def test_control_characters_of_a_folder_are_shown_as_escapes(name, crafted, tmp_path, monkeypatch, capfd):
    places = {"bad": crafted / "bad", "good": crafted / "good", "out": tmp_path / "out"}
    places["out"].mkdir()
    monkeypatch.setattr(sys, "argv", ["nfbench", *(part.format(**places) for part in READING[name])])
    monkeypatch.setenv("COLUMNS", "1000")
    code = 0
    try:
        main()
    except SystemExit as ended:
        code = ended.code or 0
    output, errors = capfd.readouterr()
    assert code in (0, 1, 2) and "Traceback" not in errors
    assert not {"\x1b", "\r", "\x07"} & {*(output + errors)}, output + errors
    if name in ("status", "report"):
        assert LITERAL in output, output
