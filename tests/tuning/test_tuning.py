"""`nfbench tune`: its search ranges, its scenes, the files it keeps, and what it reports."""

import dataclasses
import importlib.util
import math
import os
import re
import signal
import subprocess
import sys
from typing import Annotated, Literal

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

import nfbench
import nfbench.tuning
from nfbench import Ge, Gt, Le, Lt, MissingExtra, NfbenchError, Options, StoreError, Tune
from nfbench.cli.entry import app
from nfbench.core.options import build
from nfbench.plugins.registry import Registry
from nfbench.results.folder import locked
from nfbench.study.manifest import load_study
from nfbench.tuning.search_space import domains
from nfbench.tuning.tuning import Plan, tune

needs_optuna = pytest.mark.skipif(importlib.util.find_spec("optuna") is None, reason="the extra optuna is missing")

PLUGIN = """
from dataclasses import dataclass
from typing import Annotated, Literal
from nfbench import Ge, Le, Solver, Tune

@dataclass(frozen=True)
class Points(Solver):
    \"\"\"Some random points, in part of the box.\"\"\"
    points: Annotated[int, Ge(1), Tune(1, 64, log=True)] = 1
    width: Annotated[float, Ge(0.0), Le(1.0)] = 1.0
    mode: Literal["fine", "broken"] = "fine"
    patience: int = 3

    def validate(self):
        if self.points == 64:
            raise ValueError("points: 64 are too many")

    def minimize(self, problem, rng):
        if self.mode == "broken":
            raise RuntimeError("out of luck")
        problem.evaluate(problem.from_unit(rng.random((self.points, problem.dimension)) * self.width))
"""

STUDY = """
[[formulation]]
kind = "oracle"
[[formulation]]
kind = "once"
[[formulation]]
kind = "twice"
label = "two"
[[solver]]
kind = "sampler"
[budget]
evaluations = 40
[sweep]
noise = [0.0, 0.5]
"""


@pytest.fixture
def path(manifest, tmp_path):
    (tmp_path / "points.py").write_text(PLUGIN)
    return manifest(STUDY, repetitions=4, plugins=[tmp_path / "points.py"])


def plan(**more):
    return Plan("points", **{"trials": 8, "training": 3, "held_out": 6, **more})


# --- search ranges --------------------------------------------------------------------------------------------------


def test_domains_follow_from_types_limits_and_marks():
    @dataclasses.dataclass(frozen=True)
    class Everything(Options):
        flag: bool = True
        word: Literal["a", "b"] = "a"
        marked: Annotated[int, Ge(4), Tune(10, 200, log=True)] = 50
        maybe: Annotated[float, Gt(0.0), Tune(1, 2)] | None = None
        closed: Annotated[float, Ge(0.0), Le(2.0)] = 0.5
        half_open: Annotated[float, Gt(0.0), Lt(0.5)] = 0.1
        whole: Annotated[int, Gt(3), Lt(9)] = 5
        unlimited: Annotated[int, Ge(1)] = 1
        number: float = 1.0
        text: str = ""
        several: tuple[float, ...] = ()
        either: int | str = 1

    found = domains(Everything)
    assert found == {
        "flag": (False, True),
        "word": ("a", "b"),
        "marked": Tune(10, 200, log=True),
        "maybe": Tune(1.0, 2.0),
        "closed": Tune(0.0, 2.0),
        "half_open": Tune(math.nextafter(0.0, 1.0), math.nextafter(0.5, 0.0)),
        "whole": Tune(4, 8),
    }
    assert isinstance(found["maybe"].low, float) and isinstance(found["whole"].low, int)
    for low, high, log in ((2, 1, False), (0, 1, True)):
        with pytest.raises(ValueError, match="Tune"):
            Tune(low, high, log)


@pytest.mark.parametrize("name", Registry().names("solver"))
def test_every_solver_accepts_the_ends_of_its_search_ranges(name):
    cls = Registry().find("solver", name).resolve()
    for option, domain in domains(cls).items():
        for value in (domain.low, domain.high) if isinstance(domain, Tune) else ():
            try:
                build(cls, {option: value})
            except (
                nfbench.OptionError
            ) as error:  # rules across fields may reject the value, those of the field must not
                assert all(path != option for path, _ in error.problems), error


def test_evolutionary_solvers_declare_a_search_range_of_the_population():
    for name in ("de", "jade", "shade", "cmaes"):
        assert domains(Registry().find("solver", name).resolve())["population"].log


