"""Pictures of measured responses over frequency: with their errors, with a fitted model, and of their excitation."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from feeddrive.plot import style
from feeddrive.plot.style import envelope

if TYPE_CHECKING:
    from feeddrive.identification.excitation.excitation import Excitation
    from feeddrive.identification.excitation.frequency_estimate import FrequencyEstimate
    from feeddrive.identification.response.agreement import Agreement
    from feeddrive.identification.response.fit_axis import AxisFits
    from feeddrive.identification.response.modal_fit import ModalFit
    from feeddrive.identification.response.plant_fit import PlantFit
    from feeddrive.loop.frequency_response import FRF

_LEVELS = {"noise": "noise", "nonlinear": "scatter beyond noise", "odd": "odd distortion", "even": "even distortion"}


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
    """The phase of a model, shifted by whole turns next to the measured one."""
    at = float(np.interp(frf.frequency[0], frequency, phase))
    return phase + 360.0 * round((float(frf.phase_deg[0]) - at) / 360.0)


def excitation(found: Excitation) -> Any:
    """The excitation of the first realization, and the simulated speed and force, over time."""
    drawn = found.drawings[0]
    figure, axes = style.picture(3, height=5.2)
    unit, factor = ("N", 1.0) if found.where == "force" else ("µm", 1e6)
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


def response_fit(found: Agreement) -> Any:
    """Magnitude and phase: the measurement as dots with its 95 % band, the model as a line; their distance; coherence.

    The distance is |model/measured - 1| in dB; the dashed line of the same color is the radius of the 95 % disc.
    """
    every = list(zip(found.measured, found.fitted, strict=True))
    coherent = any(measured.coherence is not None for measured, _ in every)
    ratios = [3, 2, 1.4, 1] if coherent else [3, 2, 1.4]
    figure, axes = style.picture(len(ratios), height=6.8 if coherent else 5.8, ratios=ratios)
    lows, highs = [], []
    for i, (measured, fitted) in enumerate(every):
        f, size, curve = measured.frequency, measured.magnitude, found.drawn[i]
        dots = style.curve(i) | {"linestyle": "none", "marker": ".", "markersize": 3.0, "alpha": 0.6}
        name = measured.output if len(every) > 1 else ""
        phase = curve.phase_deg
        on_lines = np.degrees(np.angle(fitted.response))
        on_lines += 360.0 * np.round((np.interp(f, curve.frequency, phase) - on_lines) / 360.0)
        beside = on_lines + np.degrees(np.angle(measured.response / fitted.response))
        axes[0].plot(f, style.decibel(size), label=style.caption(name, "measured"), **dots)
        axes[0].plot(
            curve.frequency, style.decibel(curve.magnitude), label=style.caption(name, "fitted"), **style.curve(i)
        )
        axes[1].plot(f, beside, **dots)
        axes[1].plot(curve.frequency, phase, **style.curve(i))
        axes[2].plot(f, style.decibel(np.abs(fitted.response / measured.response - 1.0)), **dots)
        radius = measured.radius
        if radius is not None:
            shade = {"color": style.color(i), "alpha": 0.18, "linewidth": 0.0}
            low, high = style.decibel(np.maximum(size - radius, 0.1 * size)), style.decibel(size + radius)
            axes[0].fill_between(f, low, high, **shade)
            spread = np.degrees(np.arcsin(np.minimum(radius / size, 1.0)))
            axes[1].fill_between(f, beside - spread, beside + spread, **shade)
            axes[2].plot(f, style.decibel(radius / size), color=style.color(i), linewidth=0.8, linestyle=(0, (4, 3)))
        if measured.coherence is not None:
            axes[3].plot(f, measured.coherence, **style.curve(i))
        lows.append(float(np.min(phase)))
        highs.append(float(np.max(phase)))
    unit = every[0][0].unit
    style.labels(axes[0], None, f"magnitude (dB re 1 {unit})" if unit else "magnitude (dB)")
    style.labels(axes[1], None, "phase (deg)")
    style.labels(axes[2], None, "error (dB)")
    if coherent:
        least = min(float(np.min(m.coherence)) for m, _ in every if m.coherence is not None)
        axes[3].set_ylim(max(0.0, min(0.98, 0.9 * least)), 1.002)
        style.labels(axes[3], None, "coherence")
    axes[-1].set_xlabel("frequency (Hz)", fontsize=style.TEXT)
    style.degrees_axis(axes[1], min(lows), max(highs))
    _frequency(axes[-1], found)
    style.frequency_grid(axes)
    style.legend(figure, axes[0], 2)
    return figure


def response_residuals(found: Agreement) -> Any:
    """Weighted residuals over frequency, real and imaginary part, and their autocorrelation from line to line."""
    figure, axes = style.picture(2, height=4.4, ratios=[2, 1], share=False)
    lags = np.arange(1, max(2, min(40, min(r.size for r in found.residuals) // 4)))
    for i, (measured, r) in enumerate(zip(found.measured, found.residuals, strict=True)):
        name = measured.output if len(found.measured) > 1 else ""
        look = {"color": style.color(i), "linestyle": "none", "markersize": 3.0}
        f, scaled = measured.frequency, r / max(found.spread, 1e-300)
        axes[0].plot(f, np.real(scaled), marker=".", label=style.caption(name, "real"), **look)
        axes[0].plot(f, np.imag(scaled), marker="x", label=style.caption(name, "imaginary"), **look)
    across = [found.autocorrelation(int(lag)) for lag in lags]
    axes[1].vlines(lags, 0.0, across, color=style.color(0), linewidth=1.4)
    axes[1].set_xlim(0.0, float(lags[-1]) + 1.0)
    bound = 1.96 / np.sqrt(2.0 * sum(r.size for r in found.residuals))
    for each in (-bound, bound):
        axes[1].axhline(each, color=style.MUTED, linewidth=1.0, linestyle=(0, (4, 3)))
    # a few lines far off must not hide the others
    reach = 1.15 * float(np.percentile(np.abs(np.concatenate(found.residuals)), 99.0)) / max(found.spread, 1e-300)
    axes[0].set_ylim(-max(reach, 3.0), max(reach, 3.0))
    style.labels(axes[0], "frequency (Hz)", "residual (deviations)")
    style.labels(axes[1], "lines apart", "autocorrelation")
    _frequency(axes[0], found)
    style.frequency_grid(axes[:1])
    style.legend(figure, axes[0], 4)
    return figure


def response_nyquist(found: Agreement) -> Any:
    """Responses in the complex plane, as velocity over force: each mode is a circle; dots measured, curves the model.

    Velocity, since the rigid motion hides the circles of the position.
    """
    figure, (ax,) = style.picture(1, height=4.6)
    figure.set_size_inches(5.4, 4.6)
    ax.set_aspect("equal", adjustable="datalim")
    ax.axhline(0.0, color=style.MUTED, linewidth=0.8)
    ax.axvline(0.0, color=style.MUTED, linewidth=0.8)
    order, unit = 1 - found.order, found.measured[0].unit
    for i, (measured, model) in enumerate(zip(found.measured, found.drawn, strict=True)):
        name = measured.output if len(found.measured) > 1 else ""
        points, curve = (each.response * (2j * np.pi * each.frequency) ** order for each in (measured, model))
        dots = {"color": style.color(i), "linestyle": "none", "marker": "o", "markersize": 4.0, "zorder": 3.0}
        ax.plot(np.real(points), np.imag(points), label=style.caption(name, "measured"), **dots)
        ax.plot(np.real(curve), np.imag(curve), label=style.caption(name, "fitted"), **style.curve(i))
    said = f" ({_velocity(unit)})" if unit else ""
    ax.locator_params(nbins=5)
    ax.ticklabel_format(scilimits=(-3, 3))
    style.labels(ax, f"real part{said}", f"imaginary part{said}")
    style.legend(figure, ax, 2)
    return figure


def _velocity(unit: str) -> str:
    """A unit of position over force as one of velocity: m/N -> (m/s)/N."""
    above, _, below = unit.partition("/")
    return f"({above}/s)/{below}" if below and "(" not in unit else "velocity over force"


def _frequency(ax: Any, found: Agreement) -> None:
    lines = [m.frequency for m in found.measured]
    style.frequency_axis(ax, float(min(f[0] for f in lines)), float(max(f[-1] for f in lines)))


def fitted(found: PlantFit | ModalFit) -> Any:
    """Measured and fitted response."""
    return response_fit(found.agreement)


def axis_fits(found: AxisFits) -> Any:
    """Measured response and the chosen fit."""
    return response_fit(found.fit.agreement)
