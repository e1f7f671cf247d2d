"""`feeddrive identify`: mass, friction and delay of a drive from a log of one motion."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from feeddrive.files.formats import OpenedFile
from feeddrive.files.log import Log
from feeddrive.files.machine import read_machine
from feeddrive.files.messages import sentence
from feeddrive.identification.motion.identify import identify as identify_motion
from feeddrive.identification.motion.motion_log import MotionLog
from feeddrive.language.errors import LogError, ParameterError
from feeddrive.language.progress import Progress
from feeddrive.loop.loop import Loop
from feeddrive.workflow.channels import mapped
from feeddrive.workflow.command import Outcome, command
from feeddrive.workflow.drive_logs import axis_name, columns_said, narrow, written
from feeddrive.workflow.identified_machine import machine_text
from feeddrive.workflow.identify_page import tables, write_identified
from feeddrive.workflow.identify_request import IdentifyRequest
from feeddrive.workflow.identify_responses import identify_responses, responses_in

_POSITIONS = ("position_load", "position_motor")  # the first that is there is taken
_WANTED = ("time", "setpoint_position", *_POSITIONS, "force", "command", "setpoint_angle", "angle_motor", "torque")


@command(IdentifyRequest)
def identify(request: IdentifyRequest, progress: Progress) -> Outcome[Any]:
    """Find mass, friction and dead time in a log, or masses and modes in frequency responses; with errors.

    The result is an `Identified`, of frequency responses `AxisFits` or a `ModalFit`.

    Raises LogError for a log that cannot be used, NotIdentifiableError for one that does not hold what is asked.
    """
    progress.step(f"reading {request.log}")
    file = OpenedFile(request.log)
    responses = responses_in(file)
    if responses is not None:
        return identify_responses(request, responses, progress)
    return _identify_motion(request, file, progress)


def _identify_motion(request: IdentifyRequest, file: OpenedFile, progress: Progress) -> Outcome[Any]:
    """A rigid drive from a log of one motion."""
    given = None if request.machine is None else read_machine(request.machine)
    loop = None if given is None else given.loop(request.axis)
    log = request.log
    measured, mapping = mapped(file, request.named(), request.channels, _WANTED, request.sample_time, progress)
    motion = _motion(log, measured, loop, request.force_constant)
    progress.step("fitting")
    found = identify_motion(motion, loop, friction=request.friction, lead=request.lead, gear=request.gear)
    text = machine_text(found, given, axis_name(loop, request.axis))
    files: dict[str, Path] = {}
    if request.out is not None:
        facts = {
            "Log": str(log),
            "Rows": f"{len(measured)}, {1e3 * measured.sample_time:.6g} ms apart",
            "Columns": columns_said(mapping),
            "Machine": request.machine or "none given",
        }
        progress.step("report")
        files = written(write_identified(found, text, request.out, facts), text)
    notes = (
        ["No machine file was written: the law that ran is not known; give it with --machine."] if text is None else []
    )
    return Outcome(
        found, [narrow(each) for each in tables(found)], [sentence(each) for each in found.remarks],
        found.recommendation, notes, files=files,
    )  # fmt: skip


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


def _there(log: Log) -> str:
    names = [*log.channels]
    return f"; with a role there are: {', '.join(names)}" if names else ""
