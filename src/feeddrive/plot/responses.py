"""Pictures of measured responses over frequency: with their errors, with a fitted model, and of their excitation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from feeddrive.language.quantity import DRAWN, Units, unit_name
from feeddrive.plot import style
from feeddrive.plot.chart import DEGREES, DOTS, FREQUENCY, LINEAR, LOG, THIN, Band, Chart, Curve, Panel
from feeddrive.plot.drawing import drawn
from feeddrive.plot.style import envelope
from feeddrive.plot.uncertainty import coherence_panels, doubtful, magnitude_band, phase_band

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
    """Magnitude with the 95 % band, noise and distortion; phase with its band; coherence. `model` is a line."""
    return drawn(estimates_chart([found], model=model))


def estimates_chart(found: Sequence[FrequencyEstimate], units: Units = DRAWN, model: FRF | None = None) -> Chart:
    """Responses that were estimated, those in the unit of the first: each in its 95 % band, with its coherence.

    Of one alone the levels of noise and distortion too.  The radius counts that the variance itself is estimated
    (`FrequencyEstimate.radius`).
    """
    alike = [each for each in found if each.frf.unit == found[0].frf.unit]
    rows = list[Overlay]()
    for each in alike:
        frf = each.frf
        if frf.radius is not None and frf.variance is not None:
            with np.errstate(all="ignore"):
                wider = np.where(frf.radius > 0.0, each.radius() / frf.radius, 1.0)
            frf = replace(frf, variance=frf.variance * wider**2)
        rows.append(Overlay(frf.output.replace("_", " ") if len(alike) > 1 else "", frf, None, model))
    return overlay_chart(rows, units, _levels(alike[0], units) if len(alike) == 1 else ())


def _levels(found: FrequencyEstimate, units: Units) -> list[Curve]:
    """Noise and distortion over frequency, as far as the excitation shows them."""
    factor, curves = _magnitudes(found.frf.unit, units)[0], list[Curve]()
    for i, (name, text) in enumerate(_LEVELS.items(), start=2):
        level = found.levels.get(name)
        if level is None or not np.any(there := np.isfinite(level.response) & (level.response > 0.0)):
            continue
        y = np.asarray(units.from_decibel(style.decibel(factor * level.response[there])))
        curves.append(Curve(units.of("Hz")[1] * level.frequency[there], y, text, i, DOTS))
    return curves


def _beside(phase: np.ndarray, frequency: np.ndarray, frf: FRF) -> np.ndarray:
    """A phase in degrees over a frequency in Hz, shifted by whole turns next to that of a response."""
    at = float(np.interp(frf.frequency[0], frequency, phase))
    return phase + 360.0 * round((float(frf.phase_deg[0]) - at) / 360.0)


def excitation(found: Excitation) -> Any:
    """The excitation of the first realization, and the simulated speed and force, over time."""
    drawn = found.drawings[0]
    figure, axes = style.picture(3, height=5.2)
    unit, factor = ("N", 1.0) if found.where == "force" else ("um", 1e6)
    rows = (
        (factor * drawn.excitation, f"excitation ({unit_name(unit)})"),
        (1e3 * drawn.signals["velocity_load"], f"speed ({unit_name('m/s')})"),
        (drawn.signals["force"], f"force ({unit_name('N')})"),
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


class Overlay(NamedTuple):
    """A response: as measured, by the model on the same lines, and the model as a curve; what there is not is None."""

    name: str
    measured: FRF | None
    fitted: FRF | None
    drawn: FRF | None


def response_fit(found: Agreement) -> Any:
    """Magnitude and phase: the measurement as dots, the model as a line, each in its 95 % band; distance; coherence.

    The distance is |model/measured - 1| in dB; the thin line is the radius of the 95 % disc of the measurement.
    """
    return drawn(response_fit_chart(found))


def response_fit_chart(found: Agreement, units: Units = DRAWN) -> Chart:
    """What `response_fit` shows."""
    rows = zip(found.measured, found.fitted, found.drawn, strict=True)
    several = len(found.measured) > 1
    return overlay_chart([Overlay(each.output if several else "", each, *model) for each, *model in rows], units)


def overlay_chart(rows: Sequence[Overlay], units: Units = DRAWN, more: Sequence[Curve] = ()) -> Chart:
    """Measured responses and those of a model over each other: magnitude, phase, distance, and coherence.

    more  curves beside the magnitudes, as shown
    """
    known = [each for row in rows for each in (row.drawn, row.measured) if each is not None]
    factor, label = _magnitudes(known[0].unit, units)
    hertz, log = units.of("Hz")[1], not units.decibel
    coherent = [(i, row.measured) for i, row in enumerate(rows) if row.measured is not None]
    levels, phases, apart = list[Curve](), list[Curve](), list[Curve]()
    shaded = doubtful((each for _, each in coherent), units, ratio=log)
    bands = list(shaded), list(doubtful((each for _, each in coherent), units))
    ends = list[float]()
    for i, (name, measured, fitted, curve) in enumerate(rows):
        phase = None if curve is None else curve.phase_deg
        before = f"{name}, " if name else ""
        if measured is not None:
            beside = measured.phase_deg if curve is None else _by_model(measured, fitted, curve)
            x = hertz * measured.frequency
            level = units.from_decibel(style.decibel(factor * measured.magnitude))
            levels.append(Curve(x, np.asarray(level), f"{before}measured", i, DOTS))
            phases.append(Curve(x, beside, number=i, look=DOTS))
            ends += [float(np.min(beside)), float(np.max(beside))]
            bands[0].extend(
                magnitude_band(measured, i, units, "95 % of the measurement" if i == 0 else "", factor=factor)
            )
            bands[1].extend(phase_band(measured, beside, i, units))
            if fitted is not None:
                off = style.decibel(np.abs(fitted.response / measured.response - 1.0))
                apart.append(Curve(x, np.asarray(units.from_decibel(off)), number=i, look=DOTS))
            if fitted is not None and measured.radius is not None:
                level = style.decibel(measured.radius / measured.magnitude)
                apart.append(Curve(x, np.asarray(units.from_decibel(level)), number=i, look=THIN))
        if curve is not None and phase is not None:
            level = units.from_decibel(style.decibel(factor * curve.magnitude))
            levels.append(Curve(hertz * curve.frequency, np.asarray(level), f"{before}model", i))
            phases.append(Curve(hertz * curve.frequency, phase, number=i))
            ends += [float(np.min(phase)), float(np.max(phase))]
            name = "" if i else "95 % of the model"
            bands[0].extend(magnitude_band(curve, _OTHER, units, name, factor=factor, model=True))
            bands[1].extend(phase_band(curve, phase, _OTHER, units, model=True))
    scale = LOG if log else LINEAR
    panels = [
        _gains(label, [*levels, *more], bands[0], scale, 3.0),
        Panel("phase (deg)", tuple(phases), bands=tuple(bands[1]), scale=DEGREES, low=min(ends), high=max(ends),
              share=2.0),
    ]  # fmt: skip
    if apart:
        label = "error (part of it)" if log else "error (dB)"
        panels.append(_gains(label, apart, shaded, scale, 1.4))
    panels += coherence_panels(coherent, units)
    x = [hertz * float(each.frequency[k]) for each in known for k in (0, -1)]
    return Chart(
        f"frequency ({unit_name('Hz')})", tuple(panels), FREQUENCY, min(x), max(x), height=2.6 + 1.05 * len(panels),
        columns=2, factor=hertz,
    )  # fmt: skip


_ROOM = 1.3  # a factor above and below the gains of a panel
_OTHER = 4  # number of the band of a model, to be told from that of the measurement


def _by_model(measured: FRF, fitted: FRF | None, curve: FRF) -> np.ndarray:
    """The phase of a measurement in degrees, in the turn of its model on each line."""
    if fitted is None:
        return _beside(measured.phase_deg, measured.frequency, curve)
    on_lines = np.degrees(np.angle(fitted.response))
    on_lines += 360.0 * np.round((np.interp(measured.frequency, curve.frequency, curve.phase_deg) - on_lines) / 360.0)
    return on_lines + np.degrees(np.angle(measured.response / fitted.response))


def _magnitudes(unit: str, units: Units) -> tuple[float, str]:
    """Factor to what is shown of a response of this unit, and the label of its magnitude."""
    if units.decibel:
        return 1.0, f"magnitude (dB re 1 {unit_name(unit, 'SI')})" if unit else "magnitude (dB)"
    return units.of(unit)[1], f"magnitude ({unit_name(unit)})" if unit else "magnitude"


def _gains(label: str, curves: Sequence[Curve], bands: Sequence[Band], scale: str, share: float) -> Panel:
    """A panel whose range is that of its curves with some room: what is shaded over its height widens nothing."""
    values = np.concatenate([each.y for each in curves])
    values = values[np.isfinite(values) & ((values > 0.0) | (scale != LOG))]
    low, high = float(np.min(values)), float(np.max(values))
    low, high = (low / _ROOM, high * _ROOM) if scale == LOG else style.padded(low, high)
    return Panel(label, tuple(curves), bands=tuple(bands), scale=scale, share=share, low=low, high=high)


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
    said = f" ({unit_name(_velocity(unit), 'SI')})" if unit else ""
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
