"""The page says what the tables say, loads nothing from elsewhere, stays small, and shows any text literally."""

import json
import math

import numpy as np
import pytest
from conftest import BASIC
from conftest import nfbench as command
from small_study import Page, external, run_in

import nfbench
from nfbench import NfbenchError, Status, StoreError, load_study
from nfbench.core import printable
from nfbench.problems.near_field.instance import NearFieldInstance
from nfbench.report import html_report, write_html
from nfbench.report.html.study import numbers
from nfbench.results import Store
from nfbench.study import RunRecord

HOSTILE = [
    "</script><script>alert(1)</script>",
    "<!--<script>",
    '"><img src=x onerror=alert(1)>',
    "' onload='alert(1)",
    "{{ 7 * 7 }}{% raw %}",
    "]]>&lt;b&gt;&amp;",
    "a\x1b[2J\x07\u202eb\u2028c",
    "<a href=https://example.org/>x</a>",
]


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """The folder of the small study."""
    return run_in(tmp_path_factory.mktemp("small"))


@pytest.fixture(scope="module")
def text(results):
    """The page as text."""
    return html_report(results)


@pytest.fixture(scope="module")
def page(text):
    """The page, parsed."""
    return Page(text)


def close(shown, value):
    return shown == pytest.approx(value, rel=1e-3)


def test_the_page_answers_the_five_questions(page, results):
    ranking = results.ranking()
    best = ranking.frame[ranking.frame["scenario.snr_db"].astype(str) == "all"]
    best = best[best["in_best_set"].astype(bool)]["method"].tolist()
    assert f"Use {best[0]}: it reached error ≤ 3 bounds in " in page.text
    assert "On 14 scenes, " in page.text
    assert f"{best[0]} misses error ≤ 3 bounds in " in page.text
    assert "nfbench run manifest.toml --out results/small" in page.text
    assert "Expected before the study: DE beats random search" in page.text
    assert "2 methods · 2 swept points · 14 scenes · 56 runs" in page.text


def test_the_scenes_that_the_recommended_method_misses_are_listed(page, results):
    best = page.data["methods"][page.data["tables"][0]["rows"][0]["method"]]
    hits = results.hits()
    missed = hits[(hits["method"] == best) & (hits["number"] == 0) & ~hits["hit"]]
    if len(missed):
        assert f"in {len(missed)} of 28 cases (14 scenes at each of 2 swept points)" in page.text
        at = missed.groupby("scenario.snr_db").size()
        assert f"{at.get(0, 0)} of 14 at 0, {at.get(20, 0)} of 14 at 20" in page.text
        scene, count = missed["scene"].iloc[0], (missed["scene"] == missed["scene"].iloc[0]).sum()
        assert f"{scene} ({count})" in page.text
    else:
        assert "reaches error ≤ 3 bounds in all 14 scenes at each of 2 swept points" in page.text


def test_what_the_formulations_and_solvers_are_is_said(page):
    assert "Near-field eigen-subspace fitting: minimizes ESF once over all sources" in page.text
    assert "Differential evolution with synchronous generations" in page.text and "Storn & Price 1997" in page.text
    assert "Residual least squares: the energy of the received data" in page.data["landscapes"][0]["about"]


def test_how_to_install_what_was_used_is_said(page, results):
    versions = json.loads((results.folder / "environment.json").read_text())["versions"]
    assert f"numpy=={versions['numpy']}" in page.text and "pip install -e '.'" in page.text


def test_claims_have_their_verdict_and_numbers(page, results):
    claim = results.claims().iloc[0]
    assert claim["text"] in page.text
    assert f"{claim['verdict']} error: better ÷ worse, below 1 {float(f'{claim.estimate:.3g}'):.6g}" in page.text


def test_the_measures_are_those_of_the_tables(page, results):
    data, summary, targets = page.data, results.summary(), results.target_table()
    assert data["points"] == ["SNR = 0 dB", "SNR = 20 dB"]
    by_name = {measure["name"]: measure for measure in data["measures"]}
    at = {0: 0, 20: 1}
    for row in summary.to_dict("records"):
        method, point = data["methods"].index(row["method"]), at[row["scenario.snr_db"]]
        measure = by_name["Median error [m]"]
        assert close(measure["value"][method][point], row["median_m"])
        assert close(measure["low"][method][point], row["median_m_low"])
        assert close(by_name["RMSE [m]"]["value"][method][point], row["rmse_m"])
        assert close(by_name["Evaluations per run"]["value"][method][point], row["evaluations"])
        assert close(data["bound"][point], row["crb_m"])
    for row in targets.to_dict("records"):
        method, point = data["methods"].index(row["method"]), at[row["scenario.snr_db"]]
        assert close(by_name[f"Runs that reach {row['target']} [%]"]["value"][method][point], 100 * row["share"])
        found = by_name[f"Evaluations per hit of {row['target']} (ERT)"]["value"][method][point]
        assert found == "inf" if math.isinf(row["ert"]) else close(found, row["ert"])


