"""Several logs of one drive with the same columns, and its known data, for the friction commands."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from feeddrive.blocks.actuator.screw import Screw
from feeddrive.files.atomic_io import new_directory
from feeddrive.files.columns import Column
from feeddrive.files.formats import OpenedFile
from feeddrive.files.log import Log, LogLike
from feeddrive.files.machine import MachineFile, MachineLike, read_machine
from feeddrive.files.mapping import MappingLike
from feeddrive.files.read_log import read_log
from feeddrive.identification.estimate import SHAFT, lever
from feeddrive.language import units
from feeddrive.language.errors import ParameterError
from feeddrive.language.progress import Progress
from feeddrive.language.table import Table
from feeddrive.loop.loop import Loop
from feeddrive.report.page import html
from feeddrive.report.report import Report
from feeddrive.workflow.channels import mapped, no_column
from feeddrive.workflow.request import CHANNELS, OUT, UNIT, Request, argument, called, option

# along the table and round the shaft, the first that is there is taken; a position is differenced
_TABLE = ("velocity_load", "velocity_motor", "position_load", "position_motor")
_SHAFT = ("speed_motor", "angle_motor")
FORCES = ("force", "torque", "command", "current")
MOTIONS = (*_TABLE, *_SHAFT)


@dataclass(frozen=True)
class Drive:
    """What the command line, and else the machine file, says of the drive that made the logs.

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
        """The lever, m/rad, for a motion in a unit and a force, of which one is along the table, the other of a shaft.

        Raises ParameterError without a lead.
        """
        if self.lever is None:
            other = "N" if "rad" in unit else "N m"
            raise ParameterError(
                f"{path}: {moving} is in {unit} and {acting} in {other}: one is along the table and the other round a "
                f"shaft; give the screw's lead in m with --lead"
            )
        return self.lever


class DriveLogsRequest(Request):
    """What commands on logs of a drive share: columns of the force, constants of the drive, and where it is written."""

    logs: tuple[LogLike, ...] = argument("Logs of one drive")
    force: str | None = option("column of the force, name:unit", default=None)
    torque: str | None = option("column of the motor's torque, name:unit", default=None)
    current: str | None = option("column of the current, name:unit", default=None)
    command: str | None = option("column of the command in the drive's unit", default=None)
    force_constant: float | None = option("N at the table per unit of command or current", above=0.0, default=None)
    lead: float | None = option(
        "lead of the screw, to convert motor angle and torque to the table", unit="m", above=0.0, default=None
    )
    gear: float | None = option("turns of the motor in one turn of the screw; 1", above=0.0, default=None)
    machine: MachineLike | None = option("the machine file to write into; its comments are kept", default=None)
    axis: str | None = option("its axis, if it has several", default=None)
    channels: MappingLike | None = option(CHANNELS, default=None)
    time: str | None = option("column of the time, name:unit", default=None)
    sample_time: float | None = option("of logs without a clock", unit="s", default=None)
    unit: tuple[str, ...] = option(UNIT, default=())
    out: Path | None = option(OUT, short="-o", default=None)

    def forces(self) -> dict[str, str | None]:
        """The columns that were named, by their roles."""
        return {
            "force": self.force, "torque": self.torque, "current": self.current, "command": self.command,
            "time": self.time,
        }  # fmt: skip


def drive_of(request: DriveLogsRequest) -> Drive:
    """The options, completed by the motor of the machine file."""
    given = None if request.machine is None else read_machine(request.machine)
    loop = None if given is None else given.loop(request.axis)
    return drive_with(given, loop, request.axis, request.force_constant, request.lead, request.gear)


def drive_with(
    given: MachineFile | None, loop: Loop | None, axis: str | None, force_constant: float | None = None,
    lead: float | None = None, gear: float | None = None, *, turns: bool = False,
) -> Drive:  # fmt: skip
    """The drive of a loop of a machine file, with what was typed; lead and gear are completed by its motor."""
    motor = None if loop is None else loop.axis.actuator.motor
    if isinstance(motor, Screw) and lead is None:
        lead, gear = float(motor.lead), float(motor.gear) if gear is None else gear
    turns = turns or (loop is not None and loop.axis.rotary)
    return Drive(given, axis_name(loop, axis), loop, force_constant, lead, 1.0 if gear is None else gear, turns)


def axis_name(loop: Loop | None, axis: str | None) -> str:
    """The name of an axis: that of its loop in the machine file, else as it was given; x without both."""
    return axis or "x" if loop is None else loop.name


