"""Check samples of a planned program against its moves and limits, with nothing of the planner: differences, distances.

A motion q with three continuous derivatives whose q⁽ᵏ⁾ stays within L has differences Δᵏq / Tᵏ within L: they are means
of q⁽ᵏ⁾ over k samples.  The path is followed if the samples can be assigned to the moves in order, each within the
tolerance of its move.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from feeddrive.path.program.moves import Arc, Feed, Move, PathMode, Spline, Straight

WIDER = 1e-9  # of a limit: the planner's proof widens limits by that
_JUMP = 1e-9  # of a limit: the proof allows a derivative to jump by that at a joint
_ROUNDING = 32.0 * 2.0**-53  # of the farthest coordinate and of the way: each place is rounded some ten times
_INSTANT = 4.0 * 2.0**-53  # of the time: k T and the begin of a part are rounded, and the axis moves on meanwhile
_APART = 1e-12  # of a coordinate or 1 m: ends of runs are computed twice
_GRIDS = 48, 3000  # steps of a curve, of which the place nearest to a sample is sought: the finer where the other fails
_KEPT, _ZOOMS = 6, 25  # steps on either side of it, on which a finer grid is laid, and how often: to 1e-15 of the curve
_ROWS = 1500  # samples that are assigned to moves


class Curve(NamedTuple):
    """A move or a part of it, in the machine's axes, from s = `begin` to `end`, where 0 <= s <= 1 is the whole move.

    feed       m/s, inf on a traverse
    tolerance  m
    """

    move: Straight | Arc | Spline
    columns: list[int]
    begin: float
    end: float
    feed: float
    tolerance: float

    def at(self, s: np.ndarray) -> np.ndarray:
        """Return points of the move, shape (n, N)."""
        ends = self.move.start, *(self.move.points if isinstance(self.move, Spline) else ()), self.move.end
        control = [np.array(each)[self.columns] for each in ends]
        point = _bezier(control, s[:, None])
        if isinstance(self.move, Arc):
            center, angle = self.move.center, _angle(self.move)
            plane = [self.columns.index(axis) for axis in self.move.axes[:2]]
            from_center = control[0][plane] - center
            turned = math.atan2(from_center[1], from_center[0]) + angle * np.append(s, 1.0)
            around = center + math.hypot(*from_center) * np.stack([np.cos(turned), np.sin(turned)], axis=1)
            # what a circle about that center misses of the end is gone linearly
            point[:, plane] = around[:-1] + s[:, None] * (control[1][plane] - around[-1])
        return point

    def place(self, s: float) -> np.ndarray:
        """Return the point at s, shape (N,)."""
        return self.at(np.array([s]))[0]

    def away(self, points: np.ndarray, near: float) -> np.ndarray:
        """Return distances of points, m, shape (n,): exact from a line, never too small from a curve.

        From a curve only those are made exact that may be as small as `near`.
        """
        if isinstance(self.move, Straight):
            start, along = self.place(0.0), self.place(1.0) - self.place(0.0)
            s = np.clip((points - start) @ along / (along @ along), 0.0, 1.0)
            return np.linalg.norm(points - self.at(s), axis=1)
        found, some = np.full(len(points), np.inf), np.arange(len(points))
        for fine in _GRIDS:  # where a curve turns back sharply, the nearest place of a coarse grid may be a wrong one
            if len(some):
                away, cell = self._zoomed(points[some], near, fine)
                found[some] = np.minimum(found[some], away)
                some = some[(away > near) & (away <= near + 2.0 * cell)]
        return found

    def _zoomed(self, points: np.ndarray, near: float, fine: int) -> tuple[np.ndarray, np.ndarray]:
        """Return distances from a grid of so many steps and finer ones around the nearest place, and the first step."""
        found, grid = np.full(len(points), np.inf), np.linspace(0.0, 1.0, fine + 1)
        first = np.zeros(len(points))
        begin, end, some = np.full(len(points), self.begin), np.full(len(points), self.end), np.arange(len(points))
        for _ in range(_ZOOMS):
            s = begin[some, None] + grid * (end - begin)[some, None]
            places = self.at(s.ravel()).reshape(*s.shape, points.shape[1])
            away = np.linalg.norm(places - points[some, None], axis=2)
            nearest = np.argmin(away, axis=1)
            found[some] = np.minimum(found[some], away.min(axis=1))
            begin[some] = s[np.arange(len(some)), np.maximum(nearest - _KEPT, 0)]
            end[some] = s[np.arange(len(some)), np.minimum(nearest + _KEPT, len(grid) - 1)]
            cell = np.linalg.norm(np.diff(places, axis=1), axis=2).max(axis=1)
            first[some] = np.where(first[some] > 0.0, first[some], cell)
            some = some[(found[some] > near) & (found[some] <= near + 2.0 * cell)]
            grid = np.linspace(0.0, 1.0, _GRIDS[0] + 1)
            if not len(some):
                break
        return found, first


def _angle(move: Arc) -> float:
    """Return the angle through which an arc turns, rad."""
    first, second, _ = move.axes
    ends = [math.atan2(p[second] - move.center[1], p[first] - move.center[0]) for p in (move.start, move.end)]
    sense = math.copysign(1.0, move.turns)
    once = sense * (ends[1] - ends[0]) % (2.0 * math.pi)
    if (move.start[first], move.start[second]) == (move.end[first], move.end[second]):
        once = 2.0 * math.pi
    return sense * (once + 2.0 * math.pi * (abs(move.turns) - 1))


def _bezier(points: list[np.ndarray], s: np.ndarray) -> np.ndarray:
    """De Casteljau's construction."""
    while len(points) > 1:
        points = [a + s * (b - a) for a, b in pairwise(points)]
    return points[0] + 0.0 * s


