"""Builds the documentation site and checks it: ``python docs/build.py``.

Warnings are errors. Then every internal link and anchor of the site is followed, and so is every link from the Markdown
files of the repository to another file. Nothing that a page loads may come from the network. Links to other sites are
checked for their form only, as a build must not depend on them.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent
SITE = DOCS / "_build" / "html"
GENERATED = {"docs/_build", "docs/gallery", "docs/results", "docs/project"}
LOADING = {
    "script": "src",
    "img": "src",
    "iframe": "src",
    "source": "src",
    "audio": "src",
    "video": "src",
    "embed": "src",
}


class _Page(HTMLParser):
    """The anchors of a page, what it links to, and what it loads."""

    def __init__(self) -> None:
        super().__init__()
        self.anchors: set[str] = set()
        self.links: list[str] = []
        self.loads: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = {name: value or "" for name, value in attrs}
        self.anchors |= {values[name] for name in ("id", "name") if name in values}
        if tag == "a" and "href" in values:
            self.links.append(values["href"])
        if tag == "link" and values.get("rel") not in ("index", "search", "next", "prev", "canonical"):
            self.loads.append(values["href"])
        if tag in LOADING and values.get(LOADING[tag]):
            self.loads.append(values[LOADING[tag]])
        self.loads += [part.split()[0] for part in values.get("srcset", "").split(",") if part.strip()]


def site_faults(site: Path) -> Iterator[str]:
    """What is wrong with the links and resources of a built site."""
    pages = {path: _Page() for path in sorted(site.rglob("*.html"))}
    for path, page in pages.items():
        page.feed(path.read_text(encoding="utf-8"))
    for path, page in pages.items():
        where = path.relative_to(site)
        for link in [*page.links, *page.loads]:
            parts = urlsplit(link)
            if parts.scheme == "data" and link in page.loads:
                continue
            if parts.scheme or parts.netloc:
                if link in page.loads:
                    yield f"{where}: loads {link} from the network"
                elif not _well_formed(link):
                    yield f"{where}: {link} is not a well-formed address"
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if not target.is_file():
                yield f"{where}: {link} does not exist"
            elif parts.fragment and target in pages and unquote(parts.fragment) not in pages[target].anchors:
                yield f"{where}: {link} has no such anchor"
    for sheet in site.rglob("*.css"):
        for address in re.findall(
            r"(?:url\(\s*['\"]?|@import\s+['\"])((?:https?:)?//[^)'\"]+)", sheet.read_text("utf-8")
        ):
            yield f"{sheet.relative_to(site)}: loads {address} from the network"
    for script in site.rglob("*.js"):
        text = script.read_text(encoding="utf-8")
        for address in re.findall(
            r"(?:fetch|import|importScripts)\(\s*['\"](https?://[^'\"]+)|\.src\s*=\s*['\"](https?://[^'\"]+)", text
        ):
            yield f"{script.relative_to(site)}: loads {address} from the network"


def markdown_faults(root: Path) -> Iterator[str]:
    """Links from Markdown files of the repository that lead nowhere."""
    found = subprocess.run(
        ["git", "-C", str(root), "ls-files", "--cached", "--others", "--exclude-standard", "*.md"],
        capture_output=True, text=True, check=True,
    ).stdout.split()  # fmt: skip
    for name in found:
        path = root / name
        for link in re.findall(r"\]\(([^()\s]+)\)", _without_code(path.read_text(encoding="utf-8"))):
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                if not _well_formed(link):
                    yield f"{name}: {link} is not a well-formed address"
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            generated = target.is_relative_to(root) and any(
                target.is_relative_to(root / folder) for folder in GENERATED
            )
            if generated:
                continue  # the check of the site follows it
            if not target.exists():
                yield f"{name}: {link} does not exist"
            elif parts.fragment and target.suffix == ".md" and parts.fragment not in _headings(target):
                yield f"{name}: {link} has no such heading"


def _well_formed(link: str) -> bool:
    parts = urlsplit(link)
    if parts.scheme == "mailto":
        return "@" in parts.path
    return parts.scheme in ("http", "https") and "." in parts.netloc and " " not in link


def _without_code(text: str) -> str:
    return re.sub(r"`[^`\n]*`", "", re.sub(r"^ *(```|~~~).*?^ *\1", "", text, flags=re.DOTALL | re.MULTILINE))


def _headings(path: Path) -> set[str]:
    """The anchors that a Markdown file's headings get."""
    titles = re.findall(r"^#+ (.*)$", _without_code(path.read_text(encoding="utf-8")), flags=re.MULTILINE)
    anchors = {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}
    return anchors | set(re.findall(r"^\(([\w-]+)\)=$", path.read_text(encoding="utf-8"), flags=re.MULTILINE))


def main() -> int:
    """Build all pages again (unchanged examples are not executed again), then check; returns the exit code."""
    command = [
        sys.executable,
        "-m",
        "sphinx",
        "-W",
        "--keep-going",
        "-n",
        "-E",
        "-q",
        "-b",
        "html",
        str(DOCS),
        str(SITE),
    ]
    shutil.rmtree(SITE, ignore_errors=True)  # no page of an earlier build stays
    built = subprocess.run(command, check=False).returncode
    if built:
        return built
    faults = [*site_faults(SITE), *markdown_faults(ROOT)]
    for fault in faults:
        print(fault, file=sys.stderr)
    pages = len(list(SITE.rglob("*.html")))
    print(f"{SITE / 'index.html'}: {pages} pages, {len(faults)} broken links or resources from the network")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
