"""A chart drawn by matplotlib, in the common style."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from feeddrive.language.quantity import Units
from feeddrive.language.table import READER
from feeddrive.plot import chart as looks
from feeddrive.plot import style
from feeddrive.plot.chart import Band, Chart, Curve, Disc, Heat, Level, Note, Panel
from feeddrive.plot.mark_names import name_marks

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes

_DASHED = (0, (4, 3))
_COLD, _HOT = 1.1, 2.6  # width of the smallest and the largest value


def drawn(chart: Chart, units: Units | None = None) -> Any:
    """The picture of a chart in the width of a report, with its texts in the units of a reader; None: of `READER`."""
    chart = chart.shown(units or READER.get())
    shares = [panel.share for panel in chart.panels]
    figure, axes = style.picture(len(shares), height=chart.height, ratios=shares)
    draw_chart(chart, axes)
    style.legend(figure, axes[0], chart.columns)
    return figure


def draw_chart(chart: Chart, axes: Sequence[Axes]) -> None:
    """The panels of a chart into axes below each other, without a legend."""
    if chart.scale == looks.FREQUENCY:
        assert chart.low is not None
        assert chart.high is not None
        style.frequency_axis(axes[-1], chart.low, chart.high)
    elif chart.low is not None:
        axes[-1].set_xlim(chart.low, chart.high)
    logarithmic = chart.scale == looks.LOG
    if logarithmic:
        axes[-1].set_xscale("log")
        style.plain_decades(axes[-1].xaxis, between=True)
    for ax, panel in zip(axes, chart.panels, strict=True):
        if chart.square:
            ax.set_aspect("equal")
        _panel(ax, panel, crowded=len(axes) > 2, between=logarithmic)
        style.labels(ax, chart.label if ax is axes[-1] else None, panel.label)
        if panel.said:
            style.note(ax, style.caption(panel.said, most=120) or "")
        if chart.bare:
            ax.set_axis_off()
    if chart.scale == looks.FREQUENCY:
        style.frequency_grid(axes)
    if any(mark.name for panel in chart.panels for mark in panel.marks):
        axes[0].get_figure(root=True).draw_without_rendering()  # type: ignore[union-attr]
        for ax, panel in zip(axes, chart.panels, strict=True):
            name_marks(ax, panel.marks, _color)


def _panel(ax: Axes, panel: Panel, crowded: bool, between: bool) -> None:
    for level in panel.levels:
        _level(ax, level)
    for disc in panel.discs:
        _disc(ax, disc)
    for band in panel.bands:
        _band(ax, band)
    for curve in panel.curves:
        if curve.heat is None:
            _curve(ax, curve)
        elif panel.heat is not None:
            _heat(ax, curve, curve.heat, panel.heat)
    for mark in panel.marks:
        face: dict[str, Any] = {"markerfacecolor": style.PAPER} if mark.hollow else {}
        ax.plot([mark.x], [mark.y], style.MARKERS[mark.number % len(style.MARKERS)], color=_color(mark.number),
                markersize=6.0 if mark.name else 4.5, **face)  # fmt: skip
    for note in panel.notes:
        _note(ax, note)
    if panel.scale == looks.LOG:
        ax.set_yscale("log")
        style.plain_decades(ax.yaxis, crowded=crowded, between=between)
        ax.grid(True, which="minor", axis="y", color=style.GRID, linewidth=0.4)
    if panel.scale == looks.DEGREES:
        assert panel.low is not None
        assert panel.high is not None
        style.degrees_axis(ax, panel.low, panel.high)
    elif panel.low is not None or panel.high is not None:
        ax.set_ylim(panel.low, panel.high)


def _level(ax: Axes, level: Level) -> None:
    draw = ax.axvline if level.upright else ax.axhline
    tint = style.MUTED if level.dashed or level.faint else style.INK
    draw(level.value, color=tint, linewidth=0.8 if level.faint else 1.0, linestyle=_DASHED if level.dashed else "-")
    if not level.text:
        return
    where, of = ((level.value, 1.0), ("data", "axes fraction")) if level.upright else (
        (0.0, level.value), ("axes fraction", "data"))  # fmt: skip
    ax.annotate(style.read(level.text), where, xycoords=of, xytext=(4, -2), textcoords="offset points", va="top",
                fontsize=style.SMALL, color=style.MUTED)  # fmt: skip


def _disc(ax: Axes, disc: Disc) -> None:
    from matplotlib.patches import Circle

    where, tint = (disc.x, disc.y), style.GRID if disc.faint else _color(disc.number, style.MUTED)
    if disc.filled:
        ax.add_patch(Circle(where, disc.radius, facecolor=tint, alpha=0.10, edgecolor="none"))
    dashes = "-" if disc.faint else _DASHED if disc.number < 0 else style.DASHES[disc.number % len(style.DASHES)]
    ax.add_patch(Circle(where, disc.radius, fill=False, edgecolor=tint, linewidth=0.9, linestyle=dashes))


def _note(ax: Axes, note: Note) -> None:
    off, across, along = (3, "left", "bottom") if note.right else (-5, "right", "top")
    if note.middle:
        off, across, along = 0, "center", "center"
    ax.annotate(style.read(note.text), (note.x, note.y), xytext=(off, off), textcoords="offset points", ha=across,
                va=along, fontsize=style.SMALL, color=_color(note.number, style.MUTED))  # fmt: skip


def _heat(ax: Axes, curve: Curve, heat: np.ndarray, scale: Heat) -> None:
    """A curve in steps of color and width, and the bar that says which value is which."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LinearSegmentedColormap, Normalize

    n = style.HEAT_STEPS
    colors = LinearSegmentedColormap.from_list("heat", style.HEAT, n)
    larger = np.maximum(heat[:-1], heat[1:])  # of the line from each point to the next
    step = np.clip(np.floor(n * (larger - scale.low) / (scale.high - scale.low)), 0, n - 1)  # NaN stays: no line
    for k in range(n):
        rows = np.flatnonzero(step == k)
        if rows.size:
            x, y = (_stretches(row, rows) for row in (curve.x, curve.y))
            ax.plot(x, y, color=colors(k), linewidth=_COLD + (_HOT - _COLD) * k / (n - 1), solid_capstyle="round")
    bar = ax.figure.colorbar(ScalarMappable(Normalize(scale.low, scale.high), colors), ax=ax, pad=0.02, aspect=30)
    bar.set_label(style.read(scale.label), fontsize=style.TEXT, color=style.INK)
    bar.ax.tick_params(colors=style.MUTED, labelcolor=style.INK, labelsize=style.SMALL)
    bar.outline.set_visible(False)  # type: ignore[operator]


