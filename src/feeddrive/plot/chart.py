"""What a picture shows, without how it is drawn: panels of curves, marks and limits, each with names and units.

A chart is drawn by matplotlib (`plot.drawing`), and may be drawn by anything else, with the same curves, limits and
words.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from feeddrive.language.quantity import Units
from feeddrive.language.text import resolve

LINE, THIN, BAR, DOTS, PLUS = "line", "thin", "bar", "dots", "plus"
CROSS, RING, SOLID = "cross", "ring", "solid"
"""Looks of a curve: THIN accompanies a line, BAR is short and wide, DOTS are measured, PLUS is a place by itself.

CROSS are poles, RING are zeros: single places without a line. SOLID is a filled shape with these corners.
"""
LINEAR, LOG, DEGREES, FREQUENCY = "linear", "log", "degrees", "frequency"
"""Scales: DEGREES is linear in steps of 45 or 90, FREQUENCY logarithmic with plain numbers in Hz."""
NEUTRAL, ALERT = -1, -2
"""In place of the number of a curve: the color of axes, and that of a warning."""


@dataclass(frozen=True, eq=False)
class Curve:
    """A line or points through (x, y), both of shape (n,); NaN interrupts a line.

    name    of what it is of, as a person called it; empty if it needs no entry in the legend
    number  decides color, dashes and marker
    said    its figures, beside the name in the legend; of a bar, beside it
    heat    a value for each point, shown as color and width by the scale of the panel
    reach   radius of a disc around each point, in place of the line: all discs are one pale area
    """

    x: np.ndarray
    y: np.ndarray
    name: str = ""
    number: int = 0
    look: str = LINE
    said: str = ""
    heat: np.ndarray | None = None
    reach: np.ndarray | None = None


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

    name  written beside it, where it covers neither a point nor another name
    said  its figures, for who points at it
    key   what a click on it means; empty: nothing
    """

    x: float
    y: float
    number: int = 0
    hollow: bool = False
    name: str = ""
    said: str = ""
    key: str = ""


@dataclass(frozen=True)
class Level:
    """A straight line over the whole panel at a value of y, or with `upright` of x: dashed a limit, faint an axis."""

    value: float
    text: str = ""
    upright: bool = False
    dashed: bool = False
    faint: bool = False


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
class Heat:
    """The scale of the values of curves that are shown as color: label with its unit, and range."""

    label: str
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class Panel:
    """One field of a chart.

    label      of y, with its unit
    low, high  range of y; None: what the curves need
    share      of the height, in relation to the other panels
    said       a line above it
    heat       scale of the curves that have values
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
    said: str = ""
    heat: Heat | None = None


@dataclass(frozen=True, eq=False)
class Chart:
    """Panels below each other over the same x.

    label      of x, with its unit
    low, high  range of x
    square     a unit of x is as long as one of y, as in the complex plane
    bare       without axes: discs and notes say the scale
    height     of a drawing in the width of a report, inches
    columns    of the legend
    factor     from the SI unit of x to that of the label, for what is dragged in the picture
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

    def shown(self, units: Units) -> Chart:
        """The chart with all its texts in the units of a reader; the numbers stay."""
        return replace(
            self, label=resolve(self.label, units), panels=tuple(_shown(each, units) for each in self.panels)
        )


def _shown(panel: Panel, units: Units) -> Panel:
    return replace(
        panel,
        label=resolve(panel.label, units),
        said=resolve(panel.said, units),
        marks=tuple(replace(each, said=resolve(each.said, units)) for each in panel.marks),
        heat=panel.heat and replace(panel.heat, label=resolve(panel.heat.label, units)),
        curves=tuple(replace(each, said=resolve(each.said, units)) for each in panel.curves),
        levels=tuple(replace(each, text=resolve(each.text, units)) for each in panel.levels),
        notes=tuple(replace(each, text=resolve(each.text, units)) for each in panel.notes),
        bands=tuple(replace(each, name=resolve(each.name, units)) for each in panel.bands),
    )
