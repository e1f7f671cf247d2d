"""Setpoints of a part program: planned, proven and sampled section by section in constant memory.

A section leaves the planner only after its proof.  If the proof fails, sampling continues with `proven` False so that
all faults are counted; these samples must not be used.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np

from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.source import Records, Records2
from feeddrive.language.quantity import number
from feeddrive.path.geometry.joints import SMOOTH, Joiner, Joint
from feeddrive.path.geometry.segments import Chain, chains
from feeddrive.path.limits import MachineLimits
from feeddrive.path.motion import Derivatives, Motion, Part, Pause, Pieces, Section, chain, cubic, derivatives, way
from feeddrive.path.program.moves import Arc, Move, Spline, Straight
from feeddrive.path.proof import Prover
from feeddrive.path.schedule.override import Overridden, Override
from feeddrive.path.schedule.planner import Planner

# planning twice takes twice the time, so longer chains are joined by geometry alone
SHORT = 100  # largest number of segments of a chain that is planned in two ways


def planned(
    moves: Iterable[Move], axes: str, limits: np.ndarray, override: Override | None = None
) -> Iterator[Part | Pause]:
    """Yield the runs of a program, each from rest to rest in one or more parts, and the pauses between them.

    Segments are planned in windows, and a part is yielded as soon as it is final, so memory does not grow with the
    program.

    axes      letters of the machine's axes, in the order of `limits`
    limits    limits of velocity to snap of each axis, m/s .. m/s⁴, shape (N, 4)
    override  feed override

    Raises ProgramError as `chains` does.  The parts are planned but not proven: pass them to a `Prover`.
    """
    joiner, planner = Joiner(), Planner(limits)
    overridden = None if override is None else Overridden(limits, override)
    joints: deque[str] = deque()  # path modes of the undecided joints
    modes: deque[str] = deque()  # path modes at the ends of runs not yet yielded
    for segments in chains(moves, axes):
        if isinstance(segments, Pause):
            if overridden is not None:
                overridden.wait(segments.duration)
            yield segments
            continue
        # only a chain from rest to rest can be planned by itself, in either way
        alone = joiner.rests and segments.ends
        whole = _quicker(segments, limits, overridden.factor() if overridden else 1.0) if alone else None
        sections, joint = whole[:2] if whole else joiner.join(segments)
        joints.extend(segments.modes)
        for stop in joint.stop:
            mode = joints.popleft()
            if stop:
                modes.append(mode)
        if overridden is not None:
            parts = overridden.along(sections, segments.ends, whole[2] if whole else None)
        else:
            parts = whole[2] if whole else planner.along(sections, segments.ends)
        for part in parts:
            yield part._replace(mode=modes.popleft()) if isinstance(part, Part) and part.ends else part


def _quicker(chain: Chain, limits: np.ndarray, factor: float) -> tuple[list[Section], Joint, list[Part]] | None:
    """Plan a short chain at a feed factor in two ways, once with splines and blends and once with overlapping runs at
    all corners; return the faster plan.

    The result is None if the chain is not short, or if both plans are identical.
    """
    if len(chain.tolerance) > SHORT:
        return None
    # with a limit angle of nearly 0 every corner becomes a stop, which `Crossings` then passes in time
    usual, in_time = Joiner().join(chain), Joiner(SMOOTH, 0.0).join(chain)
    if np.array_equal(usual[1].stop, in_time[1].stop):
        return None
    whole = [(*joined, list(Planner(limits, factor).along(joined[0], True))) for joined in (usual, in_time)]
    return min(whole, key=lambda candidate: _lasts(candidate[2]))


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
    last = len(pieces.length) - 1
    for m in range(len(motion.duration)):
        T = motion.duration[m]
        p = int(motion.piece[m])
        x0 = motion.x[m]
        v = motion.speed[m]
        a = motion.acceleration[m]
        j = motion.jerk[m]
        s = motion.snap[m]
        while count < len(out):
            # from the sample number: a running sum of sample times would drift in programs of hours
            t = (first + count) * sample_time - since
            if t >= T:
                break
            # the sum of durations may pass a sampling instant by rounding
            t = max(t, 0.0)
            here = x0 + way(v, a, j, s, t)
            while here > pieces.length[p] and p < last:
                x0 = x0 - pieces.length[p]
                here = here - pieces.length[p]
                p = p + 1
            here = min(max(here, 0.0), pieces.length[p])
            derivatives(pieces.kind[p], pieces.length[p], pieces.shape[p], here, r)
            axes = out[count]
            chain(cubic(v, a, j, s, t), a + t * (j + 0.5 * t * s), j + t * s, s, r, axes)
            for i in range(len(r)):
                axes[i] = axes[i]._replace(value=pieces.origin[p, i] + r[i].value)
            count = count + 1
        since = since + T
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


_TANGENT = 1e-6  # rad: a smaller angle is not a corner
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
    proven    True if the whole motion up to here is proven
    """

    first: int
    values: np.ndarray
    line: np.ndarray
    feed: np.ndarray
    proven: bool


