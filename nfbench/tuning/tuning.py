"""Tunes a solver's options on training scenes of a study, and measures the gain on held-out scenes."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import math
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, final

import numpy as np
import pandas as pd
from jaxtyping import Float
from numpy import ndarray

from nfbench.analysis import summarize, tuning_verdict
from nfbench.core import (
    Budget,
    MissingExtra,
    NfbenchError,
    PluginError,
    Status,
    StoreError,
    Tune,
    canonical,
    suggest,
)
from nfbench.execution import RunAll, ordered_runner, warm_up
from nfbench.plugins import Registry
from nfbench.results import locked, prepare, write_whole
from nfbench.study import ErrorCollector, Method, PluginSpec, Resolver, RunRecord, RunSpec, Study

from .search_space import Domain, domains
from .trials import TUNED, Trial, Trials

__all__ = ["Plan", "Trial", "Tuning", "tune"]

FLOOR = 1e-12  # smaller errors count as this
DIGITS = 4  # significant digits of a tuned number


@dataclass(frozen=True)
class Plan:
    """What is tuned, and how.

    solver: name of the solver to tune.
    options: options of the solver that keep these values and are not tuned.
    formulation: label in the study of the formulation to tune for; None: the first that needs a solver.
    evaluations: budget of evaluations per problem; None: the study's budget.
    trials: number of settings to try in addition to the default setting.
    training: number of training scenes at each scenario point of the study.
    held_out: number of held-out scenes at each scenario point of the study.
    seed: seed of the tuner's sampler; the scenes use the study's seed.
    """

    solver: str
    options: Mapping[str, Any] = field(default_factory=dict)
    formulation: str | None = None
    evaluations: int | None = None
    trials: int = 50
    training: int = 10
    held_out: int = 30
    seed: int = 0


@dataclass(frozen=True)
class Tuning:
    """The result of a tuning.

    plan: the plan that was executed; its ``trials`` count stored trials beyond those requested, too.
    study: the study whose scenes were used.
    method: formulation and budget that the solver was tuned for.
    error: name of the error measure that was minimized.
    trials: all trials in order; the first is the default setting.
    best: the trial with the lowest score.
    held_out: rows of ``summarize`` for "default" and "tuned"; None if the default is best, or if the tuning was
    interrupted before the held-out scenes were run.
    verdict: a sentence with the result on the held-out scenes.
    interrupted: whether the tuning was interrupted.
    """

    plan: Plan
    study: Study
    method: Method
    error: str
    trials: list[Trial]
    best: Trial
    held_out: pd.DataFrame | None
    verdict: str
    interrupted: bool = False


def tune(
    study: Study,
    plan: Plan,
    out: Path,
    jobs: int = 0,
    on_trial: Callable[[Trial], None] = lambda trial: None,
    fresh: bool = False,
) -> Tuning:
    """Search the options with the lowest mean log error on training scenes, and compare them on held-out scenes.

    The score of a trial is the mean over the training scenes of log10 of the study's error, or of ``gospa_m`` if the
    default does not find the true number of sources in every scene. Held-out scenes are the study's first repetitions.
    Training scenes are repetitions after those and after all repetitions of the study. Optuna's TPE proposes one
    setting after the other, so the settings depend only on the study and the plan, not on ``jobs``. Writes
    ``trials.csv``, one row as each trial ends, and ``tuned.toml``. After KeyboardInterrupt, the finished trials count.

    A second call resumes: stored trials are not run again, and the sampler receives their scores, so that the next
    settings are the same as without an interruption. All stored trials count, even if more than ``plan.trials``.

    out: folder of the tuning.
    jobs: number of worker processes; 0: run in this process.
    on_trial: called with each trial, stored ones included.
    fresh: whether to move an existing folder aside first.

    Raises NfbenchError if the plan does not fit the study or every setting fails, MissingExtra without
    Optuna, StoreError if the folder cannot be used, has another writer, or belongs to another tuning (nothing is then
    changed), and KeyboardInterrupt if it comes before any new trial.
    """
    if importlib.util.find_spec("optuna") is None:
        raise MissingExtra("tuning needs optuna, which is not installed: pip install 'nfbench[optuna]'")
    search = _Search(study, plan)
    try:
        if not fresh:
            search.stored(out)  # refuses the folder of another tuning before anything is written
        prepare(out, fresh)
        lock = locked(out)
        try:
            found = search.tuning(search.stored(out), jobs, on_trial)
            text = _toml(found)
            write_whole(out / TUNED, lambda draft: draft.write_text(text, encoding="utf-8"), "trials.csv")
        finally:
            lock.release()
    except OSError as error:
        raise StoreError(f"{out}: {error.strerror or error}") from error
    return found


@final
class _Search:
    """One tuning in progress."""

    def __init__(self, study: Study, plan: Plan) -> None:
        self.study, self.plan = study, plan
        self.method = _method(study, plan)
        self.registry = Registry(study.plugins)
        self.first = max(study.scenes, plan.held_out)  # first training repetition
        study.check_scenes(self.first + plan.training)
        default = self.registry.make("solver", plan.solver, plan.options)
        self.domains = {name: d for name, d in domains(type(default)).items() if name not in plan.options}
        if not self.domains:
            raise NfbenchError(
                f"{plan.solver} has no option to tune: no bool, no Literal, no number with two limits or Tune"
            )
        self.default = {name: canonical(getattr(default, name)) for name in self.domains}
        self.error = study.error
        self.scores: dict[str, tuple[float, str]] = {}
        self.trials: list[Trial] = []

    def stored(self, folder: Path) -> Trials:
        """The stored trials of this tuning. Raises StoreError if the folder holds another tuning."""
        return Trials(folder, self._identity(), list(self.domains))

    def _identity(self) -> dict[str, Any]:
        """Everything that determines the settings, the scenes and the scores, as plain data."""
        study, plan, method = self.study, self.plan, self.method
        solver = self._solver({}, ErrorCollector())
        assert solver is not None  # the constructor has already created it
        return {
            "solver": plan.solver,
            "options": canonical(plan.options),
            "formulation": method.formulation.identity,
            "budget": method.budget,
            "training": {"scenes": plan.training, "from_repetition": self.first},
            "seed": {"tuner": plan.seed, "study": study.seed},
            "points": [point.scenario.identity for point in study.points],
            "versions": {
                "solver": solver.version,
                "formulation": method.formulation.version,
                "scenario": "+".join(dict.fromkeys(point.scenario.version for point in study.points)),
            },
        }

    def tuning(self, stored: Trials, jobs: int, on_trial: Callable[[Trial], None]) -> Tuning:
        self.plan = replace(self.plan, trials=max(self.plan.trials, len(stored) - 1))
        before = len(stored)
        frame, verdict, interrupted = None, "The tuning was interrupted before the held-out scenes were run.", False
        try:
            scenario, solver = self.study.points[0].scenario, self._solver({}, ErrorCollector())
            if scenario.broken:
                raise PluginError(scenario.broken)
            warm_up(self.study, [solver] if solver else [])
            with ordered_runner(self.study.plugins, jobs) as run:
                self._search(run, stored, on_trial)
                if self._best().number == 0:
                    verdict = f"None of {self.plan.trials} settings is better on the training scenes: keep the default."
                else:
                    frame, verdict = self._compare(run)
        except KeyboardInterrupt:
            interrupted = True
            if len(self.trials) <= before:
                raise
        plan, study, method = self.plan, self.study, self.method
        best = self._best()
        return Tuning(plan, study, method, self.error, self.trials, best, frame, verdict, interrupted)

    def _best(self) -> Trial:
        valid = [trial for trial in self.trials if not math.isnan(trial.score)]
        if not valid:
            raise NfbenchError(f"every setting of {self.plan.solver} failed; the default: {self.trials[0].message}")
        return min(valid, key=lambda trial: trial.score)

    def _search(self, run: RunAll, stored: Trials, on_trial: Callable[[Trial], None]) -> None:
        import optuna

        def keep(options: dict[str, Any]) -> Trial:
            number = len(self.trials)
            trial = stored.replay(number, options)
            if trial is None:
                score, message = self._score(options, run)
                trial = Trial(number, options, score, self.error, message)
                stored.add(trial)
            else:
                self.error, self.scores[_key(options)] = trial.error, (trial.score, trial.message)
            self.trials.append(trial)
            on_trial(trial)
            return trial

        with _quiet(optuna.logging):
            space = {name: _distribution(domain, optuna.distributions) for name, domain in self.domains.items()}
            tuner = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=self.plan.seed, multivariate=True))
            default = keep(self.default)
            if not math.isnan(default.score) and all(_within(self.default[n], d) for n, d in self.domains.items()):
                known = optuna.trial.create_trial(params=self.default, distributions=space, value=default.score)
                tuner.add_trial(known)
            for _ in range(self.plan.trials):
                proposal = tuner.ask(space)
                trial = keep({name: _rounded(proposal.params[name], domain) for name, domain in self.domains.items()})
                if math.isnan(trial.score):
                    tuner.tell(proposal, state=optuna.trial.TrialState.FAIL)
                else:
                    tuner.tell(proposal, trial.score)

    def _score(self, options: dict[str, Any], run: RunAll) -> tuple[float, str]:
        """A setting's score on the training scenes, and the reason if it has none."""
        if (key := _key(options)) not in self.scores:
            errors = ErrorCollector()
            solver = self._solver(options, errors)
            if solver is None:
                return math.nan, _line("; ".join(errors.texts))
            records = run(self._specs(solver, range(self.first, self.first + self.plan.training)))
            if not self.scores and any(_miscounted(record) for record in records):
                self.error = "gospa_m"
            self.scores[key] = self._mean_log(records)
        return self.scores[key]

    def _solver(self, options: dict[str, Any], errors: ErrorCollector) -> PluginSpec | None:
        """The solver with these options. If they are invalid, add the errors to ``errors`` and return None."""
        table = {"kind": self.plan.solver, **self.plan.options, **options}
        resolved = Resolver(self.registry, errors).resolve("solver", table, self.plan.solver)
        return resolved.spec if resolved else None

    def _mean_log(self, records: list[RunRecord]) -> tuple[float, str]:
        """The mean of log10 of the runs' errors, and the reason if there is none."""
        for record in records:
            if record.status is not Status.OK:
                return math.nan, _line(f"{record.status}: {record.message}")
        errors = self._errors(records)
        if np.isnan(errors).any():
            return math.nan, f"a run has no {self.error}"
        return float(np.log10(errors).mean()), ""

    def _errors(self, records: list[RunRecord]) -> Float[ndarray, " runs"]:
        """The error of each run; NaN if it has none."""
        ok = [record.scores.get(self.error, math.nan) if record.status is Status.OK else math.nan for record in records]
        return np.maximum(ok, FLOOR)

    def _specs(self, solver: PluginSpec, repetitions: range) -> list[RunSpec]:
        study = replace(self.study, methods=(replace(self.method, solver=solver),), runs_per_scene=1)
        points = len(study.points)
        return [study.spec(repetition * points + point) for repetition in repetitions for point in range(points)]

    def _compare(self, run: RunAll) -> tuple[pd.DataFrame, str]:
        """Compare the default and the best setting on the held-out scenes."""
        rows, errors = [], {}
        for name, options in (("default", self.default), ("tuned", self._best().options)):
            solver = self._solver(options, ErrorCollector())
            assert solver is not None  # it has run on the training scenes
            records = run(self._specs(solver, range(self.plan.held_out)))
            errors[name] = self._errors(records)
            rows += [
                {
                    "method": name,
                    "status": record.status,
                    "evaluations": float(record.evaluations),
                    "runtime_s": record.runtime_s,
                    **record.scores,
                }
                for record in records
            ]
        frame = summarize(pd.DataFrame(rows), ["method"], error=self.error, outlier_m=self.study.outlier_m)
        by_point = (error.reshape(self.plan.held_out, -1).T for error in (errors["default"], errors["tuned"]))
        return frame, tuning_verdict(*by_point)


