"""The discs |dP/P| <= r(f) of a plant, as steps over frequency: given, or wide enough for all measured lines."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from feeddrive.certificate.plants import NominalPlant
from feeddrive.language.errors import ParameterError

Radius = float | Sequence[tuple[float, float]]
_ALIKE = 1.15  # radii of neighboring lines that become one step


def deviations(lines: int, confidence: float) -> float:
    """How many √variance the disc of a line reaches so that all lines together lie inside with the confidence.

    For a complex normal error P(|dG|² > q var) = e^-q, and q = ln(lines/(1 - confidence)) for all of them (Bonferroni),
    however their errors hang together.
    """
    return math.sqrt(math.log(max(lines, 1) / (1.0 - confidence)))


def given(radius: Radius, nyquist: float) -> list[tuple[float, float]]:
    """Steps (up to Hz, r) from a number, or from points (Hz, r) with straight lines over ln f between them.

    A step has the larger radius of its ends.  Raises ParameterError for radii below 0 and frequencies that do not rise.
    """
    if isinstance(radius, (int, float)):
        if not (np.isfinite(radius) and radius >= 0.0):
            raise ParameterError(f"radius = {radius:g} of a disc, |dP/P|, must be a finite number >= 0")
        return [(nyquist, float(radius))]
    f, r = (np.array([float(point[i]) for point in radius]) for i in (0, 1))
    if f.size == 0 or np.any(~np.isfinite(r)) or np.any(r < 0.0) or np.any(f <= 0.0) or np.any(np.diff(f) <= 0.0):
        raise ParameterError("the radius needs points (Hz, r) with frequencies that rise and radii >= 0")
    steps = np.arange(math.log(f[0]), math.log(f[-1]), 0.02)
    f_all = np.unique(np.concatenate([f, np.exp(steps)]))
    r_all = np.interp(np.log(f_all), np.log(f), r)
    return _steps(f_all, r_all, float(r[0]), float(r[-1]), nyquist, 1.001)


def needed(plant: NominalPlant, reading: int, sure: float) -> np.ndarray:
    """|G - P| + sure √variance over |P| on each measured line of a reading."""
    lines = plant.lines[reading]
    model = plant.model.response(lines.frequency, output=plant.model.outputs[reading]).response
    return (np.abs(lines.response - model) + sure * np.sqrt(lines.variance)) / np.abs(model)


def measured(
    plant: NominalPlant, sure: float, least: float, beyond: float, nyquist: float
) -> list[list[tuple[float, float]]]:
    """For each reading steps that hold every line with its confidence.

    Between two lines the larger of both; below the first one the most of its octave; above the last one the most of its
    octave, and at least `beyond`; nowhere less than `least`.
    """
    found: list[list[tuple[float, float]]] = []
    for reading, lines in enumerate(plant.lines):
        f, r = lines.frequency, np.maximum(needed(plant, reading, sure), least)
        low, high = float(np.max(r[f <= 2.0 * f[0]])), float(np.max(r[f >= 0.5 * f[-1]]))
        found.append(_steps(f, r, low, max(high, beyond), nyquist, _ALIKE))
    return found


def _steps(
    f: np.ndarray, r: np.ndarray, low: float, high: float, nyquist: float, alike: float
) -> list[tuple[float, float]]:
    """Steps from lines: neighbors whose radii differ by less than a factor become one."""
    inside = f < nyquist
    f, r = f[inside], r[inside]
    raw = [(float(f[0]), low), *zip(f[1:].tolist(), np.maximum(r[:-1], r[1:]).tolist(), strict=True), (nyquist, high)]
    made: list[tuple[float, float]] = []
    least = math.inf
    for to, radius in raw:
        radius = _up(radius)
        if made and max(made[-1][1], radius) <= alike * min(least, radius):
            made[-1] = to, max(made[-1][1], radius)
            least = min(least, radius)
        else:
            made.append((to, radius))
            least = radius
    return made


def _up(radius: float) -> float:
    """Four digits, upwards."""
    if radius == 0.0:
        return 0.0
    unit = 10.0 ** (math.floor(math.log10(radius)) - 3)
    return math.ceil(radius / unit - 1e-7) * unit


def together(readings: Sequence[Sequence[tuple[float, float]]]) -> list[dict[str, Any]]:
    """The steps of all readings on common edges, as a certificate holds them."""
    edges = sorted({to for steps in readings for to, _ in steps})
    bands: list[dict[str, Any]] = []
    low = 0.0
    for to in edges:
        r = [next(radius for end, radius in steps if end >= to) for steps in readings]
        if bands and bands[-1]["r"] == r:
            bands[-1]["to_Hz"] = to
        else:
            bands.append({"from_Hz": low, "to_Hz": to, "r": r})
        low = to
    return bands
