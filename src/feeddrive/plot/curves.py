"""Pictures of plain curves, for experiments: one or more rows over one abscissa, and poles that move."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from feeddrive.plot import style


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
        axes[0].annotate(name, (1.0, level), xycoords=("axes fraction", "data"), xytext=(-4, 2),
                         textcoords="offset points", ha="right", fontsize=style.SMALL, color=style.MUTED)  # fmt: skip
    axes[-1].set_xlabel(abscissa, fontsize=style.TEXT)
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