def curves(moves: Sequence[Move], columns: list[int]) -> list[Curve]:
    """Return the moves that go somewhere, arcs in quarters of a turn; feeds only where they count along all axes."""
    return list(_curves(moves, columns))


def _curves(moves: Sequence[Move], columns: list[int]) -> Iterator[Curve]:
    feed = tolerance = 0.0
    for move in moves:
        if isinstance(move, PathMode):
            tolerance = move.tolerance if move.mode == "continuous" else 0.0
        elif isinstance(move, Feed):
            feed = move.linear if columns == [0, 1, 2] else math.inf
        elif isinstance(move, Straight | Arc | Spline):
            traverse = isinstance(move, Straight) and move.traverse
            whole = Curve(move, columns, 0.0, 1.0, math.inf if traverse else feed, tolerance)
            if isinstance(move, Straight) and np.array_equal(whole.place(0.0), whole.place(1.0)):
                continue
            parts = 1 if isinstance(move, Straight) else 8
            if isinstance(move, Arc):
                parts = math.ceil(abs(_angle(move)) / (0.5 * math.pi))
            for begin, end in pairwise(np.linspace(0.0, 1.0, parts + 1).tolist()):
                yield whole._replace(begin=begin, end=end)


def check_limits(T: float, values: np.ndarray, limits: np.ndarray, way: float, until: float | None = None) -> None:
    """Raise AssertionError if a derivative, a difference of any order or a step by Taylor's series exceeds its limit.

    values  position, velocity .. snap of each axis, m .. m/s⁴, shape (n, N, 5)
    limits  of velocity .. snap, shape (N, 4)
    way     of the whole path, m
    until   time of the last sample, s; None: the first is at 0
    """
    until = len(values) * T if until is None else until
    assert np.all(np.isfinite(values)), "a sample is not a number"
    use = np.abs(values[:, :, 1:]).max(axis=0) / limits
    assert np.all(use <= 1.0 + WIDER), f"use of limits {use}"
    noise = np.column_stack([_ROUNDING * (np.abs(values[:, :, 0]).max(axis=0) + way), _JUMP * limits[:, :3]])
    noise += _INSTANT * until * np.abs(values[:, :, 1:]).max(axis=0)
    for k in range(4):
        change = values[:, :, k]
        for order in range(1, min(5 - k, len(values))):
            change = np.diff(change, axis=0) / T
            allowed = limits[:, k + order - 1] * (1.0 + WIDER) + (2.0 / T) ** order * noise[:, k]
            seen = np.abs(change).max(axis=0)
            assert np.all(seen <= allowed), f"difference {order} of derivative {k}: {seen}, allowed {allowed}"
    x, v, a, j, s = np.moveaxis(values[:-1], 2, 0)
    ahead = x + T * (v + T * (a / 2.0 + T * (j / 6.0 + T * s / 24.0)))
    # the snap may jump from one limit to the other: 2 L T⁴ / 24
    allowed = limits[:, 3] * T**4 / 12.0 + 2.0 * noise[:, 0] + noise[:, 1:] @ np.array([T, T**2 / 2.0, T**3 / 6.0])
    miss = np.abs(ahead - values[1:, :, 0]).max(axis=0, initial=0.0)
    assert np.all(miss <= allowed), f"samples do not follow from each other: {miss}, allowed {allowed}"


