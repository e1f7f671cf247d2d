"""The kinds of five-axis machines, as `[kinematics]` of a machine file declares them.

[kinematics]
kind = "table_table"               # head_head, head_table
joints = "AC"                      # the rotary joint on the base, and the one that it carries
outer_mm = [0, 0, 0]               # a point on the axis of A, in machine coordinates
inner_mm = [0, 0, 0]               # a point on the axis of C
workpiece_mm = [0, 0, -80]         # origin of the workpiece frame
tool_length_mm = 0

All positions hold for rotary joints at 0.  Equations and signs: `kinematics.py`.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from feeddrive.language.block import Block, Number, choice, parameter, table
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text
from feeddrive.path.kinematics import Kind, Kinematics, Vector

REVERSED = ("", "A", "B", "C", "AB", "AC", "BC")
"""Choices of joints that count against ISO 841."""
_LONGEST = 100.0  # m: a longer offset is one in a wrong unit


class TableTable(Block):
    """A machine whose table tilts and turns, such as a trunnion: the first joint carries the second, which carries the
    workpiece.
    """

    joints: str = choice("rotary joint on the base, and the one it carries", options=("AC", "BC", "AB", "BA"))
    outer: np.ndarray = table("m", "x, y, z of a point on the axis of the first joint", shortest=3)
    inner: np.ndarray = table("m", "x, y, z of a point on the axis of the second joint", shortest=3)
    workpiece: np.ndarray = table("m", "x, y, z of the origin of the workpiece frame", shortest=3)
    tool_length: Number = parameter("m", "from the spindle's gauge point to the tip", least=0, most=_LONGEST)
    nutating: bool = choice("axis of the first joint at 45 degrees between Z and that of its letter", default=False)
    reversed: str = choice("joints that count against ISO 841", options=REVERSED, default="")

    def check(self) -> None:
        """Raise ParameterError for a point that is not x, y, z, or a joint that the machine does not have."""
        _check(self)

    def kinematics(self) -> Kinematics:
        """Return the kinematics of the machine."""
        return _kinematics(self, "table_table", self.outer, self.inner)


class HeadHead(Block):
    """A machine whose head turns and tilts: the first joint carries the second, which carries the spindle."""

    joints: str = choice("rotary joint on the slide, and the one it carries", options=("CA", "CB", "AB", "BA"))
    outer: np.ndarray = table(
        "m", "x, y, z of a point on the axis of the first joint, from the gauge point", shortest=3
    )
    pivot: np.ndarray = table(
        "m", "x, y, z of a point on the axis of the second joint, from the gauge point", shortest=3
    )
    workpiece: np.ndarray = table("m", "x, y, z of the origin of the workpiece frame", shortest=3)
    tool_length: Number = parameter("m", "from the spindle's gauge point to the tip", least=0, most=_LONGEST)
    nutating: bool = choice("axis of the second joint at 45 degrees between Z and that of its letter", default=False)
    reversed: str = choice("joints that count against ISO 841", options=REVERSED, default="")

    def check(self) -> None:
        """Raise ParameterError for a point that is not x, y, z, or a joint that the machine does not have."""
        _check(self)

    def kinematics(self) -> Kinematics:
        """Return the kinematics of the machine."""
        return _kinematics(self, "head_head", self.outer, self.pivot)


class HeadTable(Block):
    """A machine whose head tilts the tool and whose table turns the workpiece."""

    joints: str = choice("rotary joint of the head, and of the table", options=("BC", "AC", "AB", "BA"))
    pivot: np.ndarray = table("m", "x, y, z of a point on the axis of the head, from the gauge point", shortest=3)
    inner: np.ndarray = table("m", "x, y, z of a point on the axis of the table", shortest=3)
    workpiece: np.ndarray = table("m", "x, y, z of the origin of the workpiece frame", shortest=3)
    tool_length: Number = parameter("m", "from the spindle's gauge point to the tip", least=0, most=_LONGEST)
    nutating: bool = choice("axis of the head at 45 degrees between Z and that of its letter", default=False)
    reversed: str = choice("joints that count against ISO 841", options=REVERSED, default="")

    def check(self) -> None:
        """Raise ParameterError for a point that is not x, y, z, or a joint that the machine does not have."""
        _check(self)

    def kinematics(self) -> Kinematics:
        """Return the kinematics of the machine."""
        return _kinematics(self, "head_table", self.pivot, self.inner)


FiveAxes: TypeAlias = TableTable | HeadHead | HeadTable
"""The kinds of five-axis machines."""


def _kinematics(machine: FiveAxes, kind: Kind, first: np.ndarray, second: np.ndarray) -> Kinematics:
    return Kinematics.of(
        kind,
        machine.joints,
        _point(first),
        _point(second),
        _point(machine.workpiece),
        machine.tool_length,
        nutating=machine.nutating,
        reversed_joints=machine.reversed,
    )


def _point(row: np.ndarray) -> Vector:
    x, y, z = row.tolist()
    return x, y, z


def _check(machine: FiveAxes) -> None:
    names = [name for name in ("outer", "pivot", "inner", "workpiece") if hasattr(machine, name)]
    by_name = {name: getattr(machine, name) for name in names}
    for name, row in by_name.items():
        if row.size != 3:
            raise ParameterError(f"{name} has {row.size} numbers: give x, y and z")
        far = float(np.max(np.abs(row)))
        if far > _LONGEST:
            raise ParameterError(
                Text(
                    f"{name} lies {Quantity(far, 'm'):m} away, and {Quantity(_LONGEST, 'm'):m} is the most: check its "
                    f"unit, as in {name}_mm"
                )
            )
    strangers = [letter for letter in machine.reversed if letter not in machine.joints]
    if strangers:
        raise ParameterError(f"reversed names joint {strangers[0]}, and the joints are {machine.joints}: leave it out")