def read_logs(
    paths: Sequence[Path | OpenedFile], named: Mapping[str, str | None], channels: MappingLike | None,
    wanted: Collection[str], sample_time: float | None, progress: Progress, unit: Sequence[str] = (),
) -> tuple[list[Log], dict[str, Column], list[str]]:  # fmt: skip
    """All logs with the roles of the first one, whose guess is shown; and doubts about their sizes.

    Raises LogError as `read_log`, and for a log that is none of a feed drive.
    """
    first = mapped(paths[0], named, channels, wanted, sample_time, progress, unit, steady=True)
    first.doubt.stop(progress)
    read, doubts = [first.log], [first.doubt.why]
    for path in paths[1:]:
        if channels is not None:
            other = mapped(path, named, channels, wanted, sample_time, progress, unit, steady=True)
            other.doubt.stop(progress)
            read.append(other.log)
            doubts.append(other.doubt.why)
        else:
            read.append(read_log(path, first.columns, sample_time=sample_time))
    return read, first.columns, [each for each in doubts if each]


def chosen(
    path: Path | OpenedFile, log: Log, named: Mapping[str, str | None], roles: Sequence[str], what: str, options: str
) -> str:
    """The role that is taken: one that was named, else the first of `roles` that is there. Raises LogError."""
    there = [role for role in roles if role in log.channels]
    told = [role for role in there if named.get(role) is not None]
    if not there:
        raise no_column(path, log, roles, f"its {what}", options)
    return (told or there)[0]


def velocity_and_force(
    path: OpenedFile, log: Log, named: Mapping[str, str | None], drive: Drive
) -> tuple[np.ndarray, np.ndarray, bool]:
    """Velocity and force of a log, and whether they are those of a shaft."""
    acting = chosen(path, log, named, FORCES, "force", "--force, --torque, --current or --command")
    shaft_first = acting == "torque"
    order = (*_SHAFT, *_TABLE) if shaft_first else (*_TABLE, *_SHAFT)
    moving = chosen(path, log, named, order, "velocity", "--velocity, --speed, --position or --angle")
    velocity = log[moving]
    if moving.startswith(("position", "angle")):
        velocity = np.gradient(velocity, log.sample_time)
    force, is_torque = drive.acting(path, log, acting)
    turning = moving in _SHAFT
    if is_torque == turning:
        return velocity, force, turning
    unit = log.units.get(moving, SHAFT.velocity)
    r = drive.at_table(path, moving, unit, acting)
    return (r * velocity, force, False) if turning else (velocity, force / r, False)


def logs_stem(logs: Sequence[LogLike]) -> str:
    """Of the results: the name of the first log, and how many more there are."""
    name = Path(called(logs[0])).name.split(".")[0]
    return name if len(logs) == 1 else f"{name}_and_{len(logs) - 1}"


def logs_said(logs: Sequence[LogLike]) -> str:
    """Names of the logs, and once the folder in which all of them are."""
    paths = [Path(called(each)) for each in logs]
    names = ", ".join(path.name for path in paths)
    folders = {str(path.parent) for path in paths}
    if folders == {"."}:
        return names
    return f"{names} in {folders.pop()}" if len(folders) == 1 else ", ".join(map(str, paths))


def columns_said(mapping: Mapping[str, Column]) -> str:
    """Which column is what, with its factor and unit, for the facts of a report."""
    return ", ".join(f"{role}: {each.text()}" for role, each in mapping.items())


def narrow(table: Table) -> Table:
    """A table of estimates without its intervals, which the report has: a terminal of 80 columns holds it whole."""
    if table.heads[-1] != "95 % interval":
        return table
    rows = [[*row[:-1], "unknown" if str(row[-1]).startswith("not") else ""] for row in table.rows]
    return Table(table.title, [*table.columns[:-1], ""], rows)


def write_report(report: Report, machine: str | None, out: str | Path) -> Path:
    """Write `report.html` and, if there is one, `machine.toml` into a directory; the path of the report."""
    with new_directory(out) as folder:
        if machine is not None:
            (folder / "machine.toml").write_text(machine, encoding="utf-8")
        (folder / "report.html").write_text(html(report), encoding="utf-8")
    return Path(out) / "report.html"


def written(report: Path, machine: str | None) -> dict[str, Path]:
    """What was written beside a report: the machine file, if there is one."""
    return {**({} if machine is None else {"Machine": report.parent / "machine.toml"}), "Report": report}
