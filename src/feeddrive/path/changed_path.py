"""The proof that a proven plan plus a change of splines keeps velocity to snap of an axis in continuous time.

    q = p + Σ c_i N_i                p planned and proven: |p''''| <= S, |p'''| <= J everywhere; N of degree 5, knots h
    q'''' in [t_k, t_k + T]          <= S + |change''''|
    q'''                             <= min(J + |change'''|, |q'''| at both ends + (T/2) bound of q'''')
    q''                              <= |q''| at both ends + (T²/8) bound of q''''
    q'                               <= |q'| at both ends + (T²/8) bound of q'''

Knots are samples, so that the fourth derivative of the change is linear between two samples and largest at one, and the
third one exceeds its samples by T²/8 times the fifth at most.  The change is evaluated from its coefficients alone,
over the whole motion, where the fit adds shifted samples of one spline.
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
    jerk, snap, fifth = (_at_ends(_derivative(coefficients, spacing, T, order, n)) for order in (3, 4, 5))
    jerk += T * T / 8.0 * fifth
    snap_bound = proven[3] * limits[3] + snap
    ends = [_at_ends(row) for row in rows]
    jerk_bound = np.minimum(proven[2] * limits[2] + jerk, ends[2] + 0.5 * T * snap_bound)
    acceleration_bound = ends[1] + T * T / 8.0 * snap_bound
    velocity_bound = ends[0] + T * T / 8.0 * jerk_bound
    bounds = (velocity_bound, acceleration_bound, jerk_bound, snap_bound)
    return np.array([float(np.max(bound)) for bound in bounds]) / limits


def keeps(use: np.ndarray) -> bool:
    """True if all limits are kept."""
    return bool(np.all(use <= 1.0 + WIDENED))


def _at_ends(row: np.ndarray) -> np.ndarray:
    """Return the larger size at both ends of each interval between two samples, shape (n - 1,)."""
    return np.maximum(np.abs(row[:-1]), np.abs(row[1:]))


def _derivative(coefficients: np.ndarray, spacing: int, T: float, order: int, n: int) -> np.ndarray:
    """Return a derivative of the change at the samples, shape (n,); the fifth one is constant from each knot on."""
    # imported here: a plan without a change starts without it
    from scipy.interpolate import BSpline

    h = spacing * T
    knots = h * np.arange(-_DEGREE, coefficients.size + 1)
    derivative = BSpline(knots, coefficients, _DEGREE).derivative(order)
    values = np.asarray(derivative(T * np.arange(n)), dtype=np.float64)
    # beyond the last spline there is no change
    values[T * np.arange(n) > knots[-_DEGREE - 1]] = 0.0
    if order < _DEGREE:
        return values
    # a sample at a knot may be evaluated on either side of it: both neighbors count
    return np.maximum(np.abs(values), np.maximum(np.abs(np.roll(values, 1)), np.abs(np.roll(values, -1))))