class Setpoints:
    """The samples of a program, which can be iterated once; the counts are complete after the iteration.

    moves        moves from `read_program`
    sample_time  sample time of the loop, s
    stops        standstills since the list was last emptied
    blocks       number of straight moves, arcs and splines read
    line         program line being read
    seconds      cycle time by cause: the limit used most, the feed, or a standstill

    Raises ProgramError, located at the program line, as `read_program` and `planned` do.
    """

    def __init__(
        self, moves: Iterable[Move], limits: MachineLimits, sample_time: float, override: Override | None = None
    ) -> None:
        self.limits, self.sample_time = limits, sample_time
        self.stops: list[Standstill] = []
        self.blocks = self.line = self.samples = self.runs = 0
        self.time = 0.0
        self._array, self._moves, self._override = limits.array, moves, override
        self.prover = Prover(self._array)
        self._sampler = Sampler(sample_time)
        self._counts = np.zeros(4 * len(limits.axes) + 3, np.int64)
        self._position = np.zeros(len(limits.axes))
        self._along: np.ndarray | None = None  # final direction of the previous run, and the path mode of its stop
        self._mode = ""
        self._waits: Pause | None = None  # the pause since then
        self._last_line = 0
        self.proven = True

    def __iter__(self) -> Iterator[Samples]:
        for part in planned(self._counted(), self.limits.letters, self._array, self._override):
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

    def _counted(self) -> Iterator[Move]:
        for move in self.limits.resolved(self._moves):
            self.line = move.source.number
            self.blocks += isinstance(move, Straight | Arc | Spline)
            yield move

    def _part(self, part: Part) -> Iterator[Samples]:
        pieces, motion = part.pieces, part.motion
        if self._along is not None:  # a run begins where another one has ended
            if self._waits is None:
                angle = self._corner(part)
                corner = angle > _TANGENT
                reason = (CORNERS if corner else BENDS)[self._mode]
                self._stand(reason, 0.0, int(pieces.line[0]), angle if corner else 0.0)
            else:
                self._stand(PAUSES.get(self._waits.why, self._waits.why), 0.0, self._waits.line)
        self._along = self._waits = None
        self.proven = self.prover.prove(part) and self.proven
        for values in self._sampler.slices(part):
            times = (self.samples + np.arange(len(values))) * self.sample_time - self.time
            samples = Samples(self.samples, values, *_where(part, times), self.proven)
            self._attribute(samples)
            self.samples += len(values)
            yield samples
        self.time += float(np.sum(motion.duration))
        self._last_line = int(pieces.line[-1])
        self._position, along = _end(part)
        if part.ends and part.entering is None:
            self.runs += 1
            self._along, self._mode = along, part.mode

    def _pause(self, pause: Pause) -> Iterator[Samples]:
        if pause.duration > 0.0:
            self._stand(PAUSES.get(pause.why, pause.why), pause.duration, pause.line)
            self._along = self._waits = None
        elif self._waits is None:
            self._waits = pause
        yield from self._rest(pause.duration, pause.line)

    def _stand(self, reason: str, duration: float, line: int, angle: float = 0.0) -> None:
        self.stops.append(Standstill(self.time, duration, line, self._position, reason, angle))

    def _rest(self, duration: float, line: int) -> Iterator[Samples]:
        """Yield the samples of a standstill in chunks."""
        ends, longest = self.time + duration, _AT_ONCE * self.sample_time
        while duration > 0.0:
            now = min(duration, longest)
            values = self._sampler.rest(self._position, now)
            samples = Samples(self.samples, values, np.full(len(values), line), np.zeros(len(values)), self.proven)
            self.samples += len(values)
            # a standstill has no limiting axis, so it is counted here and not by `_attribute`
            self._counts[-1] += len(values)
            yield samples
            duration -= now
        self.time = ends

    def _corner(self, part: Part) -> float:
        """Return the angle between the end of the previous run and the start of this one, rad."""
        assert self._along is not None
        r = np.zeros((len(self.limits.axes), 5))
        derivatives(int(part.pieces.kind[0]), float(part.pieces.length[0]), part.pieces.shape[0], 0.0, r)
        begin = _along(r, float(part.pieces.length[0]), 1.0)
        # by the chord: the arc cosine of a scalar product has no digits at small angles
        return 2.0 * float(np.arcsin(min(1.0, 0.5 * float(np.linalg.norm(begin - self._along)))))

    def _attribute(self, samples: Samples) -> None:
        """Attribute each sample to the cause that limits it most."""
        speed = np.linalg.norm(samples.values[:, :, 1], axis=1)
        reasons = causes(np.abs(samples.values[:, :, 1:]) / self._array, speed, samples.feed)
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


