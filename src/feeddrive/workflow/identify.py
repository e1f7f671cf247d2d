"""`feeddrive identify`: mass, friction and dead time of a drive from a log of one motion, or from several of one axis.

Identified values are written into an existing machine file, whose comments are kept, or into a new one, with a report.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from feeddrive import plot
from feeddrive.blocks.families import Law
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.files.columns import Column
from feeddrive.files.commissioning import read_commissioning
from feeddrive.files.drive import Drive, axis_name, drive_with
from feeddrive.files.frf import read_frfs
from feeddrive.files.log import Log, clipped
from feeddrive.files.machine import MachineFile, machine_toml, read_machine, with_standard_errors
from feeddrive.files.mapping import axes_in
from feeddrive.files.odrive import read_odrive
from feeddrive.files.origins import with_origins
from feeddrive.files.preview import Preview
from feeddrive.files.read_log import OpenedFile
from feeddrive.files.section import to_toml
from feeddrive.files.toml_file import TomlEdit
from feeddrive.identification.motion.identify import Identified, identify_motion, swapped, with_rigid
from feeddrive.identification.motion.known_values import against_known
from feeddrive.identification.motion.motion_log import MotionLog, count_of
from feeddrive.identification.motion.pooled import IdentifiedLogs, law_table, pool_logs
from feeddrive.identification.motion.rigid import RigidFit
from feeddrive.identification.regression import NORMAL, SHAFT, Estimate, lever
from feeddrive.language import tree, units
from feeddrive.language.block import Block, declarations
from feeddrive.language.errors import FeeddriveError, LogError, NotIdentifiableError, ParameterError, sentence
from feeddrive.language.judgment import Judgment
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Column as TableColumn
from feeddrive.language.table import Table
from feeddrive.language.text import Text, joined
from feeddrive.loop.axis import Axis
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import Machine
from feeddrive.report.report import Part, Picture, Remarks, Report, Section, Verdict, facts, further
from feeddrive.tuning.filters import read_block
from feeddrive.tuning.start_law import SPREAD, start_law
from feeddrive.workflow.channels import ALL, Doubt, Mapped, mapped, no_column
from feeddrive.workflow.command import Outcome, called, command, line
from feeddrive.workflow.drive_logs import column_texts, log_names, narrow, write_report, written
from feeddrive.workflow.force import number_with_unit
from feeddrive.workflow.identify_responses import (
    IdentifyRequest,
    identify_commissioned,
    identify_responses,
    is_commissioned,
    responses_in,
)

_POSITIONS = ("position_load", "position_motor")  # in order of preference
_ANGLES = ("angle_load", "angle_motor")
_FORCES = ("force", "torque", "command")
# roles that are a second source for clock and scales of a log, and are used for nothing else
_BESIDE = ("velocity_load", "velocity_motor", "speed_motor", "speed_load", "current")
_WANTED = ("time", "setpoint_position", *_POSITIONS, "force", "command", "setpoint_angle", *_ANGLES, "torque")


@command(IdentifyRequest)
def identify(request: IdentifyRequest, progress: Progress) -> Outcome[Any]:
    """Identify mass, friction and dead time from a log, or masses and modes from frequency responses.

    Several logs of one axis are pooled: each is processed like a single log, and the errors of the pooled values
    include the scatter.

    The result, with standard errors, is an `Identified`, of several logs `IdentifiedLogs`, or, for frequency responses,
    `AxisFits` or a `ModalFit`.

    Raises LogError for an unusable log, NotIdentifiableError for one that lacks the required information.
    """
    if len(request.sources) > 1:
        return _identify_several(request, progress)
    progress.step(f"reading {called(request.log)}")
    if isinstance(request.log, FRF):
        return identify_responses(request, read_frfs(request.log), progress)
    if isinstance(request.log, MotionLog):
        return _identify_motion(request, [request.log], progress)
    # opened once, so that both readers below share the parsed content
    file = OpenedFile(request.log)
    commissioning = read_commissioning(file) if is_commissioned(request) else None
    if commissioning is not None and commissioning.plants:
        return identify_commissioned(request, commissioning, progress)
    responses = responses_in(file)
    if responses is not None:
        return identify_responses(request, responses, progress)
    if request.axis == ALL:
        return _each_axis(request, [file], progress)
    return _identify_motion(request, [file], progress)


def _identify_several(request: IdentifyRequest, progress: Progress) -> Outcome[Any]:
    """Identify a drive from several logs. Raise ParameterError for a file given twice, and for frequency responses."""
    paths = [log.resolve() for log in request.sources if isinstance(log, Path)]
    for path in paths:
        if paths.count(path) > 1:
            raise ParameterError(f"{path}: is given {paths.count(path)} times; a log counts once")
    sources: list[OpenedFile | MotionLog] = []
    for log in request.sources:
        progress.step(f"reading {called(log)}")
        source = OpenedFile(log) if isinstance(log, Path | Log) else log
        if isinstance(source, FRF) or (isinstance(source, OpenedFile) and responses_in(source) is not None):
            raise ParameterError(
                f"{called(log)}: holds frequency responses, and several logs of motions are pooled: identify it alone, "
                "with the response of another encoder as --motor FILE or --load FILE"
            )
        sources.append(source)
    files = [source for source in sources if isinstance(source, OpenedFile)]
    if request.axis == ALL and len(files) == len(sources):
        return _each_axis(request, files, progress)
    return _identify_motion(request, sources, progress)


def _each_axis(request: IdentifyRequest, files: Sequence[OpenedFile], progress: Progress) -> Outcome[dict[str, Any]]:
    """Identify each axis of one or several logs separately; a failure of one axis is reported with the reason.

    Raises ParameterError for a log without axis names, and for named columns, which belong to a single axis.
    """
    named = [role for role, text in request.named().items() if text is not None and role != "time"]
    file = files[0]
    axes = axes_in(file.columns.values, file.columns.units)
    if not axes or named or request.channels is not None:
        why = "columns are named" if named or request.channels is not None else "no column names an axis"
        raise ParameterError(f"{file}: --axis {ALL} identifies each axis of a log by its own columns, and {why}")
    outcomes: dict[str, Outcome[Any]] = {}
    failed: dict[str, str] = {}
    for axis in axes:
        out = None if request.out is None else request.out / axis
        try:
            outcomes[axis] = _identify_motion(replace(request, axis=axis, out=out), files, progress)
        except FeeddriveError as error:
            failed[axis] = str(error)
    if not outcomes:
        raise NotIdentifiableError("; ".join(failed.values()))
    worst = max((outcome.judgment for outcome in outcomes.values()), key=lambda judgment: judgment.exit_code)
    shown: list[Table | str] = []
    for axis, outcome in outcomes.items():
        shown += [Text(f"Axis {axis}: {outcome.verdict}"), *outcome.tables]
    remarks = [Text(f"{axis}: {remark}") for axis, outcome in outcomes.items() for remark in outcome.remarks]
    return Outcome(
        {axis: outcome.result for axis, outcome in outcomes.items()},
        shown,
        [*remarks, *(Text(f"axis {axis} is not identified: {why}") for axis, why in failed.items())],
        Text(f"{len(outcomes)} of {len(axes)} axes are identified: {', '.join(outcomes)}"),
        [Text(f"{axis}: {note}") for axis, outcome in outcomes.items() for note in outcome.notes],
        files={f"{axis} {what}": path for axis, outcome in outcomes.items() for what, path in outcome.files.items()},
        details=[detail for outcome in outcomes.values() for detail in outcome.details],
        judgment=worst,
    )


@dataclass(frozen=True)
class _Run:
    """One log: the fields of its `MotionLog`, the readings of the motor's encoder, and how its columns were read."""

    source: OpenedFile | MotionLog
    channels: Mapping[str, Any]
    motor: np.ndarray | None
    read: Mapped | None

    @property
    def name(self) -> str:
        return str(self.channels["name"])

    @property
    def columns(self) -> Mapping[str, Column]:
        return {} if self.read is None else self.read.columns


