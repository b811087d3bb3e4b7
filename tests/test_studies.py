"""The studies of the project: each runs in a small version, its claims can be judged, and its committed tables hold."""

import csv
import functools
import re
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import nfbench
from nfbench.analysis import Outcomes, judge_claims
from nfbench.plugins.registry import Registry
from nfbench.results import cell
from nfbench.study import Claim, Study, claim_of, swept_column

PROJECT = Path(__file__).parent.parent
RESULTS = PROJECT / "results"
MANIFESTS = sorted((PROJECT / "studies" / "paper").glob("*.toml"))
REFUSED = {"rmse_snr_half": {"modified MUSIC 400×2000"}}  # methods that a study includes to show that they are refused
IMPAIRMENTS = sorted((PROJECT / "studies" / "impairments").glob("*.toml"))
ESTIMATORS = sorted((PROJECT / "studies" / "estimators").glob("*.toml"))
FOLDERS = ("paper/*", "impairments/*", "estimators/*", "learned/*", "*")
JUDGED = sorted(table for folder in FOLDERS for table in RESULTS.glob(f"{folder}/claims.csv"))
RELAXATION = PROJECT / "studies" / "relaxation.toml"
LEARNED = [PROJECT / "studies" / f"{name}.toml" for name in ("learned", "learned_channel", "learned_space")]
WITH_CLAIMS = [
    *MANIFESTS,
    *IMPAIRMENTS,
    *ESTIMATORS,
    *LEARNED,
    *(PROJECT / "studies" / f"{name}.toml" for name in ("optimizer_choice", "relaxation", "certified", "measured")),
]
DATA = PROJECT / ".." / "shared" / "data"  # of the studies of measured data
SCENES = 100


@functools.cache
def loaded(manifest: Path) -> Study:
    if manifest.stem != "measured":
        return nfbench.load_study(manifest)
    if not DATA.is_dir():
        pytest.skip(f"the measured data are not in {DATA}")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("NFBENCH_DATA", str(DATA))
        return nfbench.load_study(manifest)


def small(text: str) -> str:
    """The manifest with coarse grids and very few evaluations."""
    text = re.sub(r"(azimuth|elevation|range) = (\d+)", lambda side: f"{side[1]} = {int(side[2]) // 12}", text)
    return re.sub(r"evaluations = (\d+)", lambda budget: f"evaluations = {int(budget[1]) // 60}", text)


@pytest.mark.parametrize("end", [-1, pytest.param(0, marks=pytest.mark.slow)], ids=["last point", "first point"])
@pytest.mark.parametrize(
    "manifest", [*MANIFESTS, RELAXATION, *LEARNED, *IMPAIRMENTS, *ESTIMATORS], ids=lambda path: path.stem
)
def test_a_study_runs_from_end_to_end(manifest, tmp_path, end):
    path = tmp_path / manifest.name
    path.write_text(small(manifest.read_text(encoding="utf-8")), encoding="utf-8")
    study = nfbench.load_study(path)
    study = replace(study, scenes=1, points=[study.points[end]], claims=())  # the claims name other points, too
    results = nfbench.run(study, out=tmp_path / "out", jobs=0)
    runs = results.runs
    refused = runs["method"].map(lambda label: any(label.startswith(name[:14]) for name in REFUSED.get(study.name, ())))
    assert len(runs) == len(study)
    assert (runs["status"][refused] == "skipped").all()
    assert (runs["status"][~refused] == "ok").all()
    assert runs.loc[~refused, "rmse_m"].gt(0).all()
    assert runs[~refused].filter(["crb_m", "floor_m"]).notna().any(axis=1).all()


