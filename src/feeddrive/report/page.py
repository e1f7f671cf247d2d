"""The HTML writer for reports: one self-contained page for offline use, from the template `templates/report.html`.

All text is escaped, and an undefined name in the template is an error.  A page loads no resources and runs no scripts.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from feeddrive.files.atomic_io import new_directory
from feeddrive.language.errors import sentence
from feeddrive.language.quantity import DRAWN, Units
from feeddrive.language.table import Grid, Table, drawn_in
from feeddrive.language.text import marked, plain, resolve, split
from feeddrive.plot import style
from feeddrive.plot.chart import Chart
from feeddrive.plot.drawing import drawn
from feeddrive.report.report import Marked, Part, Picture, Report

if TYPE_CHECKING:
    from jinja2 import Environment

# colors of the house style, and the page's variables for them
THEME = {
    style.INK: "var(--ink)",
    style.MUTED: "var(--muted)",
    style.GRID: "var(--grid)",
    style.PAPER: "var(--paper)",
    style.ALERT: "var(--alert)",
    **{color: f"var(--curve-{i})" for i, color in enumerate(style.COLORS)},
}
_WIDTHS = range(25, 70, 5)  # rem: screen widths at which a table may be cut off
_CHARACTER, _BETWEEN, _AROUND = 0.5, 1.2, 4.0  # rem: character width, column gap, margin of a table
_DECIMALS = re.compile(r"\d+\.\d+")
# control characters other than line ends and tabs, which a page must not contain
_CONTROL = dict.fromkeys([*range(9), *range(11, 32), *range(127, 160)])


def page_units(*, rotary: bool) -> Units:
    """Return the units of a page: typographic symbols, and rotary units for a rotary axis."""
    return replace(DRAWN, rotary=rotary)


def html(report: Report, units: Units | None = None) -> str:
    """Return a report as a complete HTML page without scripts or external files.

    units  the display units; None: those of `page_units`

    The same report always gives identical HTML.
    """
    units = page_units(rotary=report.rotary) if units is None else units
    text = _environment().get_template("report.html").render(report=report, units=units, widths=_WIDTHS)
    # quantities are placeholders until here: units are chosen once, after all texts are in place
    return resolve(text.translate(_CONTROL), units)


def write_page(out: str | Path, report: Report, texts: Mapping[str, str]) -> Path:
    """Write a directory that holds a report and further texts (file name to content); return the report's path.

    Raises FileError if `out` cannot be written, or is a directory that feeddrive did not write.
    """
    with new_directory(out) as folder:
        for name, text in {"report.html": html(report), **texts}.items():
            (folder / name).parent.mkdir(exist_ok=True)
            (folder / name).write_text(text, encoding="utf-8")
    return Path(out) / "report.html"


@cache
def _environment() -> Environment:
    # imported on use: most commands write no page, and would start later
    from jinja2 import Environment, PackageLoader, StrictUndefined, pass_context
    from markupsafe import Markup, escape

    environment = Environment(
        loader=PackageLoader("feeddrive.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )

    @pass_context
    def picture(context: Any, shown: Picture) -> Markup:
        with drawn_in(context["units"]):
            return Markup(svg(shown.chart(), shown.key, shown.alt))

    def unbroken(text: str) -> Markup:
        """Prevent a line break within a unit such as N/µm.

        A word joiner follows the slash; a unit that is a placeholder is enclosed in a <span>.
        """
        whole, joined = Markup('<span class="unit">{}</span>'), Markup("/&#8288;")
        pieces = split(marked(text))
        escaped = (whole.format(piece) if is_mark else escape(piece).replace("/", joined) for piece, is_mark in pieces)
        return Markup("").join(escaped)

    filters: dict[str, Any] = {"drawn": picture, "unbroken": unbroken, "beyond": _beyond, "kind": _kind, "grid": _grid}
    environment.filters.update(filters)
    return environment


def _kind(part: Part) -> str:
    """Return the name of the template macro that writes a part."""
    if isinstance(part, str):
        return "text"
    return "table" if isinstance(part, Table | Grid | Marked) else type(part).__name__.lower()


def _grid(part: Table | Grid | Marked) -> Grid:
    """Return a table whose cells are strings with placeholders for quantities, and whose title ends as a sentence."""
    table = part.table if isinstance(part, Marked) else part
    grid = table if isinstance(table, Grid) else table.marked()
    ends = plain(grid.title).rstrip()[-1:] in (".", ":", "?", "!", "")
    return grid if ends else grid._replace(title=marked(sentence(grid.title)))


def _beyond(heads: Sequence[str], rows: Sequence[Sequence[Any]], text: bool = False) -> str:
    """Return the CSS class that states the screen width (rem) below which a table does not fit; "" if it always fits.

    Column heads and the first column may wrap between words, other cells only in a table of sentences.
    """

    def columns(cell: Any, breaks: bool) -> int:
        text = plain(marked(str(cell)))
        return max(map(len, re.split(r"[\s-]", text))) if breaks else len(text)

    widest = [
        max(columns(str(row[i]), i == 0 or text or row is heads) for row in (heads, *rows) if i < len(row))
        for i in range(len(heads))
    ]
    needed = _AROUND + sum(_CHARACTER * width + _BETWEEN for width in widest)
    # the style sheet has one class for each width: a media query cannot compare with a variable
    return "" if needed <= _WIDTHS[0] - 5 else f"beyond-{next((w for w in _WIDTHS if w >= needed), _WIDTHS[-1])}"


def svg(chart: Chart, key: str, alt: str) -> str:
    """Return a chart as an SVG element in the colors of the page's theme.

    key  prefix that makes its identifiers unique among the pictures of a page
    alt  description of the picture
    """
    import matplotlib

    figure = drawn(chart)
    text = StringIO()
    # these entries differ from run to run or from version to version: without them equal reports give equal bytes
    silent = {"Date": None, "Creator": None, "Format": None, "Type": None}
    # texts stay texts; identifiers come from the key, since matplotlib's own are random and no two pages would be equal
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": key}), warnings.catch_warnings():
        # glyphs missing from matplotlib's font are available in the browser
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")
        figure.savefig(text, format="svg", metadata=silent)
    return _inlined(text.getvalue(), key, alt, float(figure.get_figwidth()) / style.WIDTH)


def _inlined(text: str, key: str, alt: str, width: float) -> str:
    from markupsafe import escape

    # an element of the page: neither the XML head nor matplotlib's style sheet, which would act on the whole page
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>|<defs>\s*<style.*?</defs>", "", text, flags=re.DOTALL)
    box = re.search(r'viewBox="([^"]*)"', text)
    head = f'<svg viewBox="{box[1] if box else ""}" width="{100 * width:.0f}%" role="img" aria-label="{escape(alt)}">'
    body = text[text.index(">") + 1 :].replace("xlink:href", "href")
    # matplotlib writes six decimals: keep one for paths, two for positions
    body = re.sub(r'(?<= )(d|x|y|width|height|transform)="([^"]*)"', _rounded, body)
    # pictures of one page share its identifiers: those of matplotlib would clash
    body = _own_identifiers(body, key)
    # colors by variables, so that a dark page recolors its pictures
    body = re.sub(r"#[0-9a-f]{6}", lambda match: THEME.get(match[0], match[0]), body)
    body = re.sub(r"font: ([\d.]+)px [^;\"]*", r"font: \1px var(--font)", body)
    return head + re.sub(r">\s+<", "><", body).strip()


def _rounded(match: re.Match[str]) -> str:
    digits = 1 if match[1] == "d" else 2
    return f'{match[1]}="{_DECIMALS.sub(lambda number: f"{float(number[0]):.{digits}f}", match[2])}"'


def _own_identifiers(body: str, key: str) -> str:
    """Rename the identifiers that are referenced within an SVG element, and remove the others."""
    # a dict and not a set, whose order of texts changes from process to process
    used = list(dict.fromkeys(re.findall(r"(?:url\(|href=\")#([^)\"]+)", body)))
    names = {name: f"{key}{i}" for i, name in enumerate(used)}
    body = re.sub(r' id="([^"]*)"', lambda match: f' id="{names[match[1]]}"' if match[1] in names else "", body)
    return re.sub(r"(url\(|href=\")#([^)\"]+)", lambda match: f"{match[1]}#{names[match[2]]}", body)