def _identify_motion(
    request: IdentifyRequest, sources: Sequence[OpenedFile | MotionLog], progress: Progress
) -> Outcome[Any]:
    """Identify a rigid drive from one log of a motion, or from several logs of one axis."""
    machine = None if request.machine is None else read_machine(request.machine)
    if machine is not None and request.law is not None:
        raise ParameterError("--law is for a log without a machine file, which states the law: leave one of them out")
    loop = None if machine is None else machine.loop(request.axis)
    runs, alone = _each_log(request, sources, machine, loop, progress)
    result: Identified | IdentifiedLogs
    if len(runs) == 1:
        result = model = _started(alone[0])
    else:
        progress.step("pooling")
        pooled = pool_logs(alone, lambda k, model: _identified(runs[k], loop, request, progress, model))
        model = _started(pooled.model)
        remarks = (*pooled.remarks, *_other_columns(runs), *([model.started] if model.started else []))
        result = replace(pooled, model=model, remarks=remarks)
    why = result.unusable or ("" if model.loop is not None else _OF_SHAFT if model.rigid.frame is SHAFT else _NO_LAW)
    names = [log.log.name for log in alone]
    # an axis of a log with several keeps its name
    named = request.axis or (None if runs[0].read is None else runs[0].read.axis or None)
    text = None if why else machine_text(model, machine, axis_name(loop, named), names)
    text = None if text is None else with_origins(text, (*request.sources, machine))
    files: dict[str, Path] = {}
    rows = (Text(f"{log.log.position.size}, {Quantity(log.log.sample_time, 's'):6} apart") for log in alone)
    known = {
        **({"Log": called(request.log)} if len(runs) == 1 else {"Logs": log_names(request.sources)}),
        "Rows": joined("; ", rows),
        "Columns": "; ".join(dict.fromkeys(column_texts(run.columns) or "those of the object" for run in runs)),
        "Machine": called(request.machine),
    }
    if isinstance(result, IdentifiedLogs):
        page = partial(pooled_report, result, known)
    else:
        page = partial(identified_report, result, known, None if runs[0].read is None else runs[0].read.preview)
    if request.out is not None:
        progress.step("report")
        files = written(write_report(page(), text, request.out), text)
    judgment = result.advice.judgment
    first, *details = _shown(result)
    # values that are in doubt or advised against are not to be tuned on
    usable = judgment is Judgment.USE_VALUES and "Machine" in files
    return Outcome(
        result,
        first,
        [sentence(remark) for remark in result.remarks],
        result.recommendation,
        [f"No machine file was written: {why}."] if why else [],
        files=files,
        details=details,
        judgment=judgment,
        page=page,
        then=line("tune", files["Machine"], axis=request.axis) if usable else "",
    )


