"""Renders formulas as MathML while the pages are built, so that reading them needs no script and no network."""

from __future__ import annotations

import re
from typing import Any
from xml.etree import ElementTree

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx

__all__ = ["setup"]


# where the letters of a variant begin in Unicode: A, a, Α, α, 0. Browsers ignore the attribute mathvariant.
_VARIANTS = {
    "bold": (0x1D400, 0x1D41A, 0x1D6A8, 0x1D6C2, 0x1D7CE),
    "double-struck": (0x1D538, 0x1D552, None, None, 0x1D7D8),
    "sans-serif": (0x1D5A0, 0x1D5BA, None, None, 0x1D7E2),
}
_PRIMES = ("′", "″", "‴")
_MATHML = "http://www.w3.org/1998/Math/MathML"
_EXCEPTIONS = {("double-struck", letter): sign for letter, sign in zip("CHNPQRZ", "ℂℍℕℙℚℝℤ", strict=True)}


def _mathml(formula: str, display: str) -> str:
    """MathML with bold, double-struck and sans-serif letters as characters of their own."""

    def letters(match: re.Match[str]) -> str:
        tag, variant, text = match.groups()
        return f'<{tag} mathvariant="normal">{"".join(_variant(variant, letter) for letter in text)}</{tag}>'

    text = _upright_primes(convert(formula, display=display))
    text = re.sub(r'<(m[ion]) mathvariant="(bold|double-struck|sans-serif)">([^<&]*)</m[ion]>', letters, text)
    return re.sub(r"<mi>([^<&]{2,})</mi>", r'<mi mathvariant="normal">\1</mi>', text)


def _upright_primes(text: str) -> str:
    """Formulas whose primes follow their letters in full size; in a superscript they are raised twice, and tiny."""
    ElementTree.register_namespace("", _MATHML)
    root = ElementTree.fromstring(text)
    for element in list(root.iter()):
        if element.tag not in (f"{{{_MATHML}}}msup", f"{{{_MATHML}}}msubsup"):
            continue
        *below, above = list(element)
        first = above[0] if above.tag == f"{{{_MATHML}}}mrow" and len(above) > 1 else above
        if first.text not in _PRIMES:
            continue
        kind = "msub" if len(below) == 2 else "mrow"
        base = ElementTree.Element(f"{{{_MATHML}}}{kind}")
        base.extend(below)
        element[:] = [base, first]
        element.tag = f"{{{_MATHML}}}mrow"
        if first is not above:  # such as the H of A′ᴴ
            above.remove(first)
            whole = ElementTree.Element(f"{{{_MATHML}}}mrow")
            whole.extend([base, first])
            element[:] = [whole, above]
            element.tag = f"{{{_MATHML}}}msup"
    return ElementTree.tostring(root, encoding="unicode")


def _variant(variant: str, letter: str) -> str:
    if (variant, letter) in _EXCEPTIONS:
        return _EXCEPTIONS[variant, letter]
    for first, start in zip("AaΑα0", _VARIANTS[variant], strict=True):
        place = ord(letter) - ord(first)
        if start and 0 <= place < (10 if first == "0" else 26):
            return chr(start + place)
    return letter


def _inline(translator: Any, node: nodes.math) -> None:
    translator.body.append(_mathml(node.astext(), "inline"))
    raise nodes.SkipNode


def _block(translator: Any, node: nodes.math_block) -> None:
    translator.body.append(f'<div class="math">{_mathml(node.astext(), "block")}</div>')
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, Any]:
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