def _method(study: Study, plan: Plan) -> Method:
    """The formulation to tune for, with its budget."""
    usable = {method.formulation.label: method for method in reversed(study.methods) if method.solver}
    if not usable:
        raise NfbenchError(f"study {study.name} has no formulation that needs a solver")
    first = next(method.formulation.label for method in study.methods if method.solver)
    label = first if plan.formulation is None else plan.formulation
    if label not in usable:
        raise NfbenchError(f"--formulation: study {study.name} has no {label!r} with a solver{suggest(label, usable)}")
    method = usable[label]
    if plan.evaluations is None:
        return method
    target = (method.budget or {}).get("target")
    return replace(method, budget=canonical(Budget(evaluations=plan.evaluations, target=target)))


def _key(options: dict[str, Any]) -> str:
    return json.dumps(options, sort_keys=True)


def _line(text: str) -> str:
    """The text in one line, so that each row of ``trials.csv`` is one line."""
    return " ".join(text.split())


def _miscounted(record: RunRecord) -> bool:
    return record.scores.get("sources_found") != record.scores.get("sources")


def _distribution(domain: Domain, distributions: Any) -> Any:
    if not isinstance(domain, Tune):
        return distributions.CategoricalDistribution(domain)
    whole = isinstance(domain.low, int)
    kind = distributions.IntDistribution if whole else distributions.FloatDistribution
    return kind(domain.low, domain.high, log=domain.log)


