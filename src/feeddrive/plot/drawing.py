"""A chart drawn by matplotlib, in the common style."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from feeddrive.plot import chart as looks
from feeddrive.plot import style
from feeddrive.plot.chart import Band, Chart, Curve, Panel

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes

_DASHED = (0, (4, 3))


def drawn(chart: Chart) -> Any:
    """The picture of a chart, in the width of a report."""
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
    for ax, panel in zip(axes, chart.panels, strict=True):
        if chart.square:
            ax.set_aspect("equal")
        _panel(ax, panel)
        style.labels(ax, chart.label if ax is axes[-1] else None, panel.label)
    if chart.scale == looks.FREQUENCY:
        style.frequency_grid(axes)


def _panel(ax: Axes, panel: Panel) -> None:
    from matplotlib.patches import Circle

    for level in panel.levels:
        draw = ax.axvline if level.upright else ax.axhline
        tint = style.MUTED if level.dashed or level.faint else style.INK
        draw(level.value, color=tint, linewidth=0.8 if level.faint else 1.0, linestyle=_DASHED if level.dashed else "-")
        if level.text:
            ax.annotate(
                level.text, (0.0, level.value), xycoords=("axes fraction", "data"), xytext=(4, -2),
                textcoords="offset points", va="top", fontsize=style.SMALL, color=style.MUTED,
            )  # fmt: skip
    for disc in panel.discs:
        where, tint = (disc.x, disc.y), _color(disc.number, style.MUTED)
        if disc.filled:
            ax.add_patch(Circle(where, disc.radius, facecolor=tint, alpha=0.10, edgecolor="none"))
        dashes = _DASHED if disc.number < 0 else style.DASHES[disc.number % len(style.DASHES)]
        ax.add_patch(Circle(where, disc.radius, fill=False, edgecolor=tint, linewidth=0.9, linestyle=dashes))
    for band in panel.bands:
        _band(ax, band)
    for curve in panel.curves:
        _curve(ax, curve)
    for mark in panel.marks:
        face: dict[str, Any] = {"markerfacecolor": style.PAPER} if mark.hollow else {}
        ax.plot([mark.x], [mark.y], style.MARKERS[mark.number % len(style.MARKERS)], color=_color(mark.number),
                markersize=4.5, **face)  # fmt: skip
    for note in panel.notes:
        off, across, along = (3, "left", "bottom") if note.right else (-5, "right", "top")
        ax.annotate(note.text, (note.x, note.y), xytext=(off, off), textcoords="offset points", ha=across, va=along,
                    fontsize=style.SMALL, color=_color(note.number, style.MUTED))  # fmt: skip
    if panel.scale == looks.LOG:
        ax.set_yscale("log")
        style.plain_decades(ax.yaxis)
        ax.grid(True, which="minor", axis="y", color=style.GRID, linewidth=0.4)
    if panel.scale == looks.DEGREES:
        assert panel.low is not None
        assert panel.high is not None
        style.degrees_axis(ax, panel.low, panel.high)
    elif panel.low is not None or panel.high is not None:
        ax.set_ylim(panel.low, panel.high)


def _band(ax: Axes, band: Band) -> None:
    ax.fill_between(
        band.x, band.low, band.high, color=_color(band.number, style.MUTED), alpha=0.18, linewidth=0.0,
        label=style.caption(band.name),
    )  # fmt: skip


def _curve(ax: Axes, curve: Curve) -> None:
    tint = _color(curve.number)
    if curve.look == looks.LINE:
        ax.plot(curve.x, curve.y, label=style.caption(curve.name, curve.said), **style.curve(curve.number))
    elif curve.look == looks.THIN:
        ax.plot(curve.x, curve.y, color=tint, linewidth=0.6, alpha=0.6)
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


def _color(number: int, neutral: str = style.INK) -> str:
    return style.ALERT if number == looks.ALERT else neutral if number < 0 else style.color(number)


def _beside(ax: Axes, x: float, y: float, text: str) -> None:
    """Write next to a bar, on the side with more room."""
    low, high = ax.get_xlim()
    right = np.log(x / low) < 0.85 * np.log(high / low)
    ax.annotate(
        text, (x, y), xytext=(5 if right else -5, 0), textcoords="offset points", ha="left" if right else "right",
        va="center", fontsize=style.SMALL, color=style.INK,
        bbox={"facecolor": style.PAPER, "edgecolor": "none", "alpha": 0.8, "pad": 0.8},
    )  # fmt: skip
