"""The page recommends what `nfbench choose` recommends, and names axes as the manifest does."""

import itertools
import math
import shutil

import pytest
from small_study import Page, run_in

import nfbench
from nfbench.report import html_report
from nfbench.report.html.choices import choices
from nfbench.report.html.study import Study
from nfbench.results import overviews

LABELS = """
[labels]
snr_db = "Rapport signal/bruit [dB]"
rmse = "Erreur de position [m]"
median = "Erreur médiane <b> [m]"
runtime = "Durée [s]"
"""


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """The folder of the small study."""
    return run_in(tmp_path_factory.mktemp("small"))


@pytest.fixture(scope="module")
def study(results):
    """The study that the page shows."""
    return Study(results, results.evidence())


@pytest.fixture(scope="module")
def named(results, tmp_path_factory):
    """The page of a copy of the folder whose manifest has labels."""
    copy = tmp_path_factory.mktemp("named") / "out"
    shutil.copytree(results.folder, copy)
    manifest = copy / "manifest.toml"
    manifest.write_text(manifest.read_text(encoding="utf-8") + LABELS, encoding="utf-8")
    return Page(html_report(nfbench.Results(copy)))


def row_of(choice):
    row = choice.frame.iloc[0]
    return row["setting"], row["verdict"], row["share"]


def test_each_target_has_the_answer_of_choose(results, study):
    shown = choices(study)
    assert [each["target"] for each in shown] == [target.label for target in results.targets]
    for each in shown:
        found = nfbench.choose(results, target=each["target"], reliability=0.95)
        text = [each["first"], *each["more"]]
        assert [
            sentence.replace("SNR = 0 dB", "snr_db = 0").replace("SNR = 20 dB", "snr_db = 20") for sentence in text
        ] == [*found.sentences]
        assert [line["method"] for line in each["methods"]] == found.frame["setting"].tolist()
        assert each["command"].startswith("nfbench choose results/small --target ")


def test_each_limit_and_each_point_has_the_answer_of_choose(results):
    evidence = results.evidence()
    for target, found in zip(results.targets, overviews(evidence, 0.5), strict=True):
        assert len(found.ladder) and found.choice.unit == "evaluations"
        for row in found.ladder.to_dict("records"):
            alone = nfbench.choose(results, target=target, reliability=0.5, evaluations=row["limit"])
            assert row_of(alone) == (row["setting"], row["verdict"], row["share"])
        limits = found.ladder["limit"].tolist()
        assert limits == sorted(limits) and limits[-1] <= 400
        assert found.places["place"].tolist() == ["snr_db = 0", "snr_db = 20"]
        for snr_db, row in zip((0, 20), found.places.to_dict("records"), strict=True):
            alone = nfbench.choose(results, target=target, reliability=0.5, at={"snr_db": snr_db})
            assert row_of(alone) == (row["setting"], row["verdict"], row["share"])


def test_neighbouring_limits_have_different_answers(results):
    for found in overviews(results.evidence(), 0.5):
        rows = found.ladder[["setting", "verdict", "share"]].to_numpy().tolist()
        assert all(row != after for row, after in itertools.pairwise(rows))
        assert rows[-1] == [*row_of(found.choice)]


def test_the_page_says_what_choose_says(results):
    page = Page(html_report(results))
    found = nfbench.choose(results)
    first = found.sentences[0].replace("snr_db = 0", "SNR = 0 dB").replace("snr_db = 20", "SNR = 20 dB")
    assert " ".join(first.split()) in page.text
    assert "To reach error ≤ 3 bounds in 95 % of the scenes" in page.text
    assert "nfbench choose results/small --target 'error ≤ 3 bounds'" in page.text


def test_axes_and_tables_have_the_labels_of_the_manifest(named):
    data = named.data
    assert [axis["name"] for axis in data["axes"]] == ["Rapport signal/bruit [dB]"]
    assert data["points"] == ["Rapport signal/bruit = 0 dB", "Rapport signal/bruit = 20 dB"]
    names = [measure["name"] for measure in data["measures"]]
    assert {"Erreur de position [m]", "Erreur médiane <b> [m]", "Durée [s]"} <= {*names}
    assert not {"RMSE [m]", "Median error [m]", "Time per run [s]"} & {*names}
    bounded = [measure["name"] for measure in data["measures"] if measure["bounded"]]
    assert bounded == ["Erreur de position [m]"]
    for text in ("Durée [s]", "Erreur médiane <b> [m]", "swept: snr_db 0, 20 (Rapport signal/bruit [dB])"):
        assert text in named.text
    assert "b" not in named.tags and "snr_db = 0:" not in named.text
    assert "Rapport signal/bruit = 0 dB" in named.text  # of the recommendation at this point alone


def test_the_scale_of_an_axis_is_that_of_the_figures(study):
    axis = study.axes[0]
    assert (axis["values"], axis["log"]) == ([0, 20], False)


def test_without_targets_nothing_is_recommended(study, monkeypatch):
    monkeypatch.setattr(type(study.evidence), "targets", ())
    assert choices(Study(study.results, study.results.evidence())) == []


def test_a_share_is_never_shown_without_a_number():
    from nfbench.report.html.choices import _step

    empty = {"setting": "", "verdict": "does not", "share": math.nan, "budget": math.nan}
    assert _step(empty, "s") == {"method": "", "verdict": "no", "share": "–", "needed": "–"}
