"""Frequency-domain plots: measured responses with uncertainty, Bode plots, margins, sensitivity, stiffness."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from feeddrive.analysis.margins import Margins, complementary_sensitivity, tracking_bandwidth
from feeddrive.analysis.margins import sensitivity as sensitivity_of
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import DRAWN, USUAL, Quantity, Units, signal_unit, unit_name
from feeddrive.language.text import Text, joined
from feeddrive.loop.frequency_response import FRF, TRUSTED
from feeddrive.plot import chart, style
from feeddrive.plot.chart import Abscissa, Band, Chart, Curve, Level, Mark, Panel
from feeddrive.plot.drawing import figure_of
from feeddrive.plot.style import envelope

if TYPE_CHECKING:
    from collections.abc import Mapping

    from feeddrive.analysis.margins import MarginIntervals
    from feeddrive.analysis.measured_loop import MeasuredLoop
    from feeddrive.analysis.spectrum import Spectrum
    from feeddrive.analysis.stiffness import Stiffness
    from feeddrive.identification.excitation.excitation import Excitation
    from feeddrive.identification.excitation.frequency_estimate import FrequencyEstimate
    from feeddrive.identification.response.agreement import Agreement
    from feeddrive.identification.response.modal_fit import ModalFit
    from feeddrive.identification.response.plant_fit import AxisFits, PlantFit
    from feeddrive.tuning.recipes import Recipe
    from feeddrive.tuning.tune import CascadeLoops, Tuned


# Lower end of a magnitude band as a share of the magnitude: at or below 0 it would have no level in dB.
_LEAST = 0.1
# Infinity is no coordinate that can be drawn; as a ratio this becomes 10^±10
_FAR = 1e4  # dB or degrees beyond all panels


def magnitude_band(
    frf: FRF, number: int, units: Units = DRAWN, name: str = "", *, factor: float = 1.0, model: bool = False
) -> tuple[Band, ...]:
    """Return the band from |G| - r to |G| + r, with r the radius of the 95 % disc; empty if there is no variance.

    factor  conversion factor from the unit of the response to the displayed unit
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
    """Return the band ± arcsin(r/|G|) around a phase in degrees, r as in `magnitude_band`; empty if there is no
    variance.
    """
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
    """Return shading over the full height of a panel where the coherence of a response is 0.9 or less.

    ratio  True if the panel has a logarithmic scale, such as that of gains not in dB
    """
    parts = list[tuple[float, float]]()
    for low, high in sorted(stretch for frf in responses for stretch in _stretches(frf)):
        # Overlaps are shaded once: two pale areas would look like twice the doubt.
        if parts and low <= parts[-1][1]:
            low, high = parts[-1][0], max(high, parts.pop()[1])
        parts.append((low, high))
    if not parts:
        return ()
    x = units.of("Hz")[1] * np.concatenate([[low, high, np.nan] for low, high in parts])
    low, high = (10.0 ** (-_FAR / 1e3), 10.0 ** (_FAR / 1e3)) if ratio else (-_FAR, _FAR)
    gap = np.isnan(x)
    return (Band(x, np.where(gap, np.nan, low), np.where(gap, np.nan, high), name=name),)


def _stretches(frf: FRF) -> list[tuple[float, float]]:
    """Return the first and last frequency in Hz of each interval of frequency lines with low coherence, extended
    halfway to the next line.
    """
    if frf.coherence is None:
        return []
    low = frf.coherence <= TRUSTED
    # Halfway on a logarithmic axis.
    edges = np.sqrt(frf.frequency[1:] * frf.frequency[:-1])
    edges = np.concatenate([frf.frequency[:1], edges, frf.frequency[-1:]])
    begins = np.flatnonzero(low & ~np.append(False, low[:-1]))
    ends = np.flatnonzero(low & ~np.append(low[1:], False))
    return [(float(edges[a]), float(edges[b + 1])) for a, b in zip(begins, ends, strict=True)]


def coherence_panels(responses: Iterable[tuple[int, FRF]], units: Units = DRAWN) -> tuple[Panel, ...]:
    """Return a panel with the coherences and the lowest value that a tuning accepts; empty if there is no coherence."""
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
    """Plot the magnitude and phase with 95 % bands, noise and distortion, and coherence; `model` is drawn as a line."""
    return estimates_chart([estimate], model=model)


frequency_estimate = figure_of(frequency_estimate_chart)


