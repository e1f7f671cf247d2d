"""Pictures over frequency: Bode plots with all margins, closed loop, sensitivity, dynamic stiffness, amplitude
spectra.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from feeddrive.analysis.margins import Margins, complementary_sensitivity, tracking_bandwidth
from feeddrive.analysis.margins import sensitivity as sensitivity_of
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import DRAWN, USUAL, Quantity, Units, signal_unit, unit_name
from feeddrive.language.text import Text, joined
from feeddrive.plot import style
from feeddrive.plot.chart import BAR, DEGREES, FREQUENCY, LINEAR, LOG, PLAIN, Chart, Curve, Level, Mark, Panel
from feeddrive.plot.drawing import figure_of
from feeddrive.plot.responses import coherence_panels, doubtful, magnitude_band, phase_band

if TYPE_CHECKING:
    from collections.abc import Mapping

    from feeddrive.analysis.margins import MarginIntervals
    from feeddrive.analysis.measured_loop import MeasuredLoop
    from feeddrive.analysis.spectrum import Spectrum
    from feeddrive.analysis.stiffness import Stiffness
    from feeddrive.loop.frequency_response import FRF
    from feeddrive.tuning.recipes import Recipe
    from feeddrive.tuning.tune import CascadeLoops, Tuned

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
        Panel("phase (deg)", tuple(phases), scale=DEGREES, low=low, high=high, share=2.0),
    ]
    if coherences:
        panels.append(Panel("coherence", tuple(coherences), low=0.0, high=1.05))
    span = _span(response.frequency for response in chosen.values())
    return Chart("frequency (Hz)", tuple(panels), FREQUENCY, *span, height=4.6 + bool(coherences))


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
    return Chart("frequency (Hz)", (panel,), FREQUENCY, *span, columns=style.narrow(chosen))


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
    return Chart(_hertz(), panels, FREQUENCY, *span, height=4.4, columns=style.narrow(chosen), factor=hertz)


sensitivity = figure_of(sensitivity_chart)


def _decibel(ratio: float) -> float:
    return float(style.decibel(np.array(ratio)))


def _floor(least: float, units: Units) -> float | None:
    """Return the lower limit of a gain panel: -60 dB if the curves fall below it, else None."""
    return float(units.from_decibel(-60.0)) if least < -60.0 else None


def _scale(units: Units) -> str:
    """Return the scale of a gain panel."""
    return LINEAR if units.decibel else LOG


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
        scale=LOG,
        low=0.5 * min(lows),
        high=3.0 * max(*tops, *lows),
    )
    span = _span((stiffness.frequency for stiffness in chosen.values()), units)
    return Chart(_hertz(), (panel,), FREQUENCY, *span, height=3.4, columns=style.narrow(chosen), factor=hertz)


stiffness = figure_of(stiffness_chart)


def spectrum_chart(spectra: Spectrum | Mapping[str, Spectrum]) -> Chart:
    """Plot amplitude and cumulative RMS versus Hz on logarithmic scales; dense lines are reduced to the largest of each
    band.
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
        amplitudes.append(Curve(frequency, factor * amplitude, name, i, PLAIN, size=0.7))
        sums.append(Curve(frequency, factor * cumulative, number=i))
        tops.append(factor * float(np.max(amplitude)))
        bottoms.append(factor * float(np.quantile(amplitude, 0.02)))
    whole, top = [factor * spectrum.rms for spectrum in chosen.values()], max(tops)
    quantity = first.name.replace("_", " ") if len(chosen) == 1 or first.name else "amplitude"
    label = unit_name(style.written(unit))
    above = Panel(f"{quantity}\namplitude ({label})", tuple(amplitudes), share=3.0)
    if top > 0.0:  # a signal that is zero cannot be drawn on a logarithmic scale
        above = replace(above, scale=LOG, low=max(0.5 * min(bottoms), 1e-7 * top), high=2.0 * top)
    below = Panel(f"cumulative\nRMS ({label})", tuple(sums), low=0.0, high=1.15 * max(whole) or 1.0, share=2.0)
    if min(whole) > 0.0 and max(whole) > style.WIDE * min(whole):
        below = replace(below, scale=LOG, low=0.1 * min(whole), high=2.0 * max(whole))
    return Chart("frequency (Hz)", (above, below), FREQUENCY, lowest, highest, height=4.6)


spectrum = figure_of(spectrum_chart)


def _banded(spectrum: Spectrum, low: float, high: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return center frequency, largest amplitude and last cumulative RMS of each band with lines, without the line at
    0.
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
    """Return the lowest and highest of all frequencies in Hz, in the displayed unit."""
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
        if i == len(chosen) - 1:  # the axis is the same for all, and so is its uncertainty
            shaded[0].extend(magnitude_band(L, i, units, "95 % of the measurement"))
            shaded[1].extend(phase_band(L, phase, i, units))
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
            scale=DEGREES,
            low=low,
            high=high,
            share=2.0,
            levels=tuple(Level(360.0 * turn - 180.0) for turn in turns),
            bands=tuple(shaded[1]),
        ),
        *coherence_panels(list(enumerate(gains))[-1:], units),
    )
    span = _span((gain.frequency for gain in gains), units)
    return Chart(_hertz(), panels, FREQUENCY, *span, height=3.0 + len(panels), columns=1, factor=hertz)


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
    return Curve(np.array([x, x]), np.array([low, high]), number=i, look=BAR, caption=text)


def measured_loop_chart(loop: MarginIntervals | MeasuredLoop) -> Chart:
    """Plot the loop gain with its crossovers."""
    return open_loop_chart(loop.margins)


def cascade_loops_chart(loops: CascadeLoops) -> Chart:
    """Plot the loop gains of both loops of a cascade."""
    return open_loop_chart({"velocity loop": loops.velocity, "position loop": loops.position})


def recipe_chart(_found: Recipe) -> Chart:
    """Raise ParameterError: a recipe has no picture."""
    raise ParameterError("a recipe has no picture: give its law to `tune` or `measured_loop`, and draw that")
