"""Pictures over frequency: Bode with all margins, closed loop, sensitivity, dynamic stiffness, amplitude spectrum."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from feeddrive.analysis.margins import Margins, complementary_sensitivity, tracking_bandwidth
from feeddrive.analysis.margins import sensitivity as sensitivity_of
from feeddrive.language.errors import ParameterError
from feeddrive.language.table import shown
from feeddrive.plot import style

if TYPE_CHECKING:
    from collections.abc import Mapping

    from matplotlib.axes import Axes

    from feeddrive.analysis.margin_intervals import MarginIntervals
    from feeddrive.analysis.measured_loop import MeasuredLoop
    from feeddrive.analysis.spectrum import Spectrum
    from feeddrive.analysis.stiffness import Stiffness
    from feeddrive.loop.frequency_response import FRF
    from feeddrive.tuning.recipes import Recipe
    from feeddrive.tuning.tuned import CascadeLoops, Tuned

BANDS = 500  # over the whole axis: a line shows the largest amplitude in its band


def bode(responses: FRF | Mapping[str, FRF]) -> Any:
    """Magnitude in dB and phase in degrees over Hz; with a third row if a response has a coherence."""
    chosen = style.named(responses)
    measured = any(response.coherence is not None for response in chosen.values())
    figure, axes = style.picture(2 + measured, height=4.6 + measured, ratios=[3, 2, 1] if measured else [3, 2])
    for i, (name, response) in enumerate(chosen.items()):
        axes[0].plot(response.frequency, style.decibel(response.magnitude), label=style.caption(name), **style.curve(i))
        axes[1].plot(response.frequency, response.phase_deg, **style.curve(i))
        if response.coherence is not None:
            axes[2].plot(response.frequency, response.coherence, **style.curve(i))
    unit = next((response.unit for response in chosen.values() if response.unit), "")
    style.labels(axes[0], None, f"magnitude (dB re 1 {unit})" if unit not in ("", "N/N", "m/m") else "magnitude (dB)")
    style.labels(axes[1], None if measured else "frequency (Hz)", "phase (deg)")
    phases = np.concatenate([response.phase_deg for response in chosen.values()])
    style.degrees_axis(axes[1], float(phases.min()), float(phases.max()))
    if measured:
        style.labels(axes[2], "frequency (Hz)", "coherence")
        axes[2].set_ylim(0.0, 1.05)
    style.frequency_axis(axes[-1], *_span(response.frequency for response in chosen.values()))
    style.frequency_grid(axes)
    style.legend(figure, axes[0])
    return figure


def closed_loop(responses: FRF | Mapping[str, FRF]) -> Any:
    """Magnitude of the response to the setpoint in dB, with the -3 dB line, and each one's bandwidth and peak."""
    chosen = style.named(responses)
    figure, (ax,) = style.picture(1, height=3.0)
    lows: list[float] = []
    for i, (name, response) in enumerate(chosen.items()):
        level = style.decibel(response.magnitude)
        width = tracking_bandwidth(response)
        said = [f"peak {level.max():.2f} dB"] + ([f"-3 dB at {width:.4g} Hz"] if width is not None else [])
        ax.plot(response.frequency, level, label=style.caption(name, ", ".join(said)), **style.curve(i))
        if width is not None:
            ax.plot([width], [_MINUS_3_DB], style.MARKERS[i % len(style.MARKERS)], color=style.color(i), markersize=5)
        lows.append(float(level.min()))
    ax.axhline(_MINUS_3_DB, color=style.MUTED, linewidth=1.0, linestyle=(0, (4, 3)))
    ax.annotate("-3 dB", (0.0, _MINUS_3_DB), xycoords=("axes fraction", "data"), xytext=(4, -2),
                textcoords="offset points", va="top", fontsize=style.SMALL, color=style.MUTED)  # fmt: skip
    ax.set_ylim(bottom=max(-40.0, min(lows) - 2.0))
    style.frequency_axis(ax, *_span(response.frequency for response in chosen.values()))
    style.labels(ax, "frequency (Hz)", "position / set position (dB)")
    style.legend(figure, ax, style.narrow(chosen))
    return figure


