"""Pictures of chatter: the lobes over the spindle speed; its signs in a signal."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from feeddrive.language.quantity import USUAL, Quantity, signal_unit, unit_name
from feeddrive.language.text import Text
from feeddrive.plot import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from feeddrive.machining.chatter_signs import ChatterSigns
    from feeddrive.machining.cutting_force import CuttingForces
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
    said = f"this cut: |µ| = {Quantity(own.growth):.3f}{'' if own.stable else ', chatters'}"
    low, high = ax.get_xlim()
    right = own.speed > 0.6 * high + 0.4 * low
    ax.annotate(style.read(said), (own.speed, 1e3 * own.depth), xytext=(-8 if right else 8, 5),
                textcoords="offset points", ha="right" if right else "left", fontsize=style.SMALL, color=color,
                bbox={"facecolor": style.PAPER, "edgecolor": "none", "pad": 0.8, "alpha": 0.85})  # fmt: skip


def cutting_forces(found: CuttingForces) -> Any:
    """Forces over the angle of the spindle in the last turn that cuts; force across the spindle and power over time."""
    figure, axes = style.picture(3, height=6.0, share=False)
    turns = found.angle / (2.0 * np.pi)
    cuts = np.flatnonzero(found.torque != 0.0)
    if cuts.size:
        last = np.floor(turns[cuts[-1]])
        turn = (turns >= last - 1.0) & (turns < last) if last >= 1.0 else np.ones(turns.size, dtype=bool)
        degrees = 360.0 * (turns[turn] - np.floor(turns[turn][0]))
        for i, name in enumerate(("feed", "normal", "axial")):
            axes[0].plot(degrees, getattr(found, name)[turn], **style.curve(i), label=name)
        style.note(axes[0], Text(f"the turn from {Quantity(found.time[turn][0], 's'):SI} on"))
    axes[0].set_xlim(0.0, 360.0)
    axes[0].set_xticks(range(0, 361, 60))
    style.labels(axes[0], "angle of the spindle (°)", f"force on the\ntool ({unit_name('N')})")
    style.row_legend(axes[0])
    for ax, name, unit in ((axes[1], "resultant", "N"), (axes[2], "power", "W")):
        values = getattr(found, name)
        ax.plot(*style.envelope(found.time, values), **style.curve(0))
        ax.set_xlim(found.time[0], found.time[-1])
        mean = float(np.mean(values[cuts])) if cuts.size else 0.0
        mean, peak = (Quantity(size, unit, bare=True) for size in (mean, np.max(np.abs(values))))
        style.note(ax, Text(f"mean {mean} while it cuts, peak {peak}"))
        words = "power" if name == "power" else "force across\nthe spindle"
        style.labels(ax, "time (s)" if name == "power" else None, f"{words} ({unit_name(unit)})")
    figure.align_ylabels(axes)
    return figure


def chatter_signs(found: ChatterSigns) -> Any:
    """Spectrum with the harmonics of the teeth apart from the rest; each sample once per tooth over the one before."""
    figure, _ = style.picture(1, height=3.6)
    figure.clear()
    left, right = (style.dressed(ax) for ax in figure.subplots(1, 2, gridspec_kw={"width_ratios": (1.7, 1.0)}))
    lines = found.spectrum
    unit, factor = USUAL.of(lines.unit, signal_unit(lines.unit))
    top = min(float(lines.frequency[-1]), 8.0 * max(found.passing, found.chatter if found.dots != 1 else 0.0))
    chosen = (lines.frequency > 0.0) & (lines.frequency <= top)
    for i, (mask, name) in enumerate(((found.harmonic, "harmonics of the teeth"), (~found.harmonic, "all else"))):
        amplitude = np.where(mask & chosen, factor * lines.amplitude, np.nan)
        left.vlines(lines.frequency, 0.0, amplitude, color=style.color(i), linewidth=style.LINE, label=name)
    if found.dots != 1:
        peak = factor * float(lines.amplitude[np.searchsorted(lines.frequency, found.chatter)])
        left.annotate(style.read(f"{Quantity(found.chatter, 'Hz')}"), (found.chatter, peak), xytext=(4, 2),
                      textcoords="offset points", fontsize=style.SMALL, color=style.color(1))  # fmt: skip
    left.set_xlim(0.0, top)
    left.set_ylim(0.0, 1.12 * factor * float(np.max(lines.amplitude[chosen])))
    style.labels(left, "frequency (Hz)", f"{lines.name.replace('_', ' ')} ({unit_name(style.written(unit))})")
    values = factor * found.samples
    right.plot(values[:-1], values[1:], ".", color=style.color(0 if found.dots == 1 else 1), markersize=4)
    said = {1: "one dot: stable", 2: "two dots: flip", 0: "a ring: Hopf chatter"}[found.dots]
    style.note(right, said)
    middle, spread = float(np.mean(values)), 1.3 * float(np.ptp(values))
    room = max(0.5 * spread, 0.5 * factor * found.swing if found.dots == 1 else 0.0) or 1.0
    right.set_xlim(middle - room, middle + room)
    right.set_ylim(middle - room, middle + room)
    right.set_aspect("equal")
    name = unit_name(style.written(unit))
    style.labels(right, f"once per tooth ({name})", f"a tooth later ({name})")
    style.legend(figure, left)
    return figure
