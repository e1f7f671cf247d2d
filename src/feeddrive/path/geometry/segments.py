"""Moves of a part program as segments: lines and arcs of the machine's axes, with feed and tolerance."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from feeddrive.language.errors import ProgramError
from feeddrive.path.pieces import ARC, LINE, Pieces
from feeddrive.path.program.blocks import AXES
from feeddrive.path.program.lines import Line
from feeddrive.path.program.moves import (
    Arc,
    Dwell,
    End,
    Feed,
    Move,
    PathMode,
    Spindle,
    Spline,
    Stop,
    Straight,
    Switch,
    Synchronized,
    ToolChange,
)

_LETTERS = AXES.upper()
_ROTARY = "ABC"
AT_ONCE = 1000  # segments of a chain
_STOPS = -1.0  # tolerance of a joint at which the program asks for a stop


class Chain(NamedTuple):
    """Segments that follow each other without a stop that the program asks for.

    tolerance  of the joint behind each segment, m; 0: stop unless the joint is smooth; negative: stop
    ends       whether such a stop follows; else the next chain goes on from this one
    """

    segments: Pieces
    tolerance: np.ndarray
    ends: bool


class Pause(NamedTuple):
    """A standstill: a dwell of `duration` s, or 0 s at what waits for something else."""

    duration: float
    why: str
    line: int


class _Collected:
    """Segments so far, as rows."""

    def __init__(self) -> None:
        self.rows: list[tuple[int, float, np.ndarray, np.ndarray, float, int]] = []
        self.tolerance: list[float] = []

    def chain(self, ends: bool) -> Chain:
        """All of them, or all but the last, which stays."""
        count = len(self.rows) - (0 if ends else 1)
        kind, length, origin, shape, feed, line = zip(*self.rows[:count], strict=True)
        pieces = Pieces(
            np.array(kind), np.array(length), np.array(origin), np.array(shape), np.array(feed), np.array(line)
        )
        # a joint keeps the stricter of the modes before and behind it
        tolerance = np.array(self.tolerance)
        tolerance[:-1] = np.minimum(tolerance[:-1], tolerance[1:])
        del self.rows[:count], self.tolerance[:count]
        return Chain(pieces, tolerance[:count], ends)


def chains(moves: Iterable[Move], axes: str) -> Iterator[Chain | Pause]:
    """The chains of a program and the pauses between them; `axes` are letters of the machine's axes, such as XYZ.

    Raises ProgramError for what is not planned: rotary axes, moves that follow the spindle, splines.
    """
    columns = [_LETTERS.index(letter) for letter in axes]
    collected, feed, tolerance, turns = _Collected(), Feed(Line("", 0, ""), 0.0, 0.0), 0.0, 0.0
    for move in moves:
        if isinstance(move, Straight | Arc):
            row = _segment(move, axes, columns, _speed(move, feed, turns))
            if row is not None:
                collected.rows.append(row)
                collected.tolerance.append(tolerance)
            if len(collected.rows) > AT_ONCE:
                yield collected.chain(False)
        elif isinstance(move, PathMode):
            tolerance = {"exact_stop": _STOPS, "exact_path": 0.0}.get(move.mode, move.tolerance)
        elif isinstance(move, Feed):
            feed = move
        elif isinstance(move, Spline | Synchronized):
            what = "a spline (G5)" if isinstance(move, Spline) else "a move that follows the spindle (G33, G95)"
            raise _refused(move.source, f"{what} is not planned yet")
        elif isinstance(move, Dwell | Stop | ToolChange | Spindle | Switch | End):
            if isinstance(move, Spindle):
                turns = move.spindle_speed / 60.0
            if collected.rows:
                yield collected.chain(True)
            if not isinstance(move, End):
                duration = move.duration if isinstance(move, Dwell) else 0.0
                yield Pause(duration, type(move).__name__, move.source.number)
    if collected.rows:
        yield collected.chain(True)


def _speed(move: Straight | Arc, feed: Feed, turns: float) -> float:
    """Path speed at most, m/s."""
    if isinstance(move, Straight) and move.traverse:
        return math.inf
    speed = feed.linear * (turns if feed.per_turn else 1.0)
    if not speed > 0.0:
        raise _refused(move.source, "the feed is 0: give an F, and with G95 start the spindle")
    return speed


def _segment(
    move: Straight | Arc, axes: str, columns: Sequence[int], speed: float
) -> tuple[int, float, np.ndarray, np.ndarray, float, int] | None:
    """A row of `Pieces`; none for a move that goes nowhere."""
    for column, letter in enumerate(_LETTERS):
        if move.start[column] != move.end[column]:
            if letter in _ROTARY:
                raise _refused(move.source, f"the rotary axis {letter} is not planned yet")
            if letter not in axes:
                raise _refused(move.source, f"the machine has no axis {letter}; it has {', '.join(axes)}")
    start, end = (np.array([point[column] for column in columns]) for point in (move.start, move.end))
    shape = np.zeros((len(columns), 8))
    way = end - start
    if isinstance(move, Straight):
        length = float(np.linalg.norm(way))
        if length == 0.0:
            return None
        shape[:, 1] = way
        return LINE, length, start, shape, speed, move.source.number
    angle = move.angle
    first, second = (columns.index(axis) for axis in move.axes[:2])
    x, y = start[first] - move.center[0], start[second] - move.center[1]
    sense = math.copysign(1.0, angle)
    shape[[first, second], 0] = x, y
    shape[[first, second], 1] = -sense * y, sense * x
    # what the circle misses of the end, and the other axes, go linearly along
    s, versine = math.sin(abs(angle)), 2.0 * math.sin(0.5 * angle) ** 2
    drift = way - (shape[:, 1] * s - shape[:, 0] * versine)
    straight = np.delete(drift, [first, second])
    length = math.hypot(math.hypot(x, y) * abs(angle), float(np.linalg.norm(straight)))
    shape[:, 2] = drift / length
    shape[:, 3] = abs(angle) / length
    return ARC, length, start, shape, speed, move.source.number


def _refused(line: Line, reason: str) -> ProgramError:
    return ProgramError(line.file, line.number, 0, "", reason)
