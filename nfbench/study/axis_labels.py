"""The ``[labels]`` table of a manifest: how the axes of figures are labelled."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

from nfbench.core import ManifestError, nearest

from .reading import read_manifest

__all__ = ["AXES", "label_problems", "read_labels"]

AXES = ("rmse", "median", "runtime")  # axes that every study has
LONGEST = 80  # characters


def label_problems(labels: Mapping[str, str], swept: Iterable[str]) -> list[tuple[str, str]]:
    """Return what is wrong with the labels as (key, sentence) pairs. swept: keys of the sweep."""
    known = [*AXES, *dict.fromkeys(key for name in swept for key in (name, _plain(name)))]
    found = []
    for key, text in labels.items():
        if key not in known and _plain(key) not in known:
            near = nearest(key, known)
            hint = f"; did you mean {near!r}?" if near else ""
            found.append((key, f"expected a swept key or one of {', '.join(AXES)}{hint}"))
        elif not text.strip() or len(text) > LONGEST:
            found.append((key, f"expected a label of 1 to {LONGEST} characters, got {len(text)}"))
    return found


def read_labels(manifest: Path) -> dict[str, str]:
    """Return the labels of a manifest by key, without the prefix ``scenario.``; none if it cannot be read."""
    try:
        table, _ = read_manifest(manifest)
    except ManifestError:
        return {}
    labels = table.get("labels")
    if not isinstance(labels, dict):
        return {}
    return {_plain(key): text[:LONGEST] for key, text in labels.items() if isinstance(text, str) and text.strip()}


def _plain(key: str) -> str:
    return key.removeprefix("scenario.")
