"""Text in ASCII, for compilers that take a source for a code page of their own."""

from __future__ import annotations

import unicodedata

_SIGNS = {
    "·": "*", "×": "x", "−": "-", "–": "-", "—": "-", "√": "sqrt", "∞": "inf", "∛": "cbrt", "°": "deg", "→": "->",
    "≤": "<=", "≥": ">=", "∈": " in ", "‖": "||", "’": "'", "‘": "'", "“": '"', "”": '"', "…": "...", "µ": "u",
    "∂": "d", "∫": "int ", "±": "+-", "≈": "~", "ß": "ss", "Σ": "sum ",
}  # fmt: skip
_RAISED = dict(zip("⁰¹²³⁴⁵⁶⁷⁸⁹⁻⁺ˣʸᵀⁱⁿᵏˢ", "0123456789-+xyTinks", strict=True))


def ascii_text(text: str) -> str:
    """The same text without any character beyond ASCII: `s²` is `s^2`, `ζ` is `zeta`, an unknown one is `?`.

    No end of a C comment comes into being: `·/` is `* /`.
    """
    found: list[str] = []
    raised = lowered = False
    for character in text:
        code = _SIGNS.get(character)
        up = code is None and character in _RAISED
        down = "SUBSCRIPT" in unicodedata.name(character, "") and not character.isascii()
        if up and not raised:
            found.append("^")
        if down and not lowered:
            found.append("_")
        raised, lowered = up, down
        found.append(character if character.isascii() else code or _RAISED.get(character) or _spelled(character))
    return "".join(found) if "·/" not in text else ascii_text(text.replace("·/", "· /"))


def _spelled(character: str) -> str:
    words = unicodedata.name(character, "").split()
    if words[:1] == ["GREEK"] and "LETTER" in words:
        name = words[words.index("LETTER") + 1].lower().replace("lamda", "lambda")
        return name.capitalize() if words[1] == "CAPITAL" else name
    if unicodedata.combining(character):
        return ""
    return unicodedata.normalize("NFKD", character).encode("ascii", "ignore").decode() or "?"
