"""Learning from the log of the last part: the share of the friction, then what the correction left.

    θ = <e_f, e> / <e_f, e_f>     first log, without a correction: share of the model's friction that is there
    (B'B + λ r0 I) dc = B' q(w e) later logs: splines of the force that displace the table back by the error e
    force += g Σ dc_j N_j         g = 0.7, 0.7, 0.7², 0.7³ ... from part to part, and 0 in a rest

In a rest the friction along the plan holds nearly the whole breakaway ready: more force cannot move the stuck axis, it
can only break it loose before its start.  So what is learned fades there within 1 ms.

The model supplies only the inverse of the loop, so that a machine whose friction, mass or stiffness differ from the
model is corrected too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from feeddrive.blocks.reference.recorded import Recorded
from feeddrive.identification.regression import robust_covariance
from feeddrive.language.errors import LogError, ParameterError
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Cell, Column, Result, Table
from feeddrive.language.text import Text
from feeddrive.learning.loop_inverse import LoopInverse, loop_inverse
from feeddrive.learning.part_correction import (
    PLAN_KNOTS,
    PLAN_RIDGE,
    SHARE,
    Correction,
    PathFigures,
    PlannedPath,
    feeds_friction,
    friction_displacement,
    moving_axes,
    planned_velocity,
)
from feeddrive.learning.planned_friction import around_motion
from feeddrive.learning.trial import check_clock
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import Machine
from feeddrive.loop.simulate import simulate

# of the friction that a log shows: its standard error, and too much costs more than too little
SHARE_FOUND = 0.9
"""The share of a friction that was found in a log."""
_KNOTS, _RIDGE = 0.01, 0.01  # s, relative: with 2 ms the third pass grows on a machine that is softer and later
_GAIN = 0.7  # of the error of the last part, at first
_CALMER = 0.7  # of the gain before: what a start from rest leaves differs from part to part
_REST = 1e-3  # s around a motion in which a learned force fades: with 10 ms an axis breaks loose before its start
_SMOOTH = 1e-3  # s, of each of two moving averages of the error
_GATE = 1e-3  # m/s: below it an axis may stick, which no linear model describes
_OPEN = 3e-3  # m/s: from it on the whole error is learned
LEAST_SHARE, MOST_SHARE, SHARE_ERROR = 0.3, 1.6, 0.2
"""The range of friction shares that a model can explain, and the largest standard error of a share that is used.

