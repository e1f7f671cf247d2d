"""Pictures of measured frequency responses with their uncertainty."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from feeddrive.language.quantity import DRAWN, Quantity, Units, unit_name
from feeddrive.language.text import Text
from feeddrive.loop.frequency_response import FRF, TRUSTED
from feeddrive.plot import style
from feeddrive.plot.chart import (
    CROSS,
    DEGREES,
    DOTS,
    FREQUENCY,
    LINEAR,
    LOG,
    MARKERS,
    THIN,
    Abscissa,
    Band,
    Chart,
    Curve,
    Level,
    Panel,
    rods,
)
from feeddrive.plot.drawing import figure_of
from feeddrive.plot.style import envelope

if TYPE_CHECKING:
    from feeddrive.identification.excitation.excitation import Excitation
    from feeddrive.identification.excitation.frequency_estimate import FrequencyEstimate
    from feeddrive.identification.response.agreement import Agreement
    from feeddrive.identification.response.fit_axis import AxisFits
    from feeddrive.identification.response.modal_fit import ModalFit
    from feeddrive.identification.response.plant_fit import PlantFit


_LEAST = 0.1  # of a magnitude: lower end of its band
# Infinity would be no coordinate for a drawing; as a ratio it becomes 10^±10
_FAR = 1e4  # dB or degrees beyond all panels


def magnitude_band(
    frf: FRF, number: int, units: Units = DRAWN, name: str = "", *, factor: float = 1.0, model: bool = False
) -> tuple[Band, ...]:
    """Return the band from |G| - r to |G| + r, with r the radius of the 95 % disc; empty without a variance.

    factor  from the unit of the response to the displayed unit
    model   True if the error comes from a few real parameters and may be one-directional: r is then 1.96 √variance
    """
    radius = _radius(frf, model)
    if radius is None:
        return ()
    size = frf.magnitude
    low, high = (style.decibel(factor * edge) for edge in (np.maximum(size - radius, _LEAST * size), size + radius))
    return (_band(frf, units.from_decibel(low), units.from_decibel(high), number, units, name),)


def _radius(frf: FRF, model: bool) -> np.ndarray | None:
    if not model or frf.variance is None:
        return frf.radius
    from feeddrive.identification.regression import NORMAL

    return NORMAL * np.sqrt(frf.variance)


def phase_band(
    frf: FRF, phase: np.ndarray, number: int, units: Units = DRAWN, *, model: bool = False
) -> tuple[Band, ...]:
    """Return the band ± arcsin(r/|G|) around a phase in degrees, r as in `magnitude_band`; empty without a variance."""
    radius = _radius(frf, model)
    if radius is None:
        return ()
    spread = np.degrees(np.arcsin(np.minimum(radius / frf.magnitude, 1.0)))
    return (_band(frf, phase - spread, phase + spread, number, units),)


def _band(frf: FRF, low: object, high: object, number: int, units: Units, name: str = "") -> Band:
    return Band(units.of("Hz")[1] * frf.frequency, np.asarray(low), np.asarray(high), number, name)


def doubtful(
    responses: Iterable[FRF], units: Units = DRAWN, *, ratio: bool = False, name: str = ""
) -> tuple[Band, ...]:
    """Return shading over the whole height of a panel where a coherence is 0.9 or less.

    ratio  True if the panel has a logarithmic scale, such as that of gains not in dB
    """
    parts = list[tuple[float, float]]()
    for low, high in sorted(stretch for frf in responses for stretch in _stretches(frf)):
        if parts and low <= parts[-1][1]:  # overlaps are shaded once
            low, high = parts[-1][0], max(high, parts.pop()[1])
        parts.append((low, high))
    if not parts:
        return ()
    x = units.of("Hz")[1] * np.concatenate([[low, high, np.nan] for low, high in parts])
    low, high = (10.0 ** (-_FAR / 1e3), 10.0 ** (_FAR / 1e3)) if ratio else (-_FAR, _FAR)
    gap = np.isnan(x)
    return (Band(x, np.where(gap, np.nan, low), np.where(gap, np.nan, high), name=name),)


def _stretches(frf: FRF) -> list[tuple[float, float]]:
    """Return the first and last frequency in Hz of each interval of untrusted lines, extended halfway to the next
    line.
    """
    if frf.coherence is None:
        return []
    low = frf.coherence <= TRUSTED
    edges = np.sqrt(frf.frequency[1:] * frf.frequency[:-1])
    edges = np.concatenate([frf.frequency[:1], edges, frf.frequency[-1:]])
    begins = np.flatnonzero(low & ~np.append(False, low[:-1]))
    ends = np.flatnonzero(low & ~np.append(low[1:], False))
    return [(float(edges[a]), float(edges[b + 1])) for a, b in zip(begins, ends, strict=True)]


def coherence_panels(responses: Iterable[tuple[int, FRF]], units: Units = DRAWN) -> tuple[Panel, ...]:
    """Return a panel with the coherences and the lowest one that a tuning accepts; empty without a coherence."""
    with_coherence = [(i, frf) for i, frf in responses if frf.coherence is not None]
    if not with_coherence:
        return ()
    curves = tuple(
        Curve(units.of("Hz")[1] * frf.frequency, np.asarray(frf.coherence), number=i) for i, frf in with_coherence
    )
    level = Level(TRUSTED, dashed=True)
    shaded = doubtful((frf for _, frf in with_coherence), units, name=Text(f"coherence {Quantity(TRUSTED)} or less"))
    return (Panel("coherence", curves, levels=(level,), bands=shaded, low=0.0, high=1.05),)


_LEVELS = {"noise": "noise", "nonlinear": "scatter beyond noise", "odd": "odd distortion", "even": "even distortion"}


def frequency_estimate_chart(estimate: FrequencyEstimate, model: FRF | None = None) -> Chart:
    """Plot magnitude with the 95 % band, noise and distortion, phase with its band, and coherence; `model` is a
    line.
    """
    return estimates_chart([estimate], model=model)


frequency_estimate = figure_of(frequency_estimate_chart)


def estimates_chart(estimates: Sequence[FrequencyEstimate], units: Units = DRAWN, model: FRF | None = None) -> Chart:
    """Plot estimated responses with their 95 % bands and coherences, without those in a unit other than the first
    one's.

    A single response is shown with its noise and distortion levels. The radius includes the uncertainty of the
    estimated variance (`FrequencyEstimate.radius`).
    """
    alike = [estimate for estimate in estimates if estimate.frf.unit == estimates[0].frf.unit]
    rows = list[Overlay]()
    for estimate in alike:
        frf = estimate.frf
        if frf.radius is not None and frf.variance is not None:
            with np.errstate(all="ignore"):
                wider = np.where(frf.radius > 0.0, estimate.radius() / frf.radius, 1.0)
            frf = replace(frf, variance=frf.variance * wider**2)
        rows.append(Overlay(frf.output.replace("_", " ") if len(alike) > 1 else "", frf, None, model))
    return overlay_chart(rows, units, _levels(alike[0], units) if len(alike) == 1 else ())


def _levels(estimate: FrequencyEstimate, units: Units) -> list[Curve]:
    """Return noise and distortion levels versus frequency, as far as the excitation reveals them."""
    factor, curves = _magnitudes(estimate.frf.unit, units)[0], list[Curve]()
    for i, (name, text) in enumerate(_LEVELS.items(), start=2):
        level = estimate.levels.get(name)
        if level is None or not np.any(there := np.isfinite(level.response) & (level.response > 0.0)):
            continue
        y = np.asarray(units.from_decibel(style.decibel(factor * level.response[there])))
        curves.append(Curve(units.of("Hz")[1] * level.frequency[there], y, text, i, DOTS))
    return curves


def _beside(phase: np.ndarray, frequency: np.ndarray, frf: FRF) -> np.ndarray:
    """Shift a phase (degrees, over Hz) by whole turns to be closest to that of a response."""
    at = float(np.interp(frf.frequency[0], frequency, phase))
    return phase + 360.0 * round((float(frf.phase_deg[0]) - at) / 360.0)


def excitation_chart(excitation: Excitation) -> Chart:
    """Plot the excitation of the first realization, and the simulated speed and force, versus time."""
    first = excitation.drawings[0]
    unit, factor = ("N", 1.0) if excitation.where == "force" else ("um", 1e6)
    rows = (
        (factor * first.excitation, f"excitation ({unit_name(unit)})"),
        (1e3 * first.signals["velocity_load"], f"speed ({unit_name('m/s')})"),
        (first.signals["force"], f"force ({unit_name('N')})"),
    )
    edges = (excitation.first, excitation.first + excitation.periods * excitation.period)
    levels = tuple(Level(edge * excitation.sample_time, upright=True, dashed=True) for edge in edges)
    panels = [Panel(text, (Curve(*envelope(first.time, values), size=0.5),), levels=levels) for values, text in rows]
    panels[0] = replace(panels[0], caption=f"between the dashed lines: {excitation.periods} whole periods")
    return Chart("time (s)", tuple(panels), height=5.2)


excitation = figure_of(excitation_chart)


class Overlay(NamedTuple):
    """A measured response, its model on the measured lines, and its model as a curve; None if absent."""

    name: str
    measured: FRF | None
    fitted: FRF | None
    drawn: FRF | None


def response_fit_chart(agreement: Agreement, units: Units = DRAWN) -> Chart:
    """Plot magnitude and phase with the measurement as dots and the model as a line, both in 95 % bands; distance;
    coherence.

    The distance is |model/measured - 1| in dB; the thin line is the radius of the measurement's 95 % disc.
    """
    rows = zip(agreement.measured, agreement.fitted, agreement.drawn, strict=True)
    several = len(agreement.measured) > 1
    return overlay_chart(
        [Overlay(measured.output if several else "", measured, *model) for measured, *model in rows], units
    )


response_fit = figure_of(response_fit_chart)


def overlay_chart(rows: Sequence[Overlay], units: Units = DRAWN, more: Sequence[Curve] = ()) -> Chart:
    """Plot measured and modelled responses together: magnitude, phase, distance, and coherence.

    more  additional curves in the magnitude panel, in displayed units
    """
    drawn = [frf for row in rows for frf in (row.drawn, row.measured) if frf is not None]
    factor, label = _magnitudes(drawn[0].unit, units)
    hertz, log = units.of("Hz")[1], not units.decibel
    coherent = [(i, row.measured) for i, row in enumerate(rows) if row.measured is not None]
    levels, phases, apart = list[Curve](), list[Curve](), list[Curve]()
    shaded = doubtful((frf for _, frf in coherent), units, ratio=log)
    bands = list(shaded), list(doubtful((frf for _, frf in coherent), units))
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
        Panel(
            "phase (deg)", tuple(phases), bands=tuple(bands[1]), scale=DEGREES, low=min(ends), high=max(ends), share=2.0
        ),
    ]
    if apart:
        label = "error (part of it)" if log else "error (dB)"
        panels.append(_gains(label, apart, shaded, scale, 1.4))
    panels += coherence_panels(coherent, units)
    x = [hertz * float(frf.frequency[k]) for frf in drawn for k in (0, -1)]
    return Chart(
        f"frequency ({unit_name('Hz')})",
        tuple(panels),
        FREQUENCY,
        min(x),
        max(x),
        height=2.6 + 1.05 * len(panels),
        columns=2,
        factor=hertz,
    )


_ROOM = 1.3  # margin of a gain panel as a factor, above and below
_OTHER = 4  # number of the band of a model, different from that of the measurement


def _by_model(measured: FRF, fitted: FRF | None, curve: FRF) -> np.ndarray:
    """Return the phase of a measurement in degrees, in the same turn as its model on each line."""
    if fitted is None:
        return _beside(measured.phase_deg, measured.frequency, curve)
    # noise slips by whole turns when it is unwrapped by itself: the model tells the turn on each line
    on_lines = np.degrees(np.angle(fitted.response))
    on_lines += 360.0 * np.round((np.interp(measured.frequency, curve.frequency, curve.phase_deg) - on_lines) / 360.0)
    return on_lines + np.degrees(np.angle(measured.response / fitted.response))


def _magnitudes(unit: str, units: Units) -> tuple[float, str]:
    """Return the factor to the displayed unit of a response, and the label of its magnitude."""
    if units.decibel:
        return 1.0, f"magnitude (dB re 1 {unit_name(unit, 'SI')})" if unit else "magnitude (dB)"
    return units.of(unit)[1], f"magnitude ({unit_name(unit)})" if unit else "magnitude"


def _gains(label: str, curves: Sequence[Curve], bands: Sequence[Band], scale: str, share: float) -> Panel:
    """Return a panel whose range follows from its curves only: shading over the full height does not widen it."""
    values = np.concatenate([curve.y for curve in curves])
    values = values[np.isfinite(values) & ((values > 0.0) | (scale != LOG))]
    low, high = float(np.min(values)), float(np.max(values))
    low, high = (low / _ROOM, high * _ROOM) if scale == LOG else style.padded(low, high)
    return Panel(label, tuple(curves), bands=tuple(bands), scale=scale, share=share, low=low, high=high)


def response_residuals_chart(agreement: Agreement) -> Chart:
    """Plot weighted residuals versus frequency, real and imaginary part, and their autocorrelation across lines."""
    lags = np.arange(1, max(2, min(40, min(r.size for r in agreement.residuals) // 4)))
    spread, curves = max(agreement.spread, 1e-300), list[Curve]()
    for i, (measured, residual) in enumerate(zip(agreement.measured, agreement.residuals, strict=True)):
        name = measured.output if len(agreement.measured) > 1 else ""
        f, scaled = measured.frequency, residual / spread
        curves.append(Curve(f, np.real(scaled), name, i, MARKERS, "real", size=0.45))
        curves.append(Curve(f, np.imag(scaled), name, i, CROSS, "imaginary", size=0.45))
    # outliers must not compress the other lines
    reach = 1.15 * float(np.percentile(np.abs(np.concatenate(agreement.residuals)), 99.0)) / spread
    reach = max(reach, 3.0)
    ends = [float(measured.frequency[k]) for measured in agreement.measured for k in (0, -1)]
    across = np.array([agreement.autocorrelation(int(lag)) for lag in lags])
    # a complex residual counts as two real ones
    bound = 1.96 / np.sqrt(2.0 * sum(residual.size for residual in agreement.residuals))
    panels = (
        Panel(
            "residual (deviations)",
            tuple(curves),
            low=-reach,
            high=reach,
            share=2.0,
            abscissa=Abscissa("frequency (Hz)", FREQUENCY, min(ends), max(ends)),
        ),
        Panel(
            "autocorrelation",
            (Curve(*rods(lags.astype(float), 0.0, across)),),
            levels=(Level(-bound, dashed=True), Level(bound, dashed=True)),
            abscissa=Abscissa("lines apart", low=0.0, high=float(lags[-1]) + 1.0),
        ),
    )
    return Chart("", panels, height=4.4)


response_residuals = figure_of(response_residuals_chart)


def response_nyquist_chart(agreement: Agreement) -> Chart:
    """Plot the responses from force to velocity in the complex plane: each mode is a circle; dots measured, curves the
    model.

    Velocity is used because rigid-body motion hides the circles in the position response.
    """
    order, unit = 1 - agreement.order, agreement.measured[0].unit
    curves, dots = list[Curve](), list[Curve]()
    for i, (measured, model) in enumerate(zip(agreement.measured, agreement.drawn, strict=True)):
        name = measured.output if len(agreement.measured) > 1 else ""
        points, curve = (frf.response * (2j * np.pi * frf.frequency) ** order for frf in (measured, model))
        dots.append(Curve(np.real(points), np.imag(points), name, i, MARKERS, "measured", size=0.9))
        curves.append(Curve(np.real(curve), np.imag(curve), name, i, caption="fitted"))
    unit_text = f" ({unit_name(_velocity(unit), 'SI')})" if unit else ""
    axes = Level(0.0, faint=True), Level(0.0, upright=True, faint=True)
    panel = Panel(f"imaginary part{unit_text}", (*curves, *dots), levels=axes)
    return Chart(f"real part{unit_text}", (panel,), square=True, height=4.6, width=5.4, columns=2)


response_nyquist = figure_of(response_nyquist_chart)


def _velocity(unit: str) -> str:
    """Convert a unit of position per force to one of velocity per force: m/N -> (m/s)/N."""
    above, _, below = unit.partition("/")
    return f"({above}/s)/{below}" if below and "(" not in unit else "velocity over force"


def fitted_chart(fit: PlantFit | ModalFit) -> Chart:
    """Plot measured and fitted responses."""
    return response_fit_chart(fit.agreement)


def axis_fits_chart(fits: AxisFits) -> Chart:
    """Plot the measured response and the chosen fit."""
    return response_fit_chart(fits.fit.agreement)