def estimates_chart(estimates: Sequence[FrequencyEstimate], units: Units = DRAWN, model: FRF | None = None) -> Chart:
    """Plot estimated responses with their 95 % bands and coherences, omitting responses whose unit differs from that of
    the first.

    A single response is shown with its noise and distortion levels. The width of a band includes the uncertainty of the
    estimated variance (`FrequencyEstimate.radius`).
    """
    alike = [estimate for estimate in estimates if estimate.frf.unit == estimates[0].frf.unit]
    rows = list[Overlay]()
    for estimate in alike:
        frf = estimate.frf
        if frf.radius is not None and frf.variance is not None:
            # A line without variance has a radius of 0, and `where` computes its quotient as well.
            with np.errstate(all="ignore"):
                wider = np.where(frf.radius > 0.0, estimate.radius() / frf.radius, 1.0)
            frf = replace(frf, variance=frf.variance * wider**2)
        rows.append(Overlay(frf.output.replace("_", " ") if len(alike) > 1 else "", frf, None, model))
    return overlay_chart(rows, units, _levels(alike[0], units) if len(alike) == 1 else ())


def _levels(estimate: FrequencyEstimate, units: Units) -> list[Curve]:
    """Return the noise and distortion levels that can be estimated from the excitation, versus frequency."""
    factor, curves = _magnitudes(estimate.frf.unit, units)[0], list[Curve]()
    for i, (name, text) in enumerate(_LEVELS.items(), start=2):
        level = estimate.levels.get(name)
        if level is None or not np.any(there := np.isfinite(level.response) & (level.response > 0.0)):
            continue
        y = np.asarray(units.from_decibel(style.decibel(factor * level.response[there])))
        curves.append(Curve(units.of("Hz")[1] * level.frequency[there], y, text, i, chart.DOTS))
    return curves


def _beside(phase: np.ndarray, frequency: np.ndarray, frf: FRF) -> np.ndarray:
    """Shift a phase in degrees by whole turns so that it is closest to the phase of a response at the first line of the
    response.
    """
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
    """A measured response, its model on the measured frequency lines, and its model as a curve; None if absent."""

    name: str
    measured: FRF | None
    fitted: FRF | None
    drawn: FRF | None


def response_fit_chart(agreement: Agreement, units: Units = DRAWN) -> Chart:
    """Plot the magnitude, phase, distance and coherence, with the measurement as dots and the model as a line, both
    with 95 % bands.

    The distance is |model/measured - 1| in dB; the thin line is the radius of the measurement's 95 % disc.
    """
    rows = zip(agreement.measured, agreement.fitted, agreement.drawn, strict=True)
    several = len(agreement.measured) > 1
    return overlay_chart(
        [Overlay(measured.output if several else "", measured, *model) for measured, *model in rows], units
    )


response_fit = figure_of(response_fit_chart)


