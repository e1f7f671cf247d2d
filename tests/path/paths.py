"""Paths for the tests of the planner."""

from __future__ import annotations

import numpy as np

from feeddrive.path.pieces import ARC, LINE, POLYNOMIAL, Pieces

# m/s, m/s², m/s³, m/s⁴ of each of three axes
LIMITS = np.array([[0.5, 5.0, 100.0, 5e4]] * 3)


def lines(points: np.ndarray, feed: float) -> Pieces:
    """A polyline, shape (n + 1, N)."""
    points = np.asarray(points, float)
    moves = np.diff(points, axis=0)
    n, axes = moves.shape
    shape = np.zeros((n, axes, 8))
    shape[:, :, 1] = moves
    length = np.linalg.norm(moves, axis=1)
    return Pieces(np.full(n, LINE), length, points[:-1].copy(), shape, np.full(n, float(feed)), np.arange(n))


def arc(center: tuple[float, float], radius: float, begin: float, end: float, feed: float, pitch: float = 0) -> Pieces:
    """An arc in the plane of the first two axes of three, angles in rad; `pitch` is the way of the third axis, m."""
    turn, sense = abs(end - begin), np.sign(end - begin)
    length = float(np.hypot(radius * turn, pitch))
    shape = np.zeros((1, 3, 8))
    shape[0, :2, 0] = radius * np.cos(begin), radius * np.sin(begin)
    shape[0, :2, 1] = -sense * radius * np.sin(begin), sense * radius * np.cos(begin)
    shape[0, 2, 2] = pitch / length
    shape[0, :, 3] = turn / length
    origin = np.array([[center[0] + shape[0, 0, 0], center[1] + shape[0, 1, 0], 0.0]])
    return Pieces(np.array([ARC]), np.array([length]), origin, shape, np.array([float(feed)]), np.array([0]))


def joined_up(*parts: Pieces) -> Pieces:
    """One after the other."""
    return Pieces(*(np.concatenate(each) for each in zip(*parts, strict=True)))


def square(side: float, radius: float, feed: float) -> Pieces:
    """A square with rounded corners in the plane of the first two of three axes, from the end of a corner, m."""
    r, s, quarter = radius, side, 0.5 * np.pi
    ends = [((r, 0), (s - r, 0)), ((s, r), (s, s - r)), ((s - r, s), (r, s)), ((0, s - r), (0, r))]
    centers = [(s - r, r), (s - r, s - r), (r, s - r), (r, r)]
    parts = []
    for k, ((x0, y0), (x1, y1)) in enumerate(ends):
        parts.append(lines(np.array([[x0, y0, 0.0], [x1, y1, 0.0]]), feed))
        parts.append(arc(centers[k], r, (k - 1) * quarter, k * quarter, feed))
    return joined_up(*parts)


def random_curve(draw: np.random.Generator) -> Pieces:
    """Polynomials of seventh degree through random states of r' .. r''' at their ends, from 10 um to 30 mm long."""
    n, axes = int(draw.integers(1, 120)), 3
    step, wild = 10.0 ** draw.uniform(-5.0, -1.5), 10.0 ** draw.uniform(-2.0, 0.0)

    def direction(near: np.ndarray) -> np.ndarray:
        found = near + wild * draw.normal(size=axes)
        return found / np.linalg.norm(found)

    t = direction(np.zeros(axes))
    left, origin = np.array([t, 0.0 * t, 0.0 * t]), np.zeros(axes)
    lengths, origins, shapes = [], [], []
    for k in range(n):
        B = step * np.exp(0.7 * draw.normal())
        new = direction(t)
        bend, twist = 0.5 * draw.normal() * (new - t) / B, wild * draw.normal(size=axes) / B**2
        right = np.array([new, bend, twist]) * (1.0 if k < n - 1 else np.array([[1.0], [0.0], [0.0]]))
        move = 0.5 * (t + new) * B * (1.0 + 0.02 * draw.normal())
        c1, c2, c3 = left[0] * B, left[1] * B**2 / 2, left[2] * B**3 / 6
        # the four others from r, r', r'' and r''' at the end
        system = np.array([[1, 1, 1, 1], [4, 5, 6, 7], [12, 20, 30, 42], [24, 60, 120, 210]], float)
        rest = [move - c1 - c2 - c3, right[0] * B - c1 - 2 * c2 - 3 * c3, right[1] * B**2 - 2 * c2 - 6 * c3]
        high = np.linalg.solve(system, np.array([*rest, right[2] * B**3 - 6 * c3]))
        shape = np.zeros((axes, 8))
        shape[:, 1:] = np.array([c1, c2, c3, *high]).T
        lengths.append(B)
        origins.append(origin.copy())
        shapes.append(shape)
        origin, left, t = origin + shape.sum(axis=1), right, new
    feed = np.full(n, 10.0 ** draw.uniform(-3.0, 1.0))
    return Pieces(np.full(n, POLYNOMIAL), np.array(lengths), np.array(origins), np.array(shapes), feed, np.arange(n))


def random_limits(draw: np.random.Generator) -> np.ndarray:
    """Unequal axes, over decades."""
    return LIMITS * np.exp(draw.normal(size=LIMITS.shape))
