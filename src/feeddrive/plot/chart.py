"""Charts: the content of a picture as a value, separate from its drawing.

A chart consists of panels with curves, marks and limits, with units. Matplotlib draws it (`plot.drawing`), and any
other backend can draw it with the same curves, limits and words. Numbers are in the units that the labels state. `name`
is a name given by the user and is never parsed; all other strings may contain quantities, which `Chart.shown` converts
to the display units.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Self, TypeVar

import numpy as np

from feeddrive.language.quantity import Units, number
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
"""Scales: DEGREES is linear with ticks every 15 to 720 degrees, FREQUENCY is logarithmic with plain numbers in Hz."""
NEUTRAL, ALERT = -1, -2
"""Curve numbers that select the color of axes, and the color of a warning."""
ABOVE, RIGHT, PANELS = "above", "right", "panels"
"""Positions of the legend: one for all panels, above them or to their right, with each name once; or one above each
panel, with the levels above all panels."""


@dataclass(frozen=True, eq=False)
class Curve:
    """A line or points through (x, y), both of shape (n,); NaN interrupts a line.

    name     the user's name of the curve; empty for no legend entry
    number   determines color, dashes and marker
    caption  values shown next to the name in the legend; for a bar, next to the bar
    heat     a value for each point, shown as color and width on the scale of the panel
    reach    radius of a disc around each point, in place of the line; all discs form one pale area
    size     factor on the default line width and marker size
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

    name    legend entry; empty for none
    number  number of the curve that it belongs to; NEUTRAL is gray
    """

    x: np.ndarray
    low: np.ndarray
    high: np.ndarray
    number: int = NEUTRAL
    name: str = ""


@dataclass(frozen=True)
class Mark:
    """A point on a curve; `hollow` distinguishes two kinds of points.

    name     label next to the point, placed so that it covers no point and no other label
    caption  values shown when the pointer is on the point
    key      what a click on the point selects; empty if it selects nothing
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
    """A straight line across the whole panel at a value of y, or of x if `upright`: a dashed limit or a faint axis.

    text     label next to the line
    number   number of the curve whose color is used; NEUTRAL is the color of axes
    caption  its legend entry; dashed lines with different captions have different dashes
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
    """A circle, dashed like its curve; if `filled` an area in a pale color, if `faint` a grid line."""

    x: float
    y: float
    radius: float
    number: int = NEUTRAL
    filled: bool = False
    faint: bool = False


@dataclass(frozen=True)
class Note:
    """A short text at a point: below left by default, above right if `right`, centered on it if `middle`."""

    x: float
    y: float
    text: str
    number: int = NEUTRAL
    right: bool = False
    middle: bool = False


@dataclass(frozen=True)
class Box:
    """A filled rectangle: a bar, a table cell, or, if `low` or `high` is None, an area over the full height of the
    panel.

    number   number of the curve whose color is used
    name     legend entry; boxes with the same name share an entry
    text     text in the middle, or with `beside` next to the end that is farther from 0
    level    -1 to 1 in place of the number: a color from better through neutral to worse; a panel of such boxes is a
             table
    pale     True for an area behind curves
    hatched  True for an uncertain value
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
    """Values of shape (m, n) over x (n,) and y (m,), shown as color on the scale of the panel."""

    x: np.ndarray
    y: np.ndarray
    values: np.ndarray


@dataclass(frozen=True)
class Heat:
    """The color scale of the values of curves or of a field: label with unit, and range."""

    label: str
    low: float
    high: float


@dataclass(frozen=True)
class Tick:
    """A position on an axis with a text in place of its number.

    name     a name given by the user; such a position has no grid line
    caption  values shown next to the name; without a name, the number shown
    """

    value: float
    name: str = ""
    caption: str = ""