def test_the_curves_end_at_the_shares_of_the_table(page, results):
    for row in results.target_table().to_dict("records"):
        point = int(row["scenario.snr_db"] == 20)
        target, method = page.data["targets"].index(row["target"]), page.data["methods"].index(row["method"])
        costs, shares = page.data["distributions"]["evaluations"][target][point][str(method)]
        assert shares[-1] == pytest.approx(1000 * row["share"], abs=1)
        assert len(costs) == len(shares) and costs == sorted(costs)


def test_the_table_of_methods_is_that_of_the_ranking(page, results):
    frame = results.ranking().frame
    first = page.data["tables"][0]
    assert (first["point"], first["n"], first["target"]) == (-1, 14, "error ≤ 3 bounds")
    rows = frame[frame["scenario.snr_db"].astype(str) == "all"].set_index("method")
    for line in first["rows"]:
        row = rows.loc[page.data["methods"][line["method"]]]
        assert close(line["solved_share"], row["solved_share"])
        assert line["best"] == bool(row["in_best_set"])


def test_scenes_have_their_errors_truth_estimates_and_traces(page, results):
    runs, positions = results.runs, results.positions
    table = page.data["scenes"][1]
    assert sorted(table["scenes"]) == list(range(14))
    assert table["share"] == sorted(table["share"])
    at = runs[runs["scenario.snr_db"] == 20].set_index(["method", "scene"])
    method = table["methods"].index(page.data["methods"].index("neef + de"))
    for place, scene in enumerate(table["scenes"]):
        assert table["error"][method][place] == pytest.approx(at.loc[("neef + de", scene), "rmse_m"], rel=6e-3)
    row = positions[(positions["scenario.snr_db"] == 20) & (positions["scene"] == 2)].iloc[0]
    shown = page.data["places"]["1"]["2"]
    assert shown["truth"][0] == pytest.approx([row["true_x_m"], row["true_y_m"], row["true_z_m"]], rel=1e-3, abs=1e-9)
    evaluations, errors = page.data["traces"]["error"]["1"]["2"][str(page.data["methods"].index("neef + de"))]
    assert errors[-1] == pytest.approx(at.loc[("neef + de", 2), "rmse_m"], rel=6e-3)
    assert len(evaluations) <= 14 and evaluations[-1] <= 400


def test_the_progress_of_the_gap_ends_at_the_final_gap(page, results):
    table = results.evidence().table
    own = table[(table["method"] == "neef + de") & (table["scenario.snr_db"] == 20)]
    curve = page.data["progress"]["gap"][1]
    median, _, _ = curve["m"][str(page.data["methods"].index("neef + de"))]
    assert curve["x"][-1] == 400
    assert median[-1] == pytest.approx(own["gap"].median(), rel=1e-3)


def test_a_landscape_is_a_small_picture_of_a_cut_with_the_true_positions(page, results):
    landscapes = page.data["landscapes"]
    first = [each for each in landscapes if (each["point"], each["scene"]) == (0, 0)]
    assert [each["name"] for each in first] == ["RLS", "ESF", "MUSIC spectrum"]
    row = results.positions.query("scene == 0").iloc[0]
    azimuth = math.degrees(math.atan2(row["true_y_m"], row["true_x_m"]))
    for each in landscapes:
        assert each["png"].startswith("iVBOR") and len(each["png"]) < 40_000
        assert each["axes"] == ["Azimuth [°]", "Range [m]"] and each["box"] == [-50, 50, 0.05, 0.2]
    for each in first:
        assert each["marks"][0] == pytest.approx([azimuth, math.hypot(row["true_x_m"], row["true_y_m"])], rel=1e-3)
    clear = [each for each in landscapes if each["point"] == 1 and each["name"] == "ESF"]
    assert clear and all(each["lowest"][0] == pytest.approx(each["marks"][0][0], abs=5) for each in clear)


def test_without_cuts_a_landscape_is_that_of_the_first_problem(monkeypatch, results):
    monkeypatch.setattr(NearFieldInstance, "cuts", lambda self: ())
    first = Page(html_report(results)).data["landscapes"][0]
    assert (first["name"], first["point"], first["scene"], first["unknowns"]) == ("neef", 0, 0, 2)
    assert first["marks"] == [] and first["axes"] == ["unknown 1", "unknown 2"]
    low, high = first["box"][:2]
    assert low <= first["lowest"][0] <= high