# --- results ---------------------------------------------------------------------------------------------------


@needs_optuna
def test_scores_and_scenes_are_those_of_a_study(path, tmp_path):
    found = tune(load_study(path), plan(options={"width": 0.9}), tmp_path / "out")
    assert found.trials[0].options == {"points": 1, "mode": "fine"} and len(found.trials) == 9
    assert found.best.options["points"] > 1 and found.best.score < found.trials[0].score
    assert found.method.formulation.kind == "once" and found.error == "rmse_m"

    settings = [found.trials[0].options, found.best.options]
    lines = [
        f'[[solver]]\nkind = "points"\nlabel = "s{i}"\nwidth = 0.9\npoints = {options["points"]}\n'
        for i, options in enumerate(settings)
    ]
    text = STUDY.replace('[[solver]]\nkind = "sampler"\n', "".join(lines))
    longer = path.with_name("longer.toml")
    longer.write_text(
        path.read_text().replace(STUDY.strip(), text.strip()).replace("repetitions = 4", "repetitions = 9")
    )
    runs = nfbench.run(load_study(longer), out=tmp_path / "longer", jobs=0).runs
    runs = runs[runs["formulation"] == "once"]
    logs = [np.log10(runs[runs["solver"] == label]["rmse_m"].to_numpy()) for label in ("s0", "s1")]
    repetition = runs[runs["solver"] == "s0"]["repetition"].to_numpy()
    training, held_out = (
        (repetition >= 6) & (repetition < 9),
        repetition < 6,
    )  # the study has 4 repetitions, and 6 are held out
    assert found.trials[0].score == pytest.approx(logs[0][training].mean(), rel=1e-12)
    assert found.best.score == pytest.approx(logs[1][training].mean(), rel=1e-12)
    changes = (logs[1] - logs[0])[held_out].reshape(6, 2).mean(axis=1)  # of two points per scene
    walsh = [(changes[i] + changes[j]) / 2 for i in range(6) for j in range(i, 6)]
    factor = 10 ** np.median(walsh)  # Hodges and Lehmann's estimate
    assert f"has {factor:.3g} times the default's error on 6 held-out scenes" in found.verdict
    assert list(found.held_out["runs"]) == [12, 12]


@needs_optuna
def test_the_same_seed_gives_the_same_trials_in_workers_too(path, tmp_path):
    study = load_study(path)
    for folder, seed, jobs in (("a", 1, 0), ("b", 1, 1), ("c", 2, 0)):
        tune(study, plan(seed=seed, trials=5, training=1, held_out=1), tmp_path / folder, jobs)
    a, b, c = ((tmp_path / folder / "trials.csv").read_text() for folder in "abc")
    assert a == b and a != c


@needs_optuna
def test_settings_that_fail_are_recorded_and_never_best(path, tmp_path):
    found = tune(load_study(path), plan(trials=25, seed=3), tmp_path / "out")
    table = pd.read_csv(tmp_path / "out" / "trials.csv")
    assert list(table.columns) == ["trial", "score", "error", "message", "points", "width", "mode"] and len(table) == 26
    broken = table["mode"] == "broken"
    assert broken.any() and (table["score"].isna() == (broken | (table["points"] == 64))).all()
    assert table.loc[broken, "message"].str.contains("failed: RuntimeError: out of luck|64 are too many").all()
    assert found.best.options["mode"] == "fine" and found.best.score == table["score"].min()


@needs_optuna
def test_it_is_an_error_if_every_setting_fails(path, tmp_path):
    with pytest.raises(NfbenchError, match="every setting of points failed; the default: failed: RuntimeError"):
        tune(load_study(path), plan(options={"mode": "broken"}), tmp_path / "out")


@needs_optuna
def test_an_interrupted_tuning_keeps_its_trials(path, tmp_path):
    def interrupt(trial):
        if trial.number == 3:
            raise KeyboardInterrupt

    found = tune(load_study(path), plan(), tmp_path / "out", on_trial=interrupt)
    assert found.interrupted and len(found.trials) == 4 and found.held_out is None
    assert len(pd.read_csv(tmp_path / "out" / "trials.csv")) == 4
    assert "interrupted before the held-out" in (tmp_path / "out" / "tuned.toml").read_text()


