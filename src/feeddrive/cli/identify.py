"""`feeddrive identify`: mass, friction and delay of a drive from a log of one motion."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from feeddrive.cli.identify_frf import narrow, positive
from feeddrive.cli.roles import mapped
from feeddrive.cli.terminal import open_console
from feeddrive.cli.working import drawn
from feeddrive.files.log import Log
from feeddrive.files.machine import read_machine
from feeddrive.files.messages import sentence
from feeddrive.identification.motion.identify import identify
from feeddrive.identification.motion.motion_log import MotionLog
from feeddrive.language.errors import LogError, ParameterError
from feeddrive.loop.loop import Loop
from feeddrive.workflow.identified_machine import machine_text
from feeddrive.workflow.identify_page import tables, write_identified

_POSITIONS = ("position_load", "position_motor")  # the first that is there is taken
_WANTED = ("time", "setpoint_position", *_POSITIONS, "force", "command", "setpoint_angle", "angle_motor", "torque")


def perform(
    log: Path,
    machine: str | None,
    axis: str | None,
    friction: str,
    columns: Mapping[str, str | None],
    channels: Path | None,
    force_constant: float | None,
    lead: float | None,
    gear: float,
    sample_time: float | None,
    out: Path | None,
) -> None:
    """Read, fit, show, write."""
    console = open_console()
    positive(force_constant, lead, gear)
    given = None if machine is None else read_machine(machine)
    loop = None if given is None else given.loop(axis)
    measured, mapping = mapped(log, columns, channels, _WANTED, sample_time, console)
    motion = _motion(log, measured, loop, force_constant)
    found = identify(motion, loop, friction=friction, lead=lead, gear=gear)
    for each in tables(found):
        console.print(drawn(narrow(each)))
    for remark in found.remarks:
        console.print(f"- {sentence(remark)}", markup=False)
    text = machine_text(found, given, _name(loop, axis))
    facts = {
        "Log": str(log),
        "Rows": f"{len(measured)}, {1e3 * measured.sample_time:.6g} ms apart",
        "Columns": ", ".join(f"{role}: {column.name}" for role, column in mapping.items()),
        "Machine": machine or "none given",
    }
    report = write_identified(found, text, out or Path("results") / f"identify_{log.name.split('.')[0]}", facts)
    console.print(found.recommendation, markup=False)
    if text is None:
        console.print(
            "- No machine file was written: the law that ran is not known; give it with --machine.", markup=False
        )
    else:
        console.print(f"Machine: {report.parent / 'machine.toml'}", markup=False, soft_wrap=True)
    console.print(f"Report: {report}", markup=False, soft_wrap=True)


def _motion(path: Path, log: Log, loop: Loop | None, force_constant: float | None) -> MotionLog:
    """Position and force of the log, along the table or round a shaft."""
    motor = None if loop is None else loop.axis.actuator.motor
    limit = None if loop is None else loop.control.force_limit
    channels = log.channels
    position = next((channels[role] for role in _POSITIONS if role in channels), None)
    rotary = position is None and "angle_motor" in channels
    if rotary:
        position = channels["angle_motor"]
    if position is None:
        raise LogError(f"{path}: has no position that is named as such: name its column with --position{_there(log)}")
    set_position = channels.get("setpoint_angle" if rotary else "setpoint_position")
    force = channels.get("torque" if rotary else "force")
    if force is None and "command" in channels:
        if force_constant is None and motor is None:
            raise ParameterError(
                f"{path}: the command is in the drive's own unit: give the force per unit with --force-constant, or "
                f"the machine with --machine"
            )
        assert force_constant is not None or motor is not None
        constant = float(motor.force_per_unit()) if motor is not None and force_constant is None else force_constant
        force = constant * channels["command"]
    if force is None:
        raise LogError(
            f"{path}: has no force that is named as such: name its column with --force or --command{_there(log)}"
        )
    return MotionLog(
        name=str(path), position=position, force=force, set_position=set_position, sample_time=log.sample_time,
        force_limit=None if limit is None or rotary else float(limit), rotary=rotary,
    )  # fmt: skip


def _name(loop: Loop | None, axis: str | None) -> str:
    return axis or "x" if loop is None else loop.name


def _there(log: Log) -> str:
    names = [*log.channels]
    return f"; with a role there are: {', '.join(names)}" if names else ""
