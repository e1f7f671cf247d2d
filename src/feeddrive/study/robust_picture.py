"""The picture of a robust tuning: how figures are spread over fresh machines, under today's control and the new one."""

from __future__ import annotations

from typing import Any

import numpy as np

from feeddrive.figures.figure import Figure
from feeddrive.language.quantity import USUAL, unit_name
from feeddrive.plot import style
from feeddrive.study.fresh import Measured


def shares(before: Measured, after: Measured) -> Any:
    """By figure the share of the machines below each value; what lies outside of a bound is shaded."""
    figures = after.figures
    columns = 2 if len(figures) > 1 else 1
    rows = -(-len(figures) // columns)
    picture, _ = style.picture(1, height=0.7 + 2.3 * rows)
    picture.clear()
    axes = [style.dressed(ax) for ax in np.ravel(picture.subplots(rows, columns, squeeze=False))]
    bounds = {bound.figure.key: bound for bound in after.bounds}
    lines: dict[str, Any] = {}
    for ax, figure in zip(axes, figures, strict=False):
        factor = USUAL.of(figure.unit)[1]
        spread = [factor * _sorted(each.values[figure.key]) for each in (before, after)]
        low, high = _range(spread)
        for i, (name, values) in enumerate(zip(("today", "new"), spread, strict=True)):
            share = 100.0 * np.arange(1, values.size + 1) / max(each.count for each in (before, after))
            (lines[name],) = ax.step(values, share, where="post", **style.curve(i))
        ax.set_xlim(low, high)
        ax.set_ylim(0.0, 100.0)
        bound = bounds.get(figure.key)
        if bound is not None and bound.least is not None:
            ax.axvspan(low, max(low, factor * bound.least), color=style.ALERT, alpha=0.1, linewidth=0.0)
        if bound is not None and bound.most is not None:
            ax.axvspan(min(high, factor * bound.most), high, color=style.ALERT, alpha=0.1, linewidth=0.0)
        style.labels(
            ax, f"{_said(figure)}{f' ({unit_name(figure.unit)})' if figure.unit else ''}", "machines below (%)"
        )
    for ax in axes[len(figures) :]:
        ax.set_visible(False)
    style.figure_legend(picture, lines)
    return picture


def _sorted(values: np.ndarray) -> np.ndarray:
    """The values that there are, the least first."""
    return np.sort(values[np.isfinite(values)])


def _range(spread: list[np.ndarray]) -> tuple[float, float]:
    """The ends of an axis: all but the outermost hundredth of the values."""
    every = np.concatenate(spread)
    if not every.size:
        return 0.0, 1.0
    low, high = (float(each) for each in np.quantile(every, [0.005, 0.995]))
    return style.padded(low, high) if high > low else (low - 0.5 * abs(low) - 1e-12, high + 0.5 * abs(high) + 1e-12)


def _said(figure: Figure) -> str:
    """Its meaning, short enough for an axis."""
    return style.read(figure.description) if len(figure.description) <= 44 else figure.key.replace("_", " ")
