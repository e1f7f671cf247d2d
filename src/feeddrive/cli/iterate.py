"""`feeddrive iterate`: the next feedforward parameters, from a log or over simulated trials."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from feeddrive.blocks.families import Feedforward, Reference
from feeddrive.blocks.feedforward.disturbance_compensator import DisturbanceCompensator
from feeddrive.blocks.feedforward.inertia import Inertia
from feeddrive.blocks.reference.snap_limited_move import SnapLimitedMove
from feeddrive.cli.terminal import open_console
from feeddrive.cli.working import drawn
from feeddrive.files.atomic_io import write_whole
from feeddrive.files.blocks_to_toml import to_toml
from feeddrive.files.columns import Column
from feeddrive.files.job import read_job
from feeddrive.files.machine import read_machine
from feeddrive.files.messages import nearest
from feeddrive.files.read_log import read_log
from feeddrive.language.errors import LogError, ParameterError
from feeddrive.loop.loop import Loop
from feeddrive.tuning.compensated import begin_compensation
from feeddrive.tuning.iterative_feedforward import Iteration, iterate
from feeddrive.tuning.trial import Trial, measured_trial
from feeddrive.tuning.trials import iterate_trials

# names that a column may have for each role, the first that is there is taken
USUAL: Mapping[str, tuple[str, ...]] = {
    "setpoint_position": ("setpoint_position", "set_position", "reference", "x_set", "xr", "qg"),
    "position_load": ("position_load", "reading_load", "position", "x", "y", "qm"),
    "force": ("force",),
    "command": ("command", "vir"),
}
_NEEDED = {"setpoint_position": "--set-position", "position_load": "--position"}
_UNITS = ("m", "mm", "um", "nm", "N", "kN")
# the motion of simulated trials if no job names another
MOVE = SnapLimitedMove(
    distance=0.1, velocity=0.25, acceleration=3.0, jerk=60.0, snap=15e3, back=True, dwell_before=0.02,
    dwell_between=0.2, dwell_after=0.2,
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Asked:
    """The options that both ways share."""

    controller: str
    axis: str | None
    form: str
    gamma: float
    columns: tuple[str, ...] | None
    stribeck_velocity: float | None
    least_mass: float
    out: Path | None


def perform_on_log(log: Path, asked: Asked, named: Mapping[str, str | None], skip: int, smoothing: int | None) -> None:
    """One log, one step."""
    loop, axis = _loop(asked)
    trial = _trial(log, loop, named, smoothing)
    found = iterate(
        loop, trial, form=asked.form.replace("-", "_"), gamma=asked.gamma, columns=asked.columns,
        least_mass=asked.least_mass, skip=skip,
    )  # fmt: skip
    console = open_console()
    console.print(drawn(found.table()))
    if trial.starts_moving and skip == 0:
        console.print(
            "- The log starts in motion; its first samples are taken as steady: --skip leaves some out.", markup=False
        )
    _finish(console, found, axis, asked)


def perform_trials(asked: Asked, trials: int, jobs: Sequence[str], seed: int) -> None:
    """Simulated trials on the machine itself."""
    loop, axis = _loop(asked)
    references = [_reference(job) for job in jobs] or [MOVE]
    found = iterate_trials(
        loop, references, trials, form=asked.form.replace("-", "_"), gamma=asked.gamma, columns=asked.columns,
        least_mass=asked.least_mass, seed=seed,
    )  # fmt: skip
    console = open_console()
    console.print(drawn(found.table()))
    if not jobs:
        console.print(
            f"- Each trial: {1e3 * MOVE.distance:g} mm out and back, at most {MOVE.velocity:g} m/s, "
            f"{MOVE.acceleration:g} m/s², {MOVE.jerk:g} m/s³; --job names another motion.",
            markup=False,
        )
    _finish(console, found.iterations[-1], axis, asked)


def _finish(console: Console, found: Iteration, axis: str, asked: Asked) -> None:
    """What to know, and the section to paste."""
    for name, reason in found.frozen.items():
        console.print(f"- {name} is frozen: {reason}.", markup=False)
    for name in found.held:
        console.print(f"- {name} is held by its bound.", markup=False)
    for remark in found.remarks:
        console.print(f"- {remark[:1].upper()}{remark[1:]}.", markup=False)
    if found.trial.saturated is None:
        console.print("- Whether the force was limited is not known: name its column with --force.", markup=False)
    if found.gamma > 0.5:
        console.print(
            "- This step trusts the gains of the controller; where they are known roughly, take --gamma 0.5.",
            markup=False,
        )
    replaced = [
        block.kind for block in _machine_feedforward(asked) if isinstance(block, (Inertia, DisturbanceCompensator))
    ]
    if replaced:
        console.print(f"- The section takes the place of {' and '.join(replaced)} in the machine file.", markup=False)
    key = f"axis.{axis}.control.feedforward"
    text = to_toml(found.after, key).replace(f"[{key}]", f"[[{key}]]", 1)
    console.print("")
    console.print(text, markup=False, soft_wrap=True)
    if asked.out is not None:
        write_whole(asked.out, text)
        console.print(f"Written: {asked.out}", markup=False, soft_wrap=True)


def _loop(asked: Asked) -> tuple[Loop, str]:
    """The loop with a compensator that has the columns, and the name of its axis."""
    machine = read_machine(asked.controller)
    loop = machine.loop(asked.axis)
    axis = loop.name
    has = any(isinstance(block, DisturbanceCompensator) for block in loop.control.feedforward)
    if has and asked.columns is None and asked.stribeck_velocity is None:
        return loop, axis
    columns = asked.columns
    if asked.stribeck_velocity is not None and columns is None:
        columns = ("mass", "viscous", "coulomb_positive", "coulomb_negative", "stribeck")
    return begin_compensation(loop, columns, stribeck_velocity=asked.stribeck_velocity), axis


def _machine_feedforward(asked: Asked) -> tuple[Feedforward, ...]:
    return read_machine(asked.controller).loop(asked.axis).control.feedforward


def _reference(job: str) -> Reference:
    reference = read_job(job).reference
    if reference is None:
        raise ParameterError(f"{job}: has no [reference], only a log: give the log itself, with --controller")
    return reference


def _trial(log: Path, loop: Loop, named: Mapping[str, str | None], smoothing: int | None) -> Trial:
    there = read_log(log).channels
    columns = {role: _column(str(log), role, named.get(role), there) for role in USUAL}
    measured = read_log(log, {role: column for role, column in columns.items() if column is not None})
    force = measured.channels.get("force")
    motor = loop.axis.actuator.motor
    if force is None and "command" in measured.channels and motor is not None:
        force = float(motor.force_per_unit()) * measured["command"]
    return measured_trial(
        loop, measured["setpoint_position"], measured["position_load"], sample_time=measured.sample_time, force=force,
        smoothing=smoothing, name=str(log),
    )  # fmt: skip


def _column(log: str, role: str, asked: str | None, there: Iterable[str]) -> Column | None:
    """The column of a role: the one that was named (`name` or `name:unit`), else one with a usual name."""
    if asked is not None:
        name, _, unit = asked.partition(":")
        return Column(name=name, unit=unit)
    for usual in USUAL[role]:
        for name in there:
            if name == usual or (name.startswith(f"{usual}_") and name.removeprefix(f"{usual}_") in _UNITS):
                return Column(name=name)
    if role not in _NEEDED:
        return None
    raise LogError(
        f"{log}: has no column that is named like its {role.replace('_', ' ')}{nearest(USUAL[role][0], there)}: "
        f"name it with {_NEEDED[role]}"
    )
