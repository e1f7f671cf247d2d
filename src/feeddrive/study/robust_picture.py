"""The picture of a robust tuning: how figures are spread over fresh machines, under today's control and the new one."""

from __future__ import annotations

import numpy as np

from feeddrive.figures.figure import Figure
from feeddrive.language.quantity import USUAL, unit_name
from feeddrive.plot import style
from feeddrive.plot.chart import ALERT, Abscissa, Box, Chart, Curve, Panel, stairs
from feeddrive.study.fresh import Measured
from feeddrive.study.specification import Bound


def shares_chart(before: Measured, after: Measured) -> Chart:
    """The cumulative share of the machines over the values of each figure; the outside of a bound is shaded."""
    bounds = {bound.figure.key: bound for bound in after.bounds}
    across = 2 if len(after.figures) > 1 else 1
    panels = tuple(_share(figure, before, after, bounds.get(figure.key)) for figure in after.figures)
    return Chart("", panels, across=across, height=0.7 + 2.3 * -(-len(panels) // across))


def _share(figure: Figure, before: Measured, after: Measured, bound: Bound | None) -> Panel:
    factor = USUAL.of(figure.unit)[1]
    spread = [factor * _sorted(machines.values[figure.key]) for machines in (before, after)]
    low, high = _range(spread)
    curves = list[Curve]()
    for i, (name, values) in enumerate(zip(("today", "new"), spread, strict=True)):
        share = 100.0 * np.arange(1, values.size + 1) / max(before.count, after.count)
        curves.append(Curve(*stairs(values, share), name, i))
    outside = list[Box]()
    if bound is not None and bound.least is not None:
        outside.append(Box(low, max(low, factor * bound.least), number=ALERT, pale=True))
    if bound is not None and bound.most is not None:
        outside.append(Box(min(high, factor * bound.most), high, number=ALERT, pale=True))
    label = f"{_axis_name(figure)}{f' ({unit_name(figure.unit)})' if figure.unit else ''}"
    return Panel(
        "machines below (%)",
        tuple(curves),
        boxes=tuple(outside),
        low=0.0,
        high=100.0,
        abscissa=Abscissa(label, low=low, high=high),
    )


def _sorted(values: np.ndarray) -> np.ndarray:
    """Sort the finite values."""
    return np.sort(values[np.isfinite(values)])


def _range(spread: list[np.ndarray]) -> tuple[float, float]:
    """The ends of an axis: all but the outermost hundredth of the values."""
    every = np.concatenate(spread)
    if not every.size:
        return 0.0, 1.0
    low, high = (float(end) for end in np.quantile(every, [0.005, 0.995]))
    return style.padded(low, high) if high > low else (low - 0.5 * abs(low) - 1e-12, high + 0.5 * abs(high) + 1e-12)


def _axis_name(figure: Figure) -> str:
    """The label of a figure: its description, or its key if that is too long for an axis."""
    return figure.description if len(figure.description) <= 44 else figure.key.replace("_", " ")
