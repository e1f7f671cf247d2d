"""`feeddrive friction`: a friction curve from logs at constant velocity, its report, and the machine file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from feeddrive.blocks.families import Friction
from feeddrive.blocks.force.gravity import Gravity
from feeddrive.files.drive import Drive
from feeddrive.files.log import Log
from feeddrive.files.machine import MachineFile
from feeddrive.files.origins import with_origins
from feeddrive.files.read_log import OpenedFile
from feeddrive.files.section import to_toml
from feeddrive.files.toml_file import TomlEdit
from feeddrive.identification import friction_curve
from feeddrive.identification.friction_curve import Compared, FrictionCurve, SteadyRuns
from feeddrive.identification.motion.identify import own_viscous
from feeddrive.identification.regression import LEAST_PULL, SHAFT, SIGNIFICANT
from feeddrive.language.block import declarations
from feeddrive.language.errors import NotIdentifiableError, sentence
from feeddrive.language.judgment import Advice, Judgment
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity, number, unit_name
from feeddrive.language.table import Table
from feeddrive.language.text import Text
from feeddrive.loop.axis import Axis
from feeddrive.loop.loop import Loop
from feeddrive.report.report import Picture, Remarks, Report, Section, Verdict, facts, further
from feeddrive.workflow import drive_logs
from feeddrive.workflow.channels import units_first
from feeddrive.workflow.command import Outcome, argument, called, command, line, option
from feeddrive.workflow.drive_logs import DriveLogsRequest

_POOR = 0.15  # residual over the force's RMS beyond which a curve is rejected
_SLOW = 2  # runs per direction below the Stribeck velocity that are needed to identify the breakaway level
_AT_END = 0.9  # of the largest speed: a Stribeck velocity beyond it is at the end of the search range
_OPEN = 0.5  # standard error over value beyond which a parameter counts as undetermined


class FrictionRequest(DriveLogsRequest):
    """The logs at constant velocity, and the columns of the motion."""

    logs: tuple[Path, ...] = argument("Logs of constant speeds; one log may hold several")
    velocity: str | None = option("column along the table: name:unit or name*factor:unit", default=None)
    position: str | None = option("the position instead, to be differenced", default=None)
    speed: str | None = option("column of the motor's speed, as n:rpm", default=None)
    angle: str | None = option("the motor's angle instead, to be differenced", default=None)

    def usual_out(self) -> Path:
        return Path("results") / f"friction_{drive_logs.logs_stem(self.logs)}"

    def named(self) -> dict[str, str | None]:
        """Return the column options by role; None for an omitted option."""
        return {
            "velocity_load": self.velocity,
            "position_load": self.position,
            "speed_motor": self.speed,
            "angle_motor": self.angle,
            **self.forces(),
        }


@command(FrictionRequest)
def friction(request: FrictionRequest, progress: Progress) -> Outcome[FrictionCurve]:
    """Identify a friction curve from runs at constant velocity: select a model by evidence, estimate its parameters.

    Raises LogError for an unusable log, NotIdentifiableError for logs without a section of constant velocity.
    """
    drive, named = drive_logs.drive_of(request), request.named()
    opened = [OpenedFile(path) for path in request.logs]
    wanted = ("time", *drive_logs.MOTIONS, *drive_logs.FORCES)
    read, mapping, doubts = drive_logs.read_logs(opened, named, request, wanted, request.sample_time, progress)
    progress.step("fitting")
    runs, without = _runs(opened, read, named, drive)
    curve = friction_curve.fit_friction(runs)
    noted = [*doubts, *remarks(curve, drive.loop), *without]
    judged_by = units_first(doubts) or advice(curve)
    judgment, verdict = judged_by
    compared, parameters = tables(curve)
    why = kept_away(curve, drive.loop)
    text = None if why else machine_text(curve, drive.machine, drive.axis)
    # without a machine file the text is a section to be pasted
    text = text if text is None or drive.machine is None else with_origins(text, (*request.logs, drive.machine))
    files: dict[str, Path] = {}
    known = {
        "Logs": drive_logs.log_names(request.logs),
        "Runs": f"{runs.velocity.size} of {int(np.min(runs.rows))} to {int(np.max(runs.rows))} rows",
        "Columns": drive_logs.column_texts(mapping),
        "Lead": "none given"
        if drive.lead is None
        else Text(f"{Quantity(drive.lead, 'm'):6 mm}, gear {number(drive.gear, 6)}"),
        "Machine": called(request.machine),
    }
    page = partial(friction_report, curve, noted, known, judged_by)
    if request.out is not None:
        progress.step("report")
        files = drive_logs.written(drive_logs.write_report(page(), text, request.out), text)
    return Outcome(
        curve,
        [replace(compared, sentences=0), drive_logs.narrow(parameters)],
        [sentence(text) for text in noted],
        verdict,
        [f"No machine file was written: {why}."] if why else [],
        files=files,
        judgment=judgment,
        page=page,
        then=line("tune", files["Machine"], axis=request.axis) if "Machine" in files and not judgment.bad else "",
    )


def _runs(
    paths: Sequence[OpenedFile], logs: Sequence[Log], named: Mapping[str, str | None], drive: Drive
) -> tuple[SteadyRuns, list[str]]:
    """Return the runs at constant velocity in all logs, and remarks on logs that contain none."""
    steady: list[SteadyRuns] = []
    without: list[str] = []
    for path, log in zip(paths, logs, strict=True):
        velocity, force, rotary = drive_logs.velocity_and_force(path, log, named, drive)
        try:
            steady.append(friction_curve.steady_runs([(velocity, force)], rotary=rotary, names=[path.path.name]))
        except NotIdentifiableError:
            # one log without a constant speed, such as a run-up, must not discard the others
            without.append(
                f"{path.path.name} holds no constant speed for {friction_curve.LEAST_ROWS} rows and is left out"
            )
    if not steady:
        raise NotIdentifiableError(
            f"{paths[0]}: no constant speed is held for {friction_curve.LEAST_ROWS} rows"
            + (f", nor in the {len(paths) - 1} other logs" if len(paths) > 1 else "")
            + "; record next runs at a constant speed, some seconds each"
        )
    joined = (
        np.concatenate([getattr(part, name) for part in steady]) for name in ("velocity", "force", "error", "rows")
    )
    # all logs are in one frame, since they were read with the same roles
    runs = SteadyRuns(
        *joined, frame=steady[0].frame, remarks=tuple(remark for part in steady for remark in part.remarks)
    )
    return (runs.at_table(drive.lead, drive.gear) if drive.lead is not None else runs), without


def friction_report(
    curve: FrictionCurve,
    texts: Sequence[str] | None = None,
    known: Mapping[str, str] | None = None,
    verdict: Advice | None = None,
) -> Report:
    """Return the report of a friction curve with remarks (`texts`) and facts about the logs (`known`)."""
    first, *others = _pictures(curve)
    judgment, told = verdict or advice(curve)
    noted = remarks(curve, None) if texts is None else texts
    return Report(
        f"A friction curve from {curve.runs.velocity.size} constant-speed runs",
        "feeddrive friction",
        Verdict((told,), good=not judgment.bad),
        (
            Section("result", "Result", (*tables(curve), Remarks(map(sentence, noted)))),
            further(others),
            facts("The logs", known or {}),
            Section("runs", "All runs", (curve.runs.table(),), folded=True),
        ),
        first,
    )


def tables(curve: FrictionCurve) -> list[Table]:
    """Tabulate the models, best first, and the parameters of the selected model."""
    comparison = curve.comparison()
    rows = [[f"{row[0]} (taken)" if row[0] == curve.model.name else row[0], *row[1:]] for row in comparison.rows]
    return [Table(comparison.title, comparison.columns, rows), curve.table()]


def remarks(curve: FrictionCurve, loop: Loop | None) -> list[str]:
    """Return remarks on the curve and on its effect on the machine file."""
    texts = list(curve.remarks)
    for name, value in curve.values.items():
        if name.startswith("viscous") and value < 0.0:
            texts.append(f"{name} is negative and counts as 0 in a block: friction falls up to the fastest run")
    axis = None if loop is None or curve.frame is SHAFT else loop.axis
    if curve.model.offset and not curve.is_pulled and (axis is None or _weight(axis) is None):
        pull = curve["offset"]
        texts.append(
            Text(
                f"the offset of {Quantity(pull.value, pull.unit, pull.error)} becomes no constant force: that takes "
                f"more than {number(SIGNIFICANT)} of its errors and {Quantity(LEAST_PULL, 'share'):6} of Coulomb "
                "friction"
            )
        )
    if axis is None:
        return texts
    # the dampers of the plant and the friction block add up, so the block gets only the remainder
    own = own_viscous(axis)
    least = min(value for name, value in curve.values.items() if name.startswith("viscous"))
    if least < own:
        texts.append(
            Text(
                f"the runs show {Quantity(least, 'N s/m')} of viscous friction, less than the {Quantity(own, 'N s/m')} "
                "that the plant has of its own: the block has none, and the plant's must be lowered by hand"
            )
        )
    elif own > 0.0:
        texts.append(
            Text(f"the plant has {Quantity(own, 'N s/m')} of its own, which is taken off the viscous friction")
        )
    weight = _weight(axis)
    if weight is not None and not curve.model.offset:
        texts.append(
            Text(
                f"the machine has a constant force of {Quantity(float(weight.force), 'N')}, and the runs show none: it "
                "stays"
            )
        )
    return texts


def kept_away(curve: FrictionCurve, loop: Loop | None) -> str:
    """Return the reason for not writing the curve to a machine file, or an empty string if it may be written."""
    if curve.frame is SHAFT:
        return "the curve is that of a shaft; give --lead and --gear to put it at the table"
    if _share(curve) > _POOR:
        return Text(f"the curve leaves {Quantity(_share(curve), 'share'):3} of the force")
    missing, _ = _missing(curve)
    if missing:
        return missing
    if loop is not None and loop.axis.friction_motor is not None and loop.axis.friction_load is not None:
        return "friction acts on both bodies of the axis, and constant speeds tell their sum only: both stay"
    return ""


def advice(curve: FrictionCurve) -> Advice:
    """Return the judgment on the curve and one sentence: the reason, or the measurement to do next."""
    share = _share(curve)
    if share > _POOR:
        return Judgment.DO_NOT_USE_CURVE.because(
            f"the best model, {curve.model.name}, leaves {Quantity(share, 'share'):3} of the force, so it is no "
            "function of the velocity; warm the axis up, let each speed settle, and measure again"
        )
    missing, parameter = _missing(curve)
    if missing:
        open_ = Judgment.CURVE_IS_OPEN
        speeds = f"{_next(curve, parameter)} in both directions"
        told = Text(f"{open_.says} ({curve.model.name}): {missing}; record next runs at {speeds}.")
        return Advice(open_, told)
    kind = "this curve" if curve.frame is SHAFT else f"the block '{curve.block().kind}'"
    take, left = Judgment.TAKE_CURVE, f"it leaves {Quantity(share, 'share'):2} of the force"
    return Advice(take, Text(f"{take.says} {kind} ({curve.model.name}): {left}, and {_against(curve)}."))


def machine_text(curve: FrictionCurve, machine: MachineFile | None, axis: str) -> str:
    """Return the text of the machine file with the friction added (comments are kept).

    Without a machine file, only the sections to be pasted are returned.
    """
    # a new constant force must be significant; one that the file already has is updated in any case
    gravity = curve.gravity() if curve.is_pulled or (machine and _weight(machine.loop(axis).axis)) else None
    if machine is None:
        place = "friction_load"
        parts = [to_toml(curve.block(), f"axis.{axis}.{place}")]
        if gravity is not None:
            parts.append(_force(gravity, axis))
        head = "# friction of an axis, from runs of constant speed; add plant, control, limits and encoders\n\n"
        edit = TomlEdit(head + "\n".join(parts), "friction.toml")
        own = 0.0
    else:
        edit = TomlEdit(machine.file.text, machine.file.name)
        before = machine.loop(axis).axis
        place, own = _place(before), own_viscous(before)
        _friction(edit, ("axis", axis, place), getattr(before, place), _without(curve.block(), own))
        if gravity is not None:
            _gravity(edit, axis, before, gravity)
    block = _without(curve.block(), own)
    for estimate in curve.estimates:
        # the offset is no parameter of the friction block: it is written as the constant force below
        if estimate.name == "offset":
            continue
        key = edit.set(("axis", axis, place, estimate.name), float(getattr(block, estimate.name)), estimate.unit)
        edit.comment(key, f"standard error {Quantity(estimate.error, estimate.unit):2 SI}")
    if gravity is not None:
        index = 0 if machine is None else _index(machine.loop(axis).axis)
        key = edit.set(("axis", axis, "forces", index, "force"), float(gravity.force), "N")
        edit.comment(key, Text(f"standard error {Quantity(curve['offset'].error, 'N'):2}"))
    return edit.text


def _place(axis: Axis) -> str:
    """Return the key of the axis's friction section."""
    return "friction_motor" if axis.friction_load is None and axis.friction_motor is not None else "friction_load"


