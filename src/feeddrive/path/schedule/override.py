"""Feed override and feed hold: a motion whose feed factor changes at any times."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import chain
from typing import NamedTuple

import numpy as np

from feeddrive.language.errors import ParameterError
from feeddrive.language.kernels.source import by_field
from feeddrive.language.quantity import Quantity
from feeddrive.path.motion import (
    LINE,
    Limits,
    Motion,
    Part,
    Pause,
    Pieces,
    Section,
    cubic,
    one_after_the_other,
    part_of_pieces,
    way,
)
from feeddrive.path.proof import faults_of
from feeddrive.path.schedule.brake import Moving, braking, straight_stop
from feeddrive.path.schedule.lift import divided
from feeddrive.path.schedule.planner import Planner, limits_at
from feeddrive.path.schedule.run import Start, highest_speeds, start_at
from feeddrive.path.schedule.stop import quickest_stop

_SPEEDS = 8  # largest number of trial speeds to brake to
_SLOWER = 0.7  # ratio of two of them, where the path ahead leaves no room to stop
_HARDLY = 1e-3  # of the largest speed: so near to rest, spans as short as a spline would need are too many
_BELOW = 1.0 - 1e-9  # of the largest speed: braking to it must not end above it by rounding
_AGAIN = 0.1  # of the longest time in which an axis stops: the longest time to another trial
_NEAR = 1e-9  # of the way: a stop so close to the end of the run is the one at its end
_ROUNDING = 1e-9  # of a time interval: a part cut so close to its end is cut at its end

MOST = 2.0
"""The largest feed factor."""


class Override(NamedTuple):
    """The feed factor as a step function of time; constructed by `override`.

    time    start of each step, s from the start of the program, the first at 0, shape (n,)
    factor  feed factor from then on, 0 .. 2; 0 holds the motion, shape (n,)
    """

    time: np.ndarray
    factor: np.ndarray

    def at(self, time: float) -> float:
        """Return the factor at a time in s."""
        return float(self.factor[np.searchsorted(self.time, time, side="right") - 1])

    def moves_again(self, time: float) -> float:
        """Return the first time, in s, at or after `time` at which the factor is not 0."""
        k = int(np.searchsorted(self.time, time, side="right")) - 1
        if self.factor[k] > 0.0:
            return time
        return float(self.time[k + int(np.argmax(self.factor[k:] > 0.0))])


def override(steps: Sequence[tuple[float, float]]) -> Override:
    """Return an override from pairs of time (s) and factor; before the first pair the factor is 1.

    Raises ParameterError for times that do not increase, a factor outside 0 .. 2, and a hold that never ends.
    """
    time, factor = [0.0], [1.0]
    for k, (begin, value) in enumerate(steps):
        if not 0.0 <= begin < np.inf or (k and begin <= time[-1]):
            raise ParameterError(
                f"override: the times must rise from 0 s on, step {k + 1} is at {Quantity(begin, 's'):6 SI}"
            )
        if not 0.0 <= value <= MOST:
            raise ParameterError(
                f"override: the factor of step {k + 1} must be 0 .. {Quantity(MOST)} (0 .. "
                f"{Quantity(MOST, 'share'):6}), got {Quantity(value):6} ({Quantity(value, 'share'):6})"
            )
        if begin == 0.0:
            factor[0] = value
            continue
        time.append(float(begin))
        factor.append(float(value))
    if factor[-1] == 0.0:
        raise ParameterError("override: the last factor is 0, a hold that never ends: add a step with a factor > 0")
    return Override(np.array(time), np.array(factor, float))


def read_steps(text: str, option: str = "--override") -> Override:
    """Parse an override from a string of steps: the time in s, a colon and the feed in %, e.g. `1:50, 2:0, 3.5:120`.

    option  its name, for messages

    Raises ParameterError as `override` does, and for a malformed string.
    """
    steps: list[tuple[float, float]] = []
    for step in text.split(","):
        time, colon, percent = step.partition(":")
        try:
            steps.append((float(time), float(percent.strip().removesuffix("%")) / 100.0))
        except ValueError:
            missing = "" if colon else " (there is no colon)"
            raise ParameterError(
                f"{option}: {step.strip()!r} is no step{missing}: give the time in s, a colon and the feed in %, "
                "such as 1:50, 2:0, 3.5:120"
            ) from None
    try:
        return override(steps)
    except ParameterError as error:
        raise ParameterError(str(error).replace("override", option, 1)) from None


class Overridden:
    """The motion of a program under an override.

    All of it is planned at the present factor, as without an override. Where the factor changes, the planned motion is
    cut at that time, whatever its state; from there it brakes as quickly as the limits allow (`braking`): to rest for a
    hold, otherwise to a node from which the path ahead is planned at the new factor. A higher factor brakes only until
    u'' and u''' are 0, and this and what follows are lifted together; on a plateau they are. Where there is no such
    braking, and while a corner is passed in time, the planned motion goes on to its next time interval.

    limits    limits of velocity to snap of each axis, m/s .. m/s⁴, shape (N, 4)
    override  the feed factor
    time      time up to which the motion is final, s
    """

    def __init__(self, limits: np.ndarray, override: Override) -> None:
        self._override = override
        self.time = 0.0
        self._ahead: list[Section] = []  # the path from the piece on which the motion is, at 100 %
        self._moves, self._x = False, 0.0  # x is that of a rest within a run
        self.measure(limits)

    def measure(self, limits: np.ndarray) -> None:
        """Take the limits, as for the class, in the coordinates of the sections that follow, which begin at rest."""
        self._limits = np.ascontiguousarray(limits, float)
        of_axis = by_field(Limits, self._limits)
        self._soon = _AGAIN * float(np.max(np.asarray(of_axis.velocity) / of_axis.acceleration))
        self._plan_at(self.factor())

    def _plan_at(self, factor: float, start: Start | None = None, before: Part | None = None) -> Planner:
        """Return the planner from here on at another factor."""
        self._factor = self._fastest = factor
        """The factor in force, and the largest one since which the motion may not have slowed down."""
        self._planner = Planner(self._limits, factor, start, before)
        return self._planner

    def factor(self) -> float:
        """Return the factor at which a motion from rest begins, after a hold if there is one."""
        return self._override.at(self._override.moves_again(self.time))

    def along(self, sections: list[Section], ends: bool, parts: Iterable[Part] | None = None) -> Iterator[Part | Pause]:
        """Yield the motion that is final after these sections of a chain: all of it if the chain `ends`.

        parts  the motion along a whole chain from rest to rest, if it is already planned at `factor`
        """
        self._ahead += sections
        if parts is not None:
            self._plan_at(self.factor())
        coming = iter(self._planner.along(sections, ends) if parts is None else parts)
        while (part := next(coming, None)) is not None:
            if not self._moves and (pause := self._hold(part)) is not None:
                yield pause
            if not self._moves and self._override.at(self.time) != self._factor:
                coming = self._from_rest(ends)
                continue
            lasts = float(part.motion.duration.sum())
            change = self._changes()
            # what would be left of the part must be longer than rounding
            if change >= self.time + lasts - _ROUNDING * float(part.motion.duration[-1]):
                yield self._gone(part)
                continue
            if part.entering is not None:
                alone = self._override.at(self.time) == 0.0 and self._may_stop(part)
                yield self._gone(part._replace(entering=None) if alone else part)
                if alone:
                    coming = self._from_rest(ends)
                continue
            if change > self.time:
                before, part = divided_part(part, change - self.time)
                yield self._gone(before)
                self.time = change
            turned = self._turned(part, ends)
            if turned is not None:
                coming = turned
                continue
            # as planned up to the next time interval, where it is tried again, but not for long
            motion = part.motion
            soon = min(float(motion.duration[0]), self._soon)
            if len(motion.duration) > 1 or soon < motion.duration[0]:
                before, part = divided_part(part, soon)
                yield self._gone(before)
                coming = chain([part], coming)
            else:
                yield self._gone(part)

    def wait(self, duration: float) -> None:
        """Let time pass at rest, s."""
        self.time += duration

    def _changes(self) -> float:
        """Return the first time from now on at which the factor is another than the one in force, s."""
        time, factor = self._override
        k = int(np.searchsorted(time, self.time, side="right")) - 1
        if factor[k] != self._factor:
            return self.time
        later = np.flatnonzero(factor[k:] != self._factor)
        return float(time[k + later[0]]) if len(later) else np.inf

    def _hold(self, part: Part) -> Pause | None:
        """Return the hold at rest before this part, if the factor is 0."""
        duration = self._override.moves_again(self.time) - self.time
        if duration == 0.0:
            return None
        self.time += duration
        return Pause(duration, "Hold", int(part.pieces.line[0]))

    def _gone(self, part: Part) -> Part:
        """Go to the end of a part; return it."""
        self.time += float(part.motion.duration.sum())
        self._moves, self._x = True, 0.0
        if part.ends:
            while not self._ahead.pop(0).ends:
                pass
            self._moves = part.entering is not None
        else:
            self._ahead = _without(self._ahead, len(part.pieces.length) - 1)
        return part

    def _from_rest(self, ends: bool) -> Iterator[Part]:
        """Yield the motion from a rest at the present factor."""
        start = Start(self._x, 0.0) if self._x > 0.0 else None
        yield from self._plan_at(self.factor(), start).along(list(self._ahead), ends)

    def _may_stop(self, part: Part) -> bool:
        """True if the end of a run keeps all limits without the next run."""
        return not len(faults_of(part.pieces, part.motion, limits_at(self._limits, self._fastest)))

    def _turned(self, part: Part, ends: bool) -> Iterator[Part] | None:
        """Return the motion from the start of a part on at the present factor, or None if there is none from here."""
        wanted, motion = self._override.at(self.time), part.motion
        here = int(motion.piece[0])
        ahead = _without(self._ahead, here)
        state = Moving(*(float(column[0]) for column in (motion.x, motion.speed, motion.acceleration, motion.jerk)))
        run = _run(ahead)
        if wanted == 0.0:
            stop = self._stop(run, state)
            if stop is None or _ends(stop, run):
                return None
            return self._stopped(self._part(stop, run, here, self._fastest), ends)
        return self._at_factor(run, here, state, wanted, ends)

    def _at_factor(self, run: Pieces, here: int, state: Moving, wanted: float, ends: bool) -> Iterator[Part] | None:
        """Return the motion from a state on at another factor, as `_turned` does."""
        limits = limits_at(self._limits, wanted)
        scaled = run._replace(feed=run.feed * wanted)
        node = here == 0 and _is_node(state, limits)
        eased = None if node else self._braked(run, state, None, wanted)
        most, speed = highest_speeds(scaled, limits), None
        if node and (start := start_at(scaled, limits, state.x, state.speed)) is not None:
            return self._plan_at(wanted, start).along(list(self._ahead), ends)
        if eased is not None and (start := _start(scaled, limits, eased)) is not None:
            before = self._part(eased, run, here, wanted)
            if state.speed < _HARDLY * most[0]:
                return self._slowed(before, wanted, wanted, start, ends)
            planner = self._plan_at(wanted, start, before)
            return planner.along(_without(self._ahead, len(before.pieces.length) - 1), ends)
        fastest = max(self._fastest, wanted)
        if node:  # a brake to the speed at which u'' and u''' are 0 has no phases
            speed = _BELOW * float(most[0]) if state.speed > most[0] else _SLOWER * state.speed
        for _ in range(_SPEEDS):
            slowed = self._braked(run, state, speed, fastest)
            if slowed is None:
                return None
            p, _, speed = _end(slowed, run)
            lowest = float(np.min(most[: p + 1]))
            if speed > lowest:
                speed = _BELOW * lowest
            elif (start := _start(scaled, limits, slowed)) is not None:
                return self._slowed(self._part(slowed, run, here, fastest), wanted, fastest, start, ends)
            else:
                speed *= _SLOWER
        return None

    def _slowed(self, part: Part, wanted: float, fastest: float, start: Start, ends: bool) -> Iterator[Part]:
        """Yield a braking part, and the motion from its end on at another factor."""
        planner = self._plan_at(wanted, start)
        self._fastest = fastest
        yield part
        self._fastest = wanted
        yield from planner.along(list(self._ahead), ends)

    def _stopped(self, part: Part, ends: bool) -> Iterator[Part]:
        """Yield a part that brakes to rest, and the motion from there on."""
        self._factor = 0.0
        yield part
        _, x, _ = _end(part.motion, part.pieces)
        self._moves, self._x = False, x
        yield from self._from_rest(ends)

    def _braked(self, run: Pieces, state: Moving, speed: float | None, factor: float) -> Motion | None:
        """Return the result of `braking` at a factor."""
        return braking(run._replace(feed=run.feed * factor), state, speed, limits_at(self._limits, factor))

    def _stop(self, run: Pieces, state: Moving) -> Motion | None:
        """Return the quickest stop from a state on."""
        stop = self._braked(run, state, 0.0, self._fastest)
        first = 0 if stop is None else int(stop.piece[-1])
        if stop is not None and np.all(run.kind[: first + 1] == LINE):
            return stop  # on a line it is time-optimal
        limits = limits_at(self._limits, self._fastest)
        scaled = run._replace(feed=run.feed * self._fastest)
        straight = straight_stop(scaled, state, limits)
        return stop if straight is None else quickest_stop(scaled, state, straight, stop, limits)

    def _part(self, motion: Motion, run: Pieces, here: int, factor: float) -> Part:
        """Return a motion along a run, which begins so many pieces ahead, as the next part at a factor."""
        last = here + _end(motion, run)[0]
        pieces = part_of_pieces(_run(self._ahead), 0, last + 1)
        motion = motion._replace(piece=motion.piece + here)
        return Part(pieces._replace(feed=pieces.feed * factor), motion, False, factor=factor)


