"""Plots of a comparison: what stiffness costs in tracking, every figure against P-PI, and the recovery of the laws."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from feeddrive.comparison.figures import CRITERIA
from feeddrive.figures.of_loops import STIFFNESS_AT
from feeddrive.figures.of_runs import TRACKING_RMS
from feeddrive.language.quantity import Quantity, number, unit_name
from feeddrive.language.text import Text
from feeddrive.loop.simulate import Run
from feeddrive.plot import style
from feeddrive.plot.chart import LOG, Chart, Mark, Panel
from feeddrive.plot.drawing import drawn

X, HEIGHTS = TRACKING_RMS, STIFFNESS_AT
_MOST = 8.0  # a ratio beyond which the color is full
_BETTER, _WORSE = "#0072b2", "#d55e00"


def tradeoff(rows: Sequence[tuple[str, Mapping[str, float | None], str]]) -> Any:
    """Stiffness at 10 and at 100 Hz over the RMS tracking error, a dot for each law: better is left and up.

    rows  name of a law, its figures in SI by the key of a criterion, and why it is not ranked: its dot is then hollow
    """
    return drawn(tradeoff_chart(rows))


def tradeoff_chart(rows: Sequence[tuple[str, Mapping[str, float | None], str]]) -> Chart:
    """What `tradeoff` shows; the key of a dot is the name of its law. A law without these figures has no dot."""
    bases = {base: i - 1 for i, base in enumerate(dict.fromkeys(_base(name) for name, _, _ in rows))}
    panels = list[Panel]()
    for of_y in HEIGHTS:
        marks = tuple(
            Mark(
                X.scale * x, of_y.scale * y, bases[_base(name)], bool(why), name,
                Text(
                    f"{X.shown(x)}, {of_y.shown(y)}{f'; not ranked: {why}' if why else ''}"
                ), name,
            )
            for name, figures, why in rows
            if (x := figures.get(X.key)) and (y := figures.get(of_y.key)) and np.isfinite([x, y]).all()
        )  # fmt: skip
        low, high = _around([mark.y for mark in marks], 0.14)
        label = Text(f"{of_y.title}\n({unit_name(of_y.unit)})")
        panels.append(Panel(label, marks=marks, scale=LOG, low=low, high=high))
    left, right = _around([mark.x for panel in panels for mark in panel.marks], 0.16)
    label = Text(f"{X.title} ({unit_name(X.unit)}); filled: ranked at equal robustness")
    return Chart(label, tuple(panels), LOG, left, right, height=8.4)


def _around(values: Sequence[float], part: float) -> tuple[float, float]:
    """A range around positive values on a logarithmic scale, with room on both sides; a decade if there is none."""
    ends = np.log10([min(values), max(values)]) if values else np.zeros(2)
    low, high = (
        style.padded(float(ends[0]), float(ends[1]), part) if np.ptp(ends) > 0.0 else (ends[0] - 0.5, ends[1] + 0.5)
    )
    return float(10.0**low), float(10.0**high)


def _base(name: str) -> str:
    """The law without what stands beside it: laws of one base have one color."""
    return name.partition(" + ")[0].partition(",")[0]


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
    ax.set_xticks(
        range(len(CRITERIA)),
        [style.read(criterion.title) for criterion in CRITERIA],
        rotation=40,
        ha="left",
        fontsize=style.SMALL,
    )
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
        return ("never" if np.isinf(value) else number(value, 2)), float(-worse if higher else worse)
    ratio = value / base
    level = float(np.clip(np.log(ratio) / np.log(_MOST), -1.0, 1.0))
    return Text(f"{Quantity(ratio):{'.2f' if ratio < 9.95 else '.0f'}}"), -level if higher else level


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
    for ax, text in zip(axes, ("rope snap", "force step"), strict=True):
        style.labels(ax, None, f"{text}\n({unit_name('m')})")
        for side in (-1.0, 1.0):
            ax.axhline(side * 1e6 * near, color=style.MUTED, linewidth=0.8, linestyle=(0, (4, 3)))
    axes[-1].set_xlabel(style.read(f"time after the force changed ({unit_name('s')})"), fontsize=style.TEXT)
    style.legend(figure, axes[0], columns=3)
    return figure
