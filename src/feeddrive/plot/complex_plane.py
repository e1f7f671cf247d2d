"""The Nyquist curve in the complex plane."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from feeddrive.analysis.margins import Margins
from feeddrive.analysis.margins import margins as margins_of
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text, joined
from feeddrive.plot import style
from feeddrive.plot.chart import (
    ABOVE,
    ALERT,
    LINE,
    PLUS,
    RIGHT,
    THIN,
    WIDTH,
    Chart,
    Curve,
    Disc,
    Level,
    Mark,
    Note,
    Panel,
)
from feeddrive.plot.drawing import figure_of

if TYPE_CHECKING:
    from collections.abc import Mapping

    from feeddrive.analysis.stability import Encirclement
    from feeddrive.loop.frequency_response import FRF

FINER = 4  # points drawn for each line of a modeled curve
DISCS = 200  # that are drawn along a measured curve
REACH = (-2.6, 1.4, -2.0, 2.0)  # of the Nyquist plot: the critical point is -1


def nyquist_chart(loops: Margins | Mapping[str, Margins]) -> Chart:
    """Loop gains near -1, with the unit circle and for each loop the circle of radius 1/Ms that it touches.

    A measured loop gain also has its 95 % discs, which hold line by line.
    """
    chosen = style.named(loops)
    curves, marks, discs = list[Curve](), list[Mark](), [Disc(0.0, 0.0, 1.0)]
    for i, (name, margins) in enumerate(chosen.items()):
        L = margins.loop_gain
        figures = Text(f"Ms {Quantity(margins.sensitivity_peak):3} at {Quantity(margins.modulus_frequency, 'Hz')}")
        x, y = _visible(_rounded(L.response) if L.coherence is None else L.response)
        caption = (
            (name[:40], i, LINE, joined("", ["\n", figures])) if len(chosen) > 1 else (name[:40], i, LINE, figures)
        )
        curves += [Curve(x, y, *caption), Curve(x, -y, number=i, look=THIN)]
        discs.append(Disc(-1.0, 0.0, margins.modulus_margin, i, filled=True))
        touch = _at(margins, margins.modulus_frequency)
        marks.append(Mark(touch.real, touch.imag, i))
        if i == len(chosen) - 1:  # the axis is the same for all, and so is its uncertainty
            curves = [*_spread(L, i), *curves]  # below the curves
    critical = Curve(np.array([-1.0]), np.array([0.0]), number=ALERT, look=PLUS)
    notes = Note(-1.0, 0.0, "-1", ALERT), Note(float(np.cos(0.9)), float(np.sin(0.9)), "|L| = 1", right=True)
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
        width=5.4 if alone else WIDTH,
        legend=ABOVE if alone else RIGHT,
    )


nyquist = figure_of(nyquist_chart)


def _spread(L: FRF, number: int) -> list[Curve]:
    """The 95 % discs of a measured loop gain, interpolated along the lines between its points; none of a model."""
    if L.radius is None:
        return []
    low, high, bottom, top = REACH
    off = np.hypot(np.real(L.response) - 0.5 * (low + high), np.imag(L.response) - 0.5 * (bottom + top))
    near = (off < high - low + L.radius) & (L.radius < top)
    near &= np.roll(near, 1) | np.roll(near, -1)
    if np.count_nonzero(near) < 2:
        return []
    center, radius = L.response[near], L.radius[near]
    walked = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(center)))])
    along = np.linspace(0.0, walked[-1], DISCS)
    x, y, reach = (np.interp(along, walked, values) for values in (np.real(center), np.imag(center), radius))
    return [Curve(x, y, "95 % of the measurement", number, reach=reach)]


def _rounded(response: np.ndarray) -> np.ndarray:
    """A modeled curve with points between its lines, on cubics through them, so that a resonance is round."""
    if response.size < 3:
        return response
    slope = np.gradient(response)
    t = np.arange(FINER)[:, None] / FINER
    a, b, da, db = response[:-1], response[1:], slope[:-1], slope[1:]
    between = a + t * (da + t * (3.0 * (b - a) - 2.0 * da - db + t * (2.0 * (a - b) + da + db)))
    return np.append(between.T.ravel(), response[-1])


def _visible(response: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Parts of a curve inside of the picture and one point around; the rest is cut out."""
    low, high, bottom, top = REACH
    near = (
        (np.real(response) > low)
        & (np.real(response) < high)
        & (np.imag(response) > bottom)
        & (np.imag(response) < top)
    )
    near = near | np.roll(near, 1) | np.roll(near, -1)
    bounded = np.clip(np.real(response), 4 * low, 4 * high), np.clip(np.imag(response), 4 * bottom, 4 * top)
    return np.where(near, bounded[0], np.nan), np.where(near, bounded[1], np.nan)


def _at(margins: Margins, frequency: float) -> complex:
    L = margins.loop_gain
    x = np.log(L.frequency)
    return complex(
        np.interp(np.log(frequency), x, np.real(L.response)), np.interp(np.log(frequency), x, np.imag(L.response))
    )


def encirclement_chart(encirclement: Encirclement) -> Chart:
    """Nyquist plot of the measured or modelled loop gain."""
    return nyquist_chart(margins_of(encirclement.loop_gain))
