"""Tests that every manifest ends in a study or in a message, soon and without taking much memory."""

import contextlib
import json
import os
import re
import subprocess
import sys
import threading
import time
import tracemalloc
from dataclasses import fields, replace
from pathlib import Path

import pytest
from conftest import BASIC, COMMAND_ENVIRONMENT, nfbench
from hostile import MEGABYTES, REFUSED, SECONDS, VALID, with_

from nfbench import ManifestError, OptionError, PluginError, load_study
from nfbench.plugins import Registry


@pytest.fixture(scope="module")
def load(tmp_path_factory):
    """A function that loads the text of a manifest, or raises ManifestError."""
    path = tmp_path_factory.mktemp("hostile") / "study.toml"

    def load_text(text):
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return load_study(path)

    load_text(VALID)  # imports what every manifest needs
    return load_text


@pytest.mark.parametrize("name", REFUSED)
def test_a_manifest_is_refused_with_a_message_in_time(load, name):
    text, *parts = REFUSED[name]
    start = time.process_time()
    with pytest.raises(ManifestError) as caught:
        load(text)
    assert time.process_time() - start < SECONDS
    message = str(caught.value)
    for part in parts:
        assert part in message, message[:3000]
    assert len(message) < 120_000 and message.count("\n") <= 51
    assert all(character.isprintable() or character == "\n" for character in message)


@pytest.mark.parametrize(
    "name", ["20,000 wrong values", "20,000 swept keys", "2,000 nested brackets", "elements = 10^12"]
)
def test_a_refusal_takes_little_memory(load, name):
    tracemalloc.start()
    try:
        with pytest.raises(ManifestError):
            load(REFUSED[name][0])
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < MEGABYTES * 2**20 / 4


def test_all_errors_are_kept_and_the_first_50_shown(load):
    with pytest.raises(ManifestError) as caught:
        load(REFUSED["20,000 wrong values"][0])
    assert len(caught.value.problems) == 20_000
    shown = str(caught.value).splitlines()
    assert shown[50].strip() == "scenario.snr_db[49]: expected number, got 'x'"
    assert shown[51].strip() == "… and 19,950 more (the first 50 of 20,000 are shown)" and len(shown) == 52
    with pytest.raises(ManifestError) as caught:
        load(with_("snr_db = 20.0", f"snr_db = {['x'] * 50}"))
    assert "more" not in str(caught.value) and len(str(caught.value).splitlines()) == 51


ACCEPTED = {
    "a byte order mark": "\ufeff" + VALID,
    "carriage returns": VALID.replace("\n", "\r\n"),
    "a title of two lines": 'title = """a\nb"""\n' + VALID,
    "the largest seed": with_("seed = 1", "seed = 9223372036854775807"),
    "the largest budget": with_("evaluations = 100", "evaluations = 1_000_000_000_000_000\nseconds = 1e9"),
    "the largest scenario": with_("snapshots = 20", "snapshots = 6_250_000"),
    "many solvers": VALID + "".join(f"[[solver]]\nkind = 'de'\npopulation = {i + 60}\n" for i in range(990)),
    "many points": VALID + f"[sweep]\nsnr_db = {[i / 10 for i in range(300)]}",
    "brackets in texts and comments": "title = '" + "[" * 500 + "'\n# " + "{" * 500 + "\n" + VALID,
}


@pytest.mark.parametrize("name", ACCEPTED)
def test_an_unusual_manifest_is_accepted(load, name):
    assert len(load(ACCEPTED[name])) >= 2


@pytest.mark.parametrize(
    ("line", "name", "value"),
    [
        ("run_timeout_s = 1e7", "run_timeout_s", 1e7),
        ("run_timeout_s = 1e300", "run_timeout_s", None),
        ("run_timeout_s = inf", "run_timeout_s", None),
        ("run_memory_mb = 1_000_000", "run_memory_mb", 1_000_000),
        ("run_memory_mb = 10_000_000_000_000", "run_memory_mb", None),
        ("run_memory_mb = 9223372036854775807", "run_memory_mb", None),
    ],
)
def test_a_limit_larger_than_the_platform_takes_means_none(load, line, name, value):
    assert getattr(load(VALID + line).methods[0], name) == value


def test_a_study_never_has_more_runs_than_can_be_counted(load):
    study = load(VALID)
    for repetitions in (10**9, 10**19, 10**400):
        with pytest.raises(OptionError, match=r"scenes: expected at most 1,000,000,000 runs, got "):
            replace(study, scenes=2 * repetitions)
    assert len(replace(study, scenes=10**9)) == 10**9


def test_a_large_sweep_is_only_built_if_the_rest_is_valid(load, monkeypatch):
    from nfbench.study.sweep import Sweep

    built = []
    build = Sweep._build
    monkeypatch.setattr(Sweep, "_build", lambda self, *args: (built.append(1), build(self, *args)))
    sweep = f"[sweep]\nsnr_db = {[i / 100 for i in range(5000)]}"
    with pytest.raises(ManifestError, match="unknown solver"):
        load(VALID.replace('kind = "de"', 'kind = "ed"') + sweep)
    assert len(built) == 200
    assert len(load(VALID + sweep).points) == 5000


def test_errors_at_many_points_end_the_search_and_say_so(load):
    with pytest.raises(ManifestError) as caught:
        load(VALID + f"[sweep]\nsnr_db = {['x'] * 9000}")
    assert caught.value.problems[-1] == "sweep: the other 8,900 of 9,000 points are not checked"