_MINUS_3_DB = float(20.0 * np.log10(np.sqrt(0.5)))


def sensitivity(loops: Margins | Mapping[str, Margins]) -> Any:
    """|S| and |T| in dB of loops that were opened at the drive, with the peak Ms marked."""
    chosen = style.named(loops)
    figure, axes = style.picture(2, height=4.4)
    for i, (name, margins) in enumerate(chosen.items()):
        L = margins.loop_gain
        label = style.caption(name, f"Ms {margins.sensitivity_peak:.3g} at {margins.modulus_frequency:.4g} Hz")
        axes[0].plot(L.frequency, style.decibel(sensitivity_of(L).magnitude), label=label, **style.curve(i))
        axes[1].plot(L.frequency, style.decibel(complementary_sensitivity(L).magnitude), **style.curve(i))
        axes[0].plot(
            [margins.modulus_frequency], style.decibel(np.array([margins.sensitivity_peak])),
            style.MARKERS[i % len(style.MARKERS)], color=style.color(i), markersize=5,
        )  # fmt: skip
    for ax, name in zip(axes, ("|S|", "|T|"), strict=True):
        ax.set_ylim(bottom=max(ax.get_ylim()[0], -60.0))
        style.labels(ax, None, f"{name} (dB)")
    axes[1].set_xlabel("frequency (Hz)", fontsize=style.TEXT)
    style.frequency_axis(axes[1], *_span(margins.loop_gain.frequency for margins in chosen.values()))
    style.frequency_grid(axes)
    style.legend(figure, axes[0], style.narrow(chosen))
    return figure


def stiffness(stiffnesses: Stiffness | Mapping[str, Stiffness]) -> Any:
    """Dynamic stiffness in N/µm over Hz, log-log, with the minimum marked."""
    chosen = style.named(stiffnesses)
    figure, (ax,) = style.picture(1, height=3.4)
    tops: list[float] = []
    lows: list[float] = []
    for i, (name, found) in enumerate(chosen.items()):
        least, where = 1e-6 * found.minimum, found.minimum_frequency
        label = style.caption(name, f"least {least:.3g} N/µm at {where:.3g} Hz")
        ax.plot(found.frequency, 1e-6 * found.magnitude, label=label, **style.curve(i))
        ax.plot([where], [least], style.MARKERS[i % len(style.MARKERS)], color=style.color(i), markersize=5)
        tops.append(1e-6 * float(np.max(found.magnitude[found.frequency <= 0.8 * found.frequency[-1]], initial=0.0)))
        lows.append(least)
    ax.set_yscale("log")
    # a sampled axis is infinitely stiff at Nyquist, where the sampled position cannot show the motion
    ax.set_ylim(0.5 * min(lows), 3.0 * max(*tops, *lows))
    style.plain_decades(ax.yaxis)
    ax.grid(True, which="minor", axis="y", color=style.GRID, linewidth=0.4)
    style.frequency_axis(ax, *_span(found.frequency for found in chosen.values()))
    style.labels(ax, "frequency (Hz)", "dynamic stiffness (N/µm)")
    style.legend(figure, ax, style.narrow(chosen))
    return figure