def overlay_chart(rows: Sequence[Overlay], units: Units = DRAWN, more: Sequence[Curve] = ()) -> Chart:
    """Plot the measured and modelled responses together: magnitude, phase, distance, and coherence.

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
            levels.append(Curve(x, np.asarray(level), f"{before}measured", i, chart.DOTS))
            phases.append(Curve(x, beside, number=i, look=chart.DOTS))
            ends += [float(np.min(beside)), float(np.max(beside))]
            bands[0].extend(
                magnitude_band(measured, i, units, "95 % of the measurement" if i == 0 else "", factor=factor)
            )
            bands[1].extend(phase_band(measured, beside, i, units))
            if fitted is not None:
                off = style.decibel(np.abs(fitted.response / measured.response - 1.0))
                apart.append(Curve(x, np.asarray(units.from_decibel(off)), number=i, look=chart.DOTS))
            if fitted is not None and measured.radius is not None:
                level = style.decibel(measured.radius / measured.magnitude)
                apart.append(Curve(x, np.asarray(units.from_decibel(level)), number=i, look=chart.THIN))
        if curve is not None and phase is not None:
            level = units.from_decibel(style.decibel(factor * curve.magnitude))
            levels.append(Curve(hertz * curve.frequency, np.asarray(level), f"{before}model", i))
            phases.append(Curve(hertz * curve.frequency, phase, number=i))
            ends += [float(np.min(phase)), float(np.max(phase))]
            name = "" if i else "95 % of the model"
            bands[0].extend(magnitude_band(curve, _OTHER, units, name, factor=factor, model=True))
            bands[1].extend(phase_band(curve, phase, _OTHER, units, model=True))
    scale = chart.LOG if log else chart.LINEAR
    panels = [
        _gains(label, [*levels, *more], bands[0], scale, 3.0),
        Panel(
            "phase (deg)",
            tuple(phases),
            bands=tuple(bands[1]),
            scale=chart.DEGREES,
            low=min(ends),
            high=max(ends),
            share=2.0,
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
        chart.FREQUENCY,
        min(x),
        max(x),
        height=2.6 + 1.05 * len(panels),
        columns=2,
        factor=hertz,
    )


_ROOM = 1.3  # margin of a gain panel as a factor, above and below
_OTHER = 4  # number of the band of a model, different from that of the measurement


def _by_model(measured: FRF, fitted: FRF | None, curve: FRF) -> np.ndarray:
    """Return the phase of a measurement in degrees, shifted by whole turns to be closest to that of its model at each
    line.
    """
    if fitted is None:
        return _beside(measured.phase_deg, measured.frequency, curve)
    # noise slips by whole turns when it is unwrapped alone: the model gives the turn on each line
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
    values = values[np.isfinite(values) & ((values > 0.0) | (scale != chart.LOG))]
    low, high = float(np.min(values)), float(np.max(values))
    low, high = (low / _ROOM, high * _ROOM) if scale == chart.LOG else style.padded(low, high)
    return Panel(label, tuple(curves), bands=tuple(bands), scale=scale, share=share, low=low, high=high)


def response_residuals_chart(agreement: Agreement) -> Chart:
    """Plot weighted residuals versus frequency, real and imaginary part, and their autocorrelation across lines."""
    lags = np.arange(1, max(2, min(40, min(r.size for r in agreement.residuals) // 4)))
    # A fit to data of its own model may leave no residual to scale with.
    spread, curves = max(agreement.spread, 1e-300), list[Curve]()
    for i, (measured, residual) in enumerate(zip(agreement.measured, agreement.residuals, strict=True)):
        name = measured.output if len(agreement.measured) > 1 else ""
        f, scaled = measured.frequency, residual / spread
        curves.append(Curve(f, np.real(scaled), name, i, chart.MARKERS, "real", size=0.45))
        curves.append(Curve(f, np.imag(scaled), name, i, chart.CROSS, "imaginary", size=0.45))
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
            abscissa=Abscissa("frequency (Hz)", chart.FREQUENCY, min(ends), max(ends)),
        ),
        Panel(
            "autocorrelation",
            (Curve(*chart.rods(lags.astype(float), 0.0, across)),),
            levels=(Level(-bound, dashed=True), Level(bound, dashed=True)),
            abscissa=Abscissa("lines apart", low=0.0, high=float(lags[-1]) + 1.0),
        ),
    )
    return Chart("", panels, height=4.4)


response_residuals = figure_of(response_residuals_chart)


def response_nyquist_chart(agreement: Agreement) -> Chart:
    """Plot the responses from force to velocity in the complex plane, where each mode is a circle: measurement as dots,
    model as curves.

    Velocity is used because rigid-body motion hides the circles in the position response.
    """
    order, unit = 1 - agreement.order, agreement.measured[0].unit
    curves, dots = list[Curve](), list[Curve]()
    for i, (measured, model) in enumerate(zip(agreement.measured, agreement.drawn, strict=True)):
        name = measured.output if len(agreement.measured) > 1 else ""
        points, curve = (frf.response * (2j * np.pi * frf.frequency) ** order for frf in (measured, model))
        dots.append(Curve(np.real(points), np.imag(points), name, i, chart.MARKERS, "measured", size=0.9))
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
    """Plot the measured and fitted responses."""
    return response_fit_chart(fit.agreement)


def axis_fits_chart(fits: AxisFits) -> Chart:
    """Plot the measured response and the chosen fit."""
    return response_fit_chart(fits.fit.agreement)


BANDS = 500  # frequency bands over the whole axis; the curve shows the largest amplitude in each band


def bode_chart(responses: FRF | Mapping[str, FRF]) -> Chart:
    """Plot magnitude in dB and phase in degrees versus Hz, and the coherence in a third row if a response has one."""
    chosen = style.named(responses)
    numbered = list(enumerate(chosen.items()))
    unit = next((response.unit for response in chosen.values() if response.unit), "")
    label = f"magnitude (dB re 1 {unit_name(unit, 'SI')})" if unit not in ("", "N/N", "m/m") else "magnitude (dB)"
    levels = [Curve(response.frequency, style.decibel(response.magnitude), name, i) for i, (name, response) in numbered]
    phases = [Curve(response.frequency, response.phase_deg, number=i) for i, (_, response) in numbered]
    coherences = [
        Curve(response.frequency, response.coherence, number=i)
        for i, (_, response) in numbered
        if response.coherence is not None
    ]
    low, high = (float(end(np.concatenate([curve.y for curve in phases]))) for end in (np.min, np.max))
    panels = [
        Panel(label, tuple(levels), share=3.0),
        Panel("phase (deg)", tuple(phases), scale=chart.DEGREES, low=low, high=high, share=2.0),
    ]
    if coherences:
        panels.append(Panel("coherence", tuple(coherences), low=0.0, high=1.05))
    span = _span(response.frequency for response in chosen.values())
    return Chart("frequency (Hz)", tuple(panels), chart.FREQUENCY, *span, height=4.6 + bool(coherences))


bode = figure_of(bode_chart)


def closed_loop_chart(responses: FRF | Mapping[str, FRF]) -> Chart:
    """Plot the magnitude of the response to the setpoint in dB, with the -3 dB line, bandwidths and peaks."""
    chosen = style.named(responses)
    curves, marks = list[Curve](), list[Mark]()
    for i, (name, response) in enumerate(chosen.items()):
        level = style.decibel(response.magnitude)
        width = tracking_bandwidth(response)
        caption = [Text(f"peak {Quantity(level.max(), 'dB'):.2f}")] + (
            [Text(f"-3 dB at {Quantity(width, 'Hz')}")] if width is not None else []
        )
        curves.append(Curve(response.frequency, level, name, i, caption=joined(", ", caption)))
        marks += [] if width is None else [Mark(width, _MINUS_3_DB, i)]
    line = Level(_MINUS_3_DB, text="-3 dB", dashed=True)
    # a sampled response falls to nothing at Nyquist
    bottom = max(-40.0, min(float(np.min(curve.y)) for curve in curves) - 2.0)
    panel = Panel("position / set position (dB)", tuple(curves), marks=tuple(marks), levels=(line,), low=bottom)
    span = _span(response.frequency for response in chosen.values())
    return Chart("frequency (Hz)", (panel,), chart.FREQUENCY, *span, columns=style.narrow(chosen))


closed_loop = figure_of(closed_loop_chart)


_MINUS_3_DB = float(20.0 * np.log10(np.sqrt(0.5)))


def sensitivity_chart(loops: Margins | Mapping[str, Margins], units: Units = DRAWN) -> Chart:
    """Plot |S| and |T| in dB of loops opened at the drive, with the peak Ms marked."""
    chosen = style.named(loops)
    hertz, rows = units.of("Hz")[1], list[tuple[Curve, Curve]]()
    marks, least = list[Mark](), [0.0, 0.0]
    for i, (name, margins) in enumerate(chosen.items()):
        L, at = margins.loop_gain, margins.modulus_frequency
        caption = Text(f"Ms {Quantity(margins.sensitivity_peak):3} at {Quantity(at, 'Hz')}")
        levels = [style.decibel(ratio.magnitude) for ratio in (sensitivity_of(L), complementary_sensitivity(L))]
        least = [min(before, float(np.min(level))) for before, level in zip(least, levels, strict=True)]
        S, T = (np.asarray(units.from_decibel(level)) for level in levels)
        rows.append((Curve(hertz * L.frequency, S, name, i, caption=caption), Curve(hertz * L.frequency, T, number=i)))
        marks.append(Mark(hertz * at, float(units.from_decibel(_decibel(margins.sensitivity_peak))), i))
    panels = tuple(
        Panel(
            _ratio(what, units),
            tuple(row[k] for row in rows),
            marks=(tuple(marks), ())[k],
            scale=_scale(units),
            low=_floor(least[k], units),
        )
        for k, what in enumerate(("|S|", "|T|"))
    )
    span = _span((margins.loop_gain.frequency for margins in chosen.values()), units)
    return Chart(_hertz(), panels, chart.FREQUENCY, *span, height=4.4, columns=style.narrow(chosen), factor=hertz)


sensitivity = figure_of(sensitivity_chart)


def _decibel(ratio: float) -> float:
    return float(style.decibel(np.array(ratio)))


def _floor(least: float, units: Units) -> float | None:
    """Return the lower limit of a gain panel: -60 dB if the curves fall below it, otherwise None."""
    # |S| falls without limit towards 0 Hz and |T| towards Nyquist, which would compress the peaks.
    return float(units.from_decibel(-60.0)) if least < -60.0 else None


def _scale(units: Units) -> str:
    """Return the scale of a gain panel."""
    return chart.LINEAR if units.decibel else chart.LOG


def _ratio(what: str, units: Units) -> str:
    """Return the label of a gain panel."""
    return f"{what} (dB)" if units.decibel else what


def _hertz() -> str:
    return f"frequency ({unit_name('Hz')})"


def stiffness_chart(stiffnesses: Stiffness | Mapping[str, Stiffness], units: Units = DRAWN) -> Chart:
    """Plot the dynamic stiffness in N/µm versus Hz on logarithmic scales, with the minimum marked."""
    chosen = style.named(stiffnesses)
    hertz, factor = (units.of(unit)[1] for unit in ("Hz", "N/m"))
    curves, marks, tops = list[Curve](), list[Mark](), list[float]()
    for i, (name, stiffness) in enumerate(chosen.items()):
        least, where = factor * stiffness.minimum, stiffness.minimum_frequency
        caption = Text(f"least {Quantity(stiffness.minimum, 'N/m'):3} at {Quantity(where, 'Hz'):3}")
        curves.append(Curve(hertz * stiffness.frequency, factor * stiffness.magnitude, name, i, caption=caption))
        marks.append(Mark(hertz * where, least, i))
        # a sampled axis appears infinitely stiff at Nyquist, where the sampled position cannot show the motion
        tops.append(
            factor
            * float(np.max(stiffness.magnitude[stiffness.frequency <= 0.8 * stiffness.frequency[-1]], initial=0.0))
        )
    lows = [mark.y for mark in marks]
    panel = Panel(
        f"dynamic stiffness ({unit_name('N/m')})",
        tuple(curves),
        marks=tuple(marks),
        scale=chart.LOG,
        low=0.5 * min(lows),
        high=3.0 * max(*tops, *lows),
    )
    span = _span((stiffness.frequency for stiffness in chosen.values()), units)
    return Chart(_hertz(), (panel,), chart.FREQUENCY, *span, height=3.4, columns=style.narrow(chosen), factor=hertz)


stiffness = figure_of(stiffness_chart)


def spectrum_chart(spectra: Spectrum | Mapping[str, Spectrum]) -> Chart:
    """Plot the amplitude and cumulative RMS versus Hz on logarithmic scales, with only the largest line of each band
    where lines are dense.
    """
    chosen = style.named(spectra)
    first = next(iter(chosen.values()))
    unit, factor = USUAL.of(first.unit, signal_unit(first.unit))
    lowest = min(float(spectrum.frequency[1]) for spectrum in chosen.values())
    highest = max(float(spectrum.frequency[-1]) for spectrum in chosen.values())
    amplitudes, sums = list[Curve](), list[Curve]()
    tops, bottoms = list[float](), list[float]()
    for i, (name, spectrum) in enumerate(chosen.items()):
        frequency, amplitude, cumulative = _banded(spectrum, lowest, highest)
        amplitudes.append(Curve(frequency, factor * amplitude, name, i, chart.PLAIN, size=0.7))
        sums.append(Curve(frequency, factor * cumulative, number=i))
        tops.append(factor * float(np.max(amplitude)))
        # Not the minimum, since a few lines near 0 would stretch the logarithmic scale.
        bottoms.append(factor * float(np.quantile(amplitude, 0.02)))
    whole, top = [factor * spectrum.rms for spectrum in chosen.values()], max(tops)
    quantity = first.name.replace("_", " ") if len(chosen) == 1 or first.name else "amplitude"
    label = unit_name(style.written(unit))
    above = Panel(f"{quantity}\namplitude ({label})", tuple(amplitudes), share=3.0)
    # A signal that is zero cannot be drawn on a logarithmic scale.
    if top > 0.0:
        above = replace(above, scale=chart.LOG, low=max(0.5 * min(bottoms), 1e-7 * top), high=2.0 * top)
    below = Panel(f"cumulative\nRMS ({label})", tuple(sums), low=0.0, high=1.15 * max(whole) or 1.0, share=2.0)
    if min(whole) > 0.0 and max(whole) > style.WIDE * min(whole):
        below = replace(below, scale=chart.LOG, low=0.1 * min(whole), high=2.0 * max(whole))
    return Chart("frequency (Hz)", (above, below), chart.FREQUENCY, lowest, highest, height=4.6)


spectrum = figure_of(spectrum_chart)


def _banded(spectrum: Spectrum, low: float, high: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the center frequency, largest amplitude and last cumulative RMS of each band that contains lines; the line
    at 0 Hz is excluded.
    """
    frequency = spectrum.frequency[1:]
    bands = np.floor(BANDS * np.log(frequency / low) / np.log(high / low)).astype(int)
    begins = np.flatnonzero(np.diff(bands, prepend=-1))
    ends = np.append(begins[1:], frequency.size) - 1
    # the largest and not the mean: a single spectral line must not vanish
    amplitude = np.maximum.reduceat(spectrum.amplitude[1:], begins)
    centre = np.sqrt(frequency[begins] * frequency[ends])
    return centre, amplitude, spectrum.cumulative_rms[1:][ends]


