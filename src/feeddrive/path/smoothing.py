"""Smoothing of recorded setpoints whose acceleration or jerk jumps, with exact derivatives up to snap.

    q(t) = Σ c_k B₆(t/h - k),    c = p averaged four times over n rows

p are the recorded positions with spacing h in time; B₆ is the B-spline of sixth order (degree five) on integer knots.
q has four continuous derivatives, all known exactly, and no delay.  Where p is linear in time, q equals p; where p has
the acceleration a, q deviates by a h² ((n² - 1)/6 + 1/4): at the speed v, q lies inside a circle of radius R by this
amount with a = v²/R.

Do not use it to hide that a planner exceeds its limits; smoothing lowers the peaks only because it spreads the
planner's jumps over 4 n h.
"""

import numpy as np

_AVERAGES = 4


def reach(average: int) -> int:
    """Return the number of rows on each side of an instant that influence q there."""
    return _AVERAGES * (average - 1) // 2 + 3


def smoothed(position: np.ndarray, sample_time: float, average: int, times: np.ndarray) -> np.ndarray:
    """Return the position to snap of one axis at times (s, from the first row on), m .. m/s⁴, shape (n, 5).

    position  m, one row every `sample_time` s; constant before the first and after the last row, so that the motion
              starts up to `reach` rows earlier and ends as many later
    average   number of rows of each of the four averages, 1 or more
    """
    # imported late: scipy loads slowly, and only recorded setpoints are smoothed
    from scipy.interpolate import BSpline

    around = 2 * reach(average)
    points = np.pad(position, around, mode="edge")
    for _ in range(_AVERAGES):
        # relative to the first row: sums of absolute positions would lose digits
        sums = np.cumsum(np.concatenate([[0.0], points - points[0]]))
        points = points[0] + (sums[average:] - sums[:-average]) / average
    # the first point is now 2 (average - 1) rows after the first padded one
    knots = (2 * (average - 1) - around - 3 + np.arange(len(points) + 6)) * sample_time
    curve = BSpline(knots, points, 5)
    inside = np.clip(times, knots[5], knots[-6])
    return np.stack([curve.derivative(k)(inside) if k else curve(inside) for k in range(5)], axis=1)