def _where(part: Part, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the program line and feed at given times, s, from the start of a part."""
    pieces, motion = part.pieces, part.motion
    begins = np.cumsum(motion.duration) - motion.duration
    m = np.clip(np.searchsorted(begins, times, side="right") - 1, 0, len(begins) - 1)
    far = np.cumsum(pieces.length)
    u = (far - pieces.length)[motion.piece[m]] + motion.x[m]
    v, a, j, s = (row[m] for row in motion[3:])
    gone: Any = way.python  # plain arithmetic, which also accepts arrays
    u += gone(v, a, j, s, times - begins[m])
    p = np.clip(np.searchsorted(far, u), 0, len(far) - 1)
    return pieces.line[p], pieces.feed[p]


def _end(part: Part) -> tuple[np.ndarray, np.ndarray]:
    """Return the position and direction at the end of a part that ends at rest."""
    pieces, motion = part.pieces, part.motion
    p, last = int(motion.piece[-1]), len(pieces.length) - 1
    x = float(motion.x[-1] + way(*(float(column[-1]) for column in (*motion[3:], motion.duration))))
    # a run ends exactly at the end of its path, from which x differs by rounding
    while p < last and (part.ends or x > pieces.length[p]):
        x, p = x - float(pieces.length[p]), p + 1
    length = float(pieces.length[p])
    r = np.zeros((pieces.origin.shape[1], 5))
    derivatives(int(pieces.kind[p]), length, pieces.shape[p], length if part.ends else min(x, length), r)
    return pieces.origin[p] + r[:, 0], _along(r, length, -1.0)


def _along(r: np.ndarray, length: float, side: float) -> np.ndarray:
    """Return the path direction at the start (`side` 1) or end (-1) of a piece, also where r' of a spline is 0."""
    # r' vanishes at the end of a spline whose control points coincide: the next derivative has the direction
    for k in (1, 2, 3):
        size = float(np.linalg.norm(r[:, k]))
        if size * length ** (k - 1) > _TANGENT:
            return side ** (k - 1) * r[:, k] / size
    return np.zeros(len(r))
