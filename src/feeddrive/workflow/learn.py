"""`feeddrive iterate` and `prefilter`: feedforward and prefilters from logs or models."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from feeddrive.analysis.contour_control import matched_dynamics
from feeddrive.blocks.families import Reference
from feeddrive.blocks.feedforward.disturbance_compensator import DisturbanceCompensator
from feeddrive.blocks.feedforward.inertia import Inertia
from feeddrive.blocks.prefilter.trajectory_prefilter import TrajectoryPrefilter
from feeddrive.blocks.reference.snap_limited_move import SnapLimitedMove
from feeddrive.export.corrected_part import write_setpoints
from feeddrive.files.atomic_io import write_whole, written_whole
from feeddrive.files.drive import drive_with
from feeddrive.files.job import Job, JobLike, read_job
from feeddrive.files.log import Log, LogLike
from feeddrive.files.machine import MachineFile, MachineLike, read_machine
from feeddrive.files.mapping import MappingLike
from feeddrive.files.origins import with_origins
from feeddrive.files.read_log import OpenedFile
from feeddrive.files.section import to_toml
from feeddrive.language.errors import ParameterError
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Table
from feeddrive.language.text import Text, capitalized
from feeddrive.learning.iterative_feedforward import (
    AT_REST,
    Iteration,
    begin_compensation,
    compensated,
    next_iteration,
)
from feeddrive.learning.part_correction import planned_rows
from feeddrive.learning.part_log import PartTrials, iterate_parts
from feeddrive.learning.trajectory_prefilter import REGRESSORS, PrefilterFit, fit_prefilter_to_log
from feeddrive.learning.trial import Trial, measured_trial
from feeddrive.learning.trials import MachineTrials, iterate_machine, iterate_trials, tune_prefilters
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.workflow.channels import mapped
from feeddrive.workflow.command import CHANNELS, UNIT, Outcome, Request, argument, called, command, line, option
from feeddrive.workflow.control_text import machine_text
from feeddrive.workflow.drive_logs import chosen

# role of a column that an option of a request names -> that option
_OPTIONS = {
    "setpoint_position": "set_position",
    "position_load": "position",
    "force": "force",
    "command": "command",
    "time": "time",
}
# default motion of simulated trials
MOVE = SnapLimitedMove(
    distance=0.1,
    velocity=0.25,
    acceleration=3.0,
    jerk=60.0,
    snap=15e3,
    # friction can be separated from a constant force only by a reversal
    back=True,
    dwell_before=0.02,
    dwell_between=0.2,
    dwell_after=0.2,
)


class IterateRequest(Request):
    """A log of one trial, or a machine for simulated trials, and the settings of the learning step."""

    source: MachineLike | Log = argument(
        "A log of set position and position (MAT, CSV, Parquet), or a machine to simulate trials"
    )
    controller: MachineLike | None = option("the machine file of the loop that ran the log", default=None)
    axis: str | None = option("its axis, if it has several", default=None)
    form: str = option("form of the step: model-free, model-based or axis-model", default="model-free")
    columns: str | None = option("parameters to tune, as mass,viscous,coulomb_positive", default=None)
    gamma: float = option("share of the step; 0.5 if gains are known roughly", default=1.0)
    stribeck_velocity: float | None = option("adds a Stribeck column", unit="m/s", default=None)
    least_mass: float = option("lower bound of the mass", default=0.0, unit="kg")
    at_rest: str | None = option(
        "friction at rest: held, an unknown force that holds the axis, or none, the model's force (Wu's law); default: "
        "held for a log, none for simulated trials",
        default=None,
        options=AT_REST,
    )
    skip: int = option("samples at the start of the log that do not count", default=0)
    smoothing: int | None = option("samples over which the set position is averaged", default=None)
    set_position: str | None = option("column of the set position, name:unit", default=None)
    position: str | None = option("column of the position of the table", default=None)
    force: str | None = option("column of the commanded force", default=None)
    command: str | None = option("column of the command in the drive's unit", default=None)
    time: str | None = option("column of the time, name:unit", default=None)
    sample_time: float | None = option("sample time of a log without a clock", unit="s", default=None)
    unit: tuple[str, ...] = option(UNIT, default=())
    channels: MappingLike | None = option(CHANNELS, default=None)
    trials: int = option("simulated trials", default=6)
    prefilter: bool = option(
        "tune trajectory prefilters of all axes of a job instead of the feedforward", default=False
    )
    offsets: bool = option(
        "learn the force offsets of `setpath` from part to part of a job, in place of the feedforward", default=False
    )
    job: tuple[JobLike, ...] = option("job whose reference the trials run; several take turns", default=())
    seed: int = option("seed of the noise of simulated trials", default=0)
    out: Path | None = option("File for the section (TOML)", short="-o", default=None)
    into: Path | None = option(
        "Machine file (TOML) to write: that of the loop, with the section in it; for one axis", default=None
    )

    @property
    def machine(self) -> MachineLike:
        """The machine file of the loop. Raises ParameterError if a log is given without `controller`."""
        source = self.source if self.controller is None else self.controller
        if isinstance(source, Log):
            raise ParameterError(f"{source.name}: is a log: say with --controller which machine ran it")
        return source

    @property
    def wanted(self) -> tuple[str, ...] | None:
        """The names of the parameters to tune; None for the default of the loop."""
        if self.columns is None:
            return None
        return tuple(name.strip() for name in self.columns.split(",") if name.strip())


@command(IterateRequest)
def iterate(request: IterateRequest, progress: Progress) -> Outcome[Iteration | MachineTrials | PartTrials]:
    """Learn the feedforward of mass, viscous and dry friction from the error of a logged trial, or of simulated trials.

    The outcome contains the parameters for the next trial and the section for the machine file.  If a job moves several
    axes, as with a part program, and no axis is named, all moving axes learn from the same runs, and the contour error
    is reported.
    """
    together = _together(request)
    if together is not None:
        return _all_axes(request, together, progress)
    if request.offsets:
        raise ParameterError("--offsets is for the axes of a job that run together: name it by --job, without --axis")
    if request.prefilter:
        raise ParameterError("--prefilter is for the axes of a job that run together: name it by --job, without --axis")
    loop, axis = _compensated_loop(request)
    iteration, tables, remarks = (_simulated if request.controller is None else _measured)(request, loop, progress)
    text = to_toml(iteration.after, f"axis.{axis}.control.feedforward", listed=True, rotary=loop.axis.rotary)
    files: dict[str, Path] = {}
    if request.out is not None:
        progress.step("writing")
        write_whole(request.out, text)
        files["Written"] = request.out
    then = ""
    if request.into is not None:
        progress.step("writing")
        write_whole(request.into, _machine_with(request, compensated(loop, iteration.after).control, axis))
        files["Machine"] = request.into
        then = line("certify", request.into, axis=request.axis)
    notes = [*remarks, *_remarks(iteration, request)]
    return Outcome(iteration, tables, notes, section=text, files=files, rotary=loop.axis.rotary, then=then)


def _machine_with(request: IterateRequest, control: Control, axis: str) -> str:
    """Return the text of the machine file of the loop with the control that learned, and with its sources."""
    machine = read_machine(request.machine)
    log = () if request.controller is None else (request.source,)
    return with_origins(machine_text(machine, axis, control), (machine, *log))


def _measured(request: IterateRequest, loop: Loop, progress: Progress) -> tuple[Iteration, list[Table], list[str]]:
    """Compute one learning step from one log."""
    progress.step(f"reading {called(request.source)}")
    trial = _trial(request, loop, progress)
    iteration = next_iteration(
        loop,
        trial,
        form=request.form.replace("-", "_"),
        gamma=request.gamma,
        columns=request.wanted,
        least_mass=request.least_mass,
        at_rest=request.at_rest or "held",
        skip=request.skip,
    )
    moving = trial.starts_moving and request.skip == 0
    text = "The log starts in motion; its first samples are taken as steady: --skip leaves some out."
    return iteration, [iteration.table()], [text] if moving else []


def _simulated(request: IterateRequest, loop: Loop, progress: Progress) -> tuple[Iteration, list[Table], list[str]]:
    """Simulate learning trials on the machine."""
    remedy = "give the log itself, with --controller"
    references = [job_reference(job, remedy) for job in request.job] or [MOVE]
    progress.step(f"{request.trials} trials")
    trials = iterate_trials(
        loop,
        references,
        request.trials,
        form=request.form.replace("-", "_"),
        gamma=request.gamma,
        columns=request.wanted,
        least_mass=request.least_mass,
        at_rest=request.at_rest or "none",
        seed=request.seed,
    )
    text = Text(
        f"Each trial: {Quantity(MOVE.distance, 'm'):6 mm} out and back, at most {Quantity(MOVE.velocity, 'm/s'):6 SI}, "
        f"{Quantity(MOVE.acceleration, 'm/s2')}, {Quantity(MOVE.jerk, 'm/s3'):6}; --job names another motion."
    )
    return trials.iterations[-1], [trials.table()], [] if request.job else [text]


def _together(request: IterateRequest) -> Job | None:
    """Return the job whose axes learn together; None for a single axis."""
    if request.axis is not None or request.controller is not None or len(request.job) != 1:
        return None
    job = read_job(request.job[0])
    return job if len(job.others) > 0 and len(read_machine(request.machine).loops) > 1 else None


def _all_axes(request: IterateRequest, job: Job, progress: Progress) -> Outcome[Any]:
    """Simulate learning trials of a job, from which all axes of the machine learn together."""
    if request.into is not None:
        raise ParameterError("--into is for one axis, and this job moves several: name one by --axis, or take --out")
    if request.at_rest == "held":
        raise ParameterError("--at-rest held is for one axis; the axes of a job learn together with none: leave it out")
    file = read_machine(request.machine)
    machine = file.machine()
    paths = {file.named(job.axis): job.reference, **{name: other.reference for name, other in job.others.items()}}
    missing = [name for name in machine.axes() if paths.get(name) is None]
    if missing:
        raise ParameterError(f"{called(request.job[0])}: gives axis {', '.join(missing)} of {file.file.name} no motion")
    references = {name: path for name, path in paths.items() if path is not None}
    if request.offsets:
        return _offsets(request, file, job, references, progress)
    if request.prefilter:
        trials = tune_prefilters(machine, references, request.trials, seed=request.seed, progress=progress)
    else:
        trials = iterate_machine(
            machine,
            references,
            request.trials,
            form=request.form.replace("-", "_"),
            gamma=request.gamma,
            columns=request.wanted,
            least_mass=request.least_mass,
            seed=request.seed,
            progress=progress,
        )
    name = "prefilter" if request.prefilter else "feedforward"
    section = "\n".join(
        to_toml(block, f"axis.{axis}.control.{name}", listed=not request.prefilter, rotary=file.loops[axis].axis.rotary)
        for axis, block in trials.learned.items()
    )
    files: dict[str, Path] = {}
    if request.out is not None:
        progress.step("writing")
        write_whole(request.out, section)
        files["Written"] = request.out
    # axes that follow with different dynamics leave a contour error, even where each tracks well
    remarks = [*trials.remarks, *matched_dynamics(trials.machine).remarks()]
    if not request.prefilter:
        remarks += [
            text for axis in trials.learned for text in _replaced(file.loops[axis], f"The section of axis {axis}")
        ]
    return Outcome(trials, [trials.table()], remarks, section=section, files=files)


def _offsets(
    request: IterateRequest, file: MachineFile, job: Job, references: Mapping[str, Reference], progress: Progress
) -> Outcome[Any]:
    """Simulate parts of a job that learn the force offsets of all axes from their logs."""
    if request.prefilter or request.columns is not None:
        raise ParameterError(
            "--offsets learns a force over time and no parameters: leave out --prefilter and --columns"
        )
    job.require_axes("learn --offsets")
    machine = file.machine()
    counted = None if job.program is None else job.program.counted
    plan = planned_rows(references, float(machine.sample_time))
    trials = iterate_parts(machine, plan, request.trials, counted=counted, seed=request.seed, progress=progress)
    files: dict[str, Path] = {}
    if request.out is not None:
        progress.step("writing")
        with written_whole(request.out) as text:
            write_setpoints(text, trials.correction, None if job.program is None else job.program.line)
        files["Written"] = request.out
    remarks = [
        *trials.remarks,
        "The file holds set positions and force offsets of all axes, sample by sample; the control stays as it is.",
        "These parts are simulated on the machine file; `feeddrive setpath JOB --from-log` learns from those of a "
        "real one.",
    ]
    return Outcome(trials, [trials.table()], remarks, files=files)


def _remarks(iteration: Iteration, request: IterateRequest) -> list[str]:
    """Return remarks on how to use the section."""
    remarks: list[str] = [Text(f"{name} is frozen: {reason}.") for name, reason in iteration.frozen.items()]
    remarks += [f"{name} is held by its bound." for name in iteration.held]
    remarks += [capitalized(f"{remark}.") for remark in iteration.remarks]
    if iteration.trial.saturated is None:
        remarks.append("Whether the force was limited is not known: name its column with --force.")
    if iteration.gamma > 0.5:
        remarks.append("This step trusts the gains of the controller; where they are known roughly, take --gamma 0.5.")
    return [*remarks, *_replaced(read_machine(request.machine).loop(request.axis), "The section")]


def _replaced(loop: Loop, section: str) -> list[str]:
    """Return a remark on the blocks of the machine file that the section replaces."""
    there = [block.kind for block in loop.control.feedforward if isinstance(block, (Inertia, DisturbanceCompensator))]
    return [f"{section} takes the place of {' and '.join(there)} in the machine file."] if there else []


def _compensated_loop(request: IterateRequest) -> tuple[Loop, str]:
    """Return the loop with a compensator that has the requested parameters, and the name of the axis."""
    machine = read_machine(request.machine)
    loop = machine.loop(request.axis)
    axis = loop.name
    has = any(isinstance(block, DisturbanceCompensator) for block in loop.control.feedforward)
    # a compensator of the file keeps its parameters: it is the starting point of the next step
    if has and request.wanted is None and request.stribeck_velocity is None:
        return loop, axis
    columns = request.wanted
    if request.stribeck_velocity is not None and columns is None:
        columns = ("mass", "viscous", "coulomb_positive", "coulomb_negative", "stribeck")
    return begin_compensation(loop, columns, stribeck_velocity=request.stribeck_velocity), axis


def _log(request: IterateRequest) -> OpenedFile:
    if isinstance(request.source, MachineFile):
        raise ParameterError(f"{called(request.source)}: is a machine: leave out --controller to simulate its trials")
    return OpenedFile(request.source)


def _trial(request: IterateRequest, loop: Loop, progress: Progress) -> Trial:
    file = _log(request)
    measured, set_position, position = _tracked(file, request, progress)
    force = measured.channels.get("force")
    if force is None and "command" in measured.channels:
        scale = drive_with(None, loop, request.axis).force_per_unit(measured.units["command"])
        # the force only marks saturated samples, so a trial without it is still usable
        force = None if scale is None else scale * measured["command"]
    return measured_trial(
        loop,
        set_position,
        position,
        sample_time=measured.sample_time,
        force=force,
        smoothing=request.smoothing,
        name=str(file),
    )


class PrefilterRequest(Request):
    """The log, the allowed derivatives of the set position, and known data of the loop that was logged."""

    log: LogLike = argument("A log of set position and position (MAT, CSV, Parquet)")
    regressors: str = option("derivatives of the reference that may be used", default="v,a,j,s")
    controller: MachineLike | None = option(
        "the machine file of the loop: its clock, limit and prefilter", default=None
    )
    axis: str | None = option("its axis, if it has several", default=None)
    job: JobLike | None = option("the job whose reference was run, for exact derivatives", default=None)
    set_position: str | None = option("column of the set position", default=None)
    position: str | None = option("column of the position of the table", default=None)
    force: str | None = option("column of the commanded force", default=None)
    time: str | None = option("column of the time, name:unit", default=None)
    sample_time: float | None = option("sample time of a log without a clock", unit="s", default=None)
    unit: tuple[str, ...] = option(UNIT, default=())
    channels: MappingLike | None = option(CHANNELS, default=None)
    out: Path | None = option("File for the section (TOML)", short="-o", default=None)


@command(PrefilterRequest)
def prefilter(request: PrefilterRequest, progress: Progress) -> Outcome[PrefilterFit]:
    """Fit, from one log, the prefilter that cancels the remaining tracking error of a loop.

    The outcome contains the parameters with their standard errors, and the section for the machine file.
    """
    loop, name = _controlled_loop(request.controller, request.axis)
    remedy = "leave out --job, or name the job that was run"
    reference = None if request.job is None else job_reference(request.job, remedy)
    fit = _fit(request, _chosen(request.regressors), loop, reference, progress)
    text = to_toml(fit.prefilter, f"axis.{name}.control.prefilter")
    remarks = [
        "Derivatives are central differences of the log's set positions, not filtered."
        if request.job is None
        else "Derivatives are those of the job's reference, exact."
    ]
    if loop is None:
        remarks.append("Neither the clock nor the force limit of the controller is known: give it with --controller.")
    files: dict[str, Path] = {}
    if request.out is not None:
        progress.step("writing")
        write_whole(request.out, text)
        files["Written"] = request.out
    return Outcome(fit, [fit.table()], remarks, section=text, files=files)


def _fit(
    request: PrefilterRequest, regressors: list[str], loop: Loop | None, reference: Reference | None, progress: Progress
) -> PrefilterFit:
    file = OpenedFile(request.log)
    measured, set_position, position = _tracked(file, request, progress)
    present = None if loop is None else loop.control.prefilter
    # the fit adds its parameters to those of the present prefilter, which must therefore have the same ones
    if present is not None and not isinstance(present, TrajectoryPrefilter):
        raise ParameterError(
            f"control.prefilter of the controller is a {present.kind}; the log of a loop without it, or with a "
            f"trajectory_prefilter, can be used"
        )
    return fit_prefilter_to_log(
        # the reference of a job starts at t = 0, the clock of a log anywhere
        measured.time - measured.time[0],
        set_position,
        position,
        measured.sample_time,
        reference=reference,
        regressors=regressors,
        present=present,
        force=measured.channels.get("force"),
        control=loop,
        name=str(file),
    )


def _controlled_loop(controller: MachineLike | None, axis: str | None) -> tuple[Loop | None, str]:
    if controller is None:
        return None, axis or "x"
    machine = read_machine(controller)
    loop = machine.loop(axis)
    return loop, loop.name


def _chosen(regressors: str) -> list[str]:
    """Parse abbreviations (`v,a,j,s`) or full names into names of regressors.

    Raises ParameterError for an unknown name.
    """
    chosen: list[str] = []
    for word in (part.strip() for part in regressors.split(",")):
        # `word and`: an empty word is the beginning of every name
        name = next((regressor for regressor in REGRESSORS if word and regressor.startswith(word)), None)
        if name is None:
            raise ParameterError(f"--regressors: '{word}' is none of v, a, j, s ({', '.join(REGRESSORS)})")
        chosen.append(name)
    return chosen


def _tracked(
    file: OpenedFile, request: IterateRequest | PrefilterRequest, progress: Progress
) -> tuple[Log, np.ndarray, np.ndarray]:
    """Return the log of a motion, and the set position and the measured position in it, both in m.

    The measured position is that of the load encoder or, if there is none, of the motor encoder.
    """
    # a prefilter request has no option for a command in the drive's unit
    named = {role: getattr(request, name) for role, name in _OPTIONS.items() if hasattr(request, name)}
    roles = (*named, "position_motor")
    read = mapped(file, named, request.channels, roles, request.sample_time, progress, request.unit)
    read.stop(progress)
    log = read.log
    set_position = chosen(file, log, named, ("setpoint_position",), "set position", "--set-position")
    position = chosen(file, log, named, ("position_load", "position_motor"), "position", "--position")
    return log, log[set_position], log[position]


def job_reference(job: JobLike, remedy: str) -> Reference:
    """Return the reference of a job. Raise ParameterError with a remedy for a job that has only a log."""
    reference = read_job(job).reference
    if reference is None:
        raise ParameterError(f"{called(job)}: has no [reference], only a log: {remedy}")
    return reference