def _each_log(
    request: IdentifyRequest,
    sources: Sequence[OpenedFile | MotionLog],
    machine: MachineFile | None,
    loop: Loop | None,
    progress: Progress,
) -> tuple[list[_Run], list[Identified]]:
    """Read and identify each log by the same steps. Raise LogError naming all logs that are refused."""
    runs: list[_Run] = []
    alone: list[Identified] = []
    refused: dict[str, LogError] = {}
    for source in sources:
        name = str(source) if isinstance(source, OpenedFile) else source.name
        try:
            run = _read(request, source, machine, loop, progress if not runs else progress.quiet())
            if runs:
                _check_roles(runs[0], run, progress)
            progress.step("fitting" if len(sources) == 1 else f"fitting {name}")
            found = _identified(run, loop, request, progress, request.friction)
        except LogError as error:
            if len(sources) == 1:
                raise
            refused[name] = error
            continue
        if run.read is not None and run.read.unused:
            found = replace(found, remarks=(*found.remarks, _not_used(run.read.unused)))
        runs.append(run)
        alone.append(found)
    if refused:
        raise _all_refused(request, refused, [run.name for run in runs])
    return runs, alone


def _all_refused(request: IdentifyRequest, refused: Mapping[str, LogError], others: Sequence[str]) -> LogError:
    """Return the error that names each log that was refused, and the command for the others."""
    reasons = "; ".join(str(error) if name in str(error) else f"{name}: {error}" for name, error in refused.items())
    how = f"; without {'it' if len(refused) == 1 else 'them'}: {line('identify', *others)}" if others else ""
    known = all(isinstance(error, NotIdentifiableError) for error in refused.values())
    kind = NotIdentifiableError if known else LogError
    return kind(Text(f"{len(refused)} of {len(request.sources)} logs cannot be used: {reasons}{how}"))


def _check_roles(first: _Run, run: _Run, progress: Progress) -> None:
    """Show contradictions in another log. Raise LogError if one of its columns has another role in the first log."""
    before = {column.name: role for role, column in first.columns.items()}
    for role, column in run.columns.items():
        if before.get(column.name, role) != role:
            raise LogError(
                f"{run.name}: '{column.name}' is taken for {role}, and in {first.name} for {before[column.name]}: name "
                "the columns for all logs, or give them with --channels"
            )
    if run.read is not None:
        for doubt in run.read.contradictions:
            progress.remark(Text(f"- {run.name}: {doubt.why}"))


def _other_columns(runs: Sequence[_Run]) -> list[str]:
    """Return remarks on logs whose columns differ from those of the first log."""
    first = runs[0]
    return [
        f"the columns of {run.name} are {column_texts(run.columns)}, and not those of {first.name}"
        for run in runs[1:]
        if run.columns and first.columns and run.columns != first.columns
    ]