def _span(frequencies: Any, units: Units = DRAWN) -> tuple[float, float]:
    """Return the lowest and highest of the frequencies (given in Hz), converted to the display unit."""
    ends, hertz = [(float(f[0]), float(f[-1])) for f in frequencies], units.of("Hz")[1]
    return hertz * min(low for low, _ in ends), hertz * max(high for _, high in ends)


def tuned_chart(tuned: Tuned) -> Chart:
    """Plot the dynamic stiffness before and after tuning at each operating point."""
    many = len(tuned.after) > 1
    curves = {
        f"{name}, {proof.point}" if many else name: proof.stiffness
        for name, row in (("today", tuned.before), ("new", tuned.after))
        for proof in row
        if proof.stable
    }
    return stiffness_chart(curves)


FAR = 60.0  # dB: a larger margin is not drawn
WRITTEN = 3  # largest number of labeled crossovers of each type, in a picture of one loop


def open_loop_chart(loops: Margins | Mapping[str, Margins], units: Units = DRAWN) -> Chart:
    """Plot magnitude in dB and phase in degrees of loop gains, with every gain and phase crossover.

    A bar on the phase shows a phase margin, a bar on the magnitude a gain margin. A measured loop gain also has its 95
    % confidence bands, its coherence in a third row, and shading where the coherence is 0.9 or less.
    """
    chosen = style.named(loops)
    hertz, gains = units.of("Hz")[1], [margins.loop_gain for margins in chosen.values()]
    levels, phases, levels_dB = list[Curve](), list[Curve](), list[np.ndarray]()
    bars: tuple[list[Curve], list[Curve]] = ([], [])
    marks: tuple[list[Mark], list[Mark]] = ([], [])
    shaded = list(doubtful(gains[-1:], units, ratio=not units.decibel)), list(doubtful(gains[-1:], units))
    for i, (name, margins) in enumerate(chosen.items()):
        L, phase = margins.loop_gain, _phase(margins)
        levels_dB.append(style.decibel(L.magnitude))
        level = np.asarray(units.from_decibel(levels_dB[-1]))
        levels.append(Curve(hertz * L.frequency, level, name, i, caption=_caption(margins, units)))
        phases.append(Curve(hertz * L.frequency, phase, number=i))
        _margins(margins, phase, i, len(chosen) == 1, bars, marks, units)
        # The axis is the same for all, and so is its uncertainty.
        if i == len(chosen) - 1:
            shaded[0].extend(magnitude_band(L, i, units, "95 % of the measurement"))
            shaded[1].extend(phase_band(L, phase, i, units))
    # -180 deg is always in view, since the phase margin is read from it.
    low, high = min(*(float(curve.y.min()) for curve in phases), -180.0), max(float(curve.y.max()) for curve in phases)
    turns = range(int(np.ceil((low + 180.0) / 360.0)), int(np.floor((high + 180.0) / 360.0)) + 1)
    bottom, top = min(float(np.min(level)) for level in levels_dB), max(float(np.max(level)) for level in levels_dB)
    ends = [float(units.from_decibel(end)) for end in (max(bottom, -FAR) - 5.0, min(top, 80.0) + 5.0)]
    panels = (
        Panel(
            _ratio("open loop |L|", units),
            (*levels, *bars[0]),
            marks=tuple(marks[0]),
            bands=tuple(shaded[0]),
            levels=(Level(float(units.from_decibel(0.0))),),
            scale=_scale(units),
            low=ends[0],
            high=ends[1],
            share=3.0,
        ),
        Panel(
            "phase (deg)",
            (*phases, *bars[1]),
            marks=tuple(marks[1]),
            scale=chart.DEGREES,
            low=low,
            high=high,
            share=2.0,
            levels=tuple(Level(360.0 * turn - 180.0) for turn in turns),
            bands=tuple(shaded[1]),
        ),
        *coherence_panels(list(enumerate(gains))[-1:], units),
    )
    span = _span((gain.frequency for gain in gains), units)
    return Chart(_hertz(), panels, chart.FREQUENCY, *span, height=3.0 + len(panels), columns=1, factor=hertz)


