"""Radius compensation (G41, G42): the path of the center of a tool that cuts the programmed contour.

The center keeps the distance of the radius r to the contour, on its left (G41) or right (G42):

    line   shifted by r along its normal
    arc    same center, radius R - r inside and R + r outside; R > r inside
    lead-in            from the position before, to the point at r beside the end of the first move
    outer corner       an arc of radius r about the corner; at rapid traverse a line
    inner corner       the intersection of the shifted curves, which must lie on both of them
    angle below 0.05   no corner: the move ends at r beside its end
    G451               an outer corner of two lines is their intersection, up to `SHARPEST`
    reversal           an inner corner if an arc behind or before it opens towards the tool, otherwise an outer one

Each move waits until the next one is known, since an inner corner shortens it.  Commands between two moves wait with
it.  Only neighboring moves are compared: a contour that the tool meets elsewhere is cut.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

from feeddrive.language.quantity import Quantity
from feeddrive.path.program.blocks import BlockError, Line
from feeddrive.path.program.moves import Command, sweep

# as in LinuxCNC; at most 0.00125 r are cut off at such a corner, or left
SMALLEST_CORNER = 0.05
"""The angle of a corner, rad, below which neither an arc is inserted nor an intersection taken."""
# MD20210 $MC_CUTCOM_CORNER_LIMIT as delivered
SHARPEST = math.radians(100.0)
"""The largest change of direction at which G451 goes to the intersection, rad; a sharper corner has an arc."""
_ROUNDING = 1e-9  # of the size of a curve: a point this far beyond its end is its end

Pair = tuple[float, float]


class Curve(NamedTuple):
    """A line, or an arc with a center and signed turns (positive counterclockwise), in the plane of compensation."""

    start: Pair
    end: Pair
    center: Pair | None = None
    turns: int = 0

    def tangent(self, point: Pair) -> Pair:
        """Return the unit vector of the direction of travel at a point of the curve."""
        if self.center is None:
            x, y = self.end[0] - self.start[0], self.end[1] - self.start[1]
        else:
            sense = 1.0 if self.turns > 0 else -1.0
            x, y = sense * (self.center[1] - point[1]), sense * (point[0] - self.center[0])
        size = math.hypot(x, y)
        return x / size, y / size

    def shifted(self, left: float) -> Curve:
        """Return the curve shifted to its left by a signed distance."""
        return self._replace(start=self._beside(self.start, left), end=self._beside(self.end, left))

    def _beside(self, point: Pair, left: float) -> Pair:
        x, y = self.tangent(point)
        return point[0] - left * y, point[1] + left * x

    def curvature(self) -> float:
        """Return the curvature, positive counterclockwise; 0 for a line."""
        return 0.0 if self.center is None else math.copysign(1.0 / math.dist(self.start, self.center), self.turns)

    def length(self) -> float:
        """Return the length of a line, or the unsigned angle of an arc, rad."""
        if self.center is None:
            return math.dist(self.start, self.end)
        return abs(sweep(self.start, self.end, self.center, self.turns))

    def between(self, a: Pair, b: Pair) -> float:
        """Return the way from one point of the curve to another: a length on a line, an angle >= 0 on an arc."""
        if self.center is None:
            x, y = self.tangent(a)
            return (b[0] - a[0]) * x + (b[1] - a[1]) * y
        if math.dist(a, b) <= _ROUNDING * math.dist(a, self.center):
            return 0.0
        return abs(sweep(a, b, self.center, 1 if self.turns > 0 else -1))


def _meetings(a: Curve, b: Curve) -> Iterator[Pair]:
    """Yield the intersections of two lines or circles, regardless of their ends."""
    if a.center is None and b.center is not None:
        a, b = b, a
    if a.center is None:
        (ux, uy), (vx, vy) = a.tangent(a.start), b.tangent(b.start)
        across = ux * vy - uy * vx
        if across:
            way = ((b.start[0] - a.start[0]) * vy - (b.start[1] - a.start[1]) * vx) / across
            yield a.start[0] + way * ux, a.start[1] + way * uy
        return
    radius = math.dist(a.end, a.center)
    if b.center is None:
        ux, uy = b.tangent(b.start)
        foot = (a.center[0] - b.start[0]) * ux + (a.center[1] - b.start[1]) * uy
        x, y = b.start[0] + foot * ux, b.start[1] + foot * uy
        away = math.dist((x, y), a.center)
    else:
        apart = math.dist(a.center, b.center)
        if apart == 0.0:
            return
        ux, uy = (b.center[0] - a.center[0]) / apart, (b.center[1] - a.center[1]) / apart
        # the intersections lie on the line across that of the centers, at this distance from the first one
        away = 0.5 * (apart + (radius - math.dist(b.start, b.center)) * (radius + math.dist(b.start, b.center)) / apart)
        x, y = a.center[0] + away * ux, a.center[1] + away * uy
        ux, uy = -uy, ux
    square = (radius - away) * (radius + away)
    if square < -_ROUNDING * radius * radius:
        return
    half = math.sqrt(max(0.0, square))
    yield x + half * ux, y + half * uy
    yield x - half * ux, y - half * uy


class Corners(NamedTuple):
    """How a language enters a contour and goes around its outer corners.

    square  True for a straight lead-in of any length that ends beside the start of the next move (NORM); otherwise it
            ends beside its own end, and the corner behind it is one of the contour
    sharp   True for outer corners at the intersection of shifted lines (G451), up to `SHARPEST`; otherwise by an arc
    """

    square: bool = False
    sharp: bool = False


class _Move(NamedTuple):
    """A move that waits for the next one: its command, and its programmed and its shifted curve.

    lead_in  True if it leads to the contour, so that no corner of the contour is behind it
    """

    command: Command
    target: list[float]
    programmed: Curve
    shifted: Curve
    lead_in: bool = False


class Compensation:
    """The compensation between G41 or G42 and G40.

    radius  r in the program's unit, positive; `left` is True for a tool on the left of the contour
    plane   first and second axis of the plane, and the normal axis
    line    function that returns the line of the present block
    write   function that takes the finished commands
    corners how the contour is entered, and its corners
    """

    def __init__(
        self,
        radius: float,
        left: bool,
        plane: tuple[int, int, int],
        position: list[float],
        line: Callable[[], Line],
        write: Callable[[Command], None],
        corners: Corners | None = None,
    ) -> None:
        self.corners = corners or Corners()
        self._radius, self._left = radius, radius if left else -radius
        self._plane, self._line, self._write = plane, line, write
        self._place = self._pair(position)  # the center of the tool, where the waiting move begins
        self._target = list(position)
        self._waiting: _Move | None = None
        self._behind: list[Command] = []  # commands that wait behind the move

    def _pair(self, point: list[float]) -> Pair:
        return point[self._plane[0]], point[self._plane[1]]

    def position(self, programmed: list[float]) -> list[float]:
        """Return the position of the tool's center as it is without a corner, in place of the programmed one."""
        end = self._waiting.shifted.end if self._waiting else self._place
        return self._at(programmed, end)

    def _at(self, point: list[float], pair: Pair) -> list[float]:
        point = list(point)
        point[self._plane[0]], point[self._plane[1]] = pair
        return point

    def take(self, command: Command) -> None:
        """Take a command that is no move of the contour: it keeps its place between the moves."""
        if self._waiting is None:
            self._write(command)
        else:
            self._behind.append(command)

    def move(self, name: str, target: list[float], center: Pair | None = None, turns: int = 0) -> None:
        """Take a straight move, or an arc with its center and turns, to a programmed target; `name`: its command.

        Raises BlockError for a move that the tool cannot follow without cutting into the contour.
        """
        command = Command(name, (), self._line())
        programmed = Curve(self._pair(self._target), self._pair(target), center, turns)
        if center is None and programmed.start == programmed.end:
            self._across(command, target)
            return
        shifted = self._shifted(programmed)
        waiting, square = self._waiting, self.corners.square
        if waiting is None:
            if square and center is not None:
                raise BlockError("the move behind G41 or G42 is straight: write G0 or G1 before this arc", "G")
            shifted = shifted if square else self._lead_in(programmed, shifted)
        elif waiting.lead_in:
            self._release(shifted.start)
        else:
            shifted = self._corner(command, target, waiting, programmed, shifted)
        self._waiting = _Move(command, list(target), programmed, shifted, square and waiting is None)
        self._target = list(target)

    def _across(self, command: Command, target: list[float]) -> None:
        """Take a move without motion in the plane, at the end of the waiting move."""
        if self._waiting is None:
            if not self.corners.square:
                raise self._too_short()
            self._write(command._replace(values=tuple(self._at(target, self._place))))
            self._target = list(target)
            return
        # its coordinates in the plane are known when those of the waiting move are
        self._behind.append(command._replace(values=tuple(target)))
        self._target = list(target)

    def _shifted(self, programmed: Curve) -> Curve:
        if programmed.center is not None:
            inside = (programmed.turns > 0) == (self._left > 0)
            radius = math.dist(programmed.start, programmed.center)
            if inside and radius <= self._radius:
                raise BlockError(
                    f"the tool of radius {Quantity(self._radius):6} does not fit into this arc of radius "
                    f"{Quantity(radius):6}: take a smaller tool, or a larger arc",
                    "G",
                )
        return programmed.shifted(self._left)

    def _too_short(self) -> BlockError:
        return BlockError(
            f"the first move behind G41 or G42 is the lead-in, in the plane and longer than the tool's radius, "
            f"{Quantity(self._radius):6}: make it longer",
            "G",
        )

    def _lead_in(self, programmed: Curve, shifted: Curve) -> Curve:
        """Return the curve of the first move, shifted at its end."""
        if programmed.center is None:
            if programmed.length() <= self._radius:
                raise self._too_short()
            return shifted
        # an arc that touches the contour at its end: its center lies on the line through end and center there
        x, y = programmed.tangent(programmed.end)
        across = (-y, x)
        way = self._place[0] - shifted.end[0], self._place[1] - shifted.end[1]
        beside = way[0] * across[0] + way[1] * across[1]
        if beside == 0.0 or (beside > 0) != (programmed.turns > 0):
            raise BlockError(
                "an arc behind G41 or G42 has to touch the contour at its end, which none does from here: lead in on "
                "a straight move",
                "G",
            )
        reach = 0.5 * (way[0] * way[0] + way[1] * way[1]) / beside
        center = shifted.end[0] + reach * across[0], shifted.end[1] + reach * across[1]
        return Curve(self._place, shifted.end, center, programmed.turns)

    def _corner(self, command: Command, target: list[float], last: _Move, programmed: Curve, shifted: Curve) -> Curve:
        """Write the waiting move and the corner behind it; return the shifted curve, which begins behind the corner."""
        corner = last.programmed.end
        (ax, ay), (bx, by) = last.programmed.tangent(corner), programmed.tangent(corner)
        turn = math.atan2(ax * by - ay * bx, ax * bx + ay * by)
        inner = (turn > 0) == (self._left > 0)
        if abs(turn) > math.pi - SMALLEST_CORNER:
            # a reversal is an inner corner if the curves open towards the tool behind it
            inner = self._left * (last.programmed.curvature() + programmed.curvature()) < 0.0
        if abs(turn) < SMALLEST_CORNER:
            self._release(last.shifted.end)
            return shifted._replace(start=last.shifted.end)
        if not inner:
            if self.corners.sharp and abs(turn) <= SHARPEST:
                return self._sharp(last, shifted)
            self._release(last.shifted.end)
            self._round(command.name, corner, shifted.start, target)
            return shifted
        meeting = self._meeting(last.shifted, shifted)
        self._release(meeting)
        return shifted._replace(start=meeting)

    def _sharp(self, last: _Move, shifted: Curve) -> Curve:
        """Write the waiting move up to the intersection of both shifted lines beyond the corner (G451)."""
        if last.shifted.center is not None or shifted.center is not None:
            raise BlockError(
                "how G451 lengthens an arc beyond an outer corner is not documented: write G450 before this corner", "G"
            )
        meeting = next(_meetings(last.shifted, shifted))
        self._release(meeting)
        return shifted._replace(start=meeting)

    def _meeting(self, before: Curve, after: Curve) -> Pair:
        near = _ROUNDING * (1.0 + self._radius)
        # the start of the lead-in is not beside its programmed one: only its direction counts
        whole = before.length() + near
        for point in sorted(_meetings(before, after), key=lambda point: math.dist(point, after.start)):
            back, ahead = before.between(point, before.end), after.between(after.start, point)
            if -near <= back <= whole and -near <= ahead <= after.length() + near:
                return point
        raise BlockError(
            f"the tool of radius {Quantity(self._radius):6} does not reach this inner corner without cutting into the "
            "contour: take a smaller tool, or lengthen the moves at the corner",
            "G",
        )

    def _round(self, name: str, corner: Pair, start: Pair, target: list[float]) -> None:
        """Write the way around an outer corner, on which axes other than X Y Z go to their target, as in LinuxCNC."""
        first, second, across = self._plane
        point = self._at([*self._target[:3], *target[3:]], start)
        if name == "STRAIGHT_TRAVERSE":
            self._write(Command(name, tuple(point), self._line()))
            return
        values = (point[first], point[second], *corner, -1 if self._left > 0 else 1, point[across], *point[3:])
        self._write(Command("ARC_FEED", values, self._line()))

    def _release(self, end: Pair) -> None:
        """Write the waiting move up to a point, and the commands behind it."""
        move = self._waiting
        if move is None:
            return
        first, second, across = self._plane
        point, center = self._at(move.target, end), move.shifted.center
        if center is None:
            self._write(move.command._replace(values=tuple(point)))
        else:
            values = (*end, *center, move.shifted.turns, point[across], *point[3:])
            self._write(move.command._replace(values=values))
        for command in self._behind:
            if command.name in ("STRAIGHT_FEED", "STRAIGHT_TRAVERSE"):
                values = list(command.values)
                values[first], values[second] = end
                command = command._replace(values=tuple(values))
            self._write(command)
        self._behind.clear()
        self._waiting = None
        self._place = end

    def finish(self) -> None:
        """Write what waits: the last move ends beside its programmed end."""
        if self._waiting:
            self._release(self._waiting.shifted.end)