def check_path(T: float, values: np.ndarray, limits: np.ndarray, path: list[Curve], factor: float) -> None:
    """Raise AssertionError if the samples leave the path, its order or its feed, or begin or end elsewhere.

    values  all samples, as of `check_limits`
    factor  the largest of the feed
    """
    start, ends = path[0].place(0.0), np.array([each.place(each.end) for each in path])
    near = _APART * (1.0 + float(max(np.abs(start).max(), np.abs(ends).max())))
    assert np.abs(values[0, :, 0] - start).max() <= near, "it begins elsewhere"
    assert not np.any(values[0, :, 1:4]), "it begins in motion"
    miss = float(np.abs(values[-1, :, 0] - ends[-1]).max())
    assert miss <= near, f"it ends {miss} m away"
    assert not np.any(values[-1, :, 1:]), "it ends in motion"
    some = np.unique(np.linspace(0, len(values) - 1, _ROWS).astype(int))
    points = values[some, :, 0]
    tolerance = np.array([each.tolerance for each in path]) + near
    away = np.stack([each.away(points, far) for each, far in zip(path, tolerance.tolist(), strict=True)], axis=1)
    inside = away <= tolerance
    lost = ~inside.any(axis=1)
    assert not lost.any(), f"sample {some[lost][0]} is {away[lost][0].min()} m away from the path"
    speed = np.linalg.norm(values[some, :, 1], axis=1)
    # the moves before and behind count, too, since corners are passed at the larger feed of both
    around = np.pad(inside, ((0, 0), (1, 1)))
    around = around[:, :-2] | around[:, 1:-1] | around[:, 2:]
    fastest = np.where(around, [each.feed for each in path], 0.0).max(axis=1)
    fast = speed > factor * fastest * (1.0 + WIDER)
    assert not fast.any(), f"sample {some[fast][0]}: {speed[fast][0]} m/s, at most {factor * fastest[fast][0]}"
    # so far a sample may be from where it was between it and the one before
    step = np.diff(some, prepend=0) * T
    step *= speed + step * float(np.linalg.norm(limits[:, 1]))
    passed = np.linalg.norm(points[:, None] - ends, axis=2) <= tolerance + step[:, None]
    reached = np.arange(len(path)) == 0
    for k in range(len(some)):
        front = reached
        while True:
            front = np.append(False, (front & passed[k])[:-1])
            if not (front & ~reached).any():
                break
            reached = reached | front
        reached = reached & inside[k]
        assert reached.any(), f"sample {some[k]} is not behind the one before on the path"
    assert reached[-1], "moves are left out"
