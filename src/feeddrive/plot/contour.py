"""Pictures of a contour error: along the path, on the path as color and enlarged, and zooms of corners."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from feeddrive.plot import style
from feeddrive.plot.style import envelope

if TYPE_CHECKING:
    from collections.abc import Sequence

    from feeddrive.machining.contour import ContourError, Corner

# from small to large errors: cold to warm, and thicker, so that gray print shows it too
_SIZES = (style.COLORS[0], style.COLORS[5], style.COLORS[2], style.COLORS[4], style.COLORS[1], style.ALERT)
_WIDTHS = (1.1, 1.3, 1.5, 1.8, 2.2, 2.6)
_ENLARGED = 0.08  # of the larger extent: the largest deviation as it is drawn
_STEPS = (1.0, 2.0, 5.0)
_POINTS = 20_000  # of a path that is drawn
_MARKED = 5


def contour(found: ContourError) -> Any:
    """The error over path length with its worst places, and how much of the path has how much of it."""
    figure, (over, share) = style.picture(2, height=4.6, ratios=(1.5, 1.0), share=False)
    along, error = 1e3 * found.along, 1e6 * found.error
    over.plot(*envelope(along, error), **style.curve(0) | {"linewidth": 0.9})
    places = found.worst(_MARKED)
    over.plot([1e3 * each.along for each in places], [1e6 * each.error for each in places], "o", color=style.ALERT,
              fillstyle="none", label="worst places")  # fmt: skip
    over.axhline(0.0, color=style.MUTED, linewidth=0.8)
    over.set_ylim(*style.padded(min(0.0, float(error.min())), max(0.0, float(error.max()))))
    side = "contour error, + left\n(µm)" if found.signed else "contour error\n(µm)"
    style.labels(over, "length of the path (mm)", side)
    style.note(over, f"largest {1e6 * found.largest:.4g} µm, RMS {1e6 * found.rms:.4g} µm, "
                     f"95 % within {1e6 * found.within():.4g} µm")  # fmt: skip
    counts, edges = np.histogram(error, bins=60, weights=100.0 * found.weights)
    share.stairs(counts, edges, fill=True, color=style.color(0))
    style.labels(share, "contour error (µm)", "part of the path\n(%)")
    style.row_legend(over)
    return figure


def contour_on_path(found: ContourError, axes: tuple[int, int] = (0, 1), enlarged: float | None = None) -> Any:
    """The path that counts with the size of the error as color, and the deviation from it, enlarged by a round factor.

    axes      columns of the contour error that span the picture
    enlarged  the factor; default: the largest deviation is a twelfth of the extent
    """
    every = max(1, len(found.time) // _POINTS)
    i, j = axes
    kept = found.counted[::every]
    foot = np.where(kept[:, None], 1e3 * (found.position - found.vector)[::every], np.nan)
    off = 1e3 * found.vector[::every]
    size = np.where(kept, 1e6 * np.abs(found.error[::every]), 0.0)
    wide, high = (float(np.ptp(foot[kept, column])) if np.any(kept) else 0.0 for column in axes)
    extent = max(wide, high, 1e-9)
    factor = _round(_ENLARGED * extent / max(1e3 * found.largest, 1e-12)) if enlarged is None else enlarged
    shape = max(0.35, min(1.0, high / extent))
    figure, (ax,) = style.picture(1, height=0.8 + 0.75 * style.WIDTH * shape)
    ax.plot(foot[:, i] + factor * off[:, i], foot[:, j] + factor * off[:, j], color=style.MUTED, linewidth=0.8,
            label=f"tool, deviation × {factor:.0f}")  # fmt: skip
    edges = np.linspace(0.0, max(float(size.max()), 1e-9), len(_SIZES) + 1)
    kind = np.clip(np.searchsorted(edges, size, side="left") - 1, 0, len(_SIZES) - 1)
    for k, (color, width) in enumerate(zip(_SIZES, _WIDTHS, strict=True)):
        drawn = kind == k
        drawn[1:] |= kind[:-1] == k
        if np.any(kind == k):
            x, y = (np.where(drawn, foot[:, column], np.nan) for column in axes)
            ax.plot(x, y, color=color, linewidth=width, solid_capstyle="round",
                    label=f"{edges[k]:.3g} to {edges[k + 1]:.3g} µm")  # fmt: skip
    ax.set_aspect("equal", adjustable="datalim")
    ax.margins(0.05)
    style.labels(ax, f"{found.axes[i]} (mm)", f"{found.axes[j]} (mm)")
    style.legend(figure, ax)
    return figure


def corner_zoom(found: ContourError, corners: Sequence[Corner] | None = None, tolerance: float | None = None) -> Any:
    """Corners 1:1, at most four: the path, the tool, and a band of the tolerance (m) around the path.

    corners  default: the four with the largest error
    """
    given = sorted(found.corners(), key=lambda each: -each.error) if corners is None else list(corners)
    chosen = given[:4]
    columns = max(1, min(2, len(chosen)))
    rows = max(1, -(-len(chosen) // columns))
    figure, axes = _grid(rows, columns, 0.5 + 3.6 * rows)
    for ax, each in zip(axes, chosen, strict=False):
        at = 1e6 * (found.set_position - each.position)
        tool = 1e6 * (found.position - each.position)
        reach = 2.2e6 * max(each.nearest, each.error, 0.0 if tolerance is None else tolerance, 1e-7)
        near = each.rows
        if tolerance is not None:
            _band(ax, at[near], 1e6 * tolerance)
        ax.plot(at[near, 0], at[near, 1], color=style.INK, linewidth=1.2, label="path")
        ax.plot(tool[near, 0], tool[near, 1], **style.curve(1) | {"linestyle": "-"}, label="tool")
        ax.set_xlim(-reach, reach)
        ax.set_ylim(-reach, reach)
        ax.set_aspect("equal")
        where = "" if each.line is None else f"line {each.line}, "
        style.note(ax, f"{where}{np.degrees(each.turn):.3g}°: passed at {1e6 * each.nearest:.4g} µm")
        style.labels(ax, f"{found.axes[0]} (µm)", f"{found.axes[1]} (µm)")
    for ax in axes[len(chosen) :]:
        ax.set_axis_off()
    if not chosen:
        style.note(axes[0], "the path has no corner", x=0.5, align="center", y=0.5)
    style.legend(figure, axes[0])
    return figure


def _band(ax: Any, path: np.ndarray, half: float) -> None:
    """A band around a path: the lines left and right of each stretch, open at corners."""
    step = np.diff(path, axis=0)
    moved = np.linalg.norm(step, axis=1) > 0.0
    begin, end, step = path[:-1][moved], path[1:][moved], step[moved]
    normal = half * np.column_stack([-step[:, 1], step[:, 0]]) / np.linalg.norm(step, axis=1)[:, None]
    for i, side in enumerate((1.0, -1.0)):
        line = np.full((3 * len(begin), 2), np.nan)
        line[::3], line[1::3] = begin + side * normal, end + side * normal
        smooth = np.flatnonzero(np.einsum("ij,ij->i", normal[1:], normal[:-1]) > 0.99 * half * half)
        line[3 * smooth + 2] = end[smooth] + side * normal[smooth]
        label = f"tolerance {half:.3g} µm" if i == 0 else None
        ax.plot(line[:, 0], line[:, 1], color=style.ALERT, linewidth=0.9, linestyle=(0, (5, 2)), label=label)


def _grid(rows: int, columns: int, height: float) -> tuple[Any, list[Any]]:
    """A figure with axes in rows and columns in the common style."""
    from feeddrive.plot.picture import Picture

    figure = Picture(figsize=(style.WIDTH, height), layout="constrained", facecolor=style.PAPER)
    return figure, [style.dressed(ax) for ax in figure.subplots(rows, columns, squeeze=False).flat]


def _round(factor: float) -> float:
    """1, 2 or 5 times a power of ten, the largest that is not above; at least 1."""
    power = 10.0 ** np.floor(np.log10(max(factor, 1.0)))
    return float(power * max(each for each in _STEPS if each * power <= max(factor, 1.0)))
