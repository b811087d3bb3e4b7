"""The true and the estimated positions of the sources, in the store of a study and as a table."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, Protocol, final

import numpy as np
from numpy import ndarray

from nfbench.study import RunRecord, swept_column

from .cells import cell
from .schema import POSITION_COLUMNS, marks
from .values import settings

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["PositionTable", "positions_frame"]

COLUMNS = ("run_id", "method", "repetition", "swept", "truth", "estimated")
_JOINED = "FROM plan JOIN results USING (run_id) JOIN positions USING (run_id) ORDER BY ordinal"


class _Database(Protocol):
    """What a store offers to this table."""

    @property
    def connection(self) -> sqlite3.Connection: ...

    def select(self, sql: str, args: Sequence[Any] = ()) -> Iterator[tuple[Any, ...]]: ...

    def checked(
        self, table: str, names: Sequence[str], source: str, args: Sequence[Any] = ()
    ) -> Iterator[tuple[list[Any], tuple[Any, ...]]]: ...


@final
class PositionTable:
    """The table ``positions`` of a store, with one row per run whose instance has positions.

    Files of schema 3 and older do not have it.
    """

    def __init__(self, store: _Database) -> None:
        self._store = store

    def _exists(self) -> bool:
        query = "SELECT 1 FROM sqlite_master WHERE name = 'positions'"
        return any(True for _ in self._store.select(query))

    def finished(self) -> Iterator[tuple[Any, ...]]:
        """Yield the columns COLUMNS of every finished run of the plan that has positions, in order."""
        if self._exists():
            for values, _ in self._store.checked("positions", COLUMNS, _JOINED):
                yield tuple(values)

    def rows(self) -> Iterator[tuple[Any, ...]]:
        """Yield the rows of the table as stored."""
        if self._exists():
            for _, row in self._store.checked("positions", POSITION_COLUMNS, "FROM positions"):
                yield row

    def put(self, records: Iterable[RunRecord]) -> None:
        """Replace the positions of runs; within a transaction of the store."""
        db = self._store.connection
        for record in records:
            if record.positions is None:
                db.execute("DELETE FROM positions WHERE run_id = ?", [record.run_id])
            else:
                row = [record.run_id, *map(json.dumps, record.positions)]
                db.execute(f"REPLACE INTO positions VALUES ({marks(len(POSITION_COLUMNS))})", row)


def positions_frame(rows: Sequence[tuple[Any, ...]], keys: Sequence[str], runs_per_scene: int) -> pd.DataFrame:
    """Return the table of positions: one row per source of each run, followed by its surplus estimates.

    rows: the columns COLUMNS of each run.
    keys: the swept keys of the study.
    runs_per_scene: number of runs of a method on the same scene.
    """
    import pandas as pd

    truths = [row[4] for row in rows]
    found = [row[5] for row in rows]
    counts = np.array([max(len(t), len(e)) for t, e in zip(truths, found, strict=True)], dtype=np.int64)
    true, estimated = (_padded(parts, counts) for parts in (truths, found))
    numbers = np.concatenate([np.arange(1, n + 1) for n in counts]) if len(counts) else np.empty(0, np.int64)
    known = numbers <= np.repeat([len(t) for t in truths], counts)
    repetitions = np.array([row[2] for row in rows], dtype=np.int64)
    swept = [settings(row[3]) for row in rows]
    about: dict[str, Any] = {"run_id": [row[0] for row in rows], "method": [row[1] for row in rows]}
    about |= {"scene": repetitions // runs_per_scene, "run": repetitions % runs_per_scene}
    about |= {swept_column(key): [cell(each.get(key)) for each in swept] for key in keys}
    table = pd.DataFrame(about).loc[np.repeat(np.arange(len(rows)), counts)].reset_index(drop=True)
    with np.errstate(all="ignore"):  # positions may be infinite
        distances = np.linalg.norm(estimated[:, :3] - true[:, :3], axis=1)
        columns = {f"true_{name}": values for name, values in _coordinates(true).items()}
        columns |= _coordinates(estimated)
        columns["error_m"] = distances
    source = pd.Series(numbers, dtype="Int64").where(pd.Series(known, dtype=bool))
    return table.assign(source=source, **columns)


def _padded(parts: Sequence[ndarray], counts: ndarray) -> ndarray:
    """The rows of all parts, each part filled up with NaN to its count (n, 6): x, y, z, azimuth, elevation, range."""
    rows = np.full((int(counts.sum()), 6), np.nan)
    first = 0
    for part, count in zip(parts, counts.tolist(), strict=True):
        rows[first : first + len(part)] = part if part.shape[1] == 6 else _with_angles(part)
        first += count
    return rows


def _with_angles(points: ndarray) -> ndarray:
    """Points (n, 3), followed by their azimuth, elevation [rad] and range [m] from the origin along x, y and z."""
    x, y, z = points.T
    with np.errstate(all="ignore"):
        across = np.hypot(x, y)
        return np.column_stack([points, np.arctan2(y, x), np.arctan2(z, across), np.hypot(across, z)])


def _coordinates(points: ndarray) -> dict[str, ndarray]:
    """The Cartesian and spherical coordinates of points (n, 6) [m, rad] by column name."""
    x, y, z, azimuth, elevation, r = points.T
    return {
        "x_m": x,
        "y_m": y,
        "z_m": z,
        "azimuth_deg": np.degrees(azimuth),
        "elevation_deg": np.degrees(elevation),
        "range_m": r,
    }
