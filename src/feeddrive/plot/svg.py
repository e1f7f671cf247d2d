"""Charts as SVG for pages: texts stay texts, colors are the page's variables, and nothing but numpy is needed.

`svg` lays a chart out in four steps: the ranges of all axes, their ticks, the room that ticks, labels and legends need,
and the frames of the panels in the room that is left. Lengths are points, 72 in an inch; y points down.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from itertools import pairwise

import numpy as np

from feeddrive.plot import chart as looks
from feeddrive.plot import placing, style, ticks
from feeddrive.plot.chart import Abscissa, Band, Box, Chart, Curve, Disc, Field, Heat, Level, Note, Panel, Tick
from feeddrive.plot.placing import LINE, width
from feeddrive.plot.polyline import cut, thinned
from feeddrive.plot.style import SMALL, TEXT

_INCH = 72.0
_EDGE = 4.0  # around all
_TICK, _GAP = 3.5, 3.0  # length of a tick, and the gap to its text
_SAMPLE, _BETWEEN = 24.0, 14.0  # a legend entry: its sample, and the gap to the next one
_ROW = 1.45 * SMALL  # height of a row of a legend
_APART = 8.0  # between panels
_BAR = 9.0  # width of a color bar
_MARGIN = 0.05  # share of a range that is left free at both ends
_SQUARE_MARGIN = 0.04  # the same of equal scales
_TURN = 40.0  # degrees of slanted texts
_LOW = 30.0  # the least height of a panel; a picture with more around it becomes higher
_FINE_GRID = 25.0  # the least length of a decade that has a fine grid
_FINE = 0.01  # unit of the paths of curves
_CLIPPED = 2.0  # beyond the frame: half a line at the edge is not cut off
_DENSE = 3  # paths of a cloud of pale points, so that overlaps look darker

Extent = tuple[float, float, float, float]


def svg(chart: Chart, key: str, alt: str, colors: Mapping[str, str] | None = None) -> str:
    """Return a chart, with its texts in display units, as an SVG element.

    key     prefix that makes its identifiers unique on a page
    alt     description of the picture
    colors  what replaces the colors of the house style, such as variables of a page; None: they stay
    """
    return _Drawing(chart, key, colors or {}).element(alt)


@dataclass
class _Axis:
    """An axis from `low` at the place `begin` to `high` at the place `end`."""

    low: float
    high: float
    log: bool
    begin: float = 0.0
    end: float = 1.0

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """Return the places of values; NaN for a value that a logarithmic axis does not have."""
        low, high = self.low, self.high
        if self.log:
            with np.errstate(divide="ignore", invalid="ignore"):
                values = np.log10(np.where(values > 0.0, values, np.nan))
            low, high = np.log10(low), np.log10(high)
        return self.begin + (np.asarray(values, np.float64) - low) * ((self.end - self.begin) / (high - low))

    def at(self, value: float) -> float:
        """Return the place of a value."""
        return float(self(np.asarray(value, np.float64)))

    def holds(self, value: float) -> bool:
        """Return True if a value lies on the axis."""
        slack = 1e-9 * (self.high - self.low)
        return self.low - slack <= value <= self.high + slack


@dataclass
class _Frame:
    """A panel with its axes; `ends` if the texts of x stand below it, `labeled` if its label does."""

    panel: Panel
    abscissa: Abscissa
    row: int
    column: int
    x: _Axis
    y: _Axis
    ends: bool = True
    labeled: bool = True
    x_ticks: ticks.Ticks = field(default_factory=lambda: ticks.Ticks((), ()))
    y_ticks: ticks.Ticks = field(default_factory=lambda: ticks.Ticks((), ()))
    legend: list[_Entry] = field(default_factory=list)

    @property
    def table(self) -> bool:
        return any(box.level is not None for box in self.panel.boxes)

    @property
    def wide(self) -> float:
        return self.x.end - self.x.begin

    @property
    def tall(self) -> float:
        return self.y.begin - self.y.end


@dataclass(frozen=True)
class _Entry:
    """An entry of a legend: its text and what it is the sample of."""

    text: str
    of: Curve | Band | Box | Level
    dashes: tuple[float, ...] = ()


class _Drawing:
    def __init__(self, chart: Chart, key: str, colors: Mapping[str, str]) -> None:
        self.chart, self.key, self.colors = chart, key, colors
        self.parts = list[str]()
        self.identifiers = 0
        self.wide, self.tall = _INCH * chart.width, _INCH * chart.height
        self.frames = _frames(chart)
        self.columns = max(frame.column for frame in self.frames) + 1
        self.rows = max(frame.row for frame in self.frames) + 1
        self.legend = self._entries()

    def element(self, alt: str) -> str:
        """Return the SVG element."""
        # texts take room from the panels, and narrower panels have fewer texts
        self._ranges()
        for _ in range(3):
            self._lay_out()
        self._headings()
        for frame in self.frames:
            self._frame(frame)
        share = 100.0 * self.chart.width / style.WIDTH
        head = (
            f'<svg viewBox="0 0 {_n(self.wide)} {_n(self.tall)}" width="{share:.0f}%" role="img"'
            f' aria-label="{escape(alt)}" font-family="var(--font, sans-serif)">'
        )
        return f"{head}<desc>{escape(_description(self.frames))}</desc>{''.join(self.parts)}</svg>"

    # ranges and layout

    def _ranges(self) -> None:
        """Set the ranges of all axes; panels without their own x axis share theirs."""
        together = [frame for frame in self.frames if frame.panel.abscissa is None]
        for frame in self.frames:
            panels = [frame.panel] if frame.panel.abscissa is not None else [other.panel for other in together]
            margin = _SQUARE_MARGIN if frame.abscissa.square and frame.abscissa.low is None else 0.0
            given = frame.abscissa.low, frame.abscissa.high
            frame.x.low, frame.x.high = _range(panels, True, frame.x.log, given, margin)
            margin = _MARGIN if not frame.abscissa.square or frame.abscissa.low is not None else _SQUARE_MARGIN
            given = frame.panel.low, frame.panel.high
            frame.y.low, frame.y.high = _range([frame.panel], False, frame.y.log, given, margin)
            if frame.panel.scale == looks.DEGREES:
                step = ticks.phase_step(frame.y.low, frame.y.high)
                frame.y.low, frame.y.high = style.phase_range(frame.y.low, frame.y.high, step)
        self.data = [(frame.x.low, frame.x.high, frame.y.low, frame.y.high) for frame in self.frames]

    def _lay_out(self) -> None:
        chart = self.chart
        for frame in self.frames:
            self._tick(frame)
        left, right = [0.0] * self.columns, [0.0] * self.columns
        above, below = [0.0] * self.rows, [0.0] * self.rows
        for frame in self.frames:
            last = self.columns - 1 if frame.panel.whole else frame.column
            sides = self._around(frame)
            left[frame.column], right[last] = max(left[frame.column], sides[0]), max(right[last], sides[2])
            above[frame.row], below[frame.row] = max(above[frame.row], sides[1]), max(below[frame.row], sides[3])
        begin = _EDGE + (LINE * TEXT + 2.0 if chart.side else 0.0)
        end = self.wide - _EDGE
        if chart.legend == looks.RIGHT and self.legend:
            end -= max(_entry_width(entry) for entry in self.legend) + _BETWEEN
        top = _EDGE + (LINE * TEXT + 4.0 if chart.caption else 0.0)
        self.legend_top = top
        self.legend_rows = _rows(self.legend, chart.columns, end - begin) if chart.legend != looks.RIGHT else []
        top += _height(self.legend_rows) + (4.0 if self.legend_rows else 0.0)
        # further rows of the legend do not make the panels smaller
        fixed = top + sum(above) + sum(below) + _APART * (self.rows - 1) + _EDGE
        further = _height(self.legend_rows[1:])
        self.tall = max(_INCH * chart.height + further, fixed + _LOW * self.rows)
        widths, heights = [0.0] * self.columns, [0.0] * self.rows
        for frame in self.frames:
            heights[frame.row] = max(heights[frame.row], frame.panel.share)
            if not frame.panel.whole:
                widths[frame.column] = max(widths[frame.column], frame.panel.width)
        widths = [share or 1.0 for share in widths]
        room = end - begin - sum(left) - sum(right) - _APART * (self.columns - 1)
        across = _places(begin, room, widths, left, right)
        down = _places(top, self.tall - fixed, heights, above, below)
        for frame, data in zip(self.frames, self.data, strict=True):
            last = across[-1] if frame.panel.whole else across[frame.column]
            frame.x.begin, frame.x.end = across[frame.column][0], last[1]
            frame.y.end, frame.y.begin = down[frame.row]
            if frame.abscissa.square:
                self._square(frame, data)
        self.labels = [across[column][0] - left[column] for column in range(self.columns)]
        self.legend_at = begin if chart.legend != looks.RIGHT else end + _BETWEEN
        self.inside = begin, top, end, self.tall - _EDGE
        for frame in self.frames:
            own = chart.legend == looks.PANELS
            frame.legend = list(_unique(_panel_entries(frame.panel))) if own else []

    def _tick(self, frame: _Frame) -> None:
        abscissa, x, y = frame.abscissa, frame.x, frame.y
        sized = frame.x.end - frame.x.begin > 2.0
        wide, tall = (frame.wide, frame.tall) if sized else (self.wide / self.columns - 40.0, self.tall / self.rows)
        if abscissa.ticks is not None:
            frame.x_ticks = _named_ticks(abscissa.ticks, x)
        else:
            for most in range(min(10, max(1, int(wide / 40.0))), 0, -1):
                frame.x_ticks = _divided(x, abscissa.scale, float(most))
                widest = max((width(text, SMALL) for text in frame.x_ticks.texts), default=0.0)
                if _spacing(frame.x_ticks.values, x, wide) >= widest + 7.0:
                    break
        if frame.panel.ticks is not None:
            frame.y_ticks = _named_ticks(frame.panel.ticks, y)
        elif frame.panel.scale == looks.DEGREES:
            step = ticks.phase_step(y.low, y.high)
            frame.y_ticks = ticks.linear(y.low, y.high, 1.0)
            for each in (step, 2.0 * step, 4.0 * step):
                values = np.arange(y.low, y.high + 0.5 * step, each)
                frame.y_ticks = ticks.Ticks(list(values), [ticks.signed(float(value), 0) for value in values])
                if tall * each / (y.high - y.low) >= 1.3 * SMALL:
                    break
        else:
            frame.y_ticks = _divided(y, frame.panel.scale, min(9.0, max(2.0, tall / 18.0)))
            if len(frame.y_ticks.values) < 3:
                finer = _divided(y, frame.panel.scale, max(2.0, tall / (1.4 * SMALL)))
                frame.y_ticks = max(frame.y_ticks, finer, key=lambda divided: len(divided.values))

    def _around(self, frame: _Frame) -> Extent:
        """Return the room that a panel needs left, above, right and below."""
        if self.chart.bare and frame.panel.abscissa is None:
            return 2.0, self._over(frame), 2.0, 2.0
        texts = max((width(text, SMALL) for text in frame.y_ticks.texts), default=0.0)
        label = LINE * TEXT * len(self._y_label(frame)) + 2.0 if frame.panel.label else 0.0
        ends = [width(text, SMALL) for text in frame.x_ticks.texts] if frame.ends else []
        left = max(label + texts + _TICK + _GAP, 0.5 * ends[0] if ends else 0.0)
        over, right, below = self._over(frame), max(4.0, 0.5 * ends[-1] if ends else 0.0), 2.0
        if frame.ends and any(frame.x_ticks.texts):
            below = _TICK + _GAP + LINE * SMALL
            if self._slanted(frame):
                turned = np.sin(np.radians(_TURN)) * max(ends) + SMALL
                over, below = (over + turned, 2.0) if frame.table else (over, _TICK + _GAP + turned)
                along = np.cos(np.radians(_TURN)) * max(ends)
                right = max(right, along if frame.table else 4.0)
        if frame.labeled and frame.abscissa.label:
            below += 2.0 + LINE * TEXT * len(self._x_label(frame))
        if frame.x_ticks.power and frame.ends:
            right = max(right, width(frame.x_ticks.power, SMALL) + 4.0)
        if _scaled(frame.panel) is not None:
            bar = _divided(_Axis(*_heat_range(frame.panel), False), looks.LINEAR, 5.0)
            right = 8.0 + _BAR + _TICK + _GAP + max(width(text, SMALL) for text in bar.texts) + LINE * TEXT + 4.0
        if self.chart.beside and frame is self.frames[0]:
            right += 10.0 + width(self.chart.beside, SMALL)
        return left, over, right, below

    def _over(self, frame: _Frame) -> float:
        """Return the room above a panel: its legend, its line of text and its power of ten."""
        caption = _title(frame.panel.caption, most=120) if frame.panel.caption else ""
        over = _height(self._own_legend(frame))
        if caption and not self._beside_legend(frame):
            over += _ROW
        return 3.0 + (over or (_ROW if frame.y_ticks.power else 0.0))

    def _own_legend(self, frame: _Frame) -> _LegendRows:
        """Return the rows of the legend of a panel, beside the power of ten of its y axis."""
        return _rows(frame.legend, 4, frame.wide - self._power(frame))

    def _power(self, frame: _Frame) -> float:
        return width(frame.y_ticks.power, SMALL) + 8.0 if frame.y_ticks.power else 0.0

    def _beside_legend(self, frame: _Frame) -> bool:
        """Return True if the last row of the legend leaves room for the line of text."""
        rows = self._own_legend(frame)
        if not rows:
            return False
        used = max(x for x, _ in rows[-1]) + _entry_width(rows[-1][-1][1])
        return used + self._power(frame) + _BETWEEN + width(_title(frame.panel.caption, most=120), SMALL) <= frame.wide

    def _y_label(self, frame: _Frame) -> list[str]:
        return placing.wrapped(frame.panel.label, TEXT, max(frame.tall + 4.0, 60.0)).split("\n")

    def _x_label(self, frame: _Frame) -> list[str]:
        return placing.wrapped(frame.abscissa.label, TEXT, max(frame.wide + 20.0, 90.0)).split("\n")

    def _slanted(self, frame: _Frame) -> bool:
        """Return True if the texts of x do not fit beside each other."""
        if frame.table:
            return True
        texts = [(x, width(text, SMALL)) for x, text in zip(frame.x_ticks.values, frame.x_ticks.texts, strict=True)]
        places = sorted((frame.x.at(x), wide) for x, wide in texts if wide)
        return any(b - a < 0.5 * (u + v) + 3.0 for (a, u), (b, v) in pairwise(places))

    def _square(self, frame: _Frame, data: Extent) -> None:
        """Give x and y the same scale: fixed ranges change the shape of the panel, others become wider."""
        x, y = frame.x, frame.y
        x.low, x.high, y.low, y.high = data
        across, up = frame.wide / (x.high - x.low), frame.tall / (y.high - y.low)
        unit = min(across, up)
        if frame.abscissa.low is None:
            middle, half = 0.5 * (x.low + x.high), 0.5 * frame.wide / unit
            x.low, x.high = middle - half, middle + half
            middle, half = 0.5 * (y.low + y.high), 0.5 * frame.tall / unit
            y.low, y.high = middle - half, middle + half
            return
        spare = frame.wide - unit * (x.high - x.low)
        x.begin += 0.0 if self.chart.beside else 0.5 * spare
        x.end = x.begin + unit * (x.high - x.low)
        spare = frame.tall - unit * (y.high - y.low)
        y.end += 0.5 * spare
        y.begin = y.end + unit * (y.high - y.low)

    # texts around the panels

    def _entries(self) -> list[_Entry]:
        """Return the entries of the common legend, levels last; with a legend for each panel, levels alone."""
        panels = self.chart.panels
        curves = [] if self.chart.legend == looks.PANELS else [e for panel in panels for e in _panel_entries(panel)]
        levels = [
            _Entry(_title("", level.caption), level, _level_dashes(panel, level))
            for panel in panels
            for level in panel.levels
            if level.caption
        ]
        limits = {entry.text for entry in levels}
        return [*_unique(entry for entry in curves if entry.text not in limits), *_unique(levels)]

    def _headings(self) -> None:
        chart, (begin, top, end, bottom) = self.chart, self.inside
        if chart.caption:
            text = _title(chart.caption, most=120)
            self._text(0.5 * (begin + end), _EDGE + TEXT, text, TEXT, style.ALERT, "middle")
        if chart.legend == looks.RIGHT:
            self._legend(self.legend_at, self.legend_top, [[(0.0, entry)] for entry in self.legend])
        self._legend(self.legend_at, self.legend_top, self.legend_rows)
        if chart.side:
            self._text(_EDGE + TEXT, 0.5 * (top + bottom), chart.side, TEXT, style.INK, "middle", turn=-90.0)

    def _legend(self, x: float, y: float, rows: _LegendRows) -> None:
        """Draw the rows of a legend from (x, y)."""
        for row in rows:
            for along, entry in row:
                self._entry(x + along, y + 0.5 * _ROW, entry)
            y += _height([row])

    def _entry(self, x: float, y: float, entry: _Entry) -> None:
        """Draw an entry of a legend with its sample from x, centered on y."""
        thing, end = entry.of, x + _SAMPLE - 6.0
        if isinstance(thing, Curve) and thing.look != looks.SOLID and thing.reach is None:
            stroke = style.stroke(thing)
            tint = self._tint(_color(thing.number, _neutral(thing)))
            if stroke.line:
                self._add(f'<path d="M{_n(x)} {_n(y)}H{_n(end)}" {_line(tint, stroke.line, stroke.dashes)}/>')
            if stroke.marker:
                self._markers(np.array([0.5 * (x + end)]), np.array([y]), stroke, tint)
        elif isinstance(thing, Level):
            tint = self._tint(_color(thing.number, style.MUTED if thing.dashed or thing.faint else style.INK))
            self._add(f'<path d="M{_n(x)} {_n(y)}H{_n(end)}" {_line(tint, 1.0, entry.dashes)}/>')
        else:
            look = f'fill="{self._tint(_color(thing.number, style.MUTED))}"'
            if isinstance(thing, Band):
                look += f' fill-opacity="{style.BAND}"'
            elif isinstance(thing, Curve) and thing.reach is not None:
                look += f' fill-opacity="{style.PALE}"'
            elif isinstance(thing, Box):
                look = self._box_look(thing)
            self._add(f'<rect x="{_n(x)}" y="{_n(y - 3.2)}" width="{_n(end - x)}" height="6.4" {look}/>')
        self._text(x + _SAMPLE, y + 0.35 * SMALL, entry.text, SMALL, style.INK)

    # a panel

    def _frame(self, frame: _Frame) -> None:
        panel, x, y = frame.panel, frame.x, frame.y
        bare = self.chart.bare and panel.abscissa is None
        identifier = self._identifier()
        left, top = x.begin - _CLIPPED, y.end - _CLIPPED
        self._add(
            f'<clipPath id="{identifier}"><rect x="{_n(left)}" y="{_n(top)}" '
            f'width="{_n(frame.wide + 2.0 * _CLIPPED)}" height="{_n(frame.tall + 2.0 * _CLIPPED)}"/></clipPath>'
        )
        if not bare:
            self._grid(frame)
        self._add(f'<g clip-path="url(#{identifier})" stroke-linejoin="round">')
        # what is drawn later covers what is below: areas first, then curves, then marks and words
        for curve in panel.curves:
            if curve.reach is not None:
                self._reach(frame, curve, curve.reach)
        for box in panel.boxes:
            self._box(frame, box)
        if panel.field is not None and panel.heat is not None:
            self._field(frame, panel.field, panel.heat)
        for disc in panel.discs:
            self._disc(frame, disc)
        for band in panel.bands:
            self._band(frame, band)
        for level in panel.levels:
            self._level(frame, level)
        for curve in panel.curves:
            if curve.reach is not None:
                continue
            if curve.heat is None:
                self._curve(frame, curve)
            elif panel.heat is not None:
                self._heat(frame, curve, curve.heat, panel.heat)
        self._add("</g>")
        if not bare:
            self._axes(frame)
        self._marks(frame)
        self._words(frame)
        if _scaled(panel) is not None:
            self._scale(frame)
        if self.chart.beside and frame is self.frames[0]:
            lines = self.chart.beside.count("\n")
            above = 0.5 * (y.begin + y.end) - 0.5 * lines * 1.5 * SMALL + 0.35 * SMALL
            self._text(x.end + 10.0, above, self.chart.beside, SMALL, style.INK, spacing=1.5)

    def _grid(self, frame: _Frame) -> None:
        panel, x, y = frame.panel, frame.x, frame.y
        if frame.table or panel.field is not None:
            return
        axes = [(x, frame.x_ticks, frame.abscissa.ticks), (y, frame.y_ticks, panel.ticks)]
        for minor in (True, False):
            path = ""
            for axis, divided, given in axes:
                # positions with names have no lines, and a fine grid needs room
                if any(tick.name for tick in given or ()) or (minor and _decade(axis) < _FINE_GRID):
                    continue
                for at in (_n(axis.at(value)) for value in (divided.minor if minor else divided.values)):
                    path += f"M{at} {_n(y.begin)}V{_n(y.end)}" if axis is x else f"M{_n(x.begin)} {at}H{_n(x.end)}"
            if path:
                self._add(f'<path d="{path}" {_line(self._tint(style.GRID), 0.4 if minor else 0.8)}/>')

    def _axes(self, frame: _Frame) -> None:
        panel, x, y, muted = frame.panel, frame.x, frame.y, self._tint(style.MUTED)
        if not frame.table:
            path = f"M{_n(x.begin)} {_n(y.end)}V{_n(y.begin)}H{_n(x.end)}"
            for at in (x.at(value) for value in frame.x_ticks.values):
                path += f"M{_n(at)} {_n(y.begin)}v{_TICK}"
            for at in (y.at(value) for value in frame.y_ticks.values):
                path += f"M{_n(x.begin)} {_n(at)}h-{_TICK}"
            for at in (x.at(value) for value in frame.x_ticks.minor):
                path += f"M{_n(at)} {_n(y.begin)}v2"
            for at in (y.at(value) for value in frame.y_ticks.minor):
                path += f"M{_n(x.begin)} {_n(at)}h-2"
            self._add(f'<path d="{path}" {_line(muted, 0.8)}/>')
        if frame.ends:
            slanted = self._slanted(frame)
            for value, text in zip(frame.x_ticks.values, frame.x_ticks.texts, strict=True):
                if frame.table:
                    self._text(x.at(value), y.end - 4.0, text, SMALL, style.INK, turn=-_TURN)
                elif slanted:
                    self._text(x.at(value) + 3.0, y.begin + _TICK + SMALL, text, SMALL, style.INK, "end", -_TURN)
                else:
                    self._text(x.at(value), y.begin + _TICK + _GAP + 0.8 * SMALL, text, SMALL, style.INK, "middle")
            if frame.x_ticks.power:
                self._text(x.end + 4.0, y.begin, frame.x_ticks.power, SMALL, style.MUTED)
        for value, text in zip(frame.y_ticks.values, frame.y_ticks.texts, strict=True):
            self._text(x.begin - _TICK - _GAP, y.at(value) + 0.35 * SMALL, text, SMALL, style.INK, "end")
        if frame.y_ticks.power:
            self._text(x.begin, y.end - 4.0, frame.y_ticks.power, SMALL, style.MUTED)
        if frame.labeled and frame.abscissa.label:
            lines = self._x_label(frame)
            room = self._around(frame)[3] - LINE * TEXT * len(lines)
            self._text(0.5 * (x.begin + x.end), y.begin + room + TEXT, "\n".join(lines), TEXT, style.INK, "middle")
        if panel.label:
            lines = "\n".join(self._y_label(frame))
            left = self.labels[frame.column]
            if frame.abscissa.square:  # beside the panel, which is narrower than its column
                left = x.begin - self._around(frame)[0]
            self._text(left + TEXT, 0.5 * (y.begin + y.end), lines, TEXT, style.INK, "middle", -90.0)

    def _words(self, frame: _Frame) -> None:
        """Write what stands above a panel and on it."""
        panel, x, y = frame.panel, frame.x, frame.y
        rows = self._own_legend(frame)
        if caption := _title(panel.caption, most=120) if panel.caption else "":
            # above the legend, unless its last row leaves room
            up = 0.0 if self._beside_legend(frame) else _height(rows)
            self._text(x.end, y.end - 3.0 - up - 0.5 * _ROW + 0.35 * SMALL, caption, SMALL, style.MUTED, "end")
        self._legend(x.begin + self._power(frame), y.end - 3.0 - _height(rows), rows)
        taken = list[Extent]()
        for level in panel.levels:
            self._level_text(frame, level, taken)
        for box in panel.boxes:
            self._box_text(frame, box)
        for curve in panel.curves:
            if curve.look == looks.BAR and curve.caption:
                self._bar_text(frame, curve)
        for note in panel.notes:
            self._note(frame, note)

    def _level(self, frame: _Frame, level: Level) -> None:
        x, y = frame.x, frame.y
        if not (x if level.upright else y).holds(level.value):
            return
        at = _n((x if level.upright else y).at(level.value))
        path = f"M{at} {_n(y.begin)}V{_n(y.end)}" if level.upright else f"M{_n(x.begin)} {at}H{_n(x.end)}"
        tint = self._tint(_color(level.number, style.MUTED if level.dashed or level.faint else style.INK))
        line = _line(tint, 0.8 if level.faint else 1.0, _level_dashes(frame.panel, level))
        self._add(f'<path d="{path}" {line}/>')

    def _level_text(self, frame: _Frame, level: Level, taken: list[Extent]) -> None:
        """Write the text of a level where it covers no other one: beside its line at the top, or under or over it."""
        x, y = frame.x, frame.y
        if not level.text or not (x if level.upright else y).holds(level.value):
            return
        wide = width(level.text, SMALL)
        places = list[tuple[float, float]]()  # left end and base line
        if level.upright:
            at = x.at(level.value)
            for row in range(4):
                base = y.end + 2.0 + SMALL * (0.8 + LINE * row)
                places += [(at + 4.0, base), (at - 4.0 - wide, base)]
        else:
            at = y.at(level.value)
            for left in (x.begin + 4.0, x.end - 4.0 - wide, 0.5 * (x.begin + x.end - wide)):
                places += [(left, at + 2.0 + 0.8 * SMALL), (left, at - 3.0)]
        boxes = [(left, base - 0.8 * SMALL, left + wide, base + 0.25 * SMALL) for left, base in places]
        edge = x.begin, y.end, x.end, y.begin
        # a curve under a text is better than another text, and that better than a text that leaves the panel
        over = [sum(placing.shared(box, other) for other in taken) + 20.0 * placing.outside(box, edge) for box in boxes]
        costs = [cost + min(self._covered(frame, box), 9) for cost, box in zip(over, boxes, strict=True)]
        best = costs.index(min(costs))
        taken.append(boxes[best])
        self._text(*places[best], level.text, SMALL, style.MUTED, halo=True)

    def _covered(self, frame: _Frame, box: Extent) -> int:
        """Return the number of points of curves in a box."""
        count = 0
        for curve in frame.panel.curves:
            x, y = frame.x(curve.x), frame.y(curve.y)
            count += int(np.count_nonzero((x > box[0]) & (x < box[2]) & (y > box[1]) & (y < box[3])))
        return count

    def _curve(self, frame: _Frame, curve: Curve) -> None:
        tint = self._tint(_color(curve.number, _neutral(curve)))
        if curve.look == looks.SOLID:
            path = "".join(_polygon(frame.x(x), frame.y(y)) for x, y in style.shapes(curve))
            self._add(f'<path d="{path}" fill="{tint}">{_hint(curve)}</path>')
            return
        stroke = style.stroke(curve)
        x, y = frame.x(curve.x), frame.y(curve.y)
        if stroke.line and (path := self._polyline(frame, x, y)):
            opacity = f' stroke-opacity="{_n(stroke.alpha)}"' if stroke.alpha < 1.0 else ""
            line = _line(tint, stroke.line / _FINE, [each / _FINE for each in stroke.dashes])
            cap = ' stroke-linecap="round"' if not stroke.dashes and not stroke.butt else ""
            self._add(f'<path d="{path}" transform="scale({_FINE})" {line}{opacity}{cap}>{_hint(curve)}</path>')
        if stroke.marker:
            inside = (x >= frame.x.begin - 0.1) & (x <= frame.x.end + 0.1)
            inside &= (y >= frame.y.end - 0.1) & (y <= frame.y.begin + 0.1)
            self._markers(x[inside], y[inside], stroke, tint)

    def _polyline(self, frame: _Frame, x: np.ndarray, y: np.ndarray) -> str:
        """Return the path of a line in units of `_FINE`, cut at the edge of the frame and thinned."""
        edge = frame.x.begin - _CLIPPED, frame.y.end - _CLIPPED, frame.x.end + _CLIPPED, frame.y.begin + _CLIPPED
        return "".join(_steps(*thinned(*piece)) for piece in cut(x, y, edge))

    def _markers(self, x: np.ndarray, y: np.ndarray, stroke: style.Stroke, tint: str) -> None:
        if not x.size:
            return
        shape, closed = _marker(stroke.marker, 0.5 * stroke.size)
        opacity = f' opacity="{_n(stroke.alpha)}"' if stroke.alpha < 1.0 else ""
        fill = "none" if stroke.hollow or not closed else tint
        look = f'fill="{fill}" stroke="{tint}" stroke-width="{_n(stroke.edge)}"{opacity}'
        # pale points that overlap become darker, which one path would not show
        groups = _DENSE if stroke.alpha < 1.0 else 1
        for first in range(min(groups, x.size)):
            places = zip(x[first::groups].tolist(), y[first::groups].tolist(), strict=True)
            path = "".join(f"M{px:.2f} {py:.2f}{shape}" for px, py in places)
            self._add(f'<path d="{path}" {look}/>')

    def _heat(self, frame: _Frame, curve: Curve, heat: np.ndarray, scale: Heat) -> None:
        """Draw a curve in steps of color and width."""
        x, y = frame.x(curve.x), frame.y(curve.y)
        # a segment has the larger value of its two ends, so that a single peak keeps its color
        step = style.heat_step(np.maximum(heat[:-1], heat[1:]), scale)
        for k in range(style.HEAT_STEPS):
            rows = np.flatnonzero(step == k)
            if not rows.size or not (path := self._polyline(frame, *(style.stretches(z, rows) for z in (x, y)))):
                continue
            line = _line(self._tint(style.heat(k)), style.heat_width(k) / _FINE)
            self._add(f'<path d="{path}" transform="scale({_FINE})" {line} stroke-linecap="round"/>')

    def _band(self, frame: _Frame, band: Band) -> None:
        tint = self._tint(_color(band.number, style.MUTED))
        x = frame.x(band.x)
        ends = [(frame.y(side), side) for side in (band.low, band.high)]
        # on a logarithmic axis a band that reaches 0 goes down to the edge of the panel
        low, high = (np.where(np.isnan(place) & np.isfinite(side), frame.y.begin + 9.0, place) for place, side in ends)
        low, high = (np.clip(place, frame.y.end - 9.0, frame.y.begin + 9.0) for place in (low, high))
        there = np.isfinite(x) & np.isfinite(low) & np.isfinite(high)
        path = ""
        for rows in np.split(np.arange(x.size), np.flatnonzero(np.diff(there)) + 1):
            if rows.size > 1 and there[rows[0]]:
                (ax, ay), (bx, by) = thinned(x[rows], low[rows]), thinned(x[rows], high[rows])
                path += _steps(np.concatenate([ax, bx[::-1]]), np.concatenate([ay, by[::-1]])) + "z"
        if path:
            title = f"<title>{escape(style.shortened(band.name))}</title>" if band.name else ""
            look = f'fill="{tint}" fill-opacity="{style.BAND}"'
            self._add(f'<path d="{path}" transform="scale({_FINE})" {look}>{title}</path>')

    def _reach(self, frame: _Frame, curve: Curve, reach: np.ndarray) -> None:
        """Draw discs as one pale area, so that an overlap does not look like a higher probability."""
        x, y, radius = frame.x(curve.x), frame.y(curve.y), reach * abs(frame.wide / (frame.x.high - frame.x.low))
        path = ""
        for px, py, r in zip(x.tolist(), y.tolist(), radius.tolist(), strict=True):
            if np.isfinite(px + py + r) and abs(px) + abs(py) + r < 1e5:
                path += f"M{px - r:.2f} {py:.2f}{_circle(r)}"
        tint = self._tint(_color(curve.number))
        self._add(f'<path d="{path}" fill="{tint}" fill-opacity="{style.PALE}">{_hint(curve)}</path>')

    def _disc(self, frame: _Frame, disc: Disc) -> None:
        x, y = frame.x.at(disc.x), frame.y.at(disc.y)
        rx = abs(disc.radius * frame.wide / (frame.x.high - frame.x.low))
        ry = abs(disc.radius * frame.tall / (frame.y.high - frame.y.low))
        tint = self._tint(style.GRID if disc.faint else _color(disc.number, style.MUTED))
        fill = f'fill="{tint}" fill-opacity="0.1"' if disc.filled else 'fill="none"'
        dashes = style.LIMITS[0] if disc.number < 0 else style.DASHES[disc.number % len(style.DASHES)]
        dashes = () if disc.faint else dashes
        line = _line(tint, 0.9, [0.9 * each for each in dashes], "")
        self._add(f'<ellipse cx="{_n(x)}" cy="{_n(y)}" rx="{_n(rx)}" ry="{_n(ry)}" {fill} {line}/>')

    def _box(self, frame: _Frame, box: Box) -> None:
        left, right = sorted(frame.x.at(value) for value in (box.left, box.right))
        top, bottom = frame.y.end, frame.y.begin
        if box.low is not None and box.high is not None:
            top, bottom = sorted(frame.y.at(value) for value in (box.low, box.high))
        left, right = (float(np.clip(each, frame.x.begin - 9.0, frame.x.end + 9.0)) for each in (left, right))
        top, bottom = (float(np.clip(each, frame.y.end - 9.0, frame.y.begin + 9.0)) for each in (top, bottom))
        if not np.isfinite(left + right + top + bottom):
            return
        self._add(
            f'<rect x="{_n(left)}" y="{_n(top)}" width="{_n(right - left)}" height="{_n(bottom - top)}" '
            f"{self._box_look(box)}/>"
        )

    def _box_look(self, box: Box) -> str:
        if box.hatched:
            return f'fill="url(#{self._hatch()})" stroke="{self._tint(style.MUTED)}" stroke-width="0.6"'
        if box.level is not None:
            # from better through the color of the page to worse, so that the text is readable on light and dark
            tint = self._tint(style.BETTER if box.level < 0.0 else style.WORSE)
            return f'fill="{tint}" fill-opacity="{_n(0.84 * min(abs(box.level), 1.0))}"'
        tint = self._tint(_color(box.number, style.MUTED))
        if box.pale:
            return f'fill="{tint}" fill-opacity="0.14"'
        return f'fill="{tint}" stroke="{self._tint(style.PAPER)}" stroke-width="0.5"'

    def _hatch(self) -> str:
        identifier = f"{self.key}-hatch"
        if not any(f'id="{identifier}"' in part for part in self.parts):
            self._add(
                f'<pattern id="{identifier}" width="4" height="4" patternUnits="userSpaceOnUse" '
                f'patternTransform="rotate(45)"><rect width="4" height="4" fill="{self._tint(style.GRID)}"/>'
                f'<path d="M0 0V4" {_line(self._tint(style.MUTED), 1.2)}/></pattern>'
            )
        return identifier

    def _box_text(self, frame: _Frame, box: Box) -> None:
        if not box.text or box.low is None or box.high is None:
            return
        y = frame.y.at(0.5 * (box.low + box.high)) + 0.35 * SMALL
        if not box.beside:
            x = frame.x.at(0.5 * (box.left + box.right))
            self._text(x, y, box.text, SMALL - 1.0, style.INK, "middle")
        elif box.right + box.left >= 0.0:
            self._text(frame.x.at(box.right) + 5.0, y, box.text, SMALL, style.INK, halo=True)
        else:
            self._text(frame.x.at(box.left) - 5.0, y, box.text, SMALL, style.INK, "end", halo=True)

    def _bar_text(self, frame: _Frame, curve: Curve) -> None:
        """Write a text next to a bar, on the side with more room."""
        x, y = frame.x.at(float(curve.x[0])), frame.y.at(float(np.mean(curve.y)))
        right = x - frame.x.begin < 0.85 * frame.wide
        anchor = "start" if right else "end"
        y = float(np.clip(y, frame.y.end + SMALL, frame.y.begin - SMALL))
        self._text(x + (5.0 if right else -5.0), y + 0.35 * SMALL, curve.caption, SMALL, style.INK, anchor, halo=True)

    def _note(self, frame: _Frame, note: Note) -> None:
        x, y, lines = frame.x.at(note.x), frame.y.at(note.y), note.text.count("\n")
        tint = _color(note.number, style.MUTED)
        down = lines * LINE * SMALL
        if note.middle:
            self._text(x, y + 0.35 * SMALL - 0.5 * down, note.text, SMALL, tint, "middle", halo=True)
        elif note.right:
            self._text(x + 3.0, y - 3.0 - down, note.text, SMALL, tint, halo=True)
        else:
            self._text(x - 5.0, y + 5.0 + 0.8 * SMALL, note.text, SMALL, tint, "end", halo=True)

    def _field(self, frame: _Frame, values: Field, scale: Heat) -> None:
        """Draw a field as areas of one color step each; of more columns than points the largest value counts."""
        columns = values.values
        edges = frame.x(_edges(values.x))
        rows = frame.y(_edges(values.y))
        most = max(1, int(frame.wide / _COLUMN_OF_FIELD))
        if columns.shape[1] > most:
            first = np.linspace(0, columns.shape[1], most + 1).astype(int)[:-1]
            columns, edges = np.maximum.reduceat(columns, first, axis=1), np.append(edges[first], edges[-1])
        steps = style.heat_step(columns, scale)
        paths = dict[int, list[str]]()
        for row in range(steps.shape[0]):
            ends = np.flatnonzero(np.diff(steps[row])) + 1
            top, tall = float(rows[row + 1]), float(rows[row] - rows[row + 1])
            for a, b in zip([0, *ends.tolist()], [*ends.tolist(), steps.shape[1]], strict=True):
                if np.isfinite(steps[row, a]):
                    wide = float(edges[b] - edges[a])
                    area = f"M{_n(edges[a])} {_n(top)}h{_n(wide)}v{_n(tall)}h{_n(-wide)}z"
                    paths.setdefault(int(steps[row, a]), []).append(area)
        for k, areas in sorted(paths.items()):
            tint = self._tint(style.heat(k))
            self._add(f'<path d="{"".join(areas)}" fill="{tint}" shape-rendering="crispEdges"/>')

    def _scale(self, frame: _Frame) -> None:
        """Draw the color bar of a panel."""
        heat, y, steps = frame.panel.heat, frame.y, style.HEAT_STEPS
        assert heat is not None
        axis = _Axis(*_heat_range(frame.panel), False, y.begin, y.end)
        left, tall = frame.x.end + 8.0, frame.tall / steps
        for k in range(steps):
            place = f'x="{_n(left)}" y="{_n(y.begin - (k + 1) * tall)}" width="{_BAR}" height="{_n(tall)}"'
            self._add(f'<rect {place} fill="{self._tint(style.heat(k))}" shape-rendering="crispEdges"/>')
        divided = _divided(axis, looks.LINEAR, min(9.0, max(2.0, frame.tall / 22.0)))
        path = "".join(f"M{_n(left + _BAR)} {_n(axis.at(value))}h{_TICK}" for value in divided.values)
        self._add(f'<path d="{path}" {_line(self._tint(style.MUTED), 0.8)}/>')
        right = left + _BAR + _TICK + _GAP
        for value, text in zip(divided.values, divided.texts, strict=True):
            self._text(right, axis.at(value) + 0.35 * SMALL, text, SMALL, style.INK)
        right += max(width(text, SMALL) for text in divided.texts) + TEXT + 3.0
        label = f"{heat.label} {divided.power}".rstrip()
        self._text(right, 0.5 * (y.begin + y.end), label, TEXT, style.INK, "middle", -90.0)

    def _marks(self, frame: _Frame) -> None:
        """Draw the marks of a panel and their names."""
        x, y = frame.x, frame.y
        marks = [mark for mark in frame.panel.marks if x.holds(mark.x) and y.holds(mark.y)]
        for mark in marks:
            shape, _ = _marker(style.marker(mark.number), 0.5 * (6.0 if mark.name else 4.5))
            tint = self._tint(_color(mark.number))
            fill = self._tint(style.PAPER) if mark.hollow else tint
            hint = f"<title>{escape(mark.caption)}</title>" if mark.caption else ""
            path = f"M{_n(x.at(mark.x))} {_n(y.at(mark.y))}{shape}"
            self._add(f'<path d="{path}" fill="{fill}" stroke="{tint}">{hint}</path>')
        at = dict[tuple[float, float], list[looks.Mark]]()
        for mark in marks:
            if mark.name:
                place = x.at(mark.x), -y.at(mark.y)  # y up, as for the places of labels
                near = next((there for there in at if np.hypot(there[0] - place[0], there[1] - place[1]) < 2.0), place)
                at.setdefault(near, []).append(mark)
        taken = [(px - 4.0, py - 4.0, px + 4.0, py + 4.0) for px, py in at]
        edge = x.begin, -y.begin, x.end, -y.end
        size = SMALL - 1.0
        for (px, py), there in at.items():
            text, tint = ", ".join(_title(mark.name) for mark in there), _color(there[0].number)
            box = placing.free_spot((px, py), (width(text, size), LINE * size + 1.0), taken, edge)
            taken.append(box)
            ex, ey = min(max(px, box[0]), box[2]), min(max(py, box[1]), box[3])
            if np.hypot(ex - px, ey - py) > 0.8 * placing.STEP:
                self._add(f'<path d="M{_n(px)} {_n(-py)}L{_n(ex)} {_n(-ey)}" {_line(self._tint(tint), 0.7)}/>')
            middle = -0.5 * (box[1] + box[3]) + 0.35 * size
            self._text(0.5 * (box[0] + box[2]), middle, text, size, tint, "middle", halo=True)

    # elements

    def _text(
        self,
        x: float,
        y: float,
        text: str,
        size: float,
        color: str,
        anchor: str = "start",
        turn: float = 0.0,
        *,
        halo: bool = False,
        spacing: float = LINE,
    ) -> None:
        """Write a text with its first base line at y; turned about (x, y), further lines to the right of it."""
        if not text:
            return
        head = f'<text x="{_n(x)}" y="{_n(y)}" font-size="{_n(size)}" fill="{self._tint(color)}"'
        head += f' text-anchor="{anchor}"' if anchor != "start" else ""
        head += f' transform="rotate({_n(turn)} {_n(x)} {_n(y)})"' if turn else ""
        # readable over curves, too
        head += f' stroke="{self._tint(style.PAPER)}" stroke-width="2.5" paint-order="stroke"' if halo else ""
        first, *further = (escape(line, quote=False) for line in text.split("\n"))
        lines = "".join(f'<tspan x="{_n(x)}" dy="{_n(spacing * size)}">{line}</tspan>' for line in further)
        self._add(f"{head}>{first}{lines}</text>")

    def _tint(self, color: str) -> str:
        return self.colors.get(color, color)

    def _identifier(self) -> str:
        self.identifiers += 1
        return f"{self.key}-{self.identifiers}"

    def _add(self, element: str) -> None:
        self.parts.append(element)


_COLUMN_OF_FIELD = 1.0  # points: narrower columns of a field are joined


def _frames(chart: Chart) -> list[_Frame]:
    """Return the panels in rows; those that share the x axis have its texts below the lowest of each column."""
    frames, row, column = list[_Frame](), 0, 0
    for panel in chart.panels:
        if column and (panel.whole or column == chart.across):
            row, column = row + 1, 0
        abscissa = panel.abscissa or chart.abscissa
        log = abscissa.scale in (looks.LOG, looks.FREQUENCY)
        frames.append(
            _Frame(panel, abscissa, row, column, _Axis(0.0, 1.0, log), _Axis(0.0, 1.0, panel.scale == looks.LOG))
        )
        column = chart.across if panel.whole else column + 1
    shared = [frame for frame in frames if frame.panel.abscissa is None]
    lowest = {frame.column: frame for frame in shared}
    for frame in shared:
        frame.ends = frame.labeled = frame is lowest[frame.column]
    return frames


def _places(
    begin: float, room: float, shares: Sequence[float], before: Sequence[float], after: Sequence[float]
) -> list[tuple[float, float]]:
    """Return begin and end of each frame in a row or a column, with room before and after each."""
    found, place = list[tuple[float, float]](), begin
    for share, front, back in zip(shares, before, after, strict=True):
        end = place + front + room * share / sum(shares)
        found.append((place + front, end))
        place = end + back + _APART
    return found


def _range(
    panels: Sequence[Panel], across: bool, log: bool, given: tuple[float | None, float | None], margin: float
) -> tuple[float, float]:
    """Return the range of x (`across`) or y: as given, else that of the content with a margin at both ends."""
    low, high = given
    if low is not None and high is not None and low < high:
        return low, high
    values = [np.asarray(each, np.float64).ravel() for panel in panels for each in _content(panel, across)]
    found = np.concatenate([*values, np.empty(0)])
    found = found[np.isfinite(found) & (found > 0.0 if log else True)]
    least, most = (float(found.min()), float(found.max())) if found.size else (1.0, 10.0) if log else (0.0, 1.0)
    if not most - least > 1e-12 * max(abs(least), abs(most)):
        room = margin * abs(least) or abs(least) or 1.0
        least, most = (0.5 * least, 2.0 * least) if log else (least - room, most + room)
    elif not any(panel.field is not None for panel in panels):
        room = margin * (np.log(most / least) if log else most - least)
        least, most = (least * np.exp(-room), most * np.exp(room)) if log else (least - room, most + room)
    least, most = float(least if low is None else low), float(most if high is None else high)
    return (least, most) if least < most else style.padded(least, least)


def _content(panel: Panel, across: bool) -> Iterator[np.ndarray | Sequence[float]]:
    """Yield the values of x or of y that a panel shows."""
    for curve in panel.curves:
        values, reach = curve.x if across else curve.y, 0.0 if curve.reach is None else curve.reach
        yield values - reach
        yield values + reach
    for band in panel.bands:
        yield from (band.x,) if across else (band.low, band.high)
    yield [mark.x if across else mark.y for mark in panel.marks]
    for disc in panel.discs:
        middle = disc.x if across else disc.y
        yield (middle - disc.radius, middle + disc.radius)
    yield [level.value for level in panel.levels if level.upright == across]
    for box in panel.boxes:
        if across:
            yield box.left, box.right
        elif box.low is not None and box.high is not None:
            yield box.low, box.high
    if panel.field is not None:
        yield _edges(panel.field.x if across else panel.field.y)


def _edges(middles: np.ndarray) -> np.ndarray:
    """Return the edges of cells around their middles: shape (n,) -> (n + 1,)."""
    if middles.size < 2:
        return np.concatenate([middles - 0.5, middles + 0.5])
    between = 0.5 * (middles[:-1] + middles[1:])
    return np.concatenate([[2.0 * middles[0] - between[0]], between, [2.0 * middles[-1] - between[-1]]])


def _divided(axis: _Axis, scale: str, most: float) -> ticks.Ticks:
    if axis.log:
        return ticks.logarithmic(axis.low, axis.high, most)
    return (ticks.degrees if scale == looks.DEGREES else ticks.linear)(axis.low, axis.high, most)


def _named_ticks(given: Sequence[Tick], axis: _Axis) -> ticks.Ticks:
    held = [tick for tick in given if axis.holds(tick.value)]
    return ticks.Ticks([tick.value for tick in held], [_title(tick.name, tick.caption) for tick in held])


def _decade(axis: _Axis) -> float:
    """Return the length of a decade of a logarithmic axis, else of the axis."""
    return abs(axis.end - axis.begin) / (float(np.log10(axis.high / axis.low)) if axis.log else 1.0)


def _spacing(values: Sequence[float], axis: _Axis, wide: float) -> float:
    """Return the least distance of ticks on an axis as long as `wide`."""
    if len(values) < 2:
        return wide
    places = _Axis(axis.low, axis.high, axis.log, 0.0, wide)(np.asarray(values, np.float64))
    return float(np.min(np.diff(places)))


def _scaled(panel: Panel) -> Heat | None:
    """Return the color scale of a panel that uses it."""
    used = panel.field is not None or any(curve.heat is not None for curve in panel.curves)
    return panel.heat if used else None


def _heat_range(panel: Panel) -> tuple[float, float]:
    assert panel.heat is not None
    low, high = panel.heat.low, panel.heat.high
    return (low, high) if low < high else style.padded(low, low)


def _panel_entries(panel: Panel) -> Iterator[_Entry]:
    """Yield the entries of the legend of a panel: curves, then areas."""
    solid = [curve for curve in panel.curves if curve.look == looks.SOLID]
    for curve in (*(curve for curve in panel.curves if curve.look != looks.SOLID), *solid):
        # the caption of a bar stands beside it
        text = _title(curve.name, "" if curve.look == looks.BAR else curve.caption)
        if text and curve.heat is None:
            yield _Entry(text, curve)
    for thing in (*panel.boxes, *panel.bands):
        if thing.name:
            yield _Entry(_title(thing.name), thing)


def _unique(entries: Iterable[_Entry]) -> Iterator[_Entry]:
    found = set[str]()
    for entry in entries:
        if entry.text not in found:
            found.add(entry.text)
            yield entry


_LegendRows = list[list[tuple[float, _Entry]]]
"""Rows of a legend: each entry with its distance from the left."""


def _height(rows: _LegendRows) -> float:
    """Return the height of rows of a legend, whose entries may have several lines."""
    lines = [max(entry.text.count("\n") for _, entry in row) for row in rows]
    return sum(_ROW + LINE * SMALL * more + (0.5 * SMALL if more else 0.0) for more in lines)


def _rows(entries: Sequence[_Entry], columns: int, room: float) -> _LegendRows:
    """Arrange a legend in rows with as many columns as fit, at most `columns`."""
    if not entries:
        return []
    for count in range(min(columns, len(entries)), 0, -1):
        columns_ = [entries[first::count] for first in range(count)]
        wide = [max(map(_entry_width, column)) + _BETWEEN for column in columns_]
        if sum(wide) - _BETWEEN <= room or count == 1:
            starts = [sum(wide[:number]) for number in range(count)]
            rows = [entries[first : first + count] for first in range(0, len(entries), count)]
            return [list(zip(starts, row, strict=False)) for row in rows]
    raise AssertionError


def _entry_width(entry: _Entry) -> float:
    return _SAMPLE + width(entry.text, SMALL)


def _level_dashes(panel: Panel, level: Level) -> tuple[float, ...]:
    """Return the dashes of a level: dashed levels with different captions have different ones."""
    if not level.dashed:
        return ()
    kinds = list(dict.fromkeys(each.caption for each in panel.levels if each.caption))
    return style.LIMITS[kinds.index(level.caption) % len(style.LIMITS) if level.caption else 0]


def _description(frames: Sequence[_Frame]) -> str:
    """Return what the picture shows, in words: the axes of each panel and the names of its curves."""
    said = list[str]()
    for frame in frames:
        names = list(dict.fromkeys(style.shortened(curve.name) for curve in frame.panel.curves if curve.name))
        axes = " over ".join(label.replace("\n", " ") for label in (frame.panel.label, frame.abscissa.label) if label)
        said.append(f"{axes}: {', '.join(names)}" if names and axes else axes or ", ".join(names))
    return "; ".join(text for text in said if text)


def _title(name: str, remark: str = "", most: int = 60) -> str:
    return style.titled(name, remark, most)


def _neutral(curve: Curve) -> str:
    return style.MUTED if curve.look == looks.WIDE else style.INK


def _color(number: int, neutral: str = style.INK) -> str:
    return style.ALERT if number == looks.ALERT else neutral if number < 0 else style.color(number)


def _hint(curve: Curve) -> str:
    """Return the name of a curve, shown where the pointer rests on it."""
    text = _title(curve.name, curve.caption)
    return f"<title>{escape(text)}</title>" if text else ""


def _line(tint: str, wide: float, dashes: Sequence[float] = (), fill: str = 'fill="none" ') -> str:
    dashed = f' stroke-dasharray="{" ".join(map(_n, dashes))}"' if len(dashes) else ""
    return f'{fill}stroke="{tint}" stroke-width="{_n(wide)}"{dashed}'


def _polygon(x: np.ndarray, y: np.ndarray) -> str:
    places = [f"{_n(px)} {_n(py)}" for px, py in zip(x.tolist(), y.tolist(), strict=True) if np.isfinite(px + py)]
    return f"M{'L'.join(places)}z" if places else ""


def _circle(r: float) -> str:
    """Return the path of a circle from its left end."""
    arc = f"a{_n(r)} {_n(r)} 0 1 0 "
    return f"{arc}{_n(2.0 * r)} 0{arc}{_n(-2.0 * r)} 0z"


def _marker(marker: str, r: float) -> tuple[str, bool]:
    """Return the path of a marker from its middle, and True if it is an area."""
    a, d, p = _n(r), _n(r * np.sqrt(2.0)), _n(r / 3.0)
    two, q = _n(2.0 * r), _n(2.0 * r / 3.0)
    shapes = {
        "s": f"m-{a} -{a}h{two}v{two}h-{two}z",
        "^": f"m0 -{a}l{a} {two}h-{two}z",
        "v": f"m0 {a}l{a} -{two}h-{two}z",
        "D": f"m0 -{d}l{d} {d}l-{d} {d}l-{d} -{d}z",
        "P": f"m-{p} -{a}h{q}v{q}h{q}v{q}h-{q}v{q}h-{q}v-{q}h-{q}v-{q}h{q}z",
    }
    if marker == "+":
        return f"m-{a} 0h{two}m-{a} -{a}v{two}", False
    if marker == "x":
        return f"m-{a} -{a}l{two} {two}m-{two} 0l{two} -{two}", False
    return shapes.get(marker, f"m-{a} 0{_circle(r)}"), True


def _steps(x: np.ndarray, y: np.ndarray) -> str:
    """Return the path of a line in units of `_FINE`: its first place, then steps, whose sum is exact."""
    places = np.rint(np.column_stack([x, y]) / _FINE).astype(np.int64)
    steps = np.diff(places, axis=0)
    steps = steps[np.any(steps != 0, axis=1)]
    if not steps.size:
        return ""
    body = " ".join(map(str, steps.ravel().tolist())).replace(" -", "-")
    return f"M{places[0, 0]} {places[0, 1]}l{body}"


def _n(value: float) -> str:
    """Return a length to a hundredth of a point, in the shortest form."""
    text = f"{value:.2f}".rstrip("0").rstrip(".")
    return "0" if text in ("-0", "") else text
