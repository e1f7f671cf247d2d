"""`feeddrive iterate`: the next feedforward parameters, from a log or over simulated trials."""

from __future__ import annotations

from pathlib import Path

from feeddrive.analysis.contour_control import matched_dynamics
from feeddrive.blocks.families import Reference
from feeddrive.blocks.feedforward.disturbance_compensator import DisturbanceCompensator
from feeddrive.blocks.feedforward.inertia import Inertia
from feeddrive.blocks.reference.snap_limited_move import SnapLimitedMove
from feeddrive.files.atomic_io import write_whole
from feeddrive.files.drive import drive_with
from feeddrive.files.formats import OpenedFile
from feeddrive.files.job import Job, JobLike, read_job
from feeddrive.files.log import Log
from feeddrive.files.machine import MachineFile, MachineLike, read_machine
from feeddrive.files.mapping import MappingLike
from feeddrive.files.to_toml import to_toml
from feeddrive.language.errors import ParameterError
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Table
from feeddrive.language.text import Text, capitalized
from feeddrive.learning.iterative_feedforward import Iteration, begin_compensation, next_iteration
from feeddrive.learning.trial import Trial, measured_trial
from feeddrive.learning.trials import MachineTrials, iterate_machine, iterate_trials, tune_prefilters
from feeddrive.loop.loop import Loop
from feeddrive.workflow.channels import mapped
from feeddrive.workflow.command import Outcome, command
from feeddrive.workflow.drive_logs import chosen
from feeddrive.workflow.request import CHANNELS, UNIT, Request, argument, called, option

_WANTED = ("time", "setpoint_position", "position_load", "position_motor", "force", "command")
# the motion of simulated trials if no job names another
MOVE = SnapLimitedMove(
    distance=0.1,
    velocity=0.25,
    acceleration=3.0,
    jerk=60.0,
    snap=15e3,
    back=True,
    dwell_before=0.02,
    dwell_between=0.2,
    dwell_after=0.2,
)


class IterateRequest(Request):
    """A log of one trial, or a machine on which trials are simulated, and how far a step goes."""

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
    job: tuple[JobLike, ...] = option("job whose reference the trials run; several take turns", default=())
    seed: int = option("seed of the noise of simulated trials", default=0)
    out: Path | None = option("File for the section (TOML)", short="-o", default=None)

    def named(self) -> dict[str, str | None]:
        """Return the column texts of the options by role; None for an option left out."""
        return {
            "setpoint_position": self.set_position,
            "position_load": self.position,
            "force": self.force,
            "command": self.command,
            "time": self.time,
        }

    @property
    def machine(self) -> MachineLike:
        """The machine file of the loop."""
        source = self.source if self.controller is None else self.controller
        if isinstance(source, Log):
            raise ParameterError(f"{source.name}: is a log: say with --controller which machine ran it")
        return source

    @property
    def wanted(self) -> tuple[str, ...] | None:
        """The parameters to tune; None for those that the loop has."""
        if self.columns is None:
            return None
        return tuple(name.strip() for name in self.columns.split(",") if name.strip())


@command(IterateRequest)
def iterate(request: IterateRequest, progress: Progress) -> Outcome[Iteration | MachineTrials]:
    """Learn mass, viscous and dry friction to feed forward from the error of a trial: a log, or simulated ones.

    The outcome has the next parameters and the section for the machine file.  With a job that runs several axes, such
    as a part program, and without an axis, all that move learn from the same runs, and the contour error is reported.
    """
    together = _together(request)
    if together is not None:
        return _all_axes(request, together, progress)
    if request.prefilter:
        raise ParameterError("--prefilter is for the axes of a job that run together: name it by --job, without --axis")
    loop, axis = _loop(request)
    iteration, tables, remarks = (_simulated if request.controller is None else _measured)(request, loop, progress)
    key = f"axis.{axis}.control.feedforward"
    text = to_toml(iteration.after, key, rotary=loop.axis.rotary).replace(f"[{key}]", f"[[{key}]]", 1)
    files: dict[str, Path] = {}
    if request.out is not None:
        progress.step("writing")
        write_whole(request.out, text)
        files["Written"] = request.out
    notes = [*remarks, *_remarks(iteration, request)]
    return Outcome(iteration, tables, notes, section=text, files=files, rotary=loop.axis.rotary)


def _measured(request: IterateRequest, loop: Loop, progress: Progress) -> tuple[Iteration, list[Table], list[str]]:
    """Take one step from one log."""
    progress.step(f"reading {called(request.source)}")
    trial = _trial(request, loop, progress)
    iteration = next_iteration(
        loop,
        trial,
        form=request.form.replace("-", "_"),
        gamma=request.gamma,
        columns=request.wanted,
        least_mass=request.least_mass,
        skip=request.skip,
    )
    moving = trial.starts_moving and request.skip == 0
    text = "The log starts in motion; its first samples are taken as steady: --skip leaves some out."
    return iteration, [iteration.table()], [text] if moving else []


