"""Runs for the identification of cogging: position in turns and force; a log of both directions is cut into runs."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from feeddrive.language.errors import LogError, NotIdentifiableError, ParameterError

_ONE_WAY = 0.98  # share of a run's steps that must go its way
_TURN = 0.02  # share of the whole travel by which a position must come back to be a reversal
_END = 0.005  # share of a pass that is cut off at its ends, with the rows that stand still there
_WHOLE = 0.95  # of a period that a pass must cover
_FINE = 32  # rows that are kept for one wave of the highest order: their mean takes 0.2 % off its amplitude


@dataclass(frozen=True, eq=False)
class CoggingRun:
    """Position in turns (or in periods of whatever repeats) and the force that held or moved the axis, shape (n,).

    direction is +1 for a run towards larger positions and -1 for the other; by default it is seen in the positions.
    """

    turns: np.ndarray
    force: np.ndarray
    direction: int = 0

    def __post_init__(self) -> None:
        turns, force = np.asarray(self.turns, dtype=np.float64), np.asarray(self.force, dtype=np.float64)
        if turns.ndim != 1 or turns.shape != force.shape:
            raise LogError(f"a cogging run needs one force for each position, not {force.shape} for {turns.shape}")
        if not (np.all(np.isfinite(turns)) and np.all(np.isfinite(force))):
            bad = int(np.argmin(np.isfinite(turns) & np.isfinite(force)))
            raise LogError(f"a cogging run is not finite at row {bad + 1}; cut it there")
        direction = self.direction
        if direction == 0:
            steps = np.diff(turns)
            steps = steps[np.abs(steps) > 0.0]
            share = float(np.mean(steps > 0.0)) if steps.size else 0.5
            if 1.0 - _ONE_WAY < share < _ONE_WAY:
                raise NotIdentifiableError(
                    f"a cogging run goes both ways ({100.0 * share:.3g} % of its steps forward): friction changes its "
                    f"sign within it; cut it into runs of one direction, or state `direction`"
                )
            direction = 1 if share > 0.5 else -1
        if direction not in (-1, 1):
            raise ParameterError(f"direction = {direction} must be 1 or -1")
        for name, value in (("turns", turns), ("force", force), ("direction", direction)):
            object.__setattr__(self, name, value)


def cogging_passes(turns: np.ndarray, force: np.ndarray, *, highest: int = 128) -> tuple[CoggingRun, ...]:
    """The passes of a log in one direction each, of position in periods and force, both of shape (n,).

    A position that starts again after each period is followed over its jumps.  Where the log reverses it is cut; passes
    of less than a whole period are left out, and so is half a percent of the travel at both ends of a pass, where it
    speeds up or stands still.  A long pass is averaged to 32 rows in a wave of order `highest`.
    Raises LogError for numbers that are not finite, NotIdentifiableError where no pass covers a period.
    """
    turns, force = np.asarray(turns, dtype=np.float64), np.asarray(force, dtype=np.float64)
    if turns.shape != force.shape or turns.ndim != 1 or turns.size < 2:
        raise LogError(f"a log of cogging needs one force for each position, not {force.shape} for {turns.shape}")
    if not (np.all(np.isfinite(turns)) and np.all(np.isfinite(force))):
        bad = int(np.argmin(np.isfinite(turns) & np.isfinite(force)))
        raise LogError(f"a log of cogging is not finite at row {bad + 1}; cut it there")
    x = np.unwrap(turns, period=1.0)
    found: list[CoggingRun] = []
    longest = 0.0
    for begin, end in _passes(x):
        travel = float(x[end] - x[begin])
        longest = max(longest, abs(travel))
        if abs(travel) < _WHOLE:
            continue
        along = (x[begin : end + 1] - x[begin]) / travel
        inside = np.flatnonzero((along > _END) & (along < 1.0 - _END))
        rows = slice(begin + int(inside[0]), begin + int(inside[-1]) + 1)
        found.append(CoggingRun(*_averaged(x[rows], force[rows], highest), direction=1 if travel > 0.0 else -1))
    if not found:
        raise NotIdentifiableError(
            f"the longest way in one direction is {longest:.3g} periods, and cogging needs a whole one: record next a "
            f"whole period at low speed in both directions, or correct the period"
        )
    return tuple(found)


def _passes(x: np.ndarray) -> Iterator[tuple[int, int]]:
    """First and last row of each way between two reversals."""
    enough = _TURN * float(np.ptp(x))
    if enough == 0.0:
        return
    begin = far = 0
    way = 0
    for k in range(1, x.size):
        if way == 0:
            if abs(x[k] - x[begin]) > enough:
                way, far = (1 if x[k] > x[begin] else -1), k
        elif way * (x[k] - x[far]) > 0.0:
            far = k
        elif way * (x[far] - x[k]) > enough:
            yield begin, far
            begin, far, way = far, k, -way
    if way:
        yield begin, far


def _averaged(x: np.ndarray, force: np.ndarray, highest: int) -> tuple[np.ndarray, np.ndarray]:
    """Means of neighboring rows, if there are more than needed."""
    needed = int(np.ceil(_FINE * highest * max(1.0, float(np.ptp(x)))))
    if x.size <= 2 * needed:
        return x, force
    edges = np.linspace(0, x.size, needed + 1).astype(int)
    count = np.diff(edges)
    return np.add.reduceat(x, edges[:-1]) / count, np.add.reduceat(force, edges[:-1]) / count