@needs_optuna
def test_gospa_is_tuned_if_sources_are_miscounted(path, tmp_path, monkeypatch):
    study, execute = load_study(path), nfbench.execution.engine.execute
    plain = tune(study, plan(trials=1, held_out=1), tmp_path / "plain")

    def miscounting(spec, registry):
        record = execute(spec, registry)
        more = {"gospa_m": 2 * record.scores["rmse_m"], "sources": 3.0, "sources_found": 2.0}
        return dataclasses.replace(record, scores=record.scores | more)

    monkeypatch.setattr("nfbench.execution.engine.execute", miscounting)
    found = tune(study, plan(trials=1, held_out=1), tmp_path / "out")
    assert plain.error == "rmse_m" and found.error == "gospa_m"
    assert found.trials[0].score == pytest.approx(plain.trials[0].score + math.log10(2), rel=1e-12)


@needs_optuna
def test_formulation_and_budget_can_be_chosen(path, tmp_path):
    study = load_study(path)
    found = tune(study, plan(formulation="two", evaluations=7, trials=1, held_out=1), tmp_path / "out")
    assert found.method.formulation.kind == "twice" and found.method.budget["evaluations"] == 7
    with pytest.raises(NfbenchError, match=r"has no 'tow' with a solver; did you mean \"two\"\?"):
        tune(study, plan(formulation="tow"), tmp_path / "out")
    with pytest.raises(NfbenchError, match="has no option to tune"):
        tune(study, Plan("raises"), tmp_path / "out")


