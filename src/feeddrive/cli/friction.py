"""`feeddrive friction`: a friction curve from logs of constant speeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from feeddrive.cli.drive_logs import Drive, chosen, columns_said, drive_of, logs_said, read_logs, stem
from feeddrive.cli.identify_frf import narrow
from feeddrive.cli.terminal import open_console
from feeddrive.cli.working import drawn
from feeddrive.files.log import Log
from feeddrive.files.messages import sentence
from feeddrive.identification.frame import SHAFT
from feeddrive.identification.steady_runs.friction_curve import fit_friction
from feeddrive.identification.steady_runs.steady_runs import LEAST_ROWS, SteadyRuns, steady_runs
from feeddrive.language.errors import NotIdentifiableError, ParameterError
from feeddrive.workflow.friction_page import (
    kept_away,
    machine_text,
    recommendation,
    remarks,
    tables,
    write_friction,
)

# along the table and round the shaft, the first that is there is taken; a position is differenced
_TABLE = ("velocity_load", "velocity_motor", "position_load", "position_motor")
_SHAFT = ("speed_motor", "angle_motor")
_FORCES = ("force", "torque", "command", "current")


def perform(
    logs: Sequence[Path], named: Mapping[str, str | None], channels: Path | None, machine: str | None,
    axis: str | None, force_constant: float | None, lead: float | None, gear: float | None,
    sample_time: float | None, out: Path | None,
) -> None:  # fmt: skip
    """Read, find the runs, fit, show, write."""
    console = open_console()
    drive = drive_of(machine, axis, force_constant, lead, gear)
    read, mapping = read_logs(logs, named, channels, ("time", *_TABLE, *_SHAFT, *_FORCES), sample_time, console)
    runs, without = _runs(logs, read, named, drive)
    curve = fit_friction(runs)
    said = [*remarks(curve, drive.loop), *without]
    compared, parameters = tables(curve)
    console.print(drawn(compared, 0))
    console.print(drawn(narrow(parameters)))
    for remark in said:
        console.print(f"- {sentence(remark)}", markup=False)
    why = kept_away(curve, drive.loop)
    text = None if why else machine_text(curve, drive.machine, drive.axis)
    facts = {
        "Logs": logs_said(logs),
        "Runs": f"{runs.velocity.size} of {int(np.min(runs.rows))} to {int(np.max(runs.rows))} rows",
        "Columns": columns_said(mapping),
        "Lead": "none given" if drive.lead is None else f"{1e3 * drive.lead:.6g} mm, gear {drive.gear:g}",
        "Machine": machine or "none given",
    }
    report = write_friction(curve, said, text, out or Path("results") / f"friction_{stem(logs)}", facts)
    console.print(recommendation(curve), markup=False)
    if text is None:
        console.print(f"- No machine file was written: {why}.", markup=False)
    else:
        console.print(f"Machine: {report.parent / 'machine.toml'}", markup=False, soft_wrap=True)
    console.print(f"Report: {report}", markup=False, soft_wrap=True)


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
