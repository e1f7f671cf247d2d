"""Moves through waypoints in an array, for motions that no part program describes."""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from feeddrive.language.errors import ParameterError
from feeddrive.path.limits import FARTHEST
from feeddrive.path.program.blocks import AXES, Line
from feeddrive.path.program.moves import End, Feed, Move, PathMode, Straight

NAME = "waypoints"
"""The name of the file in errors of the planner; the number of the line is that of the waypoint, from 1."""


def waypoints(points: ArrayLike, feed: ArrayLike, *, axes: str = "XYZ", tolerance: float = 0.0) -> Iterator[Move]:
    """Return straight moves from the first waypoint, where the machine stands, through all others.

    points     coordinates in m (rad for A B C), shape (n, N), n >= 2
    feed       path speed in m/s (rad/s where only A B C move): one, or one for each of the n - 1 moves
    axes       N letters of the axes of the columns, of X Y Z A B C U V W
    tolerance  largest deviation from the polygon, m; 0: the motion stops at each corner

    A waypoint that repeats the one before it is left out.  The moves are read as those of `read_program`: `Setpoints`
    plans them, `planned_of` gives cycle time and proof.

    Raises ParameterError for an array of another shape, a number that is not finite, a feed that is not positive.
    """
    letters = axes.lower()
    if not letters or len(set(letters)) != len(letters) or not set(letters) <= set(AXES):
        raise ParameterError(f"axes = {axes!r}: letters of X Y Z A B C U V W are expected, each once")
    rows = _numbers("points", points)
    if rows.ndim != 2 or rows.shape[1] != len(letters) or len(rows) < 2:
        raise ParameterError(
            f"points has the shape {rows.shape}: one row for each waypoint, two at least, and {len(letters)} columns "
            f"for {axes.upper()} are expected"
        )
    wrong = np.flatnonzero(~(np.abs(rows) <= FARTHEST).all(axis=1))
    if len(wrong):
        raise ParameterError(f"points[{wrong[0]}] = {rows[wrong[0]]}: finite numbers up to {FARTHEST:g} m are expected")
    feeds = _numbers("feed", feed)
    if feeds.ndim > 1 or (feeds.ndim == 1 and len(feeds) != len(rows) - 1):
        raise ParameterError(
            f"feed has the shape {feeds.shape}: one number, or {len(rows) - 1}, one for each move, are expected"
        )
    if not (np.all(feeds > 0.0) and np.all(np.isfinite(feeds))):
        raise ParameterError("feed: finite numbers above 0 are expected, in m/s")
    if not 0.0 <= tolerance < np.inf:
        raise ParameterError(f"tolerance = {tolerance}: a finite number of m, 0 or more, is expected")
    return _moves(rows, np.broadcast_to(feeds, len(rows) - 1), [AXES.index(letter) for letter in letters], tolerance)


def _numbers(name: str, given: ArrayLike) -> np.ndarray:
    """Return an array of numbers."""
    try:
        return np.asarray(given, float)
    except (TypeError, ValueError) as error:
        raise ParameterError(f"{name} is no array of numbers: {error}") from None


def _moves(rows: np.ndarray, feeds: np.ndarray, columns: list[int], tolerance: float) -> Iterator[Move]:
    whole = np.zeros((len(rows), 9))
    whole[:, columns] = rows
    # also without a tolerance: it is that of the moves and not of a program that states none
    yield PathMode(Line(NAME, 1, ""), "continuous", tolerance, tolerance)
    fed = 0.0
    for number, (start, end) in enumerate(pairwise(map(tuple, whole.tolist())), 2):
        line = Line(NAME, number, "")
        if feeds[number - 2] != fed:
            fed = float(feeds[number - 2])
            yield Feed(line, fed, fed)
        if end != start:
            yield Straight(line, start, end, False)
    yield End(Line(NAME, len(whole), ""))
