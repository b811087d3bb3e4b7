"""Text for LaTeX documents."""

from __future__ import annotations

__all__ = ["latex_text"]

_ESCAPED = {
    "\\": r"\textbackslash{}", "{": r"\{", "}": r"\}", "$": r"\$", "&": r"\&", "#": r"\#", "%": r"\%", "_": r"\_",
    "^": r"\textasciicircum{}", "~": r"\textasciitilde{}", "<": r"\textless{}", ">": r"\textgreater{}",
    "|": r"\textbar{}", '"': r"\textquotedbl{}", "\n": " ", "`": r"\textasciigrave{}",
}  # fmt: skip
_MATH = {
    "λ": r"\lambda", "κ": r"\kappa", "θ": r"\theta", "φ": r"\varphi", "σ": r"\sigma", "Δ": r"\Delta", "Γ": r"\Gamma",
    "≤": r"\leq", "≥": r"\geq", "×": r"\times", "·": r"\cdot", "÷": r"\div", "±": r"\pm", "−": "-", "∞": r"\infty",
    "√": r"\surd", "°": r"^\circ", "²": "^2", "³": "^3", "⁻": "^-", "₁": "_1", "₂": "_2", "→": r"\rightarrow",
    "‖": r"\|", "µ": r"\mu", "μ": r"\mu", "α": r"\alpha", "δ": r"\delta", "ε": r"\varepsilon",
}  # fmt: skip
_PLAIN = {
    "–": "--", "—": "---", "…": r"\ldots{}", "\N{THIN SPACE}": r"\,", "\N{NO-BREAK SPACE}": "~",
    "“": "``", "”": "''", "‘": "`", "’": "'",
}  # fmt: skip
_TABLE = str.maketrans(_ESCAPED | {key: rf"\ensuremath{{{value}}}" for key, value in _MATH.items()} | _PLAIN)


def latex_text(text: str) -> str:
    """Return text that LaTeX prints literally: no character of it acts as a command.

    Greek letters and signs of mathematics become commands, so that every engine prints them; letters of other scripts
    stay as they are, and need an engine and a font that have them.
    """
    return text.translate(_TABLE)
