"""The charts of the answers of a study: yield by bound, distributions, sensitivity, bands, and the Pareto front."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from feeddrive.figures.figure import Figure
from feeddrive.figures.of_loops import StiffnessAt
from feeddrive.language.quantity import USUAL, Quantity, unit_name
from feeddrive.language.text import Text
from feeddrive.plot import style
from feeddrive.plot.chart import (
    ALERT,
    FREQUENCY,
    LOG,
    MARKERS,
    NEUTRAL,
    RING,
    Abscissa,
    Box,
    Chart,
    Curve,
    Level,
    Panel,
    Tick,
    listed,
)
from feeddrive.plot.chart import Band as Area
from feeddrive.plot.curves import histogram
from feeddrive.study.answers.rows import Judged
from feeddrive.study.answers.sentences import bound_text, name_of, short
from feeddrive.study.answers.statistics import INSIDE, Band, RankCorrelation, SobolIndices, Yield
from feeddrive.study.study import Bound, Study

if TYPE_CHECKING:
    from feeddrive.study.answers.statistics import Front

_DOTS = 1200  # points of a scatter plot, to keep the page small
_PANELS = 12  # largest number of histograms
_OUTPUTS = 4  # outputs whose sensitivities are shown
_FACTORS = 8  # shown per output
_LETTERS = 30  # longest shown name of a factor


def labelled(figure: Figure) -> str:
    """Return a figure with its unit as an axis label."""
    return f"{name_of(figure)} ({unit_name(figure.unit)})" if figure.unit else name_of(figure)


def _scale(unit: str) -> float:
    """Return the factor from an SI unit to the unit used in charts."""
    return USUAL.of(unit)[1]


def yields_chart(yields: Yield) -> Chart:
    """Return the share of machines that keep each bound, and all bounds, as error bars with 95 % intervals."""
    rows = [(bound_text(bound.bound), bound.kept) for bound in yields.bounds]
    rows.append(("all of them" if rows else "with figures", yields.inside))
    lines, dots = list[Curve](), list[Curve]()
    for row, (_, share) in enumerate(rows):
        number = NEUTRAL if row == len(rows) - 1 else 0
        if share.interval is not None:
            ends = 100.0 * np.array(share.interval)
            lines.append(Curve(ends, np.full(2, -float(row)), number=number, size=1.6))
        dots.append(
            Curve(np.array([100.0 * share.value]), np.array([-float(row)]), number=number, look=MARKERS, size=1.3)
        )
    low = min((share.interval or (share.value,))[0] for _, share in rows)
    left = 100.0 * max(0.0, low - 0.08 * (1.0 - low) - 0.002)
    right = 100.0 + 100.0 * (0.03 * (1.0 - low) + 5e-4)
    ticks = tuple(Tick(-float(row), caption=text) for row, (text, _) in enumerate(rows))
    panel = Panel("", (*lines, *dots), ticks=ticks, low=0.6 - len(rows), high=0.6)
    label = "machines that keep it (%); lines: 95 % interval"
    return Chart(label, (panel,), low=left, high=right, height=0.9 + 0.36 * len(rows))


def histograms_chart(sample: Judged, banded: bool = False) -> Chart:
    """Return a histogram of each figure over the machines, with its bound.

    banded  True to leave dynamic stiffness lines without a bound to the chart of their band
    """
    figures = _figures(sample.study, banded)[:_PANELS]
    bounds = {bound.figure: bound for bound in sample.study.specification}
    panels = tuple(_histogram(figure, sample.figures[figure.key], bounds.get(figure)) for figure in figures)
    across = min(2, len(panels))
    return Chart("", panels, across=across, height=0.5 + 1.9 * -(-len(panels) // across))


def _figures(study: Study, banded: bool) -> list[Figure]:
    """Return the figures to draw, starting with those that have a bound."""
    bounded = [bound.figure for bound in study.specification]
    others = [figure for figure in study.measure if not (banded and isinstance(figure.of, StiffnessAt))]
    return list(dict.fromkeys([*bounded, *others]))


def _histogram(figure: Figure, values: np.ndarray, bound: Bound | None) -> Panel:
    factor = _scale(figure.unit)
    values = factor * values[np.isfinite(values)]
    panel = Panel("machines", abscissa=Abscissa(labelled(figure)))
    if values.size:
        panel = histogram(values, labelled(figure), "machines", values.size // 8)
        panel = replace(panel, caption=Text(f"median {Quantity(np.median(values) / factor, figure.unit, bare=True)}"))
    ends = [factor * end for end in (() if bound is None else (bound.least, bound.most)) if end is not None]
    if ends and panel.abscissa is not None and panel.abscissa.low is not None and panel.abscissa.high is not None:
        low, high = panel.abscissa.low, panel.abscissa.high
        room = 0.03 * (max(high, *ends) - min(low, *ends))
        wider = replace(
            panel.abscissa, low=min(low, *(e - room for e in ends)), high=max(high, *(e + room for e in ends))
        )
        panel = replace(panel, abscissa=wider)
    levels = tuple(Level(end, upright=True, dashed=True, number=ALERT) for end in ends)
    return replace(panel, levels=levels)


def decides_chart(study: Study, indices: Sequence[SobolIndices], correlations: Sequence[RankCorrelation]) -> Chart:
    """Return bars of the Sobol indices, or rank correlations, of the specified figures, with intervals."""
    outputs = _outputs(study)
    sobol = {row.output: row for row in indices if row.output in outputs}
    ranks = {name: [rank for rank in correlations if rank.output == name] for name in outputs}
    titles = {figure.key: name_of(figure) for figure in study.measure} | {INSIDE: "inside the specification"}
    shown = [name for name in outputs if (sobol if indices else ranks).get(name)]
    panels = [_indices(sobol[name]) if indices else _correlations(ranks[name]) for name in shown]
    panels = [replace(panel, caption=titles[name]) for panel, name in zip(panels, shown, strict=True)]
    count = min(_FACTORS, len(study.vary) if indices else max((len(ranks[name]) for name in shown), default=0))
    label = "share of the variance" if indices else "rank correlation, -1 to 1"
    low, high = (None, None) if indices else (-1.0, 1.0)
    return Chart(
        f"{label}; lines: 95 % interval",
        tuple(panels) or (Panel("", caption="no output varies"),),
        low=low,
        high=high,
        height=0.7 + max(len(panels), 1) * (0.45 + 0.27 * count),
    )


def _outputs(study: Study) -> list[str]:
    """Return the outputs to show: figures with a bound, and `INSIDE`; without bounds, the first figures."""
    bounded = [bound.figure.key for bound in study.specification][: _OUTPUTS - 1]
    return [*bounded, INSIDE] if bounded else [figure.key for figure in _figures(study, True)][:_OUTPUTS]


def _indices(indices: SobolIndices) -> Panel:
    order = indices.order[:_FACTORS].tolist()
    boxes, lines = list[Box](), list[Curve]()
    for offset, value, interval, number, name in (
        (0.19, indices.first, indices.first_interval, 0, "alone"),
        (-0.19, indices.total, indices.total_interval, 5, "with what it does together with others"),
    ):
        for row, i in enumerate(order):
            y, size = offset - row, float(value[i])
            boxes.append(Box(min(0.0, size), max(0.0, size), y - 0.18, y + 0.18, number, name))
            lines.append(Curve(interval[:, i], np.full(2, y), number=NEUTRAL))
    return _rows([indices.factors[i] for i in order], indices.factors, boxes, lines)


def _correlations(correlations: Sequence[RankCorrelation]) -> Panel:
    some = correlations[:_FACTORS]
    boxes = [
        Box(min(0.0, rank.value), max(0.0, rank.value), -row - 0.31, -row + 0.31, int(rank.value >= 0.0))
        for row, rank in enumerate(some)
    ]
    lines = [
        Curve(np.array(rank.interval), np.full(2, -float(row)), number=NEUTRAL)
        for row, rank in enumerate(some)
        if rank.interval is not None
    ]
    panel = _rows([rank.column for rank in some], [rank.column for rank in correlations], boxes, lines)
    return replace(panel, levels=(Level(0.0, upright=True),))


def _rows(some: Sequence[str], names: Sequence[str], boxes: Sequence[Box], lines: Sequence[Curve]) -> Panel:
    short_names = short(names)
    shown = [style.shortened(short_names[name], _LETTERS) for name in some]
    return Panel("", tuple(lines), boxes=tuple(boxes), ticks=listed(shown), low=0.55 - len(some), high=0.55)


def stiffness_band_chart(band: Band) -> Chart:
    """Return the quantiles of the dynamic stiffness over frequency."""
    panel = replace(_quantiles(band, "dynamic stiffness"), scale=LOG)
    ends = float(band.x[0]), float(band.x[-1])
    return Chart(f"frequency ({unit_name('Hz')})", (panel,), FREQUENCY, *ends, height=3.2)


def error_band_chart(band: Band) -> Chart:
    """Return the quantiles of the following error over time."""
    return Chart("time (s)", (replace(_quantiles(band, "largest following error"), low=0.0),), height=3.0)


def _quantiles(band: Band, what: str) -> Panel:
    values = _scale(band.unit) * band.quantiles
    areas = Area(band.x, values[0], values[4], 0), Area(band.x, values[1], values[3], 0)
    caption = "line: median; dark: every second machine; light: nine of ten"
    return Panel(f"{what} ({unit_name(band.unit)})", (Curve(band.x, values[2]),), bands=areas, caption=caption)


def front_chart(front: Front, sample: Judged) -> Chart:
    """Return scatter plots of tracking, stiffness and robustness; rings mark the Pareto front."""
    first, *others = front.figures.values()
    some = np.linspace(0, sample.variant.size - 1, min(_DOTS, sample.variant.size)).astype(int)
    kept = np.arange(front.rows.variant.size)[:_DOTS]
    panels = list[Panel]()
    for other in others:
        curves = list[Curve]()
        for inside, number, name in ((True, 0, "inside"), (False, 1, "outside")):
            chosen = some[sample.inside[some] == inside]
            if chosen.size:
                place = _place(sample.figures, first, other, chosen)
                curves.append(Curve(*place, name, number, MARKERS, size=0.5))
        ring = _place(front.rows.figures, first, other, kept)
        curves.append(Curve(*ring, "front", NEUTRAL, RING, size=1.45))
        low, high = _ends(curves, "y", 0.06)
        panels.append(Panel(labelled(other), tuple(curves), low=low, high=high))
    left, right = _ends([curve for panel in panels for curve in panel.curves], "x", 0.04)
    return Chart(labelled(first), tuple(panels), low=left, high=right, height=0.6 + 3.0 * len(others))


def _ends(curves: Sequence[Curve], axis: Literal["x", "y"], part: float) -> tuple[float, float]:
    values = np.concatenate([getattr(curve, axis) for curve in curves])
    return style.padded(float(np.min(values)), float(np.max(values)), part) if values.size else (0.0, 1.0)


def _place(
    figures: Mapping[str, np.ndarray], first: Figure, other: Figure, chosen: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    x, y = (_scale(figure.unit) * figures[figure.key][chosen] for figure in (first, other))
    seen = np.isfinite(x) & np.isfinite(y)
    return x[seen], y[seen]