def _read(
    request: IdentifyRequest,
    source: OpenedFile | MotionLog,
    machine: MachineFile | None,
    loop: Loop | None,
    progress: Progress,
) -> _Run:
    """Read the columns of a log by the import step that all commands share."""
    if isinstance(source, MotionLog):
        channels: dict[str, Any] = {spec.name: getattr(source, spec.name) for spec in fields(source)}
        channels["turning"] = _turning(request, loop, channels)
        return _Run(source, channels, None, None)
    read = mapped(
        source,
        request.named(),
        request.channels,
        _WANTED,
        request.sample_time,
        progress,
        request.unit,
        axis=request.axis,
        names_machine=machine is not None,
        values=request.drive_values(),
        beside=_BESIDE,
    )
    if read.preview is not None:
        progress.remark(read.preview.table())
    drive = drive_with(
        machine, loop, request.axis, request.force_constant, request.lead, request.gear, turns=request.rotary
    )
    channels = _channels(source, read.log, drive, read.named)
    motor = _motor(channels, read.log)
    channels["turning"] = _turning(request, loop, channels)
    return _Run(source, channels, motor, read)


def _turning(request: IdentifyRequest, loop: Loop | None, channels: Mapping[str, Any]) -> bool:
    """Return True if machine file or option state a rotary axis. Raise ParameterError if lead or log contradict it."""
    turns = request.rotary or (loop is not None and loop.axis.rotary)
    if turns and request.lead is not None:
        raise ParameterError("--lead belongs to a screw, and the axis turns: leave out --lead, or rotary = true")
    if turns and not channels["rotary"]:
        raise ParameterError(
            f"{channels['name']}: the axis turns, and the log has a position in m: name the columns with --angle "
            f"'theta:deg' and --torque 'm:Nm'"
        )
    return turns


def _not_used(columns: Sequence[str]) -> str:
    """Return a remark on named columns that the fit does not use."""
    outside = any(column.startswith(("load_force", "excitation")) for column in columns)
    why = (
        ": what was injected there counts as error of the fit, so identify from a run without it, or add it to the "
        "column of the force if the command does not hold it"
    )
    return f"named and not used: {', '.join(columns)}{why if outside else ''}"


def _started(identified: Identified) -> Identified:
    """Return the result with a safe start law if none was found, so that the machine can be tuned and simulated."""
    log, rigid = identified.log, identified.rigid
    if identified.loop is not None or identified.unusable or rigid.frame is SHAFT:
        return identified
    axis = with_rigid(Axis(plant=rigid.plant(), rotary=log.turning), rigid)
    # the larger one, and its error with it: a shorter dead time would make the law too fast
    late = max(0.0, identified.delay.dead_time + NORMAL * identified.delay.error, float(identified.delay.nearest))
    axis = replace(axis, actuator=replace(axis.actuator, dead_time=late * log.sample_time))
    speed = np.gradient(log.position, log.sample_time)
    fast = float(np.quantile(np.abs(speed), _FAST))
    try:
        start = start_law(
            axis,
            log.sample_time,
            count=count_of(log.position),
            force_limit=log.force_limit,
            force=float(np.max(np.abs(log.force))),
            motion=(0.5 * float(np.ptp(log.position)), fast, fast / _RISE),
            spread=max(SPREAD, NORMAL * identified.mass.error / identified.mass.value),
        )
    except FeeddriveError as error:
        return replace(identified, remarks=(*identified.remarks, Text(f"{error}")))
    remarks = (*identified.remarks, start.sentence)
    return replace(identified, loop=start.loop, started=start.sentence, remarks=remarks)


_START = ", with a start law that did not run"
_FAST = 0.95  # quantile of the speed of the log, with which a start law is simulated
_RISE = 0.1  # s to that speed: the acceleration of the simulated move
_NO_LAW = "the law that ran is not known; give it with --machine, or by its numbers with --law"
_OF_SHAFT = "the log is that of a shaft: give --lead of the screw in m, or --rotary for an axis that turns"


def _law(request: IdentifyRequest, motion: MotionLog) -> tuple[Law | None, list[str]]:
    """Return the requested law, from given values or from the configuration of a drive, and remarks."""
    if request.law is None:
        return None, []
    file, _, axis = request.law.partition(":")
    if not file.lower().endswith(".json"):
        return read_block(Law, request.law), []  # type: ignore[type-abstract]
    if request.lead is None and not motion.rotary:
        raise ParameterError(
            f"--law {file}: the gains of an ODrive are those at the motor: give the --lead of the screw or belt, or "
            "--rotary for an axis that turns"
        )
    place = None if request.lead is None else lever(request.lead, request.geared)
    return read_odrive(file, axis or "axis0", place)


