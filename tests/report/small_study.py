"""A small study with positions, targets and a claim, and what its page contains."""

import json
import re
from html.parser import HTMLParser

import nfbench
from nfbench.study import load_study

MANIFEST = """
name = "small"
title = "Two SNRs, one source"
expect = "DE beats random search"
scenes = 14
seed = 3
[scenario]
kind = "near-field"
array = { kind = "ula", elements = 8, spacing_wavelengths = 0.25, origin = "center" }
wavelength_m = 0.02
sources = 1
snapshots = 20
azimuth_deg = [-50, 50]
range_m = [0.05, 0.2]
[sweep]
snr_db = [0, 20]
[targets]
error_in_bounds = [3]
gap = [1e-6]
[[formulation]]
kind = "neef"
[[solver]]
kind = "de"
population = 10
[[solver]]
kind = "random-search"
[budget]
evaluations = 400
[[claim]]
text = "DE is more accurate than random search"
compare = { better = "neef + de", worse = "neef + random-search" }
"""


LOADING = ("src", "href", "xlink:href", "action", "srcset", "data", "poster", "formaction")  # attributes


class Page(HTMLParser):
    """The elements of a page, and the text of its scripts and other elements."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.scripts, self.words, self.references, self.styles, self._open = [], [], [], [], [], ""
        self.feed(text)
        self.close()
        self.text = " ".join(" ".join(self.words).split())
        self.data = json.loads(self.scripts[0]) if self.scripts else None

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self._open = tag
        if tag == "script":
            self.scripts.append("")
        self.references += [(name, value) for name, value in attrs if name in LOADING]
        self.styles += [value for name, value in attrs if name == "style"]

    def handle_data(self, data):
        if self._open == "script":
            self.scripts[-1] += data
        elif self._open == "style":
            self.styles.append(data)
        else:
            self.words.append(data)

    def handle_endtag(self, tag):
        self._open = ""


def run_in(folder):
    """Run the small study in a new folder, and return its results."""
    manifest = folder / "small.toml"
    manifest.write_text(MANIFEST)
    return nfbench.run(load_study(manifest), out=folder / "out", jobs=0)


def external(text):
    """What a page would load from elsewhere: addresses in attributes and in styles."""
    page = Page(text)
    addresses = [value for _, value in page.references]
    for style in page.styles:
        addresses += re.findall(r"""(?:url\(|@import)\s*["']?\s*([^"')\s]+)""", style)
    return [address for address in addresses if re.match(r"\s*(?:[a-z]+:)?//", address or "", re.IGNORECASE)]
