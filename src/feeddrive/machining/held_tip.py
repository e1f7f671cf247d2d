"""A rotary joint turns while the linear joints hold the tip of the tool at a point of the workpiece, through the loops.

A probe with the sphere at the tip and its sensors on the workpiece (or a ball bar between both) reads the tip against
the point in three directions: radial, from the axis of the joint to the tip; tangential, in which the joint moves the
tip; axial, along the axis.  Such tests of a rotary axis with linear axes that follow belong to the accuracy of
interpolations of ISO 10791-6.

    reading = error · (radial, tangential, axial),   error = actual.tip(q(t)) - p
    actual  kinematics with the location errors of the axes (`pivots.py`);  q(t)  joints behind their loops

An axis of a table that lies e beside its nominal place gives error = (I - R) e, so that radial and tangential reading
are sine waves of amplitude |e| over the angle, whatever the distance from the axis; one that is tilted by α gives an
axial wave of amplitude α times the distance.  What the loops add comes on top and depends on the direction of motion.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from feeddrive.blocks.families import Reference
from feeddrive.blocks.reference.recorded import Recorded
from feeddrive.language.errors import NotPlannedError, ParameterError, nearest
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity
from feeddrive.language.series import Taylor
from feeddrive.language.table import Column, Result, Table
from feeddrive.language.text import Text
from feeddrive.loop.machine import Machine
from feeddrive.loop.simulate import simulate
from feeddrive.machining.pivots import PivotError, held_tip_error, with_pivot_errors
from feeddrive.path.kinematics import LINEAR, Kinematics, Vector
from feeddrive.path.limits import LETTERS, MachineLimits
from feeddrive.path.program.blocks import Line
from feeddrive.path.program.moves import Begin, Dwell, End, Feed, Move, PathMode, Straight, ToolPoint
from feeddrive.path.setpoints import Setpoints

DIRECTIONS = ("radial", "tangential", "axial")
"""The directions of the readings."""
SHORTEST = np.pi / 3.0
"""The least travel of the joint, rad: mean and wave of a shorter arc cannot be told apart."""
NEAREST = 1e-3
"""The least distance of the tip from the axis of the joint, m: on the axis there is no radial direction."""
_SETTLES = 0.3  # s at both ends, in which the loops come to rest


class Wave(NamedTuple):
    """A reading over the angle: its wave of one period a turn, by least squares, and its extent, m.

    amplitude  of the wave
    angle      of the joint at which the wave is largest, rad
    width      difference of the largest and the smallest reading
    hysteresis  the largest difference of the readings of both ways at the same angle, without the outer 5 % of the way
    """

    amplitude: float
    angle: float
    width: float
    hysteresis: float


@dataclass(frozen=True, eq=False, repr=False)
class HeldTip(Result):
    """The readings of a tip that is held while a rotary joint turns there and back.

    joint      letter of the joint
    tip        the point of the workpiece, m
    lever      distance of the point from the axis of the joint, m
    angle      set position of the joint, rad, shape (n,)
    way        1 while it turns towards its end, -1 back, 0 while it stands, shape (n,)
    reading    radial, tangential and axial reading, m, shape (3, n)
    geometry   the part of the location errors of the axes, m, shape (3, n); the rest is due to the loops
    sample_time  s
    errors     location errors of the rotary joints, by letter
    """

    name: str
    joint: str
    tip: Vector
    lever: float
    angle: np.ndarray
    way: np.ndarray
    reading: np.ndarray
    geometry: np.ndarray
    sample_time: float
    errors: Mapping[str, PivotError] = field(default_factory=dict[str, PivotError])

    @property
    def waves(self) -> dict[str, Wave]:
        """The wave of each reading by direction, of both ways together."""
        return {name: self._wave(row) for name, row in zip(DIRECTIONS, self.reading, strict=True)}

    @property
    def waves_of_geometry(self) -> dict[str, Wave]:
        """The waves that the location errors of the axes alone would give."""
        return {name: self._wave(row) for name, row in zip(DIRECTIONS, self.geometry, strict=True)}

    def _wave(self, row: np.ndarray) -> Wave:
        moves = self.way != 0
        angle, values = self.angle[moves], row[moves]
        # even in the angle, not in time
        weight = np.sqrt(np.abs(np.gradient(self.angle)[moves]))
        columns = np.stack([np.ones(angle.size), np.cos(angle), np.sin(angle)], axis=1)
        _, cosine, sine = np.linalg.lstsq(weight[:, None] * columns, weight * values, rcond=None)[0]
        low, high = float(angle.min()), float(angle.max())
        margin = 0.05 * (high - low)
        places = np.linspace(low + margin, high - margin, 721)
        ways = []
        for sign in (1, -1):
            here = self.way == sign
            order = np.argsort(self.angle[here], kind="stable")
            ways.append(np.interp(places, self.angle[here][order], row[here][order]))
        return Wave(
            float(np.hypot(cosine, sine)),
            float(np.arctan2(sine, cosine)),
            float(np.ptp(values)),
            float(np.max(np.abs(ways[0] - ways[1]))),
        )

    def table(self) -> Table:
        """Return a table with one row for each direction."""
        of_geometry = self.waves_of_geometry
        rows = [
            [
                name,
                wave.amplitude,
                Quantity(wave.angle, "rad", form="4 deg", stays=True) if wave.amplitude > 0.0 else None,
                of_geometry[name].amplitude,
                wave.width,
                wave.hysteresis,
            ]
            for name, wave in self.waves.items()
        ]
        columns = [
            "reading",
            Column("wave", "m"),
            "largest at",
            Column("of the axes", "m"),
            Column("width", "m"),
            Column("both ways apart", "m"),
        ]
        low, high = (Quantity(x, "rad", form="6 deg", stays=True) for x in (self.angle.min(), self.angle.max()))
        title = Text(
            f"{self.name}: {self.joint} from {low} to {high} and back, tip held {Quantity(self.lever, 'm'):4 mm} from "
            "its axis"
        )
        return Table(title, columns, rows)


def held_tip_test(
    machine: Machine,
    kinematics: Kinematics,
    limits: MachineLimits,
    joint: str,
    tip: Sequence[float],
    *,
    begin: float = 0.0,
    end: float = 2.0 * np.pi,
    held: float = 0.0,
    speed: float = 0.5,
    errors: Mapping[str, PivotError] | None = None,
    seed: int = 0,
    name: str = "held tip",
    progress: Progress | None = None,
) -> HeldTip:
    """Turn a rotary joint of a machine there and back, while its linear joints hold the tip, and read the tip.

    machine     the loops of all joints, by their letters
    kinematics  as the control knows them, with the tool
    limits      of the axes; the motion is planned within them, and proven
    joint       letter of the rotary joint that turns
    tip         point of the workpiece, m, at least 1 mm from its axis
    begin, end  of its travel, rad, at least 60 degrees apart
    held        position of the other rotary joint, rad
    speed       of the joint, rad/s
    errors      location errors of the axes of rotary joints by letter: the control does not know them
    seed        of the noise of the encoders

    Raises ParameterError for a joint that is not there, a travel beyond its ends or too short, a tip on its axis;
    ProgramError for a linear joint beyond its travel; NotPlannedError if the motion cannot be proven.
    """
    errors = dict(errors or {})
    _check(kinematics, joint, begin, end, speed)
    place: Vector = (float(tip[0]), float(tip[1]), float(tip[2]))
    by_letter = {axis.upper(): axis for axis in machine.axes()}
    missing = [letter for letter in kinematics.letters if letter not in by_letter]
    if missing:
        raise ParameterError(f"the machine has no axis for joint {missing[0]}; it has {', '.join(by_letter.values())}")
    moves = _moves(kinematics, joint, place, (begin, end), held, speed)
    rows = _planned(moves, limits, float(machine.sample_time), name)
    order = [limits.letters.index(letter) for letter in kinematics.letters]
    wanted = rows[:, order, 0].T
    directions, lever = _directions(kinematics, joint, wanted)
    references: dict[str, Reference] = {
        by_letter[letter]: _recorded(rows[:, k], float(machine.sample_time)) for k, letter in enumerate(limits.letters)
    }
    run = simulate(machine, references, seed=seed, name=name, progress=progress)
    n = min(run.samples, wanted.shape[1])
    joints = np.stack([run[f"{by_letter[letter]}.position_load"][:n] for letter in kinematics.letters])
    actual = with_pivot_errors(kinematics, errors)
    linear = len(LINEAR)
    off = np.stack(actual.tip(joints[:linear], joints[linear:])) - np.array(place)[:, None]
    of_axes = held_tip_error(kinematics, actual, place, wanted[linear:, :n])
    turning = linear + kinematics.rotary_letters.index(joint)
    return HeldTip(
        name,
        joint,
        place,
        lever,
        wanted[turning, :n],
        np.sign(rows[:n, limits.letters.index(joint), 1]).astype(np.int64),
        np.einsum("kin,in->kn", directions[..., :n], off),
        np.einsum("kin,in->kn", directions[..., :n], of_axes),
        run.sample_time,
        errors,
    )


def _check(kinematics: Kinematics, joint: str, begin: float, end: float, speed: float) -> None:
    if joint not in kinematics.rotary_letters:
        there = kinematics.rotary_letters
        raise ParameterError(f"the machine has no rotary joint '{joint}'{nearest(joint, there)}")
    found = next(each for each in kinematics.joints if each.letter == joint)
    for what, at in (("begin", begin), ("end", end)):
        if not found.least <= at <= found.most:
            least, most = Quantity(found.least, "rad"), Quantity(found.most, "rad")
            raise ParameterError(
                Text(
                    f"{what} = {Quantity(at, 'rad'):6 deg} must lie within the travel of joint {joint}, {least:6 deg} "
                    f"to {most:6 deg}"
                )
            )
    if not abs(end - begin) >= SHORTEST:
        raise ParameterError(
            Text(
                f"begin and end are {Quantity(abs(end - begin), 'rad'):4 deg} apart, and mean and wave of a reading "
                f"need {Quantity(SHORTEST, 'rad'):4 deg}: turn the joint further"
            )
        )
    if not 0.0 < speed < np.inf:
        raise ParameterError(f"speed = {speed} rad/s must be > 0 rad/s")


def _moves(
    kinematics: Kinematics, joint: str, tip: Vector, ends: tuple[float, float], held: float, speed: float
) -> Iterator[Move]:
    """Yield the moves of the joint to its end and back, with the tip at a point."""
    other = next(letter for letter in kinematics.rotary_letters if letter != joint)

    def point(linear: Sequence[float], angle: float) -> tuple[float, ...]:
        row = [0.0] * len(LETTERS)
        for letter, x in zip(LINEAR, linear, strict=True):
            row[LETTERS.index(letter)] = float(x)
        row[LETTERS.index(joint)], row[LETTERS.index(other)] = angle, held
        return tuple(row)

    line, begin = Line("held tip", 1, ""), ends[0]
    rotary = [begin if letter == joint else held for letter in kinematics.rotary_letters]
    one, two = (point(tip, angle) for angle in ends)
    yield Begin(line, point(kinematics.linear(tip, rotary), begin))
    yield PathMode(line, "continuous", 0.0, 0.0)
    yield Feed(line, speed, speed)
    yield ToolPoint(line, kinematics)
    yield Dwell(line, _SETTLES)
    yield Straight(line, one, two, False)
    yield Dwell(line, _SETTLES)
    yield Straight(line, two, one, False)
    yield Dwell(line, _SETTLES)
    yield End(line)


def _planned(moves: Iterator[Move], limits: MachineLimits, sample_time: float, name: str) -> np.ndarray:
    """Return positions to snap of all axes in each sample, shape (n, N, 5)."""
    setpoints = Setpoints(moves, limits, sample_time)
    rows = [samples.values for samples in setpoints]
    tip = setpoints.tip.proof()
    if setpoints.prover.proof().count or (tip is not None and tip.faults):
        raise NotPlannedError(
            f"{name}: the motion could not be proven to keep its limits: this is a fault of feeddrive"
        )
    return np.concatenate(rows)


def _recorded(rows: np.ndarray, sample_time: float) -> Recorded:
    position, velocity, acceleration, jerk, snap = (np.ascontiguousarray(column) for column in rows.T)
    return Recorded(
        position=position, velocity=velocity, acceleration=acceleration, jerk=jerk, snap=snap, sample_time=sample_time
    )


def _directions(kinematics: Kinematics, joint: str, position: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the directions of the readings in the frame of the workpiece, (3, 3, n), and the distance from the axis.

    The tip of a machine that turns this joint alone moves on a circle: r' is tangential, and r'' points to the axis.
    """
    linear = len(LINEAR)
    n = position.shape[1]
    turning = linear + kinematics.rotary_letters.index(joint)
    series = [Taylor(row, (np.ones if k == turning else np.zeros)(n), np.zeros(n)) for k, row in enumerate(position)]
    moved = kinematics.tip(series[:linear], series[linear:])
    along, inward = (np.stack([row.terms[k] for row in moved]) for k in (1, 2))
    lever = float(np.min(np.linalg.norm(along, axis=0)))
    if lever < NEAREST:
        raise ParameterError(
            Text(
                f"the tip lies {Quantity(lever, 'm'):4 mm} from the axis of joint {joint}, and a radial direction "
                f"needs {Quantity(NEAREST, 'm'):mm}: move it outward"
            )
        )
    radial = -inward / np.linalg.norm(inward, axis=0)
    tangential = along / np.linalg.norm(along, axis=0)
    return np.stack([radial, tangential, np.cross(radial, tangential, axis=0)]), lever
