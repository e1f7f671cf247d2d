"""The contents of a report, and its HTML page for offline use, from the Jinja2 templates of `templates/`.

HTML pages for offline use: the Jinja2 templates of `templates/`, with the style sheet `page.css`.

Every text is escaped, and an undefined name in a template is an error.  No page loads or runs anything.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from io import StringIO
from typing import TYPE_CHECKING, Any

import numpy as np

from feeddrive.analysis.margins import Margins, margins
from feeddrive.analysis.replay import Replay
from feeddrive.analysis.spectrum import Spectrum, spectrum
from feeddrive.analysis.stiffness import Stiffness, stiffness
from feeddrive.language.quantity import DRAWN, Units
from feeddrive.language.table import Grid, Table, drawn_in
from feeddrive.language.text import marked, plain, resolve, split
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import Run
from feeddrive.machining.part_run import PartRun
from feeddrive.path.planned import Planned
from feeddrive.plot import drawing, style
from feeddrive.plot.chart import Chart

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
_WIDTHS = range(25, 70, 5)  # rem: of screens on which a table may be cut off
_CHARACTER, _BETWEEN, _AROUND = 0.5, 1.2, 4.0  # rem: a character of a table, between two columns, beside the table
_DECIMALS = re.compile(r"\d+\.\d+")
# control characters, which no page may hold, apart from the ends of lines and tabs
_CONTROL = dict.fromkeys([*range(9), *range(11, 32), *range(127, 160)])


def page_units(*, rotary: bool) -> Units:
    """Return the units of a page: typographic, and those of an axis that turns if it is about one."""
    return replace(DRAWN, rotary=rotary)


def render(template: str, *, units: Units = DRAWN, **content: Any) -> str:
    """Return a template of `templates/` with its content as a whole page, in the units of a reader.

    Pure: the same content gives the same text.
    """
    text = _environment().get_template(template).render(widths=_WIDTHS, units=units, **content)
    return resolve(text.translate(_CONTROL), units)


@cache
def _environment() -> Environment:
    from jinja2 import Environment, PackageLoader, StrictUndefined, pass_context
    from markupsafe import Markup, escape

    made = Environment(
        loader=PackageLoader("feeddrive.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )

    @pass_context
    def drawn(context: Any, shown: Shown) -> Markup:
        with drawn_in(context["units"]):
            return Markup(svg(shown.draw(), shown.key, shown.alt))

    def unbroken(text: str) -> Markup:
        """A word joiner keeps a unit such as N/µm on one line, an element one that is still a mark."""
        whole, joined = Markup('<span class="unit">{}</span>'), Markup("/&#8288;")
        pieces = split(marked(text))
        made = (whole.format(each) if is_mark else escape(each).replace("/", joined) for each, is_mark in pieces)
        return Markup("").join(made)

    filters: dict[str, Any] = {"drawn": drawn, "unbroken": unbroken, "beyond": _beyond, "marked": Table.marked}
    made.filters.update(filters)
    return made


def _beyond(heads: Sequence[str], rows: Sequence[Sequence[Any]], text: bool = False) -> str:
    """The class of a table that is cut off on a screen narrower than a width in rem; empty if it never is.

    Heads and the first column break between words, cells only in a table of sentences.
    """

    def columns(cell: Any, breaks: bool) -> int:
        text = plain(marked(str(cell)))
        return max(map(len, re.split(r"[\s-]", text))) if breaks else len(text)

    widest = [
        max(columns(str(row[i]), i == 0 or text or row is heads) for row in (heads, *rows) if i < len(row))
        for i in range(len(heads))
    ]
    needed = _AROUND + sum(_CHARACTER * each + _BETWEEN for each in widest)
    return "" if needed <= _WIDTHS[0] - 5 else f"beyond-{next((w for w in _WIDTHS if w >= needed), _WIDTHS[-1])}"


def _part(name: str, *content: Any, units: Units = DRAWN) -> str:
    return str(getattr(_environment().get_template("parts.html").make_module({"units": units}), name)(*content))


def page(title: str, parts: Sequence[str], units: Units = DRAWN) -> str:
    """Return sections, as HTML, on one page in the units of a reader."""
    from markupsafe import Markup

    return render("page.html", units=units, title=title, body=Markup("".join(map(marked, parts))))


def header(kind: str, title: str, lead: Sequence[str], links: Sequence[tuple[str, str]]) -> str:
    """Headline, the result in sentences, and links to what follows: (identifier, text)."""
    return _part("header", kind, title, lead, links)


def definitions(pairs: Iterable[tuple[str, str]]) -> str:
    """A list of headlines and texts."""
    return _part("definitions", pairs)


def remarks(sentences: Sequence[str], head: str = "Remarks") -> str:
    """Return sentences as a list in a box under a head; nothing if there are none."""
    return _part("remarks", sentences, head)


def picture(shown: Shown, units: Units = DRAWN) -> str:
    """Return a picture in the units of a reader, with its headline and how to read it."""
    return _part("picture", shown, units=units)


def table(caption: str, heads: Sequence[str], rows: Sequence[Sequence[str]], best: Sequence[int | None] = ()) -> str:
    """Rows under heads; the first column names the row. `best` marks one row for each further column."""
    return _part("table", caption, heads, rows, best)


def tabled(found: Table | Grid, caption: str = "") -> str:
    """A table under its own title, or under a caption."""
    grid = found if isinstance(found, Grid) else found.marked()
    return table(caption or grid.title, grid.heads, grid.rows)


def svg(figure: Any, key: str, alt: str) -> str:
    """Return a chart or a matplotlib figure as an SVG element in the colors of the page's theme.

    key  letters that make its identifiers unique among the pictures of one page
    alt  description of the figure
    """
    import matplotlib

    if isinstance(figure, Chart):
        figure = drawing.drawn(figure)
    text = StringIO()
    silent = {"Date": None, "Creator": None, "Format": None, "Type": None}
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": key}), warnings.catch_warnings():
        # the browser has the glyphs that matplotlib's own font lacks
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")
        figure.savefig(text, format="svg", metadata=silent)
    return _inlined(text.getvalue(), key, alt, float(figure.get_figwidth()) / style.WIDTH)


def _inlined(text: str, key: str, alt: str, width: float) -> str:
    from markupsafe import escape

    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>|<defs>\s*<style.*?</defs>", "", text, flags=re.DOTALL)
    box = re.search(r'viewBox="([^"]*)"', text)
    head = f'<svg viewBox="{box[1] if box else ""}" width="{100 * width:.0f}%" role="img" aria-label="{escape(alt)}">'
    body = text[text.index(">") + 1 :].replace("xlink:href", "href")
    # matplotlib writes six decimals: a tenth of a point for a path, a hundredth for what is placed
    body = re.sub(r'(?<= )(d|x|y|width|height|transform)="([^"]*)"', _rounded, body)
    body = _own_identifiers(body, key)
    body = re.sub(r"#[0-9a-f]{6}", lambda found: THEME.get(found[0], found[0]), body)
    body = re.sub(r"font: ([\d.]+)px [^;\"]*", r"font: \1px var(--font)", body)
    return head + re.sub(r">\s+<", "><", body).strip()


def _rounded(found: re.Match[str]) -> str:
    digits = 1 if found[1] == "d" else 2
    return f'{found[1]}="{_DECIMALS.sub(lambda number: f"{float(number[0]):.{digits}f}", found[2])}"'


def _own_identifiers(body: str, key: str) -> str:
    """Rename the identifiers that are referred to, and remove the others."""
    used = list(dict.fromkeys(re.findall(r"(?:url\(|href=\")#([^)\"]+)", body)))
    names = {name: f"{key}{i}" for i, name in enumerate(used)}
    body = re.sub(r' id="([^"]*)"', lambda found: f' id="{names[found[1]]}"' if found[1] in names else "", body)
    return re.sub(r"(url\(|href=\")#([^)\"]+)", lambda found: f"{found[1]}#{names[found[2]]}", body)


RESPONSE_LINES = 1500  # of the frequency responses of an entry, from 1 Hz to Nyquist


@dataclass(frozen=True)
class Shown:
    """A picture that is drawn on demand: a key of letters, a headline, how to read it, a description."""

    key: str
    title: str
    caption: str
    alt: str
    draw: Callable[[], Any]


@dataclass(frozen=True)
class ShownTable:
    """A table of a report.

    best  the row that stands out, for each column after the first; None for none
    text  whether the cells are sentences
    """

    table: Table
    best: Sequence[int | None] = ()
    text: bool = False


@dataclass(frozen=True, eq=False)
class Entry:
    """One law of the comparison: its loop, its run, and its figures in the frequency domain.

    The loop is stable: check it before (`require_stable`).  The run has all signals recorded.  With a `replay` it is
    the prediction, and the samples that the replay skips do not count. `no_model` is the reason if the law has no
    linear model; its stability is then not proven.
    """

    name: str
    description: str
    run: Run
    loop: Loop
    loop_gain: FRF | None = None
    compliance: FRF | None = None
    tracking: FRF | None = None
    no_model: str = ""
    replay: Replay | None = None
    together: Run | None = None  # all axes of a machine in the same run
    part: PartRun | None = None  # its figures along a part program

    def counted(self, signal: str) -> np.ndarray:
        """The samples of a signal that count, in SI."""
        return self.run[signal][0 if self.replay is None else self.replay.skipped :]

    @cached_property
    def shown(self) -> Run:
        """The run without the samples that do not count, for the pictures."""
        skip = 0 if self.replay is None else self.replay.skipped
        signals = {name: values[skip:] for name, values in self.run.signals.items()}
        return replace(self.run, signals=signals, samples=self.run.samples - skip, first=self.run.first + skip)

    def rms(self, signal: str) -> float:
        """RMS of the samples that count, SI."""
        return float(np.sqrt(np.mean(self.counted(signal) ** 2)))

    def peak(self, signal: str) -> float:
        """Largest size of the samples that count, SI."""
        return float(np.max(np.abs(self.counted(signal)), initial=0.0))

    @cached_property
    def margins(self) -> Margins | None:
        """The margins of the loop gain."""
        return None if self.loop_gain is None else margins(self.loop_gain)

    @cached_property
    def stiffness(self) -> Stiffness | None:
        """The inverse of the compliance."""
        return None if self.compliance is None else stiffness(self.compliance)

    @cached_property
    def spectrum(self) -> Spectrum:
        """The spectrum of the following error, without samples that do not count."""
        return spectrum(self.counted("following_error"), self.run.sample_time, name="following_error", unit="m")

    @cached_property
    def limits(self) -> dict[str, float]:
        """Force limits in N by name: commanded, and the motor's peak and continuous one, as far as they are stated."""
        found: dict[str, float] = {}
        limit = self.loop.control.force_limit
        motor = self.loop.axis.actuator.motor
        peak, continuous = (None, None) if motor is None else motor.limits()
        if peak is not None:
            found["motor peak"] = float(peak)
        if limit is not None and (peak is None or abs(limit - peak) > 1e-6 * peak):
            found["commanded limit"] = float(limit)
        if continuous is not None:
            found["motor continuous (RMS)"] = float(continuous)
        return found


@dataclass(frozen=True, eq=False)
class LawsReport:
    """The content of a report. Texts are shown unchanged, escaped.

    entries   one for each law, the first is the one that the others are compared with
    facts machine and run, by headline: machine, reference, load, noise, seed ...
    rule what makes the laws comparable, as a sentence
    job       the exact text of the job
    versions of Python, feeddrive and its libraries, by name
    notes     remarks of the person who ran it
    overview  pictures before all tables
    extras    tables of its own, first in the result
    pictures  pictures of its own, before all others
    planned   the part program that all laws ran, if one
    cuts      what cut while which lines ran, in cells
    """

    title: str
    entries: Sequence[Entry]
    facts: Mapping[str, str] = field(default_factory=dict[str, str])
    rule: str = ""
    job: str = ""
    versions: Mapping[str, str] = field(default_factory=dict[str, str])
    notes: Sequence[str] = ()
    overview: Sequence[Shown] = ()
    extras: Sequence[ShownTable] = ()
    pictures: Sequence[Shown] = ()
    planned: Planned | None = None
    cuts: Sequence[ShownTable] = ()
