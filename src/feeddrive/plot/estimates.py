"""Pictures of observers and of what dead time allows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from feeddrive.analysis.observe import Observation
from feeddrive.language.table import picture_of
from feeddrive.plot import style
from feeddrive.tuning.delay_map import DelayMap


@picture_of.register(Observation)
def disturbance(
    observations: Observation | Mapping[str, Observation],
    true: np.ndarray | None = None,
    window: tuple[float, float] | None = None,
) -> Any:
    """Estimated disturbances over time in ms, with the true one in gray; `window` in s says from when to when."""
    chosen = style.named(observations)
    figure, (ax,) = style.picture(1, height=3.2)
    first = next(iter(chosen.values()))
    low, high = window or (float(first.time[0]), float(first.time[-1]))
    shown = (first.time >= low) & (first.time <= high)
    if true is not None:
        ax.step(1e3 * first.time[shown], true[shown], where="post", color=style.MUTED, linewidth=2.4, alpha=0.55,
                label="true")  # fmt: skip
    for i, (name, found) in enumerate(chosen.items()):
        ax.plot(1e3 * found.time[shown], found.disturbance[shown], label=style.caption(name), **style.curve(i))
    style.labels(ax, "time (ms)", "disturbance (N)")
    style.legend(figure, ax)
    return figure


@picture_of.register(DelayMap)
def delay_map(maps: DelayMap | Mapping[str, DelayMap]) -> Any:
    """The first tunable at the edge of stability and where Ms reaches its bound, over the dead time in samples."""
    chosen = style.named(maps)
    figure, (ax,) = style.picture(1, height=3.2)
    for i, (name, found) in enumerate(chosen.items()):
        tunable = next(iter(found.tunables))
        samples = found.dead_time / found.sample_time
        edge, robust = found.at_edge(tunable), found.at_robust(tunable)
        mark = style.MARKERS[i % len(style.MARKERS)]
        before = f"{name}: " if name else ""
        ax.plot(samples, edge, mark + "-", color=style.color(i), linewidth=style.LINE, label=f"{before}unstable above")
        ax.plot(samples, robust, mark + "--", color=style.color(i), linewidth=style.LINE,
                label=f"{before}Ms = {found.sensitivity_bound:g}")  # fmt: skip
        ax.fill_between(samples, 0.0, robust, color=style.color(i), alpha=0.08, linewidth=0.0)
        style.labels(ax, "dead time (samples)", f"{tunable.rpartition('.')[2].replace('_', ' ')} (1/s)")
    ax.set_ylim(bottom=0.0)
    style.legend(figure, ax, 2)
    return figure
