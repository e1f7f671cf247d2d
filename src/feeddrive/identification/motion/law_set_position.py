"""Set positions that were rounded in a log: the path before rounding, and how far it is off."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from feeddrive.identification.motion.law_rows import Signals, widened

_DIFFERENCES = 4  # of a set position that are small but at few instants, as where a planner changes its jerk
_SOFT, _HARD = -2.0, 14.0  # decades of λ, between which the smoothness of a set position is searched
_STIFFEST = 1e12  # λ g: more is lost in the digits of the solution; 200 samples are smoothed then
_REWEIGHTED = 6  # searches for the smoothness, each with the weights of the last; after 4 they change little
_AROUND = 1.5  # decades about the last smoothness that are searched then
_HALVINGS = 10  # of such a range, to a fiftieth of a decade
_BENT = 0.2  # of the RMS of the fourth differences, beyond which one is a bend; 0.1 and 0.3 do as well
_LITTLE = 1e-20  # counts²: fourth differences that are 0
_OUTSIDE = 4  # power of the distance from the rounded value, in half counts, by which a sample beyond it weighs more
_FORGOTTEN = 0.9  # of such a weight that stays when the sample is within
_RESTS = 50  # samples before and after, in which a set position that rests does not change
_DITHERS = (0.25, 0.75)  # counts by which a path is moved before it is rounded again; at 0.5 a rest is between two


def restored(signals: Signals, count: float) -> Signals:
    """Return signals with the set position before rounding, and others that are as likely.

    The others are the first one, rounded to other values and restored again (a parametric bootstrap): they are as far
    from it as it is from the truth.
    """
    smooth = steadied(signals.wanted, count)
    first = signals.wanted[0]

    def others() -> Iterator[np.ndarray]:
        for dither in _DITHERS:
            rounded = np.rint((smooth - first) / count + dither) - dither
            yield steadied(first + count * rounded, count)

    speed = np.abs(np.diff(smooth, prepend=smooth[0])) / signals.T
    rests = ~widened(np.diff(signals.wanted, prepend=first) != 0.0, _RESTS, _RESTS)
    resting = float(np.max(speed[rests], initial=0.0))
    return replace(signals, wanted=smooth, others=tuple(others()), resting=resting)


def steadied(values: np.ndarray, count: float) -> np.ndarray:
    """Return an estimate of a set position before rounding: the smoothest one within the rounding errors.

        minimize Σ w (s - rounded)² + λ Σ g (fourth difference of s)²,   g = t² / (t² + (fourth difference of s)²)

    λ is such that the RMS of s - rounded in motion is that of rounding errors, count/√12 (Whittaker-Henderson
    smoothing). Planners change jerk, or acceleration, at few instants, at which the fourth difference is large: the
    weights g, of a heavy-tailed (Cauchy) distribution with t a share of the RMS, let the path bend there and nowhere
    else. w grows where the path leaves the half count of rounding. Both are iterated.
    """
    from scipy.linalg import solveh_banded  # takes a second to import

    n, weights = values.size, np.array([math.comb(_DIFFERENCES, k) * (-1.0) ** k for k in range(_DIFFERENCES + 1)])
    moves = widened(np.diff(values, prepend=values[0]) != 0.0, _DIFFERENCES, _DIFFERENCES)
    # in counts; `off` is s - rounded, which keeps its digits, as s itself would not
    rough = np.diff((values - values[0]) / count, _DIFFERENCES)
    bends, trust, off = np.ones(rough.size), np.ones(n), np.zeros(n)

    def solved(stiffness: float) -> np.ndarray:
        stiff = np.minimum(10.0**stiffness * bends, _STIFFEST)
        matrix = np.zeros((_DIFFERENCES + 1, n))
        matrix[-1] = trust
        for i in range(_DIFFERENCES + 1):
            for j in range(i, _DIFFERENCES + 1):
                matrix[_DIFFERENCES - (j - i), j : n - _DIFFERENCES + j] += weights[i] * weights[j] * stiff
        return np.asarray(solveh_banded(matrix, -np.convolve(stiff * rough, weights), check_finite=False))

    low, high = _SOFT, _HARD
    for _ in range(_REWEIGHTED):
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            tried = solved(middle)
            if np.sqrt(np.mean(tried[moves] ** 2)) > 1.0 / np.sqrt(12.0):
                high = middle
            else:
                low, off = middle, tried
        low, high = low - _AROUND, low + _AROUND
        bent = (rough + np.diff(off, _DIFFERENCES)) ** 2
        size = _BENT**2 * float(np.mean(bent)) + _LITTLE
        bends = size / (size + bent)
        beyond = np.abs(off) / 0.5
        trust = np.where(beyond > 1.0, trust * beyond**_OUTSIDE, np.maximum(1.0, _FORGOTTEN * trust))
    return values + count * off
