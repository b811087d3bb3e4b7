"""Tests of the forecast: it counts the runs of each method at their own speed, and waits until it knows enough."""

import math
from dataclasses import replace

import pytest
from conftest import BASIC

from nfbench import Status, load_study
from nfbench.cli.forecast import ENOUGH_S, Forecast, rough_duration
from nfbench.study import RunRecord


@pytest.fixture
def study(manifest):
    return load_study(manifest(BASIC + '[[solver]]\nkind = "sampler"\nbatch = 4\n', repetitions=100))


def finished(forecast, study, seconds, scenes):
    """Add the runs of the first scenes, with these seconds by method."""
    for spec in study.specs():
        if spec.scene < scenes and spec.method.label in seconds:
            record = RunRecord(spec.run_id, Status.OK, runtime_s=seconds[spec.method.label])
            forecast.add(spec, record)


def test_the_time_left_is_that_of_the_runs_left_of_each_method(study):
    labels = [method.label for method in study.methods]
    forecast = Forecast(study)
    start = forecast._start
    assert math.isnan(forecast.left_s(start + 1))
    finished(forecast, study, dict.fromkeys(labels[1:], 1.0) | {labels[0]: 9.0}, 10)
    spent = 10 * (9 + len(labels) - 1)
    assert forecast.left_s(start + spent) == pytest.approx(9 * spent)
    assert forecast.left_s(start + spent / 2) == pytest.approx(9 * spent / 2), "two workers take half the time"


def test_a_resumed_study_has_only_the_rest_to_do(study):
    labels = [method.label for method in study.methods]
    forecast = Forecast(study)
    forecast.begin(len(study) // 2)
    finished(forecast, study, dict.fromkeys(labels, 1.0), 10)
    assert forecast.left_s(forecast._start + 30.0) == pytest.approx(30.0 * 4)


def test_the_sentence_comes_once_when_every_method_is_known_and_only_for_long_studies(study):
    labels = [method.label for method in study.methods]
    forecast = Forecast(study, " on 2 workers")
    finished(forecast, study, {labels[0]: 3.0}, 1)
    assert forecast.sentence(forecast._start + ENOUGH_S + 1) is None, "a method is unknown"
    finished(forecast, study, dict.fromkeys(labels[1:], 3.0), 1)
    assert forecast.sentence(forecast._start + ENOUGH_S - 1) is None, "it is too early"
    said = forecast.sentence(forecast._start + 36.0)  # for 2 of 200 runs
    assert said == "The study takes about 60 min on 2 workers, judging by its first 2 runs."
    assert forecast.sentence(forecast._start + 40.0) is None
    quick = Forecast(replace(study, scenes=3))
    finished(quick, study, dict.fromkeys(labels, 3.0), 1)
    assert quick.sentence(quick._start + 6.0) is None


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(8, "about 8 s"), (150, "about 2.5 min"), (7200, "about 2 h"), (40_000, "about 11 h"), (10**6, "about 12 days")],
)
def test_durations_are_rough(seconds, text):
    assert rough_duration(seconds) == text
