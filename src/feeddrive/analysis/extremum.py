"""Where a sampled curve is least: the vertex of the parabola through the least point and its neighbors."""

from __future__ import annotations

import numpy as np


def least(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Place and value of the minimum of y(x), both of shape (n,), n >= 1; at an end of the range that end itself."""
    k = int(np.argmin(y))
    if k in (0, y.size - 1):
        return float(x[k]), float(y[k])
    left, right = x[k - 1] - x[k], x[k + 1] - x[k]
    slope_left, slope_right = (y[k - 1] - y[k]) / left, (y[k + 1] - y[k]) / right
    bend = (slope_right - slope_left) / (right - left)
    if not bend > 0.0:
        return float(x[k]), float(y[k])
    slope = slope_left - bend * left
    step = -0.5 * slope / bend
    # the neighbors are not lower, so the vertex lies within half an interval; rounding must not take it below zero
    return float(x[k] + step), float(y[k] + 0.5 * slope * step)
