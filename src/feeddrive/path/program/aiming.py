"""The rotary joints of a run of blocks that give the direction of the tool (G43.5): chosen over the whole run.

Which branch of the joints, how many turns, and where the free joint stands in the cone at the pole can only be chosen
with the blocks behind in view (`path/orientation.py`).  Commands therefore wait, with the position that the rotary axes
had before, until the run ends, or the program asks for the position of a rotary axis, or `MOST_AHEAD` directions wait.
Then the first half of them is settled, up to a block outside of the cone, and the other half waits on.

    run       from a direction on, up to G49, a change of an offset or of the path mode, a curve, a probe or a cycle
    cone      within it the joint next to the workpiece moves straight between the blocks before and behind
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from feeddrive.path.kinematics import Kinematics, UnreachableError
from feeddrive.path.orientation import Orientations, angle_between, choose_rotary
from feeddrive.path.program.blocks import AXES, BlockError, located
from feeddrive.path.program.moves import Command, Orientation, Value

MOST_AHEAD = 8192
"""The largest number of directions that wait for those behind them."""
# the weight of an angle in the way along which the free joint turns: 10 um over 0.05 degrees
_RADIAN = 0.01  # m
_OFF = 1e-9  # rad: a smaller angle from the programmed direction is a rounding
# what may wait: none of them depends on the rotary axes but by the position that it names
_WAITING = frozenset(
    {
        "STRAIGHT_TRAVERSE",
        "STRAIGHT_FEED",
        "ARC_FEED",
        "DWELL",
        "SET_FEED_RATE",
        "SET_FEED_MODE",
        "SELECT_PLANE",
        "SET_SPINDLE_SPEED",
        "SET_SPINDLE_MODE",
        "START_SPINDLE_CLOCKWISE",
        "START_SPINDLE_COUNTERCLOCKWISE",
        "STOP_SPINDLE_TURNING",
        "MIST_ON",
        "MIST_OFF",
        "FLOOD_ON",
        "FLOOD_OFF",
        "COMMENT",
        "MESSAGE",
    }
)


class Turning(NamedTuple):
    """How the tool turns, where the program does not say.

    orientation  how it turns in a block
    cone         half angle of the cone at the pole, rad, where a tolerance of the path is stated
    always       True if a tolerance holds also where the program states none (G64 without P)
    """

    orientation: Orientation = "axes"
    cone: float = 0.0
    always: bool = False


BY_AXES = Turning()
"""Rotary joints that move straight, and no cone at the pole."""


class _Aim(NamedTuple):
    """A direction of the tool in the frame of the workpiece, shape (3, 1), the word of the program that gives it, and
    how far it lies behind the one before along the path.
    """

    direction: np.ndarray
    word: str
    way: float


class Aiming:
    """The commands that wait for the rotary joints of their directions.

    position  positions of the rotary axes in the program, degrees, at the end of what has been settled
    """

    def __init__(self) -> None:
        self.position: dict[int, float] = {}
        self._ready: list[Command] = []
        self._waiting: list[tuple[int, Command]] = []  # with the number of directions up to each
        self._aims: list[_Aim] = []
        self._kinematics: Kinematics | None = None
        self._start: list[float] = []
        self._shift: list[float] = []
        self._cone = self._off = 0.0
        self._in_plane = False
        self._tip: list[float] = []

    @property
    def waits(self) -> bool:
        """True if directions wait for those behind them."""
        return bool(self._aims)

    @property
    def busy(self) -> bool:
        """True if commands wait, or are settled and not yet taken."""
        return bool(self._aims or self._ready)

    def begin(
        self,
        kinematics: Kinematics,
        tip: list[float],
        start: list[float],
        shift: list[float],
        cone: float,
        orientation: Orientation,
    ) -> None:
        """Begin a run, unless one has begun.

        tip    place of the tip before it, m
        start  rotary joints before it, rad;  shift  offsets of the rotary axes, rad, which joint positions contain
        """
        if not self._aims:
            self._kinematics, self._start, self._shift = kinematics, start, shift
            self._cone, self._in_plane, self._tip = cone, orientation != "axes", tip

    def aim(self, direction: np.ndarray, tip: list[float], word: str) -> None:
        """Add the direction of the next motion, a unit vector, whose end is `tip`, m."""
        direction = direction[:, None]
        turned = angle_between(direction, self._aims[-1].direction) if self._aims else np.zeros(1)
        way = math.dist(tip, self._tip) + _RADIAN * float(turned[0])
        self._tip = tip
        self._aims.append(_Aim(direction, word, way))
        if len(self._aims) > MOST_AHEAD:
            # the command of this direction is still to come
            self._settle(self._aims[:-1], MOST_AHEAD // 2)

    def holds(self, command: Command) -> bool:
        """Return True if a command waits for directions behind it."""
        return bool(self._aims) and command.name in _WAITING

    def take(self, command: Command) -> list[Command]:
        """Return the commands that are finished with this one; the run has ended unless it holds the command."""
        if self.holds(command):
            self._waiting.append((len(self._aims), command))
        else:
            self._ready.append(command)
        return self.taken()

    def taken(self) -> list[Command]:
        """Return the commands that are finished."""
        ready, self._ready = self._ready, []
        return ready

    def settle(self) -> None:
        """Choose the joints of all directions that wait."""
        if self._aims:
            self._settle(self._aims, len(self._aims))

    def _settle(self, aims: list[_Aim], least: int) -> None:
        """Choose the joints of directions, and settle at least the first ones, up to one outside of the cone."""
        assert self._kinematics is not None
        chosen = self._choose(self._kinematics, aims)
        outside = np.flatnonzero(chosen.branch[:least] >= 0)
        count = least if least == len(aims) or not outside.size else int(outside[-1]) + 1
        letters = self._kinematics.rotary_letters
        axes = [AXES.index(letter.lower()) for letter in letters]
        angles = np.degrees(chosen.rotary - np.array(self._shift)[:, None])
        done = sum(1 for number, _ in self._waiting if number <= count)
        for number, command in self._waiting[:done]:
            k = number - 1
            off = float(chosen.deviation[k]) if chosen.deviation[k] > _OFF else 0.0
            if off != self._off:
                self._off = off
                self._ready.append(Command("TOOL_OFF_AXIS", (math.degrees(off),), command.line))
            self._ready.append(_with(command, dict(zip(axes, angles[:, k].tolist(), strict=True))))
        self._waiting = [(number - count, command) for number, command in self._waiting[done:]]
        self._aims = self._aims[count:]
        self._start = chosen.rotary[:, count - 1].tolist()
        self.position = dict(zip(axes, angles[:, count - 1].tolist(), strict=True))

    def _choose(self, kinematics: Kinematics, aims: list[_Aim]) -> Orientations:
        axis = np.concatenate([aim.direction for aim in aims], axis=1)
        way = np.cumsum([aim.way for aim in aims])
        try:
            return choose_rotary(kinematics, axis, start=self._start, cone=self._cone, way=way, in_plane=self._in_plane)
        except UnreachableError as error:
            fault = BlockError(str(error), aims[error.block].word)
            lines = [command.line for number, command in self._waiting if number == error.block + 1]
            # without a command it is the direction of the present block
            raise (located(lines[0], fault) if lines else fault) from None


def _with(command: Command, angles: dict[int, float]) -> Command:
    """Return a command with other positions of the rotary axes, degrees."""
    if command.name not in ("STRAIGHT_TRAVERSE", "STRAIGHT_FEED", "ARC_FEED"):
        return command
    # the point of an arc: end and center in its plane, turns, level, and the axes from A on
    first = 6 - 3 if command.name == "ARC_FEED" else 0
    values: list[Value] = list(command.values)
    for axis, angle in angles.items():
        values[first + axis] = angle
    return command._replace(values=tuple(values))