The residual is correlated over each start and reversal: an axis that starts eight times has a standard error of 0.15 to
0.17, for which the bound leaves room.
"""
BETTER = 0.98
"""The factor by which the RMS of a part must fall below that of the part before: a pass that gains less is the last."""
_LATE = 2.0  # samples by which the error of a log may lag behind the plan beyond the model
_STUCK = 0.1  # of the planned way: an axis that moves less does not follow


@dataclass(frozen=True, eq=False)
class PartLog:
    """The log of one part, by axis.

    set_position  logged set positions, m, shape (n,)
    position      measured positions of the tables, m, shape (n,)
    force         commanded forces without the added one, N, shape (n,); empty if they were not logged
    tripped       True where a guard had tripped, shape (n,); empty if it was not logged
    sample_time   s
    """

    name: str
    set_position: Mapping[str, np.ndarray]
    position: Mapping[str, np.ndarray]
    sample_time: float
    force: Mapping[str, np.ndarray] = field(default_factory=dict[str, np.ndarray])
    tripped: Mapping[str, np.ndarray] = field(default_factory=dict[str, np.ndarray])


@dataclass(frozen=True, eq=False, repr=False)
class LearnedPart(Result):
    """What one log of a part taught.

    correction  correction to run with the next part
    figures     deviation from the path in this log
    history     RMS of all logs so far, m, this one last
    shares      share of the model's friction that was found, with its standard error, by axis
    error       deviation over time in this log, m, shape (n,)
    best        True if the correction of this log, or that before it, is kept: the last pass gained less than 2 %
    """

    correction: Correction
    figures: PathFigures
    history: tuple[float, ...]
    shares: Mapping[str, tuple[float, float]]
    error: np.ndarray
    best: bool
    remarks: tuple[str, ...] = ()

    def table(self) -> Table:
        """Return a table of the RMS of the deviation, part by part."""
        rows: list[list[Cell]] = [[f"log {i + 1}", rms, rms / self.history[0]] for i, rms in enumerate(self.history)]
        return Table(
            "Deviation from the path, part by part",
            ["part", Column("RMS", "m"), Column("of the first", form=".3f")],
            rows,
        )


def learn_from_log(
    machine: Machine,
    plan: Mapping[str, Recorded],
    log: PartLog,
    *,
    last: Correction | None = None,
    before: Correction | None = None,
    history: Sequence[float] = (),
    counted: np.ndarray | None = None,
) -> LearnedPart:
    """Return the correction for the next part, from the log of the last one.

    machine  model of the machine with the control that ran the part
    plan     planned motion by axis
    last     correction that ran with the logged part; None for a part without one
    before   correction that ran with the part before it
    history  RMS of the logs before this one, m
    counted  True for the samples that count, shape (n,)

    Raises LogError, with the reason and what to do, for a log of another program, start or sample time, with missing
    or saturated samples, or of an axis that did not follow, and for a friction that is not what the model says.
    """
    axes = moving_axes(machine, plan)
    n = plan[axes[0]].position.size
    log = _without_rest(log, machine, plan, axes)
    mask = np.ones(n, bool) if counted is None else np.asarray(counted, bool)
    errors = {axis: _error(log, axis, machine.loop(axis), plan[axis], mask) for axis in axes}
    positions = {axis: plan[axis].position - error for axis, error in errors.items()}
    figures, size = PlannedPath(plan, axes, mask).deviation(positions)
    past = (*history, figures.rms)
    if len(past) > 1 and past[-1] > BETTER * past[-2]:
        kept = last if past[-1] <= past[-2] else before
        none = Correction(plan, {axis: np.zeros(n) for axis in axes})
        return LearnedPart(kept or none, figures, past, {}, size, True)
    shares: dict[str, tuple[float, float]] = {}
    forces = {} if last is None else dict(last.forces)
    remarks: list[str] = []
    passes = 0 if last is None else last.passes
    T = float(plan[axes[0]].sample_time)
    for axis in axes:
        loop = machine.loop(axis)
        if last is None and not feeds_friction(loop):
            displaced, inverse = friction_displacement(loop, plan[axis])
            _same_start(log, axis, inverse, plan[axis], errors[axis])
            share, remark = _share(log, axis, loop, plan[axis], displaced, errors[axis])
            if share is not None:
                shares[axis] = share
            remarks += remark
            part = SHARE if share is None else SHARE_FOUND * share[0]
            forces[axis] = part * inverse.force_for(displaced, PLAN_KNOTS, PLAN_RIDGE)
            continue
        inverse = loop_inverse(loop)
        _same_start(log, axis, inverse, plan[axis], errors[axis])
        gain = _GAIN * _CALMER ** max(0, passes - 1)
        learned = gain * inverse.force_for(_learnable(plan[axis], errors[axis]), _KNOTS, _RIDGE)
        if not feeds_friction(loop):
            # the force along the plan is complete at the start: more of it would break the axis loose before
            learned *= around_motion(planned_velocity(plan[axis]), T, _REST)
        forces[axis] = forces.get(axis, np.zeros(n)) + learned
    correction = Correction(
        plan,
        forces,
        shares={axis: SHARE_FOUND * share for axis, (share, _) in shares.items()},
        passes=passes + 1,
    )
    _within_limits(log, machine, correction)
    return LearnedPart(correction, figures, past, shares, size, False, tuple(remarks))


@dataclass(frozen=True, eq=False, repr=False)
class PartTrials(Result):
    """Simulated parts, each with the correction that its predecessor's log taught.

    figures     deviation from the path of each part
    correction  correction of the best part
    machine     machine that made them
    remarks     what a user must know
    """

    figures: tuple[PathFigures, ...]
    correction: Correction
    machine: Machine
    remarks: tuple[str, ...] = ()

    def table(self) -> Table:
        """Return a table of the deviation from the path, part by part."""
        rows: list[list[Cell]] = [[i + 1, *figures] for i, figures in enumerate(self.figures)]
        columns = ["part", Column("RMS", "m"), Column("95 %", "m"), Column("largest", "m")]
        return Table("Deviation from the path, part by part, with the force offsets of the last", columns, rows)


def iterate_parts(
    machine: Machine,
    plan: Mapping[str, Recorded],
    parts: int = 4,
    *,
    counted: np.ndarray | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> PartTrials:
    """Simulate parts, each with the correction that `learn_from_log` finds in the log of the one before.

    parts  largest number of parts; fewer if a part gains less than 2 %

    Raises ParameterError for fewer than two parts, and the errors of `learn_from_log` and `simulate`.
    """
    if parts < 2:
        raise ParameterError(f"parts = {parts} must be >= 2: the first shows the error, the second what was learned")
    axes = moving_axes(machine, plan)
    signals = ("set_position", "reading_load", "position_load", "force")
    record = [f"{axis}.{signal}" for axis in axes for signal in signals]
    n = plan[axes[0]].position.size
    mask = np.ones(n, bool) if counted is None else np.asarray(counted, bool)
    planned = PlannedPath(plan, axes, mask)
    last: Correction | None = None
    before: Correction | None = None
    history: tuple[float, ...] = ()
    figures: list[PathFigures] = []
    remarks: dict[str, None] = {}
    for part in range(parts):
        if progress is not None:
            progress.step("parts", part + 1, parts)
        added = None if last is None else last.added
        run = simulate(machine, plan, added_force=added, seed=seed + part, record=record, name=f"part {part + 1}")
        by = {signal: {axis: run[f"{axis}.{signal}"] for axis in axes} for signal in signals}
        log = PartLog(run.name, by["set_position"], by["reading_load"], run.sample_time, by["force"])
        figures.append(planned.deviation(by["position_load"])[0])
        learned = learn_from_log(machine, plan, log, last=last, before=before, history=history, counted=counted)
        remarks |= dict.fromkeys(learned.remarks)
        history = learned.history
        if learned.best:
            last = learned.correction
            break
        # the correction of the last part is shown by no part any more
        if part < parts - 1:
            before, last = last, learned.correction
    none = Correction(plan, {axis: np.zeros(n) for axis in axes})
    return PartTrials(tuple(figures), last or none, machine, tuple(remarks))


def _without_rest(log: PartLog, machine: Machine, plan: Mapping[str, Recorded], axes: Sequence[str]) -> PartLog:
    """Return a log without the rows behind the plan, if no set position moves by a count in them.

    Exported setpoints end with a rest in which the forces fall to 0, and a control logs it with the part.
    """
    n = plan[axes[0]].position.size
    for axis in axes:
        behind = log.set_position[axis][n:] - plan[axis].position[-1]
        if not np.all(np.abs(behind) <= _count(machine.loop(axis))):
            return log

    def cut(rows: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        return {axis: row[:n] for axis, row in rows.items()}

    return replace(
        log,
        set_position=cut(log.set_position),
        position=cut(log.position),
        force=cut(log.force),
        tripped=cut(log.tripped),
    )


def _learnable(path: Recorded, error: np.ndarray) -> np.ndarray:
    """Return the part of an error that a force may cancel: where the axis moves, averaged twice over 1 ms."""
    speed = np.abs(planned_velocity(path))
    gated = np.clip((speed - _GATE) / (_OPEN - _GATE), 0.0, 1.0) * error
    width = max(1, round(_SMOOTH / float(path.sample_time)))
    width += 1 - width % 2  # an odd number of samples has no phase
    box = np.full(width, 1.0 / width)
    return np.convolve(gated, np.convolve(box, box), mode="same")


def _count(loop: Loop) -> float:
    """Return a count of the encoder of the position loop, m; 1 nm of one without counts."""
    encoder = loop.axis.encoder_load or loop.axis.encoder_motor
    return float(getattr(encoder, "resolution", None) or 1e-9)


def _error(log: PartLog, axis: str, loop: Loop, path: Recorded, counted: np.ndarray) -> np.ndarray:
    """Return planned minus measured position, m. Raise LogError if the log does not belong to the plan."""
    T = float(path.sample_time)
    check_clock(log.name, log.sample_time, T)
    n = path.position.size
    measured, setpoint = log.position[axis], log.set_position[axis]
    for what, row in (("position", measured), ("set position", setpoint)):
        if abs(row.size - n) > 1:
            raise LogError(
                f"{log.name}: axis {axis}: has {row.size} samples of the {what}, the plan {n}: "
                + (
                    "cut the log to the program, from its first sample to its last"
                    if row.size > n
                    else "log the part again, to its last sample"
                )
            )
        if not np.all(np.isfinite(row)):
            raise LogError(
                f"{log.name}: axis {axis}: the {what} is not a number in row {int(np.argmin(np.isfinite(row)))}: "
                "samples are missing; log the part again"
            )
    # a log may hold one sample less than the plan: the last one, at rest
    measured, setpoint = (np.append(row, np.full(max(0, n - row.size), row[-1]))[:n] for row in (measured, setpoint))
    resolution = _count(loop)
    off = np.abs(setpoint - path.position)
    if float(np.max(off)) > resolution:
        k = int(np.argmax(off))
        raise LogError(
            f"{log.name}: axis {axis}: the set position differs from the plan by {Quantity(float(off[k]), 'm')} at "
            f"{Quantity(k * T, 's'):6 SI}, more than a count of {Quantity(resolution, 'm')}: the log is of another "
            "program or starts elsewhere; log the planned part from its first sample on"
        )
    trip = log.tripped.get(axis, np.zeros(0))
    if trip.size and np.any(trip):
        raise LogError(
            f"{log.name}: axis {axis}: the guard tripped at {Quantity(int(np.argmax(trip)) * T, 's'):6 SI}, and the "
            "axis did not follow after that: find the cause, and log the part again"
        )
    moves = np.abs(planned_velocity(path)) > _GATE
    way, wanted = (float(np.sum(np.abs(np.diff(row))[moves[:-1]])) for row in (_calm(measured, T), path.position))
    if np.any(moves) and way < _STUCK * wanted:
        raise LogError(
            f"{log.name}: axis {axis}: moves {Quantity(way, 'm')} where the plan moves {Quantity(wanted, 'm')}: the "
            "axis is stuck or switched off, or the column is not its position; free it and log the part again, or name "
            "its column by --position"
        )
    limit, force = loop.control.force_limit, log.force.get(axis)
    if force is not None and limit is not None:
        held = np.flatnonzero((np.abs(force[:n]) >= (1.0 - 1e-6) * limit) & counted[: force.size])
        if held.size:
            raise LogError(
                f"{log.name}: axis {axis}: the force is at its limit of {Quantity(limit, 'N'):4} in {held.size} "
                f"samples that count, first at {Quantity(int(held[0]) * T, 's'):6 SI}: what is lost there is no error "
                "of the path; plan with less acceleration"
            )
    return path.position - measured


def _calm(position: np.ndarray, T: float) -> np.ndarray:
    """Return positions averaged over 10 ms, so that the noise of a resting encoder makes no way."""
    width = max(1, round(0.01 / T))
    padded = np.concatenate([np.full(width, position[0]), position, np.full(width, position[-1])])
    return np.convolve(padded, np.full(width, 1.0 / width), mode="same")[width:-width]


def _same_start(log: PartLog, axis: str, inverse: LoopInverse, path: Recorded, error: np.ndarray) -> None:
    """Raise LogError if the error lags behind the plan by two samples more, or less, than the model of the loop does.

    A shift by τ adds τ v to the error: it is the coefficient of the planned velocity in the error beyond the model's.
    """
    velocity = planned_velocity(path)
    beyond = error - inverse.following_error(path)
    late = float(velocity @ beyond / (velocity @ velocity)) / float(path.sample_time)
    if abs(late) > _LATE:
        raise LogError(
            f"{log.name}: axis {axis}: the positions are {Quantity(abs(late)):2} samples "
            f"{'later' if late > 0.0 else 'earlier'} than the model of the loop lets them be, at most "
            f"{Quantity(_LATE):2} are admitted: the log starts at another sample, its columns are not logged at one "
            "instant, or another control was running"
        )


def _share(
    log: PartLog, axis: str, loop: Loop, path: Recorded, displaced: np.ndarray, error: np.ndarray
) -> tuple[tuple[float, float] | None, list[str]]:
    """Return the share of the model's friction in the error with its standard error, or None, and remarks."""
    if loop.axis.friction_load is not None and loop.axis.friction_motor is not None:
        raise LogError(
            f"{log.name}: axis {axis}: the model has friction on motor and load, and the error of the table shows "
            "their "
            "sum only: give the machine file one of them, or correct by the plan alone, without --from-log"
        )
    velocity = planned_velocity(path)
    moves = np.abs(velocity) > _GATE
    sign = np.sign(velocity[moves])
    if not np.any(displaced):
        return None, [f"Axis {axis} has no dry friction in the machine file: its first correction is 0."]
    if not np.any(sign[1:] * sign[:-1] < 0.0):
        remark = (
            f"Axis {axis} never reverses: no share of friction can be told, and {Quantity(SHARE, 'share'):3} of the "
        )
        return None, [Text(remark + "model's is fed forward.")]
    column, left = displaced[moves], error[moves]
    share = float(column @ left / (column @ column))
    error_of_share = float(np.sqrt(robust_covariance(column[:, None], left - share * column)[0, 0]))
    found = f"{Quantity(share, 'share'):3} ± {Quantity(error_of_share, 'share'):2} of the model's friction"
    if not LEAST_SHARE <= share <= MOST_SHARE:
        raise LogError(
            f"{log.name}: axis {axis}: the error shows {found}; {Quantity(LEAST_SHARE, 'share'):3} to "
            f"{Quantity(MOST_SHARE, 'share'):3} are admitted: friction of this axis is not what the model says; "
            "identify "
            "it again (feeddrive friction, identify)"
        )
    if error_of_share > SHARE_ERROR:
        return None, [
            Text(
                f"Axis {axis}: the error shows {found}, with a standard error of more than "
                f"{Quantity(SHARE_ERROR, 'share'):3}, as the axis starts and reverses too seldom: "
                f"{Quantity(SHARE, 'share'):3} of the model's is fed forward."
            )
        ]
    return (share, error_of_share), []


def _within_limits(log: PartLog, machine: Machine, correction: Correction) -> None:
    """Raise LogError if logged and added force together exceed the limit of force or current of an axis."""
    T = correction.sample_time
    for axis, added in correction.forces.items():
        if axis not in log.force:
            continue
        loop = machine.loop(axis)
        peak = None if loop.axis.actuator.motor is None else loop.axis.actuator.motor.limits()[0]
        n = min(added.size, log.force[axis].size)
        total = np.abs(log.force[axis][:n] + added[:n])
        for what, limit in (("force_limit", loop.control.force_limit), ("peak current", peak)):
            if limit is not None and np.any(total > limit):
                k = int(np.argmax(total > limit))
                raise LogError(
                    f"{log.name}: axis {axis}: logged force and correction together are "
                    f"{Quantity(float(total[k]), 'N'):4} "
                    f"at {Quantity(k * T, 's'):6 SI}, beyond the {what} of {Quantity(float(limit), 'N'):4}: plan with "
                    "less "
                    "acceleration"
                )