@pytest.mark.parametrize("manifest", WITH_CLAIMS, ids=lambda path: path.stem)
def test_the_claims_of_a_study_are_decided_by_outcomes_that_decide_them(manifest):
    """Outcomes at the study's own points, in which one claim clearly holds, confirm it; the opposite contradicts it."""
    study = loaded(manifest)
    assert study.claims
    for claim in map(claim_of, study.claims):
        for holds, verdict in ((True, "confirmed"), (False, "contradicted")):
            (found,) = judge_claims([claim], outcomes_where(study, claim, holds))["verdict"]
            assert found == verdict, claim.text


def outcomes_where(study: Study, claim: Claim, holds: bool) -> list[tuple[dict, Outcomes]]:
    """The outcomes of 100 scenes at every point of a study, in which one claim holds, or its opposite."""
    rng = np.random.default_rng(0)
    compare, methods = claim.compare, [method.label for method in study.methods]
    keys = [swept_column(key) for key in study.swept]
    values = {
        name: list(dict.fromkeys(str(p.swept[key]) for p in study.points))
        for name, key in zip(keys, study.swept, strict=True)
    }
    shape = (SCENES, len(methods))
    points = []
    for point in study.points:
        swept = {name: cell(point.swept[key]) for name, key in zip(keys, study.swept, strict=True)}
        place = values[compare.key].index(str(point.swept[compare.key.partition(".")[2]])) if compare.key else 0
        number = float(swept[compare.key]) if compare.kind == "exponent" else 1.0
        level = np.array([level_of(claim, method, place, number, holds) for method in methods])
        error = level * rng.lognormal(sigma=0.1, size=shape)
        hits = np.broadcast_to([hit_share(claim, method, holds) for method in methods], shape).astype(int)
        skipped = np.broadcast_to([holds and method == compare.runs for method in methods], shape).astype(int)
        outcomes = Outcomes(
            methods=tuple(methods),
            scenes=tuple(range(SCENES)),
            error=error,
            runs=np.ones(len(methods), dtype=int),
            hits=hits,
            cost=error,
            spent=error,
            cap=np.full(len(methods), np.inf),
            columns=dict.fromkeys(("seconds", "runtime_s", "gospa_m"), error),
            ended={"skipped": skipped, "ok": 1 - skipped},
        )
        points.append((swept, outcomes))
    return points


def level_of(claim: Claim, method: str, place: int, number: float, holds: bool) -> float:
    """The typical value of a method at one value of the claim's key: its number in the sweep, or the number itself."""
    compare, kind = claim.compare, claim.compare.kind
    if kind == "better":
        lower = method in named(compare.better)
        return (0.01 if holds else 100.0) if lower else 1.0
    if kind == "equal":
        return 3.0 if method == compare.equal[0] and not holds else 1.0
    if kind in ("grows", "falls"):
        return 2.0 ** (place if (kind == "grows") == holds else -place)
    if kind == "changes" and compare.at_most is not None:
        return 0.01**place if holds else 10.0**place
    if kind in ("changes", "floor"):
        rises = (compare.at_most is None) == holds
        return 10.0**place if rises and kind == "changes" else 1.0 if rises or kind == "changes" else 0.1**place
    if kind == "degrades":
        return {compare.degrades[1]: 4.0 if holds else 1.0, compare.more_than[1]: 2.0}.get(method, 1.0)
    if kind == "exponent":
        return number ** ((compare.at_least + compare.at_most) / 2 if holds else 5.0)
    return 1.0


def hit_share(claim: Claim, method: str, holds: bool) -> bool:
    """Whether a method hits the target in every scene, or in none."""
    compare = claim.compare
    if compare.kind == "fails":
        return (compare.at_least is None) == holds
    return (method in named(compare.better)) == holds


def named(names: str | tuple[str, ...]) -> tuple[str, ...]:
    return (names,) if isinstance(names, str) else names


def test_the_papers_claims_are_stated():
    """22 claims of the paper: one takes two comparisons, and one stands there in a weaker form, too."""
    count = {path.stem: len(loaded(path).claims) for path in MANIFESTS}
    assert len(MANIFESTS) == 16
    assert all(count.values())
    ours = ("line_of_sight", "nlos_severity", "wavefront_mismatch")  # studies that the paper does not have
    assert sum(number for name, number in count.items() if name not in ours) == 24