def _within(value: Any, domain: Domain) -> bool:
    if not isinstance(domain, Tune):
        return value in domain
    return value is not None and domain.low <= value <= domain.high


def _rounded(value: Any, domain: Domain) -> Any:
    """A value as it is tried and stored: a float with few digits, within its range."""
    if not isinstance(domain, Tune) or isinstance(value, int):
        return value
    return min(max(float(f"{value:.{DIGITS}g}"), domain.low), domain.high)


@contextlib.contextmanager
def _quiet(logging: Any) -> Iterator[None]:
    """Silence Optuna in this context; it prints a message for every trial."""
    level = logging.get_verbosity()
    logging.set_verbosity(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Optuna warns that multivariate TPE is experimental
            yield
    finally:
        logging.set_verbosity(level)


def _toml(found: Tuning) -> str:
    """The text of ``tuned.toml``: a ``[[solver]]`` table to paste into a manifest, and comments on its origin."""
    plan, budget = found.plan, found.method.budget or {}
    spent = " and ".join(f"{value:g} {name}" for name, value in budget.items() if value is not None)
    settings = {name: value for name, value in {**plan.options, **found.best.options}.items() if value is not None}
    lines = [
        f"# {plan.solver} tuned for study {found.study.name}, formulation {found.method.formulation.label}, {spent}:",
        f"# {len(found.trials) - 1} trials on {plan.training} training scenes per point, seed {plan.seed}.",
        f"# {found.verdict}".replace("\u00a0", " "),
        "[[solver]]",
        f"kind = {_value(plan.solver)}",
        f"label = {_value(plan.solver + ' tuned')}",
        *(f"{name} = {_value(value)}" for name, value in settings.items()),
    ]
    return "\n".join(lines) + "\n"


def _value(value: Any) -> str:
    """A value in TOML."""
    if isinstance(value, Mapping):
        inside = ", ".join(f"{json.dumps(name)} = {_value(item)}" for name, item in value.items())
        return f"{{ {inside} }}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_value, value))}]"
    if isinstance(value, float):
        return repr(value)  # inf and nan are valid TOML
    return json.dumps(value, ensure_ascii=False)