def _identified(
    run: _Run, loop: Loop | None, request: IdentifyRequest, progress: Progress, friction: str
) -> Identified:
    """Identify the drive. Raise NotIdentifiableError for interchanged columns, LogError for implausible magnitudes and
    for guessed roles that the samples contradict.
    """
    channels, read = run.channels, run.read
    doubt = Doubt() if read is None else read.doubt
    motion: MotionLog | None = None
    try:
        # without a mass the fit comes first: swapped columns or noise explain implausible sizes better than wrong units
        if doubt.moves:
            doubt.stop(progress)
        motion = MotionLog(**channels)
        law, said = _law(request, motion)
        identified = identify_motion(
            motion, loop, law=law, friction=friction, lead=request.lead, gear=request.geared, motor=run.motor
        )
        identified = replace(identified, remarks=(*identified.remarks, *said, *request.about_gear()))
        # before the machine file is written: implausible units and wrong columns must not reach it
        if read is not None:
            read.stop(progress)
    except LogError as error:
        # a reversed force moves its axis as well as a position moves a force: the samples tell them apart
        reversed_ = read is not None and any(doubt.kind == "sign" for doubt in read.contradictions)
        if read is not None and not reversed_ and swapped(channels):
            columns = read.columns
            moving, acting = (
                next((columns[role].name for role in roles if role in columns), roles[0])
                for roles in ((*_POSITIONS, *_ANGLES), ("force", "torque", "command"))
            )
            raise NotIdentifiableError(
                f"{channels['name']}: position and force are swapped: '{acting}' moves as '{moving}' makes it; "
                f"exchange their names, as --position '{acting}:mm' --force '{moving}:N' with their units"
            ) from None
        # a mass that the fit cannot tell may have its cause in columns that do not belong together
        doubts = () if read is None or motion is None else read.contradictions
        against = [doubt.why for doubt in sorted(doubts, key=lambda doubt: not doubt.certain)]
        if against and isinstance(error, NotIdentifiableError):
            raise NotIdentifiableError(f"{error}. What the samples say of the columns: {against[0]}") from None
        raise
    against, remarks = against_known(
        identified, request.mass, programmed_feed(request, motion), None if loop is None else float(loop.sample_time)
    )
    second = () if read is None else read.second
    return replace(
        identified,
        doubt=doubt.why or identified.doubt,
        contradicted=joined("; ", (*second, *against)),
        remarks=(*identified.remarks, *remarks),
    )


def programmed_feed(request: IdentifyRequest, log: MotionLog) -> float | None:
    """Return the programmed feed in the unit of the log's speed, m/s or rad/s; None if none was given.

    Raises ParameterError for a text that is no speed, and for a feed along the table in a log of a shaft without a
    lead.
    """
    if request.feed is None:
        return None
    value, unit = number_with_unit("--feed", request.feed, "6000 or 6:m/min")
    unit = unit or ("deg/min" if log.turning else "mm/min")
    with suppress(ParameterError):
        return value * units.factor(unit, log.frame.velocity)
    if log.rotary and not log.turning and request.lead is not None:
        with suppress(ParameterError):
            return value * units.factor(unit, "m/s") / lever(request.lead, request.geared)
    wanted = "a speed along the table, as m/min"
    if log.turning:
        wanted = "a speed of rotation, as deg/min or rev/min"
    elif log.rotary:
        wanted = "a speed of the shaft, as rev/min, or --lead must be given"
    raise ParameterError(f"--feed {request.feed}: the unit {unit} must be {wanted}")


def _channels(file: OpenedFile, log: Log, drive: Drive, named: Collection[str]) -> dict[str, Any]:
    """Return the fields of a `MotionLog`; position and force are both at the table or both at the shaft.

    If only one of them is at the shaft, it is converted to the table by the lead of the screw.
    """
    moving, acting = _chosen(file, log, drive, named)
    limit = None if drive.loop is None else drive.loop.control.force_limit
    if why := clipped(moving, log[moving], times=1):
        raise NotIdentifiableError(
            f"{file}: {why}: the recorder or the encoder ends there; record the motion again within its range"
        )
    position, rotary = log[moving], moving in _ANGLES
    set_position = log.channels.get("setpoint_angle" if rotary else "setpoint_position")
    force, is_torque = drive.acting(file, log, acting)
    if is_torque != rotary:
        r = drive.at_table(file, moving, log.units[moving], acting)
        if rotary:
            position, set_position = r * position, None if set_position is None else r * set_position
        force, rotary = force / r if is_torque else force, False
    return {
        "name": str(file),
        "position": position,
        "force": force,
        "set_position": set_position,
        "sample_time": log.sample_time,
        # the limit of a control is in N at the table, so it does not bound a torque at a shaft
        "force_limit": None if limit is None or rotary else float(limit),
        "rotary": rotary,
    }


