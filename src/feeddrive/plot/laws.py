"""Plots of control laws: stiffness versus tracking, all figures relative to P-PI on one or several axes, and
disturbance recovery.
"""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np

from feeddrive.figures.of_loops import STIFFNESS_AT
from feeddrive.figures.of_runs import TRACKING_RMS
from feeddrive.figures.ranking import CRITERIA
from feeddrive.language.quantity import Quantity, number, unit_name
from feeddrive.language.text import Text
from feeddrive.loop.simulate import Run
from feeddrive.plot import style
from feeddrive.plot.chart import (
    DOTS,
    LOG,
    MARKERS,
    NEUTRAL,
    THIN,
    WIDE,
    Abscissa,
    Box,
    Chart,
    Curve,
    Level,
    Mark,
    Panel,
    Tick,
    listed,
)

X, HEIGHTS = TRACKING_RMS, STIFFNESS_AT
_MOST = 8.0  # ratio at which the color saturates


def tradeoff_chart(
    rows: Sequence[tuple[str, Mapping[str, float | None], str]],
    worst: Sequence[Mapping[str, float | None]] = (),
) -> Chart:
    """Plot stiffness at 10 and 100 Hz versus the RMS tracking error, one dot per law; the better laws are at the upper
    left.

    The key of each dot is the name of its law.  A law without these figures has no dot.

    rows  name of a law, its figures in SI units by criterion key, and the reason why it is not ranked (drawn as a
          hollow dot)
    worst  for each row its figures at the worst plant of a box, to which a line leads; empty without a box
    """
    bases = {base: i - 1 for i, base in enumerate(dict.fromkeys(_base(name) for name, _, _ in rows))}
    panels = list[Panel]()
    for of_y in HEIGHTS:
        marks = tuple(
            Mark(
                X.scale * x,
                of_y.scale * y,
                bases[_base(name)],
                bool(why),
                name,
                Text(f"{X.shown(x)}, {of_y.shown(y)}{f'; not ranked: {why}' if why else ''}"),
                name,
            )
            for name, figures, why in rows
            # Neither 0 nor infinity has a place on a logarithmic scale.
            if (x := figures.get(X.key)) and (y := figures.get(of_y.key)) and np.isfinite([x, y]).all()
        )
        ways = tuple(
            Curve(
                np.array([X.scale * x, X.scale * to_x]),
                np.array([of_y.scale * y, of_y.scale * to_y]),
                number=bases[_base(name)],
                look=THIN,
            )
            for (name, figures, _), over in zip(rows, worst, strict=False)
            if (x := figures.get(X.key)) and (y := figures.get(of_y.key))
            if (to_x := over.get(X.key)) and (to_y := over.get(of_y.key)) and np.isfinite([x, y, to_x, to_y]).all()
        )
        low, high = _around([*(mark.y for mark in marks), *(float(way.y[1]) for way in ways)], 0.14)
        label = Text(f"{of_y.title}\n({unit_name(of_y.unit)})")
        panels.append(Panel(label, ways, marks=marks, scale=LOG, low=low, high=high))
    places = [mark.x for panel in panels for mark in panel.marks]
    left, right = _around([*places, *(float(way.x[1]) for panel in panels for way in panel.curves)], 0.16)
    label = Text(f"{X.title} ({unit_name(X.unit)}); filled: ranked at equal robustness")
    return Chart(label, tuple(panels), LOG, left, right, height=8.4)


def _around(values: Sequence[float], part: float) -> tuple[float, float]:
    """Return a range around positive values with margins on a logarithmic scale; one decade if there is at most one
    value.
    """
    ends = np.log10([min(values), max(values)]) if values else np.zeros(2)
    low, high = (
        style.padded(float(ends[0]), float(ends[1]), part) if np.ptp(ends) > 0.0 else (ends[0] - 0.5, ends[1] + 0.5)
    )
    return float(10.0**low), float(10.0**high)


def _base(name: str) -> str:
    """Return the name of a law up to the first " + " or comma; laws with the same base name share a color."""
    return name.partition(" + ")[0].partition(",")[0]


def ratios_chart(rows: Sequence[tuple[str, Mapping[str, float | None]]], base: str) -> Chart:
    """Draw one cell per law and criterion: the ratio to law `base`, blue if better and orange if worse.

    rows  name of a law, and its figures in SI units by criterion key
    """
    reference = next((figures for name, figures in rows if name == base), rows[0][1])
    cells = list[Box]()
    for row, (_, figures) in enumerate(rows):
        for k, criterion in enumerate(CRITERIA):
            text, level = _cell(figures.get(criterion.key), reference.get(criterion.key), criterion.higher)
            cells.append(Box(k - 0.47, k + 0.47, -row - 0.45, -row + 0.45, text=text, level=level))
    panel = Panel("", boxes=tuple(cells), ticks=listed([name for name, _ in rows]), low=0.5 - len(rows), high=0.5)
    heads = tuple(Tick(float(k), caption=criterion.title) for k, criterion in enumerate(CRITERIA))
    return Chart("", (panel,), low=-0.5, high=len(CRITERIA) - 0.5, ticks=heads, height=1.9 + 0.34 * len(rows))


