"""Joins the folders of one study's shards."""

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
    """Join the results of ``folders`` in ``out``, a new folder or one of the same study, and write its tables.

    Raises StoreError if they are of different studies, seeds, manifests or plugin versions, or disagree on a run; then
    ``out`` is left with what was joined before.
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
