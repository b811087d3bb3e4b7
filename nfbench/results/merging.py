"""Merges results folders of one study, such as its shards."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from pathlib import Path

from nfbench.core import StoreError

from .results import Results
from .store import Store

__all__ = ["merge"]


def merge(folders: Sequence[str | Path], out: str | Path) -> Results:
    """Merge the results of ``folders`` into ``out``, a new folder or one of the same study, and write its tables.

    Raises StoreError if the folders differ in study, seed, manifest or plugin versions, or if they have different
    results for the same run. ``out`` then keeps what was merged before.
    """
    out = Path(out)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StoreError(f"{out}: {error.strerror or error}") from error
    with Store(out, write=True) as store:
        for folder in map(Path, folders):
            with Store(folder) as other:
                store.take_over(other)
            _copy(folder / "manifest.toml", out / "manifest.toml")
    environments = [json.loads(path.read_text()) for f in folders if (path := Path(f) / "environment.json").is_file()]
    text = json.dumps({"merged": environments}, indent=2) + "\n"
    (out / "environment.json").write_text(text, encoding="utf-8")
    results = Results(out)
    results.write_tables()
    return results


def _copy(source: Path, target: Path) -> None:
    if source.is_file() and source.resolve() != target.resolve():
        shutil.copyfile(source, target)
