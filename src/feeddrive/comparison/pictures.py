"""Plots of a comparison: what stiffness costs in tracking, every figure against P-PI, and the recovery of the laws."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from feeddrive.comparison.figures import CRITERIA, Criterion
from feeddrive.loop.simulate import Run
from feeddrive.plot import style

X, HEIGHTS = "tracking_error_rms_m", ("stiffness_10_Hz_N_per_m", "stiffness_100_Hz_N_per_m")
_SPOTS = tuple(
    (reach * dx, reach * dy)
    for reach in (1.0, 1.9, 2.9, 4.0)
    for dx, dy in ((1, 0), (-1, 0), (0.7, 0.8), (-0.7, 0.8), (0.7, -0.8), (-0.7, -0.8), (0, 1), (0, -1))
)  # where a name may stand, in steps of 9 points right and up
_STEP, _WIDE, _TALL = 9.0, 4.2, 10.5  # points: of a spot; width of a letter; height of a line
_MOST = 8.0  # a ratio beyond which the color is full
_BETTER, _WORSE = "#0072b2", "#d55e00"


def tradeoff(rows: Sequence[tuple[str, Mapping[str, float | None], str]]) -> Any:
    """Stiffness at 10 and at 100 Hz over the RMS tracking error, a dot for each law: better is left and up.

    rows  name of a law, its figures in SI by the key of a criterion, and why it is not ranked: its dot is then hollow
    """
    kinds = {criterion.key: criterion for criterion in CRITERIA}
    figure, axes = style.picture(2, height=8.4)
    bases = dict.fromkeys(_base(name) for name, _, _ in rows)
    colors = {base: style.INK if i == 0 else style.color(i - 1) for i, base in enumerate(bases)}
    for ax, key in zip(axes, HEIGHTS, strict=True):
        dots = [
            (name, kinds[X].factor * x, kinds[key].factor * y, why)
            for name, figures, why in rows
            if (x := figures.get(X)) and (y := figures.get(key)) and np.isfinite([x, y]).all()
        ]
        for name, x, y, why in dots:
            face = style.PAPER if why else colors[_base(name)]
            edge = colors[_base(name)]
            ax.plot(x, y, "o", markersize=6.0, markerfacecolor=face, markeredgecolor=edge, markeredgewidth=1.3)
        ax.set_xscale("log")
        ax.set_yscale("log")
        ax.margins(0.16, 0.14)
        style.labels(ax, None, f"{kinds[key].head}\n({kinds[key].unit})")
    axes[-1].set_xlabel(f"{kinds[X].head} ({kinds[X].unit}); filled: ranked at equal robustness", fontsize=style.TEXT)
    figure.draw_without_rendering()
    for ax, key in zip(axes, HEIGHTS, strict=True):
        dots = [(name, figures.get(X), figures.get(key)) for name, figures, _ in rows]
        _name_dots(ax, dots, kinds[X], kinds[key], colors)
        for each in (ax.xaxis, ax.yaxis):
            style.plain_decades(each, between=True)
    return figure


def _base(name: str) -> str:
    """The law without what stands beside it: laws of one base have one color."""
    return name.partition(" + ")[0].partition(",")[0]


def _name_dots(
    ax: Any, dots: Sequence[tuple[str, float | None, float | None]], of_x: Criterion, of_y: Criterion,
    colors: Mapping[str, str],
) -> None:  # fmt: skip
    """Names beside their dots, each where it covers neither a dot nor another name; laws at one dot share a name."""
    at: dict[tuple[float, float], list[str]] = {}
    data: dict[tuple[float, float], tuple[float, float]] = {}
    scale = 72.0 / ax.figure.dpi
    for name, x, y in dots:
        if not x or not y or not np.isfinite([x, y]).all():
            continue
        place = scale * ax.transData.transform((of_x.factor * x, of_y.factor * y))
        near = next((known for known in at if np.hypot(known[0] - place[0], known[1] - place[1]) < 2.0), None)
        near = (float(place[0]), float(place[1])) if near is None else near
        at.setdefault(near, []).append(name)
        data.setdefault(near, (of_x.factor * x, of_y.factor * y))
    taken = [(px - 4.0, py - 4.0, px + 4.0, py + 4.0) for px, py in at]
    edge = scale * ax.bbox.extents
    for (px, py), names in at.items():
        text = ", ".join(str(style.caption(name)) for name in names)
        wide = _WIDE * len(text)
        best: tuple[float, tuple[float, float, float, float]] | None = None
        for i, (dx, dy) in enumerate(_SPOTS):
            left = px + _STEP * dx - wide * (0.0 if dx > 0 else 1.0 if dx < 0 else 0.5)
            low = py + _STEP * dy - 0.5 * _TALL
            box = (left, low, left + wide, low + _TALL)
            over = sum(_shared(box, other) for other in taken)
            out = max(edge[0] - box[0], 0.0) + max(box[2] - edge[2], 0.0)
            out += max(edge[1] - box[1], 0.0) + max(box[3] - edge[3], 0.0)
            cost = over + 20.0 * out + 3.0 * i
            if best is None or cost < best[0]:
                best = cost, box
        assert best is not None
        box = best[1]
        taken.append(box)
        middle = (0.5 * (box[0] + box[2]), 0.5 * (box[1] + box[3]))
        ax.annotate(
            text, data[px, py], (middle[0] - px, middle[1] - py), textcoords="offset points", ha="center",
            va="center", fontsize=style.SMALL - 1, color=colors[_base(names[0])],
        )  # fmt: skip
        end = (min(max(px, box[0]), box[2]), min(max(py, box[1]), box[3]))
        if np.hypot(end[0] - px, end[1] - py) > 0.8 * _STEP:
            ax.annotate(
                "", data[px, py], (end[0] - px, end[1] - py), textcoords="offset points",
                arrowprops={"arrowstyle": "-", "color": colors[_base(names[0])], "linewidth": 0.7},
            )  # fmt: skip


def _shared(a: tuple[float, float, float, float], b: tuple[float, float, float, float]) -> float:
    """The area that two boxes share."""
    return max(min(a[2], b[2]) - max(a[0], b[0]), 0.0) * max(min(a[3], b[3]) - max(a[1], b[1]), 0.0)


def ratios(rows: Sequence[tuple[str, Mapping[str, float | None]]], base: str) -> Any:
    """One cell for each law and criterion: the ratio to law `base`, blue where better and orange where worse.

    rows  name of a law, and its figures in SI by the key of a criterion
    """
    from matplotlib.colors import LinearSegmentedColormap

    reference = next((figures for name, figures in rows if name == base), rows[0][1])
    figure, (ax,) = style.picture(1, height=1.9 + 0.34 * len(rows))
    shades = LinearSegmentedColormap.from_list("against", [_BETTER, style.PAPER, _WORSE])
    for i, (_, figures) in enumerate(rows):
        for k, criterion in enumerate(CRITERIA):
            text, level = _cell(figures.get(criterion.key), reference.get(criterion.key), criterion.higher)
            ax.add_patch(_square(k, i, shades(0.5 + 0.42 * level)))
            ax.text(k, i, text, ha="center", va="center", fontsize=style.SMALL - 1, color=style.INK)
    ax.set_xlim(-0.5, len(CRITERIA) - 0.5)
    ax.set_ylim(len(rows) - 0.5, -0.5)
    ax.set_yticks(range(len(rows)), [str(style.caption(name)) for name, _ in rows], fontsize=style.SMALL)
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


def recovery(rows: Sequence[tuple[str, Run, Run]], *, begin: float, near: float, span: float) -> Any:
    """The error of the table after the rope was cut, and after a force was switched on, of all laws.

    rows   name of a law, its run of the rope snap, its run of the force step
    begin  s, when the force changed; near  m, within which a law counts as settled; span  s, that is shown
    """
    figure, axes = style.picture(2, height=5.0)
    for i, (name, snap, step) in enumerate(rows):
        for ax, run in zip(axes, (snap, step), strict=True):
            inside = (run.time >= begin - 0.05 * span) & (run.time <= begin + span)
            error = -1e6 * run["tracking_error"][inside]
            # a second round of colors takes other dashes
            line = style.curve(i) | {"linestyle": style.DASHES[(i + i // len(style.COLORS)) % len(style.DASHES)]}
            ax.plot(1e3 * (run.time[inside] - begin), error, label=style.caption(name), **line)
    for ax, text in zip(axes, ("rope snap\n(µm)", "force step\n(µm)"), strict=True):
        style.labels(ax, None, text)
        for side in (-1.0, 1.0):
            ax.axhline(side * 1e6 * near, color=style.MUTED, linewidth=0.8, linestyle=(0, (4, 3)))
    axes[-1].set_xlabel("time after the force changed (ms)", fontsize=style.TEXT)
    style.legend(figure, axes[0], columns=3)
    return figure
