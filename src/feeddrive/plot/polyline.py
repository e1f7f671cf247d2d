"""Lines on a page: cut at the edge of their panel, and without the points that nobody can see."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

TOLERANCE = 0.05  # points: how far a line without the left-out points may run from the whole one
_PASSES = 8
_COLUMN = 0.5  # points: a long curve over x keeps first, least, largest and last of each column this wide
_FAR = 1e6  # points: beyond any page


def cut(x: np.ndarray, y: np.ndarray, box: Sequence[float]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield the pieces of a line through (x, y), both of shape (n,), that lie in the box (left, top, right, bottom).

    NaN interrupts the line. A piece ends where the line crosses the edge of the box.
    """
    x, y = np.clip(x, -_FAR, _FAR), np.clip(y, -_FAR, _FAR)
    left, top, right, bottom = box
    if x.size > 1 and np.all((x >= left) & (x <= right) & (y >= top) & (y <= bottom)):
        yield x, y
        return
    px, py, dx, dy = x[:-1], y[:-1], np.diff(x), np.diff(y)
    # Liang & Barsky 1984: the part begin..end of each segment that lies on the inner side of all four edges
    begin, end = np.zeros(px.size), np.ones(px.size)
    with np.errstate(divide="ignore", invalid="ignore"):
        for slope, room in ((-dx, px - left), (dx, right - px), (-dy, py - top), (dy, bottom - py)):
            crossing = room / slope
            begin = np.where(slope < 0.0, np.maximum(begin, crossing), begin)
            end = np.where(slope > 0.0, np.minimum(end, crossing), end)
            begin = np.where((slope == 0.0) & (room < 0.0), 2.0, begin)
    kept = np.flatnonzero((begin <= end) & np.isfinite(dx) & np.isfinite(dy))
    if not kept.size:
        return
    apart = (np.diff(kept) > 1) | (end[kept[:-1]] < 1.0) | (begin[kept[1:]] > 0.0)
    for piece in np.split(kept, np.flatnonzero(apart) + 1):
        first, last = piece[0], piece[-1]
        xs, ys = x[first : last + 2].copy(), y[first : last + 2].copy()
        ends = px[last] + end[last] * dx[last], py[last] + end[last] * dy[last]
        xs[0], ys[0] = px[first] + begin[first] * dx[first], py[first] + begin[first] * dy[first]
        xs[-1], ys[-1] = ends
        yield xs, ys


def thinned(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the points of a line that are seen, of points (x, y) of shape (n,) on the page.

    A very long curve over x keeps the first, the least, the largest and the last point of each column of half a point,
    so that every peak stays. Of what is left, no left-out point lies farther than `TOLERANCE` from the new line.
    """
    if x.size * _COLUMN > 8.0 * np.ptp(x) and np.all(np.diff(x) >= 0.0):
        kept = _columns(x, y)
        x, y = x[kept], y[kept]
    for number in range(_PASSES):
        if x.size < 5:
            break
        # every second point is tried; each pass may move the line by its share of the tolerance
        near = _distance(x, y, number % 2) <= TOLERANCE / _PASSES
        if np.count_nonzero(near) < 0.02 * x.size:
            break
        stays = np.ones(x.size, bool)
        stays[1 + number % 2 : -1 : 2][near] = False
        x, y = x[stays], y[stays]
    return x, y


def _columns(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    column = np.floor((x - x[0]) / _COLUMN)
    ends = np.flatnonzero(np.diff(column))
    first, last = np.concatenate([[0], ends + 1]), np.concatenate([ends, [x.size - 1]])
    order = np.lexsort((y, column))
    return np.unique(np.concatenate([first, order[first], order[last], last]))


def _distance(x: np.ndarray, y: np.ndarray, start: int) -> np.ndarray:
    """Return the distance of every second point from the segment between its neighbors."""
    middle = slice(1 + start, -1, 2)
    count = len(range(*middle.indices(x.size)))
    before, after = slice(start, start + 2 * count, 2), slice(start + 2, start + 2 * count + 1, 2)
    ax, ay, bx, by = x[before], y[before], x[after] - x[before], y[after] - y[before]
    px, py = x[middle] - ax, y[middle] - ay
    long = bx * bx + by * by
    # the nearest place of the segment: a spike along the line must not be dropped
    part = np.clip(np.divide(px * bx + py * by, long, out=np.zeros_like(long), where=long > 0.0), 0.0, 1.0)
    return np.hypot(px - part * bx, py - part * by)
