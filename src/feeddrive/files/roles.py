"""What a column of a measured log may stand for, and how a column is named."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from feeddrive.language import units
from feeddrive.language.errors import ParameterError

# what a column may stand for, and the unit in which the log then holds it; along the axis, and round the motor
ROLES: Mapping[str, str] = {
    "time": "s",
    "setpoint_position": "m",
    "setpoint_velocity": "m/s",
    "position_motor": "m",
    "position_load": "m",
    "velocity_motor": "m/s",
    "velocity_load": "m/s",
    "acceleration_load": "m/s2",
    "force": "N",
    "command": "",
    "load_force": "N",
    "excitation": "",
    "setpoint_angle": "rad",
    "setpoint_speed": "rad/s",
    "angle_motor": "rad",
    "angle_load": "rad",
    "speed_motor": "rad/s",
    "speed_load": "rad/s",
    "torque": "N m",
    "current": "A",
}

# roles in whatever unit the drive has: what is commanded (A, V, percent), and what an experiment adds somewhere
OWN_UNIT = frozenset({"command", "excitation"})


@dataclass(frozen=True, kw_only=True)
class Column:
    """A column of a file: its name there, and its unit, or the factor to the unit of its role (or neither: SI).

    Column(name="qm", unit="mm"), Column(name="iq", factor=35.15), Column(name="y", factor=-1e-3)
    """

    name: str
    unit: str = ""
    factor: float | None = None

    def checked(self, role: str) -> Column:
        """The column itself. Raises ParameterError if its unit or factor cannot be that of the role."""
        if self.factor is not None and not (np.isfinite(self.factor) and self.factor != 0.0):
            raise ParameterError(f"{role}: factor = {self.factor:g} must be a finite number that is not 0")
        if role not in OWN_UNIT and self.unit:
            if self.factor is not None:
                raise ParameterError(f"{role}: give the unit of column '{self.name}' or a factor, not both")
            units.factor(self.unit, ROLES[role])
        return self


Named: TypeAlias = Column | str | tuple[str, float] | tuple[str, str]
