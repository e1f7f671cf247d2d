"""Shared options and functions of commands that read several logs of one drive: columns, drive data, output."""

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import numpy as np

from feeddrive.files.columns import Column
from feeddrive.files.drive import Drive, drive_with
from feeddrive.files.log import Log, LogLike
from feeddrive.files.machine import MachineLike, read_machine
from feeddrive.files.mapping import MappingLike
from feeddrive.files.read_log import OpenedFile, read_log
from feeddrive.identification.regression import SHAFT
from feeddrive.language.progress import Progress
from feeddrive.language.table import Table
from feeddrive.report.page import write_page
from feeddrive.report.report import Report
from feeddrive.workflow.channels import Mapped, mapped, no_column
from feeddrive.workflow.command import CHANNELS, OUT, UNIT, argument, called, option
from feeddrive.workflow.force import DriveValues

# roles at the table and at the shaft, in order of preference; a position is differentiated
_TABLE = ("velocity_load", "velocity_motor", "position_load", "position_motor")
_SHAFT = ("speed_motor", "angle_motor")
FORCES = ("force", "torque", "command", "current")
MOTIONS = (*_TABLE, *_SHAFT)


class DriveLogsRequest(DriveValues):
    """The common options of commands that read logs of one drive: force columns, drive constants, output."""

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
    axis: str | None = option("axis of the machine file, and of a log with several", default=None)
    channels: MappingLike | None = option(CHANNELS, default=None)
    time: str | None = option("column of the time, name:unit", default=None)
    sample_time: float | None = option("sample time of logs without a clock", unit="s", default=None)
    unit: tuple[str, ...] = option(UNIT, default=())
    out: Path | None = option(OUT, short="-o", default=None)

    def forces(self) -> dict[str, str | None]:
        """Return the options for the columns of force and time by role; None for an omitted option."""
        return {
            "force": self.force,
            "torque": self.torque,
            "current": self.current,
            "command": self.command,
            "time": self.time,
        }


def drive_of(request: DriveLogsRequest) -> Drive:
    """Return the drive described by the options, completed with the motor data of the machine file."""
    machine = None if request.machine is None else read_machine(request.machine)
    loop = None if machine is None else machine.loop(request.axis)
    return drive_with(machine, loop, request.axis, request.force_constant, request.lead, request.gear)


def read_logs(
    paths: Sequence[Path | OpenedFile],
    named: Mapping[str, str | None],
    request: DriveLogsRequest,
    wanted: Collection[str],
    sample_time: float | None,
    progress: Progress,
) -> tuple[list[Log], dict[str, Column], list[str]]:
    """Read all logs with the column roles of the first one; return logs, columns, and doubts about magnitudes.

    Guessed roles are shown.  Raises LogError as `read_log` does, and for a log that is implausible for a feed drive.
    """

    def one(path: Path | OpenedFile) -> Mapped:
        read = mapped(
            path,
            named,
            request.channels,
            wanted,
            sample_time,
            progress,
            request.unit,
            steady=True,
            axis=request.axis,
            names_machine=request.machine is not None,
            values=request.drive_values(),
        )
        read.stop(progress)
        return read

    first = one(paths[0])
    read, doubts = [first.log], [first.doubt.why]
    for path in paths[1:]:
        if request.channels is not None:
            other = one(path)
            read.append(other.log)
            doubts.append(other.doubt.why)
        else:
            # a new guess for each log could give the same column another role
            read.append(read_log(path, first.columns, sample_time=sample_time))
    return read, first.columns, [doubt for doubt in doubts if doubt]


def chosen(
    path: Path | OpenedFile, log: Log, named: Mapping[str, str | None], roles: Sequence[str], what: str, options: str
) -> str:
    """Return the first of `roles` that the log has; roles whose column the user named take precedence.

    Raises LogError if the log has none of them.
    """
    there = [role for role in roles if role in log.channels]
    told = [role for role in there if named.get(role) is not None]
    if not there:
        raise no_column(path, log, roles, f"its {what}", options)
    return (told or there)[0]


def velocity_and_force(
    path: OpenedFile, log: Log, named: Mapping[str, str | None], drive: Drive
) -> tuple[np.ndarray, np.ndarray, bool]:
    """Return the velocity and force of a log, both at the table or both at the shaft, and True for the shaft."""
    acting = chosen(path, log, named, FORCES, "force", "--force, --torque, --current or --command")
    # a torque acts at the shaft: with a motion at the shaft no lead is needed to relate the two
    shaft_first = acting == "torque"
    order = (*_SHAFT, *_TABLE) if shaft_first else (*_TABLE, *_SHAFT)
    moving = chosen(path, log, named, order, "velocity", "--velocity, --speed, --position or --angle")
    velocity = log[moving]
    if moving.startswith(("position", "angle")):
        # central differences leave no delay between velocity and force
        velocity = np.gradient(velocity, log.sample_time)
    force, is_torque = drive.acting(path, log, acting)
    turning = moving in _SHAFT
    if is_torque == turning:
        return velocity, force, turning
    unit = log.units.get(moving, SHAFT.velocity)
    r = drive.at_table(path, moving, unit, acting)
    return (r * velocity, force, False) if turning else (velocity, force / r, False)


def logs_stem(logs: Sequence[object]) -> str:
    """Return a stem for the names of results: the name of the first log and, if there are more, their number."""
    name = log_stem(called(logs[0]))
    return name if len(logs) == 1 else f"{name}_and_{len(logs) - 1}"


def log_stem(name: str) -> str:
    """Return the name of a log without folder and suffix: `run.1` for run.1.csv and run.1.csv.gz."""
    path = Path(Path(name).name.removesuffix(".gz"))
    # a type begins with a letter, the number of a run does not
    return path.stem if path.suffix[1:2].isalpha() else path.name


def log_names(logs: Sequence[object]) -> str:
    """Return the names of the logs, with the folder stated once if they share it."""
    paths = [Path(called(log)) for log in logs]
    names = ", ".join(path.name for path in paths)
    folders = {str(path.parent) for path in paths}
    if folders == {"."}:
        return names
    return f"{names} in {folders.pop()}" if len(folders) == 1 else ", ".join(map(str, paths))


def column_texts(mapping: Mapping[str, Column]) -> str:
    """List the column of each role with its factor and unit, for the table of facts in a report."""
    return ", ".join(f"{role}: {column.text()}" for role, column in mapping.items())


def narrow(table: Table) -> Table:
    """Return a table of estimates without intervals, so that it fits 80 columns; the report shows the intervals."""
    if table.heads[-1] != "95 % interval":
        return table
    rows = [[*row[:-1], "unknown" if str(row[-1]).startswith("not") else ""] for row in table.rows]
    return Table(table.title, [*table.columns[:-1], ""], rows)


def write_report(report: Report, machine: str | None, out: str | Path) -> Path:
    """Write `report.html` and, if there is one, `machine.toml` into a directory; return the path of the report."""
    return write_page(out, report, {} if machine is None else {"machine.toml": machine})


def written(report: Path, machine: str | None) -> dict[str, Path]:
    """Return the paths of the files written by `write_report`: the machine file, if there is one, and the report."""
    return {**({} if machine is None else {"Machine": report.parent / "machine.toml"}), "Report": report}
