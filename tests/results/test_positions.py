"""The table of true and estimated positions is what the estimates are, is kept by merges and rescues, and old folders
without it are read."""

import json
import math
import sqlite3

import numpy as np
import pandas as pd
import pytest
from conftest import BASIC
from damage_kinds import overwritten, placed
from numpy.testing import assert_allclose

import nfbench
from nfbench import Instance, Status, StoreError, load_study
from nfbench.execution.storable import Unstorable, plain_positions
from nfbench.results import export_parquet, merge

STUDY = """
name = "placed"
scenes = 4
seed = 3
[scenario]
kind = "near-field"
array = { kind = "upa", columns = 5, rows = 5, spacing_wavelengths = 0.5, origin = "center" }
wavelength_m = 0.02
sources = 2
snapshots = 40
azimuth_deg = [-60, 60]
elevation_deg = [-30, 30]
range_m = [0.06, 0.3]
min_separation_deg = 15.0
[sweep]
snr_db = [20.0, 30.0]
[[formulation]]
kind = "grid-refine"
[[formulation]]
kind = "grid-refine"
label = "three"
sources = 3
[[formulation]]
kind = "grid-refine"
label = "one"
sources = 1
"""
COLUMNS = [
    *("run_id", "method", "scene", "run", "scenario.snr_db", "source", "true_x_m", "true_y_m", "true_z_m"),
    *("true_azimuth_deg", "true_elevation_deg", "true_range_m", "x_m", "y_m", "z_m"),
    *("azimuth_deg", "elevation_deg", "range_m", "error_m"),
]
XYZ = ["x_m", "y_m", "z_m"]


@pytest.fixture(scope="module")
def placed_study(tmp_path_factory):
    folder = tmp_path_factory.mktemp("positions")
    (folder / "study.toml").write_text(STUDY)
    return nfbench.run(load_study(folder / "study.toml"), out=folder / "out", jobs=0)


def test_the_table_has_one_row_per_source_and_surplus_estimate(placed_study):
    table = placed_study.positions
    assert list(table) == COLUMNS
    counts = table.groupby("method").size()
    assert counts.to_dict() == {"grid-refine": 16, "three": 24, "one": 16}
    for method, sources in (("grid-refine", [1, 2]), ("three", [1, 2, None]), ("one", [1, 2])):
        found = table[table.method == method].source.tolist()
        assert [None if number is pd.NA else number for number in found] == sources * 8
    assert (table[table.method == "one"].x_m.isna().groupby(table.run_id).sum() == 1).all()
    surplus = table[table.source.isna()]
    assert len(surplus) == 8 and surplus.true_x_m.isna().all() and surplus.x_m.notna().all()


