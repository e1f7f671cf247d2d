"""Long curves with fewer points that look the same: the least and the most of each stretch are kept."""

from __future__ import annotations

import numpy as np

POINTS = 2000  # more than twice the pixels that a picture is wide


def envelope(x: np.ndarray, y: np.ndarray, points: int = POINTS) -> tuple[np.ndarray, np.ndarray]:
    """At most `points` + 2 of the points (x, y), both of shape (n,): per stretch its lowest and highest, in order.

    First and last point stay.  A curve that is short enough comes back as it is.  No value is invented or averaged, so
    peaks and limits are where they were.  `points` is at least 2.
    """
    n = x.size
    if n <= points:
        return x, y
    edges = np.linspace(0, n, points // 2 + 1).astype(int)
    low = _first_of_stretch(y, edges, np.minimum)
    high = _first_of_stretch(y, edges, np.maximum)
    kept = np.unique(np.concatenate([[0], low, high, [n - 1]]))
    return x[kept], y[kept]


def _first_of_stretch(y: np.ndarray, edges: np.ndarray, extreme: np.ufunc) -> np.ndarray:
    """Index of the first point in each stretch that has the stretch's extreme value."""
    values = extreme.reduceat(y, edges[:-1])
    met = np.flatnonzero(y == np.repeat(values, np.diff(edges)))
    return met[np.searchsorted(met, edges[:-1])]
