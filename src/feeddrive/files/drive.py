"""The drive behind a log: how much force its command or current is, and the lever of its motor on the table."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from feeddrive.blocks.actuator.screw import Screw
from feeddrive.files.log import Log
from feeddrive.files.machine import MachineFile
from feeddrive.files.read_log import OpenedFile
from feeddrive.identification.regression import lever
from feeddrive.language import units
from feeddrive.language.errors import ParameterError
from feeddrive.loop.loop import Loop


@dataclass(frozen=True)
class Drive:
    """The drive that made the logs, by the command line, else by the machine file.

    force_constant  N at the table per unit of the command or current, as it was typed
    lead, gear      of the screw, m, and turns of the motor in one of the screw
    turns           the axis itself turns: its force is a torque, and no screw stands between
    """

    machine: MachineFile | None
    axis: str
    loop: Loop | None
    force_constant: float | None
    lead: float | None
    gear: float
    turns: bool = False

    @property
    def lever(self) -> float | None:
        """Travel of the table per rad of the motor, m/rad."""
        return None if self.lead is None else lever(self.lead, self.gear)

    def per_unit(self, unit: str) -> tuple[float, bool] | None:
        """Return how much 1 of a command or current in `unit` is: in N at the table, or, if True, in N m of the shaft.

        A typed force constant decides, then the unit of the column if it is that of a force or torque, then the motor
        of the machine file, whose constant is for the drive's own unit.  None if nothing says it.
        """
        if self.force_constant is not None:
            return self.force_constant, self.turns
        for si, is_torque in (("N", False), ("N m", True)):
            try:
                return units.factor(unit, si), is_torque
            except ParameterError:
                continue
        motor = None if self.loop is None else self.loop.axis.actuator.motor
        return None if motor is None else (float(motor.force_per_unit()), self.turns)

    def force_per_unit(self, unit: str) -> float | None:
        """Return the force on the axis for 1 of a command in `unit`, N, or N m if it turns; None if nothing says it."""
        size, is_torque = self.per_unit(unit) or (None, False)
        if size is None or is_torque == self.turns:
            return size
        return size / self.lever if is_torque and self.lever is not None else None

    def acting(self, path: Path | OpenedFile, log: Log, role: str) -> tuple[np.ndarray, bool]:
        """Return the force along the table that a channel holds, N, or the torque of the shaft, N m, and True.

        Raises ParameterError for a command or current in the drive's own unit, with what to give.
        """
        scale = self._scale(log, role)
        if scale is None:
            raise ParameterError(
                f"{path}: the {role} is in the drive's own unit: give the force per unit with --force-constant, the "
                f"machine with --machine, or the torque per unit as --torque 'column*factor'"
            )
        return log[role] if scale[0] == 1.0 else scale[0] * log[role], scale[1]

    def knows(self, log: Log, role: str) -> bool:
        """True if `acting` can tell the force that a channel holds."""
        return self._scale(log, role) is not None

    def _scale(self, log: Log, role: str) -> tuple[float, bool] | None:
        return (1.0, role == "torque") if role in ("force", "torque") else self.per_unit(log.units.get(role, ""))

    def at_table(self, path: Path | OpenedFile, moving: str, unit: str, acting: str) -> float:
        """Return the lever, m/rad, for a motion in a unit and a force, one along the table, the other of a shaft.

        Raises ParameterError without a lead.
        """
        if self.lever is None:
            other = "N" if "rad" in unit else "N m"
            raise ParameterError(
                f"{path}: {moving} is in {unit} and {acting} in {other}: one is along the table and the other round a "
                f"shaft; give the screw's lead in m with --lead"
            )
        return self.lever


def drive_with(
    machine: MachineFile | None,
    loop: Loop | None,
    axis: str | None,
    force_constant: float | None = None,
    lead: float | None = None,
    gear: float | None = None,
    *,
    turns: bool = False,
) -> Drive:
    """Return the drive of a loop of a machine file with the options; lead and gear are completed by its motor."""
    motor = None if loop is None else loop.axis.actuator.motor
    if isinstance(motor, Screw) and lead is None:
        lead, gear = float(motor.lead), float(motor.gear) if gear is None else gear
    turns = turns or (loop is not None and loop.axis.rotary)
    return Drive(machine, axis_name(loop, axis), loop, force_constant, lead, 1.0 if gear is None else gear, turns)


def axis_name(loop: Loop | None, axis: str | None) -> str:
    """Return the name of an axis: that of its loop in the machine file, else as it was given; x without both."""
    return axis or "x" if loop is None else loop.name