def test_positions_agree_with_the_scores_and_the_estimates_of_their_runs(placed_study):
    table, runs = placed_study.positions, placed_study.runs.set_index("run_id")
    for run_id, rows in table.dropna(subset="source").groupby("run_id"):
        for row in rows.to_dict("records"):
            k, run = row["source"], runs.loc[run_id]
            assert_allclose(row["error_m"], run[f"error_{k}_m"], rtol=1e-9)
            assert_allclose(row["range_m"] - row["true_range_m"], run[f"range_error_{k}_m"], atol=1e-12)
            for name in ("azimuth", "elevation"):
                error = row[f"{name}_deg"] - row[f"true_{name}_deg"]
                assert_allclose(error, run[f"{name}_error_{k}_deg"], atol=1e-9)
    for run_id, estimate in placed_study.estimates():
        azimuth, elevation, r = np.array(estimate).T
        points = np.stack([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
        found = table[(table.run_id == run_id) & table.x_m.notna()][XYZ].to_numpy()
        assert_allclose(np.sort(found, axis=0), np.sort((r * points).T, axis=0), atol=1e-12)


TURNED = """
name = "turned"
seed = 1
scenes = 2
[scenario]
kind = "near-field"
array = { kind = "custom", origin = "center", positions = POSITIONS, broadside = "+z", up = "+y" }
wavelength_m = 0.3
sources = 2
snapshots = 40
snr_db = 20
azimuth_deg = [-60, 60]
elevation_deg = [-60, 60]
range_m = [0.2, 3]
positions_m = [[4.2, -6.9, 2.0], [3.7, -7.0, 1.8]]
[[formulation]]
kind = "grid-refine"
"""


@pytest.fixture(scope="module")
def turned_study(tmp_path_factory):
    """A study of an array in the x-y plane around (4, -7, 1) m that looks along z."""
    folder = tmp_path_factory.mktemp("turned")
    corners = np.random.default_rng(1).uniform(-0.5, 0.5, (12, 2))
    corners -= corners.mean(axis=0)
    positions = [[4 + x, -7 + y, 1.0] for x, y in corners.tolist()]
    (folder / "study.toml").write_text(TURNED.replace("POSITIONS", repr(positions)))
    return nfbench.run(load_study(folder / "study.toml"), out=folder / "out", jobs=0)


def test_positions_are_in_the_coordinates_of_the_array_and_angles_from_its_broadside(turned_study):
    table = turned_study.positions
    true = table[table.scene == 0][[f"true_{name}" for name in XYZ]].to_numpy()
    assert_allclose(true, [[4.2, -6.9, 2.0], [3.7, -7.0, 1.8]], atol=1e-12)
    assert_allclose(table[XYZ].to_numpy(), np.vstack([true, true]), atol=0.05)
    for prefix in ("true_", ""):
        right, up, front = table[[f"{prefix}{name}" for name in XYZ]].to_numpy().T - [[4], [-7], [1]]
        r = np.sqrt(right**2 + up**2 + front**2)
        assert_allclose(table[f"{prefix}range_m"], r, atol=1e-12)
        assert_allclose(table[f"{prefix}azimuth_deg"], np.degrees(np.arctan2(right, front)), atol=1e-9)
        assert_allclose(table[f"{prefix}elevation_deg"], np.degrees(np.arcsin(up / r)), atol=1e-9)
    runs = turned_study.runs.set_index("run_id")
    for row in table.to_dict("records"):
        assert_allclose(row["error_m"], runs.loc[row["run_id"], f"error_{row['source']}_m"], rtol=1e-9)


def test_the_figure_of_positions_uses_the_coordinates_of_the_array(turned_study):
    from nfbench.figures import Drawing, figures
    from nfbench.figures import positions as drawing

    for extents, views in (([1, 1, 0], [(0, 1)]), ([1, 1e-12, 2], [(0, 2)]), ([1, 1, 1], [(0, 1), (0, 2)])):
        assert drawing._views(np.array(extents)) == views
    ((_, figure),) = figures(turned_study, Drawing(only=("positions",)))
    front, above = [ax for ax in figure.axes if ax.get_visible()][::2]
    assert (front.get_ylabel(), above.get_xlabel(), above.get_ylabel()) == ("y [m]", "x [m]", "z [m]")
    elements, heights = front.lines[0].get_xydata(), above.lines[0].get_xydata()
    assert len(elements) == len(heights) == 12
    assert_allclose(elements.mean(axis=0), [4, -7], atol=1e-12)
    assert 0.5 < np.ptp(elements, axis=0).min() <= np.ptp(elements, axis=0).max() < 1
    assert_allclose(heights, np.column_stack([elements[:, 0], np.ones(12)]), atol=1e-12)
    for ax, truth in ((front, [4.2, -6.9]), (above, [4.2, 2.0])):
        (stars,) = [line for line in ax.lines if line.get_label() == "truth"]
        assert_allclose(stars.get_xydata(), [truth, truth], atol=1e-12)


def test_the_same_scene_has_the_same_sources_for_all_methods_and_swept_values(placed_study):
    table = placed_study.positions.dropna(subset="source")
    assert (table.groupby(["scene", "source"])[[f"true_{name}" for name in XYZ]].nunique() == 1).all(axis=None)
    assert table.groupby("scene").true_x_m.first().nunique() == 4


def test_the_file_has_the_same_rows(placed_study):
    read = pd.read_csv(placed_study.folder / "positions.csv", dtype={"source": "Int64"})
    pd.testing.assert_frame_equal(read, placed_study.positions, check_exact=False, rtol=1e-12)


def test_the_parquet_export_has_the_table(placed_study, tmp_path):
    pytest.importorskip("pyarrow", reason="the extra parquet")
    with pytest.raises(nfbench.NfbenchError, match="no finished run can be exported"):  # no solver, so no traces
        export_parquet(placed_study, tmp_path / "out")


def test_shards_and_rescued_folders_keep_positions(placed_study, tmp_path):
    study = load_study(placed_study.folder.parent / "study.toml")
    for k in (1, 2):
        nfbench.run(study, out=tmp_path / str(k), jobs=0, shard=(k, 2))
    merged = merge([tmp_path / "1", tmp_path / "2"], tmp_path / "merged")
    pd.testing.assert_frame_equal(merged.positions, placed_study.positions)
    assert (tmp_path / "merged" / "positions.csv").read_text() == (placed_study.folder / "positions.csv").read_text()
    overwritten(0, 100)(tmp_path / "merged")  # the header: SQLite refuses the file
    rescued = merge([tmp_path / "merged"], tmp_path / "rescued")
    pd.testing.assert_frame_equal(rescued.positions, placed_study.positions)


def test_a_folder_of_schema_3_is_read_and_updated(placed_study, tmp_path):
    study = load_study(placed_study.folder.parent / "study.toml")
    results = nfbench.run(study, out=tmp_path / "old", jobs=0)
    (results.folder / "positions.csv").unlink()
    with sqlite3.connect(results.folder / "runs.sqlite") as db:
        db.execute("DROP TABLE positions")
        db.execute("UPDATE meta SET value = '3' WHERE key = 'schema'")
    assert results.positions.empty and list(results.positions) == COLUMNS
    pd.testing.assert_frame_equal(results.runs, nfbench.Results(results.folder).runs)
    results.write_tables()
    assert not (results.folder / "positions.csv").exists()
    with sqlite3.connect(results.folder / "runs.sqlite") as db:
        (left,) = db.execute("SELECT run_id FROM plan WHERE ordinal = 5").fetchone()
        db.execute("DELETE FROM results WHERE run_id = ?", [left])
    again = nfbench.run(study, out=results.folder, jobs=0)
    assert set(again.positions.run_id) == {left}  # of the others, the table has never been written


def test_a_run_that_is_made_again_without_positions_loses_them(placed_study, tmp_path):
    from nfbench.results import Store
    from nfbench.study import RunRecord

    study = load_study(placed_study.folder.parent / "study.toml")
    first = next(study.specs()).run_id
    (tmp_path / "out").mkdir()
    with Store(tmp_path / "out", write=True) as store:
        store.begin(study)
        store.add([RunRecord(first, Status.OK, positions=([[1.0, 2.0, 2.0]], [[math.nan] * 3, [0.0, 0.0, 5.0]]))])
        table = nfbench.Results(tmp_path / "out").positions
        assert table.true_range_m[0] == 3.0 and table.elevation_deg[1] == 90.0 and np.isnan(table.error_m).all()
        store.add([RunRecord(first, Status.FAILED, "no luck")])
    assert nfbench.Results(tmp_path / "out").positions.empty


@pytest.mark.parametrize(("truth", "estimated"), [("'[[1, 2]]'", "'[]'"), ("'7'", "'[]'"), ("x'00'", "'[]'")])
def test_damaged_positions_are_reported_with_their_row(truth, estimated, manifest, tmp_path):
    results = nfbench.run(load_study(manifest(BASIC)), out=tmp_path / "out", jobs=0)
    assert results.positions.empty and not (tmp_path / "out" / "positions.csv").exists()
    placed("run_id", truth, estimated)(tmp_path / "out")
    with pytest.raises(StoreError, match=r"table positions, row '.*', column truth: .*nfbench merge"):
        results.positions  # noqa: B018
    merged = merge([tmp_path / "out"], tmp_path / "merged")
    assert merged.positions.empty and len(merged.runs) == len(results.runs)


@pytest.mark.parametrize(
    ("found", "message"),
    [
        (7, "expected two arrays or None, got int"),
        ((np.ones((2, 3)),), "expected two arrays or None, got tuple"),
        ((np.ones((2, 2)), np.ones((2, 2))), r"expected two arrays of points \(x, 3\), .* got \(2, 2\)"),
        ((np.ones((2, 6)), np.ones((2, 3))), r"or \(x, 6\) with angles and range, got \(2, 6\) and \(2, 3\)"),
        ((np.ones((2, 3)), np.ones((1, 3))), "expected at least 2 estimates, one per source, got 1"),
        ((np.ones((1, 3)), np.array([["x", "y", "z"]])), "expected an array of real numbers"),
    ],
)
def test_positions_that_are_none_make_a_run_invalid(found, message):
    with pytest.raises(Unstorable, match=message):
        plain_positions(found)


def test_positions_of_whole_numbers_and_none_at_all_are_kept():
    assert plain_positions(Instance.positions(None, np.ones(1))) is None
    assert plain_positions((np.array([[1, 2, 3]]), np.array([[4, 5, 6]]))) == ([[1.0, 2.0, 3.0]], [[4.0, 5.0, 6.0]])
    assert json.dumps(plain_positions((np.empty((0, 3)), np.empty((0, 3))))) == "[[], []]"