def spectrum(spectra: Spectrum | Mapping[str, Spectrum]) -> Any:
    """Amplitude and cumulative RMS over Hz, log-log; dense lines show the largest amplitude of each band."""
    chosen = style.named(spectra)
    figure, axes = style.picture(2, height=4.6, ratios=[3, 2])
    first = next(iter(chosen.values()))
    unit, factor = shown(first.unit)
    lowest = min(float(found.frequency[1]) for found in chosen.values())
    highest = max(float(found.frequency[-1]) for found in chosen.values())
    tops, bottoms = [], []
    for i, (name, found) in enumerate(chosen.items()):
        frequency, amplitude, cumulative = _banded(found, lowest, highest)
        line = style.curve(i)
        axes[0].plot(
            frequency, factor * amplitude, label=style.caption(name), **line | {"linewidth": 1.0, "linestyle": "-"}
        )
        axes[1].plot(frequency, factor * cumulative, **line)
        tops.append(factor * float(np.max(amplitude)))
        bottoms.append(factor * float(np.quantile(amplitude, 0.02)))
    top = max(tops)
    if top > 0.0:  # a signal that is zero cannot be drawn on a logarithmic scale
        axes[0].set_yscale("log")
        style.plain_decades(axes[0].yaxis, crowded=True)
        axes[0].set_ylim(max(0.5 * min(bottoms), 1e-7 * top), 2.0 * top)
    whole = [factor * found.rms for found in chosen.values()]
    if min(whole) > 0.0 and max(whole) > style.WIDE * min(whole):
        axes[1].set_yscale("log")
        style.plain_decades(axes[1].yaxis, crowded=True)
        axes[1].set_ylim(0.1 * min(whole), 2.0 * max(whole))
    else:
        axes[1].set_ylim(0.0, 1.15 * max(whole) or 1.0)
    quantity = first.name.replace("_", " ") if len(chosen) == 1 or first.name else "amplitude"
    style.labels(axes[0], None, f"{quantity}\namplitude ({style.written(unit)})")
    style.labels(axes[1], "frequency (Hz)", f"cumulative\nRMS ({style.written(unit)})")
    style.frequency_axis(axes[1], lowest, highest)
    style.frequency_grid(axes)
    style.legend(figure, axes[0])
    return figure


def _banded(found: Spectrum, low: float, high: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frequency, largest amplitude and last cumulative RMS of each band that has lines, without the line at 0."""
    frequency = found.frequency[1:]
    bands = np.floor(BANDS * np.log(frequency / low) / np.log(high / low)).astype(int)
    begins = np.flatnonzero(np.diff(bands, prepend=-1))
    ends = np.append(begins[1:], frequency.size) - 1
    amplitude = np.maximum.reduceat(found.amplitude[1:], begins)
    centre = np.sqrt(frequency[begins] * frequency[ends])
    return centre, amplitude, found.cumulative_rms[1:][ends]


def _span(frequencies: Any) -> tuple[float, float]:
    ends = [(float(f[0]), float(f[-1])) for f in frequencies]
    return min(low for low, _ in ends), max(high for _, high in ends)


def tuned(found: Tuned) -> Any:
    """Dynamic stiffness before and after at each point."""
    many = len(found.after) > 1
    curves = {
        f"{name}, {each.point}" if many else name: each.stiffness
        for name, row in (("today", found.before), ("new", found.after))
        for each in row
        if each.stable
    }
    return stiffness(curves)


FAR = 60.0  # dB: a larger margin is not drawn
WRITTEN = 3  # crossovers of a kind with their number, in a picture of one loop


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
    """Write next to a bar, on the side with more room."""
    low, high = ax.get_xlim()
    right = np.log(x / low) < 0.85 * np.log(high / low)
    ax.annotate(
        text, (x, y), xytext=(5 if right else -5, 0), textcoords="offset points", ha="left" if right else "right",
        va="center", fontsize=style.SMALL, color=style.INK,
        bbox={"facecolor": style.PAPER, "edgecolor": "none", "alpha": 0.8, "pad": 0.8},
    )  # fmt: skip


def measured_loop(found: MarginIntervals | MeasuredLoop) -> Any:
    """Loop gain with its crossovers."""
    return open_loop(found.margins)


def cascade_loops(found: CascadeLoops) -> Any:
    """Loop gains of both loops of a cascade."""
    return open_loop({"velocity loop": found.velocity, "position loop": found.position})


def recipe(_found: Recipe) -> Any:
    """Raise ParameterError: a recipe has no picture."""
    raise ParameterError("a recipe has no picture: give its law to `tune` or `measured_loop`, and draw that")
