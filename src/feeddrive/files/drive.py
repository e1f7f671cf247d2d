"""The drive that recorded a log: force per unit of its command or current, and table travel per motor angle."""

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
    """The drive that recorded the logs. Command-line options take precedence over the machine file.

    force_constant  N at the table per unit of the command or current, from the command line
    lead, gear      lead of the screw, m, and motor revolutions per screw revolution
    turns           True for a rotary axis: its force is a torque, and there is no screw
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
        """The travel of the table per motor angle, m/rad; None if the lead is unknown."""
        return None if self.lead is None else lever(self.lead, self.gear)

    def per_unit(self, unit: str) -> tuple[float, bool] | None:
        """Return the force (N) per `unit` of command or current and False, or the shaft torque (N m) and True.

        The force constant of the command line takes precedence, then the column's unit if it is one of force or torque,
        then the motor constant of the machine file, which is per drive unit.  The result is None if none of them is
        available.
        """
        if self.force_constant is not None:
            return self.force_constant, self.turns
        # Before the machine file: a unit recorded with the log describes this very column.
        for si, is_torque in (("N", False), ("N m", True)):
            try:
                return units.factor(unit, si), is_torque
            except ParameterError:
                continue
        motor = None if self.loop is None else self.loop.axis.actuator.motor
        return None if motor is None else (float(motor.force_per_unit()), self.turns)

    def force_per_unit(self, unit: str) -> float | None:
        """Return the force on the axis in N (N m for a rotary axis) per `unit` of the command; None if unknown."""
        size, is_torque = self.per_unit(unit) or (None, False)
        if size is None or is_torque == self.turns:
            return size
        # Power is the same at the shaft and at the table: torque over travel per angle is force.
        return size / self.lever if is_torque and self.lever is not None else None

    def acting(self, path: Path | OpenedFile, log: Log, role: str) -> tuple[np.ndarray, bool]:
        """Convert a channel to force; return the force (N) at the table and False, or the shaft torque (N m) and True.

        Raises ParameterError, which names the missing option, for a command or current in the drive's own unit.
        """
        scale = self._scale(log, role)
        if scale is None:
            raise ParameterError(
                f"{path}: the {role} is in the drive's own unit: give its unit, as --force 'column:N' or --torque "
                f"'column:Nm', the force per unit with --force-constant, the values of the drive with --rated, "
                f"--torque-constant or --at-full (feeddrive force explains them), or the machine with --machine"
            )
        return log[role] if scale[0] == 1.0 else scale[0] * log[role], scale[1]

    def knows(self, log: Log, role: str) -> bool:
        """Return True if `acting` can convert the channel to a force or torque."""
        return self._scale(log, role) is not None

    def _scale(self, log: Log, role: str) -> tuple[float, bool] | None:
        return (1.0, role == "torque") if role in ("force", "torque") else self.per_unit(log.units.get(role, ""))

    def at_table(self, path: Path | OpenedFile, moving: str, unit: str, acting: str) -> float:
        """Return the table travel per motor angle, m/rad. Raise ParameterError if the lead is unknown.

        This factor is needed if the motion is measured at the shaft and the force at the table, or vice versa.
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
    """Return the drive described by the options.

    Without the option `lead`, the lead is that of the loop's screw, and so is the gear unless `gear` is given.
    """
    motor = None if loop is None else loop.axis.actuator.motor
    if isinstance(motor, Screw) and lead is None:
        lead, gear = float(motor.lead), float(motor.gear) if gear is None else gear
    turns = turns or (loop is not None and loop.axis.rotary)
    return Drive(machine, axis_name(loop, axis), loop, force_constant, lead, 1.0 if gear is None else gear, turns)


def axis_name(loop: Loop | None, axis: str | None) -> str:
    """Return the axis name: that of the machine file's loop if there is one, otherwise `axis` if given, otherwise x."""
    return axis or "x" if loop is None else loop.name
