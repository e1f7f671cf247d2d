"""Moves of a part program as segments: lines and arcs of the machine's axes, with feed and tolerance."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from feeddrive.language.errors import ProgramError
from feeddrive.path.motion import Pause
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


class _Collected:
    """Segments so far: kind, length, start, way to the end, feed and line of each, and the shape of each arc."""

    def __init__(self) -> None:
        self.rows: list[tuple[int, float, list[float], list[float], float, int]] = []
        self.tolerance: list[float] = []
        self.arcs: dict[int, np.ndarray] = {}

    def add(self, move: Straight | Arc, columns: Sequence[int], speed: float, tolerance: float) -> None:
        """A move, unless it goes nowhere; `columns` of the machine's axes."""
        start = [move.start[column] for column in columns]
        way = [move.end[column] - move.start[column] for column in columns]
        if isinstance(move, Straight):
            kind, length = LINE, math.hypot(*way)
            if length == 0.0:
                return
        else:
            kind = ARC
            length, self.arcs[len(self.rows)] = _arc(move, start, way, columns)
        self.rows.append((kind, length, start, way, speed, move.source.number))
        self.tolerance.append(tolerance)

    def chain(self, ends: bool) -> Chain:
        """All of them, or all but the last, which stays."""
        count = len(self.rows) - (0 if ends else 1)
        kind, length, start, way, feed, line = zip(*self.rows[:count], strict=True)
        origin = np.array(start)
        shape = np.zeros((*origin.shape, 8))
        shape[:, :, 1] = way
        for k, each in self.arcs.items():
            if k < count:
                shape[k] = each
        pieces = Pieces(np.array(kind), np.array(length), origin, shape, np.array(feed), np.array(line))
        # a joint keeps the stricter of the modes before and behind it
        tolerance = np.array(self.tolerance)
        tolerance[:-1] = np.minimum(tolerance[:-1], tolerance[1:])
        del self.rows[:count], self.tolerance[:count]
        self.arcs = {k - count: each for k, each in self.arcs.items() if k >= count}
        return Chain(pieces, tolerance[:count], ends)


def chains(moves: Iterable[Move], axes: str) -> Iterator[Chain | Pause]:
    """The chains of a program and the pauses between them; `axes` are letters of the machine's axes, such as XYZ.

    Raises ProgramError for what is not planned: rotary axes, moves that follow the spindle, splines.
    """
    columns = [_LETTERS.index(letter) for letter in axes]
    refused = [k for k, letter in enumerate(_LETTERS) if letter in _ROTARY or letter not in axes]
    collected, feed, tolerance, turns = _Collected(), Feed(Line("", 0, ""), 0.0, 0.0), 0.0, 0.0
    for move in moves:
        if isinstance(move, (Straight, Arc)):
            for column in refused:
                if move.start[column] != move.end[column]:
                    raise _refused(move.source, _missing(_LETTERS[column], axes))
            collected.add(move, columns, _speed(move, feed, turns), tolerance)
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


def _arc(move: Arc, start: list[float], way: list[float], columns: Sequence[int]) -> tuple[float, np.ndarray]:
    """Length and shape of an arc, as in `Pieces`."""
    shape = np.zeros((len(columns), 8))
    angle = move.angle
    first, second = (columns.index(axis) for axis in move.axes[:2])
    x, y = start[first] - move.center[0], start[second] - move.center[1]
    sense = math.copysign(1.0, angle)
    shape[[first, second], 0] = x, y
    shape[[first, second], 1] = -sense * y, sense * x
    # what the circle misses of the end, and the other axes, go linearly along
    s, versine = math.sin(abs(angle)), 2.0 * math.sin(0.5 * angle) ** 2
    drift = np.array(way) - (shape[:, 1] * s - shape[:, 0] * versine)
    straight = np.delete(drift, [first, second])
    length = math.hypot(math.hypot(x, y) * abs(angle), float(np.linalg.norm(straight)))
    shape[:, 2] = drift / length
    shape[:, 3] = abs(angle) / length
    return length, shape


def _missing(letter: str, axes: str) -> str:
    if letter in _ROTARY:
        return f"the rotary axis {letter} is not planned yet"
    return f"the machine has no axis {letter}; it has {', '.join(axes)}"


def _refused(line: Line, reason: str) -> ProgramError:
    return ProgramError(line.file, line.number, 0, "", reason)