def _simulated(request: IterateRequest, loop: Loop, progress: Progress) -> tuple[Iteration, list[Table], list[str]]:
    """Run simulated trials on the machine."""
    references = [_reference(job) for job in request.job] or [MOVE]
    progress.step(f"{request.trials} trials")
    trials = iterate_trials(
        loop,
        references,
        request.trials,
        form=request.form.replace("-", "_"),
        gamma=request.gamma,
        columns=request.wanted,
        least_mass=request.least_mass,
        seed=request.seed,
    )
    text = Text(
        f"Each trial: {Quantity(MOVE.distance, 'm'):6 mm} out and back, at most {Quantity(MOVE.velocity, 'm/s'):6 SI}, "
        f"{Quantity(MOVE.acceleration, 'm/s2')}, {Quantity(MOVE.jerk, 'm/s3'):6}; --job names another motion."
    )
    return trials.iterations[-1], [trials.table()], [] if request.job else [text]


def _together(request: IterateRequest) -> Job | None:
    """Return the job whose axes learn together, if one is asked for."""
    if request.axis is not None or request.controller is not None or len(request.job) != 1:
        return None
    job = read_job(request.job[0])
    return job if len(job.others) > 0 and len(read_machine(request.machine).loops) > 1 else None


def _all_axes(request: IterateRequest, job: Job, progress: Progress) -> Outcome[Iteration | MachineTrials]:
    """Run a job on all axes of the machine."""
    file = read_machine(request.machine)
    machine = file.machine()
    paths = {file.named(job.axis): job.reference, **{name: other.reference for name, other in job.others.items()}}
    missing = [name for name in machine.axes() if paths.get(name) is None]
    if missing:
        raise ParameterError(f"{called(request.job[0])}: gives axis {', '.join(missing)} of {file.file.name} no motion")
    references = {name: path for name, path in paths.items() if path is not None}
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
    texts: list[str] = []
    for axis, block in trials.learned.items():
        key = f"axis.{axis}.control.{'prefilter' if request.prefilter else 'feedforward'}"
        text = to_toml(block, key, rotary=file.loops[axis].axis.rotary)
        texts.append(text if request.prefilter else text.replace(f"[{key}]", f"[[{key}]]", 1))
    section = "\n".join(texts)
    files: dict[str, Path] = {}
    if request.out is not None:
        progress.step("writing")
        write_whole(request.out, section)
        files["Written"] = request.out
    remarks = [*trials.remarks, *matched_dynamics(trials.machine).remarks()]
    if not request.prefilter:
        remarks += [
            text for axis in trials.learned for text in _replaced(file.loops[axis], f"The section of axis {axis}")
        ]
    return Outcome(trials, [trials.table()], remarks, section=section, files=files)


def _remarks(iteration: Iteration, request: IterateRequest) -> list[str]:
    """Return remarks for the use of the section."""
    remarks: list[str] = [Text(f"{name} is frozen: {reason}.") for name, reason in iteration.frozen.items()]
    remarks += [f"{name} is held by its bound." for name in iteration.held]
    remarks += [capitalized(f"{remark}.") for remark in iteration.remarks]
    if iteration.trial.saturated is None:
        remarks.append("Whether the force was limited is not known: name its column with --force.")
    if iteration.gamma > 0.5:
        remarks.append("This step trusts the gains of the controller; where they are known roughly, take --gamma 0.5.")
    return [*remarks, *_replaced(read_machine(request.machine).loop(request.axis), "The section")]


def _replaced(loop: Loop, section: str) -> list[str]:
    """Return a remark on the blocks of the machine file that a section replaces."""
    there = [block.kind for block in loop.control.feedforward if isinstance(block, (Inertia, DisturbanceCompensator))]
    return [f"{section} takes the place of {' and '.join(there)} in the machine file."] if there else []


def _loop(request: IterateRequest) -> tuple[Loop, str]:
    """Return the loop with a compensator that has the columns, and the name of its axis."""
    machine = read_machine(request.machine)
    loop = machine.loop(request.axis)
    axis = loop.name
    has = any(isinstance(block, DisturbanceCompensator) for block in loop.control.feedforward)
    if has and request.wanted is None and request.stribeck_velocity is None:
        return loop, axis
    columns = request.wanted
    if request.stribeck_velocity is not None and columns is None:
        columns = ("mass", "viscous", "coulomb_positive", "coulomb_negative", "stribeck")
    return begin_compensation(loop, columns, stribeck_velocity=request.stribeck_velocity), axis


def _reference(job: JobLike) -> Reference:
    reference = read_job(job).reference
    if reference is None:
        raise ParameterError(f"{called(job)}: has no [reference], only a log: give the log itself, with --controller")
    return reference


def _log(request: IterateRequest) -> OpenedFile:
    if isinstance(request.source, MachineFile):
        raise ParameterError(f"{called(request.source)}: is a machine: leave out --controller to simulate its trials")
    return OpenedFile(request.source)


def _trial(request: IterateRequest, loop: Loop, progress: Progress) -> Trial:
    file, named = _log(request), request.named()
    read = mapped(file, named, request.channels, _WANTED, request.sample_time, progress, request.unit)
    read.doubt.stop(progress)
    measured = read.log
    set_position = chosen(file, measured, named, ("setpoint_position",), "set position", "--set-position")
    position = chosen(file, measured, named, ("position_load", "position_motor"), "position", "--position")
    force = measured.channels.get("force")
    if force is None and "command" in measured.channels:
        scale = drive_with(None, loop, request.axis).force_per_unit(measured.units["command"])
        force = None if scale is None else scale * measured["command"]
    return measured_trial(
        loop,
        measured[set_position],
        measured[position],
        sample_time=measured.sample_time,
        force=force,
        smoothing=request.smoothing,
        name=str(file),
    )