def _motor(channels: Mapping[str, Any], log: Log) -> np.ndarray | None:
    """Return the readings of the motor's encoder if the position is that of the load; otherwise None."""
    motor, load = ("angle_motor", "angle_load") if channels["rotary"] else ("position_motor", "position_load")
    there = motor in log.channels and load in log.channels and channels["position"] is log.channels[load]
    return log.channels[motor] if there else None


def _chosen(file: OpenedFile, log: Log, drive: Drive, named: Collection[str]) -> tuple[str, str]:
    """Return the roles of motion and force: the named ones or, if possible, a pair whose conversion needs no lead."""
    motions, forces = (
        [role for role in there if role in named] or there
        for there in ([role for role in roles if role in log.channels] for roles in ((*_POSITIONS, *_ANGLES), _FORCES))
    )
    if not motions:
        raise no_column(file, log, (*_POSITIONS, *_ANGLES), "the position", "--position")
    if not forces:
        roles = ("force", "torque", "command", "current")
        raise no_column(file, log, roles, "the force", "--force, --torque or --command")
    pairs = [(moving, acting) for moving in motions for acting in forces if drive.knows(log, acting)]
    # preferred: position and force at the table, or angle and torque at the shaft, which need no lead
    together = [pair for pair in pairs if drive.acting(file, log, pair[1])[1] == (pair[0] in _ANGLES)]
    return next(iter([*together, *pairs]), (motions[0], forces[0]))


def machine_text(
    identified: Identified, machine: MachineFile | None, axis: str, logs: Sequence[str] = ()
) -> str | None:
    """Return the text of the machine file; None if the loop is incomplete (no law, or a shaft without a lead).

    logs  names of the logs; default: the log of the result
    """
    if identified.loop is None:
        return None
    return (
        _new(identified, axis, logs or (identified.log.name,))
        if machine is None
        else _edited(identified, machine, axis)
    )


def estimates_of(identified: Identified) -> tuple[Estimate, ...]:
    """Return the estimates for the machine file: from the closed loop if available, otherwise from the inverse
    dynamics.
    """
    return identified.rigid.estimates if identified.refinement is None else identified.refinement.estimates


def _edited(identified: Identified, machine: MachineFile, axis: str) -> str:
    assert identified.loop is not None
    edit = TomlEdit(machine.file.text, machine.file.name)
    before, after = machine.loop(axis).axis, identified.loop.axis
    place = ("axis", axis)
    if isinstance(before.plant, Rigid):
        _values(edit, (*place, "plant"), before.plant, after.plant)
    if type(before.friction_load) is type(after.friction_load) and before.friction_load is not None:
        assert after.friction_load is not None
        _values(edit, (*place, "friction_load"), before.friction_load, after.friction_load)
    elif after.friction_load is not None:
        edit.replace(
            (*place, "friction_load"), to_toml(after.friction_load, f"axis.{axis}.friction_load", rotary=after.rotary)
        )
    if before.forces != after.forces:
        _forces(edit, axis, before.forces, after.forces)
    if before.actuator.dead_time != after.actuator.dead_time:
        key = (*place, "actuator")
        if edit.has(key):
            edit.set((*key, "dead_time"), float(after.actuator.dead_time), "s")
        else:
            edit.add(f"[axis.{axis}.actuator]\ndead_time = {float(after.actuator.dead_time)!r}")
    _say_errors(edit, identified, axis, identified.loop)
    return edit.text


def _forces(edit: TomlEdit, axis: str, before: tuple[Block, ...], after: tuple[Block, ...]) -> None:
    """Write the forces of the axis: changed values in place, or the whole list if a force was added or removed."""
    if len(before) == len(after) and all(type(a) is type(b) for a, b in zip(before, after, strict=True)):
        for k, (old, new) in enumerate(zip(before, after, strict=True)):
            _values(edit, ("axis", axis, "forces", k), old, new)
        return
    sections = [to_toml(force, f"axis.{axis}.forces", listed=True) for force in after]
    # a force that is added or removed shifts the indices of the others, so the whole list is written anew
    edit.remove(("axis", axis, "forces"))
    for section in sections:
        edit.add(section)


def _values(edit: TomlEdit, key: tuple[str | int, ...], before: Block, after: Block) -> None:
    """Write the changed parameters of a block."""
    for name, declared in declarations(type(after)).items():
        old, new = getattr(before, name), getattr(after, name)
        if declared.role == "parameter" and new is not None and new != old:
            edit.set((*key, name), float(new), declared.unit)