def test_a_folder_is_refused_with_the_manifest_inside(tmp_path):
    with pytest.raises(ManifestError, match=r"got a folder; give the path of a \.toml file in it"):
        load_study(tmp_path)
    (tmp_path / "manifest.toml").write_text(VALID)
    with pytest.raises(ManifestError, match=re.escape(str(tmp_path / "manifest.toml"))):
        load_study(tmp_path)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
@pytest.mark.parametrize("writes", [False, True])
def test_a_pipe_is_refused_at_once(tmp_path, writes):
    path = tmp_path / "pipe.toml"
    os.mkfifo(path)

    def write():
        with contextlib.suppress(OSError):  # the reader leaves
            path.write_text(VALID)

    if writes:
        threading.Thread(target=write, daemon=True).start()
    with pytest.raises(ManifestError, match="expected a regular file, got a pipe or a device"):
        load_study(path)


@pytest.mark.parametrize("path", ["/dev/zero", "/dev/null", "no\0file", "a" * 5000, "no.toml", "x.toml/y"])
def test_a_path_that_is_no_file_is_refused(tmp_path, path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("x.toml").write_text(VALID)
    with pytest.raises(ManifestError, match=r"cannot be read|expected a regular file"):
        load_study(path)


def test_a_message_has_no_control_characters_of_the_path(tmp_path):
    with pytest.raises(ManifestError) as caught:
        load_study(tmp_path / "a\x1b[31m\n.toml")
    assert "\x1b" not in str(caught.value) and str(caught.value).count("\n") == 1


STRANGE = [
    *(float("nan"), float("inf"), float("-inf"), 1e308, -1e308, -1, 0, 2**31, 2**63, 10**400, True, None),
    *("", "x", "NA", "\x1b[31m", "/dev/zero", "a" * 5000, "\0", b"x", 1j, object(), {1: 2}, {"kind": ["de"]}),
    *([], {}, [[]], [float("nan")], [1, "x"], {"kind": "de"}, {"a": {"b": [1]}}, [1e308, -1e308], [object()]),
]  # fmt: skip


@pytest.mark.parametrize("kind", ["scenario", "formulation", "solver"])
def test_every_option_of_every_plugin_accepts_or_refuses_every_value(kind):
    """No other exception may come from an option, whatever it is given."""
    registry = Registry()
    deep = []
    for _ in range(3000):
        deep = [deep]
    given = {"near-field": load_near_field()}
    for name in registry.names(kind):
        for option in fields(registry.find(kind, name).resolve()):
            for value in [*STRANGE, deep]:
                try:
                    registry.make(kind, name, {**given.get(name, {}), option.name: value})
                except OptionError as error:
                    assert str(error).isprintable() and len(str(error)) < 20_000
                except PluginError as error:
                    assert "not installed here" in str(error), (name, option.name, value)


def load_near_field():
    import tomllib

    options = tomllib.loads(VALID)["scenario"]
    return {key: value for key, value in options.items() if key != "kind"}


def test_more_than_a_million_runs_need_yes(manifest, tmp_path):
    path = manifest(BASIC, repetitions=30_000_000)
    done = nfbench("run", path, cwd=tmp_path)
    assert done.returncode == 2 and not (tmp_path / "results").exists()
    assert "the study has 30,000,000 runs" in done.stderr and "Add --yes to start it" in done.stderr
    assert "7.77 GiB of disk for the bare rows, or 172 GiB with traces" in done.stderr
    assert "2.08 hours at 4,000 rows a second at best" in done.stderr
    done = nfbench("run", path, "--shard", "1/10", cwd=tmp_path)
    assert done.returncode == 2 and "of which this shard has about 3,000,000" in done.stderr


def test_yes_starts_a_large_study_and_a_million_runs_need_none(manifest, tmp_path, monkeypatch):
    from typer.testing import CliRunner

    import nfbench.execution
    from nfbench.cli.common import app

    started = []

    def run(study, **options):
        started.append(len(study))
        raise PluginError("stopped here")

    monkeypatch.setattr(nfbench.execution, "run", run)
    for repetitions, options in ((1_000_000, []), (1_000_001, []), (1_000_001, ["--yes"])):
        path = manifest(BASIC, repetitions=repetitions)
        CliRunner().invoke(app, ["run", str(path), "--out", str(tmp_path / "out"), *options])
    assert started == [1_000_000, 1_000_001]


def test_the_command_line_refuses_without_a_folder_or_a_traceback(tmp_path):
    path = tmp_path / "study.toml"
    path.write_text(REFUSED["repetitions = 10^19"][0])
    for argument, part in ((path, "got one of 64 bits"), (tmp_path, "got a folder"), ("/dev/zero", "a device")):
        done = nfbench("run", argument, cwd=tmp_path)
        assert done.returncode == 2 and part in done.stderr and "Traceback" not in done.stderr
    assert [file.name for file in tmp_path.iterdir()] == ["study.toml"]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_random_manifests_end_in_a_study_or_a_message(tmp_path, seed):
    """500 random manifests each, in a process that may not allocate more than 500 MB."""
    script = Path(__file__).with_name("hostile.py")
    done = subprocess.run(
        [sys.executable, "-W", "error", str(script), str(seed), "500", str(tmp_path)],
        capture_output=True,
        text=True,
        env={**COMMAND_ENVIRONMENT, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
        timeout=900,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    found, studies = json.loads(done.stdout)
    assert found == [] and 20 <= studies <= 480
