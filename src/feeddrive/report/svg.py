"""A figure as a small SVG in a page: colors of the page's theme, short paths, no identifiers that collide."""

from __future__ import annotations

import re
import warnings
from html import escape
from io import StringIO
from typing import Any

from feeddrive.plot import style

# colors of the house style, and the page's variables for them
THEME = {
    style.INK: "var(--ink)",
    style.MUTED: "var(--muted)",
    style.GRID: "var(--grid)",
    style.PAPER: "var(--paper)",
    style.ALERT: "var(--alert)",
    **{color: f"var(--curve-{i})" for i, color in enumerate(style.COLORS)},
}
_NUMBER = re.compile(r"-?\d+\.\d+(?:e[-+]?\d+)?")
_TOKEN = re.compile(r"[MLz]|-?\d+(?:\.\d+)?(?:e[-+]?\d+)?")


def svg(figure: Any, key: str, alt: str) -> str:
    """The SVG element; `key` (letters) makes its identifiers its own, `alt` says what is to be seen."""
    import matplotlib

    text = StringIO()
    silent = {"Date": None, "Creator": None, "Format": None, "Type": None}
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": key}), warnings.catch_warnings():
        # the browser has the glyphs that matplotlib's own font lacks
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")
        figure.savefig(text, format="svg", metadata=silent)
    return _inlined(text.getvalue(), key, alt, float(figure.get_figwidth()) / style.WIDTH)


def _inlined(text: str, key: str, alt: str, width: float) -> str:
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>|<defs>\s*<style.*?</defs>", "", text, flags=re.DOTALL)
    box = re.search(r'viewBox="([^"]*)"', text)
    head = f'<svg viewBox="{box[1] if box else ""}" width="{100 * width:.0f}%" role="img" aria-label="{escape(alt)}">'
    body = text[text.index(">") + 1 :].replace("xlink:href", "href")
    body = re.sub(r' d="([^"]*)"', lambda found: f' d="{_short(found[1])}"', body)
    body = re.sub(r'(?<= )(x|y|width|height|transform)="([^"]*)"', _rounded, body)
    body = _own_identifiers(body, key)
    body = re.sub(r"#[0-9a-f]{6}", lambda found: THEME.get(found[0], found[0]), body)
    body = re.sub(r"font: ([\d.]+)px [^;\"]*", r"font: \1px var(--font)", body)
    body = re.sub(r"<g>\s*</g>", "", re.sub(r">\s+<", "><", body))
    body = re.sub(r"<g([^>]*)>((?:<use [^>]*/>){2,})</g>", _one_style, body)
    return head + body.strip()


def _one_style(found: re.Match[str]) -> str:
    """Marks of one curve with their style on the group in place of each."""
    styles = set(re.findall(r' style="([^"]*)"', found[2]))
    if len(styles) != 1 or "style=" in found[1]:
        return found[0]
    return f'<g{found[1]} style="{styles.pop()}">{re.sub(" style=.[^>/]*", "", found[2])}</g>'


def _rounded(found: re.Match[str]) -> str:
    return f'{found[1]}="{_NUMBER.sub(lambda number: _plain(round(float(number[0]), 2)), found[2])}"'


def _own_identifiers(body: str, key: str) -> str:
    """Identifiers that something refers to, renamed; the others left out."""
    used = list(dict.fromkeys(re.findall(r"(?:url\(|href=\")#([^)\"]+)", body)))
    names = {name: f"{key}{i}" for i, name in enumerate(used)}
    body = re.sub(r' id="([^"]*)"', lambda found: f' id="{names[found[1]]}"' if found[1] in names else "", body)
    return re.sub(r"(url\(|href=\")#([^)\"]+)", lambda found: f"{found[1]}#{names[found[2]]}", body)


def _short(path: str) -> str:
    """A path in tenths of a point, as differences where it has straight lines only."""
    if re.search(r"[CQHVSTA]", path):
        return _NUMBER.sub(lambda number: _plain(round(float(number[0]), 2)), " ".join(path.split()))
    tokens = _TOKEN.findall(path)
    parts: list[str] = []
    x = y = 0
    i, drawing = 0, ""
    while i < len(tokens):
        token = tokens[i]
        if token == "z":
            parts.append("z")
            i, drawing = i + 1, ""
            continue
        at = round(10.0 * float(tokens[i + 1])), round(10.0 * float(tokens[i + 2]))
        i += 3
        if token == "M":
            parts.append(f"M{_tenths(at[0])}{_joined(at[1])}")
            drawing = ""
        elif at != (x, y):
            step = f"{_tenths(at[0] - x)}{_joined(at[1] - y)}"
            parts.append(step if drawing and step.startswith("-") else f" {step}" if drawing else f"l{step}")
            drawing = "l"
        x, y = at
    return "".join(parts)


def _joined(tenths: int) -> str:
    text = _tenths(tenths)
    return text if text.startswith("-") else f" {text}"


def _tenths(tenths: int) -> str:
    return _plain(tenths / 10)


def _plain(value: float) -> str:
    """The shortest text of a number with few decimals: 12, .5, -.3."""
    text = f"{value:.2f}".rstrip("0").rstrip(".")
    text = "0" if text in ("-0", "") else text
    return re.sub(r"^(-?)0\.", r"\1.", text)