def _friction(edit: TomlEdit, key: tuple[str | int, ...], before: Friction | None, after: Friction) -> None:
    """Write a friction block: edit the values of a block of the same kind in place, and replace any other section."""
    # another exponent of the Stribeck curve is another law, in which the old parameters mean something else
    same = type(before) is type(after) and getattr(before, "exponent", 0) == getattr(after, "exponent", 0)
    if not same:
        edit.replace(key, to_toml(after, ".".join(map(str, key))))
        return
    for name, declared in declarations(type(after)).items():
        value: Any = getattr(after, name)
        if declared.role == "parameter" and value is not None and value != getattr(before, name):
            edit.set((*key, name), float(value), declared.unit)


def _gravity(edit: TomlEdit, axis: str, before: Axis, gravity: Gravity) -> None:
    index = _index(before)
    if index < len(before.forces):
        edit.set(("axis", axis, "forces", index, "force"), float(gravity.force), "N")
    else:
        edit.add(_force(gravity, axis))


def _weight(axis: Axis) -> Gravity | None:
    """Return the constant force of an axis; None if it has none."""
    return next((force for force in axis.forces if isinstance(force, Gravity)), None)


def _index(axis: Axis) -> int:
    """Return the index of the constant force in the list of forces, or that of a new entry."""
    return next((i for i, force in enumerate(axis.forces) if isinstance(force, Gravity)), len(axis.forces))


