"""Quadrant peaks of a circular test: how far a circle springs outward after an axis has reversed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from feeddrive.language.table import Column, Table
from feeddrive.machining.circle_test import CirclePath, CircleTest

NEAR = np.radians(10.0)
"""Of a peak: the angle behind a reversal in which it is looked for, rad; the base is taken from as much before it."""


class QuadrantPeak(NamedTuple):
    """The peak behind one reversal on one circle.

    circle     its place among the circles of the test
    axis, side  that reverses, as "x" and "+": at its most positive or its most negative place
    angle      polar, of the peak, rad, 0 to 2π
    deviation  radial, there, m
    height     of the peak above the mean deviation of the 10° before the reversal, m
    """

    circle: int
    axis: str
    side: str
    angle: float
    deviation: float
    height: float


def deviation(circle: CirclePath, center: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Polar angle about a center, rad, 0 to 2π, and radial deviation from nominal, m, in the order of the motion."""
    dx, dy = circle.x - center[0], circle.y - center[1]
    return np.arctan2(dy, dx) % (2.0 * np.pi), np.hypot(dx, dy) - circle.radius


def deviations(test: CircleTest) -> list[tuple[np.ndarray, np.ndarray]]:
    """`deviation` of each circle, about the center of its figures."""
    centers = [each.center for each in test.figures if not each.both]
    return [deviation(each, center) for each, center in zip(test.circles, centers, strict=True)]


def quadrant_peaks(test: CircleTest) -> list[QuadrantPeak]:
    """Four for each circle, the highest first: the largest outward deviation in the 10° after a reversal."""
    found = list[QuadrantPeak]()
    for k, (circle, (angle, r)) in enumerate(zip(test.circles, deviations(test), strict=True)):
        for quarter in range(4):
            since = circle.direction * (angle - 0.5 * np.pi * quarter)
            since = (since + np.pi) % (2.0 * np.pi) - np.pi
            before, after = (since < 0.0) & (since >= -NEAR), np.flatnonzero((since >= 0.0) & (since <= NEAR))
            if not np.any(before) or not len(after):
                continue
            top = int(after[np.argmax(r[after])])
            axis, side = circle.axes[quarter % 2], "+" if quarter < 2 else "-"
            height = float(r[top] - np.mean(r[before]))
            found.append(QuadrantPeak(k, axis, side, float(angle[top]), float(r[top]), height))
    return sorted(found, key=lambda each: -each.height)


def peaks_table(test: CircleTest) -> Table:
    """Return a table with one row for each circle: the heights behind its four reversals."""
    first = test.circles[0]
    places = [(axis, side) for side in "+-" for axis in first.axes]
    heights = {(peak.circle, peak.axis, peak.side): peak.height for peak in quadrant_peaks(test)}
    rows = [[circle.name, *(heights.get((k, *place)) for place in places)] for k, circle in enumerate(test.circles)]
    title = "quadrant peaks: outward, in the 10° after a reversal, above the mean of the 10° before it"
    return Table(title, ["circle", *(Column(f"{side}{axis}", "m") for axis, side in places)], rows)
