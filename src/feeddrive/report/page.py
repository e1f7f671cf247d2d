"""The HTML writer for reports: one self-contained page for offline use, from the template `templates/report.html`.

All text is escaped, and an undefined name in the template is an error.  A page loads no resources and runs no scripts.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

from feeddrive.files.atomic_io import new_directory
from feeddrive.language.errors import sentence
from feeddrive.language.machine_code import cache_directory
from feeddrive.language.quantity import DRAWN, Units
from feeddrive.language.table import READER, Grid, Table, drawn_in
from feeddrive.language.text import marked, plain, resolve, split
from feeddrive.plot import style
from feeddrive.plot.chart import Chart
from feeddrive.report.report import Marked, Part, Picture, Report
from feeddrive.report.svg import svg_element

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
    **{style.heat(k): f"var(--heat-{k})" for k in range(style.HEAT_STEPS)},
}
_HEAT = {
    look: [style.heat(k, colors) for k in range(style.HEAT_STEPS)]
    for look, colors in (("light", style.HEAT), ("dark", style.DARK_HEAT))
}
_WIDTHS = range(25, 70, 5)  # rem: screen widths at which a table may be cut off
_CHARACTER, _BETWEEN, _AROUND = 0.5, 1.2, 4.0  # rem: character width, column gap, margin of a table
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
    text = _environment().get_template("report.html").render(report=report, units=units, widths=_WIDTHS, heat=_HEAT)
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
    import jinja2
    from jinja2 import Environment, FileSystemBytecodeCache, PackageLoader, StrictUndefined, pass_context
    from markupsafe import Markup, escape

    options: dict[str, Any] = {
        "autoescape": True,
        "undefined": StrictUndefined,
        "trim_blocks": True,
        "lstrip_blocks": True,
    }
    # the compiled template depends on these; Jinja itself looks at its text only
    digest = sha256(f"{jinja2.__version__} {options}".encode()).hexdigest()
    folder = cache_directory()
    kept = FileSystemBytecodeCache(str(folder), f"template_{digest[:32]}_%s") if folder else None
    environment = Environment(loader=PackageLoader("feeddrive.report"), bytecode_cache=kept, **options)

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
    return svg_element(chart.shown(READER.get()), key, alt, THEME)
