"""Several logs of one drive with the same columns, and what is known of the drive, for commands on friction."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from feeddrive.blocks.actuator.screw import Screw
from feeddrive.cli.identify_frf import positive
from feeddrive.cli.roles import mapped
from feeddrive.files.columns import Column
from feeddrive.files.log import Log
from feeddrive.files.machine import MachineFile, read_machine
from feeddrive.files.read_log import read_log
from feeddrive.identification.frame import lever
from feeddrive.language.errors import LogError
from feeddrive.loop.loop import Loop


@dataclass(frozen=True)
class Drive:
    """What the command line, and else the machine file, says of the drive that made the logs.

    force_constant  N at the table per unit of the command or current
    lead, gear      of the screw, m, and turns of the motor in one of the screw
    """

    machine: MachineFile | None
    axis: str
    loop: Loop | None
    force_constant: float | None
    lead: float | None
    gear: float

    @property
    def lever(self) -> float | None:
        """Travel of the table per rad of the motor, m/rad."""
        return None if self.lead is None else lever(self.lead, self.gear)


def drive_of(
    machine: str | None, axis: str | None, force_constant: float | None, lead: float | None, gear: float | None
) -> Drive:
    """The options, completed by the motor of the machine file. Raises ParameterError for what cannot be."""
    positive(force_constant, lead, 1.0 if gear is None else gear)
    given = None if machine is None else read_machine(machine)
    loop = None if given is None else given.loop(axis)
    motor = None if loop is None else loop.axis.actuator.motor
    if motor is not None and force_constant is None:
        force_constant = float(motor.force_per_unit())
    if isinstance(motor, Screw) and lead is None:
        lead, gear = float(motor.lead), float(motor.gear) if gear is None else gear
    name = axis or ("x" if loop is None else loop.name)
    return Drive(given, name, loop, force_constant, lead, 1.0 if gear is None else gear)


def read_logs(
    paths: Sequence[Path], named: Mapping[str, str | None], channels: Path | None, wanted: Collection[str],
    sample_time: float | None, console: Console,
) -> tuple[list[Log], dict[str, Column]]:  # fmt: skip
    """All logs with the roles of the first one, whose guess is shown. Raises LogError as `read_log`."""
    first, mapping = mapped(paths[0], named, channels, wanted, sample_time, console)
    read = [first]
    for path in paths[1:]:
        if channels is not None:
            read.append(mapped(path, named, channels, wanted, sample_time, console)[0])
        else:
            read.append(read_log(path, mapping, sample_time=sample_time))
    return read, mapping


def chosen(path: Path, log: Log, named: Mapping[str, str | None], roles: Sequence[str], what: str, options: str) -> str:
    """The role that is taken: one that was named, else the first of `roles` that is there. Raises LogError."""
    there = [role for role in roles if role in log.channels]
    told = [role for role in there if named.get(role) is not None]
    if not there:
        names = ", ".join(log.channels)
        raise LogError(
            f"{path}: has no {what} that is named as such: name its column with {options}"
            + (f"; with a role there are: {names}" if names else "")
        )
    return (told or there)[0]


def stem(paths: Sequence[Path]) -> str:
    """Of the results: the name of the first log, and how many more there are."""
    name = paths[0].name.split(".")[0]
    return name if len(paths) == 1 else f"{name}_and_{len(paths) - 1}"


def logs_said(paths: Sequence[Path]) -> str:
    """Names of the logs, and once the folder in which all of them are."""
    names = ", ".join(path.name for path in paths)
    folders = {str(path.parent) for path in paths}
    if folders == {"."}:
        return names
    return f"{names} in {folders.pop()}" if len(folders) == 1 else ", ".join(map(str, paths))


def columns_said(mapping: Mapping[str, Column]) -> str:
    """Which column is what, for the facts of a report."""
    return ", ".join(f"{role}: {each.name}" for role, each in mapping.items())
