"""Pole maps of a sampled loop: the s plane, and damping over natural frequency."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from feeddrive.language.quantity import DRAWN, Quantity, Units, unit_name
from feeddrive.language.text import Text
from feeddrive.loop.poles_and_zeros import continuous, natural
from feeddrive.plot import style
from feeddrive.plot.chart import (
    ALERT,
    CROSS,
    FREQUENCY,
    NEUTRAL,
    RING,
    THIN,
    Chart,
    Curve,
    Disc,
    Level,
    Note,
    Panel,
    side_by_side,
)
from feeddrive.plot.drawing import figure_of

if TYPE_CHECKING:
    from collections.abc import Mapping

    from feeddrive.analysis.stability import Stability
    from feeddrive.loop.linearize import StateSpace
    from feeddrive.tuning.poles import Placement


def poles_chart(model: StateSpace) -> Chart:
    """Poles of a sampled model as s = ln(z)/T in Hz, and the same as damping ratio over natural frequency."""
    return side_by_side((plane_chart(model), damping_chart(model)), height=3.9)


poles = figure_of(poles_chart)


DAMPINGS = (0.1, 0.2, 0.4, 0.7)  # of the rays of a pole map
_LIGHT = 0.5  # damping up to which a pole decides how much of the plane is shown
_ROOM, _RIGHT, _BELOW = 1.25, 0.25, 0.04  # around the farthest of them; parts of the height to the right and below


def plane_chart(models: StateSpace | Mapping[str, StateSpace], units: Units = DRAWN) -> Chart:
    """Upper half of the s plane, s = ln(z)/T: poles as crosses, zeros of the first response as rings.

    Rays of equal damping and circles of equal natural frequency; a pole right of 0 is unstable.  The poles with a
    damping ratio below 0.5 set the range that is shown.
    """
    chosen = style.named(models)
    hertz = units.of("Hz")[1]
    upper = {name: _upper(model.poles(), model, hertz) for name, model in chosen.items()}
    light = [abs(s) for row in upper.values() for s in row if s.imag > 0.0 and -s.real < _LIGHT * abs(s)]
    known = light or [abs(s) for row in upper.values() for s in row if np.isfinite(s)]
    reach = _ROOM * max(known, default=hertz)
    curves, notes = list[Curve](), list[Note]()
    for ratio in DAMPINGS:
        x, y = -ratio, float(np.sqrt(1.0 - ratio**2))
        end = reach * min(1.0 / y, 1.0 / -x)
        curves.append(Curve(np.array([0.0, end * x]), np.array([0.0, end * y]), number=NEUTRAL, look=THIN))
        notes.append(Note(0.9 * end * x, 0.9 * end * y, Text(f"{Quantity(ratio)}")))
    circles = [k * _step(reach) for k in range(1, 8) if k * _step(reach) < reach]
    notes += [Note(0.0, radius, Text(f"{Quantity(radius / hertz, 'Hz'):6}"), right=True) for radius in circles]
    for i, (name, s) in enumerate(upper.items()):
        model, grows = chosen[name], np.real(s) >= 0.0
        curves.append(Curve(np.real(s[~grows]), np.imag(s[~grows]), name, i, CROSS, _lightest(s / hertz)))
        if np.any(grows):
            growing = f"{name} grows".strip()
            curves.append(Curve(np.real(s[grows]), np.imag(s[grows]), growing, ALERT, CROSS))
        if model.inputs and model.outputs:
            there = _upper(model.zeros(), model, hertz)
            curves.append(Curve(np.real(there), np.imag(there), number=i, look=RING))
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
    """Return s of the upper half plane in the shown unit of frequency, without what lies at z = 0."""
    s = continuous(z, model.sample_time)
    return hertz / (2.0 * np.pi) * s[np.isfinite(s) & (np.imag(s) >= 0.0)]


def _lightest(s: np.ndarray) -> str:
    """The least damped pole that oscillates, in words; s in Hz."""
    swings = s[np.imag(s) > 0.0]
    if not swings.size:
        return "no pole oscillates"
    ratio = -np.real(swings) / np.abs(swings)
    at = int(np.argmin(ratio))
    return Text(f"least damping {Quantity(ratio[at]):2} at {Quantity(abs(swings[at]), 'Hz'):3}")


def _step(reach: float) -> float:
    """Return a round step that goes three to seven times into a length."""
    size = 10.0 ** np.floor(np.log10(reach / 3.0))
    return float(size * max(multiple for multiple in (1.0, 2.0, 2.5, 5.0) if multiple * size <= reach / 3.0))


def damping_chart(models: StateSpace | Mapping[str, StateSpace], units: Units = DRAWN) -> Chart:
    """Damping ratio over natural frequency of all poles up to Nyquist: 1 for real poles, negative for unstable ones."""
    chosen = style.named(models)
    hertz = units.of("Hz")[1]
    curves, sizes, least = list[Curve](), list[float](), 0.0
    for i, (name, model) in enumerate(chosen.items()):
        z = model.poles().astype(complex)
        there = (np.abs(z) > 1e-9) & (np.abs(z - 1.0) > 1e-9) & (np.imag(z) >= 0.0)  # neither delays nor integrators
        frequency, damping = natural(z[there], model.sample_time)
        grows = damping <= 0.0
        caption = _lightest(_upper(z[there], model, 1.0))
        curves.append(Curve(hertz * frequency[~grows], damping[~grows], name, i, CROSS, caption))
        if np.any(grows):
            curves.append(Curve(hertz * frequency[grows], damping[grows], f"{name} grows".strip(), ALERT, CROSS))
        sizes += [float(value) for value in hertz * frequency]
        least = min(least, float(np.min(damping, initial=0.0)))
    panel = Panel("damping ratio", tuple(curves), levels=(Level(0.0),), low=least - 0.08, high=1.08)
    nyquist = max(0.5 * hertz / model.sample_time for model in chosen.values())
    low, high = 0.5 * min(sizes, default=1e-3 * nyquist), min(2.0 * max(sizes, default=nyquist), nyquist)
    return Chart(f"natural frequency ({unit_name('Hz')})", (panel,), FREQUENCY, low, high, factor=hertz)


def stability_chart(stability: Stability) -> Chart:
    """Poles of the loop."""
    return poles_chart(stability.model)


def placement_chart(placement: Placement) -> Chart:
    """Poles of the sampled loop."""
    return poles_chart(placement.stability.model)
