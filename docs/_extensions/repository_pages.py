"""Makes pages of Markdown files that stand elsewhere in the repository, and leads links between pages to them.

The results, the changelog and the notes for contributors are read on their own in the repository, so they stay where
they are. Here each becomes a page of the site. A link to any other file of the repository becomes a download.
"""

from __future__ import annotations

import os
import re
from pathlib import Path, PurePosixPath
from typing import Any

from sphinx.application import Sphinx

__all__ = ["PAGES", "setup"]

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = {
    "results/paper/README.md": "results/paper.md",
    "results/optimizer_choice/README.md": "results/optimizer_choice.md",
    "results/certified/README.md": "results/certified.md",
    "results/relaxation/README.md": "results/relaxation.md",
    "results/estimators/README.md": "results/estimators.md",
    "results/learned/README.md": "results/learned.md",
    "results/landscape/README.md": "results/landscape.md",
    "results/measured/README.md": "results/measured.md",
    "results/impairments/README.md": "results/impairments.md",
    "CHANGELOG.md": "project/changelog.md",
    "CONTRIBUTING.md": "project/contributing.md",
}
_LINK = re.compile(r"(\]\()([^)#\s:]+)(#[^)\s]*)?(\))")
_WRITTEN = "<!-- written by docs/_extensions/repository_pages.py -->"


def _moved(text: str, source: PurePosixPath, page: PurePosixPath) -> str:
    """The text of ``source`` with its links as they must be in ``page``; both are paths from the repository's root."""

    def moved(match: re.Match[str]) -> str:
        target = os.path.normpath(source.parent / match[2])
        target = f"docs/{PAGES[target]}" if target in PAGES else target
        return f"{match[1]}{os.path.relpath(target, page.parent)}{match[3] or ''}{match[4]}"

    return _LINK.sub(moved, text)


def _write_pages(app: Sphinx) -> None:
    for source, page in PAGES.items():
        out = DOCS / page
        out.parent.mkdir(exist_ok=True)
        text = _moved((ROOT / source).read_text(encoding="utf-8"), PurePosixPath(source), PurePosixPath("docs") / page)
        if not re.search(r"^## ", text, flags=re.MULTILINE):  # generated files skip a level
            text = re.sub(r"^### ", "## ", text, flags=re.MULTILINE)
        text = f"{_WRITTEN}\n\n{text}"
        if not out.exists() or out.read_text(encoding="utf-8") != text:
            out.write_text(text, encoding="utf-8")


def _lead_links(app: Sphinx, docname: str, content: list[str]) -> None:
    """In pages of docs/ itself, links to these files lead to their pages."""
    page = PurePosixPath("docs") / f"{docname}.md"
    if (DOCS / f"{docname}.md").exists() and not content[0].startswith(_WRITTEN):
        content[0] = _moved(content[0], page, page)


def setup(app: Sphinx) -> dict[str, Any]:
    app.connect("builder-inited", _write_pages)
    app.connect("source-read", _lead_links)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
