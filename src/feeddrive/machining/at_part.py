"""The samples of a cut that lie on the finished part: the tool's motion beside it leaves nothing that is measured.

A tool that cuts with its side leaves the wall that it touches at its radius R beside the path p:

    w(t) = p(t) + R n(t),   n to the work: right of the feed in down milling, left of it in up milling (M3)

A point of that wall belongs to the part if

1. no other place of the same cut takes it away:   min over s of |w(t) - p(s)| >= R.  A lead-in, a lead-out and the
   corners of the path around an outer corner of the part, where the tool touches nothing, fail this.
2. it lies on that side of the closed path on which most of the wall lies: inside of a path around the part, outside of
   a path in a pocket.  Lead-in and lead-out from the other side fail this.

A cut along an edge goes around nothing and counts whole: where its part ends is not known.
"""

from __future__ import annotations

import numpy as np

from feeddrive.machining.contour import size, unit

_TOUCHES = 5e-3  # of the radius: rounded corners and the distance between samples
_APART = 1e-2  # of the radius, between the places from which the wall is looked at: 5e-5 / 4 of it in the distance
_CORNERS = 300  # of the polygon that decides what lies inside: as many places of the path as that


def on_part(position: np.ndarray, velocity: np.ndarray, radius: float, milling: str) -> np.ndarray:
    """Return whether each sample of one cut leaves a wall of the part, shape (n,).

    position, velocity  of the set point in the plane of the cut, m and m/s, shape (n, 2); a place where it stands
                        leaves no wall
    radius              of the tool, m
    milling             up or down, with a spindle that turns clockwise
    """
    from scipy.spatial import KDTree

    feed = unit(velocity)
    to_right = np.column_stack([feed[:, 1], -feed[:, 0]])
    wall = position + radius * (to_right if milling == "down" else -to_right)
    step = float(np.max(size(np.diff(position, axis=0)), initial=0.0))
    stride = max(1, int(_APART * radius / step)) if step > 0.0 else 1
    nearest, _ = KDTree(position[::stride]).query(wall)
    speed = size(velocity)
    stays = (speed > 0.0) & (nearest >= radius * (1.0 - _TOUCHES))
    inside = enclosed(wall, position)
    around = float(np.sum(speed[stays & inside])) >= float(np.sum(speed[stays & ~inside]))
    return stays & (inside if around else ~inside)


def enclosed(points: np.ndarray, path: np.ndarray) -> np.ndarray:
    """Return whether a path, closed by a straight line, goes around each point: its winding number is not 0.

    points  shape (n, 2); path  shape (m, 2)
    """
    polygon = path[:: max(1, len(path) // _CORNERS)]
    begin, end = polygon, np.roll(polygon, -1, axis=0)
    turns = np.zeros(len(points), dtype=np.int64)
    for (x0, y0), (x1, y1) in zip(begin, end, strict=True):
        if y0 == y1:
            continue
        low, high, sign = (y0, y1, 1) if y0 < y1 else (y1, y0, -1)
        crosses = (points[:, 1] >= low) & (points[:, 1] < high)
        at = x0 + (points[crosses, 1] - y0) * (x1 - x0) / (y1 - y0)
        turns[np.flatnonzero(crosses)[at > points[crosses, 0]]] += sign
    return turns != 0
