"""The Bode plot of loop gains with all margins marked."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from feeddrive.analysis.margin_intervals import MarginIntervals
from feeddrive.analysis.margins import Margins
from feeddrive.analysis.measured_loop import MeasuredLoop
from feeddrive.language.errors import ParameterError
from feeddrive.language.table import picture_of
from feeddrive.plot import style
from feeddrive.tuning.recipes import Recipe
from feeddrive.tuning.tuned import CascadeLoops

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FAR = 60.0  # dB: a margin beyond it says nothing and is not drawn
WRITTEN = 3  # crossovers of a kind that get their number written beside them, in a picture of one loop


@picture_of.register(Margins)
def open_loop(loops: Margins | Mapping[str, Margins]) -> Any:
    """Magnitude in dB and phase in degrees of loop gains, with every gain and phase crossover.

    A bar on the phase stands for a phase margin, a bar on the magnitude for a gain margin.
    """
    chosen = style.named(loops)
    figure, axes = style.picture(2, height=5.0, ratios=[3, 2])
    ends = [margins.loop_gain.frequency[[0, -1]] for margins in chosen.values()]
    style.frequency_axis(axes[1], min(float(e[0]) for e in ends), max(float(e[1]) for e in ends))
    lows, highs, levels = [], [], []
    for i, (name, margins) in enumerate(chosen.items()):
        L = margins.loop_gain
        phase = _phase(margins)
        level = style.decibel(L.magnitude)
        axes[0].plot(L.frequency, level, label=_label(name, margins), **style.curve(i))
        axes[1].plot(L.frequency, phase, **style.curve(i))
        _mark(axes, margins, phase, i, len(chosen) == 1)
        lows.append(float(phase.min()))
        highs.append(float(phase.max()))
        levels.append(level)
    axes[0].axhline(0.0, color=style.INK, linewidth=1.0)
    low, high = min(*lows, -180.0), max(highs)
    for turn in range(int(np.ceil((low + 180.0) / 360.0)), int(np.floor((high + 180.0) / 360.0)) + 1):
        axes[1].axhline(360.0 * turn - 180.0, color=style.INK, linewidth=1.0)
    style.degrees_axis(axes[1], low, high)
    bottom = min(float(np.min(level)) for level in levels)
    top = max(float(np.max(level)) for level in levels)
    axes[0].set_ylim(max(bottom, -FAR) - 5.0, min(top, 80.0) + 5.0)
    style.labels(axes[0], None, "open loop |L| (dB)")
    style.labels(axes[1], "frequency (Hz)", "phase (deg)")
    style.frequency_grid(axes)
    style.legend(figure, axes[0], 1)
    return figure


def _label(name: str, margins: Margins) -> str | None:
    said = []
    if margins.crossover is not None:
        said.append(f"crossover {margins.crossover:.3g} Hz, phase margin {margins.phase_margin_deg:.1f}°")
    if margins.gain_increase_dB is not None:
        said.append(f"gain margin {margins.gain_increase_dB:.1f} dB")
    return style.caption(name, ", ".join(said))


def _phase(margins: Margins) -> np.ndarray:
    """Continuous phase, in the turn that shows the first crossover between -360° and 0°."""
    L = margins.loop_gain
    phase = L.phase_deg
    at = L.frequency[0] if margins.crossover is None else margins.crossover
    return phase - 360.0 * np.ceil(np.interp(np.log(at), np.log(L.frequency), phase) / 360.0 - 1e-6)


def _mark(axes: list[Axes], margins: Margins, phase: np.ndarray, i: int, alone: bool) -> None:
    """Points at the crossovers, and bars from the curve to 0 dB or to the nearest -180°."""
    x = np.log(margins.loop_gain.frequency)
    look: dict[str, Any] = {
        "color": style.color(i),
        "marker": style.MARKERS[i % len(style.MARKERS)],
        "linestyle": "none",
    }
    bar: dict[str, Any] = {"color": style.color(i), "linewidth": 2.4, "alpha": 0.55, "solid_capstyle": "butt"}
    for k, gain in enumerate(margins.gain_crossovers):
        at = float(np.interp(np.log(gain.frequency), x, phase))
        axes[0].plot([gain.frequency], [0.0], markersize=5, **look)
        axes[1].plot([gain.frequency] * 2, [at - gain.phase_margin_deg, at], **bar)
        axes[1].plot([gain.frequency], [at], markersize=4, **look)
        if alone and k < WRITTEN:
            _write(axes[1], gain.frequency, at - 0.5 * gain.phase_margin_deg, f"{gain.phase_margin_deg:.1f}°")
    for k, crossing in enumerate(margins.phase_crossovers):
        if abs(crossing.gain_margin_dB) > FAR:
            continue
        at = float(np.interp(np.log(crossing.frequency), x, phase))
        axes[1].plot([crossing.frequency], [at], markersize=5, markerfacecolor=style.PAPER, **look)
        axes[0].plot([crossing.frequency] * 2, [-crossing.gain_margin_dB, 0.0], **bar)
        axes[0].plot(
            [crossing.frequency], [-crossing.gain_margin_dB], markersize=4, markerfacecolor=style.PAPER, **look
        )
        if alone and k < WRITTEN:
            _write(axes[0], crossing.frequency, -0.5 * crossing.gain_margin_dB, f"{crossing.gain_margin_dB:.1f} dB")


def _write(ax: Axes, x: float, y: float, text: str) -> None:
    """Beside a bar, on the side on which there is room."""
    low, high = ax.get_xlim()
    right = np.log(x / low) < 0.85 * np.log(high / low)
    ax.annotate(
        text, (x, y), xytext=(5 if right else -5, 0), textcoords="offset points", ha="left" if right else "right",
        va="center", fontsize=style.SMALL, color=style.INK,
        bbox={"facecolor": style.PAPER, "edgecolor": "none", "alpha": 0.8, "pad": 0.8},
    )  # fmt: skip


@picture_of.register(MarginIntervals)
@picture_of.register(MeasuredLoop)
def _margins_of(found: MarginIntervals | MeasuredLoop) -> Any:
    return open_loop(found.margins)


@picture_of.register
def _cascade_loops(found: CascadeLoops) -> Any:
    return open_loop({"velocity loop": found.velocity, "position loop": found.position})


@picture_of.register
def _recipe(_found: Recipe) -> Any:
    raise ParameterError("a recipe has no picture: give its law to `tune` or `measured_loop`, and draw that")