def divided_part(part: Part, t: float) -> tuple[Part, Part]:
    """Split a part, without an overlap, after the time t within it."""
    motion, n = part.motion, len(part.motion.duration)
    ends = np.cumsum(motion.duration)
    m = min(int(np.searchsorted(ends, t, side="right")), n - 1)
    inside = t - (float(ends[m - 1]) if m else 0.0)
    # an interval as short as rounding would be noise
    if inside > _ROUNDING * float(motion.duration[m]) or m == 0:
        motion, m = divided(motion, m, inside, part.pieces.length), m + 1
    p, last = int(motion.piece[m]), len(part.pieces.length)
    before = part._replace(
        pieces=part_of_pieces(part.pieces, 0, p + 1), motion=Motion._make([each[:m] for each in motion]), ends=False
    )
    behind = Motion._make([each[m:] for each in motion])
    return before, part._replace(
        pieces=part_of_pieces(part.pieces, p, last), motion=behind._replace(piece=behind.piece - p)
    )


def _without(sections: Sequence[Section], count: int) -> list[Section]:
    """Return sections without their first pieces."""
    left = list(sections)
    while count and count >= (first := len(left[0].pieces.length)):
        left.pop(0)
        count -= first
    if count:
        pieces = left[0].pieces
        left[0] = left[0]._replace(pieces=part_of_pieces(pieces, count, len(pieces.length)))
    return left