def _cell(value: float | None, base: float | None, higher: bool) -> tuple[str, float]:
    """Return the text and the color level of a cell: -1 for much better, 1 for much worse."""
    if value is None or base is None:
        return "-", 0.0
    if np.isinf(value) or np.isinf(base) or base == 0.0 or value == 0.0:
        worse = (value > base) - (value < base)
        return ("never" if np.isinf(value) else number(value, 2)), float(-worse if higher else worse)
    ratio = value / base
    # Logarithmic, so that twice and half the value have colors of equal strength.
    level = float(np.clip(np.log(ratio) / np.log(_MOST), -1.0, 1.0))
    return Text(f"{Quantity(ratio):{'.2f' if ratio < 9.95 else '.0f'}}"), -level if higher else level


def recovery_chart(rows: Sequence[tuple[str, Run, Run]], *, begin: float, near: float, span: float) -> Chart:
    """Plot the table's position error of all laws after a rope snap and after a force step.

    rows   name of a law, its run of the rope snap, its run of the force step
    begin  time of the force change, s
    near   settling band, m
    span   time range shown, s
    """
    limits = tuple(Level(side * 1e6 * near, dashed=True) for side in (-1.0, 1.0))
    panels = list[Panel]()
    for k, text in enumerate(("rope snap", "force step")):
        curves = list[Curve]()
        for i, (name, *runs) in enumerate(rows):
            run = runs[k]
            inside = (run.time >= begin - 0.05 * span) & (run.time <= begin + span)
            # The error of the table is actual minus set position; the tracking error has the opposite sign.
            curves.append(Curve(1e3 * (run.time[inside] - begin), -1e6 * run["tracking_error"][inside], name, i))
        panels.append(Panel(f"{text}\n({unit_name('m')})", tuple(curves), levels=limits))
    label = f"time after the force changed ({unit_name('s')})"
    return Chart(label, tuple(panels), height=5.0, columns=3)


class ScoreRow(NamedTuple):
    """The ratios of one law to P-PI, their mean if there is one to be shown, and its confidence interval."""

    ratios: Sequence[float]
    mean: float | None
    interval: tuple[float, float] | None = None


Scores: TypeAlias = Mapping[str, Sequence[ScoreRow]]
"""The rows of all laws by heading."""


def scores_chart(*rows: tuple[Sequence[str], Scores]) -> Chart:
    """Plot rows of panels, one panel per figure with one line per law: a small dot per plant, a large one for the mean,
    on a bar of its interval.

    rows  for each row of panels its laws from the top, and their ratios by heading
    """
    shown = list[Panel]()
    for number_of_row, (laws, panels) in enumerate(rows, 1):
        label = "times better than P-PI" if number_of_row == len(rows) else ""
        for place, (head, values) in enumerate(panels.items()):
            shown.append(_scores_panel(laws, head, values, label, named=place == 0))
    tallest = max(len(laws) for laws, _ in rows)
    return Chart("", tuple(shown), across=len(rows[0][1]), height=len(rows) * (1.0 + 0.2 * tallest))


def _scores_panel(laws: Sequence[str], head: str, rows: Sequence[ScoreRow], label: str, *, named: bool) -> Panel:
    plants = [(ratio, -place) for place, row in enumerate(rows) for ratio in row.ratios]
    means = [(row.mean, -place) for place, row in enumerate(rows) if row.mean]
    # NaN separates the bars
    bars = [(end, -place) for place, row in enumerate(rows) if row.interval for end in (*row.interval, math.nan)]
    # `reshape` gives two columns even without a dot.
    (x, y), (mean_x, mean_y), (bar_x, bar_y) = (
        np.array(dots, float).reshape(-1, 2).T for dots in (plants, means, bars)
    )
    return Panel(
        "",
        (
            Curve(x, y, number=NEUTRAL, look=DOTS),
            Curve(mean_x, mean_y, look=MARKERS),
            *([Curve(bar_x, bar_y, look=WIDE)] if bars else []),
        ),
        levels=(Level(1.0, upright=True),),
        ticks=tuple(Tick(tick.value, tick.name if named else "") for tick in listed(laws)),
        low=0.4 - len(laws),
        high=0.6,
        caption=head,
        # P-PI itself has the ratio 1; without margins the outermost dots would be cut
        abscissa=Abscissa(label, LOG, *_around([1.0, *x], 0.1)),
    )
