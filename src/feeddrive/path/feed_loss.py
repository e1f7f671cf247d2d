"""Where and why a planned motion is slower than the programmed feed, and the time that this costs.

    lost = Σ (1 - v/F) T         over all samples: path speed v, programmed feed F, sample time T

is the cycle time less the time of the driven path at the feed alone, within one sample time for each run from rest to
rest.  On a traverse F is the largest path speed that the velocity limits of the axes allow in its direction.

A fall is a stretch with v < 0.95 F around one minimum of the level, which is v over the lesser of F and what the
velocity limits allow.  A rise by more than a tenth of the highest level since the last maximum separates two falls, and
so does a plateau on the way to the minimum that something else holds.

The cause of a fall is what holds the speed at the minimum: a stop, the feed override, the velocity limit of an axis, or
the shape of the path (an arc, a bend that is rounded within the tolerance, a corner that two runs pass at the same
time; along the path of a tip the way of the joints).  Its limit is the one with the largest utilization there; for a
stop, the limit that is used most for the longest time.
"""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise, takewhile
from typing import NamedTuple

import numpy as np

from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text, joined
from feeddrive.path.motion import ARC, LINE, PACED, POLYNOMIAL

SLOW = 0.95  # of the feed: above it the loss has no cause of its own
RISE = 0.1  # of the highest level of a fall: a smaller rise does not separate two falls
STEADY = 0.1  # of the acceleration limit: a plateau has less of it along the path
CORNER = 4
"""The shape, besides LINE, ARC, POLYNOMIAL and PACED, of the path where two runs overlap in a corner."""
OVERRIDE, VELOCITY, ON_LINE = "feed override", "velocity limit of an axis", "ramp on a line"
SHAPES = {
    LINE: ON_LINE,
    ARC: "curvature of an arc",
    POLYNOMIAL: "bend within the tolerance",
    PACED: "joints that follow the tip",
    CORNER: "corner within the tolerance",
}
"""The causes that lie in the shape of the path."""
START, END = "start of the program", "end of the program"
WITHIN, NO_LIMIT = "less than 5 % below the feed", "no limit above half"
LISTED = 1000
"""The largest number of falls listed in a plan: those with the largest loss."""
_AT_LIMIT = 0.98  # utilization from which a velocity limit holds the speed
_NEAR = 1.1  # times the lowest level: the samples among which the place of the cause is sought
_MOSTLY = 0.5  # of these samples: a velocity limit holds the speed if more of them are at it
_USED = 0.5  # of a limit: below it no limit is named
_AT_ONCE = 4096  # samples that are evaluated together: many parts of a motion are shorter than a hundred
_PENDING = 65536  # largest number of samples of a fall, so that memory is bounded
_TOLD = 5  # causes in a sentence
_TRACK = 16384  # largest number of rows of the causes over time


class Fall(NamedTuple):
    """A stretch below the programmed feed.

    time, duration  start and duration, s
    first, last     lines of the program at its start and end
    length          length of the driven path, m
    lost            time lost against the feed, s
    slowest, feed   lowest path speed, and the programmed feed there, m/s
    cause, limit    what holds the speed, and the limit used most
    """

    time: float
    duration: float
    first: int
    last: int
    length: float
    lost: float
    slowest: float
    feed: float
    cause: str
    limit: str


class CauseOfLoss(NamedTuple):
    """The falls with the same cause and limit: their number, lost time (s) and length (m)."""

    cause: str
    limit: str
    falls: int
    lost: float
    length: float

    @property
    def name(self) -> str:
        """The cause with its limit in parentheses."""
        return f"{self.cause} ({self.limit})" if self.limit else self.cause


@dataclass(frozen=True)
class FeedLoss:
    """The time that a plan loses against its feed.

    lost         lost time, s; that of `causes` in sum
    causes       by cause and limit, the largest loss first; the last row, `WITHIN`, is what is less than 5 % below
    fall_count   number of falls; `falls` are those with the largest loss, at most `LISTED`, in order of time
    time, cause  causes over time: from time[k] (s) on cause[k], an index into `names`
    names        the causes, without their limits; the first is `WITHIN`
    """

    lost: float
    causes: tuple[CauseOfLoss, ...]
    fall_count: int
    falls: tuple[Fall, ...]
    time: np.ndarray
    cause: np.ndarray
    names: tuple[str, ...]

    def sentences(self, cycle_time: float) -> list[Text]:
        """Return the time that is lost and its five largest causes, as sentences; none for a motion of no time."""
        if not cycle_time:
            return []
        feed = Quantity(cycle_time - self.lost, "s")
        falls = [
            Text(f"{row.name} {Quantity(row.lost, 's'):3 SI} in {row.falls:,}") for row in self.causes if row.falls
        ]
        told = joined("; ", falls[:_TOLD])
        return [Text(f"At its feed the path would take {feed:6 SI}. Lost by falls of the feed: {told or 'nothing'}.")]