@dataclass(frozen=True)
class Abscissa:
    """The x axis.

    label      label with unit
    low, high  range; None: fitted to the panel
    square     True for equal scales of x and y, as in the complex plane
    ticks      positions with a text; None: round numbers
    """

    label: str
    scale: str = LINEAR
    low: float | None = None
    high: float | None = None
    square: bool = False
    ticks: tuple[Tick, ...] | None = None


@dataclass(frozen=True, eq=False)
class Panel:
    """One set of axes in a chart.

    label      label of y, with unit
    low, high  range of y; None: fitted to the curves
    share      height relative to the other panels
    caption    a line of text above the panel
    heat       color scale of curves or fields with values
    ticks      positions on y with a text; None: round numbers
    abscissa   its own x axis; None: the x axis of the chart, which such panels share
    width      width relative to the other panels of its row
    whole      True if it takes up a whole row
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
    """Panels stacked over the same x axis, or arranged in rows.

    label      label of x, with unit; this and the next ones define the shared `Abscissa`
    low, high  range of x
    square     True for equal scales of x and y, as in the complex plane
    bare       True for no axes: discs and notes show the scale
    height     height of the drawing, inches
    columns    columns of the legend
    factor     conversion factor from the SI unit of x to that of the label, for values dragged in the picture
    across     number of panels in a row, filled from the left
    width      width of the drawing, inches; `WIDTH` is that of a report
    side       common y label of all panels, with unit
    legend     position of the legend: ABOVE, RIGHT or PANELS
    beside     text to the right of the panels
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
        """The x axis shared by all panels without their own."""
        return Abscissa(self.label, self.scale, self.low, self.high, self.square, self.ticks)

    def shown(self, units: Units) -> Self:
        """Return the chart with all quantities in its strings converted to the given display units; the numbers
        are unchanged.
        """
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
        # The name of a band is a text of feeddrive; those of curves, marks and ticks are the user's.
        bands=texts(panel.bands, "name"),
        boxes=texts(panel.boxes, "text"),
        ticks=_shown_ticks(panel.ticks, units),
        abscissa=abscissa
        and replace(abscissa, label=resolve(abscissa.label, units), ticks=_shown_ticks(abscissa.ticks, units)),
    )


def _shown_ticks(ticks: tuple[Tick, ...] | None, units: Units) -> tuple[Tick, ...] | None:
    return ticks and tuple(replace(tick, caption=resolve(tick.caption, units)) for tick in ticks)


def numbered(values: Iterable[float]) -> tuple[Tick, ...]:
    """Return ticks at the given numbers."""
    return tuple(Tick(float(value), caption=number(value, 6)) for value in values)


def listed(names: Sequence[str]) -> tuple[Tick, ...]:
    """Return one labelled tick per row, at 0, -1, -2, ... from top to bottom."""
    return tuple(Tick(-float(row), name) for row, name in enumerate(names))


def side_by_side(charts: Sequence[Chart], height: float) -> Chart:
    """Return one chart with the panels of several charts in a row and a common legend."""
    panels = tuple(replace(panel, abscissa=chart.abscissa) for chart in charts for panel in chart.panels)
    return Chart("", panels, across=len(panels), height=height)


def stairs(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners of a stair-step curve that holds each value until the next point: shape (n,) -> (2 n - 1,)."""
    return np.repeat(x, 2)[1:], np.repeat(y, 2)[:-1]


def filled_stairs(edges: np.ndarray, heights: np.ndarray, base: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Return the outline of a histogram with heights of shape (n,) above a base, between edges of shape (n + 1,)."""
    x = np.repeat(np.asarray(edges, np.float64), 2)
    return x, np.concatenate([[base], base + np.repeat(heights, 2), [base]])


def rods(x: np.ndarray, low: np.ndarray | float, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return vertical lines from low to high at each x of shape (n,), as one curve with gaps: stems or error bars."""
    gap = np.full(x.size, np.nan)
    return (
        np.column_stack([x, x, gap]).ravel(),
        np.column_stack([np.broadcast_to(low, x.shape), high, gap]).ravel(),
    )
