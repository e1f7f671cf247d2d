"""Pictures of a part program on a machine: the contour error of each law, the force of the cut and its estimates."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from feeddrive.language.quantity import Quantity, unit_name
from feeddrive.language.text import Text
from feeddrive.plot import style
from feeddrive.plot.chart import Chart, Curve, Panel
from feeddrive.plot.drawing import drawn
from feeddrive.plot.style import POINTS, envelope

if TYPE_CHECKING:
    from feeddrive.machining.part_run import PartRun

_WINDOW = 0.15  # s of estimates that are shown
_BEFORE, _AFTER = 0.04, 0.1  # s around a worst place
_SIZES = (("RMS", "o"), ("95 % of the path", "s"), ("largest", "^"))


def part_run(part: PartRun) -> Any:
    """The contour error over time; gray: what does not count."""
    figure, (ax,) = style.picture()
    contour = part.contour
    error = 1e6 * np.abs(contour.error)
    ax.plot(*envelope(contour.time, error), color=style.MUTED, linewidth=0.7, alpha=0.6, label="does not count")
    ax.plot(*envelope(contour.time, np.where(part.contour.counted, error, 0.0)), label="counts", **style.curve(0))
    style.labels(ax, "time (s)", f"contour error ({unit_name('um')})")
    style.note(ax, Text(f"RMS {Quantity(part.contour.rms, 'm')}, largest {Quantity(part.contour.largest, 'm')}"))
    style.legend(figure, ax)
    return figure


def part_laws(parts: Mapping[str, PartRun]) -> Any:
    """RMS, 95 % and the largest contour error of each law, a row each, on a logarithmic scale."""
    figure, (ax,) = style.picture(height=1.1 + 0.36 * len(parts))
    sizes = np.array([(each.contour.rms, each.contour.within(), each.contour.largest) for each in parts.values()])
    rows = -np.arange(len(parts))
    shown = 1e6 * np.maximum(sizes, 1e-12)
    ax.hlines(rows, shown.min(axis=1), shown.max(axis=1), color=style.GRID, linewidth=3.0)
    for k, (name, marker) in enumerate(_SIZES):
        ax.plot(shown[:, k], rows, marker, color=style.color(k), markersize=6.5, label=name)
    ax.set_xscale("log")
    style.plain_decades(ax.xaxis, between=True)
    ax.set_xlim(0.7 * shown.min(), 1.5 * shown.max())
    ax.set_ylim(rows[-1] - 0.6, 0.6)
    ax.set_yticks(rows, [style.caption(name) or "" for name in parts])
    ax.set_xlabel(style.read(f"contour error ({unit_name('um')})"), fontsize=style.TEXT)
    style.legend(figure, ax)
    return figure


def part_cutting(part: PartRun) -> Any:
    """The force of the cut on each axis over time."""
    assert part.cutting is not None
    names = part.contour.axes
    figure, axes = style.picture(len(names), height=0.9 + 1.15 * len(names))
    for i, (ax, name) in enumerate(zip(axes, names, strict=True)):
        ax.plot(
            *envelope(part.contour.time, part.cutting[:, i], POINTS // 2),
            **style.curve(i) | {"linewidth": 0.8, "linestyle": "-"},
        )
        style.labels(ax, "time (s)" if i == len(names) - 1 else None, f"on {name} ({unit_name('N')})")
    figure.align_ylabels(axes)
    return figure


def part_estimates(part: PartRun, axis: str) -> Any:
    """What acts on an axis and what observers make of it, around the largest force of the cut that lasts."""
    time, true = part.contour.time, part.disturbances[axis]
    figure, (ax,) = style.picture(height=3.4)
    middle = _busiest(part, axis)
    shown = (time >= middle - 0.5 * _WINDOW) & (time <= middle + 0.5 * _WINDOW)
    ax.plot(1e3 * time[shown], true[shown], color=style.MUTED, linewidth=1.0, alpha=0.6, label="what acts")
    for i, (name, by) in enumerate(part.estimates.items()):
        if axis in by:
            label = style.read(f"{name.replace('_', ' ')}, {Quantity(by[axis].lag, 's'):3} late")
            ax.plot(1e3 * time[shown], by[axis].disturbance[shown], label=label, **style.curve(i))
    style.labels(ax, "time (ms)", f"force on {axis} ({unit_name('N')})")
    style.legend(figure, ax, 2)
    return figure


def _busiest(part: PartRun, axis: str) -> float:
    """The middle of the window with the largest RMS force of the cut on an axis, s."""
    assert part.cutting is not None
    time = part.contour.time
    square = part.cutting[:, part.contour.axes.index(axis)] ** 2
    width = max(1, min(len(time) - 1, round(_WINDOW / (time[1] - time[0]))))
    total = np.cumsum(np.insert(square, 0, 0.0))
    return float(time[int(np.argmax(total[width:] - total[:-width])) + width // 2])


def part_zoom(parts: Mapping[str, PartRun], time: float) -> Any:
    """The contour error of each law around an instant."""
    return drawn(part_zoom_chart(parts, time))


def part_zoom_chart(parts: Mapping[str, PartRun], time: float) -> Chart:
    """What `part_zoom` shows: ms from the instant, µm."""
    curves = list[Curve]()
    for k, (name, part) in enumerate(parts.items()):
        at = part.contour.time
        shown = (at >= time - _BEFORE) & (at <= time + _AFTER)
        curves.append(Curve(1e3 * (at[shown] - time), 1e6 * np.abs(part.contour.error[shown]), name, k))
    panel = Panel(f"contour error ({unit_name('um')})", tuple(curves))
    return Chart("time after the worst instant (ms)", (panel,), height=3.4, columns=3)
