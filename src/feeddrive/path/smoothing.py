"""Recorded setpoints, smoothed: a planner that jumps in acceleration or jerk, with derivatives to snap.

    q(t) = Σ c_k B₆(t/h - k),    c = p averaged four times over n rows

p are the recorded positions, one every h; B₆ is the B-spline of sixth order (degree five) on whole numbers.  q has
four continuous derivatives, all of them known exactly.  It moves by nothing in time.  Where p is a straight line in
time q is p; where p has the acceleration a, q lies off by a h² ((n² - 1)/6 + 1/4): on a circle of radius R at the speed
v inside by v²/R times that.

When not: to hide that a planner exceeds its limits; the peaks of its steps become lower, over 4 n h.
"""

from __future__ import annotations

import numpy as np

_AVERAGES = 4


def reach(average: int) -> int:
    """Return the number of rows on each side of an instant that act on it."""
    return _AVERAGES * (average - 1) // 2 + 3


def smoothed(position: np.ndarray, sample_time: float, average: int, times: np.ndarray) -> np.ndarray:
    """Return position .. snap of one axis at times (s, from the first row on), m .. m/s⁴, shape (n, 5).

    position  m, one row every `sample_time` s; before the first and after the last row it rests, so that the motion
              begins up to `reach` rows before and ends as many after
    average   rows of each of the four averages, 1 or more
    """
    from scipy.interpolate import BSpline

    around = 2 * reach(average)
    points = np.pad(position, around, mode="edge")
    for _ in range(_AVERAGES):
        sums = np.cumsum(np.concatenate([[0.0], points - points[0]]))
        points = points[0] + (sums[average:] - sums[:-average]) / average
    # the first point now lies 2 (average - 1) rows after the first of those that were put before
    knots = (2 * (average - 1) - around - 3 + np.arange(len(points) + 6)) * sample_time
    curve = BSpline(knots, points, 5)
    inside = np.clip(times, knots[5], knots[-6])
    return np.stack([curve.derivative(k)(inside) if k else curve(inside) for k in range(5)], axis=1)
