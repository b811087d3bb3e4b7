"""Every study of the paper runs in a small version, and the committed ledger follows from the committed tables."""

import re
import sys
from dataclasses import replace
from pathlib import Path

import pytest

import nfbench

PROJECT = Path(__file__).parent.parent
MANIFESTS = sorted((PROJECT / "studies" / "paper").glob("*.toml"))
REFUSED = {"rmse_snr_half": {"modified MUSIC 400×2000"}}  # methods that a study includes to show that they are refused


def small(text: str) -> str:
    """The manifest with coarse grids and very few evaluations."""
    text = re.sub(r"(azimuth|elevation|range) = (\d+)", lambda side: f"{side[1]} = {int(side[2]) // 12}", text)
    return re.sub(r"evaluations = (\d+)", lambda budget: f"evaluations = {int(budget[1]) // 60}", text)


@pytest.mark.parametrize("manifest", MANIFESTS, ids=lambda path: path.stem)
def test_a_study_of_the_paper_runs_from_end_to_end(manifest, tmp_path):
    path = tmp_path / manifest.name
    path.write_text(small(manifest.read_text(encoding="utf-8")), encoding="utf-8")
    study = nfbench.load_study(path)
    study = replace(study, repetitions=1, points=study.points[:: max(len(study.points) - 1, 1)])
    results = nfbench.run(study, out=tmp_path / "out", jobs=0)
    runs = results.runs
    refused = runs["method"].map(lambda label: any(label.startswith(name[:14]) for name in REFUSED.get(study.name, ())))
    assert len(runs) == len(study)
    assert (runs["status"][refused] == "skipped").all()
    assert (runs["status"][~refused] == "ok").all()
    assert runs.loc[~refused, "rmse_m"].gt(0).all()
    assert runs[~refused].filter(["crb_m", "floor_m"]).notna().any(axis=1).all()


def test_each_part_of_the_papers_evaluation_has_a_study_and_results():
    names = {path.stem for path in MANIFESTS}
    assert len(names) == 16
    for name in names:
        folder = PROJECT / "results" / "paper" / name
        assert (folder / "summary.csv").exists() and (folder / "errors.csv").exists() and any(folder.glob("*.svg"))
        assert f"{name}/" in (PROJECT / "results" / "paper" / "README.md").read_text(encoding="utf-8")


def test_the_ledger_follows_from_the_committed_tables(monkeypatch):
    monkeypatch.syspath_prepend(PROJECT / "results" / "paper")
    sys.modules.pop("ledger", None)
    import ledger

    judged = ledger.claims()
    text = (PROJECT / "results" / "paper" / "README.md").read_text(encoding="utf-8")
    written = text.split(ledger.BEGIN)[1].split(ledger.END)[0].strip()
    assert verdicts(written) == verdicts(ledger.page(judged))
    assert {claim.verdict for claim in judged} <= {"confirmed", "refuted", "undecided"}
    assert ledger.below(0.5, 0.9) is True and ledger.below(0.9, 1.1) is None and ledger.below(1.1, 1.2) is False
    assert ledger.alike(0.9, 1.1) is True and ledger.alike(1.3, 1.5) is False and ledger.alike(1.1, 1.5) is None


def verdicts(page: str) -> list[tuple[str, str]]:
    return re.findall(r"^\| \d+ \| ([^|]+) \|[^|]+\| \*\*(\w+)\*\*", page, flags=re.MULTILINE)
