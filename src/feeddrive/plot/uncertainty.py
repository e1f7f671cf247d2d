"""Uncertainty of a measured or identified response in a picture: 95 % bands, and shading of untrusted lines."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from feeddrive.language.quantity import DRAWN, Quantity, Units
from feeddrive.language.text import Text
from feeddrive.loop.frequency_response import FRF, TRUSTED
from feeddrive.plot import style
from feeddrive.plot.chart import Band, Curve, Level, Panel

_LEAST = 0.1  # of a magnitude: a band that reaches below is cut off there
_FAR = 1e4  # dB or degrees beyond all panels


def magnitude_band(
    frf: FRF, number: int, units: Units = DRAWN, name: str = "", *, factor: float = 1.0, model: bool = False
) -> tuple[Band, ...]:
    """|G| - r to |G| + r with the radius r of the 95 % disc; none without a variance.

    factor  from the unit of the response to the one that is shown
    model   the error comes from few real parameters and may lie along one direction: r is then 1.96 √variance
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
    from feeddrive.identification.estimate import NORMAL

    return NORMAL * np.sqrt(frf.variance)


def phase_band(
    frf: FRF, phase: np.ndarray, number: int, units: Units = DRAWN, *, model: bool = False
) -> tuple[Band, ...]:
    """The band ± arcsin(r/|G|) around a phase in degrees, r as in `magnitude_band`; none without a variance."""
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
    """Stretches of frequency in which a coherence is 0.9 or less, over the whole height of a panel.

    ratio  the panel has a logarithmic scale, as of gains that are not in dB
    """
    parts = list[tuple[float, float]]()
    for low, high in sorted(stretch for frf in responses for stretch in _stretches(frf)):
        if parts and low <= parts[-1][1]:  # what two of them share is shaded once
            low, high = parts[-1][0], max(high, parts.pop()[1])
        parts.append((low, high))
    if not parts:
        return ()
    x = units.of("Hz")[1] * np.concatenate([[low, high, np.nan] for low, high in parts])
    low, high = (10.0 ** (-_FAR / 1e3), 10.0 ** (_FAR / 1e3)) if ratio else (-_FAR, _FAR)
    gap = np.isnan(x)
    return (Band(x, np.where(gap, np.nan, low), np.where(gap, np.nan, high), name=name),)


def _stretches(frf: FRF) -> list[tuple[float, float]]:
    """First and last frequency in Hz of each row of lines that are not trusted, up to half way to the next line."""
    if frf.coherence is None:
        return []
    low = frf.coherence <= TRUSTED
    edges = np.sqrt(frf.frequency[1:] * frf.frequency[:-1])
    edges = np.concatenate([frf.frequency[:1], edges, frf.frequency[-1:]])
    begins = np.flatnonzero(low & ~np.append(False, low[:-1]))
    ends = np.flatnonzero(low & ~np.append(low[1:], False))
    return [(float(edges[a]), float(edges[b + 1])) for a, b in zip(begins, ends, strict=True)]


def coherence_panels(responses: Iterable[tuple[int, FRF]], units: Units = DRAWN) -> tuple[Panel, ...]:
    """A panel with the coherences, and the least one with which a tuning uses a line; none without a coherence."""
    known = [(i, frf) for i, frf in responses if frf.coherence is not None]
    if not known:
        return ()
    curves = tuple(Curve(units.of("Hz")[1] * frf.frequency, np.asarray(frf.coherence), number=i) for i, frf in known)
    level = Level(TRUSTED, dashed=True)
    shaded = doubtful((frf for _, frf in known), units, name=Text(f"coherence {Quantity(TRUSTED)} or less"))
    return (Panel("coherence", curves, levels=(level,), bands=shaded, low=0.0, high=1.05),)
