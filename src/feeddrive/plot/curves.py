"""Plots of plain curves, for experiments: rows over one abscissa, moving poles, one turn of a tool, magnitudes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from feeddrive.language.quantity import Quantity, unit_name
from feeddrive.language.text import Text
from feeddrive.plot import style
from feeddrive.plot.style import envelope

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence


class Row(NamedTuple):
    """Curves by name over the common abscissa, under one ordinate; `logarithmic` is its scale."""

    ordinate: str
    curves: Mapping[str, np.ndarray]
    logarithmic: bool = False


def curves(
    abscissa: str,
    x: np.ndarray,
    rows: Sequence[Row],
    *,
    frequency: bool = False,
    levels: Mapping[str, float] | None = None,
) -> Any:
    """Rows of curves over x; a name keeps its color in all rows.  `frequency`: x in Hz, logarithmic.

    levels  horizontal lines in the first row, by name
    """
    names = list(dict.fromkeys(name for row in rows for name in row.curves))
    figure, axes = style.picture(len(rows), height=1.2 + 1.9 * len(rows))
    drawn: dict[str, Any] = {}
    for ax, row in zip(axes, rows, strict=True):
        for name, values in row.curves.items():
            (line,) = ax.plot(x, values, **style.curve(names.index(name)))
            drawn.setdefault(style.caption(name) or "", line)
        if row.logarithmic:
            ax.set_yscale("log")
        style.labels(ax, None, row.ordinate)
    for name, level in (levels or {}).items():
        axes[0].axhline(level, color=style.MUTED, linewidth=1.0, linestyle=(0, (4, 3)))
        axes[0].annotate(style.read(name), (1.0, level), xycoords=("axes fraction", "data"), xytext=(-4, 2),
                         textcoords="offset points", ha="right", fontsize=style.SMALL, color=style.MUTED)  # fmt: skip
    axes[-1].set_xlabel(style.read(abscissa), fontsize=style.TEXT)
    if frequency:
        style.frequency_axis(axes[-1], float(x[0]), float(x[-1]))
        style.frequency_grid(axes)
    if "" not in drawn or len(drawn) > 1:
        style.figure_legend(figure, drawn)
    return figure


def pole_sweep(sweeps: Mapping[str, Sequence[np.ndarray]], said: str = "") -> Any:
    """Poles in the s plane (rad/s) of several systems along a sweep: the marks grow from point to point."""
    figure, (ax,) = style.picture(1, height=4.2)
    for i, (name, points) in enumerate(sweeps.items()):
        for k, poles in enumerate(points):
            ax.plot(
                np.real(poles), np.imag(poles), style.MARKERS[i % len(style.MARKERS)], color=style.color(i),
                markersize=3.5 + 1.5 * k, markerfacecolor="none", markeredgewidth=1.2,
                label=style.caption(name) if k == 0 else None,
            )  # fmt: skip
    ax.axhline(0.0, color=style.MUTED, linewidth=0.8)
    ax.axvline(0.0, color=style.MUTED, linewidth=0.8)
    ax.margins(0.08)
    style.labels(ax, "real part of s (rad/s)", "imaginary part of s (rad/s)")
    if said:
        style.note(ax, said)
    style.legend(figure, ax)
    return figure


def turn(angle: np.ndarray, forces: Mapping[str, np.ndarray]) -> Any:
    """Forces in N by name over the angle of the spindle in rad, with the mean of each as a thin line."""
    figure, (ax,) = style.picture(1, height=3.2)
    for i, (name, force) in enumerate(forces.items()):
        mean = float(np.mean(force))
        ax.plot(
            np.degrees(angle), force, label=style.caption(name, Text(f"mean {Quantity(mean, 'N')}")), **style.curve(i)
        )
        ax.axhline(mean, color=style.color(i), linewidth=0.8, alpha=0.6)
    ax.set_xlim(0.0, 360.0)
    ax.set_xticks(np.arange(0.0, 361.0, 45.0))
    style.labels(ax, "angle of the spindle (deg)", f"force on the tool ({unit_name('N')})")
    style.legend(figure, ax, 3)
    return figure


def by_axis(time: np.ndarray, rows: Mapping[str, Mapping[str, np.ndarray]], quantity: str) -> Any:
    """One row for each axis, with its curves by name, over time in s; quantity with its unit."""
    figure, axes = style.picture(len(rows), height=0.9 + 1.45 * len(rows))
    for ax, (axis, curves) in zip(axes, rows.items(), strict=True):
        for i, (name, values) in enumerate(curves.items()):
            ax.plot(*envelope(time, values), label=style.caption(name), **style.curve(i))
        style.note(ax, axis)
    style.labels(axes[-1], "time (s)", "")
    figure.supylabel(style.read(quantity), fontsize=style.TEXT, color=style.INK)
    if any(len(curves) > 1 for curves in rows.values()):
        style.legend(figure, axes[0])
    return figure


def left_over(
    curves: Mapping[str, tuple[np.ndarray, np.ndarray]],
    measured: Mapping[str, tuple[np.ndarray, np.ndarray]],
    quantity: str,
    place: tuple[float, str],
    one: bool = True,
) -> Any:
    """Magnitudes over frequency in Hz on a logarithmic scale, measured ones as marks, one frequency as a line.

    `one` draws the line at 1, above which a compensation amplifies.
    """
    figure, (ax,) = style.picture(1, height=3.6)
    for i, (name, (frequency, magnitude)) in enumerate(curves.items()):
        ax.plot(frequency, magnitude, label=style.caption(name), **style.curve(i))
    for i, name in enumerate(curves):
        if name in measured:
            ax.plot(
                *measured[name], style.MARKERS[i % len(style.MARKERS)], color=style.color(i), markersize=5,
                label=style.caption(name, "measured in the loop"),
            )  # fmt: skip
    if one:
        ax.axhline(1.0, color=style.MUTED, linewidth=1.0, linestyle=(0, (4, 3)))
    ax.axvline(place[0], color=style.INK, linewidth=1.0, linestyle=(0, (4, 3)))
    ax.annotate(style.read(place[1]), (place[0], 0.0), xycoords=("data", "axes fraction"), xytext=(3, 4),
                textcoords="offset points", fontsize=style.SMALL, color=style.MUTED)  # fmt: skip
    ax.set_yscale("log")
    style.plain_decades(ax.yaxis)
    frequencies = [frequency for frequency, _ in curves.values()]
    style.frequency_axis(ax, min(float(f[0]) for f in frequencies), max(float(f[-1]) for f in frequencies))
    style.labels(ax, "frequency (Hz)", quantity)
    style.legend(figure, ax, 3)
    return figure
