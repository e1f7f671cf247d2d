"""Pictures of chatter: the lobes over the spindle speed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from feeddrive.plot import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from feeddrive.machining.lobes import CutStability, Lobes

_SHADE = "#d9efe8"  # the third color of the style, thinned
_CROWDED = (
    12  # speeds at which a tooth passes a whole number of swings; with more of them only the upper ones are named
)


def lobes(found: Lobes) -> Any:
    """Limits over the spindle speed, the stable side shaded, Hopf and flip apart; below it the chatter frequency."""
    figure, (upper, lower) = style.picture(2, height=5.4, ratios=(2.0, 1.0))
    speed, there = found.spindle_speed, np.isfinite(found.depth)
    top = 1e3 * (1.15 * np.max(found.depth[there]) if np.any(there) else found.deepest)
    if found.own is not None:
        top = max(top, 1.15e3 * found.own.depth)
    shaded = np.where(there, 1e3 * found.depth, top)
    upper.fill_between(speed, 0.0, np.minimum(shaded, top), color=_SHADE, linewidth=0.0, zorder=0,
                       label="stable")  # fmt: skip
    for i, (flip, name) in enumerate(((False, "Hopf border"), (True, "flip border"))):
        _border(upper, speed, 1e3 * found.depth, there, found.flip == flip, i, name)
        chosen = there & (found.flip == flip)
        if np.any(chosen):
            lower.plot(speed[chosen], found.frequency[chosen], style.MARKERS[i], color=style.color(i), markersize=2.5)
    for n, (rpm, low, high) in enumerate(found.islands):
        upper.plot([rpm, rpm], [1e3 * low, min(1e3 * high, top)], color=style.color(2), linewidth=2.5, alpha=0.5,
                   label=None if n else "stable again above the border")  # fmt: skip
    passing = found.passing()
    for n, (rpm, hertz, k) in enumerate(reversed(passing)):
        upper.axvline(rpm, color=style.MUTED, linewidth=0.8, linestyle=(0, (1, 2)),
                      label="tooth passes every k swings of a mode" if n == 0 else None)  # fmt: skip
        if n < _CROWDED:
            upper.annotate(f"{k}", (rpm, 1.0), xycoords=("data", "axes fraction"), xytext=(0, -2),
                           textcoords="offset points", ha="center", va="top", fontsize=style.SMALL, color=style.MUTED,
                           bbox={"facecolor": style.PAPER, "edgecolor": "none", "pad": 0.8})  # fmt: skip
        del hertz
    for hertz in found.natural:
        lower.axhline(hertz, color=style.MUTED, linewidth=0.8, linestyle=(0, (4, 3)))
    if found.own is not None:
        _own(upper, found.own)
    upper.set_ylim(0.0, top)
    low = float(np.nanmin(found.frequency)) if np.any(there) else 0.0
    high = float(np.nanmax(found.frequency)) if np.any(there) else 1.0
    lower.set_ylim(*style.padded(low, high, 0.12))
    if found.natural.size:
        style.note(lower, "dashed: own frequencies")
    style.labels(upper, None, "axial depth (mm)")
    style.labels(lower, "spindle speed (rpm)", "chatter (Hz)")
    style.legend(figure, upper, columns=3)
    return figure


def _border(
    ax: Axes, speed: np.ndarray, depth: np.ndarray, there: np.ndarray, kind: np.ndarray, i: int, name: str
) -> None:
    """The border of one kind, carried on to the next speed so that no gap remains where the kind changes."""
    chosen = there & kind
    if not np.any(chosen):
        return
    joined = chosen | (np.roll(chosen, 1) & there & (np.arange(speed.size) > 0))
    ax.plot(speed, np.where(joined, depth, np.nan), label=name, **style.curve(i))
    if np.count_nonzero(chosen) < 3:
        ax.plot(speed[chosen], depth[chosen], style.MARKERS[i], color=style.color(i), markersize=4)


def _own(ax: Axes, own: CutStability) -> None:
    color = style.color(2) if own.stable else style.ALERT
    ax.plot([own.speed], [1e3 * own.depth], "D", color=color, markersize=6, markeredgecolor=style.PAPER, zorder=5)
    said = f"this cut: |µ| = {own.growth:.3f}{'' if own.stable else ', chatters'}"
    low, high = ax.get_xlim()
    right = own.speed > 0.6 * high + 0.4 * low
    ax.annotate(said, (own.speed, 1e3 * own.depth), xytext=(-8 if right else 8, 5), textcoords="offset points",
                ha="right" if right else "left", fontsize=style.SMALL, color=color,
                bbox={"facecolor": style.PAPER, "edgecolor": "none", "pad": 0.8, "alpha": 0.85})  # fmt: skip