def _stretches(values: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """The lines from some points to their next ones, with NaN where one does not go on."""
    ends = np.append(np.diff(rows) > 1, True)
    count = np.where(ends, 3, 1)
    last = np.cumsum(count)[ends] - 1
    taken = np.repeat(rows, count)
    taken[last - 1] += 1
    found = values[taken].astype(np.float64)
    found[last] = np.nan
    return found


def _band(ax: Axes, band: Band) -> None:
    ax.fill_between(
        band.x, band.low, band.high, color=_color(band.number, style.MUTED), alpha=0.18, linewidth=0.0,
        label=style.caption(band.name),
    )  # fmt: skip


def _curve(ax: Axes, curve: Curve) -> None:
    tint = _color(curve.number)
    if curve.reach is not None:
        _discs(ax, curve, curve.reach)
    elif curve.look == looks.LINE and curve.number < 0:
        ax.plot(curve.x, curve.y, color=tint, linewidth=style.LINE, label=style.caption(curve.name, curve.said))
    elif curve.look == looks.LINE:
        ax.plot(curve.x, curve.y, label=style.caption(curve.name, curve.said), **style.curve(curve.number))
    elif curve.look == looks.THIN:
        ax.plot(curve.x, curve.y, color=tint, linewidth=0.6, alpha=0.6, label=style.caption(curve.name, curve.said))
    elif curve.look == looks.SOLID:
        ax.fill(curve.x, curve.y, color=tint, linewidth=0.0)
    elif curve.look == looks.DOTS:
        ax.plot(curve.x, curve.y, ".", color=tint, markersize=3.0, alpha=0.6,
                label=style.caption(curve.name, curve.said))  # fmt: skip
    elif curve.look == looks.CROSS:
        ax.plot(curve.x, curve.y, "x", color=tint, markersize=7, markeredgewidth=1.6,
                label=style.caption(curve.name, curve.said))  # fmt: skip
    elif curve.look == looks.RING:
        ax.plot(curve.x, curve.y, "o", color=tint, markersize=5.5, markerfacecolor="none",
                label=style.caption(curve.name, curve.said))  # fmt: skip
    elif curve.look == looks.PLUS:
        ax.plot(curve.x, curve.y, "+", color=tint, markersize=11, markeredgewidth=1.8)
    elif curve.look == looks.BAR:
        ax.plot(curve.x, curve.y, color=tint, linewidth=2.4, alpha=0.55, solid_capstyle="butt")
        if curve.said:
            _beside(ax, float(curve.x[0]), float(np.mean(curve.y)), curve.said)


def _discs(ax: Axes, curve: Curve, reach: np.ndarray) -> None:
    """One light color without transparency: where discs overlap nothing is more likely."""
    from matplotlib.collections import PatchCollection
    from matplotlib.patches import Circle

    pale = style.pale(_color(curve.number))
    circles = [Circle((x, y), r) for x, y, r in zip(curve.x, curve.y, reach, strict=True)]
    ax.add_collection(PatchCollection(circles, facecolor=pale, edgecolor="none", zorder=0.5))
    if curve.name:
        ax.plot([], [], color=pale, linewidth=6, label=style.caption(curve.name, curve.said))


def _color(number: int, neutral: str = style.INK) -> str:
    return style.ALERT if number == looks.ALERT else neutral if number < 0 else style.color(number)


def _beside(ax: Axes, x: float, y: float, text: str) -> None:
    """Write next to a bar, on the side with more room."""
    low, high = ax.get_xlim()
    right = np.log(x / low) < 0.85 * np.log(high / low)
    ax.annotate(
        style.read(text), (x, y), xytext=(5 if right else -5, 0), textcoords="offset points",
        ha="left" if right else "right", va="center", fontsize=style.SMALL, color=style.INK,
        bbox={"facecolor": style.PAPER, "edgecolor": "none", "alpha": 0.8, "pad": 0.8},
    )  # fmt: skip
