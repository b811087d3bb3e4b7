"""Text for LaTeX documents."""

from __future__ import annotations

import unicodedata

__all__ = ["latex_text"]

_OGONEK = "\N{COMBINING OGONEK}"  # needs another font encoding than pdfLaTeX's first one
_ESCAPED = {
    "\\": r"\textbackslash{}", "{": r"\{", "}": r"\}", "$": r"\$", "&": r"\&", "#": r"\#", "%": r"\%", "_": r"\_",
    "^": r"\textasciicircum{}", "~": r"\textasciitilde{}", "<": r"\textless{}", ">": r"\textgreater{}",
    "|": r"\textbar{}", '"': r"\textquotedblright{}", "\n": " ", "`": r"\textasciigrave{}",
}  # fmt: skip
_MATH = {
    "≤": r"\leq", "≥": r"\geq", "≠": r"\neq", "≈": r"\approx", "×": r"\times", "·": r"\cdot", "÷": r"\div",
    "±": r"\pm", "−": "-", "∞": r"\infty", "√": r"\surd", "°": r"^\circ", "²": "^2", "³": "^3", "¹": "^1", "⁻": "^-",
    "₀": "_0", "₁": "_1", "₂": "_2", "₃": "_3", "→": r"\rightarrow", "←": r"\leftarrow", "‖": r"\|", "µ": r"\mu",
    "∂": r"\partial", "∑": r"\sum", "∈": r"\in", "ℓ": r"\ell", "«": r"\ll", "»": r"\gg", "¬": r"\neg",
}  # fmt: skip
_GREEK = {
    "α": "alpha", "β": "beta", "γ": "gamma", "δ": "delta", "ε": "varepsilon", "ϵ": "epsilon", "ζ": "zeta", "η": "eta",
    "θ": "theta", "ϑ": "vartheta", "ι": "iota", "κ": "kappa", "λ": "lambda", "μ": "mu", "ν": "nu", "ξ": "xi",
    "π": "pi", "ρ": "rho", "σ": "sigma", "ς": "varsigma", "τ": "tau", "υ": "upsilon", "φ": "varphi", "ϕ": "phi",
    "χ": "chi", "ψ": "psi", "ω": "omega", "Γ": "Gamma", "Δ": "Delta", "Θ": "Theta", "Λ": "Lambda", "Ξ": "Xi",
    "Π": "Pi", "Σ": "Sigma", "Υ": "Upsilon", "Φ": "Phi", "Ψ": "Psi", "Ω": "Omega",
}  # fmt: skip
_PLAIN = {
    "–": "--", "—": "---", "…": r"\ldots{}", "\N{THIN SPACE}": r"\,", "\N{NO-BREAK SPACE}": "~",
    "“": "``", "”": "''", "‘": "`", "’": "'",
}  # fmt: skip
_LATIN = "¡¿ÆæØøßıŁłŒœ"  # letters that pdfLaTeX has in its first font encoding, besides those with accents
_TABLE = (
    _ESCAPED
    | {key: rf"\ensuremath{{{value}}}" for key, value in _MATH.items()}
    | {key: rf"\ensuremath{{\{value}}}" for key, value in _GREEK.items()}
    | _PLAIN
)


def latex_text(text: str) -> str:
    """Return text that LaTeX prints literally: no character of it acts as a command or stops the document.

    Greek letters and signs of mathematics become commands, so that every engine prints them. LuaLaTeX and XeLaTeX
    print other characters if the font has them; pdfLaTeX prints such a letter without its accents, or else ``?``.
    """
    return "".join(_TABLE.get(character) or _letter(character) for character in unicodedata.normalize("NFC", text))


def _letter(character: str) -> str:
    if character.isascii():
        return character if character.isprintable() else " "
    if character in _LATIN:
        return character
    parts = unicodedata.normalize("NFD", character)
    base = parts[0] if parts[0].isascii() and len(parts) > 1 else "?"
    if len(parts) == 2 and ord(character) < 0x180 and parts[0].isascii() and parts[1] != _OGONEK:
        return character
    if unicodedata.combining(character):
        base = ""
    return rf"{{\ifdefined\Umathchar {character}\else {base}\fi}}"
