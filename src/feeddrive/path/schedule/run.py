"""The motion along a run, from rest to rest, planned window by window as its path becomes available.

Each window ends with a stop, so a safe stop is always planned.  The nodes in the first part of its plan become final;
the next window starts from the last of them.  If the motion cannot brake from there to the speed that newly added
pieces allow, the previous plan is followed to its next node, or at the latest to its stop.

With an override the motion becomes final node by node, and on plateaus at most `HORIZON` ahead.  At each of these
points the feed factor is read: if it has changed, the motion brakes as soon as the limits allow, or is replanned.
"""

from collections.abc import Generator, Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from feeddrive.language.errors import ParameterError
from feeddrive.language.kernels.source import by_field, columns, rows_for
from feeddrive.language.quantity import Quantity
from feeddrive.path.motion import Limits, Motion, Part, Pause, Pieces, Section, one_after_the_other, part_of_pieces
from feeddrive.path.schedule.plan import (
    MARGIN,
    Stretch,
    brake_soon,
    plan,
    plateau_begin,
    plateau_end,
    takes_time,
    timed,
)
from feeddrive.path.schedule.ramp import NO_RAMP, Cap, Path, Slopes, duration, pieces_room

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
                f"{Quantity(MOST, 'share'):6}), got {Quantity(value):6}"
            )
        if begin == 0.0:
            factor[0] = value
            continue
        time.append(float(begin))
        factor.append(float(value))
    if factor[-1] == 0.0:
        raise ParameterError("override: the last factor is 0, a hold that never ends: add a step with a factor > 0")
    return Override(np.array(time), np.array(factor, float))


