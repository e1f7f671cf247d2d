"""`feeddrive friction`: a friction curve from logs of constant speeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from feeddrive.files.log import Log
from feeddrive.files.messages import sentence
from feeddrive.identification.estimate import SHAFT
from feeddrive.identification.steady_runs.friction_curve import FrictionCurve, fit_friction
from feeddrive.identification.steady_runs.steady_runs import LEAST_ROWS, SteadyRuns, steady_runs
from feeddrive.language.errors import NotIdentifiableError, ParameterError
from feeddrive.language.progress import Progress
from feeddrive.workflow.command import Outcome, command
from feeddrive.workflow.drive_logs import (
    Drive,
    DriveLogsRequest,
    chosen,
    columns_said,
    drive_of,
    logs_said,
    narrow,
    read_logs,
    stem,
    written,
)
from feeddrive.workflow.friction_page import (
    kept_away,
    machine_text,
    recommendation,
    remarks,
    tables,
    write_friction,
)
from feeddrive.workflow.request import argument, option

# along the table and round the shaft, the first that is there is taken; a position is differenced
_TABLE = ("velocity_load", "velocity_motor", "position_load", "position_motor")
_SHAFT = ("speed_motor", "angle_motor")
_FORCES = ("force", "torque", "command", "current")


class FrictionRequest(DriveLogsRequest):
    """Logs of constant speeds, and the columns of the motion."""

    logs: tuple[Path, ...] = argument("Logs of constant speeds; one log may hold several")
    velocity: str | None = option("column along the table: name:unit or name*factor:unit", default=None)
    position: str | None = option("the position instead, to be differenced", default=None)
    speed: str | None = option("column of the motor's speed, as n:rpm", default=None)
    angle: str | None = option("the motor's angle instead, to be differenced", default=None)

    def usual_out(self) -> Path:
        """By the name of what it is about."""
        return Path("results") / f"friction_{stem(self.logs)}"

    def named(self) -> dict[str, str | None]:
        """The columns that were named, by their roles."""
        return {
            "velocity_load": self.velocity, "position_load": self.position, "speed_motor": self.speed,
            "angle_motor": self.angle, **self.forces(),
        }  # fmt: skip


@command(FrictionRequest)
def friction(request: FrictionRequest, progress: Progress) -> Outcome[FrictionCurve]:
    """Find the friction curve in runs of constant speed: models compared by evidence, parameters with errors.

    Raises LogError for a log that cannot be used, NotIdentifiableError for logs without a constant speed.
    """
    drive, named, logs = drive_of(request), request.named(), request.logs
    wanted = ("time", *_TABLE, *_SHAFT, *_FORCES)
    read, mapping = read_logs(logs, named, request.channels, wanted, request.sample_time, progress)
    progress.step("fitting")
    runs, without = _runs(logs, read, named, drive)
    curve = fit_friction(runs)
    said = [*remarks(curve, drive.loop), *without]
    compared, parameters = tables(curve)
    why = kept_away(curve, drive.loop)
    text = None if why else machine_text(curve, drive.machine, drive.axis)
    files: dict[str, Path] = {}
    if request.out is not None:
        facts = {
            "Logs": logs_said(logs),
            "Runs": f"{runs.velocity.size} of {int(np.min(runs.rows))} to {int(np.max(runs.rows))} rows",
            "Columns": columns_said(mapping),
            "Lead": "none given" if drive.lead is None else f"{1e3 * drive.lead:.6g} mm, gear {drive.gear:g}",
            "Machine": request.machine or "none given",
        }
        progress.step("report")
        report = write_friction(curve, said, text, request.out, facts)
        files = written(report, text)
    return Outcome(
        curve, [replace(compared, sentences=0), narrow(parameters)], [sentence(each) for each in said],
        recommendation(curve), [f"No machine file was written: {why}."] if why else [], files=files,
    )  # fmt: skip


def _runs(
    paths: Sequence[Path], logs: Sequence[Log], named: Mapping[str, str | None], drive: Drive
) -> tuple[SteadyRuns, list[str]]:
    """The constant speeds of all logs, and remarks on logs that hold none."""
    found: list[SteadyRuns] = []
    without: list[str] = []
    for path, log in zip(paths, logs, strict=True):
        velocity, force, rotary = _pair(path, log, named, drive)
        try:
            found.append(steady_runs([(velocity, force)], rotary=rotary))
        except NotIdentifiableError:
            without.append(f"{path.name} holds no constant speed for {LEAST_ROWS} rows and is left out")
    if not found:
        raise NotIdentifiableError(
            f"{paths[0]}: no constant speed is held for {LEAST_ROWS} rows"
            + (f", nor in the {len(paths) - 1} other logs" if len(paths) > 1 else "")
            + "; record next runs at a constant speed, some seconds each"
        )
    joined = (
        np.concatenate([getattr(each, name) for each in found]) for name in ("velocity", "force", "error", "rows")
    )
    runs = SteadyRuns(*joined, frame=found[0].frame)
    return (runs.at_table(drive.lead, drive.gear) if drive.lead is not None else runs), without


def _pair(path: Path, log: Log, named: Mapping[str, str | None], drive: Drive) -> tuple[np.ndarray, np.ndarray, bool]:
    """Velocity and force of a log, and whether they are those of a shaft."""
    acting = chosen(path, log, named, _FORCES, "force", "--force, --torque, --current or --command")
    shaft_first = acting == "torque"
    order = (*_SHAFT, *_TABLE) if shaft_first else (*_TABLE, *_SHAFT)
    moving = chosen(path, log, named, order, "velocity", "--velocity, --speed, --position or --angle")
    velocity, force = log[moving], log[acting]
    if moving.startswith(("position", "angle")):
        velocity = np.gradient(velocity, log.sample_time)
    if acting in ("command", "current"):
        if drive.force_constant is None:
            raise ParameterError(
                f"{path}: the {acting} is in the drive's own unit: give the force per unit with --force-constant, the "
                f"machine with --machine, or the torque per unit as --torque 'column*factor'"
            )
        force = drive.force_constant * force
    round_, turning = acting == "torque", moving in _SHAFT
    if round_ == turning:
        return velocity, force, turning
    r = drive.lever
    if r is None:
        raise ParameterError(
            f"{path}: {moving} is in {log.units.get(moving, SHAFT.velocity)} and the force comes from {acting}: one "
            f"is along the table and the other round a shaft; give the screw's lead in m with --lead"
        )
    return (r * velocity, force, False) if turning else (velocity, force / r, False)
