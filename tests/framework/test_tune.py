"""`nfbench tune`: where it looks, on which scenes, what it keeps, and what it says."""

import dataclasses
import importlib.util
import math
import re
from typing import Annotated, Literal

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

import nfbench
import nfbench.tuning
from nfbench import Ge, Gt, Le, Lt, MissingExtra, NfbenchError, Options, Tune
from nfbench.cli import app
from nfbench.manifest import load_study
from nfbench.options import build
from nfbench.registry import Registry
from nfbench.space import domains
from nfbench.tuning import Plan, judge, tune

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


# --- where it looks --------------------------------------------------------------------------------------------------


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
def test_every_solver_accepts_what_tuning_would_try(name):
    cls = Registry().find("solver", name).resolve()
    for option, domain in domains(cls).items():
        for value in (domain.low, domain.high) if isinstance(domain, Tune) else ():
            try:
                build(cls, {option: value})
            except nfbench.OptionError as error:  # rules across fields may object, the field itself must not
                assert all(path != option for path, _ in error.problems), error


def test_evolutionary_solvers_say_where_to_look():
    for name in ("de", "jade", "shade", "cmaes"):
        assert domains(Registry().find("solver", name).resolve())["population"].log


# --- what it finds ---------------------------------------------------------------------------------------------------


@needs_optuna
def test_scores_and_scenes_are_those_of_a_study(path, tmp_path):
    found = tune(load_study(path), plan(options={"width": 0.9}), tmp_path / "out")
    assert found.trials[0].options == {"points": 1, "mode": "fine"} and len(found.trials) == 9
    assert found.best.options["points"] > 1 and found.best.score < found.trials[0].score
    assert found.method.formulation.kind == "once" and found.error == "rmse_m"

    settings = [found.trials[0].options, found.best.options]
    lines = [
        f'[[solver]]\nkind = "points"\nlabel = "{i}"\nwidth = 0.9\npoints = {options["points"]}\n'
        for i, options in enumerate(settings)
    ]
    text = STUDY.replace('[[solver]]\nkind = "sampler"\n', "".join(lines))
    longer = path.with_name("longer.toml")
    longer.write_text(
        path.read_text().replace(STUDY.strip(), text.strip()).replace("repetitions = 4", "repetitions = 9")
    )
    runs = nfbench.run(load_study(longer), out=tmp_path / "longer", jobs=0).runs
    runs = runs[runs["formulation"] == "once"]
    logs = [np.log10(runs[runs["solver"] == label]["rmse_m"].to_numpy()) for label in "01"]
    repetition = runs[runs["solver"] == "0"]["repetition"].to_numpy()
    training, held_out = (repetition >= 6) & (repetition < 9), repetition < 6  # 4 are the study's, 6 held out
    assert found.trials[0].score == pytest.approx(logs[0][training].mean(), rel=1e-12)
    assert found.best.score == pytest.approx(logs[1][training].mean(), rel=1e-12)
    factor = 10 ** (logs[1] - logs[0])[held_out].mean()
    assert f"has {factor:.3g} times the default's error on 12 held-out scenes" in found.verdict
    assert list(found.held_out["runs"]) == [12, 12]


@needs_optuna
def test_the_same_seed_gives_the_same_trials_in_workers_too(path, tmp_path):
    study = load_study(path)
    for folder, seed, jobs in (("a", 1, 0), ("b", 1, 1), ("c", 2, 0)):
        tune(study, plan(seed=seed, trials=5, training=1, held_out=1), tmp_path / folder, jobs)
    a, b, c = ((tmp_path / folder / "trials.csv").read_text() for folder in "abc")
    assert a == b and a != c


@needs_optuna
def test_settings_that_fail_are_told_and_never_best(path, tmp_path):
    found = tune(load_study(path), plan(trials=25, seed=3), tmp_path / "out")
    table = pd.read_csv(tmp_path / "out" / "trials.csv")
    assert list(table.columns) == ["trial", "score", "error", "message", "points", "width", "mode"] and len(table) == 26
    broken = table["mode"] == "broken"
    assert broken.any() and (table["score"].isna() == (broken | (table["points"] == 64))).all()
    assert table.loc[broken, "message"].str.contains("failed: RuntimeError: out of luck|64 are too many").all()
    assert found.best.options["mode"] == "fine" and found.best.score == table["score"].min()


@needs_optuna
def test_where_nothing_runs_through_that_is_an_error(path, tmp_path):
    with pytest.raises(NfbenchError, match="no setting of points ran through; the default: failed: RuntimeError"):
        tune(load_study(path), plan(options={"mode": "broken"}), tmp_path / "out")


@needs_optuna
def test_an_interrupted_tuning_keeps_its_trials(path, tmp_path):
    def told(trial):
        if trial.number == 3:
            raise KeyboardInterrupt

    found = tune(load_study(path), plan(), tmp_path / "out", told=told)
    assert found.interrupted and len(found.trials) == 4 and found.held_out is None
    assert len(pd.read_csv(tmp_path / "out" / "trials.csv")) == 4
    assert "interrupted before held-out" in (tmp_path / "out" / "tuned.toml").read_text()


@needs_optuna
def test_where_sources_are_miscounted_gospa_is_tuned(path, tmp_path, monkeypatch):
    study, execute = load_study(path), nfbench.tuning.execute
    plain = tune(study, plan(trials=1, held_out=1), tmp_path / "plain")

    def miscounting(spec, registry):
        record = execute(spec, registry)
        more = {"gospa_m": 2 * record.scores["rmse_m"], "sources": 3.0, "sources_found": 2.0}
        return dataclasses.replace(record, scores=record.scores | more)

    monkeypatch.setattr("nfbench.tuning.execute", miscounting)
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


def test_without_optuna_it_says_how_to_get_it(path, tmp_path, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(MissingExtra, match=r"pip install 'nfbench\[optuna\]'"):
        tune(load_study(path), plan(), tmp_path / "out")


# --- what it says ----------------------------------------------------------------------------------------------------


def test_the_verdict_says_no_more_than_the_scenes_do():
    rng = np.random.default_rng(1)
    default = rng.lognormal(size=40)
    assert "0.5 times" in judge(default, default / 2) and "0.5 – 0.5): it is better" in judge(default, default / 2)
    assert "it is worse" in judge(default, default * 1.5)
    assert "the same within 1%" in judge(default, default * 1.002)
    assert "cannot be told apart" in judge(default, rng.permutation(default))
    assert "cannot be told apart" in judge(default, default * 0.995 * rng.lognormal(0, 0.02, 40))
    assert judge(default[:5], default[:5] / 9).startswith("5 held-out scenes with both errors do not tell")
    default[:36] = math.nan  # failed
    assert judge(default, default / 9).startswith("4 held-out scenes")


def test_the_interval_covers_the_true_factor():
    """Of 95 % intervals for the mean of 40 normal logs, about 94 % hold it; 300 of them within 4 standard errors."""
    rng = np.random.default_rng(2)
    hits = 0
    for _ in range(300):
        text = judge(np.ones(40), np.exp(rng.normal(math.log(0.8), 0.3, 40)))
        low, high = map(float, re.search(r"bootstrap (\S+) – (\S+)\)", text).groups())
        hits += low <= 0.8 <= high
    assert 0.94 * 300 - 4 * math.sqrt(300 * 0.94 * 0.06) <= hits < 300


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
