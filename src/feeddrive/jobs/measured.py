"""The log of a job: its columns as signals of the loop, its injected forces, and its unused columns."""

import dataclasses
from collections.abc import Mapping

import numpy as np

from feeddrive.analysis.replay import INJECTED, Replay, before_limit, injected_scale, replay
from feeddrive.blocks.load.recorded_force import RecordedForce
from feeddrive.blocks.reference.recorded import Recorded
from feeddrive.files.drive import drive_with
from feeddrive.files.job import Job
from feeddrive.files.log import Log
from feeddrive.language.errors import LogError
from feeddrive.language.quantity import Quantity, number
from feeddrive.language.text import Text, joined
from feeddrive.loop.loop import Loop
from feeddrive.report.laws import block_sentence

_USED = ("setpoint_position", "position_load", "force", "command", "load_force", "excitation")
# share of the residual: a smaller improvement by another scale or injection point is no evidence for it
_SCALED = 0.8
# relative: a scale so close to the motor's force per unit of the command points to a wrong unit of the column
_NEAR = 0.1


def measured_signals(job: Job, log: Log) -> dict[str, np.ndarray]:
    """Return the log's channels under the names of the loop's signals, in SI units."""
    channels = log.channels
    signals = {"set_position": _setpoint(job, log), "position_load": channels["position_load"]}
    if "force" in channels:
        signals["force"] = channels["force"]
    elif "command" in channels:
        signals["force"] = _per_unit(job, log, "command") * channels["command"]
    if "load_force" in channels:
        signals["load_force"] = channels["load_force"]
    if "excitation" in channels:
        signals["added_force"] = _per_unit(job, log, "excitation") * channels["excitation"]
    return signals


def _setpoint(job: Job, log: Log) -> np.ndarray:
    """Return the logged set positions.

    Raises LogError if they are missing or do not have the controller's sample time.
    """
    T = next(iter(job.loops.values())).sample_time
    if "setpoint_position" not in log.channels:
        raise LogError(f"{log.name}: the job needs the channel setpoint_position: name its column under [log.channels]")
    # at a difference of 1e-4 the clocks drift apart by a sample in ten thousand
    if abs(log.sample_time / T - 1.0) > 1e-4:
        raise LogError(
            f"{log.name}: one sample takes {Quantity(log.sample_time, 's'):6 SI}, but the machine's control runs every "
            f"{Quantity(T, 's'):6 SI}: resample the log, or set sample_time in {job.machine.file.name}"
        )
    return log["setpoint_position"]


def _per_unit(job: Job, log: Log, role: str) -> float:
    """Return the force at the table in N per unit of a channel.

    The unit is that of the drive's command, or one of force or torque.
    """
    scale = drive_with(None, next(iter(job.loops.values())), None).force_per_unit(log.units.get(role, ""))
    if scale is None:
        raise LogError(
            f"{log.name}: the channel {role} needs axis.*.actuator.motor in {job.machine.file.name}, "
            f"which turns the drive's unit into N"
        )
    return scale


def without_answer(job: Job, log: Log) -> Job:
    """Return the job with the set positions of a log, which has no measured position, as its reference."""
    T = float(next(iter(job.loops.values())).sample_time)
    outside = log.channels.get("load_force")
    load = job.load if outside is None else RecordedForce(force=outside, sample_time=T)
    return dataclasses.replace(job, reference=Recorded(position=_setpoint(job, log), sample_time=T), load=load)


def of_channels(job: Job, log: Log) -> list[str]:
    """Return remarks on a missing measured position and on named columns that are not used."""
    assert job.log is not None
    # a logged force needs no conversion, so that the command is used only in its place
    used = set(_USED) - ({"command"} if "force" in log.channels else set())
    remarks: list[str] = []
    if "position_load" not in log.channels:
        used &= {"setpoint_position", "load_force"}
        remarks.append(
            f"{log.name} has no measured position: its set positions are the reference, nothing is compared."
        )
    names = [(role, job.log.named(role)) for role in log.channels if role not in used]
    listed = ", ".join(role if named is None else f"{role} ('{named.name}')" for role, named in names)
    return [*remarks, *([f"Named and not used: {listed}."] if listed else [])]


def placed(loop: Loop, measured: dict[str, np.ndarray], skip: int) -> tuple[dict[str, np.ndarray], list[str]]:
    """Return the signals with the excitation injected before or after the force limit, and a remark on the choice.

    The point before the limit is chosen only if its position residual is clearly smaller. If the limit is never active,
    both points are equivalent.
    """
    if "added_force" not in measured:
        return measured, []
    behind = replay(loop, measured, skip=skip)
    other = before_limit(loop, measured, behind)
    if other is None:
        return measured, [
            "The excitation acts at the drive; the limit of the force does not tell where, as it cuts nothing."
        ]
    left, before = other
    far, near = (replayed.rms("position_load") for replayed in (behind, before))
    residuals = Text(f"position residual {Quantity(near, 'm'):3} RMS before it, {Quantity(far, 'm'):3} behind it")
    if near < _SCALED * far:
        kept = {**measured, "added_force": left}
        return kept, [
            Text(f"The excitation acts at the drive, before the limit of the force, which cuts it: {residuals}.")
        ]
    # both ways the residual must differ clearly: noise and an imperfect model decide small differences
    if far < _SCALED * near:
        return measured, [Text(f"The excitation acts at the drive, behind the limit of the force: {residuals}.")]
    return measured, [
        Text(
            "The excitation acts at the drive, behind the limit of the force as is taken here: the log does not tell "
            f"it from before it ({residuals}); the manual of the drive does."
        )
    ]


def of_injected(loop: Loop, measured: Mapping[str, np.ndarray], replayed: Replay) -> list[str]:
    """Return remarks on whether the logged command includes the injected force, and whether its scale is right."""
    names = [name for name in INJECTED if name in measured]
    if not names:
        return []
    remarks: list[str] = []
    if replayed.contained:
        remarks.append("The logged force holds the injected one, which is taken off before it is compared.")
    scale, better = injected_scale(loop, measured, replayed)
    off, least = replayed.rms("position_load"), better.rms("position_load")
    if least < _SCALED * off:
        motor = loop.axis.actuator.motor
        near = motor is not None and abs(scale / float(motor.force_per_unit()) - 1.0) < _NEAR
        why = " (the motor's force per unit of the command: it is logged in that unit)" if near else ""
        remarks.append(
            Text(
                f"The injected force is met best {number(scale, 3)} times as large{why}: position residual "
                f"{Quantity(least, 'm'):3} RMS in place of {Quantity(off, 'm'):3}. Check its unit and sign."
            )
        )
    return remarks


def load_text(job: Job, log: Log | None) -> str:
    """Describe the load on the table, or the force injected at the drive."""
    parts: list[str] = [] if job.load is None else [block_sentence(job.load)]
    for role in ("load_force", "excitation"):
        named = None if job.log is None else job.log.named(role)
        if log is not None and named is not None and role in log.channels:
            parts.append(f"{role} of the log, column '{named.name}'")
    return joined("; ", parts or ["none"])