def test_nothing_is_loaded_from_elsewhere(text, page):
    assert external(text) == []
    assert external('<img src="https://example.org/x.png"><style>@import "//x.org/a.css"</style>') != []
    assert {value[:1] for _, value in page.references} <= {"#", "d"}  # anchors and data:
    assert "default-src 'none'" in text
    assert "link" not in page.tags or text.count("<link") == 1


def test_the_page_is_small(text):
    assert len(text.encode()) < 300_000


def test_without_a_manifest_the_page_says_why_there_is_no_picture(results, tmp_path):
    copy = tmp_path / "copy"
    copy.mkdir()
    (copy / "runs.sqlite").write_bytes((results.folder / "runs.sqlite").read_bytes())
    page = Page(html_report(nfbench.Results(copy)))
    assert "The scene cannot be drawn: the scenes cannot be redrawn" in page.text
    assert page.data["landscapes"] == [] and page.data["elements"] is None
    assert page.data["places"]["1"]["2"]["truth"]  # stored, so it needs no scenario


def test_the_file_is_written_where_asked(results, tmp_path):
    assert write_html(results, tmp_path / "new" / "x.html").read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    assert write_html(results) == results.folder / "report.html"


def test_a_study_without_runs_has_no_page(tmp_path):
    with pytest.raises(StoreError):
        html_report(nfbench.Results(tmp_path))


def hostile(manifest, folder, text):
    """Results in which every text is this one, and a run per method has failed with it."""
    study = load_study(manifest(BASIC + "[sweep]\nnoise = [0.0, 0.5]\n", repetitions=8))
    folder.mkdir()
    (folder / "manifest.toml").write_text(f"# {json.dumps(text)}\n")
    (folder / "environment.json").write_text(
        json.dumps({"cpu": text, "versions": {text: text}, "git": {"commit": text}})
    )
    with Store(folder, write=True) as store:
        store.begin(study)
        store.add(
            RunRecord(spec.run_id, Status.OK if spec.repetition else Status.FAILED, text, scores={"rmse_m": 1.0})
            for spec in study.specs()
        )
        store._db.execute("UPDATE plan SET method = ?, formulation = ?", [text, text])
        store._db.execute("UPDATE plan SET swept = ? WHERE swept LIKE '%5%'", [json.dumps({"noise": text})])
        store._db.execute("UPDATE meta SET value = ? WHERE key IN ('title', 'expect', 'name')", [text])
        store._db.execute("DELETE FROM meta WHERE key = 'plan_rows'")
        store._db.commit()
    return nfbench.Results(folder)


@pytest.mark.parametrize("number", range(len(HOSTILE)))
def test_any_text_is_shown_literally(manifest, tmp_path, page, number):
    words = HOSTILE[number]
    found = html_report(hostile(manifest, tmp_path / "out", words))
    parsed = Page(found)
    assert parsed.tags.count("script") == page.tags.count("script")
    assert "img" not in parsed.tags and "b" not in parsed.tags
    assert not any(value and "example.org" in value for _, value in parsed.references)
    assert external(found) == []
    shown = printable(words)
    assert parsed.data["methods"] == [shown]
    assert " ".join(shown.split()) in parsed.text
    assert "\x1b" not in found and "\u202e" not in found and "\u2028" not in found


def test_failures_are_listed_by_kind_with_their_messages(manifest, tmp_path):
    page = Page(html_report(hostile(manifest, tmp_path / "out", "no luck")))
    assert "2 of 16 runs ended without an estimate" in page.text
    assert "failed 1 no luck no luck 0" in page.text or "failed 2 no luck no luck 0" in page.text


def test_numbers_fit_in_json():
    assert numbers([1.23456, math.nan, math.inf, -math.inf, 3.0, np.float64(1e300)]) == [
        1.235,
        None,
        "inf",
        "-inf",
        3,
        1e300,
    ]


def test_the_command_writes_the_page(results, tmp_path):
    done = command("report", results.folder, "--html", "--out", "page.html", cwd=tmp_path)
    assert (done.returncode, done.stdout.strip()) == (0, "page.html"), done.stderr
    assert "Two SNRs, one source" in (tmp_path / "page.html").read_text(encoding="utf-8")
    refused = command("report", results.folder, "--out", "page.html", cwd=tmp_path)
    assert refused.returncode == 2 and "--html" in refused.stderr


def test_errors_name_the_folder(tmp_path, manifest):
    study = load_study(manifest(BASIC))
    (tmp_path / "empty").mkdir()
    with Store(tmp_path / "empty", write=True) as store:
        store.begin(study)
    with pytest.raises(NfbenchError, match="empty: nothing to report: no run has finished yet"):
        html_report(nfbench.Results(tmp_path / "empty"))
