"""Charts: the content of a picture as a value, apart from its drawing: panels of curves, marks and limits, with units.

A chart is drawn by matplotlib (`plot.drawing`), and may be drawn by anything else, with the same curves, limits and
words.  Numbers are in the units that the labels state.  `name` is the user's name of a thing and is never parsed;
every other text may hold quantities, which `Chart.shown` writes in the units of a reader.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from feeddrive.language.quantity import Units
from feeddrive.language.text import resolve

WIDTH = 8.6  # inches: the width of a report's column

LINE, THIN, BAR, DOTS, PLUS = "line", "thin", "bar", "dots", "plus"
CROSS, RING, SOLID = "cross", "ring", "solid"
PLAIN, DASHED, WIDE, MARKED, MARKERS, HOLLOW = "plain", "dashed", "wide", "marked", "markers", "hollow"
"""Looks of a curve.

LINE     has the color and the dashes of its number, PLAIN the color only, DASHED is dashed whatever its number
THIN     accompanies a line; WIDE is wide and pale, below another one
BAR      is short and wide
MARKED   a line with the marker of its number at its points; MARKERS without the line, HOLLOW as outlines
DOTS     are measured; CROSS are poles, RING are zeros, PLUS is a single point
SOLID    a filled shape with these corners; NaN separates shapes
"""
LINEAR, LOG, DEGREES, FREQUENCY = "linear", "log", "degrees", "frequency"
"""Scales: DEGREES is linear in steps of 45 or 90, FREQUENCY logarithmic with plain numbers in Hz."""
NEUTRAL, ALERT = -1, -2
"""In place of the number of a curve: the color of axes, and that of a warning."""
ABOVE, RIGHT, PANELS = "above", "right", "panels"
"""Legends: of all panels above them or at their right, each name once; or of each panel above itself, the lines of
levels above all."""


@dataclass(frozen=True, eq=False)
class Curve:
    """A line or points through (x, y), both of shape (n,); NaN interrupts a line.

    name     the user's name of what is drawn; empty if it needs no entry in the legend
    number   decides color, dashes and marker
    caption  its figures, next to the name in the legend; of a bar, next to the bar
    heat     a value for each point, shown as color and width by the scale of the panel
    reach    radius of a disc around each point, in place of the line: all discs are one pale area
    size     factor on the usual width of the line and size of the markers
    """

    x: np.ndarray
    y: np.ndarray
    name: str = ""
    number: int = 0
    look: str = LINE
    caption: str = ""
    heat: np.ndarray | None = None
    reach: np.ndarray | None = None
    size: float = 1.0


@dataclass(frozen=True, eq=False)
class Band:
    """The area between low(x) and high(x), all of shape (n,), in a pale color; NaN interrupts it.

    name    in the legend; empty if it needs no entry
    number  of the curve that it belongs to; NEUTRAL is gray
    """

    x: np.ndarray
    low: np.ndarray
    high: np.ndarray
    number: int = NEUTRAL
    name: str = ""


@dataclass(frozen=True)
class Mark:
    """A point on a curve; `hollow` tells two kinds of them apart.

    name     written next to it, where it covers neither a point nor another name
    caption  its figures, shown when the pointer is on it
    key      what a click on it selects; empty: nothing
    """

    x: float
    y: float
    number: int = 0
    hollow: bool = False
    name: str = ""
    caption: str = ""
    key: str = ""


@dataclass(frozen=True)
class Level:
    """A straight line over the whole panel at a value of y, or with `upright` of x: dashed a limit, faint an axis.

    text     next to the line
    number   of the curve whose color it has; NEUTRAL is that of axes
    caption  its entry in the legend; dashed lines with different captions differ in their dashes
    """

    value: float
    text: str = ""
    upright: bool = False
    dashed: bool = False
    faint: bool = False
    number: int = NEUTRAL
    caption: str = ""


@dataclass(frozen=True)
class Disc:
    """A circle, dashed like its curve; filled with a pale color of it if it stands for an area; faint: of a grid."""

    x: float
    y: float
    radius: float
    number: int = NEUTRAL
    filled: bool = False
    faint: bool = False


@dataclass(frozen=True)
class Note:
    """A short text at a place: below it at the left, above it at the right, or around it."""

    x: float
    y: float
    text: str
    number: int = NEUTRAL
    right: bool = False
    middle: bool = False


@dataclass(frozen=True)
class Box:
    """A filled rectangle: a bar, a cell of a table, or with None for an end a stretch up to the edge of the panel.

    number   of the curve whose color it has
    name     in the legend; several boxes of one name have one entry
    text     in the middle, or with `beside` next to the end that is farther from 0
    level    -1 to 1 in place of the number: a color from better over none to worse; such a panel is a table
    pale     as an area behind curves
    hatched  uncertain
    """

    left: float
    right: float
    low: float | None = None
    high: float | None = None
    number: int = 0
    name: str = ""
    text: str = ""
    beside: bool = False
    level: float | None = None
    pale: bool = False
    hatched: bool = False


@dataclass(frozen=True, eq=False)
class Field:
    """Values of shape (m, n) over x (n,) and y (m,), shown as color by the scale of the panel."""

    x: np.ndarray
    y: np.ndarray
    values: np.ndarray


@dataclass(frozen=True)
class Heat:
    """The scale of the values of curves or a field that are shown as color: label with its unit, and range."""

    label: str
    low: float
    high: float


@dataclass(frozen=True)
class Tick:
    """A place on an axis with a text in place of its number.

    name     the user's name of a thing: such a place has no grid line
    caption  its figures, next to the name; alone, a number
    """

    value: float
    name: str = ""
    caption: str = ""


@dataclass(frozen=True)
class Abscissa:
    """The axis of x.

    label      with its unit
    low, high  range; None: what the panel needs
    square     a unit of x is as long as one of y, as in the complex plane
    ticks      places that have a text; None: round numbers
    """

    label: str
    scale: str = LINEAR
    low: float | None = None
    high: float | None = None
    square: bool = False
    ticks: tuple[Tick, ...] | None = None


@dataclass(frozen=True, eq=False)
class Panel:
    """One field of a chart.

    label      of y, with its unit
    low, high  range of y; None: what the curves need
    share      of the height, in relation to the other panels
    caption    a line above the panel
    heat       scale of the curves or the field that have values
    ticks      places of y that have a text; None: round numbers
    abscissa   its own axis of x; None: that of the chart, which these panels share
    width      in relation to the other panels of its row
    whole      it takes a row for itself
    """

    label: str
    curves: tuple[Curve, ...] = ()
    marks: tuple[Mark, ...] = ()
    levels: tuple[Level, ...] = ()
    discs: tuple[Disc, ...] = ()
    notes: tuple[Note, ...] = ()
    bands: tuple[Band, ...] = ()
    scale: str = LINEAR
    low: float | None = None
    high: float | None = None
    share: float = 1.0
    caption: str = ""
    heat: Heat | None = None
    boxes: tuple[Box, ...] = ()
    field: Field | None = None
    ticks: tuple[Tick, ...] | None = None
    abscissa: Abscissa | None = None
    width: float = 1.0
    whole: bool = False


@dataclass(frozen=True, eq=False)
class Chart:
    """Panels below each other over the same x, or in rows of several.

    label      of x, with its unit; this and the next ones are those of its `Abscissa`
    low, high  range of x
    square     a unit of x is as long as one of y, as in the complex plane
    bare       without axes: discs and notes say the scale
    height     of a drawing, inches
    columns    of the legend
    factor     from the SI unit of x to that of the label, for what is dragged in the picture
    across     panels in a row, filled from the left
    width      of a drawing, inches; `WIDTH` is that of a report
    side       label of y of all panels together, with its unit
    legend     where it stands: ABOVE, RIGHT or PANELS
    beside     lines at the right of the panels
    caption    a warning above the panels
    """

    label: str
    panels: tuple[Panel, ...]
    scale: str = LINEAR
    low: float | None = None
    high: float | None = None
    square: bool = False
    bare: bool = False
    height: float = 3.0
    columns: int = 4
    factor: float = 1.0
    ticks: tuple[Tick, ...] | None = None
    across: int = 1
    width: float = WIDTH
    side: str = ""
    legend: str = ABOVE
    beside: str = ""
    caption: str = ""

    @property
    def abscissa(self) -> Abscissa:
        """The axis of x that panels without their own share."""
        return Abscissa(self.label, self.scale, self.low, self.high, self.square, self.ticks)

    def shown(self, units: Units) -> Chart:
        """The chart with all its texts in the units of a reader; the numbers stay."""
        label, side, beside, caption = (
            resolve(text, units) for text in (self.label, self.side, self.beside, self.caption)
        )
        panels = tuple(_shown(panel, units) for panel in self.panels)
        return replace(
            self,
            label=label,
            side=side,
            beside=beside,
            caption=caption,
            ticks=_shown_ticks(self.ticks, units),
            panels=panels,
        )


Thing = TypeVar("Thing", Curve, Band, Mark, Level, Note, Box)


def _shown(panel: Panel, units: Units) -> Panel:
    def texts(things: tuple[Thing, ...], *fields: str) -> tuple[Thing, ...]:
        return tuple(
            replace(thing, **{name: resolve(getattr(thing, name), units) for name in fields}) for thing in things
        )

    abscissa = panel.abscissa
    return replace(
        panel,
        label=resolve(panel.label, units),
        caption=resolve(panel.caption, units),
        marks=texts(panel.marks, "caption"),
        heat=panel.heat and replace(panel.heat, label=resolve(panel.heat.label, units)),
        curves=texts(panel.curves, "caption"),
        levels=texts(panel.levels, "text", "caption"),
        notes=texts(panel.notes, "text"),
        bands=texts(panel.bands, "name"),
        boxes=texts(panel.boxes, "text"),
        ticks=_shown_ticks(panel.ticks, units),
        abscissa=abscissa
        and replace(abscissa, label=resolve(abscissa.label, units), ticks=_shown_ticks(abscissa.ticks, units)),
    )


def _shown_ticks(ticks: tuple[Tick, ...] | None, units: Units) -> tuple[Tick, ...] | None:
    return ticks and tuple(replace(tick, caption=resolve(tick.caption, units)) for tick in ticks)


def numbered(values: Iterable[float]) -> tuple[Tick, ...]:
    """Ticks at round numbers."""
    return tuple(Tick(float(value), caption=f"{value:g}") for value in values)


def listed(names: Sequence[str]) -> tuple[Tick, ...]:
    """Ticks of rows with names, the first at the top: at 0, -1, -2, ..."""
    return tuple(Tick(-float(row), name) for row, name in enumerate(names))


def side_by_side(charts: Sequence[Chart], height: float) -> Chart:
    """Charts of one panel in one row; the legend is that of all of them."""
    panels = tuple(replace(panel, abscissa=chart.abscissa) for chart in charts for panel in chart.panels)
    return Chart("", panels, across=len(panels), height=height)


def stairs(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The corners of a curve that keeps each value until the next point, all of shape (n,) -> (2 n - 1,)."""
    return np.repeat(x, 2)[1:], np.repeat(y, 2)[:-1]


def filled_stairs(edges: np.ndarray, heights: np.ndarray, base: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """The corners of the shape of a histogram: heights of shape (n,) above a base, between edges of shape (n + 1,)."""
    x = np.repeat(np.asarray(edges, np.float64), 2)
    return x, np.concatenate([[base], base + np.repeat(heights, 2), [base]])


def rods(x: np.ndarray, low: np.ndarray | float, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Upright lines from low to high at each x of shape (n,), as one curve with gaps: stems, or bars of errors."""
    gap = np.full(x.size, np.nan)
    return (
        np.column_stack([x, x, gap]).ravel(),
        np.column_stack([np.broadcast_to(low, x.shape), high, gap]).ravel(),
    )
