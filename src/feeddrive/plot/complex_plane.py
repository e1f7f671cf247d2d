"""Pictures in the complex plane: Nyquist plots, poles of a sampled loop, and the uncertainty discs of a certificate."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from feeddrive.analysis.margins import Margins
from feeddrive.analysis.margins import margins as margins_of
from feeddrive.language.quantity import DRAWN, Quantity, Units, unit_name
from feeddrive.language.text import Text, joined
from feeddrive.loop.linearize import continuous, natural
from feeddrive.plot import chart, style
from feeddrive.plot.chart import Band, Chart, Curve, Disc, Level, Mark, Note, Panel
from feeddrive.plot.drawing import figure_of

if TYPE_CHECKING:
    from collections.abc import Mapping

    from feeddrive.analysis.stability import Encirclement, Stability
    from feeddrive.certificate.certificate import Certificate, LoopResponse
    from feeddrive.loop.frequency_response import FRF
    from feeddrive.loop.linearize import StateSpace
    from feeddrive.tuning.poles import Placement


FINER = 4  # points drawn for each line of a model's curve
DISCS = 200  # discs drawn along a measured curve
REACH = (-2.6, 1.4, -2.0, 2.0)  # left, right, low, high of the Nyquist plot; the critical point is -1


def nyquist_chart(loops: Margins | Mapping[str, Margins]) -> Chart:
    """Plot loop gains near -1, with the unit circle and, for each loop, the circle of radius 1/Ms that it touches.

    A measured loop gain is drawn with its 95 % confidence discs; each of them is valid for one frequency line only.
    """
    chosen = style.named(loops)
    curves, marks, discs = list[Curve](), list[Mark](), [Disc(0.0, 0.0, 1.0)]
    for i, (name, margins) in enumerate(chosen.items()):
        L = margins.loop_gain
        figures = Text(f"Ms {Quantity(margins.sensitivity_peak):3} at {Quantity(margins.modulus_frequency, 'Hz')}")
        # only the curve of a model is rounded: between the lines of a measurement nothing is known
        x, y = _visible(_rounded(L.response) if L.coherence is None else L.response)
        caption = (
            (name[:40], i, chart.LINE, joined("", ["\n", figures]))
            if len(chosen) > 1
            else (name[:40], i, chart.LINE, figures)
        )
        # the mirror image belongs to negative frequencies
        curves += [Curve(x, y, *caption), Curve(x, -y, number=i, look=chart.THIN)]
        discs.append(Disc(-1.0, 0.0, margins.modulus_margin, i, filled=True))
        touch = _at(margins, margins.modulus_frequency)
        marks.append(Mark(touch.real, touch.imag, i))
        if i == len(chosen) - 1:  # the axis is the same for all, and so is its uncertainty
            curves = [*_spread(L, i), *curves]  # below the curves
    critical = Curve(np.array([-1.0]), np.array([0.0]), number=chart.ALERT, look=chart.PLUS)
    notes = Note(-1.0, 0.0, "-1", chart.ALERT), Note(float(np.cos(0.9)), float(np.sin(0.9)), "|L| = 1", right=True)
    axes = Level(0.0, faint=True), Level(0.0, upright=True, faint=True)
    low, high, bottom, top = REACH
    panel = Panel(
        "imaginary part of L",
        (*curves, critical),
        marks=tuple(marks),
        levels=axes,
        discs=tuple(discs),
        notes=notes,
        low=bottom,
        high=top,
    )
    alone = len(chosen) == 1
    return Chart(
        "real part of L",
        (panel,),
        low=low,
        high=high,
        square=True,
        height=max(4.8, 0.45 * len(chosen)),
        columns=1,
        width=5.4 if alone else chart.WIDTH,
        legend=chart.ABOVE if alone else chart.RIGHT,
    )


nyquist = figure_of(nyquist_chart)


def _spread(L: FRF, number: int) -> list[Curve]:
    """Return the 95 % confidence discs of a measured loop gain, interpolated between its points; empty for a model."""
    if L.radius is None:
        return []
    low, high, bottom, top = REACH
    off = np.hypot(np.real(L.response) - 0.5 * (low + high), np.imag(L.response) - 0.5 * (bottom + top))
    # A disc as large as the picture would only cover it.
    near = (off < high - low + L.radius) & (L.radius < top)
    # a single point has no path along which discs could be interpolated
    near &= np.roll(near, 1) | np.roll(near, -1)
    if np.count_nonzero(near) < 2:
        return []
    center, radius = L.response[near], L.radius[near]
    walked = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(center)))])
    along = np.linspace(0.0, walked[-1], DISCS)
    x, y, reach = (np.interp(along, walked, values) for values in (np.real(center), np.imag(center), radius))
    return [Curve(x, y, "95 % of the measurement", number, reach=reach)]


def _rounded(response: np.ndarray) -> np.ndarray:
    """Return a model's curve with additional points from cubic interpolation, so that a resonance appears round."""
    if response.size < 3:
        return response
    slope = np.gradient(response)
    t = np.arange(FINER)[:, None] / FINER
    a, b, da, db = response[:-1], response[1:], slope[:-1], slope[1:]
    between = a + t * (da + t * (3.0 * (b - a) - 2.0 * da - db + t * (2.0 * (a - b) + da + db)))
    return np.append(between.T.ravel(), response[-1])


