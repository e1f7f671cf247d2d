"""What a part program has set: modes, position, and the offsets between program and machine.

machine = R(rotation) (program + axis_offset) + origin + tool_offset          rotation in the XY plane, degrees
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from feeddrive.path.program.blocks import AXES
from feeddrive.path.program.parameters import Parameters

LINEAR = (0, 1, 2, 6, 7, 8)
"""Axes with lengths: X Y Z U V W; the others hold degrees."""
INCH = 25.4
SYSTEM, G92_ON, G92, HOME_1, HOME_2 = 5220, 5210, 5211, 5161, 5181
SYSTEMS = 9


def rotated(x: float, y: float, degrees: float) -> tuple[float, float]:
    """A point turned about zero."""
    if degrees == 0:
        return x, y
    angle = math.radians(degrees)
    c, s = math.cos(angle), math.sin(angle)
    return c * x - s * y, s * x + c * y


class State:
    """Modes of a program, and its position in program coordinates and the program's unit of length.

    inch      whether the program's unit is the inch
    user_inch whether parameters and tables are kept in inches
    motion    the modal motion: G1 is 10; 800 is none
    cycle     words of a series of canned cycles
    level     where these cycles began: axis and coordinate
    """

    def __init__(self, parameters: Parameters, user_inch: bool) -> None:
        self.parameters = parameters
        self.user_inch = user_inch
        self.inch = False
        self.position = [0.0] * 9
        self.origin = [0.0] * 9
        self.rotation = 0.0
        self.axis_offset = [0.0] * 9
        self.tool_offset = [0.0] * 9
        self.system = 1
        self.motion = 800
        self.plane = 170
        self.feed_mode = 940
        self.feed = 0.0
        self.feed_override = True
        self.speed_override = True
        self.incremental = False
        self.arc_absolute = False
        self.retract_to_r = True
        self.path_mode = "CANON_CONTINUOUS"
        self.tolerance = 0.0
        self.naive_tolerance = 0.0
        self.spindle = 0
        self.speed = 0.0
        self.tool = 0
        self.selected = 0
        self.mist = self.flood = False
        self.cycle: dict[str, float] = {}
        self.level: tuple[int, float] | None = None

    # units

    @property
    def scale(self) -> float:
        """Program units in one user unit of length."""
        return 1.0 if self.inch == self.user_inch else INCH if self.user_inch else 1.0 / INCH

    def use_inch(self, inch: bool) -> None:
        """Change the program's unit of length; what the machine stands at does not change."""
        if inch != self.inch:
            self.inch = inch
            if self.level:
                axis, level = self.level
                self.level = axis, level / INCH if inch else level * INCH
            for values in (self.position, self.origin, self.axis_offset, self.tool_offset):
                for axis in LINEAR:
                    values[axis] = values[axis] / INCH if inch else values[axis] * INCH
            for name in ("tolerance", "naive_tolerance"):
                value = getattr(self, name)
                setattr(self, name, value / INCH if inch else value * INCH)

    def stored(self, first: int) -> list[float]:
        """Nine parameters from `first` on, in the program's unit."""
        values = [self.parameters.numbered.get(first + axis, 0.0) for axis in range(9)]
        return self.to_program(values)

    def store(self, first: int, values: Sequence[float]) -> None:
        """Keep nine values as parameters, in the user's unit."""
        scale = self.scale
        for axis, value in enumerate(values):
            self.parameters.numbered[first + axis] = value / scale if axis in LINEAR else value

    def to_program(self, values: Sequence[float]) -> list[float]:
        """Nine values of the user's unit in the program's."""
        scale = self.scale
        return [value * scale if axis in LINEAR else value for axis, value in enumerate(values)]

    # coordinates

    def machine(self, program: Sequence[float]) -> list[float]:
        """Program coordinates in machine coordinates."""
        shifted = [p + a for p, a in zip(program, self.axis_offset, strict=True)]
        shifted[0], shifted[1] = rotated(shifted[0], shifted[1], self.rotation)
        return [s + o + t for s, o, t in zip(shifted, self.origin, self.tool_offset, strict=True)]

    def program(self, machine: Sequence[float]) -> list[float]:
        """Machine coordinates in program coordinates."""
        shifted = [m - o - t for m, o, t in zip(machine, self.origin, self.tool_offset, strict=True)]
        shifted[0], shifted[1] = rotated(shifted[0], shifted[1], -self.rotation)
        return [s - a for s, a in zip(shifted, self.axis_offset, strict=True)]

    def keep_machine(
        self,
        origin: Sequence[float] | None = None,
        rotation: float | None = None,
        axis_offset: Sequence[float] | None = None,
        tool_offset: Sequence[float] | None = None,
    ) -> None:
        """Change offsets while the machine stands still: the program's coordinates of its position change."""
        standing = self.machine(self.position)
        before = self.position
        if origin is not None:
            self.origin = list(origin)
        if rotation is not None:
            self.rotation = rotation
        if axis_offset is not None:
            self.axis_offset = list(axis_offset)
        if tool_offset is not None:
            self.tool_offset = list(tool_offset)
        self.position = self.program(standing)
        if self.level:
            axis, level = self.level
            self.level = axis, level + self.position[axis] - before[axis]

    # what the program can ask for

    def publish(self) -> None:
        """Give parameters that follow the program: #5400 to #5428 and the names that begin with _."""
        live = self.parameters.live
        live[5400] = lambda: float(self.tool)
        for axis in range(9):
            live[5401 + axis] = lambda axis=axis: self.tool_offset[axis] / (self.scale if axis in LINEAR else 1.0)
            live[5420 + axis] = lambda axis=axis: self.position[axis]
            live[f"_{AXES[axis]}"] = live[5420 + axis]
        live |= {
            "_metric": lambda: float(not self.inch),
            "_imperial": lambda: float(self.inch),
            "_absolute": lambda: float(not self.incremental),
            "_incremental": lambda: float(self.incremental),
            "_plane": lambda: float(self.plane),
            "_motion_mode": lambda: float(self.motion),
            "_feed": lambda: self.feed,
            "_rpm": lambda: self.speed,
            "_spindle_on": lambda: float(self.spindle != 0),
            "_spindle_cw": lambda: float(self.spindle > 0),
            "_mist": lambda: float(self.mist),
            "_flood": lambda: float(self.flood),
            "_inverse_time": lambda: float(self.feed_mode == 930),
            "_units_per_minute": lambda: float(self.feed_mode == 940),
            "_units_per_rev": lambda: float(self.feed_mode == 950),
            "_retract_r_plane": lambda: float(self.retract_to_r),
            "_retract_old_z": lambda: float(not self.retract_to_r),
            "_coord_system": lambda: 530.0 + 10 * self.system if self.system <= 6 else 584.0 + self.system,
            "_tool_offset": lambda: float(any(self.tool_offset)),
            "_current_tool": lambda: float(self.tool),
            "_selected_tool": lambda: float(self.selected),
        }