def test_without_optuna_the_error_names_the_command_that_installs_it(path, tmp_path, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(MissingExtra, match=r"pip install 'nfbench\[optuna\]'"):
        tune(load_study(path), plan(), tmp_path / "out")


# --- resuming --------------------------------------------------------------------------------------------------------

STOP = """
    def minimize(self, problem, rng):
        import multiprocessing, os
        if "STOP" in os.environ:  # at run number STOP, a signal to the process that tunes
            with open(os.environ["STOP_COUNTER"], "ab") as file:
                file.write(b".")
                file.flush()
                if file.tell() == int(os.environ["STOP"]):
                    tuning = os.getppid() if multiprocessing.parent_process() else os.getpid()
                    os.kill(tuning, int(os.environ["STOP_SIGNAL"]))
"""
FILES = ("trials.csv", "tuned.toml", "tuning.json")


def contents(folder):
    return {file.name: (file.read_bytes(), file.stat().st_mtime_ns) for file in folder.iterdir()}


def written(folder):
    return [(folder / name).read_bytes() for name in FILES]


def small(**more):
    return plan(**{"trials": 3, "training": 1, "held_out": 1, **more})


@needs_optuna
@pytest.mark.parametrize(
    ("number", "jobs", "then"),
    [
        (signal.SIGKILL, 2, 2),
        pytest.param(signal.SIGKILL, 0, 0, marks=pytest.mark.slow),
        pytest.param(signal.SIGINT, 2, 0, marks=pytest.mark.slow),
    ],
)
def test_a_tuning_that_was_killed_and_resumed_ends_with_the_same_files(path, tmp_path, number, jobs, then):
    plugin = tmp_path / "points.py"
    plugin.write_text(PLUGIN.replace("\n    def minimize(self, problem, rng):\n", STOP))
    out, how = (
        tmp_path / "out",
        plan(trials=16, training=2, options={"mode": "fine"}),
    )  # TPE starts after 10 random trials
    tune(load_study(path), how, tmp_path / "whole")
    stop = {"STOP": "20", "STOP_COUNTER": str(tmp_path / "count"), "STOP_SIGNAL": str(int(number))}
    arguments = ["--trials", 16, "--training", 2, "--held-out", 6, "--option", "mode=fine", "--jobs", jobs]
    command = [sys.executable, "-m", "nfbench", "tune", "points", path, *arguments, "--out", out]
    done = subprocess.run(
        [*map(str, command)],
        env={**os.environ, **stop},
        capture_output=True,
        text=True,
        timeout=300,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # a background job of a shell ignores SIGINT
    )
    assert done.returncode == (130 if number == signal.SIGINT else -number), done.stderr
    begun, whole = (out / "trials.csv").read_bytes(), (tmp_path / "whole" / "trials.csv").read_bytes()
    assert whole.startswith(begun) and 4 <= begun.count(b"\n") < whole.count(b"\n") == 18
    tune(load_study(path), how, out, then)
    assert written(out) == written(tmp_path / "whole")


@needs_optuna
def test_stored_trials_are_not_run_again_and_more_trials_can_follow(path, tmp_path, monkeypatch):
    study, out, specs, execute = load_study(path), tmp_path / "out", [], nfbench.execution.engine.execute
    monkeypatch.setattr(
        "nfbench.execution.engine.execute", lambda spec, registry: (specs.append(spec), execute(spec, registry))[1]
    )
    first, before = tune(study, plan(trials=6), out), written(out)
    specs.clear()
    again = tune(study, plan(trials=2), out)
    assert repr(again.trials) == repr(first.trials) and len(again.trials) == 7 and written(out) == before
    assert {spec.repetition for spec in specs} == set(range(6)) and len(specs) == 24  # only the held-out ones
    tune(study, plan(trials=22), out)
    tune(study, plan(trials=22), tmp_path / "whole")
    assert written(out) == written(tmp_path / "whole") != before


@needs_optuna
def test_an_incomplete_line_is_ignored(path, tmp_path):
    study, out = load_study(path), tmp_path / "out"
    tune(study, small(), out)
    whole, table = written(out), out / "trials.csv"
    data = table.read_bytes()
    header, last = data.index(b"\n") + 1, data.rindex(b"\n", 0, -1) + 1
    for torn in (
        b"",
        data[:9],
        data[:header],
        data[: header + 7],
        data[: last + 1],
        data[:-1],
        data[:last] + b"\0" * 99,
    ):
        table.write_bytes(torn)
        tune(study, small(), out)
        assert written(out) == whole, torn
    (out / "tuned.toml").unlink()
    table.unlink()  # as if killed between writing two files
    tune(study, small(), out)
    assert written(out) == whole


@needs_optuna
def test_a_resumed_tuning_uses_the_error_measure_of_the_stored_default(path, tmp_path, monkeypatch):
    study, out, execute = load_study(path), tmp_path / "out", nfbench.execution.engine.execute

    def miscounting(spec, registry):  # only with the default setting
        record, found = execute(spec, registry), 3.0 - (spec.method.solver.options["points"] == 1)
        more = {"gospa_m": 2 * record.scores["rmse_m"], "sources": 3.0, "sources_found": found}
        return dataclasses.replace(record, scores=record.scores | more)

    def interrupt(trial):
        if trial.number == 1:
            raise KeyboardInterrupt

    monkeypatch.setattr("nfbench.execution.engine.execute", miscounting)
    how = small(options={"mode": "fine"})
    whole = tune(study, how, tmp_path / "whole")
    assert tune(study, how, out, on_trial=interrupt).interrupted
    assert tune(study, how, out).error == whole.error == "gospa_m"
    assert written(out) == written(tmp_path / "whole")


@needs_optuna
def test_an_interruption_before_any_new_trial_changes_nothing(path, tmp_path):
    tune(load_study(path), small(), tmp_path / "out")
    before = contents(tmp_path / "out")

    def interrupt(trial):
        if trial.number == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        tune(load_study(path), small(trials=5), tmp_path / "out", on_trial=interrupt)
    assert contents(tmp_path / "out") == before


@needs_optuna
def test_a_folder_of_another_tuning_is_refused_with_what_differs(path, manifest, tmp_path):
    out, files = tmp_path / "out", [tmp_path / "points.py"]
    tune(load_study(path), small(), out)
    (out / ".lock").unlink(missing_ok=True)  # it must not be created again
    before = contents(out)

    def refused(study, how, differing):
        with pytest.raises(StoreError, match=f"belongs to another tuning: {re.escape(differing)}.*--out.*--fresh"):
            tune(load_study(study), how, out)
        assert contents(out) == before

    refused(path, small(seed=5), "expected seed.tuner = 5, found 0; choose")
    refused(path, small(training=2), "expected training.scenes = 2, found 1; choose")
    refused(path, small(held_out=9), "expected training.from_repetition = 9, found 4; choose")
    refused(path, small(options={"patience": 4}), "expected options.patience = 4, found None; choose")
    refused(path, small(evaluations=7), "expected budget.evaluations = 7, found 40; choose")
    refused(path, small(formulation="two"), "expected formulation.kind = 'twice', found 'once'; choose")
    for text, seed, differing in (
        (STUDY, 2, "expected seed.study = 2, found 1"),
        (STUDY.replace("0.5", "0.4"), 1, "expected points[1].noise = 0.4, found 0.5"),
        (STUDY.replace("0.5", "0.5, 0.6"), 1, "expected 3 points, found 2"),
    ):
        refused(manifest(text, repetitions=4, seed=seed, plugins=files, file="other.toml"), small(), differing)
    same = manifest(STUDY, repetitions=3, plugins=files, file="same.toml", name="renamed")
    assert len(tune(load_study(same), small(held_out=4), out).trials) == 4  # the scenes are the same
    before = contents(out)
    files[0].write_text(PLUGIN + "# changed")
    refused(path, small(), "expected versions.solver = ")


@needs_optuna
def test_a_folder_that_cannot_be_read_is_refused(path, tmp_path):
    study, out = load_study(path), tmp_path / "out"
    tune(study, small(), out)
    table, about = (out / "trials.csv").read_bytes(), (out / "tuning.json").read_bytes()
    rows = table.splitlines(keepends=True)
    number, score, *rest = rows[2].split(b",")
    other = b",".join([number, score, *rest[:2], b"17", *rest[3:]])
    for name, data, why in (
        ("trials.csv", rows[0] + rows[2], "cannot be read: expected trial 0 in line 2, got 1,"),
        (
            "trials.csv",
            table.replace(b"points", b"dots", 1),
            "cannot be read: expected the columns trial, score, error",
        ),
        ("trials.csv", b"".join([*rows[:2], b",".join([number, b"low", *rest])]), "could not convert.*'low'"),
        ("trials.csv", b"\xff\n" + table, "cannot be read: .*decode"),
        (
            "trials.csv",
            b"".join([*rows[:2], other, b"torn"]),
            r"the sampler proposes other options for trial 1 .*points was 17, now \d+",
        ),
        ("tuning.json", about[:40], "cannot be read: "),
        ("tuning.json", b"[]", "cannot be read: "),
        ("tuning.json", None, "trials.csv and tuned.toml but no tuning.json"),
    ):
        (out / "trials.csv").write_bytes(table)
        (out / "tuning.json").write_bytes(about)
        (out / name).unlink() if data is None else (out / name).write_bytes(data)
        before = contents(out)
        with pytest.raises(StoreError, match=f"{why}.*--out.*--fresh"):
            tune(study, small(), out)
        assert contents(out) == before, why


@needs_optuna
def test_fresh_moves_a_folder_aside_unless_another_process_writes_there(path, tmp_path):
    study, out = load_study(path), tmp_path / "out"
    tune(study, small(), out)
    before = written(out)
    lock = locked(out)
    for fresh in (False, True):
        with pytest.raises(StoreError, match="another nfbench process is writing to this folder"):
            tune(study, small(), out, fresh=fresh)
        with pytest.raises(StoreError, match="another nfbench process is writing to this folder"):
            nfbench.run(study, out=out, jobs=0, fresh=fresh)
    lock.release()
    assert written(out) == before
    arguments = ["tune", "points", path, "--trials", 1, "--training", 1, "--held-out", 1, "--jobs", 0, "--out", out]
    assert CliRunner().invoke(app, [*map(str, arguments), "--seed", "7", "--fresh"]).exit_code == 0
    (old,) = tmp_path.glob("out.2*")
    assert written(old) == before and len(pd.read_csv(out / "trials.csv")) == 2


# --- the command -----------------------------------------------------------------------------------------------------


@needs_optuna
def test_the_command_writes_a_table_to_paste(path, tmp_path):
    out = tmp_path / "out"
    arguments = ["tune", "points", path, "--trials", 6, "--training", 2, "--held-out", 6, "--jobs", 0, "--out", out]
    done = CliRunner().invoke(app, [*map(str, arguments), "--option", "mode=fine", "--seed", "1"])
    assert done.exit_code == 0, done.output
    assert "trial 0: " in done.output and "held-out scenes" in done.output and "tuned.toml, trials.csv" in done.output
    pasted = path.with_name("pasted.toml")
    pasted.write_text(path.read_text() + (out / "tuned.toml").read_text())
    (options,) = {
        str(method.solver.options): method.solver.options
        for method in load_study(pasted).methods
        if method.solver and method.solver.label == "points tuned"
    }.values()
    table = pd.read_csv(out / "trials.csv")
    best = table.loc[table["score"].idxmin()]
    assert (options["points"], options["width"], options["mode"]) == (best["points"], best["width"], "fine")


@needs_optuna
@pytest.mark.parametrize("name", ["tuning.json", "trials.csv"])
@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir], ids=["pipe", "folder"])
def test_what_is_in_the_place_of_a_file_is_named(path, tmp_path, name, make):
    out = tmp_path / "out"
    out.mkdir()
    make(out / name)
    with pytest.raises(StoreError, match=rf"{name}: expected a file, found something else|has {name} but no"):
        tune(load_study(path), plan(trials=2), out)