def _visible(response: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the parts of a curve inside the picture plus one point on each side; the rest is NaN."""
    low, high, bottom, top = REACH
    near = (
        (np.real(response) > low)
        & (np.real(response) < high)
        & (np.imag(response) > bottom)
        & (np.imag(response) < top)
    )
    near = near | np.roll(near, 1) | np.roll(near, -1)
    # an integrator makes L thousands of times as large as the picture
    bounded = np.clip(np.real(response), 4 * low, 4 * high), np.clip(np.imag(response), 4 * bottom, 4 * top)
    return np.where(near, bounded[0], np.nan), np.where(near, bounded[1], np.nan)


def _at(margins: Margins, frequency: float) -> complex:
    L = margins.loop_gain
    x = np.log(L.frequency)
    return complex(
        np.interp(np.log(frequency), x, np.real(L.response)), np.interp(np.log(frequency), x, np.imag(L.response))
    )


def encirclement_chart(encirclement: Encirclement) -> Chart:
    """Plot the Nyquist curve of the measured or modelled loop gain."""
    return nyquist_chart(margins_of(encirclement.loop_gain))


def poles_chart(model: StateSpace) -> Chart:
    """Plot the poles of a sampled model as s = ln(z)/T in Hz, and their damping ratios versus natural frequency."""
    return chart.side_by_side((plane_chart(model), damping_chart(model)), height=3.9)


poles = figure_of(poles_chart)


DAMPINGS = (0.1, 0.2, 0.4, 0.7)  # damping ratios of the rays of a pole map
_LIGHT = 0.5  # largest damping ratio of a pole that determines the range of the plane
_ROOM, _RIGHT, _BELOW = 1.25, 0.25, 0.04  # factor on the farthest one; right and bottom margins, shares of the height


def plane_chart(models: StateSpace | Mapping[str, StateSpace], units: Units = DRAWN) -> Chart:
    """Plot the upper half of the s plane, s = ln(z)/T: poles as crosses, zeros of the first response as circles.

    The grid has rays of constant damping ratio and circles of constant natural frequency; a pole to the right of 0 is
    unstable. The poles with a damping ratio below 0.5 determine the range shown.
    """
    chosen = style.named(models)
    hertz = units.of("Hz")[1]
    upper = {name: _upper(model.poles(), model, hertz) for name, model in chosen.items()}
    # a well damped pole far to the left would shrink the poles that ring to a corner
    light = [abs(s) for row in upper.values() for s in row if s.imag > 0.0 and -s.real < _LIGHT * abs(s)]
    sizes = light or [abs(s) for row in upper.values() for s in row if np.isfinite(s)]
    reach = _ROOM * max(sizes, default=hertz)
    curves, notes = list[Curve](), list[Note]()
    for ratio in DAMPINGS:
        x, y = -ratio, float(np.sqrt(1.0 - ratio**2))
        end = reach * min(1.0 / y, 1.0 / -x)
        curves.append(Curve(np.array([0.0, end * x]), np.array([0.0, end * y]), number=chart.NEUTRAL, look=chart.THIN))
        notes.append(Note(0.9 * end * x, 0.9 * end * y, Text(f"{Quantity(ratio)}")))
    circles = [k * _step(reach) for k in range(1, 8) if k * _step(reach) < reach]
    notes += [Note(0.0, radius, Text(f"{Quantity(radius / hertz, 'Hz'):6}"), right=True) for radius in circles]
    for i, (name, s) in enumerate(upper.items()):
        model, grows = chosen[name], np.real(s) >= 0.0
        curves.append(Curve(np.real(s[~grows]), np.imag(s[~grows]), name, i, chart.CROSS, _lightest(s / hertz)))
        if np.any(grows):
            growing = f"{name} grows".strip()
            curves.append(Curve(np.real(s[grows]), np.imag(s[grows]), growing, chart.ALERT, chart.CROSS))
        if model.inputs and model.outputs:
            there = _upper(model.zeros(), model, hertz)
            curves.append(Curve(np.real(there), np.imag(there), number=i, look=chart.RING))
    axes = Level(0.0), Level(0.0, upright=True)
    discs = tuple(Disc(0.0, 0.0, radius) for radius in circles)
    panel = Panel(
        f"imaginary part of s ({unit_name('Hz')})",
        tuple(curves),
        levels=axes,
        discs=discs,
        notes=tuple(notes),
        low=-_BELOW * reach,
        high=reach,
    )
    return Chart(
        f"real part of s ({unit_name('Hz')})",
        (panel,),
        low=-reach,
        high=_RIGHT * reach,
        square=True,
        height=4.8,
        factor=hertz,
    )


def _upper(z: np.ndarray, model: StateSpace, hertz: float) -> np.ndarray:
    """Return s of the upper half plane in the displayed unit of frequency, without points at z = 0."""
    s = continuous(z, model.sample_time)
    return hertz / (2.0 * np.pi) * s[np.isfinite(s) & (np.imag(s) >= 0.0)]


def _lightest(s: np.ndarray) -> str:
    """Return the damping ratio and frequency of the least damped oscillatory pole as text; s in Hz."""
    swings = s[np.imag(s) > 0.0]
    if not swings.size:
        return "no pole oscillates"
    ratio = -np.real(swings) / np.abs(swings)
    at = int(np.argmin(ratio))
    return Text(f"least damping {Quantity(ratio[at]):2} at {Quantity(abs(swings[at]), 'Hz'):3}")


def _step(reach: float) -> float:
    """Return a grid spacing, a round number, that divides a length into three to six intervals."""
    size = 10.0 ** np.floor(np.log10(reach / 3.0))
    return float(size * max(multiple for multiple in (1.0, 2.0, 2.5, 5.0) if multiple * size <= reach / 3.0))


def damping_chart(models: StateSpace | Mapping[str, StateSpace], units: Units = DRAWN) -> Chart:
    """Plot the damping ratio versus natural frequency of all poles up to Nyquist: 1 for real poles, negative for
    unstable ones.
    """
    chosen = style.named(models)
    hertz = units.of("Hz")[1]
    curves, sizes, least = list[Curve](), list[float](), 0.0
    for i, (name, model) in enumerate(chosen.items()):
        z = model.poles().astype(complex)
        # Delays (z = 0) and integrators (z = 1) have no damping ratio.
        there = (np.abs(z) > 1e-9) & (np.abs(z - 1.0) > 1e-9) & (np.imag(z) >= 0.0)
        frequency, damping = natural(z[there], model.sample_time)
        grows = damping <= 0.0
        caption = _lightest(_upper(z[there], model, 1.0))
        curves.append(Curve(hertz * frequency[~grows], damping[~grows], name, i, chart.CROSS, caption))
        if np.any(grows):
            curves.append(
                Curve(hertz * frequency[grows], damping[grows], f"{name} grows".strip(), chart.ALERT, chart.CROSS)
            )
        sizes += [float(value) for value in hertz * frequency]
        least = min(least, float(np.min(damping, initial=0.0)))
    panel = Panel("damping ratio", tuple(curves), levels=(Level(0.0),), low=least - 0.08, high=1.08)
    nyquist = max(0.5 * hertz / model.sample_time for model in chosen.values())
    low, high = 0.5 * min(sizes, default=1e-3 * nyquist), min(2.0 * max(sizes, default=nyquist), nyquist)
    return Chart(f"natural frequency ({unit_name('Hz')})", (panel,), chart.FREQUENCY, low, high, factor=hertz)


def stability_chart(stability: Stability) -> Chart:
    """Plot the poles of the loop."""
    return poles_chart(stability.model)


def placement_chart(placement: Placement) -> Chart:
    """Plot the poles of the sampled loop."""
    return poles_chart(placement.stability.model)


_MOST = 6  # largest number of rows of a picture
_DECADES = 3.0  # decades shown below the frequency of the smallest margin
_DISCS = 500  # discs drawn in the complex plane
_REACH = (-2.4, 1.2, -1.9, 1.7)  # left, right, low, high of the picture of discs


def certificate_chart(certificate: Certificate) -> Chart:
    """Plot the error of the model that would reach instability, |1 + L|/|L|, and the certified one, in %.

    Each plant has a panel, those with the smallest margin first. For a multirate controller, 1/Σ|H| is plotted instead:
    the sum covers the responses of the force to a sine of 1 N at its own frequency and at the image frequencies.
    """
    # A plant without discs has no reserve, and is the last to be shown.
    plants = sorted(certificate.document["plants"], key=lambda plant: plant["reserve"] or np.inf)[:_MOST]
    nyquist = 0.5 / certificate.sample_time
    low = min(max(plant["reserve_at_Hz"] * 10.0**-_DECADES, 1e-4 * nyquist) for plant in plants)
    panels = tuple(_room(certificate, plant, low, named=len(plants) > 1, first=plant is plants[0]) for plant in plants)
    return Chart(
        f"frequency ({unit_name('Hz')})", panels, chart.FREQUENCY, low, nyquist, height=1.0 + 2.2 * len(plants)
    )


certificate = figure_of(certificate_chart)


def _room(certificate: Certificate, plant: Any, low: float, *, named: bool, first: bool) -> Panel:
    """Return the panel of one plant: relative distance from -1, relative disc radius, and measured bands."""
    loop = certificate.loops[plant["name"]]
    f = loop.lines()
    f = f[f >= low]
    distance, taken = loop.room(f)
    size = loop.size(f)
    near, radius = 100.0 * distance / size, 100.0 * taken / size
    least = float(np.min(near))
    floor = max(0.5 * min(least, float(np.min(radius)) or 1.0), 1e-3 * least)
    names = ("error that would reach instability", "what the model may be wrong by") if first else ("", "")
    curves = [Curve(f, near, names[0], 0), Curve(f, radius, names[1], 1)]
    curves += [Curve(np.array(band), np.full(2, 1.08 * floor), number=2, look=chart.BAR) for band in _measured(plant)]
    marks, caption = list[Mark](), "no disc"
    if plant["reserve"] is not None:
        place = np.array([plant["reserve_at_Hz"]])
        marks.append(Mark(float(place[0]), 100.0 * float((loop.room(place)[0] / loop.size(place))[0]), 0))
        caption = Text(
            f"{Quantity(plant['reserve']):3} × the room that is needed, at {Quantity(plant['reserve_at_Hz'], 'Hz'):3}"
        )
    return Panel(
        "error of the model (%)",
        tuple(curves),
        tuple(marks),
        bands=(Band(f, np.full(f.size, floor), radius, 1),),
        scale=chart.LOG,
        low=floor,
        high=30.0 * max(100.0, least),
        caption=Text(f"{plant['name']}: {caption}") if named else caption,
    )


def _measured(plant: Any) -> list[tuple[float, float]]:
    """Return the bands in which a plant was measured."""
    return [(lines[0][0], lines[-1][0]) for lines in plant["lines"] if lines]


def certificate_discs_chart(certificate: Certificate) -> Chart:
    """Plot L of the plant with the smallest margin near -1, with its uncertainty disc at each frequency."""
    plant = min(certificate.document["plants"], key=lambda candidate: candidate["reserve"] or np.inf)
    loop: LoopResponse = certificate.loops[plant["name"]]
    f = loop.lines()
    L = loop.gains(f).sum(axis=0)
    taken = loop.room(f)[1]
    near = (np.abs(L.real + 0.6) < 2.5 + taken) & (np.abs(L.imag) < 2.5 + taken) & (taken < 4.0)
    walked = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(L[near])))])
    # Evenly along the curve: the lines are dense where it hardly moves, and a disc for each would only take time.
    keep = np.unique(np.searchsorted(walked, np.linspace(0.0, walked[-1], _DISCS)).clip(0, walked.size - 1))
    may, reach = L[near][keep], taken[near][keep]
    curves = (
        Curve(may.real, may.imag, "where L may lie", 1, reach=reach),
        # An integrator makes L thousands of times as large as the picture.
        Curve(np.clip(L.real, -20, 20), np.clip(L.imag, -20, 20), "L of the model", 0),
        Curve(np.array([-1.0]), np.array([0.0]), number=chart.ALERT, look=chart.PLUS),
    )
    axes = Level(0.0, faint=True), Level(0.0, upright=True, faint=True)
    left, right, low, high = _REACH
    note = Note(-1.0, 0.0, "-1", chart.ALERT)
    panel = Panel("imaginary part of L", curves, levels=axes, notes=(note,), low=low, high=high, caption=plant["name"])
    return Chart("real part of L", (panel,), low=left, high=right, square=True, height=5.2, width=5.8)


certificate_discs = figure_of(certificate_discs_chart)
