"""What a picture shows, without how it is drawn: panels of curves, marks and limits, each with names and units.

A chart is drawn by matplotlib (`plot.drawing`), and may be drawn by anything else, with the same curves, limits and
words.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from feeddrive.language.units import turning_text

LINE, THIN, BAR, DOTS, PLUS, CROSS, RING = "line", "thin", "bar", "dots", "plus", "cross", "ring"
"""Looks of a curve: THIN accompanies a line, BAR is short and wide, DOTS are measured, PLUS is a place by itself.

CROSS are poles, RING are zeros: single places without a line.
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
    """

    x: np.ndarray
    y: np.ndarray
    name: str = ""
    number: int = 0
    look: str = LINE
    said: str = ""


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
    """A point on a curve; `hollow` tells two kinds of them apart."""

    x: float
    y: float
    number: int = 0
    hollow: bool = False


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
    """A circle, dashed like its curve; filled with a pale color of it if it stands for an area."""

    x: float
    y: float
    radius: float
    number: int = NEUTRAL
    filled: bool = False


@dataclass(frozen=True)
class Note:
    """A short text at a place: below it at the left, or above it at the right."""

    x: float
    y: float
    text: str
    number: int = NEUTRAL
    right: bool = False


@dataclass(frozen=True, eq=False)
class Panel:
    """One field of a chart.

    label      of y, with its unit
    low, high  range of y; None: what the curves need
    share      of the height, in relation to the other panels
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


@dataclass(frozen=True, eq=False)
class Chart:
    """Panels below each other over the same x.

    label      of x, with its unit
    low, high  range of x
    square     a unit of x is as long as one of y, as in the complex plane
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
    height: float = 3.0
    columns: int = 4
    factor: float = 1.0

    def turning(self, kept: Collection[str] = ()) -> Chart:
        """The same of an axis that turns: in rad, N m and kg m2; `kept` is what a person wrote."""
        return replace(
            self, label=turning_text(self.label, kept), panels=tuple(_turning(each, kept) for each in self.panels)
        )


def _turning(panel: Panel, kept: Collection[str]) -> Panel:
    return replace(
        panel,
        label=turning_text(panel.label, kept),
        curves=tuple(replace(each, said=turning_text(each.said, kept)) for each in panel.curves),
        levels=tuple(replace(each, text=turning_text(each.text, kept)) for each in panel.levels),
        notes=tuple(replace(each, text=turning_text(each.text, kept)) for each in panel.notes),
        bands=tuple(replace(each, name=turning_text(each.name, kept)) for each in panel.bands),
    )