def _is_node(state: Moving, limits: np.ndarray) -> bool:
    """True if a motion from a node may begin in this state: u'' and u''' are 0, or may jump to it."""
    jerk, snap = (bool(np.isinf(limits[:, k]).all()) for k in (2, 3))
    return (state.acceleration == 0.0 or (jerk and snap)) and (state.jerk == 0.0 or snap)


def _run(sections: Sequence[Section]) -> Pieces:
    """Return the known pieces of the run that begins with these sections."""
    found: list[Pieces] = []
    for each in sections:
        found.append(each.pieces)
        if each.ends:
            break
    return one_after_the_other(found) if len(found) > 1 else found[0]


def _end(motion: Motion, pieces: Pieces) -> tuple[int, float, float]:
    """Return the piece on which a motion ends, x on it (m) and the speed (m/s)."""
    T, p, x, v, a, j, s = (float(column[-1]) for column in motion)
    x, piece = x + way(v, a, j, s, T), int(p)
    while x > pieces.length[piece] and piece + 1 < len(pieces.length):
        x -= float(pieces.length[piece])
        piece += 1
    return piece, x, cubic(v, a, j, s, T)


def _ends(stop: Motion, run: Pieces) -> bool:
    """True if a motion stops where the run ends, up to rounding: it will do so as planned."""
    p, x, _ = _end(stop, run)
    left = float(run.length[p]) - x + float(np.sum(run.length[p + 1 :]))
    return left <= _NEAR * float(np.sum(run.length[: p + 1]))


def _start(pieces: Pieces, limits: np.ndarray, before: Motion) -> Start | None:
    """Return the start of a motion at the node in which another one ends, or None if there is no way to stop."""
    p, x, speed = _end(before, pieces)
    return start_at(part_of_pieces(pieces, p, len(pieces.length)), limits, x, speed)
