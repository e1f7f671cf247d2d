"""Pictures of the arena: every figure of every law against that of the tuned P-PI, and how the laws recover."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from feeddrive.plot import style

if TYPE_CHECKING:
    from feeddrive.comparison.arena import Arena

_MOST = 8.0  # a ratio beyond which the color is full
_BETTER, _WORSE = "#0072b2", "#d55e00"


def arena(found: Arena) -> Any:
    """One cell for each law and criterion: the ratio to the tuned P-PI, blue where better and orange where worse."""
    from matplotlib.colors import LinearSegmentedColormap

    from feeddrive.comparison.arena import PLAIN
    from feeddrive.comparison.criteria import CRITERIA

    rows = found.competitors
    plain = next((row for row in rows if row.name == PLAIN), rows[0])
    figure, (ax,) = style.picture(1, height=1.9 + 0.34 * len(rows))
    shades = LinearSegmentedColormap.from_list("against", [_BETTER, style.PAPER, _WORSE])
    for i, row in enumerate(rows):
        for k, criterion in enumerate(CRITERIA):
            value, base = row.figures.get(criterion.key), plain.figures.get(criterion.key)
            text, level = _cell(value, base, criterion.higher)
            ax.add_patch(_square(k, i, shades(0.5 + 0.42 * level)))
            ax.text(k, i, text, ha="center", va="center", fontsize=style.SMALL - 1, color=style.INK)
    ax.set_xlim(-0.5, len(CRITERIA) - 0.5)
    ax.set_ylim(len(rows) - 0.5, -0.5)
    ax.set_yticks(range(len(rows)), [str(style.caption(row.name)) for row in rows], fontsize=style.SMALL)
    ax.set_xticks(range(len(CRITERIA)), [c.head for c in CRITERIA], rotation=40, ha="left", fontsize=style.SMALL)
    ax.xaxis.tick_top()
    ax.grid(False)
    ax.tick_params(length=0)
    for spine in ax.spines.values():
        spine.set_visible(False)
    return figure


def _square(x: float, y: float, color: Any) -> Any:
    from matplotlib.patches import Rectangle

    return Rectangle((x - 0.47, y - 0.45), 0.94, 0.9, facecolor=color, edgecolor="none")


def _cell(value: float | None, base: float | None, higher: bool) -> tuple[str, float]:
    """Text and level of a cell: -1 where much better, 1 where much worse."""
    if value is None or base is None:
        return "-", 0.0
    if np.isinf(value) or np.isinf(base) or base == 0.0 or value == 0.0:
        worse = (value > base) - (value < base)
        return ("never" if np.isinf(value) else f"{value:.2g}"), float(-worse if higher else worse)
    ratio = value / base
    level = float(np.clip(np.log(ratio) / np.log(_MOST), -1.0, 1.0))
    return f"{ratio:.2f}" if ratio < 9.95 else f"{ratio:.0f}", -level if higher else level


def recovery(found: Arena) -> Any:
    """The error of the table after the rope was cut, and after a force was switched on, of all laws."""
    rows = [row for row in found.competitors if row.snap is not None and row.step is not None]
    figure, axes = style.picture(2, height=5.0)
    span = _span(found)
    for i, row in enumerate(rows):
        for ax, run in zip(axes, (row.snap, row.step), strict=True):
            assert run is not None
            inside = (run.time >= found.work.begin - 0.05 * span) & (run.time <= found.work.begin + span)
            error = -1e6 * run["tracking_error"][inside]
            # a second round of colors takes other dashes
            line = style.curve(i) | {"linestyle": style.DASHES[(i + i // len(style.COLORS)) % len(style.DASHES)]}
            ax.plot(1e3 * (run.time[inside] - found.work.begin), error, label=style.caption(row.name), **line)
    for ax, text in zip(axes, ("rope snap\n(µm)", "force step\n(µm)"), strict=True):
        style.labels(ax, None, text)
        for side in (-1.0, 1.0):
            ax.axhline(side * 1e6 * found.work.near, color=style.MUTED, linewidth=0.8, linestyle=(0, (4, 3)))
    axes[-1].set_xlabel("time after the force changed (ms)", fontsize=style.TEXT)
    style.legend(figure, axes[0], columns=3)
    return figure


def _span(found: Arena) -> float:
    """s: one and a half times the median of what the laws need to settle, at least 20 samples."""
    times = [row.figures.get("snap_settling_s") for row in found.competitors]
    finite = [t for t in times if t is not None and np.isfinite(t)]
    T = float(found.competitors[0].loop.sample_time)
    return float(min(max(2.0 * float(np.median(finite)) if finite else found.work.rest, 20.0 * T), found.work.rest))