def _force(gravity: Gravity, axis: str) -> str:
    return to_toml(gravity, f"axis.{axis}.forces", listed=True)


def _without(friction: Friction, viscous: float) -> Friction:
    """Return the friction without the viscous part that the dampers of the plant already model."""
    changes = {
        # a block accepts no negative viscous friction
        parameter.name: max(0.0, float(getattr(friction, parameter.name)) - viscous)
        for parameter in fields(friction)
        if parameter.name.startswith("viscous")
    }
    return replace(friction, **changes)


def _share(curve: FrictionCurve) -> float:
    """Return the RMS of the residual relative to that of the force."""
    # the floor avoids 0/0 for a force of 0 throughout
    return float(np.sqrt(np.mean(curve.residual**2) / max(float(np.mean(curve.runs.force**2)), 1e-300)))


def _against(curve: FrictionCurve) -> str:
    """Return the reason why this model is preferred to the second best one."""
    own = next(model for model in curve.compared if model.name == curve.model.name)
    # "two curves, ...", one for each direction, is only a check: no block can represent it
    others: list[Compared] = [
        model for model in curve.compared if model is not own and not model.name.startswith("two ")
    ]
    if not others:
        return "no other model could be fitted"
    best = others[0]
    if best.criterion < own.criterion:
        return f"it is the simplest of those that the runs cannot tell apart ({best.name} is no better than by 2)"
    gap = best.criterion - own.criterion
    # a difference of 6 is strong evidence (Kass & Raftery 1995)
    strength = "clearly " if gap > 6.0 else ""
    return Text(f"the runs speak {strength}against the next one, {best.name} (criterion worse by {Quantity(gap):.1f})")


