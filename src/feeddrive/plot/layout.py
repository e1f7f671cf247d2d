"""Where the parts of a chart lie on a page: ranges and ticks of its axes, the frames of its panels, its legends.

`Layout` works in four steps: the ranges of all axes, their ticks, the room that ticks, labels and legends need, and the
frames of the panels in the room that is left. Lengths are points, 72 in an inch; y points down.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from feeddrive.plot import chart as looks
from feeddrive.plot import placing, style, ticks
from feeddrive.plot.chart import Abscissa, Band, Box, Chart, Curve, Heat, Level, Panel, Tick
from feeddrive.plot.placing import LINE, Extent, width
from feeddrive.plot.style import SMALL, TEXT

_INCH = 72.0
EDGE = 4.0  # around all
TICK, GAP = 3.5, 3.0  # length of a tick, and the gap to its text
SAMPLE, _BETWEEN = 24.0, 14.0  # a legend entry: its sample, and the gap to the next one
ROW = 1.45 * SMALL  # height of a row of a legend
_APART = 8.0  # between panels
BAR = 9.0  # width of a color bar
_MARGIN = 0.05  # share of a range that is left free at both ends
_SAME = 1e-12  # relative: a smaller range is that of one value
_SQUARE_MARGIN = 0.04  # the same of equal scales
TURN = 40.0  # degrees of slanted texts
_LOW = 30.0  # the least height of a panel; a picture with more around it becomes higher


@dataclass
class Axis:
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
class Frame:
    """A panel with its axes; `ends` if the texts of x stand below it, `labeled` if its label does."""

    panel: Panel
    abscissa: Abscissa
    row: int
    column: int
    x: Axis
    y: Axis
    ends: bool = True
    labeled: bool = True
    x_ticks: ticks.Ticks = field(default_factory=lambda: ticks.Ticks((), ()))
    y_ticks: ticks.Ticks = field(default_factory=lambda: ticks.Ticks((), ()))
    legend: list[Entry] = field(default_factory=list)

    @property
    def table(self) -> bool:
        """True for a table of cells, which has no axes."""
        return any(box.level is not None for box in self.panel.boxes)

    @property
    def wide(self) -> float:
        """The width of the panel."""
        return self.x.end - self.x.begin

    @property
    def tall(self) -> float:
        """The height of the panel."""
        return self.y.begin - self.y.end


@dataclass(frozen=True)
class Entry:
    """An entry of a legend: its text and what it is the sample of."""

    text: str
    of: Curve | Band | Box | Level
    dashes: tuple[float, ...] = ()


class Layout:
    """The places of all parts of a chart.

    wide, tall  size of the picture; tall may exceed that of the chart, for a legend of several rows
    frames      the panels with their axes
    legend      entries of the common legend; `legend_rows` of it from (`legend_at`, `legend_top`) on
    labels      left ends of the columns, where the labels of y begin
    inside      left, top, right and bottom of all that is not legend or heading
    """

    def __init__(self, chart: Chart) -> None:
        self.chart = chart
        self.wide, self.tall = _INCH * chart.width, _INCH * chart.height
        self.frames = _frames(chart)
        self.columns = max(frame.column for frame in self.frames) + 1
        self.rows = max(frame.row for frame in self.frames) + 1
        self.legend = self._entries()
        self._ranges()
        # texts take room from the panels, and narrower panels have fewer texts
        for _ in range(3):
            self._lay_out()

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
            sides = self.around(frame)
            left[frame.column], right[last] = max(left[frame.column], sides[0]), max(right[last], sides[2])
            above[frame.row], below[frame.row] = max(above[frame.row], sides[1]), max(below[frame.row], sides[3])
        begin = EDGE + (LINE * TEXT + 2.0 if chart.side else 0.0)
        end = self.wide - EDGE
        if chart.legend == looks.RIGHT and self.legend:
            end -= max(_entry_width(entry) for entry in self.legend) + _BETWEEN
        top = EDGE + (LINE * TEXT + 4.0 if chart.caption else 0.0)
        self.legend_top = top
        self.legend_rows = _rows(self.legend, chart.columns, end - begin) if chart.legend != looks.RIGHT else []
        top += height(self.legend_rows) + (4.0 if self.legend_rows else 0.0)
        # further rows of the legend do not make the panels smaller
        fixed = top + sum(above) + sum(below) + _APART * (self.rows - 1) + EDGE
        further = height(self.legend_rows[1:])
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
        self.inside = begin, top, end, self.tall - EDGE
        for frame in self.frames:
            own = chart.legend == looks.PANELS
            frame.legend = list(_unique(_panel_entries(frame.panel))) if own else []

    def _tick(self, frame: Frame) -> None:
        abscissa, x, y = frame.abscissa, frame.x, frame.y
        sized = frame.x.end - frame.x.begin > 2.0
        wide, tall = (frame.wide, frame.tall) if sized else (self.wide / self.columns - 40.0, self.tall / self.rows)
        if abscissa.ticks is not None:
            frame.x_ticks = _named_ticks(abscissa.ticks, x)
        else:
            for most in range(min(10, max(1, int(wide / 40.0))), 0, -1):
                frame.x_ticks = divide(x, abscissa.scale, float(most))
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
            frame.y_ticks = divide(y, frame.panel.scale, min(9.0, max(2.0, tall / 18.0)))
            if len(frame.y_ticks.values) < 3:
                finer = divide(y, frame.panel.scale, max(2.0, tall / (1.4 * SMALL)))
                frame.y_ticks = max(frame.y_ticks, finer, key=lambda divided: len(divided.values))

    def around(self, frame: Frame) -> Extent:
        """Return the room that a panel needs left, above, right and below."""
        if self.chart.bare and frame.panel.abscissa is None:
            return 2.0, self.over(frame), 2.0, 2.0
        texts = max((width(text, SMALL) for text in frame.y_ticks.texts), default=0.0)
        label = LINE * TEXT * len(self.y_label(frame)) + 2.0 if frame.panel.label else 0.0
        ends = [width(text, SMALL) for text in frame.x_ticks.texts] if frame.ends else []
        left = max(label + texts + TICK + GAP, 0.5 * ends[0] if ends else 0.0)
        over, right, below = self.over(frame), max(4.0, 0.5 * ends[-1] if ends else 0.0), 2.0
        if frame.ends and any(frame.x_ticks.texts):
            below = TICK + GAP + LINE * SMALL
            if self.slanted(frame):
                turned = np.sin(np.radians(TURN)) * max(ends) + SMALL
                over, below = (over + turned, 2.0) if frame.table else (over, TICK + GAP + turned)
                along = np.cos(np.radians(TURN)) * max(ends)
                right = max(right, along if frame.table else 4.0)
        if frame.labeled and frame.abscissa.label:
            below += 2.0 + LINE * TEXT * len(self.x_label(frame))
        if frame.x_ticks.power and frame.ends:
            right = max(right, width(frame.x_ticks.power, SMALL) + 4.0)
        if color_scale(frame.panel) is not None:
            bar = divide(Axis(*heat_range(frame.panel), False), looks.LINEAR, 5.0)
            right = 8.0 + BAR + TICK + GAP + max(width(text, SMALL) for text in bar.texts) + LINE * TEXT + 4.0
        if self.chart.beside and frame is self.frames[0]:
            right += 10.0 + width(self.chart.beside, SMALL)
        return left, over, right, below

    def over(self, frame: Frame) -> float:
        """Return the room above a panel: its legend, its line of text and its power of ten."""
        caption = style.titled(frame.panel.caption, most=120) if frame.panel.caption else ""
        over = height(self.own_legend(frame))
        if caption and not self.beside_legend(frame):
            over += ROW
        return 3.0 + (over or (ROW if frame.y_ticks.power else 0.0))

    def own_legend(self, frame: Frame) -> LegendRows:
        """Return the rows of the legend of a panel, beside the power of ten of its y axis."""
        return _rows(frame.legend, 4, frame.wide - self.power(frame))

    def power(self, frame: Frame) -> float:
        """Return the width of the power of ten above the y axis."""
        return width(frame.y_ticks.power, SMALL) + 8.0 if frame.y_ticks.power else 0.0

    def beside_legend(self, frame: Frame) -> bool:
        """Return True if the last row of the legend leaves room for the line of text."""
        rows = self.own_legend(frame)
        if not rows:
            return False
        used = max(x for x, _ in rows[-1]) + _entry_width(rows[-1][-1][1])
        return (
            used + self.power(frame) + _BETWEEN + width(style.titled(frame.panel.caption, most=120), SMALL)
            <= frame.wide
        )

    def y_label(self, frame: Frame) -> list[str]:
        """Return the lines of the label of y."""
        return placing.wrapped(frame.panel.label, TEXT, max(frame.tall + 4.0, 60.0)).split("\n")

    def x_label(self, frame: Frame) -> list[str]:
        """Return the lines of the label of x."""
        return placing.wrapped(frame.abscissa.label, TEXT, max(frame.wide + 20.0, 90.0)).split("\n")

    def slanted(self, frame: Frame) -> bool:
        """Return True if the texts of x do not fit beside each other."""
        if frame.table:
            return True
        texts = [(x, width(text, SMALL)) for x, text in zip(frame.x_ticks.values, frame.x_ticks.texts, strict=True)]
        places = sorted((frame.x.at(x), wide) for x, wide in texts if wide)
        return any(b - a < 0.5 * (u + v) + 3.0 for (a, u), (b, v) in pairwise(places))

    def _square(self, frame: Frame, data: Extent) -> None:
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

    def _entries(self) -> list[Entry]:
        """Return the entries of the common legend, levels last; with a legend for each panel, levels alone."""
        panels = self.chart.panels
        curves = [] if self.chart.legend == looks.PANELS else [e for panel in panels for e in _panel_entries(panel)]
        levels = [
            Entry(style.titled("", level.caption), level, level_dashes(panel, level))
            for panel in panels
            for level in panel.levels
            if level.caption
        ]
        limits = {entry.text for entry in levels}
        return [*_unique(entry for entry in curves if entry.text not in limits), *_unique(levels)]


def _frames(chart: Chart) -> list[Frame]:
    """Return the panels in rows; those that share the x axis have its texts below the lowest of each column."""
    frames, row, column = list[Frame](), 0, 0
    for panel in chart.panels:
        if column and (panel.whole or column == chart.across):
            row, column = row + 1, 0
        abscissa = panel.abscissa or chart.abscissa
        log = abscissa.scale in (looks.LOG, looks.FREQUENCY)
        frames.append(
            Frame(panel, abscissa, row, column, Axis(0.0, 1.0, log), Axis(0.0, 1.0, panel.scale == looks.LOG))
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
    if not found.size:
        least, most, margin = (1.0, 10.0, 0.0) if log else (0.0, 1.0, 0.0)
    else:
        least, most = float(found.min()), float(found.max())
    if not most - least > _SAME * max(abs(least), abs(most)):
        room = _MARGIN * abs(least) or _MARGIN
        least, most = (0.5 * least, 2.0 * least) if log else (least - room, most + room)
    # the cells of a field reach to the edges
    if not any(panel.field is not None for panel in panels):
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
        yield cell_edges(panel.field.x if across else panel.field.y)


def cell_edges(middles: np.ndarray) -> np.ndarray:
    """Return the edges of cells around their middles: shape (n,) -> (n + 1,)."""
    if middles.size < 2:
        return np.concatenate([middles - 0.5, middles + 0.5])
    between = 0.5 * (middles[:-1] + middles[1:])
    return np.concatenate([[2.0 * middles[0] - between[0]], between, [2.0 * middles[-1] - between[-1]]])


def divide(axis: Axis, scale: str, most: float) -> ticks.Ticks:
    """Return the ticks of an axis, about `most` at most."""
    if axis.log:
        return ticks.logarithmic(axis.low, axis.high, most)
    return (ticks.degrees if scale == looks.DEGREES else ticks.linear)(axis.low, axis.high, most)


def _named_ticks(given: Sequence[Tick], axis: Axis) -> ticks.Ticks:
    held = [tick for tick in given if axis.holds(tick.value)]
    return ticks.Ticks([tick.value for tick in held], [style.titled(tick.name, tick.caption) for tick in held])


def _spacing(values: Sequence[float], axis: Axis, wide: float) -> float:
    """Return the least distance of ticks on an axis as long as `wide`."""
    if len(values) < 2:
        return wide
    places = Axis(axis.low, axis.high, axis.log, 0.0, wide)(np.asarray(values, np.float64))
    return float(np.min(np.diff(places)))


def color_scale(panel: Panel) -> Heat | None:
    """Return the color scale of a panel that uses it."""
    used = panel.field is not None or any(curve.heat is not None for curve in panel.curves)
    return panel.heat if used else None


def heat_range(panel: Panel) -> tuple[float, float]:
    """Return the range of the color scale of a panel; of a single value a range around it."""
    assert panel.heat is not None
    low, high = panel.heat.low, panel.heat.high
    return (low, high) if low < high else style.padded(low, low)


def _panel_entries(panel: Panel) -> Iterator[Entry]:
    """Yield the entries of the legend of a panel: curves, then areas."""
    solid = [curve for curve in panel.curves if curve.look == looks.SOLID]
    for curve in (*(curve for curve in panel.curves if curve.look != looks.SOLID), *solid):
        # the caption of a bar stands beside it
        text = style.titled(curve.name, "" if curve.look == looks.BAR else curve.caption)
        if text and curve.heat is None:
            yield Entry(text, curve)
    for thing in (*panel.boxes, *panel.bands):
        if thing.name:
            yield Entry(style.titled(thing.name), thing)


def _unique(entries: Iterable[Entry]) -> Iterator[Entry]:
    found = set[str]()
    for entry in entries:
        if entry.text not in found:
            found.add(entry.text)
            yield entry


LegendRows = list[list[tuple[float, Entry]]]
"""Rows of a legend: each entry with its distance from the left."""


def height(rows: LegendRows) -> float:
    """Return the height of rows of a legend, whose entries may have several lines."""
    lines = [max(entry.text.count("\n") for _, entry in row) for row in rows]
    return sum(ROW + LINE * SMALL * more + (0.5 * SMALL if more else 0.0) for more in lines)


def _rows(entries: Sequence[Entry], columns: int, room: float) -> LegendRows:
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


def _entry_width(entry: Entry) -> float:
    return SAMPLE + width(entry.text, SMALL)


def level_dashes(panel: Panel, level: Level) -> tuple[float, ...]:
    """Return the dashes of a level: dashed levels with different captions have different ones."""
    if not level.dashed:
        return ()
    kinds = list(dict.fromkeys(each.caption for each in panel.levels if each.caption))
    return style.LIMITS[kinds.index(level.caption) % len(style.LIMITS) if level.caption else 0]
