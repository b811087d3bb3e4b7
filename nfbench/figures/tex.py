"""Figures as LaTeX code (PGF), with the fonts of the document that includes them. No LaTeX is needed to write it."""

from __future__ import annotations

import math
import re
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, final

import matplotlib as mpl
from matplotlib.backend_bases import RendererBase
from matplotlib.backends.backend_mixed import MixedModeRenderer
from matplotlib.backends.backend_pgf import RendererPgf
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.text import Text
from matplotlib.transforms import IdentityTransform
from PIL import Image

from nfbench.core import latex_text

__all__ = ["tex_files"]

DPI = 300  # of images
TRIM = 0.011  # [in] at the left and right: the columns of IEEEtran are up to 0.02 in narrower than 3.5 and 7.16 in
ALONG = {"left": 0.0, "center": 0.5, "right": 1.0}  # place of the anchor of a line, relative to its width
_NUMBER = re.compile(r"\$[0-9.]*(?:\\times )?(?:10\^\{-?[0-9]+\})?\$")  # a label of our logarithmic axes
_HEAD = r"""% A figure of nfbench. The preamble needs \usepackage{{pgf}}; include the figure with \input{{{name}.tex}}.
% If it is in another folder than the document, use \usepackage{{import}} and \import{{folder/}}{{{name}.tex}}.
\begingroup%
\makeatletter%
\begin{{pgfpicture}}%
\pgfpathrectangle{{\pgfqpoint{{{left:f}in}}{{0in}}}}{{\pgfqpoint{{{width:f}in}}{{{height:f}in}}}}%
\pgfusepath{{use as bounding box, clip}}%
"""
_FOOT = "\\end{pgfpicture}%\n\\makeatother%\n\\endgroup%\n"


@final
@dataclass(frozen=True)
class _Anchor:
    """What matplotlib's PGF renderer reads from a text: the point that the document's font keeps in place."""

    x: float
    y: float
    along: str

    def get_unitless_position(self) -> tuple[float, float]:
        return self.x, self.y

    def get_transform(self) -> IdentityTransform:
        return IdentityTransform()

    def get_horizontalalignment(self) -> str:
        return self.along

    def get_verticalalignment(self) -> str:
        return "baseline"

    def get_rotation_mode(self) -> str:
        return "anchor"


class _Renderer(RendererPgf):
    """Measures text with matplotlib's fonts rather than with LaTeX, and lets no text act as a command.

    Fonts differ in width, so each line is placed by its left end, middle or right end, as its text is aligned.
    """

    texts: dict[str, Text]  # by the identifier that they have while they are drawn
    current: Text | None = None

    def open_group(self, s: str, gid: str | None = None) -> None:
        if s == "text":
            self.current = self.texts.get(gid or "")

    def get_text_width_height_descent(self, s: str, prop: FontProperties, ismath: Any) -> tuple[float, float, float]:
        return RendererBase.get_text_width_height_descent(self, s, prop, ismath)

    def draw_text(self, gc: Any, x: float, y: float, s: str, prop: Any, angle: float, ismath: Any = False,
                  mtext: Any = None) -> None:  # fmt: skip
        text = s if ismath and _NUMBER.fullmatch(s) else latex_text(s)
        along = _alignment(self.current) if self.current is not None else "left"
        width, _, _ = self.get_text_width_height_descent(s, prop, ismath)
        to, turn = ALONG[along] * width, math.radians(angle)
        place: Any = _Anchor(x + to * math.cos(turn), y + to * math.sin(turn), along)
        super().draw_text(gc, x, y, text, prop, angle, ismath, place)  # type: ignore[no-untyped-call]

    def draw_image(self, gc: Any, x: float, y: float, im: Any, transform: Any = None) -> None:
        """Save the image next to the code, which includes it; matplotlib's own method starts LaTeX to choose how."""
        path = Path(self.fh.name)
        name = f"{path.stem}-img{self.image_counter}.png"
        self.image_counter += 1
        Image.fromarray(im[::-1]).save(path.parent / name)
        left, bottom, width, height = (value / self.dpi for value in (x, y, im.shape[1], im.shape[0]))
        self.fh.write("\\begin{pgfscope}%\n")
        self._print_pgf_clip(gc)  # type: ignore[no-untyped-call]
        self.fh.write(f"\\pgfsys@transformshift{{{left:f}in}}{{{bottom:f}in}}%\n")
        size = f"width={width:f}in,height={height:f}in"
        self.fh.write(f"\\pgftext[left,bottom]{{\\includegraphics[{size}]{{{name}}}}}%\n\\end{{pgfscope}}%\n")


def _alignment(text: Any) -> str:
    """How the lines of a text are aligned with each other; the alignment of the text, if it has one line."""
    several = "\n" in text.get_text()
    return str(text._get_multialignment() if several else text.get_horizontalalignment())


def tex_files(figure: Figure, stem: str) -> dict[str, bytes]:
    """Return the files of a figure by name: the LaTeX code, and an image for each part that is no line art."""
    with tempfile.TemporaryDirectory() as folder, mpl.rc_context({"pgf.texsystem": "pdflatex", "pgf.rcfonts": False}):
        path = Path(folder) / f"{stem}.tex"
        with path.open("w", encoding="utf-8", newline="\n") as file:
            _write(figure, file, stem)
        return {found.name: found.read_bytes() for found in sorted(path.parent.iterdir())}


def _write(figure: Figure, file: IO[str], stem: str) -> None:
    width, height = figure.get_size_inches()
    file.write(_HEAD.format(name=stem, left=TRIM, width=width - 2 * TRIM, height=height))
    figure.draw_without_rendering()  # makes the labels of ticks
    found: list[Any] = figure.findobj(Text)
    before = figure.dpi, [text.get_gid() for text in found]
    figure.dpi = DPI
    try:
        vectors = _Renderer(figure, file)  # type: ignore[no-untyped-call]
        vectors.texts = {f"text{number}": text for number, text in enumerate(found)}
        for name, text in vectors.texts.items():
            text.set_gid(name)
        renderer: Any = MixedModeRenderer(figure, width, height, DPI, vectors)  # type: ignore[no-untyped-call]
        figure.draw(renderer)
    finally:
        figure.dpi = before[0]
        for text, gid in zip(found, before[1], strict=True):
            text.set_gid(gid)
    file.write(_FOOT)
