"""Plots of plain curves, for experiments: rows over one abscissa, moving poles, one turn of a tool, magnitudes."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from feeddrive.language.quantity import Quantity, unit_name
from feeddrive.language.text import Text
from feeddrive.plot import style
from feeddrive.plot.chart import FREQUENCY, HOLLOW, LINEAR, LOG, MARKERS, Chart, Curve, Level, Panel, numbered
from feeddrive.plot.drawing import figure_of
from feeddrive.plot.style import envelope

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence


class Row(NamedTuple):
    """Curves by name over the common abscissa, under one ordinate; `logarithmic` is its scale."""

    ordinate: str
    curves: Mapping[str, np.ndarray]
    logarithmic: bool = False


def curves_chart(
    abscissa: str,
    x: np.ndarray,
    rows: Sequence[Row],
    *,
    frequency: bool = False,
    levels: Mapping[str, float] | None = None,
) -> Chart:
    """Rows of curves over x; a name keeps its color in all rows.  `frequency`: x in Hz, logarithmic.

    levels  horizontal lines in the first row, by name
    """
    names = list(dict.fromkeys(name for row in rows for name in row.curves))
    panels = list[Panel]()
    for row in rows:
        lines = tuple(Curve(x, np.asarray(values), name, names.index(name)) for name, values in row.curves.items())
        limits = () if panels else tuple(Level(value, name, dashed=True) for name, value in (levels or {}).items())
        panels.append(Panel(row.ordinate, lines, levels=limits, scale=LOG if row.logarithmic else LINEAR))
    span = (float(x[0]), float(x[-1])) if frequency else (None, None)
    return Chart(abscissa, tuple(panels), FREQUENCY if frequency else LINEAR, *span, height=1.2 + 1.9 * len(rows))


curves = figure_of(curves_chart)


def pole_sweep_chart(sweeps: Mapping[str, Sequence[np.ndarray]], caption: str = "") -> Chart:
    """Poles in the s plane (rad/s) of several systems along a sweep: the marks grow from point to point."""
    marks = tuple(
        Curve(np.real(poles), np.imag(poles), "" if k else name, i, HOLLOW, size=0.7 + 0.3 * k)
        for i, (name, points) in enumerate(sweeps.items())
        for k, poles in enumerate(points)
    )
    x, y = (np.concatenate([[0.0], *(getattr(curve, axis) for curve in marks)]) for axis in ("x", "y"))
    (left, right), (low, high) = (style.padded(float(np.min(row)), float(np.max(row)), 0.08) for row in (x, y))
    axes = Level(0.0, faint=True), Level(0.0, upright=True, faint=True)
    panel = Panel("imaginary part of s (rad/s)", marks, levels=axes, low=low, high=high, caption=caption)
    return Chart("real part of s (rad/s)", (panel,), low=left, high=right, height=4.2)


pole_sweep = figure_of(pole_sweep_chart)


def turn_chart(angle: np.ndarray, forces: Mapping[str, np.ndarray]) -> Chart:
    """Forces in N by name over the angle of the spindle in rad, with the mean of each as a thin line."""
    lines, means = list[Curve](), list[Level]()
    for i, (name, force) in enumerate(forces.items()):
        mean = float(np.mean(force))
        lines.append(Curve(np.degrees(angle), force, name, i, caption=Text(f"mean {Quantity(mean, 'N')}")))
        means.append(Level(mean, faint=True, number=i))
    panel = Panel(f"force on the tool ({unit_name('N')})", tuple(lines), levels=tuple(means))
    ticks = numbered(np.arange(0.0, 361.0, 45.0))
    return Chart("angle of the spindle (deg)", (panel,), low=0.0, high=360.0, ticks=ticks, height=3.2, columns=3)


turn = figure_of(turn_chart)


def by_axis_chart(time: np.ndarray, rows: Mapping[str, Mapping[str, np.ndarray]], quantity: str) -> Chart:
    """One row for each axis, with its curves by name, over time in s; quantity with its unit."""
    several = any(len(curves) > 1 for curves in rows.values())
    panels = tuple(
        Panel(
            "",
            tuple(Curve(*envelope(time, v), name if several else "", i) for i, (name, v) in enumerate(lines.items())),
            caption=axis,
        )
        for axis, lines in rows.items()
    )
    return Chart("time (s)", panels, height=0.9 + 1.45 * len(rows), side=quantity)


by_axis = figure_of(by_axis_chart)


def left_over_chart(
    curves: Mapping[str, tuple[np.ndarray, np.ndarray]],
    measured: Mapping[str, tuple[np.ndarray, np.ndarray]],
    quantity: str,
    place: tuple[float, str],
    one: bool = True,
) -> Chart:
    """Magnitudes over frequency in Hz on a logarithmic scale, measured ones as marks, one frequency as a line.

    `one` draws the line at 1, above which a compensation amplifies.
    """
    lines = [Curve(f, magnitude, name, i) for i, (name, (f, magnitude)) in enumerate(curves.items())]
    lines += [
        Curve(*measured[name], name, i, MARKERS, "measured in the loop", size=1.1)
        for i, name in enumerate(curves)
        if name in measured
    ]
    levels = [Level(1.0, dashed=True)] if one else []
    levels.append(Level(place[0], place[1], upright=True, dashed=True))
    ends = [float(f[k]) for f, _ in curves.values() for k in (0, -1)]
    panel = Panel(quantity, tuple(lines), levels=tuple(levels), scale=LOG)
    return Chart("frequency (Hz)", (panel,), FREQUENCY, min(ends), max(ends), height=3.6, columns=3)


left_over = figure_of(left_over_chart)
