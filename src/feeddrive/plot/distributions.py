"""Pictures of many variants: distribution of a batch, bars of a gradient, bars of an effort."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from feeddrive.language.quantity import DRAWN, Quantity, unit_name
from feeddrive.language.text import Text
from feeddrive.loop.loop import UNITS
from feeddrive.plot import style

if TYPE_CHECKING:
    from feeddrive.analysis.effort import Effort
    from feeddrive.loop.gradient import Gradient
    from feeddrive.loop.simulate import Batch


def batch(batch: Batch) -> Any:
    """Histogram of the RMS over the variants, for each signal, without variants that left their bounds."""
    from matplotlib.ticker import MaxNLocator

    names = list(batch.rms)
    columns = 2 if len(names) > 1 else 1
    rows = -(-len(names) // columns)
    figure, _ = style.picture(1, height=0.5 + 2.0 * rows)
    figure.clear()
    axes = [style.dressed(ax) for ax in np.ravel(figure.subplots(rows, columns, squeeze=False))]
    inside = batch.left < 0
    for i, (ax, name) in enumerate(zip(axes, names, strict=False)):
        unit = UNITS[name]
        factor = DRAWN.of(unit)[1]
        values = factor * batch.rms[name][inside]
        values = values[np.isfinite(values)]
        if values.size:
            low, high = float(values.min()), float(values.max())
            if high <= low:
                low, high = style.padded(low, high)
            edges = np.linspace(low, high, min(40, 5 + values.size // 5) + 1)
            ax.hist(values, bins=list(edges), color=style.color(i), alpha=0.75, edgecolor=style.PAPER, linewidth=0.5)
            ax.xaxis.set_major_locator(MaxNLocator(5))
            ax.ticklabel_format(axis="x", useOffset=False)
            ax.axvline(float(np.median(values)), color=style.INK, linewidth=1.2)
            median, least = (Quantity(size / factor, unit, bare=True) for size in (np.median(values), values.min()))
            style.note(ax, Text(f"median {median}, least {least}"))
        style.labels(ax, f"RMS of {name.replace('_', ' ')} ({unit_name(unit)})", "variants")
    for ax in axes[len(names) :]:
        ax.set_visible(False)
    lost = int(np.sum(~inside))
    if lost:
        figure.suptitle(
            f"{lost} of {inside.size} variants left their bounds and are not shown",
            fontsize=style.TEXT,
            color=style.ALERT,
        )
    return figure


def gradient(found: Gradient) -> Any:
    """By how many percent the cost changes for +1 % of each parameter: falls to the left, rises to the right."""
    names = list(found.gradient)
    scale = found.cost or 1.0
    share = np.array([found.gradient[name] * found.values[name] / scale for name in names])
    order = np.argsort(np.abs(share))
    figure, (ax,) = style.picture(1, height=1.0 + 0.3 * len(names))
    tints = [style.color(0) if share[i] < 0.0 else style.color(1) for i in order]
    bars = ax.barh([names[i] for i in order], share[order], color=tints, height=0.65)
    texts = [style.read(f"{Quantity(0.01 * share[i], 'share'):+.3f}") for i in order]
    ax.bar_label(bars, labels=texts, padding=4, fontsize=style.SMALL, color=style.INK)
    ax.axvline(0.0, color=style.INK, linewidth=1.0)
    ax.grid(False, axis="y")
    ax.margins(x=0.18)
    style.labels(ax, "change of the cost for +1 % of the parameter (%)", "")
    return figure


def effort(found: Effort) -> Any:
    """Operations of one sample by kind."""
    names = sorted(found.operations, key=lambda name: found.operations[name])
    figure, (ax,) = style.picture(1, height=1.0 + 0.3 * len(names))
    bars = ax.barh(names, [found.operations[name] for name in names], color=style.color(0), height=0.65)
    ax.bar_label(bars, padding=4, fontsize=style.SMALL, color=style.INK)
    ax.grid(False, axis="y")
    ax.margins(x=0.1)
    style.labels(ax, f"operations a sample, {found.total} in all", "")
    return figure