def _missing(curve: FrictionCurve) -> tuple[str, str]:
    """Return why the runs do not determine a parameter, and its name; both are empty if all are determined."""
    unknown = [
        estimate
        for estimate in curve.estimates
        if not estimate.name.startswith(("viscous", "offset")) and estimate.error > _OPEN * estimate.value
    ]
    if unknown:
        worst = max(unknown, key=lambda estimate: estimate.error / max(estimate.value, 1e-300))
        return (
            Text(f"{worst.name} is known to {Quantity(worst.error / max(worst.value, 1e-300), 'share'):2} only"),
            worst.name,
        )
    vs = curve.values.get("stribeck_velocity")
    if vs is None:
        return "", ""
    stribeck = Quantity(vs, curve.frame.velocity, form="2 SI")
    v = curve.runs.velocity
    slow = min(int(np.sum((sign * v > 0.0) & (sign * v < vs))) for sign in (1.0, -1.0))
    if vs > _AT_END * float(np.max(np.abs(v))):
        return Text(f"the Stribeck velocity came out at the fastest run, {stribeck}"), "coulomb"
    if slow >= _SLOW:
        return "", ""
    return (
        Text(
            f"fewer than {_SLOW} runs in a direction are slower than the Stribeck velocity, {stribeck}, so shape and "
            "breakaway level are a guess"
        ),
        "stribeck_velocity",
    )


def _next(curve: FrictionCurve, name: str) -> str:
    """Return the velocities for a further run that would identify a parameter, as text with unit."""
    unit = curve.frame.velocity
    top = float(np.max(np.abs(curve.runs.velocity)))
    slow = float(np.min(np.abs(curve.runs.velocity)))
    vs = curve.values.get("stribeck_velocity", slow)
    # coulomb is the level at speed, breakaway that at standstill, and the shape lies around the Stribeck velocity
    if name.startswith("coulomb"):
        speeds = [0.5 * top, 0.75 * top, top]
    elif name.startswith("breakaway"):
        speeds = [0.1 * min(vs, slow), 0.3 * min(vs, slow), min(vs, slow)]
    else:
        speeds = [0.1 * vs, 0.25 * vs, 0.5 * vs, vs]
    return Text(f"{', '.join(number(speed, 2) for speed in speeds)} {unit_name(unit, 'SI')}")


def _pictures(curve: FrictionCurve) -> Iterator[Picture]:
    yield Picture(
        "curve",
        "Friction over velocity",
        "Points: the mean force of each run with twice its standard error. Line: the model that is taken, in the band "
        "that holds it with 95 % if the model is right. Below: what it leaves of each run; waves over several speeds "
        "say that the shape is not quite right, and the errors count that.",
        Text(
            f"Measured and fitted friction over velocity; the residual is {Quantity(_share(curve), 'share'):2} of the "
            "force."
        ),
        curve.chart,
    )
