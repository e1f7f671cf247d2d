"""Pictures of a certificate: the margin against the discs over frequency, and the discs in the complex plane."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from feeddrive.language.quantity import Quantity, unit_name
from feeddrive.language.text import Text
from feeddrive.plot.chart import ALERT, BAR, FREQUENCY, LOG, PLUS, Band, Chart, Curve, Level, Mark, Note, Panel
from feeddrive.plot.drawing import figure_of

if TYPE_CHECKING:
    from feeddrive.certificate.certificate import Certificate
    from feeddrive.certificate.discs import LoopResponse

_MOST = 6  # rows of one picture
_DECADES = 3.0  # below the smallest reserve, the range that is shown
_DISCS = 500  # drawn in the complex plane
_REACH = (-2.4, 1.2, -1.9, 1.7)  # of the discs: left, right, low, high


def certificate_chart(certificate: Certificate) -> Chart:
    """|1 + L|/|L| of each plant over the certified radius, the plants with the smallest reserve first.

    With two rates 1/Σ|H| instead, over the force at a frequency and its images that a sine of 1 N there adds to.
    """
    plants = sorted(certificate.document["plants"], key=lambda plant: plant["reserve"] or np.inf)[:_MOST]
    nyquist = 0.5 / certificate.sample_time
    low = min(max(plant["reserve_at_Hz"] * 10.0**-_DECADES, 1e-4 * nyquist) for plant in plants)
    panels = tuple(_room(certificate, plant, low, named=len(plants) > 1, first=plant is plants[0]) for plant in plants)
    return Chart(f"frequency ({unit_name('Hz')})", panels, FREQUENCY, low, nyquist, height=1.0 + 2.2 * len(plants))


certificate = figure_of(certificate_chart)


def _room(certificate: Certificate, plant: Any, low: float, *, named: bool, first: bool) -> Panel:
    """The panel of one plant: its distance from -1, the part of it that the discs take, and the measured bands."""
    loop = certificate.loops[plant["name"]]
    f = loop.lines()
    f = f[f >= low]
    distance, taken = loop.room(f)
    size = loop.size(f)
    near, radius = distance / size, taken / size
    least = float(np.min(near))
    floor = max(0.5 * min(least, float(np.min(radius)) or 1.0), 1e-3 * least)
    names = ("1/Σ|H|" if certificate.two_rates else "|1 + L|/|L|", "radius r of the discs") if first else ("", "")
    curves = [Curve(f, near, names[0], 0), Curve(f, radius, names[1], 1)]
    curves += [Curve(np.array(band), np.full(2, 1.08 * floor), number=2, look=BAR) for band in _measured(plant)]
    marks, caption = list[Mark](), "no disc"
    if plant["reserve"] is not None:
        place = np.array([plant["reserve_at_Hz"]])
        marks.append(Mark(float(place[0]), float((loop.room(place)[0] / loop.size(place))[0]), 0))
        caption = Text(
            f"discs could be {Quantity(plant['reserve']):3} times as wide, at {Quantity(plant['reserve_at_Hz'], 'Hz')}"
        )
    return Panel(
        "relative size",
        tuple(curves),
        tuple(marks),
        bands=(Band(f, np.full(f.size, floor), radius, 1),),
        scale=LOG,
        low=floor,
        high=30.0 * max(1.0, least),
        caption=Text(f"{plant['name']}: {caption}") if named else caption,
    )


def _measured(plant: Any) -> list[tuple[float, float]]:
    """The bands in which a plant was measured."""
    return [(lines[0][0], lines[-1][0]) for lines in plant["lines"] if lines]


def certificate_discs_chart(certificate: Certificate) -> Chart:
    """L of the plant with the smallest reserve near -1, with the disc in which it may lie at each frequency."""
    plant = min(certificate.document["plants"], key=lambda candidate: candidate["reserve"] or np.inf)
    loop: LoopResponse = certificate.loops[plant["name"]]
    f = loop.lines()
    L = loop.gains(f).sum(axis=0)
    taken = loop.room(f)[1]
    near = (np.abs(L.real + 0.6) < 2.5 + taken) & (np.abs(L.imag) < 2.5 + taken) & (taken < 4.0)
    walked = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(L[near])))])
    keep = np.unique(np.searchsorted(walked, np.linspace(0.0, walked[-1], _DISCS)).clip(0, walked.size - 1))
    may, reach = L[near][keep], taken[near][keep]
    curves = (
        Curve(may.real, may.imag, "where L may lie", 1, reach=reach),
        Curve(np.clip(L.real, -20, 20), np.clip(L.imag, -20, 20), "L of the model", 0),
        Curve(np.array([-1.0]), np.array([0.0]), number=ALERT, look=PLUS),
    )
    axes = Level(0.0, faint=True), Level(0.0, upright=True, faint=True)
    left, right, low, high = _REACH
    note = Note(-1.0, 0.0, "-1", ALERT)
    panel = Panel("imaginary part of L", curves, levels=axes, notes=(note,), low=low, high=high, caption=plant["name"])
    return Chart("real part of L", (panel,), low=left, high=right, square=True, height=5.2, width=5.8)


certificate_discs = figure_of(certificate_discs_chart)
