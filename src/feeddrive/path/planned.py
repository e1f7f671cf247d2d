"""The result of a plan: cycle time, peak utilization of each limit, stops, and the motion reduced for plots."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from math import isfinite
from typing import NamedTuple, TypeAlias

import numpy as np

from feeddrive.language.quantity import Quantity, count_of, unit_name
from feeddrive.language.table import Result, Table
from feeddrive.language.text import Text
from feeddrive.path.feed_loss import FeedLoss
from feeddrive.path.kinematics import Kinematics
from feeddrive.path.limits import DERIVATIVES, MachineLimits
from feeddrive.path.motion import TipColumns
from feeddrive.path.proof import Proof
from feeddrive.path.purpose import Settings
from feeddrive.path.setpoints import Samples, Setpoints, Standstill
from feeddrive.path.tip_proof import TipProof

_STRETCHES = 8192
_PER = ("s", "s2", "s3", "s4")
FEW = 1000
"""The largest number of stops listed in a plan; if there are more, all of them go to a separate file."""


class Course(NamedTuple):
    """A motion reduced to n intervals of samples, in SI units (m to m/s⁴).

    time      start of each interval, s, shape (n,)
    position  position at the start of each interval, shape (n, N)
    speed     largest speed along the path in each interval, m/s, shape (n,)
    low, high  minimum and maximum of velocity to snap of each axis, shape (n, N, 4)
    feed      the largest programmed path speed, m/s; inf on a traverse, 0 at a standstill, shape (n,)
    line      line of the part program at the start of each interval, shape (n,)
    """

    time: np.ndarray
    position: np.ndarray
    speed: np.ndarray
    low: np.ndarray
    high: np.ndarray
    feed: np.ndarray
    line: np.ndarray


class Recorder:
    """A recorder that reduces samples, chunk by chunk, to at most 16,384 intervals, whose length grows with the
    motion.
    """

    def __init__(self, axes: int) -> None:
        n = self._axes = axes
        # columns of a stretch: position, speed, low, high, feed, line, samples
        self._place, self._speed, self._low, self._high = (
            slice(n),
            slice(n, n + 1),
            slice(n + 1, 5 * n + 1),
            slice(5 * n + 1, 9 * n + 1),
        )
        self._every, self._rows = 1, np.empty((0, 9 * n + 4))
        self._left: list[np.ndarray] = []  # samples not yet reduced to intervals
        self._waiting = 0

    def add(self, samples: Samples) -> None:
        """Add the next samples."""
        values = samples.values
        if not len(values):
            return
        motion = values[:, :, 1:].reshape(len(values), -1)
        # each row counts its samples: the last row of a group may be shorter, so the index alone gives no time
        one = np.ones(len(values))
        self._left.append(
            np.column_stack([values[:, :, 0], samples.speed, motion, motion, samples.feed, samples.line, one])
        )
        self._waiting += len(values)
        if self._waiting >= max(self._every, _STRETCHES):
            self._gather()

    def _gather(self) -> None:
        rows = np.vstack(self._left)
        self._left, self._waiting = [], 0
        self._rows = np.vstack([self._rows, self._reduced(rows, self._every)])
        # halved at twice the size, so that memory is bounded and no instant of the program is left out
        while len(self._rows) >= 2 * _STRETCHES:
            self._rows = self._reduced(self._rows, 2)
            self._every *= 2

    def _reduced(self, rows: np.ndarray, every: int) -> np.ndarray:
        """Reduce each group of `every` rows to one row; the last group may be shorter."""
        if every == 1:
            return rows
        begins = np.arange(-(-len(rows) // every)) * every
        # an index array copies, so that `rows` is not overwritten below
        reduced = rows[begins]
        for place, of in ((self._speed, np.maximum), (self._low, np.minimum), (self._high, np.maximum)):
            reduced[:, place] = of.reduceat(rows[:, place], begins)
        reduced[:, -3] = np.maximum.reduceat(rows[:, -3], begins)
        reduced[:, -1] = np.add.reduceat(rows[:, -1], begins)
        return reduced

    def course(self, sample_time: float) -> Course:
        """Return the course of all samples so far."""
        if self._waiting:
            self._gather()
        rows = self._rows
        time = (np.cumsum(rows[:, -1]) - rows[:, -1]) * sample_time
        low, high = (rows[:, columns].reshape(-1, self._axes, 4) for columns in (self._low, self._high))
        return Course(
            time, rows[:, self._place], rows[:, self._speed][:, 0], low, high, rows[:, -3], rows[:, -2].astype(np.int64)
        )


def _limit(limit: float, unit: str, per: str) -> Quantity:
    """Return a limit in m or rad per s^n, displayed in mm without its unit (given in the table head) or in degrees with
    its unit.
    """
    if unit == "mm":
        return Quantity(limit, f"m/{per}", form=f"mm/{per}", stays=True, bare=True)
    return Quantity(limit, f"rad/{per}", form=f"{unit}/{per}", stays=True)


@dataclass(frozen=True, eq=False, repr=False)
class Planned(Result):
    """The planned motion of a part program.

    program, machine  names of the part program and of the machine
    limits            limits of the axes
    sample_time       sample time of the setpoints, s
    samples           number of setpoints
    cycle_time        cycle time, dwells included, s
    blocks            number of program blocks with a motion
    runs              number of runs from rest to rest
    proof             proof for all runs; unproven samples are not written
    stops             the first 1,000 standstills; `stop_count` is their total number
    stop_reasons      number of stops of each kind
    seconds           cycle time by limiting cause: the limit used most in a sample, the feed, or a standstill
    course            reduced motion for plots
    loss              time lost against the feed, by cause
    settings          tolerance and dynamics that the plan was made with
    tip               proof for the tip of the tool; None if the program never moves it (G43.4, G43.5)
    kinematics        of the machine with the first tool whose tip is moved
    """

    program: str
    machine: str
    limits: MachineLimits
    sample_time: float
    samples: int
    cycle_time: float
    blocks: int
    runs: int
    proof: Proof
    stops: tuple[Standstill, ...]
    stop_count: int
    stop_reasons: Mapping[str, int]
    seconds: Mapping[str, float]
    course: Course
    loss: FeedLoss
    settings: Settings
    tip: TipProof | None = None
    kinematics: Kinematics | None = None

    @property
    def violations(self) -> int:
        """The number of faults of the proofs: of the axes, and of the tip."""
        return self.proof.count + (0 if self.tip is None else self.tip.faults)

    @property
    def tips(self) -> np.ndarray:
        """The tip of the tool in the frame of the workpiece at the start of each interval of the course, m, (n, 3)."""
        return self.tips_of(self.course.position)

    def tips_of(self, positions: np.ndarray) -> np.ndarray:
        """Return the tip of the tool in the frame of the workpiece, m, shape (n, 3), at positions of the axes."""
        assert self.kinematics is not None
        linear, rotary = self._joints(positions)
        return np.stack(self.kinematics.tip(linear, rotary), axis=1)

    @property
    def tilts(self) -> np.ndarray:
        """The angle between the tool and Z of the workpiece at the start of each interval of the course, rad, (n,)."""
        assert self.kinematics is not None
        x, y, z = self.kinematics.tool_axis(self._joints(self.course.position)[1])
        return np.arctan2(np.hypot(x, y), z) * np.ones(len(self.course.time))

    def _joints(self, positions: np.ndarray) -> tuple[list[np.ndarray], list[np.ndarray]]:
        assert self.kinematics is not None
        columns = TipColumns.of(self.kinematics, self.limits.letters)
        return [positions[:, k] for k in columns.linear], [positions[:, k] for k in columns.rotary]

    def table(self) -> Table:
        """Return a table of the limits of each axis and the peak utilization of each limit."""
        columns = (self.limits.letters, self.limits.shown, self.limits.array, self.proof.use)
        rows = [
            [
                letter,
                *(
                    Text(f"{Quantity(use, 'share')} of {_limit(limit, unit, s)}")
                    if isfinite(limit)
                    else Text("no limit")
                    for limit, use, s in zip(limits_of_axis, used, _PER, strict=True)
                ),
            ]
            for letter, (_, unit), limits_of_axis, used in zip(*columns, strict=True)
        ]
        names = zip(DERIVATIVES, _PER, strict=True)
        heads = ["axis", *(f"{name} {unit_name(f'm/{s}', f'mm/{s}', stays=True)}" for name, s in names)]
        held = "every limit is proven" if self.violations == 0 else count_of(self.violations, "violation")
        title = Text(
            f"{self.program}: {Quantity(self.cycle_time, 's'):6 SI}, {count_of(self.blocks, 'block')}, "
            f"{count_of(self.stop_count, 'stop')}; {held}"
        )
        return Table(title, heads, rows)


Take: TypeAlias = Callable[[Samples, Sequence[Standstill]], None]
"""A callback for each chunk of samples and the stops within it."""


def planned_of(setpoints: Setpoints, program: str, machine: str, take: Take | None = None) -> Planned:
    """Summarize the planned motion of a program; every chunk of samples is passed to `take`, with the stops in it."""
    recorder = Recorder(len(setpoints.limits.axes))
    few: list[Standstill] = []
    reasons: Counter[str] = Counter()
    with closing(iter(setpoints)) as chunks:
        for samples in chunks:
            recorder.add(samples)
            # emptied after each chunk: a program may stop millions of times
            stops, setpoints.stops = setpoints.stops, []
            reasons.update(stop.reason for stop in stops)
            few += stops[: FEW - len(few)]
            if take is not None:
                take(samples, stops)
    return Planned(
        program,
        machine,
        setpoints.limits,
        setpoints.sample_time,
        setpoints.samples,
        setpoints.time,
        setpoints.blocks,
        setpoints.runs,
        setpoints.prover.proof(),
        tuple(few),
        sum(reasons.values()),
        dict(reasons),
        setpoints.seconds,
        recorder.course(setpoints.sample_time),
        setpoints.losses.result(),
        setpoints.settings,
        setpoints.tip.proof(),
        setpoints.tip.kinematics,
    )