def test_each_part_of_the_papers_evaluation_has_a_study_and_results():
    page = (RESULTS / "paper" / "README.md").read_text(encoding="utf-8")
    for name in (path.stem for path in MANIFESTS):
        folder = RESULTS / "paper" / name
        assert (folder / "summary.csv").exists() and any(folder.glob("*.svg"))
        assert all((folder / f"{table}.csv").exists() for table in ("targets", "ranking", "claims"))
        assert f"{name}/" in page


@pytest.mark.parametrize("table", JUDGED, ids=lambda path: path.parent.name)
def test_the_committed_verdicts_are_on_the_claims_of_the_manifest_and_in_the_page(table):
    (manifest,) = (PROJECT / "studies").rglob(f"{table.parent.name}.toml")
    study = loaded(manifest)
    with table.open(encoding="utf-8", newline="") as file:
        judged = list(csv.DictReader(file))
    assert [row["text"] for row in judged] == [claim["text"] for claim in study.claims]
    assert {int(row["scenes"]) for row in judged} == {study.scenes}
    page = next(folder / "README.md" for folder in table.parents if (folder / "README.md").exists())
    text = page.read_text(encoding="utf-8")
    for row in judged:
        assert re.search(rf"^\| {re.escape(row['text'])} \| \*\*{row['verdict']}\*\*", text, flags=re.MULTILINE)


def test_each_impairment_has_a_study_and_results():
    page = (RESULTS / "impairments" / "README.md").read_text(encoding="utf-8")
    assert len(IMPAIRMENTS) == 10
    for path in IMPAIRMENTS:
        summary = pd.read_csv(RESULTS / "impairments" / path.stem / "summary.csv")
        assert set(summary["method"]) == {method.label for method in loaded(path).methods}
        assert f"studies/impairments/{path.name}" in page


def test_every_estimator_is_in_the_studies_of_all_estimators():
    """Each formulation that needs no solver, alone and as the start of a fit where the array allows it."""
    kinds = {
        name for name in Registry().names("formulation") if not Registry().make("formulation", name, {}).needs_solver
    }
    studied = [tomllib.loads(path.read_text(encoding="utf-8"))["method"] for path in ESTIMATORS]
    found = {formulation_kind(method["formulation"]) for methods in studied for method in methods}
    assert len(ESTIMATORS) == 8
    assert kinds <= found


def formulation_kind(table: str | dict) -> str:
    return table if isinstance(table, str) else table["kind"]


def test_estimators_that_know_an_impairment_come_near_the_bound():
    """Each impairment that can be known, at its greatest size, by the method that knows it."""
    for path in IMPAIRMENTS:
        summary = pd.read_csv(RESULTS / "impairments" / path.stem / "summary.csv")
        known = summary[summary["method"].str.match("grid-refine.*, (known|spherical model)")]
        key = next(name for name in summary if name.startswith("scenario."))
        most = known[known[key] == summary[key].iloc[-1]]
        assert (path.stem in ("correlated_sources", "wideband")) == most.empty
        assert (most["median_error_in_bounds"] < 2).all(), path.stem


def test_the_error_of_grid_refine_falls_at_every_step_of_the_snr():
    """The scenes are the same at every SNR, so chance does not bend the curves."""
    summary = pd.read_csv(RESULTS / "paper" / "line_of_sight" / "summary.csv")
    rows = summary[summary["method"] == "grid-refine"].sort_values("scenario.snr_db")
    assert list(rows["scenario.snr_db"]) == [0, 5, 10, 15, 20, 25, 30]
    assert (np.diff(rows["rmse_m"]) < 0).all()
    assert (np.diff(rows["median_m"]) < 0).all()