open_loop = figure_of(open_loop_chart)


def _caption(margins: Margins, units: Units) -> str:
    captions = list[str]()
    if margins.crossover is not None:
        phase = Quantity(margins.phase_margin_deg or 0.0, "deg")
        captions.append(f"crossover {Quantity(margins.crossover, 'Hz'):3}, phase margin {phase:.1f}")
    if margins.gain_increase_dB is not None:
        captions.append(f"gain margin {units.gain_text(margins.gain_increase_dB)}")
    return joined(", ", captions)


def _phase(margins: Margins) -> np.ndarray:
    """Return the continuous phase, shifted by whole turns so that the first crossover lies between -360° and 0°."""
    L = margins.loop_gain
    phase = L.phase_deg
    at = L.frequency[0] if margins.crossover is None else margins.crossover
    # 1e-6: a phase of exactly 0 or -360° must not change its turn by rounding
    return phase - 360.0 * np.ceil(np.interp(np.log(at), np.log(L.frequency), phase) / 360.0 - 1e-6)


def _margins(
    margins: Margins,
    phase: np.ndarray,
    i: int,
    alone: bool,
    bars: tuple[list[Curve], list[Curve]],
    marks: tuple[list[Mark], list[Mark]],
    units: Units,
) -> None:
    """Add points at the crossovers, and bars from the curve to 0 dB or to the nearest -180°, for both panels."""
    x, hertz = np.log(margins.loop_gain.frequency), units.of("Hz")[1]
    one = float(units.from_decibel(0.0))
    for k, gain in enumerate(margins.gain_crossovers):
        at = float(np.interp(np.log(gain.frequency), x, phase))
        text = f"{Quantity(gain.phase_margin_deg, 'deg'):.1f}" if alone and k < WRITTEN else ""
        marks[0].append(Mark(hertz * gain.frequency, one, i))
        marks[1].append(Mark(hertz * gain.frequency, at, i))
        bars[1].append(_bar(hertz * gain.frequency, at - gain.phase_margin_deg, at, i, text))
    for k, crossing in enumerate(margins.phase_crossovers):
        if abs(crossing.gain_margin_dB) > FAR:
            continue
        at = float(np.interp(np.log(crossing.frequency), x, phase))
        level = float(units.from_decibel(-crossing.gain_margin_dB))
        text = units.gain_text(crossing.gain_margin_dB) if alone and k < WRITTEN else ""
        marks[1].append(Mark(hertz * crossing.frequency, at, i, hollow=True))
        marks[0].append(Mark(hertz * crossing.frequency, level, i, hollow=True))
        bars[0].append(_bar(hertz * crossing.frequency, level, one, i, text))


def _bar(x: float, low: float, high: float, i: int, text: str) -> Curve:
    return Curve(np.array([x, x]), np.array([low, high]), number=i, look=chart.BAR, caption=text)


def measured_loop_chart(loop: MarginIntervals | MeasuredLoop) -> Chart:
    """Plot the loop gain with its crossovers."""
    return open_loop_chart(loop.margins)


def cascade_loops_chart(loops: CascadeLoops) -> Chart:
    """Plot the loop gains of both loops of a cascade."""
    return open_loop_chart({"velocity loop": loops.velocity, "position loop": loops.position})


def recipe_chart(_found: Recipe) -> Chart:
    """Raise ParameterError: a recipe has no picture."""
    raise ParameterError("a recipe has no picture: give its law to `tune` or `measured_loop`, and draw that")