def _new(identified: Identified, axis: str, logs: Sequence[str]) -> str:
    """Return a complete machine file; estimated parameters have their standard errors in comments."""
    loop = identified.loop
    assert loop is not None
    names = [_plain(log) for log in logs]
    many = f"{len(names)} logs" if len(names) > 1 else "one log"
    found = f"Mass, friction and gains were found in {many}; limits and encoders are not in it: add them."
    text = machine_toml(
        Machine.of({axis: loop}),
        f"axis identified from {', '.join(names)}",
        f"feeddrive identify {' '.join(names)}{_START if identified.started else ''}",
        f"{identified.started[:1].upper()}{identified.started[1:]}." if identified.started else found,
    )
    edit = TomlEdit(text, "identified.toml")
    _say_errors(edit, identified, axis, loop)
    return edit.text


def _say_errors(edit: TomlEdit, identified: Identified, axis: str, loop: Loop) -> None:
    """Write the estimates, with their standard errors in comments and, for the box of plants, in a section."""
    errors: dict[str, float] = {}
    for estimate in estimates_of(identified):
        # the closed-loop fit names parameters by their path, the inverse dynamics by bare names
        name = estimate.name if estimate.name in tree.parameters(loop) else _place(loop, estimate.name)
        if name is None:
            continue
        parts = [int(part) if part.isdigit() else part for part in name.split(".")]
        # parts 0 and 1 are `axis` and the name of the loop, which may differ from the axis name in the file
        key = edit.set(("axis", axis, *parts[2:]), float(tree.get(loop, name)), estimate.unit)
        edit.comment(key, f"standard error {Quantity(estimate.error, estimate.unit):2 SI}")
        errors[".".join(map(str, parts[2:]))] = float(estimate.error)
    with_standard_errors(edit, axis, errors)


def _place(loop: Loop, parameter: str) -> str | None:
    """Return the path in the loop for a parameter of the inverse dynamics; None if the loop has no such parameter."""
    own = loop.place_of("axis")
    if parameter == "offset":
        return next((path for path in tree.parameters(loop) if path.startswith(f"{own}.forces.")), None)
    for part in ("plant", "friction_load"):
        if part == "plant" and not isinstance(loop.axis.plant, Rigid):
            continue
        path = f"{own}.{part}.{parameter}"
        if path in tree.parameters(loop):
            return path
    return None


def _plain(name: str) -> str:
    # quotes and backslashes would break the string in the TOML file
    return "".join(c for c in Path(name).name if c.isprintable() and c not in '"\\')


def identified_report(
    identified: Identified, known: Mapping[str, str] | None = None, preview: Preview | None = None
) -> Report:
    """Return the report of an identified drive; `known` holds facts about the log, `preview` its peak figures."""
    shown, first = tables(identified), _estimates(identified)
    picture, *others = _pictures(identified)
    peaks = [] if preview is None else [Section("log", "The motion in the log", (preview.table(),))]
    if preview is not None:
        caption = "As the columns were read, before anything was fitted; the marks are the peaks."
        others.append(Picture("read", "What was read", caption, preview.sentence(), preview.chart))
    return Report(
        f"A rigid drive in {identified.log.name}",
        "feeddrive identify",
        Verdict((identified.recommendation,), good=not identified.advice.judgment.bad),
        (
            Section("result", "Result", (*shown[:first], Remarks(map(sentence, identified.remarks)))),
            *peaks,
            further(others),
            Section("details", "Dead time, residual and validation", shown[first:], folded=True),
            facts("The log", known or {}),
        ),
        picture,
        identified.rotary,
    )


def compared_tables(found: IdentifiedLogs) -> list[Table]:
    """Tabulate the values of each log beside the pooled ones, and the law of each log if there are two or more."""
    laws = law_table(found)
    return [found.pooled.compared(), *([] if laws is None else [laws])]


