"""The proof that a proven plan plus a change of splines keeps velocity to snap of an axis in continuous time.

    q = p + Σ c_i N_i                p planned and proven: |p''''| <= S, |p'''| <= J everywhere; N of degree 5, knots h
    q'''' in [t_k, t_k + T]          <= S + |change''''|
    q'''                             <= min(J + |change'''|, |q'''| at both ends + (T/2) bound of q'''')
    q''                              <= |q''| at both ends + (T²/8) bound of q''''
    q'                               <= |q'| at both ends + (T²/8) bound of q'''

The derivatives of the change are bounded by the coefficients of their splines, between which they lie (convex hull).
Nothing of the fit is used but its coefficients.
"""

from __future__ import annotations

import numpy as np

from feeddrive.path.proof import WIDENED

_DEGREE = 5


def changed_use(
    rows: np.ndarray, coefficients: np.ndarray, spacing: int, sample_time: float, limits: np.ndarray, proven: np.ndarray
) -> np.ndarray:
    """Return the largest share of each limit that a changed motion of one axis takes in continuous time, shape (4,).

    rows          velocity to snap of the sum of plan and change at the samples, m/s .. m/s⁴, shape (4, n)
    coefficients  those of the change, m; coefficient i belongs to the spline that begins at sample (i - 5) · spacing
    spacing       samples between two knots
    sample_time   T, s
    limits        limits of velocity to snap, shape (4,)
    proven        proven shares of these limits that the plan takes, shape (4,)

    A share above 1 + 1e-9 means that the sum is not proven.
    """
    T, n = sample_time, rows.shape[1]
    jerk, snap = (_hull(coefficients, spacing, T, order, n) for order in (3, 4))
    snap_bound = proven[3] * limits[3] + snap
    ends = [np.maximum(np.abs(row[:-1]), np.abs(row[1:])) for row in rows]
    jerk_bound = np.minimum(proven[2] * limits[2] + jerk, ends[2] + 0.5 * T * snap_bound)
    acceleration_bound = ends[1] + T * T / 8.0 * snap_bound
    velocity_bound = ends[0] + T * T / 8.0 * jerk_bound
    bounds = (velocity_bound, acceleration_bound, jerk_bound, snap_bound)
    return np.array([float(np.max(bound)) for bound in bounds]) / limits


def keeps(use: np.ndarray) -> bool:
    """True if all limits are kept."""
    return bool(np.all(use <= 1.0 + WIDENED))


def _hull(coefficients: np.ndarray, spacing: int, T: float, order: int, n: int) -> np.ndarray:
    """Return a bound on |derivative| of the change over each interval between two samples, shape (n - 1,)."""
    change = coefficients
    for _ in range(order):
        change = np.diff(change, prepend=0.0, append=0.0)
    size = np.abs(change) / (spacing * T) ** order
    # the derivative is a spline of degree 5 - order: entry i of `size` is of the one that begins at knot i - 5, and
    # over the span from knot m to m + 1 only those that begin at m - degree .. m differ from 0
    degree = _DEGREE - order
    knots = np.arange(n - 1) // spacing
    bound = np.zeros(n - 1)
    for back in range(degree + 1):
        i = knots + _DEGREE - back
        bound = np.maximum(bound, np.where(i < size.size, size[np.minimum(i, size.size - 1)], 0.0))
    return bound