class _Pending(NamedTuple):
    """Slow samples, of falls that may go on: number, v, F, line, shape, limit used most with its use, and override.

    rapid   the largest speed within the velocity limits in this direction, m/s, and the axis that limits it
    level   speed over the lesser of the feed and this speed
    steady  True where the acceleration along the path is small
    turn    twice the number of samples that are steady where a ramp up turns into a ramp down
    """

    number: np.ndarray
    speed: np.ndarray
    feed: np.ndarray
    line: np.ndarray
    shape: np.ndarray
    limit: np.ndarray
    use: np.ndarray
    factor: np.ndarray
    rapid: np.ndarray
    axis: np.ndarray
    level: np.ndarray
    steady: np.ndarray
    turn: np.ndarray


class FeedLossRecorder:
    """A recorder of falls, from consecutive samples and stops, in bounded memory.

    limits  limits of velocity to snap of each axis, m/s .. m/s⁴, shape (N, 4)
    names   names of these limits, axis by axis
    """

    def __init__(self, limits: np.ndarray, names: Sequence[str], sample_time: float) -> None:
        self._limits, self._names, self._sample_time = limits, tuple(names), sample_time
        self._pending: _Pending | None = None
        self._batch: list[tuple[np.ndarray, ...]] = []
        self._waiting = 0
        self._stops = deque([(0.0, 0.0, START)])
        self._sums: dict[tuple[str, str], list[float]] = {}
        self._within = [0.0, 0.0]
        self._count = self._samples = 0
        self._largest: list[tuple[float, int, Fall]] = []
        self._track: list[tuple[float, str, float]] = [(0.0, WITHIN, 0.0)]

    def stop(self, time: float, duration: float, reason: str) -> None:
        """Add a standstill, at or after the time of all samples so far, s."""
        self._stops.append((time, duration, reason))

    def add(
        self,
        values: np.ndarray,
        feed: np.ndarray,
        line: np.ndarray,
        shape: np.ndarray,
        factor: float = 1.0,
        speed: np.ndarray | None = None,
    ) -> None:
        """Add the next samples.

        values  position to snap of each axis, m .. m/s⁴, shape (n, N, 5)
        feed    feed with the override, m/s; inf on a traverse, 0 at a standstill, shape (n,)
        line    line of the program, shape (n,)
        shape   LINE, ARC, POLYNOMIAL, PACED or CORNER, shape (n,)
        factor  feed override
        speed   speed that the feed bounds, m/s, shape (n,); None: that of all axes together
        """
        velocity = values[:, :, 1]
        along = np.sqrt(np.einsum("ij,ij->i", velocity, velocity)) if speed is None else speed
        programmed = feed / factor if factor > 0.0 else feed.copy()
        self._batch.append((values, along, programmed, line, shape, np.full(len(feed), factor)))
        self._waiting += len(feed)
        if self._waiting >= _AT_ONCE:
            self._evaluate()

    def _evaluate(self) -> None:
        """Evaluate the samples of the batch."""
        if not self._batch:
            return
        values, speed, programmed, line, shape, factor = (
            np.concatenate(columns) for columns in zip(*self._batch, strict=True)
        )
        self._batch, self._waiting = [], 0
        traverse = np.flatnonzero(np.isinf(programmed))
        if len(traverse):
            programmed[traverse] = self._quickest(values[traverse, :, 1], speed[traverse], 0)
        ratio = np.divide(speed, programmed, out=np.zeros(len(speed)), where=programmed > 0.0)
        slow = ratio < SLOW
        self._within[0] += self._sample_time * float(np.sum(1.0 - ratio[~slow]))
        self._within[1] += self._sample_time * float(np.sum(speed[~slow]))
        # most motions are at their feed for most of the time: the rest of the work is for the others only
        chosen = np.flatnonzero(slow)
        first, self._samples = self._samples, self._samples + len(speed)
        values, speed, programmed = values[chosen], speed[chosen], programmed[chosen]
        velocity = values[:, :, 1]
        rapid, acceleration, jerk = (self._quickest(velocity, speed, k) for k in range(3))
        along = np.abs(np.einsum("ij,ij->i", velocity, values[:, :, 2])) / np.maximum(speed, 1e-300)
        use = (np.abs(values[:, :, 1:]) / self._limits).reshape(len(values), 4 * values.shape[1])
        limit = np.argmax(use, axis=1)
        rows = _Pending(
            first + chosen,
            speed,
            programmed,
            line[chosen],
            shape[chosen],
            limit,
            use[np.arange(len(use)), limit],
            factor[chosen],
            rapid,
            np.argmax(np.abs(velocity) / self._limits[:, 0], axis=1),
            np.where(programmed > 0.0, speed / np.maximum(np.minimum(programmed, rapid), 1e-300), 0.0),
            along < STEADY * acceleration,
            4.0 * STEADY * acceleration / jerk / self._sample_time,
        )
        if self._pending is not None:
            rows = _Pending(*(np.concatenate(pair) for pair in zip(self._pending, rows, strict=True)))
        self._take(rows, False)

    def _quickest(self, velocity: np.ndarray, speed: np.ndarray, k: int) -> np.ndarray:
        """Return the largest size of a vector along each velocity whose components are within the limits `k`;
        infinite if none of the axes that move has a limit.
        """
        limit = self._limits[:, k]
        direction = np.abs(velocity) / np.maximum(speed, 1e-300)[:, None]
        least = np.maximum(np.max(direction / limit, axis=1, initial=0.0), 1.0 / np.max(limit))
        return np.divide(1.0, least, out=np.full(len(least), np.inf), where=least > 0.0)

    def result(self) -> FeedLoss:
        """Return the loss of all samples, whose motion ends here."""
        self._evaluate()
        self.stop(self._samples * self._sample_time, 0.0, END)
        if self._pending is not None:
            self._take(self._pending, True)
        lost, length = self._within
        rows = [CauseOfLoss(*key, int(count), *rest) for key, (count, *rest) in self._sums.items()]
        rows.sort(key=lambda row: -row.lost)
        rows.append(CauseOfLoss(WITHIN, "", 0, lost, length))
        falls = sorted((fall for _, _, fall in self._largest), key=lambda fall: fall.time)
        names = tuple(dict.fromkeys([WITHIN, *(row.cause for row in rows)]))
        return FeedLoss(
            sum(row.lost for row in rows),
            tuple(rows),
            self._count,
            tuple(falls),
            np.array([time for time, _, _ in self._track]),
            np.array([names.index(cause) for _, cause, _ in self._track]),
            names,
        )

    def _take(self, rows: _Pending, ends: bool) -> None:
        """Close all falls in these slow samples, but for the last one if it may go on."""
        self._pending = None
        if not len(rows.number):
            return
        T, steps = self._sample_time, np.flatnonzero(np.diff(rows.number) != 1) + 1
        for begin, end in pairwise([0, *steps.tolist(), len(rows.number)]):
            goes_on = not ends and int(rows.number[end - 1]) == self._samples - 1
            cuts = [begin, *(begin + cut for cut in _separated(rows.level[begin:end])), end]
            if goes_on and cuts[-1] - cuts[-2] < _PENDING:
                self._pending = _Pending(*(column[cuts[-2] :] for column in rows))
                cuts.pop()
            for a, b in pairwise(cuts):
                self._take_valley(_Pending(*(column[a:b] for column in rows)))
            if not goes_on:
                self._mark(T * float(rows.number[end - 1] + 1), WITHIN, 0.0)

    def _take_valley(self, rows: _Pending) -> None:
        """Close the falls around one minimum: its own, and those of plateaus before and behind it."""
        lowest, cuts = int(np.argmin(rows.level)), {0, len(rows.level)}
        edges = np.flatnonzero(np.diff(np.concatenate([[False], rows.steady, [False]])))
        for a, b in edges.reshape(-1, 2):
            plateau = _Pending(*(column[a:b] for column in rows))
            apart = np.min(plateau.level) > rows.level[lowest] + RISE * np.max(rows.level)
            if b - a > plateau.turn[0] and apart and self._held(plateau)[0] != ON_LINE:
                cuts.add(int(a) if a > lowest else int(b))
        for a, b in pairwise(sorted(cuts)):
            self._close(_Pending(*(column[a:b] for column in rows)))

    def _close(self, rows: _Pending) -> None:
        T = self._sample_time
        ratio = np.divide(rows.speed, rows.feed, out=np.zeros(len(rows.speed)), where=rows.feed > 0.0)
        time, duration = T * float(rows.number[0]), T * len(ratio)
        lost, length = T * float(np.sum(1.0 - ratio)), T * float(np.sum(rows.speed))
        # falls and stops come in order of time, so what ends before this fall is of no later one
        while self._stops and sum(self._stops[0][:2]) < time - T:
            self._stops.popleft()
        stops = list(takewhile(lambda stop: stop[0] <= time + duration + T, self._stops))
        lowest = int(np.argmin(rows.level))
        held = rows.speed >= _AT_LIMIT * rows.rapid
        if np.sum((1.0 - ratio)[held]) > _MOSTLY * np.sum(1.0 - ratio):
            # an axis at its largest velocity holds the speed, whatever the fall ends at
            cause, limit = VELOCITY, self._names[4 * int(np.argmax(np.bincount(rows.axis[held], 1.0 - ratio[held])))]
        elif stops:
            cause = max(stops, key=lambda stop: stop[1])[2]
            weights = np.bincount(rows.limit, weights=(rows.use >= _USED) * (1.0 - ratio), minlength=1)
            limit = self._names[int(np.argmax(weights))] if np.any(weights > 0.0) else NO_LIMIT
        else:
            cause, limit = self._held(rows)
        first, last = int(rows.line[0]), int(rows.line[-1])
        slowest, feed = float(rows.speed[lowest]), float(rows.feed[lowest])
        fall = Fall(time, duration, first, last, length, lost, slowest, feed, cause, limit)
        self._count += 1
        sums = self._sums.setdefault((cause, limit), [0, 0.0, 0.0])
        for k, value in enumerate((1, lost, length)):
            sums[k] += value
        entry = lost, -self._count, fall
        if len(self._largest) < LISTED:
            heapq.heappush(self._largest, entry)
        else:
            heapq.heappushpop(self._largest, entry)
        self._mark(time, cause, lost)

    def _held(self, rows: _Pending) -> tuple[str, str]:
        """Return the cause and the limit of a fall without a stop."""
        near = np.flatnonzero(rows.level <= _NEAR * float(np.min(rows.level)) + 1e-12)
        # a plateau at the speed of a bend reaches beyond it: the place is where a limit is used most
        place = int(near[np.argmax(rows.use[near] + (rows.shape[near] != LINE))])
        limit = self._names[int(rows.limit[place])] if rows.use[place] >= _USED else NO_LIMIT
        at_limit = rows.speed[near] >= _AT_LIMIT * rows.rapid[near]
        if np.mean(at_limit) > _MOSTLY:
            return VELOCITY, self._names[4 * int(rows.axis[near[np.argmax(at_limit)]])]
        overridden = rows.factor[near] * rows.feed[near]
        if np.any((rows.factor[near] < SLOW) & (rows.speed[near] >= _AT_LIMIT * overridden)):
            return OVERRIDE, ""
        return SHAPES[int(rows.shape[place])], limit

    def _mark(self, time: float, cause: str, lost: float) -> None:
        """Add a row to the causes over time; halve them when there are too many."""
        if self._track[-1][0] == time:
            self._track.pop()
        self._track.append((time, cause, lost))
        if len(self._track) > 2 * _TRACK:
            pairs = zip(self._track[::2], self._track[1::2], strict=False)
            halved = [(a[0], *max(a[1:], b[1:], key=lambda row: row[1])) for a, b in pairs]
            self._track = [*halved, *self._track[2 * len(halved) :]]


def _separated(level: np.ndarray) -> list[int]:
    """Return the indices at which a fall ends and the next one begins: the maxima between separate minima."""
    step = np.diff(level)
    moving = np.flatnonzero(step)
    turns = moving[:-1][np.sign(step[moving[:-1]]) != np.sign(step[moving[1:]])] + 1
    cuts: list[int] = []
    low = high = top = float(level[0])
    at, rising = 0, False
    for i in (*turns.tolist(), len(level) - 1):
        value = float(level[i])
        top = max(top, value)
        if not rising:
            low = min(low, value)
            if value > low + RISE * top:
                rising, high, at = True, value, i
        elif value > high:
            high, at = value, i
        elif value < high - RISE * top:
            cuts.append(at)
            rising, low, top = False, value, high
    return cuts
