"""Pictures of a measured frequency response with its errors, and of the excitation that is sent for one."""

from __future__ import annotations

from typing import Any

import numpy as np

from feeddrive.identification.excitation.excitation import Excitation
from feeddrive.identification.excitation.frequency_estimate import FrequencyEstimate
from feeddrive.language.table import picture_of
from feeddrive.loop.frequency_response import FRF
from feeddrive.plot import style
from feeddrive.plot.envelope import envelope

_LEVELS = {"noise": "noise", "nonlinear": "scatter beyond noise", "odd": "odd distortion", "even": "even distortion"}


@picture_of.register(FrequencyEstimate)
def frequency_estimate(found: FrequencyEstimate, model: FRF | None = None) -> Any:
    """Magnitude with the 95 % band, noise and distortion; phase with its band; coherence. `model` is drawn behind."""
    frf = found.frf
    assert frf.coherence is not None
    figure, axes = style.picture(3, height=5.8, ratios=[3, 2, 1])
    f, size, radius = frf.frequency, frf.magnitude, found.radius()
    floor = 1e-3 * float(np.min(size))
    if model is not None:
        axes[0].plot(model.frequency, style.decibel(model.magnitude), label="model", **style.curve(1))
        axes[1].plot(model.frequency, _beside(model.phase_deg, model.frequency, frf), **style.curve(1))
    axes[0].plot(f, style.decibel(size), label="measured, 95 % band", **style.curve(0))
    low, high = style.decibel(np.maximum(size - radius, floor)), style.decibel(size + radius)
    axes[0].fill_between(f, low, high, color=style.color(0), alpha=0.25, linewidth=0.0)
    for i, (name, text) in enumerate(_LEVELS.items(), start=2):
        level = found.levels.get(name)
        if level is None or not np.any(there := np.isfinite(level.response) & (level.response > 0.0)):
            continue
        look = style.curve(i) | {"linestyle": "none", "marker": ".", "markersize": 2.5}
        axes[0].plot(level.frequency[there], style.decibel(level.response[there]), label=text, **look)
    phase = frf.phase_deg
    spread = np.degrees(np.arcsin(np.minimum(radius / size, 1.0)))
    axes[1].plot(f, phase, **style.curve(0))
    axes[1].fill_between(f, phase - spread, phase + spread, color=style.color(0), alpha=0.25, linewidth=0.0)
    axes[2].plot(f, frf.coherence, **style.curve(0))
    axes[2].set_ylim(min(0.98, 0.9 * float(np.min(frf.coherence))), 1.002)
    style.labels(axes[0], None, f"magnitude (dB re 1 {frf.unit})" if frf.unit else "magnitude (dB)")
    style.labels(axes[1], None, "phase (deg)")
    style.labels(axes[2], "frequency (Hz)", "coherence")
    style.degrees_axis(axes[1], float(np.min(phase)), float(np.max(phase)))
    style.frequency_axis(axes[2], float(f[0]), float(f[-1]))
    style.frequency_grid(axes)
    style.legend(figure, axes[0], 3)
    return figure


def _beside(phase: np.ndarray, frequency: np.ndarray, frf: FRF) -> np.ndarray:
    """The phase of a model turned by whole turns so that it lies beside the measured one."""
    at = float(np.interp(frf.frequency[0], frequency, phase))
    return phase + 360.0 * round((float(frf.phase_deg[0]) - at) / 360.0)


@picture_of.register(Excitation)
def excitation(found: Excitation) -> Any:
    """What is sent in the first realisation, and speed and force that the simulation answers, over time."""
    drawn = found.drawings[0]
    figure, axes = style.picture(3, height=5.2)
    unit, factor = ("N", 1.0) if found.unit == "N" else ("µm", 1e6)
    rows = (
        (factor * drawn.excitation, f"excitation ({unit})"),
        (1e3 * drawn.signals["velocity_load"], "speed (mm/s)"),
        (drawn.signals["force"], "force (N)"),
    )
    for ax, (values, text) in zip(axes, rows, strict=True):
        ax.plot(*envelope(drawn.time, values), **style.curve(0) | {"linewidth": 0.7})
        style.labels(ax, None, text)
    T = found.sample_time
    for edge in (found.first, found.first + found.periods * found.period):
        for ax in axes:
            ax.axvline(edge * T, color=style.MUTED, linewidth=1.0, linestyle=(0, (4, 3)))
    axes[-1].set_xlabel("time (s)", fontsize=style.TEXT)
    style.note(axes[0], f"between the dashed lines: {found.periods} whole periods")
    return figure
