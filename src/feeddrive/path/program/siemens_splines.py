"""Splines of SINUMERIK programs: ASPLINE and CSPLINE through the points of their blocks, BSPLINE near them.

    CSPLINE  twice continuously differentiable, cubic between the points
    ASPLINE  once, by Akima's slopes (J. ACM 17, 589, 1970), each of at most five points
    BSPLINE  B-spline of degree SD (3 or 2), with weights PW, over even knots, along its control polygon at both ends

The first point is the position before.  The parameter of the first two is the sum t of the chords; that of the control
is not documented, and neither are the knots that it takes without PL.  With steps h, chords d = Δx/h and slopes m

    CSPLINE  h₁ m₀ + 2 (h₀ + h₁) m₁ + h₀ m₂ = 3 (h₁ d₀ + h₀ d₁)
    ASPLINE  m = (|d₂ - d₁| d₋₁ + |d₋₁ - d₋₂| d₁) / (|d₂ - d₁| + |d₋₁ - d₋₂|)     of four chords around the point

    BTAN, ETAN    m along the block before or behind
    BNAT, ENAT    2 m₀ + m₁ = 3 d₀: no curvature
    BAUTO, EAUTO  CSPLINE: one cubic on the first two steps; ASPLINE: chords go on evenly beyond the end
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from feeddrive.path.program.blocks import BlockError, Line
from feeddrive.path.program.moves import Command
from feeddrive.path.program.nurbs import MOST_POINTS, Nurbs

KINDS = ("ASPLINE", "BSPLINE", "CSPLINE")
BEGINS, ENDS = ("BAUTO", "BNAT", "BTAN"), ("EAUTO", "ENAT", "ETAN")
MOTIONS = frozenset({"STRAIGHT_FEED", "STRAIGHT_TRAVERSE", "ARC_FEED", "BEZIER_FEED"})
"""The commands that move."""
_SPACE = 3  # X Y Z, the axes of a spline without SPLINEPATH

Row = np.ndarray


class Edges(NamedTuple):
    """How a spline begins and ends; the words stay in effect."""

    begin: str = "BTAN"
    end: str = "ETAN"


def slopes(kind: str, points: Row, edges: Edges, before: Row | None, behind: Row | None) -> Row:
    """Return the derivatives by the sum of chords at the points, shape (n, 3); see the module for the equations.

    points  shape (n, 3), n >= 2, neighbors differ
    before, behind  unit vectors along the blocks at both ends, for BTAN and ETAN
    """
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    chords = np.diff(points, axis=0) / steps[:, None]
    return _akima(chords, edges, before, behind) if kind == "ASPLINE" else _cubic(steps, chords, edges, before, behind)


def _cubic(steps: Row, chords: Row, edges: Edges, before: Row | None, behind: Row | None) -> Row:
    # loading it takes longer than reading most programs
    from scipy.linalg import solve_banded

    count = len(steps) + 1
    upper, middle, lower = np.zeros(count), np.zeros(count), np.zeros(count)
    right = np.zeros((count, chords.shape[1]))
    middle[1:-1] = 2.0 * (steps[:-1] + steps[1:])
    lower[:-2], upper[2:] = steps[1:], steps[:-1]
    right[1:-1] = 3.0 * (steps[1:, None] * chords[:-1] + steps[:-1, None] * chords[1:])
    if edges == Edges("BAUTO", "EAUTO") and count == 3:
        # one parabola: both ends would ask for the same
        inner = (steps[1] * chords[0] + steps[0] * chords[1]) / (steps[0] + steps[1])
        return np.array([2.0 * chords[0] - inner, inner, 2.0 * chords[1] - inner])
    middle[0], upper[1], right[0] = _edge(edges.begin[1:], before, steps, chords)
    middle[-1], lower[-2], right[-1] = _edge(edges.end[1:], behind, steps[::-1], chords[::-1])
    return solve_banded((1, 1), np.array([upper, middle, lower]), right)


def _edge(how: str, tangent: Row | None, steps: Row, chords: Row) -> tuple[float, float, Row]:
    """Return the coefficients of the slope at an end and of its neighbor, and the right-hand side."""
    if how == "TAN":
        assert tangent is not None
        return 1.0, 0.0, tangent
    if how == "NAT" or len(steps) == 1:
        return 2.0, 1.0, 3.0 * chords[0]
    h, k = steps[0], steps[1]
    both = h + k
    return k, both, ((h + 2.0 * both) * k * chords[0] + h * h * chords[1]) / both


def _akima(chords: Row, edges: Edges, before: Row | None, behind: Row | None) -> Row:
    if len(chords) == 1:
        found = np.array([chords[0], chords[0]])
    else:
        first, last = 2.0 * chords[0] - chords[1], 2.0 * chords[-1] - chords[-2]
        wide = np.array([2.0 * first - chords[0], first, *chords, last, 2.0 * last - chords[-1]])
        change = np.abs(np.diff(wide, axis=0))
        left, right = change[2:], change[:-2]
        whole = left + right
        even = 0.5 * (wide[1:-2] + wide[2:-1])
        # chords that do not change on both sides have no weights: the mean, as in Akima's paper
        flat = whole <= 1e-9 * np.max(whole, initial=0.0)
        found = np.where(flat, even, (left * wide[1:-2] + right * wide[2:-1]) / np.where(flat, 1.0, whole))
    for at, next_, chord, how, tangent in (
        (0, 1, chords[0], edges.begin[1:], before),
        (-1, -2, chords[-1], edges.end[1:], behind),
    ):
        if how == "TAN":
            found[at] = tangent
        elif how == "NAT":
            found[at] = 0.5 * (3.0 * chord - found[next_])
    return found


def tangents(command: Command, start: Sequence[float], plane: tuple[int, int, int]) -> tuple[Row | None, Row | None]:
    """Return the unit vectors at the start and the end of a motion, in X Y Z; None for one without length there."""
    values = np.array(command.values, float)
    begin = np.array(start[:_SPACE], float)
    if command.name == "ARC_FEED":
        first, second, across = plane
        end, center = values[:2], values[2:4]
        sense, found = math.copysign(1.0, values[4]), []
        from_center = [np.array([start[first], start[second]]) - center, end - center]
        turned = math.atan2(
            from_center[0][0] * from_center[1][1] - from_center[0][1] * from_center[1][0],
            float(from_center[0] @ from_center[1]),
        )
        angle = (sense * turned - 1e-12) % math.tau + 1e-12 + math.tau * (abs(values[4]) - 1.0)
        for x, y in from_center:
            way = np.zeros(_SPACE)
            way[first], way[second], way[across] = -sense * y, sense * x, (values[5] - start[across]) / angle
            found.append(_unit(way))
        return found[0], found[1]
    points = [begin, *(values[k : k + _SPACE] for k in range(0, len(values), 9))]
    return _unit(points[1] - points[0]), _unit(points[-1] - points[-2])


def _unit(way: Row) -> Row | None:
    length = float(np.linalg.norm(way))
    return way / length if length > 0.0 else None


class PointSpline:
    """A spline whose points are being read; commands between them wait until it is known how it ends.

    kind    a name of `KINDS`; degree: of BSPLINE
    start   position before it, in the program's unit and coordinates
    edges   how it begins and ends
    before  unit vector along the block before it, if there is one
    unit    mm per unit of the points
    write   function that takes the finished commands
    """

    def __init__(
        self,
        kind: str,
        start: Sequence[float],
        degree: int,
        edges: Edges,
        before: Row | None,
        unit: float,
        write: Callable[[Command], None],
    ) -> None:
        self.kind, self._degree, self._before, self._unit, self._write = kind, degree, before, unit, write
        self._points = [list(start)]
        self._weights = [1.0]
        self._lines: list[Line] = []
        self._behind: list[list[Command]] = [[]]
        self._edges = edges
        self.closed = False  # True once another motion is chosen: the next point belongs to another spline

    def end_by(self, word: str) -> None:
        """Choose how it ends: EAUTO, ENAT or ETAN."""
        self._edges = self._edges._replace(end=word)

    @property
    def end(self) -> list[float]:
        """The last point."""
        return self._points[-1]

    def add(self, line: Line, point: Sequence[float], weight: float | None) -> None:
        """Add the point of a block."""
        if len(self._points) > MOST_POINTS:
            raise BlockError(f"a spline has at most {MOST_POINTS} points: split it by G1", self.kind)
        if weight is not None and (self.kind != "BSPLINE" or not 0.0 < weight <= 3.0):
            raise BlockError("PW is the weight of a point of BSPLINE, above 0 and at most 3: correct it", "PW")
        if self.kind != "BSPLINE" and list(point) == self._points[-1]:
            raise BlockError(f"this point of {self.kind} is the one before: take the block out", self.kind)
        self._points.append(list(point))
        self._weights.append(1.0 if weight is None else weight)
        self._lines.append(line)
        self._behind.append([])

    def take(self, command: Command) -> None:
        """Take a command that stands between the points."""
        self._behind[-1].append(command)

    def finish(self, behind: Row | None) -> Row | None:
        """Write the spline; return the unit vector along its end.

        behind  unit vector along the block behind it, if there is one
        """
        pieces, last = self._pieces(behind), None
        for block, waiting in enumerate(self._behind):
            for points in pieces[block - 1] if block else ():
                others = self._points[block][_SPACE:]
                values = tuple(float(value) for point in points[1:] for value in [*point, *others])
                name = "STRAIGHT_FEED" if len(points) == 2 else "BEZIER_FEED"
                self._write(Command(name, values, self._lines[block - 1]))
                last = points
            for command in waiting:
                self._write(command)
        return None if last is None else _unit(last[-1] - last[-2])

    def _pieces(self, behind: Row | None) -> list[list[Row]]:
        """Return the Bezier curves that belong to each block."""
        points = np.array(self._points)[:, :_SPACE]
        count = len(points) - 1
        if self.kind == "BSPLINE":
            nurbs = Nurbs("BSPLINE", self._degree + 1)
            for point, weight in zip(points.tolist(), self._weights, strict=True):
                nurbs.add(point, weight)
            found = list(nurbs.pieces(self._unit))
            # its spans are fewer than its blocks, and may be cut: they are shared out evenly
            rows: list[list[Row]] = [[] for _ in range(count)]
            for k, piece in enumerate(found):
                rows[k * count // len(found)].append(piece)
            return rows
        if self._edges.begin == "BTAN" and self._before is None:
            raise BlockError(
                f"BTAN goes on along the move before {self.kind}, and there is none: write BAUTO or BNAT", self.kind
            )
        if self._edges.end == "ETAN" and behind is None:
            raise BlockError(
                f"ETAN ends along the move behind {self.kind}, and there is none: write EAUTO or ENAT", self.kind
            )
        found = slopes(self.kind, points, self._edges, self._before, behind)
        thirds = np.linalg.norm(np.diff(points, axis=0), axis=1)[:, None] / 3.0
        first, second = points[:-1] + thirds * found[:-1], points[1:] - thirds * found[1:]
        return [[np.array(row)] for row in zip(points[:-1], first, second, points[1:], strict=True)]