def read_steps(text: str) -> Override:
    """Parse an override from a string of steps: the time in s, a colon and the feed in %, e.g. `1:50, 2:0, 3.5:120`.

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
                f"override: {step.strip()!r} is no step{missing}: give the time in s, a colon and the feed in %, such "
                "as 1:50, 2:0, 3.5:120"
            ) from None
    return override(steps)


# shares of the speed that curvature allows: on a piece held at its cap, and on one that ramps cross.  The second pair
# is for chains of corners, where ramps need more room; both are planned, and the faster plan is taken
SHARES = ((0.9, 0.6), (0.7, 0.4))
# the cycle time grows by 16 % with windows of 50 pieces, by 0.7 % with 200, by 0.4 % with 400
WINDOW = 400  # number of pieces
# beyond that the plan already brakes to the stop at the end of its window
_KEPT = 0.6  # of the length of a window becomes final
HORIZON = 0.05
"""The longest part of a plateau that becomes final at once when the feed factor may change, s."""
_CAPS = 8  # largest number of trial speeds to brake to


class _Room(NamedTuple):
    """The bounds and caps of pieces, for one pair of limit shares in `SHARES`."""

    most: np.ndarray
    caps: np.ndarray

    @property
    def plateau(self) -> np.ndarray:
        """The largest speed of a plateau on each piece, m/s."""
        return np.asarray(by_field(Cap, self.caps).plateau)


class _Plan(NamedTuple):
    """A plan from the current node: its stretches, and u at the start of each path piece and at the end of the last.

    ends  True if the run ends with this plan
    """

    begin: np.ndarray
    rows: np.ndarray
    ends: bool


class Schedule:
    """The planner of runs whose sections are added successively.

    limits  limits of velocity to snap of each axis, m/s .. m/s⁴, shape (N, 4)
    window  number of pieces planned together; more where ramps are longer
    time    time up to which the motion is final, s; with an override the caller adds pauses from other sources
    """

    def __init__(self, limits: np.ndarray, window: int = WINDOW, override: Override | None = None) -> None:
        self._limits, self._window = np.ascontiguousarray(limits, float), window
        self._override, self._factor, self.time = override, 1.0, 0.0
        self._begin()

    def _begin(self) -> None:
        """Start a run at rest."""
        self._pieces: Pieces | None = None  # from the current node on
        self._rooms: list[_Room] = []
        self._u, self._speed, self._wide = 0.0, 0.0, self._window  # u on the first of the pieces
        self._hand: _Plan | None = None  # the rest of the last plan, to its stop

    @property
    def rests(self) -> bool:
        """True if the next section begins a run."""
        return self._pieces is None

    def add(self, section: Section) -> Iterator[Part | Pause]:
        """Yield the parts of the motion that are final after this section: all of them if the run ends."""
        self._append(section.pieces)
        while self._pieces is not None:
            n = len(self._pieces.length)
            last = min(n, self._wide)
            if last < self._wide and not section.ends:
                return
            ends = section.ends and last == n
            if self._override is not None:
                followed = yield from self._follow(self._override, last, ends)
                if followed:
                    continue
            planned = self._planned(last, ends, self._rooms, self._u, self._speed)
            if planned is None:
                assert self._hand is not None  # from rest there is a plan
                yield self._go(self._hand, 1)
                continue
            planned, count = (planned, len(planned.rows)) if ends else _cut(planned)
            if not count:
                # no node lies early enough, since ramps are longer than the window
                self._wide = 2 * last
                continue
            self._wide = self._window
            if self._override is None:
                yield self._go(planned, count)
            else:
                yield from self._go_on(self._override, planned, count)

    def _go_on(self, override: Override, planned: _Plan, count: int) -> Iterator[Part]:
        """Yield the parts of `_go` node by node, as long as the feed factor is unchanged."""
        steps = _steps(planned.rows[:count], planned.begin)
        planned = planned._replace(rows=np.vstack([steps, planned.rows[count:]]))
        for _ in range(len(steps)):
            yield self._go(planned, 1)
            if self._hand is None or override.at(self.time) != self._factor:
                return
            planned = self._hand

    def _follow(self, override: Override, last: int, ends: bool) -> Generator[Part | Pause, None, bool]:
        """Change to the current feed factor, yielding the motion or pause this requires; return True if anything was
        yielded.
        """
        wanted = override.at(self.time)
        if wanted == self._factor:
            return False
        if wanted == 0.0 and self._speed == 0.0:
            assert self._pieces is not None
            duration = override.moves_again(self.time) - self.time
            self.time += duration
            yield Pause(duration, "Hold", int(self._pieces.line[0]))
            return True
        # a higher feed, or a start from rest, breaks no limit of the motion so far
        if wanted > self._factor or self._speed == 0.0:
            self._turn_to(wanted)
            return False
        assert self._pieces is not None
        rooms = self._rooms_of(part_of_pieces(self._pieces, 0, last), wanted) if wanted > 0.0 else None
        if rooms and self._planned(last, ends, rooms, self._u, self._speed) is not None:
            # the motion is slow enough already, as curvature limits it here and not the feed
            self._turn_to(wanted)
            return False
        braked = self._braked(last, ends, rooms)
        if braked is not None:
            yield self._go(braked, 1)
            if wanted > 0.0:
                self._turn_to(wanted)
        else:  # from a later node
            assert self._hand is not None
            rows = self._hand.rows
            steps = _steps(rows[:1], self._hand.begin)
            yield self._go(self._hand._replace(rows=np.vstack([steps, rows[1:]])), 1)
        return True

    def _turn_to(self, factor: float) -> None:
        """Use another feed factor for planning from here on."""
        assert self._pieces is not None
        self._factor, self._rooms = factor, self._rooms_of(self._pieces, factor)

    def _braked(self, last: int, ends: bool, rooms: list[_Room] | None) -> _Plan | None:
        """Return a plan that first brakes until it can continue under the caps in `rooms`, or to rest if `rooms` is
        None.

        The result is None if there is no such plan, or if only the pieces ahead are too slow for the current speed.
        """
        assert self._pieces is not None
        begin = np.concatenate([[0.0], np.cumsum(self._pieces.length[:last])])
        speed = min(self._speed, float(rooms[0].plateau[0])) if rooms else 0.0
        room, stop = self._rooms[0], begin[-1] * (1.0 - MARGIN)
        path = Path(begin, room.most[:last], room.caps[:last], self._limits)
        for _ in range(_CAPS):
            braking = brake_soon(path, self._u, stop, self._speed, speed)
            row = np.array(columns(braking))
            if braking.peak == 0.0 or not takes_time(braking, begin):
                return None
            if rooms is None:
                return _Plan(begin, row[None, :], False)
            lowest = float(np.min(rooms[0].plateau[: int(np.searchsorted(begin, braking.end, side="left"))]))
            if speed <= lowest:
                behind = self._planned(last, ends, rooms, braking.end, speed)
                return behind._replace(rows=np.vstack([row, behind.rows])) if behind is not None else None
            speed = lowest
        return None

    def stop(self) -> Part | None:
        """Return the part from the end of the last one to the stop already planned, or None at rest before a run."""
        if self._pieces is None or self._hand is None or not len(self._hand.rows):
            return None
        pieces = part_of_pieces(self._pieces, 0, len(self._hand.begin) - 1)
        return self._part(pieces, self._hand.begin, self._hand.rows, True)

    def _append(self, pieces: Pieces) -> None:
        rooms = self._rooms_of(pieces, self._factor)
        if self._pieces is None:
            self._pieces, self._rooms = pieces, rooms
            return
        self._pieces = one_after_the_other([self._pieces, pieces])
        self._rooms = [
            _Room(*(np.concatenate(arrays) for arrays in zip(*both, strict=True)))
            for both in zip(self._rooms, rooms, strict=True)
        ]

    def _planned(self, last: int, ends: bool, rooms: list[_Room], u: float, speed: float) -> _Plan | None:
        """Return the fastest plan from u to a stop at the end of the first `last` pieces, or None if the speed is too
        high to stop.
        """
        assert self._pieces is not None
        begin = np.concatenate([[0.0], np.cumsum(self._pieces.length[:last])])
        # the stop of a window lies before the joint, so that rounding cannot move it to the next piece
        stop = begin[-1] if ends else begin[-1] * (1.0 - MARGIN)
        size = 4 * last + 16
        plans: list[np.ndarray] = []
        for room in rooms:
            path = Path(begin, room.most[:last], room.caps[:last], self._limits)
            slow, stack, rows = np.zeros(last, np.int64), rows_for(Stretch, size), rows_for(Stretch, size)
            count = plan(path, rooms[0].caps[:last], u, stop, speed, slow, stack, rows)
            if count >= 0:
                plans.append(rows[:count])
        return _Plan(begin, min(plans, key=_time), ends) if plans else None

    def _go(self, planned: _Plan, count: int) -> Part:
        """Return the first `count` stretches of a plan as a part; the others become the planned stop."""
        assert self._pieces is not None
        if planned.ends and count == len(planned.rows):
            whole = self._part(self._pieces, planned.begin, planned.rows, True)
            self._begin()
            return whole
        kept, begin = planned.rows[:count], planned.begin
        stretch = by_field(Stretch, kept[-1])
        pieces, node = self._pieces, float(stretch.end)
        place = min(int(np.searchsorted(begin, node, side="right")) - 1, len(begin) - 2)
        if place + 1 < len(pieces.length) and node - begin[place] >= pieces.length[place]:
            place += 1  # at a joint, up to rounding
        self._u, self._speed = max(node - float(begin[place]), 0.0), float(stretch.v1)
        self._pieces = part_of_pieces(pieces, place, len(pieces.length))
        self._rooms = [_Room(room.most[place:], room.caps[place:]) for room in self._rooms]
        self._hand = _Plan(begin[place:], planned.rows[count:], planned.ends)
        return self._part(part_of_pieces(pieces, 0, place + 1), begin, kept, False)

    def _rooms_of(self, pieces: Pieces, factor: float) -> list[_Room]:
        """Return the bounds and caps of pieces at this feed factor, for each pair in `SHARES`."""
        n, rooms = len(pieces.length), list[_Room]()
        # on a traverse the velocity limits are the feed; a factor above 1 must not raise them
        limits = self._limits * Limits(min(factor, 1.0), 1.0, 1.0, 1.0)
        for shares in SHARES:
            room = _Room(rows_for(Slopes, n, len(limits)), rows_for(Cap, n))
            pieces_room(pieces, factor, limits, *shares, *room)
            rooms.append(room)
        return rooms

    def _part(self, pieces: Pieces, begin: np.ndarray, rows: np.ndarray, ends: bool) -> Part:
        """Return one part of the motion as time intervals of constant snap: two ramps of seven phases and a plateau for
        each stretch.
        """
        size = 15 * len(rows)
        room = Motion(np.zeros(size), np.zeros(size, np.int64), *(np.zeros(size) for _ in range(5)))
        count = timed(begin, np.ascontiguousarray(rows), room)
        motion = Motion._make([array[:count].copy() for array in room])
        self.time += float(motion.duration.sum())
        return Part(pieces._replace(feed=pieces.feed * self._factor), motion, ends, factor=self._factor)


def plan_run(pieces: Pieces, limits: np.ndarray, window: int = WINDOW) -> Motion:
    """Return the motion along a whole run; `limits` and `window` as for `Schedule`."""
    motions, first = list[Motion](), 0
    for part in Schedule(limits, window).add(Section(pieces, True)):
        assert isinstance(part, Part)  # it holds only with an override
        motions.append(part.motion._replace(piece=part.motion.piece + first))
        first += len(part.pieces.length) - 1  # the next part begins on the piece where this one ends
    return Motion(*(np.concatenate(arrays) for arrays in zip(*motions, strict=True)))


def _time(rows: np.ndarray) -> float:
    """Return the total duration of stretches, s."""
    now = by_field(Stretch, rows)
    up, down = duration.python(now.up), duration.python(now.down)
    way = now.end - now.begin - 0.5 * (now.v0 + now.peak) * up - 0.5 * (now.v1 + now.peak) * down
    return float(np.sum(up + down + np.maximum(way, 0.0) / now.peak))


def _cut(planned: _Plan) -> tuple[_Plan, int]:
    """Split the plateau at which the final part of a window ends; return the plan, and the number of stretches in this
    part.
    """
    rows, ends = planned.rows, _KEPT * planned.begin[-1]
    count = int(np.searchsorted(np.asarray(by_field(Stretch, rows).end), ends, side="right"))
    if count < len(rows):
        now = by_field(Stretch, rows[count])
        low, high = plateau_begin.python(now), plateau_end.python(now)
        cut, margin = min(ends, high), MARGIN * (planned.begin[-1] - planned.begin[0])
        if now.end - cut <= margin:
            return planned, count + 1
        if cut - low > margin:
            both = [columns(_before(now, cut)), columns(_behind(now, cut))]
            return planned._replace(rows=np.vstack([rows[:count], both, rows[count + 1 :]])), count + 1
    return planned, count


def _before(stretch: Stretch, u: float) -> Stretch:
    """Return a stretch up to a point of its plateau."""
    return stretch._replace(end=u, v1=stretch.peak, down=NO_RAMP)


def _behind(stretch: Stretch, u: float) -> Stretch:
    """Return a stretch from a point of its plateau on."""
    return stretch._replace(begin=u, v0=stretch.peak, up=NO_RAMP)


def _steps(rows: np.ndarray, begin: np.ndarray) -> np.ndarray:
    """Split stretches at all their nodes: after ramps, and after each `HORIZON` of a plateau."""
    steps, margin = list[list[float]](), MARGIN * (begin[-1] - begin[0])
    for row in rows:
        now = by_field(Stretch, row)
        low, high = plateau_begin.python(now), plateau_end.python(now)
        cuts, least = [now.begin], max(margin, 1e-12 * (now.end - now.begin))
        if low > now.begin:
            cuts.append(low)
        many = int(np.ceil((high - low) / (HORIZON * now.peak))) if high - low > least else 0
        cuts += [low + (high - low) * (k + 1) / many for k in range(many)]
        if now.end > cuts[-1] and now.v1 < now.peak:
            cuts.append(now.end)
        cuts[-1] = now.end
        for k, (left, right) in enumerate(pairwise(cuts)):
            step = _behind(now, left) if k else now
            steps.append(columns(_before(step, right) if right < now.end else step))
    return np.array(steps)