def pooled_report(found: IdentifiedLogs, known: Mapping[str, str] | None = None) -> Report:
    """Return the report of a drive identified from several logs; `known` holds facts about them."""
    inverse = [] if found.rigid is found.pooled else [found.rigid.compared()]
    parts: list[Part] = [*inverse]
    for log in found.logs:
        parts += [Text(f"{log.log.name}: {log.recommendation}"), *tables(log), Remarks(map(sentence, log.remarks))]
    judgment = found.advice.judgment
    return Report(
        f"A rigid drive in {len(found.logs)} logs",
        "feeddrive identify",
        Verdict((found.recommendation,), good=not judgment.bad),
        (
            Section(
                "result",
                "Result",
                (found.table(), *compared_tables(found), Remarks(map(sentence, found.remarks))),
            ),
            further(_pictures(found.model)),
            Section("details", "Each log alone", parts, folded=True),
            facts("The logs", known or {}),
        ),
        Picture(
            "pooled",
            "The logs beside the pooled values",
            "Points: the value of each log with its 95 % interval. Line and area: the pooled value with its interval, "
            "which contains the scatter of the logs.",
            "Mass and friction of each log, with intervals, over the pooled values.",
            found.pooled.chart,
        ),
        found.rotary,
    )


def _estimates(identified: Identified) -> int:
    """Return the number of tables of estimates, which precede all others: one, or two with a closed-loop fit."""
    return 1 if identified.refinement is None else 2


def _shown(result: Identified | IdentifiedLogs) -> tuple[list[Table], *tuple[Table | str, ...]]:
    """Return the tables that are shown first, then the details."""
    if isinstance(result, Identified):
        shown = [narrow(table) for table in tables(result)]
        first = _estimates(result)
        return shown[:first], *shown[first:]
    details: list[Table | str] = [result.rigid.compared()] if result.rigid is not result.pooled else []
    for log in result.logs:
        details.append(Text(f"{log.log.name} alone: {log.recommendation}"))
        details += [narrow(table) for table in tables(log)[: _estimates(log)]]
        details += [Text(f"{log.log.name}: {remark}") for remark in log.remarks]
    return [narrow(result.table()), *compared_tables(result)], *details


def tables(identified: Identified) -> list[Table]:
    """Tabulate the estimates with their errors, then dead time, residuals and validation."""
    shown = [identified.rigid.table()]
    if identified.refinement is not None:
        shown.append(identified.refinement.table())
        rows = [[str(delay), rms] for delay, rms in identified.refinement.by_delay.items()]
        columns = ["samples more", TableColumn("RMS", "m")]
        shown.append(Table("position residual in closed loop by dead time", columns, rows))
    if identified.control is not None:
        shown.append(identified.control.table())
    rigid = identified.rigid
    return [*shown, identified.delay.table(), rigid.rows_table(), rigid.residuals.table(), rigid.validation.table()]


def _terms(rigid: RigidFit) -> str:
    """Return the list of forces in the fitted model, for a caption."""
    periodic = sum(np.isfinite(period) for period in rigid.periods)
    terms = ["mass times acceleration"]
    terms += ["the force that bends the axis (by the fourth derivative of the position)"] if rigid.bends else []
    terms += ["a force proportional to the position"] if len(rigid.periods) > periodic else []
    terms += ["a force that repeats along the travel"] if periodic else []
    return " plus ".join([*terms, "friction"])


def _pictures(identified: Identified) -> Iterator[Picture]:
    rigid = identified.rigid
    left = Text(f"{Quantity(rigid.residuals.relative, 'share'):3}")
    yield Picture(
        "fit",
        "Fitted and measured force",
        f"Inverse dynamics: {_terms(rigid)}, over the force that was commanded. Reversals are left out: there friction "
        "is no single number.",
        Text(f"Measured and fitted force over time; the residual is {left} of the force."),
        rigid.chart,
    )
    if identified.refinement is not None:
        replay = identified.refinement.replay
        yield Picture(
            "closed",
            "The loop, simulated along the same reference",
            "Gray: the log. Blue: the fitted loop, given only the reference and how the log starts.",
            Text(
                "Measured and predicted signals; residual of the position "
                f"{Quantity(replay.rms('position_load'), 'm'):3} RMS."
            ),
            replay.chart,
        )
    if identified.loop is not None and identified.friction is not None:
        loop, seen = identified.loop, identified.friction
        yield Picture(
            "friction",
            "Friction",
            "Points: what is left of the force when the inertia is taken out, by velocity. Line: the fitted friction; "
            "a constant force is in the points and not in the line.",
            "Friction force over velocity in both directions, measured and fitted.",
            lambda: plot.friction_chart(loop, measured=seen),
        )
    yield Picture(
        "residual",
        "Residual and its autocorrelation",
        "A white residual would stay between the dashed lines; beyond them errors for white noise are too small.",
        "Residual by row and its autocorrelation.",
        rigid.residuals.chart,
    )
    yield Picture(
        "delay",
        "Dead time",
        "Residual of the inverse dynamics if the force acts this many samples later than its hold.",
        Text(f"Residual over dead time; least at {Quantity(identified.delay.dead_time):.2f} samples."),
        identified.delay.chart,
    )
