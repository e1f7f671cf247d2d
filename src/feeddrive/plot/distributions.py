"""Pictures of many variants: distribution of a batch, bars of a gradient, bars of an effort."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from feeddrive.language.quantity import DRAWN, Quantity, unit_name
from feeddrive.language.text import Text
from feeddrive.loop.loop import UNITS
from feeddrive.plot import style
from feeddrive.plot.chart import Abscissa, Box, Chart, Level, Panel, listed
from feeddrive.plot.drawing import figure_of

if TYPE_CHECKING:
    from feeddrive.analysis.effort import Effort
    from feeddrive.loop.gradient import Gradient
    from feeddrive.loop.simulate import Batch


def batch_chart(batch: Batch) -> Chart:
    """Histogram of the RMS over the variants, for each signal, without variants that left their bounds."""
    inside = batch.left < 0
    panels = [_variants(name, rms[inside], i) for i, (name, rms) in enumerate(batch.rms.items())]
    across = min(2, len(panels))
    lost = int(np.sum(~inside))
    caption = f"{lost} of {inside.size} variants left their bounds and are not shown" if lost else ""
    return Chart("", tuple(panels), across=across, height=0.5 + 2.0 * -(-len(panels) // across), caption=caption)


batch = figure_of(batch_chart)


def _variants(name: str, rms: np.ndarray, number: int) -> Panel:
    unit = UNITS[name]
    factor = DRAWN.of(unit)[1]
    values = factor * rms[np.isfinite(rms)]
    abscissa = f"RMS of {name.replace('_', ' ')} ({unit_name(unit)})"
    if not values.size:
        return Panel("variants", abscissa=Abscissa(abscissa))
    median, least = (Quantity(size / factor, unit, bare=True) for size in (np.median(values), values.min()))
    middle = Level(float(np.median(values)), upright=True)
    caption = Text(f"median {median}, least {least}")
    return replace(histogram(values, abscissa, "variants", values.size // 5, number), levels=(middle,), caption=caption)


def histogram(values: np.ndarray, abscissa: str, ordinate: str, more: int, number: int = 0) -> Panel:
    """How many of some values lie in each of 5 + `more` stretches of their range, at most 40."""
    low, high = float(values.min()), float(values.max())
    if high <= low:
        low, high = style.padded(low, high)
    counts, edges = np.histogram(values, np.linspace(low, high, min(40, 5 + more) + 1))
    bars = tuple(
        Box(float(a), float(b), 0.0, float(count), number)
        for a, b, count in zip(edges[:-1], edges[1:], counts, strict=True)
        if count
    )
    left, right = style.padded(low, high, 0.03)
    top = 1.05 * float(np.max(counts))
    return Panel(ordinate, boxes=bars, low=0.0, high=top, abscissa=Abscissa(abscissa, low=left, high=right))


def gradient_chart(gradient: Gradient) -> Chart:
    """By how many percent the cost changes for +1 % of each parameter: falls to the left, rises to the right."""
    names = list(gradient.gradient)
    scale = gradient.cost or 1.0
    share = {name: gradient.gradient[name] * gradient.values[name] / scale for name in names}
    names.sort(key=lambda name: -abs(share[name]))
    texts = [Text(f"{Quantity(0.01 * share[name], 'share'):+.3f}") for name in names]
    panel = bars(names, [share[name] for name in names], texts, [int(share[name] >= 0.0) for name in names])
    reach = max(map(abs, share.values()), default=0.0) or 1.0
    low, high = (1.3 * end for end in (min(0.0, *share.values()), max(0.0, *share.values())))
    return Chart(
        "change of the cost for +1 % of the parameter (%)",
        (replace(panel, levels=(Level(0.0, upright=True),)),),
        low=min(low, -0.18 * reach),
        high=max(high, 0.18 * reach),
        height=1.0 + 0.3 * len(names),
    )


gradient = figure_of(gradient_chart)


def effort_chart(effort: Effort) -> Chart:
    """Operations of one sample by kind."""
    names = sorted(effort.operations, key=lambda name: -effort.operations[name])
    sizes = [float(effort.operations[name]) for name in names]
    panel = bars(names, sizes, [f"{size:g}" for size in sizes])
    label = f"operations a sample, {effort.total} in all"
    return Chart(label, (panel,), low=0.0, high=1.1 * max(sizes, default=1.0), height=1.0 + 0.3 * len(names))


effort = figure_of(effort_chart)


def bars(
    names: Sequence[str],
    sizes: Sequence[float],
    texts: Sequence[str],
    numbers: Sequence[int] | None = None,
    base: float = 0.0,
) -> Panel:
    """A row for each name, from the top: a bar from `base` to its size, with a text beside."""
    boxes = tuple(
        Box(
            min(base, size),
            max(base, size),
            -row - 0.32,
            -row + 0.32,
            0 if numbers is None else numbers[row],
            text=texts[row],
            beside=True,
        )
        for row, size in enumerate(sizes)
    )
    return Panel("", boxes=boxes, ticks=listed(names), low=0.4 - max(len(names), 1), high=0.6)
