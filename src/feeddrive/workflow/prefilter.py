"""`feeddrive prefilter`: from a log of reference and position to a prefilter section of a machine file."""

from __future__ import annotations

from pathlib import Path

from feeddrive.blocks.families import Reference
from feeddrive.blocks.prefilter.trajectory_prefilter import TrajectoryPrefilter
from feeddrive.files.atomic_io import write_whole
from feeddrive.files.formats import OpenedFile
from feeddrive.files.job import JobLike, read_job
from feeddrive.files.log import LogLike
from feeddrive.files.machine import MachineLike, read_machine
from feeddrive.files.mapping import MappingLike
from feeddrive.files.to_toml import to_toml
from feeddrive.language.errors import ParameterError
from feeddrive.language.progress import Progress
from feeddrive.learning.trajectory_prefilter import REGRESSORS, PrefilterFit, fit_prefilter_to_log
from feeddrive.loop.loop import Loop
from feeddrive.workflow.channels import mapped
from feeddrive.workflow.command import Outcome, command
from feeddrive.workflow.drive_logs import chosen
from feeddrive.workflow.request import CHANNELS, UNIT, Request, argument, called, option

_WANTED = ("time", "setpoint_position", "position_load", "position_motor", "force")


class PrefilterRequest(Request):
    """The log, the derivatives that may be used, and known data of the loop that ran it."""

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

    def named(self) -> dict[str, str | None]:
        """Return the column texts of the options by role; None for an option left out."""
        return {
            "setpoint_position": self.set_position,
            "position_load": self.position,
            "force": self.force,
            "time": self.time,
        }


@command(PrefilterRequest)
def prefilter(request: PrefilterRequest, progress: Progress) -> Outcome[PrefilterFit]:
    """Fit the prefilter that cancels what a loop leaves of its tracking error, from one log.

    The outcome has the parameters with their standard errors and the section for the machine file.
    """
    loop, name = _loop(request.controller, request.axis)
    fit = _fit(request, _chosen(request.regressors), loop, _reference(request.job), progress)
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
    file, named = OpenedFile(request.log), request.named()
    read = mapped(file, named, request.channels, _WANTED, request.sample_time, progress, request.unit)
    read.doubt.stop(progress)
    measured = read.log
    set_position = chosen(file, measured, named, ("setpoint_position",), "set position", "--set-position")
    position = chosen(file, measured, named, ("position_load", "position_motor"), "position", "--position")
    present = None if loop is None else loop.control.prefilter
    if present is not None and not isinstance(present, TrajectoryPrefilter):
        raise ParameterError(
            f"control.prefilter of the controller is a {present.kind}; the log of a loop without it, or with a "
            f"trajectory_prefilter, can be used"
        )
    return fit_prefilter_to_log(
        measured.time - measured.time[0],
        measured[set_position],
        measured[position],
        measured.sample_time,
        reference=reference,
        regressors=regressors,
        present=present,
        force=measured.channels.get("force"),
        control=loop,
        name=str(file),
    )


def _loop(controller: MachineLike | None, axis: str | None) -> tuple[Loop | None, str]:
    if controller is None:
        return None, axis or "x"
    machine = read_machine(controller)
    loop = machine.loop(axis)
    return loop, loop.name


def _reference(job: JobLike | None) -> Reference | None:
    if job is None:
        return None
    reference = read_job(job).reference
    if reference is None:
        raise ParameterError(
            f"{called(job)}: has no [reference], only a log: leave out --job, or name the job that was run"
        )
    return reference


def _chosen(regressors: str) -> list[str]:
    """Parse `v,a,j,s` or whole names into the names of regressors."""
    chosen: list[str] = []
    for word in (part.strip() for part in regressors.split(",")):
        name = next((regressor for regressor in REGRESSORS if word and regressor.startswith(word)), None)
        if name is None:
            raise ParameterError(f"--regressors: '{word}' is none of v, a, j, s ({', '.join(REGRESSORS)})")
        chosen.append(name)
    return chosen
