"""Setpoints of a part program: planned, proven and sampled section by section in constant memory.

A section leaves the planner only after its proof.  If the proof fails, sampling continues with `proven` False so that
all faults are counted; these samples must not be used.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Generator, Iterable, Iterator, Sequence
from contextlib import closing
from contextvars import copy_context
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from feeddrive.language.errors import FeeddriveError, ProgramError
from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.source import Records, Records2
from feeddrive.language.quantity import Quantity, number
from feeddrive.language.text import Text
from feeddrive.language.threads import ahead, through
from feeddrive.path.feed_loss import FeedLossRecorder
from feeddrive.path.geometry.joints import SMOOTH, Joiner
from feeddrive.path.geometry.segments import Chain, chains
from feeddrive.path.geometry.weights import ANGLE_TOLERANCE
from feeddrive.path.limits import LETTERS, MachineLimits
from feeddrive.path.lines_along import LinesAlong
from feeddrive.path.motion import (
    LINE,
    Derivatives,
    Motion,
    Part,
    Pause,
    Pieces,
    Section,
    TipColumns,
    at_instant,
    counted,
    derivatives,
    interval_of,
    part_of_pieces,
)
from feeddrive.path.program.blocks import Line
from feeddrive.path.program.budget import Spending
from feeddrive.path.program.moves import Arc, Begin, Move, Spline, Straight, ToolPoint
from feeddrive.path.proof import Prover
from feeddrive.path.purpose import DEFAULT, Settings
from feeddrive.path.schedule.crossings import Lines
from feeddrive.path.schedule.override import Overridden, Override
from feeddrive.path.schedule.planner import Planner, Scheduled
from feeddrive.path.tip_proof import LEFT, TipProver
from feeddrive.path.whereabouts import TANGENT, direction_of, end_of, tip_speed, where_at

if TYPE_CHECKING:
    from concurrent.futures import Executor, Future

# planning twice takes twice the time, so longer chains are joined by geometry alone
SHORT = 100  # largest number of segments of a chain that is planned in two ways
# shorter programs are planned sooner than threads would help
LONG = 500  # number of segments from which on a program is planned on several threads
_AHEAD = 8  # largest number of chains, of parts to lift, and of parts, that wait for the next stage


def planned(
    moves: Iterable[Move],
    axes: str,
    limits: np.ndarray,
    override: Override | None = None,
    angle_tolerance: ArrayLike = ANGLE_TOLERANCE,
    tip: TipProver | None = None,
    spending: Spending | None = None,
    threads: int = 1,
) -> Generator[Part | Pause]:
    """Yield the runs of a program, each from rest to rest in one or more parts, and the pauses between them.

    Segments are planned in windows, and a part is yielded as soon as it is final, so memory does not grow with the
    program.

    axes             letters of the machine's axes, in the order of `limits`
    limits           limits of velocity to snap of each axis, m/s .. m/s⁴, shape (N, 4)
    override         feed override
    angle_tolerance  tolerance of the rotary axes, as in `chains`, rad
    tip              the prover of paths of the tip, which also has the travel of the joints
    spending         counts motion and processor time, as in `chains`
    threads          number of chains, or of sections of a chain, that are planned at a time.  If it is more than 1, a
                     long program is read in the caller's thread, scheduled in another one, and lifted in others; parts,
                     pauses and errors are the same, to the bit.  A program with an override is planned in one thread

    Raises ProgramError as `chains` does.  The parts are planned but not proven: pass them to a `Prover`.  Close the
    generator, or use it up, before `moves` is closed.
    """
    tip = tip or TipProver()
    overridden = None if override is None else Overridden(limits, override)
    segments = chains(moves, axes, angle_tolerance, spending)
    threads = 1 if overridden is not None else threads
    is_long = False
    if threads > 1:
        segments, is_long = _begun(segments)
    if is_long:
        yield from _on_threads(segments, limits, tip, threads)
    else:
        yield from _leaving(_in_turn(_joined(segments, limits, tip, overridden, None), limits, overridden))


def _begun(segments: Iterator[Chain | Pause]) -> tuple[Iterator[Chain | Pause], bool]:
    """Return the chains and pauses, and True if they have more than `LONG` segments."""
    first, count, error = list[Chain | Pause](), 0, None
    try:
        for each in segments:
            first.append(each)
            count += len(each.tolerance) if isinstance(each, Chain) else 0
            if count > LONG:
                break
    except FeeddriveError as raised:
        error = raised

    def again() -> Iterator[Chain | Pause]:
        yield from first
        if error is not None:  # behind what came before
            raise error
        yield from segments

    return again(), count > LONG


class _Frame(NamedTuple):
    """The coordinates of paths.

    limits   limits in the coordinates in which the path is planned, in which angles may be lengths, shape (N, 4)
    weights  m for each rad of the axes; None: all are planned in m
    tip      axes and kinematics of a path of the tip, which is planned in m and rad
    """

    limits: np.ndarray
    weights: np.ndarray | None
    tip: TipColumns | None


class _Joined(NamedTuple):
    """A chain as joined.

    stop     True for each joint at which the motion stops, whose path modes are `modes`
    parts    its motion, if it was planned already
    rounded  False if all joints at which the motion goes on are smooth by themselves
    """

    frame: _Frame
    sections: list[Section]
    stop: np.ndarray
    modes: Sequence[str]
    ends: bool
    parts: list[Part] | None = None
    rounded: bool = True


def _joined(
    found: Iterable[Chain | Pause],
    limits: np.ndarray,
    tip: TipProver,
    overridden: Overridden | None,
    workers: Executor | None,
) -> Iterator[_Joined | Future[_Joined] | Pause]:
    """Yield the chains of a program as joined, and the pauses between them; workers plan those from rest to rest."""
    frame, joiner = _Frame(limits, None, None), Joiner()
    # at the undecided joints of a tip: distances of chords from their splines, m, and of directions, rad
    errors: deque[tuple[float, float]] = deque()
    for segments in found:
        if isinstance(segments, Pause):
            yield segments
            continue
        weights = frame.weights
        same = segments.weights is None or (weights is not None and np.array_equal(segments.weights, weights))
        if segments.tip is not frame.tip or (segments.tip is None and not same):
            # at a stop, where all earlier parts have been yielded
            weights = segments.weights
            # the joints of a tip are planned in m and rad
            weighted = limits if weights is None or segments.tip else limits * weights[:, None]
            frame = _Frame(weighted.copy(), weights, segments.tip)  # other limits than before, though they may be equal
            # where angles turn runs do not overlap: corners of a tip are rounded, or it stops
            joiner = Joiner() if segments.tip is None else Joiner(lonely=np.inf)
        if frame.tip is None and joiner.rests and segments.ends:
            # only a chain from rest to rest can be planned by itself, in either way
            if workers is not None:
                yield workers.submit(copy_context().run, _alone, segments, frame)
            else:
                factor = overridden.factor() if overridden else 1.0
                yield _quicker(segments, frame, factor) or _usual(segments, frame, joiner)
            continue
        if frame.tip is None:
            yield _usual(segments, frame, joiner)
            continue
        segments = segments._replace(tolerance=np.where(segments.tolerance > LEFT, segments.tolerance - LEFT, 0.0))
        sections, joint = joiner.join(segments)
        errors.extend(zip(segments.chords, segments.off, strict=True))
        chords, off = np.array([errors.popleft() for _ in joint.stop]).reshape(-1, 2).T
        tip.join(joint.deviation + chords, off, segments)
        sections = _with_corners(sections, [tip.joints(section, segments, frame.tip) for section in sections], tip)
        yield _Joined(frame, sections, joint.stop, segments.modes, segments.ends)


def _usual(segments: Chain, frame: _Frame, joiner: Joiner) -> _Joined:
    """Return a chain with splines and blends, not yet planned."""
    sections, joint = joiner.join(segments)
    rounded = bool(np.any(joint.deviation))
    return _Joined(frame, sections, joint.stop, segments.modes, segments.ends, rounded=rounded)


def _alone(segments: Chain, frame: _Frame) -> _Joined:
    """Return a chain from rest to rest that is planned by itself."""
    joined = _quicker(segments, frame, 1.0) or _usual(segments, frame, Joiner())
    if joined.parts is not None:
        return joined
    return joined._replace(parts=list(Planner(frame.limits).along(joined.sections, True)))


def _in_turn(
    joined: Iterable[_Joined | Future[_Joined] | Pause], limits: np.ndarray, overridden: Overridden | None
) -> Iterator[_Joined | Part | Pause]:
    """Yield each chain as joined, followed by the parts of the motion that are final with it, and the pauses."""
    planner = Planner(limits)
    for item in joined:
        if isinstance(item, Pause):
            if overridden is not None:
                overridden.wait(item.duration)
            yield item
            continue
        assert isinstance(item, _Joined)
        if item.frame.limits is not limits:
            # at a stop
            limits = item.frame.limits
            planner = Planner(limits)
            if overridden is not None:
                overridden.measure(limits)
        yield item
        if overridden is not None:
            yield from overridden.along(item.sections, item.ends, item.parts)
        else:
            yield from planner.along(item.sections, item.ends) if item.parts is None else item.parts


def _leaving(planned: Iterable[_Joined | Part | Pause]) -> Iterator[Part | Pause]:
    """Yield the parts in m and rad, with the lines along them and the path modes of their ends, and the pauses."""
    joints: deque[str] = deque()  # path modes of the undecided joints
    modes: deque[str] = deque()  # path modes at the ends of runs not yet yielded
    lines, frame = LinesAlong(), None
    for each in planned:
        if isinstance(each, Pause):
            yield each
        elif isinstance(each, _Joined):
            frame = each.frame
            if frame.tip is None:  # the pieces of a tip have their lines themselves
                for section in each.sections:
                    lines.add(section)
            joints.extend(each.modes)
            for stop in each.stop:
                mode = joints.popleft()
                if stop:
                    modes.append(mode)
        else:
            assert frame is not None
            part = each._replace(tip=frame.tip) if frame.tip else _in_radians(lines.told(each), frame.weights)
            yield part._replace(mode=modes.popleft()) if part.ends else part


class _End(NamedTuple):
    """The end of the schedule of a chain, which `ends` at rest or goes on."""

    ends: bool


def _on_threads(
    segments: Iterator[Chain | Pause], limits: np.ndarray, tip: TipProver, threads: int
) -> Iterator[Part | Pause]:
    """Yield the parts and pauses of `planned`: read and joined in this thread, scheduled and lifted in others."""
    from concurrent.futures import ThreadPoolExecutor  # not for short programs

    with ThreadPoolExecutor(threads, "plan") as workers:

        def stage(joined: Iterator[_Joined | Future[_Joined] | Pause]) -> Iterator[_Joined | Part | Pause]:
            with closing(ahead(_scheduled(joined, limits, workers), _AHEAD)) as scheduled:
                yield from _lifted(scheduled)

        with closing(through(_joined(segments, limits, tip, None, workers), stage, _AHEAD)) as parts:
            try:
                yield from _leaving(parts)
            finally:
                # what waits is not begun any more
                workers.shutdown(wait=False, cancel_futures=True)


def _scheduled(
    joined: Iterable[_Joined | Future[_Joined] | Pause], limits: np.ndarray, workers: Executor
) -> Iterator[tuple[Planner, Any]]:
    """Yield chains as joined or as a future one, what the schedule makes of them, and the pauses, with the planner."""
    planner = Planner(limits, workers=workers)
    for item in joined:
        if not isinstance(item, _Joined):
            yield planner, item
            continue
        if item.frame.limits is not limits:
            limits = item.frame.limits
            planner = Planner(limits, workers=workers)
        yield planner, item
        for scheduled in planner.scheduled(item.sections):
            yield planner, scheduled
        yield planner, _End(item.ends)


def _lifted(scheduled: Iterable[tuple[Planner, Any]]) -> Iterator[_Joined | Part | Pause]:
    """Yield what `_in_turn` yields."""
    for planner, each in scheduled:
        if isinstance(each, Pause):
            yield each
        elif isinstance(each, _End):
            yield from planner.end() if each.ends else ()
        elif isinstance(each, Scheduled | Lines):
            yield from planner.lifted(each)
        else:
            joined = each if isinstance(each, _Joined) else each.result()
            yield joined
            yield from joined.parts or ()


def _with_corners(sections: list[Section], joints: list[Section], tip: TipProver) -> list[Section]:
    """Return sections of the joints, with tolerances of the corners of the tip at which runs may overlap.

    Around a corner of two lines in which only the tip moves, it moves by the sum of both ways, as the joints do, but
    for a rotation that stands: the joints pass the corner as that of any axes.
    """
    out = list(joints)
    for k in range(len(joints) - 1):
        still = joints[k].pieces.kind[-1] == joints[k + 1].pieces.kind[0] == LINE
        if joints[k].ends and still and sections[k].tolerance > 0.0:
            out[k] = joints[k]._replace(tolerance=sections[k].tolerance)
            tip.pass_corner(sections[k].tolerance)
    return out


def _in_radians(part: Part, weights: np.ndarray | None) -> Part:
    """Return a part in m and rad, planned in coordinates in which angles are lengths."""
    if weights is None:
        return part
    entering = part.entering
    if entering is not None:
        entering = entering._replace(pieces=counted(entering.pieces, 1.0 / weights))
    return part._replace(pieces=counted(part.pieces, 1.0 / weights), entering=entering, weights=weights)


def _quicker(segments: Chain, frame: _Frame, factor: float) -> _Joined | None:
    """Plan a short chain at a feed factor in two ways, once with splines and blends and once with overlapping runs at
    all corners; return the faster plan.

    The parts are None, not yet planned, if both plans are identical; the result is None if the chain is not short.
    """
    if len(segments.tolerance) > SHORT:
        return None
    usual = _usual(segments, frame, Joiner())
    if not usual.rounded:
        return usual  # every corner is a stop already
    # with a limit angle of nearly 0 every corner becomes a stop, which `Crossings` then passes in time
    in_time = _usual(segments, frame, Joiner(SMOOTH, 0.0))
    if np.array_equal(usual.stop, in_time.stop):
        return usual
    both = [
        joined._replace(parts=list(Planner(frame.limits, factor).along(joined.sections, True)))
        for joined in (usual, in_time)
    ]
    return min(both, key=lambda joined: _lasts(joined.parts or []))


def _lasts(parts: list[Part]) -> float:
    return sum(float(part.motion.duration.sum()) for part in parts)


@kernel
def _sample(
    pieces: Pieces,
    motion: Motion,
    begin: float,
    sample_time: float,
    first: int,
    out: Records2[Derivatives],
    r: Records[Derivatives],
) -> int:
    """Write samples `first`, `first` + 1 ... of a motion that starts at time `begin`; return the number of samples
    within it.
    """
    count = 0
    since = begin
    for m in range(len(motion.duration)):
        now = interval_of(motion, m)
        p = int(motion.piece[m])
        while count < len(out):
            # from the sample number: a running sum of sample times would drift in programs of hours
            t = (first + count) * sample_time - since
            if t >= now.duration:
                break
            # the sum of durations may pass a sampling instant by rounding
            p, x = at_instant(pieces, now, p, max(t, 0.0), r, out[count])
            now = now._replace(x=x)
            axes = out[count]
            for i in range(len(r)):
                axes[i] = axes[i]._replace(value=pieces.origin[p, i] + r[i].value)
            count = count + 1
        since = since + now.duration
    return count


class Sampler:
    """A sampler of consecutive parts of runs at the instants k T, k = 0, 1, 2 ...; T is `sample_time` in s."""

    def __init__(self, sample_time: float) -> None:
        self._sample_time = sample_time
        self._begin, self._first = 0.0, 0

    def sample(self, part: Part) -> np.ndarray:
        """Return the position to snap of each axis at the samples within a part, m to m/s⁴, shape (n, N, 5)."""
        return np.concatenate(list(self.slices(part)))

    def slices(self, part: Part, most: int = 16384) -> Iterator[np.ndarray]:
        """Yield the result of `sample` in chunks of limited size, as a part may last for hours."""
        ends = self._begin + float(np.sum(part.motion.duration))
        full = True
        while full:
            sampled = self._along(part.pieces, part.motion, ends, most)
            full = len(sampled) == most
            if part.entering is not None:
                corner = part.entering.pieces.origin[0]
                other = self._along(part.entering.pieces, part.entering.motion, ends, most)
                sampled[:, :, 0] -= corner
                sampled += other
            self._first += len(sampled)
            yield sampled
        self._begin = ends

    def _along(self, pieces: Pieces, motion: Motion, ends: float, most: int) -> np.ndarray:
        axes = pieces.origin.shape[1]
        # one sample more than expected: the division may round down
        left = max(0, int(np.ceil(ends / self._sample_time)) + 1 - self._first)
        out = np.empty((min(most, left), axes, 5))
        count = _sample(pieces, motion, self._begin, self._sample_time, self._first, out, np.zeros((axes, 5)))
        return out[:count]

    def rest(self, position: np.ndarray, duration: float) -> np.ndarray:
        """Return samples, in the form of `sample`, of a standstill of `duration` s at a position (m, shape (N,)),
        e.g. for a dwell.
        """
        ends = self._begin + duration
        count = max(0, int(np.ceil(ends / self._sample_time)) - self._first)
        out = np.zeros((count, len(position), 5))
        out[:, :, 0] = position
        self._begin, self._first = ends, self._first + count
        return out


_AT_FEED = 0.999  # of the feed: above it the feed is the limiting cause
_AT_ONCE = 16384  # largest number of samples of a standstill per block
_HALF = 0.5  # of a limit: a sample below this share of all limits is limited by none

PAUSES = {
    "Hold": "feed hold",
    "ExactStop": "exact stop (G61.1)",
    "Dwell": "dwell (G4)",
    "Stop": "program stop (M0, M1, M60)",
    "Probe": "probe (G38)",
    "Wait": "wait for an input (M66)",
    "ToolPoint": "begin or end of the tool point (G43.4, G43.5, G49, TRAORI, TRAFOOF)",
    "Turn": "the tip stands while axes turn",
    "Tolerance": "change of the tolerance, by which angles are weighted (G64)",
    "ToolChange": "tool change",
    "Spindle": "spindle",
    "Switch": "coolant, output or override",
}
CORNERS = {"": "corner", "exact_path": "corner, exact path (G61)", "continuous": "corner, no tolerance (G64 without P)"}
BENDS = {
    "": "bend that no joint within the tolerance rounds",
    "exact_path": "bend, exact path (G61)",
    "continuous": "bend, no tolerance (G64 without P)",
}
"""The reasons for stops at joints within the program, by the path mode that requires the stop."""
REASONS = (*CORNERS.values(), *BENDS.values(), *PAUSES.values())


class Standstill(NamedTuple):
    """A standstill of the machine: its start and duration (s), line and position (m), and reason.

    angle  angle of the corner, rad; 0 if the stop is not at a corner
    """

    time: float
    duration: float
    line: int
    position: np.ndarray
    reason: str
    angle: float = 0.0

    def __str__(self) -> str:
        if not self.angle:
            return self.reason
        return self.reason.replace("corner", f"corner of {number(np.degrees(self.angle), 3)}°")


class Samples(NamedTuple):
    """A block of consecutive samples.

    first     number of the first sample; sample k is at k T
    values    position to snap of each axis, m .. m/s⁴, shape (n, N, 5)
    line      line of the part program, shape (n,)
    feed      the programmed path speed, m/s; inf on a traverse, 0 at a standstill, shape (n,)
    speed     the speed along the path, in which angles count as in `Part.weights`, m/s, shape (n,)
    proven    True if the whole motion up to here is proven
    """

    first: int
    values: np.ndarray
    line: np.ndarray
    feed: np.ndarray
    speed: np.ndarray
    proven: bool


class Setpoints:
    """The samples of a program, which can be iterated once; the counts are complete after the iteration.

    moves        moves from `read_program`
    sample_time  sample time of the loop, s
    settings     tolerance and dynamics that moves and limits contain
    spending     counts motion and processor time, and refuses too much; None: within the usual budget
    threads      as for `planned`
    stops        standstills since the list was last emptied
    blocks       number of straight moves, arcs and splines read
    line         program line being read
    seconds      cycle time by cause: the limit used most, the feed, or a standstill
    losses       recorder of the time that is lost against the feed

    Raises ProgramError, located at the program line, as `read_program` and `planned` do.
    """

    def __init__(
        self,
        moves: Iterable[Move],
        limits: MachineLimits,
        sample_time: float,
        override: Override | None = None,
        settings: Settings = DEFAULT,
        spending: Spending | None = None,
        threads: int = 1,
    ) -> None:
        self._threads = threads
        self.limits, self.sample_time, self.settings = limits, sample_time, settings
        self.stops: list[Standstill] = []
        self.blocks = self.line = self.samples = self.runs = 0
        self.time = 0.0
        self._array, self._moves, self._override = limits.array, moves, override
        self._spending = spending or Spending()
        self._source = Line("", 0, "")  # of the move read last
        self.prover = Prover(self._array)
        self.tip = TipProver(tuple(limits.travel.values()))
        self._sampler = Sampler(sample_time)
        self._counts = np.zeros(4 * len(limits.axes) + 3, np.int64)
        self._position = np.zeros(len(limits.axes))
        self._moved: Part | None = None  # the part since then, at whose end nothing has stood yet
        self._along: np.ndarray | None = None  # final direction of the previous run, and the path mode of its stop
        self._mode = ""
        self._waits: Pause | None = None  # the pause since then
        self._last_line = 0
        self.proven = True
        self.losses = FeedLossRecorder(self._array, limits.causes[: 4 * len(limits.axes)], sample_time)

    def __iter__(self) -> Generator[Samples]:
        angles = self.limits.angle_tolerances
        letters = self.limits.letters
        parts = planned(
            self._counted(), letters, self._array, self._override, angles, self.tip, self._spending, self._threads
        )
        # closed here, and not some time after an error: threads may still read the moves
        with closing(parts):
            for part in parts:
                self._check_motion(part)
                if isinstance(part, Part):
                    yield from self._part(part)
                else:
                    yield from self._pause(part)
        ends = self.time
        # an interval includes its start only, so the last position would be missing
        yield from self._rest(self.sample_time, self._last_line)  # the end itself
        self.time = ends

    @property
    def seconds(self) -> dict[str, float]:
        """The cycle time by limiting cause, s."""
        counted = zip(self.limits.causes, self._counts, strict=True)
        return {name: float(n * self.sample_time) for name, n in counted if n}

    def _check_motion(self, part: Part | Pause) -> None:
        """Raise ProgramError if the motion as planned is too long: by an override, or by limits below the feed."""
        lasts = part.duration if isinstance(part, Pause) else float(np.sum(part.motion.duration))
        if self.time + lasts <= self._spending.budget.longest:
            return
        number = part.line if isinstance(part, Pause) else int(part.pieces.line[-1])
        reason = Text(
            f"the motion up to here is planned to last {Quantity((self.time + lasts) / 3600.0, 'h'):4}, and at most "
            f"{Quantity(self._spending.budget.longest / 3600.0, 'h'):4}: see feed, override and limits, or allow more "
            "with --longest"
        )
        raise ProgramError(self._source.file, number, 1, "", reason)

    def _counted(self) -> Iterator[Move]:
        for move in self.limits.resolved(self._moves):
            self.line, self._source = move.source.number, move.source
            self.blocks += isinstance(move, Straight | Arc | Spline)
            if isinstance(move, ToolPoint):
                self.tip.begin(move)
            if isinstance(move, Begin):
                # before the first motion: a dwell may come first, and stands there
                self._position = np.array([move.position[LETTERS.index(letter)] for letter in self.limits.letters])
            yield move

    def _part(self, part: Part) -> Iterator[Samples]:
        pieces, motion, weights = part.pieces, part.motion, part.weights
        if self._along is not None:  # a run begins where another one has ended
            if self._waits is None:
                angle = self._corner(part)
                corner = angle > TANGENT
                reason = (CORNERS if corner else BENDS)[self._mode]
                self._stand(reason, 0.0, int(pieces.line[0]), angle if corner else 0.0)
            else:
                self._stand(PAUSES.get(self._waits.why, self._waits.why), 0.0, self._waits.line)
        self._along = self._waits = None
        self.proven = self.prover.prove(part) and self.proven and self.tip.proven
        for values in self._sampler.slices(part):
            times = (self.samples + np.arange(len(values))) * self.sample_time - self.time
            where = where_at(part, times, self._array[:, 0])
            feed, programmed = where.feed, where.programmed
            if part.tip is not None:
                speed, bound = tip_speed(values, part.tip, where.rate, feed)
                if part.entering is None:
                    feed = programmed = bound
            else:
                speed = np.linalg.norm(values[:, :, 1] if weights is None else values[:, :, 1] * weights, axis=1)
            samples = Samples(self.samples, values, where.line, feed, speed, self.proven)
            self._attribute(samples)
            self.losses.add(values, programmed, where.line, where.shape, part.factor, speed)
            self._spending.check_cpu(Line(self._source.file, int(samples.line[-1]) if len(values) else self.line, ""))
            self.samples += len(values)
            yield samples
        self.time += float(np.sum(motion.duration))
        self._last_line = int((pieces if part.lines is None else part.lines).line[-1])
        self._moved = part
        if part.ends and part.entering is None:
            self._moved, (self._position, along) = None, end_of(part)
            self.runs += 1
            self._along, self._mode = along, part.mode

    def _pause(self, pause: Pause) -> Iterator[Samples]:
        if pause.duration > 0.0:
            self._stand(PAUSES.get(pause.why, pause.why), pause.duration, pause.line)
            self._along = self._waits = None
        elif self._waits is None:
            self._waits = pause
        yield from self._rest(pause.duration, pause.line)

    def _place(self) -> np.ndarray:
        """Return the present position."""
        if self._moved is not None:
            self._moved, (self._position, _) = None, end_of(self._moved)
        return self._position

    def _stand(self, reason: str, duration: float, line: int, angle: float = 0.0) -> None:
        self.stops.append(Standstill(self.time, duration, line, self._place(), reason, angle))
        self.losses.stop(self.time, duration, reason)

    def _rest(self, duration: float, line: int) -> Iterator[Samples]:
        """Yield the samples of a standstill in chunks."""
        ends, longest = self.time + duration, _AT_ONCE * self.sample_time
        while duration > 0.0:
            now = min(duration, longest)
            values = self._sampler.rest(self._place(), now)
            rest = np.zeros(len(values))
            samples = Samples(self.samples, values, np.full(len(values), line), rest, rest, self.proven)
            self.samples += len(values)
            # a standstill has no limiting axis, so it is counted here and not by `_attribute`
            self._counts[-1] += len(values)
            self.losses.add(values, samples.feed, samples.line, np.full(len(values), LINE))
            self._spending.check_cpu(Line(self._source.file, line, ""))
            yield samples
            duration -= now
        self.time = ends

    def _corner(self, part: Part) -> float:
        """Return the angle between the end of the previous run and the start of this one, rad."""
        assert self._along is not None
        r = np.zeros((len(self.limits.axes), 5))
        first = counted(part_of_pieces(part.pieces, 0, 1), part.weights)
        derivatives(int(first.kind[0]), float(first.length[0]), first.shape[0], 0.0, r)
        begin = direction_of(r, float(first.length[0]), 1.0)
        # by the chord: the arc cosine of a scalar product has no digits at small angles
        return 2.0 * float(np.arcsin(min(1.0, 0.5 * float(np.linalg.norm(begin - self._along)))))

    def _attribute(self, samples: Samples) -> None:
        """Attribute each sample to the cause that limits it most."""
        reasons = causes(np.abs(samples.values[:, :, 1:]) / self._array, samples.speed, samples.feed)
        self._counts += np.bincount(reasons, minlength=len(self._counts))


def causes(share: np.ndarray, speed: np.ndarray, feed: np.ndarray) -> np.ndarray:
    """Return the limiting cause of each sample as an index into `MachineLimits.causes`.

    share  utilization of each limit, shape (n, N, 4)
    speed  path speed, m/s, shape (n,)
    feed   programmed path speed, m/s, shape (n,); 0 at a standstill
    """
    rows = share.reshape(len(share), math.prod(share.shape[1:]))
    reasons = np.argmax(rows, axis=1)
    limits = rows.shape[1]
    # later lines overrule earlier ones: standstill, then feed, then the limit used most
    reasons[np.max(rows, axis=1, initial=0.0) < _HALF] = limits + 1
    reasons[speed >= _AT_FEED * feed] = limits
    reasons[feed == 0.0] = limits + 2
    return reasons
