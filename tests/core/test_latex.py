"""Text in LaTeX documents is printed literally: no label acts as a command."""

import re

import pytest

from nfbench.core import latex_text


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a_b & 5 % #1 {x}", r"a\_b \& 5 \% \#1 \{x\}"),
        (r"\input{/etc/passwd}", r"\textbackslash{}input\{/etc/passwd\}"),
        ("$x^2$~", r"\$x\textasciicircum{}2\$\textasciitilde{}"),
        ("λ ≤ 3 °", r"\ensuremath{\lambda} \ensuremath{\leq} 3 \ensuremath{^\circ}"),
        ("1 – 2…", r"1 -- 2\ldots{}"),
    ],
)
def test_special_characters_are_escaped(text, expected):
    assert latex_text(text) == expected


def test_every_character_of_ascii_is_literal():
    text = "".join(map(chr, range(32, 127)))
    bare = re.sub(r"\\text[a-z]+\{\}|\\[{}$&#%_]", "", latex_text(text))
    assert not set(bare) & set("\\{}$&#%_^~")
