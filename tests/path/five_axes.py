"""Paths of three linear and two rotary axes for the tests of the planner."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from feeddrive.path.program.blocks import Line
from feeddrive.path.program.moves import Feed, Move, PathMode, Straight

# X Y Z in m/s .. m/s⁴, A and C in rad/s .. rad/s⁴
TRUNNION = np.array([[0.5, 5.0, 100.0, 5e4]] * 3 + [[5.0, 30.0, 600.0, 3e5], [10.0, 50.0, 1000.0, 5e5]])
PIVOT = -0.08  # m, from the A axis to the zero of the table
_COLUMNS = [0, 1, 2, 3, 5]


def blade(points: int = 2500) -> tuple[np.ndarray, np.ndarray]:
    """The tip, m, and the joints X Y Z A C of an AC trunnion, m and rad, along five zigzag passes over a blade."""
    u = np.linspace(0.0, 5.0, points)
    passes = np.minimum(np.floor(u), 4.0)
    f = np.where(passes % 2 == 1, 1.0 - (u - passes), u - passes)
    f = 0.5 * (1.0 - np.cos(np.pi * f))
    x, y = 0.08 * (f - 0.5), 0.012 * np.sin(2.0 * np.pi * f) + 0.004 * np.sin(6.0 * np.pi * f)
    z = 0.02 + 0.004 * u
    a = np.radians(35.0 + 15.0 * np.sin(2.0 * np.pi * f + 0.3 * u))
    c = np.radians(60.0 * np.sin(2.0 * np.pi * f) + 15.0 * np.cos(4.0 * np.pi * f))
    turned, high = np.sin(c) * x + np.cos(c) * y, z + PIVOT
    joints = [
        np.cos(c) * x - np.sin(c) * y,
        np.cos(a) * turned - np.sin(a) * high,
        np.sin(a) * turned + np.cos(a) * high,
    ]
    return np.stack([x, y, z], axis=1), np.stack([*joints, a, c], axis=1)


def blocks(joints: np.ndarray, feeds: np.ndarray, tolerance: float) -> Iterator[Move]:
    """Straight moves through joints X Y Z A C, shape (n, 5); the feeds of the linear axes, m/s, shape (n - 1,)."""
    whole = np.zeros((len(joints), 9))
    whole[:, _COLUMNS] = joints
    yield PathMode(Line("blade", 1, ""), "continuous", tolerance, tolerance)
    for number, (start, end) in enumerate(pairwise(map(tuple, whole.tolist())), 2):
        line = Line("blade", number, "")
        yield Feed(line, float(feeds[number - 2]), float(feeds[number - 2]))
        yield Straight(line, start, end, False)


def tip_feeds(tip: np.ndarray, joints: np.ndarray, feed: float) -> np.ndarray:
    """The feeds of the linear axes at which the tip moves at `feed`, m/s."""
    ways = [np.linalg.norm(np.diff(points[:, :3], axis=0), axis=1) for points in (joints, tip)]
    return feed * ways[0] / ways[1]


def farthest(points: np.ndarray, path: np.ndarray) -> np.ndarray:
    """The largest distances of points from a polyline, in the linear and in the rotary axes, shape (2,).

    Both are taken at the nearest line; the caller divides each coordinate by its tolerance.
    """
    worst = np.zeros(2)
    begins, ways = path[:-1], np.diff(path, axis=0)
    squares = np.einsum("kn,kn->k", ways, ways)
    for point in points:
        share = np.clip(np.einsum("kn,kn->k", point - begins, ways) / squares, 0.0, 1.0)
        apart = point - begins - share[:, None] * ways
        nearest = apart[np.argmin(np.einsum("kn,kn->k", apart, apart))]
        worst = np.maximum(worst, [np.linalg.norm(nearest[:3]), np.linalg.norm(nearest[3:])])
    return worst
