"""Figures as LaTeX code (PGF), with the fonts of the document that includes them. No LaTeX is needed to write it."""

from __future__ import annotations

import re
import tempfile
from pathlib import Path
from typing import IO, Any

import matplotlib as mpl
from matplotlib.backend_bases import RendererBase
from matplotlib.backends.backend_mixed import MixedModeRenderer
from matplotlib.backends.backend_pgf import RendererPgf
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from PIL import Image

from nfbench.core import latex_text

__all__ = ["tex_files"]

DPI = 300  # of images
_NUMBER = re.compile(r"\$[0-9.]*(?:\\times )?(?:10\^\{-?[0-9]+\})?\$")  # a label of our logarithmic axes
_HEAD = r"""% A figure of nfbench. The preamble needs \usepackage{{pgf}}; include the figure with \input{{{name}.tex}}.
% If it is in another folder than the document, use \usepackage{{import}} and \import{{folder/}}{{{name}.tex}}.
\begingroup%
\makeatletter%
\begin{{pgfpicture}}%
\pgfpathrectangle{{\pgfpointorigin}}{{\pgfqpoint{{{width:f}in}}{{{height:f}in}}}}%
\pgfusepath{{use as bounding box, clip}}%
"""
_FOOT = "\\end{pgfpicture}%\n\\makeatother%\n\\endgroup%\n"


class _Renderer(RendererPgf):
    """Measures text with matplotlib's fonts rather than with LaTeX, and lets no text act as a command."""

    def get_text_width_height_descent(self, s: str, prop: FontProperties, ismath: Any) -> tuple[float, float, float]:
        return RendererBase.get_text_width_height_descent(self, s, prop, ismath)

    def draw_text(self, gc: Any, x: float, y: float, s: str, prop: Any, angle: float, ismath: Any = False,
                  mtext: Any = None) -> None:  # fmt: skip
        text = s if ismath and _NUMBER.fullmatch(s) else latex_text(s)
        super().draw_text(gc, x, y, text, prop, angle, ismath, mtext)  # type: ignore[no-untyped-call]

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


def tex_files(figure: Figure, stem: str) -> dict[str, bytes]:
    """Return the files of a figure by name: the LaTeX code, and an image for each part that is no line art."""
    with tempfile.TemporaryDirectory() as folder, mpl.rc_context({"pgf.texsystem": "pdflatex", "pgf.rcfonts": False}):
        path = Path(folder) / f"{stem}.tex"
        with path.open("w", encoding="utf-8", newline="\n") as file:
            _write(figure, file, stem)
        return {found.name: found.read_bytes() for found in sorted(path.parent.iterdir())}


def _write(figure: Figure, file: IO[str], stem: str) -> None:
    width, height = figure.get_size_inches()
    file.write(_HEAD.format(name=stem, width=width, height=height))
    before = figure.dpi
    figure.dpi = DPI
    try:
        renderer: Any = MixedModeRenderer(figure, width, height, DPI, _Renderer(figure, file))  # type: ignore[no-untyped-call]
        figure.draw(renderer)
    finally:
        figure.dpi = before
    file.write(_FOOT)
