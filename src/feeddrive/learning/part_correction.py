"""Corrections of a part program for all axes: by the planned motion, and from the log of the last part.

    e_f = g_L * f                friction f along the plan displaces the load by -e_f (`friction_along`, `LoopInverse`)
    (B'B + λ r0 I) c = B' e_f    splines of the force whose responses B displace it back
    force += share Σ c_j N_j     added to the command of the drive; the loop stays as it is

Dry friction is the largest repeatable force that no linear feedforward contains, and it is known before the part runs.
A force along the *planned* motion has no sign that chatters with the reading, and the exact inverse of the loop has no
lead time to be tuned.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from feeddrive.analysis.stability import require_stable, stability
from feeddrive.blocks.coupling.milling_cut import MillingCut
from feeddrive.blocks.families import Friction, Load, Reference
from feeddrive.blocks.load.recorded_force import RecordedForce
from feeddrive.blocks.reference.recorded import Recorded
from feeddrive.language import tree
from feeddrive.language.block import Block
from feeddrive.language.errors import FeeddriveError, NoSlopeError, NotPlannedError, ParameterError
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity, number
from feeddrive.language.table import Cell, Column, Result, Table
from feeddrive.language.text import Text
from feeddrive.learning.loop_inverse import LoopInverse, loop_inverse
from feeddrive.learning.planned_friction import friction_along, remembers
from feeddrive.learning.plant_box import NOMINAL, PlantBox, noisy_machines
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import Machine
from feeddrive.loop.simulate import Run, samples, stream_each
from feeddrive.machining.contour import ContourError, contour_error, curve_of_motion
from feeddrive.path.changed_path import changed_use, keeps
from feeddrive.path.proof import DERIVATIVES

# Friction of q = 1.3 or p = 0.7 times the model leaves least in the worst case with 2 p q/(p + q)
SHARE = 0.91
"""The share of the model's friction that is fed forward."""
# s, relative: a reversal takes a few ms; with a ridge of 1e-3 a softer machine with a later drive gets larger peaks
PLAN_KNOTS, PLAN_RIDGE = 1e-3, 3e-3
"""The spacing of the knots, s, and the ridge of the friction force along the plan."""
# s, relative: shorter knots need several times the jerk and snap of the plan
PATH_KNOTS, PATH_RIDGE = 0.02, 0.01
"""The spacing of the knots, s, and the ridge of a change of the set path."""
# knots of 20 ms are too coarse for a reversal: more of it rings on machines with less friction
PATH_SHARE = 0.7
"""The share of the model's friction that a change of the set path cancels."""
RESERVE = (0.005, 0.005, 0.05, 0.025)
"""The shares of velocity, acceleration, jerk and snap that a plan keeps back for a change of its path."""
_WORSE = 1.02  # of the figure without correction
_FRACTIONS = (1.0, 0.75, 0.5, 0.25)
_RECORDED = ("position_load", "force", "trip")


class PathFigures(NamedTuple):
    """The deviation from the path on the samples that count, m: RMS, what 95 % of them keep, and the largest."""

    rms: float
    within: float
    largest: float


class PlantFigures(NamedTuple):
    """The figures of one machine without and with the correction."""

    name: str
    plain: PathFigures
    corrected: PathFigures

    @property
    def ratios(self) -> PathFigures:
        """Corrected over plain, figure by figure."""
        pairs = zip(self.corrected, self.plain, strict=True)
        return PathFigures(*(after / before if before > 0.0 else np.inf for after, before in pairs))

    @property
    def worst(self) -> tuple[str, float]:
        """The figure that the correction improves least, and its ratio."""
        names = ("the RMS deviation", "the deviation of 95 %", "the largest deviation")
        ratios = self.ratios
        worst = int(np.argmax(ratios))
        return names[worst], ratios[worst]


@dataclass(frozen=True, eq=False)
class Correction:
    """A correction of the motion of several axes.

    plan    planned motion by axis
    forces  force added to the command of the drive, N, by axis, sample by sample; after the last row it is 0
    paths   change of the set path with its derivatives, m .. m/s⁴, shape (5, n), by axis; empty without one
    shares  share of the model's friction that is fed forward, by axis
    passes  number of logs from which the correction was learned
    """

    plan: Mapping[str, Recorded]
    forces: Mapping[str, np.ndarray]
    paths: Mapping[str, np.ndarray] = field(default_factory=dict[str, np.ndarray])
    shares: Mapping[str, float] = field(default_factory=dict[str, float])
    passes: int = 0

    @property
    def sample_time(self) -> float:
        """The sample time of the rows, s."""
        return float(next(iter(self.plan.values())).sample_time)

    @property
    def references(self) -> dict[str, Recorded]:
        """The set motion to run, by axis: the plan plus the change of the path."""
        return {axis: _moved(path, self.paths.get(axis)) for axis, path in self.plan.items()}

    @property
    def added(self) -> dict[str, RecordedForce]:
        """The added force as a load of the simulation, by axis."""
        T = self.sample_time
        return {axis: RecordedForce(force=force, sample_time=T) for axis, force in self.forces.items()}

    def scaled(self, factor: float) -> Correction:
        """Return the correction with all forces and changes multiplied by a factor."""
        if factor == 1.0:
            return self
        return dataclasses.replace(
            self,
            forces={axis: factor * force for axis, force in self.forces.items()},
            paths={axis: factor * change for axis, change in self.paths.items()},
            shares={axis: factor * share for axis, share in self.shares.items()},
        )


def _moved(path: Recorded, change: np.ndarray | None) -> Recorded:
    if change is None:
        return path
    rows = [np.asarray(row) for row in path.at(np.arange(path.position.size) * float(path.sample_time))]
    position, velocity, acceleration, jerk, snap = (row + added for row, added in zip(rows, change, strict=True))
    return Recorded(
        position=position,
        velocity=velocity,
        acceleration=acceleration,
        jerk=jerk,
        snap=snap,
        sample_time=path.sample_time,
    )


def planned_rows(references: Mapping[str, Reference], sample_time: float) -> dict[str, Recorded]:
    """Return references as rows at the sampling instants with all derivatives, all as long as the longest."""
    rows = max(samples(float(path.duration), sample_time) for path in references.values())
    plan: dict[str, Recorded] = {}
    for axis, path in references.items():
        there = isinstance(path, Recorded) and path.snap is not None and path.position.size == rows
        if there and isinstance(path, Recorded) and path.sample_time == sample_time:
            plan[axis] = path
            continue
        position, velocity, acceleration, jerk, snap = (
            np.broadcast_to(np.asarray(row, np.float64), rows).copy() for row in path.at(np.arange(rows) * sample_time)
        )
        plan[axis] = Recorded(
            position=position,
            velocity=velocity,
            acceleration=acceleration,
            jerk=jerk,
            snap=snap,
            sample_time=sample_time,
        )
    return plan


def correct_by_plan(machine: Machine, plan: Mapping[str, Recorded], *, share: float = SHARE) -> Correction:
    """Return the force that feeds the dry friction of all axes forward along their planned motions.

    plan   planned motion by axis
    share  share of the friction that is fed forward, 0 to 1

    No run of the machine is needed.  The friction may be on the load, on the motor, or on both.
    Raises ParameterError for a machine that already feeds its friction forward, for axes without dry friction, and for
    the loops that `loop_inverse` refuses.
    """
    moving = _planned_axes(machine, plan, share)
    forces: dict[str, np.ndarray] = {}
    for axis in moving:
        displaced, inverse = friction_displacement(machine.loop(axis), plan[axis])
        forces[axis] = share * inverse.force_for(displaced, PLAN_KNOTS, PLAN_RIDGE)
    if share > 0.0:
        _require_friction(forces, moving)
    return Correction(plan, forces, shares=dict.fromkeys(forces, share))


def _planned_axes(machine: Machine, plan: Mapping[str, Recorded], share: float) -> list[str]:
    """Return the axes that move. Raise ParameterError for a share out of range, or axes that cannot be corrected."""
    if not 0.0 <= share <= 1.0:
        raise ParameterError(
            f"share = {number(share, 6)} must be >= 0 and <= 1: more than the whole friction makes starts from rest "
            "worse"
        )
    moving = moving_axes(machine, plan)
    for axis in moving:
        if kinds := feeds_friction(machine.loop(axis)):
            raise ParameterError(
                f"axis.{axis}.control: {kinds} feeds dry friction forward by the sign of the set velocity, which would "
                "act twice: take its friction out of the control (coulomb_positive, coulomb_negative, stribeck), or "
                "learn what it leaves from a log of the part: --from-log"
            )
    return moving


def _require_friction(corrections: Mapping[str, np.ndarray], moving: Sequence[str]) -> None:
    if not any(np.any(correction) for correction in corrections.values()):
        raise ParameterError(
            f"no axis of {', '.join(moving)} has dry friction in the machine file, so that there is nothing to feed "
            "forward: identify it (feeddrive identify, friction), and write it as [axis.x.friction_load]"
        )


def correct_path_by_plan(
    machine: Machine,
    plan: Mapping[str, Recorded],
    limits: Mapping[str, np.ndarray],
    proven: Mapping[str, np.ndarray],
    *,
    share: float = PATH_SHARE,
) -> Correction:
    """Return the change of the set paths that cancels the dry friction of all axes, for drives that take no force.

        (B'B + λ r0 I) c = B' (g * f),   B = response of the table to splines of the set path, knots every 20 ms

    plan    planned motion by axis, planned with a reserve of each limit (`RESERVE`)
    limits  limits of velocity to snap, m/s .. m/s⁴, shape (4,), by axis
    proven  proven shares of these limits that the plan takes, shape (4,), by axis
    share   share of the friction that is cancelled, 0 to 1

    Velocity to snap of the sum are proven again in continuous time (`changed_use`); the largest of 1, 3/4, 1/2 and 1/4
    of the change for which the proof holds on all axes is returned.  Raises NotPlannedError if it holds for none, and
    the errors of `correct_by_plan`.
    """
    moving = _planned_axes(machine, plan, share)
    changes: dict[str, tuple[np.ndarray, np.ndarray, int]] = {}
    for axis in moving:
        displaced, inverse = friction_displacement(machine.loop(axis), plan[axis])
        change, coefficients = inverse.path_for(share * displaced, PATH_KNOTS, PATH_RIDGE)
        changes[axis] = change, coefficients, inverse.knots(PATH_KNOTS)
    _require_friction({axis: change for axis, (change, _, _) in changes.items()}, moving)
    worst: tuple[str, int, float] = ("", 0, 0.0)
    for fraction in _FRACTIONS:
        paths = {axis: fraction * change for axis, (change, _, _) in changes.items()}
        worst = max(
            (
                (axis, int(np.argmax(use)), float(np.max(use)))
                for axis, (_, coefficients, spacing) in changes.items()
                for use in [
                    changed_use(
                        _derivatives(_moved(plan[axis], paths[axis])),
                        fraction * coefficients,
                        spacing,
                        float(plan[axis].sample_time),
                        limits[axis],
                        proven[axis],
                    )
                ]
            ),
            key=lambda entry: entry[2],
        )
        if keeps(np.array([worst[2]])):
            return Correction(plan, {}, paths, dict.fromkeys(paths, fraction * share))
    axis, which, use = worst
    raise NotPlannedError(
        f"axis {axis}: the plan and a quarter of the change together take {Quantity(use, 'share'):5} of the limit of "
        f"{DERIVATIVES[which]}, and the plan alone {Quantity(float(proven[axis][which]), 'share'):5}: give a smaller "
        "--share, or add a force (--method force)"
    )


def _derivatives(path: Recorded) -> np.ndarray:
    """Return velocity to snap of a path at its samples, shape (4, n)."""
    rows = path.at(np.arange(path.position.size) * float(path.sample_time))
    return np.array([np.asarray(row) for row in rows[1:]])


def friction_displacement(loop: Loop, path: Recorded) -> tuple[np.ndarray, LoopInverse]:
    """Return g * f, how far dry friction holds the table back along a path, m, shape (n,), and the loop's inverse."""
    inverse = loop_inverse(loop)
    velocity, T = planned_velocity(path), float(path.sample_time)
    displaced = np.zeros(velocity.size)
    if loop.axis.friction_load is not None:
        displaced += inverse.answer(friction_along(loop.axis.friction_load, velocity, T))
    if loop.axis.friction_motor is not None:
        displaced += inverse.of_command(_before_the_drive(loop, loop.axis.friction_motor, velocity, T))
    return displaced, inverse


def _before_the_drive(loop: Loop, friction: Friction, velocity: np.ndarray, T: float) -> np.ndarray:
    """Return the command whose force behind dead time and current loop is the friction on the motor, N.

    Dead time is a shift of the plan.  The lag of the current loop, y(k+1) = a y(k) + (1 - a) u(k), is solved for u; the
    regularized fit of the force takes what is too quick out of it.
    """
    force = friction_along(friction, velocity, T)
    late = float(loop.axis.actuator.dead_time) / T
    at = np.arange(velocity.size) + late
    force = np.interp(at, np.arange(velocity.size), force)
    bandwidth = loop.axis.actuator.current_loop
    if bandwidth is None:
        return force
    a = float(np.exp(-2.0 * np.pi * float(bandwidth) * T))
    return (np.append(force[1:], force[-1]) - a * force) / (1.0 - a)


def planned_velocity(path: Recorded) -> np.ndarray:
    """Return the planned velocity at the samples of a path, m/s."""
    return np.asarray(path.at(np.arange(path.position.size) * float(path.sample_time)).velocity)


def moving_axes(machine: Machine, plan: Mapping[str, Reference]) -> list[str]:
    """Return the axes that move. Raise ParameterError for a rotary one, or if none does."""
    moving: list[str] = []
    for axis, path in plan.items():
        if not isinstance(path, Recorded):
            raise ParameterError(f"axis {axis}: the plan must be rows of set positions with their derivatives")
        if float(np.ptp(path.position)) > 0.0:
            moving.append(axis)
    turning = [axis for axis in moving if machine.axes()[axis].axis.rotary]
    if turning:
        raise ParameterError(
            f"axis {', '.join(turning)} turns: the correction of a part is checked for linear axes only; leave the "
            "rotary axes out of the program"
        )
    if not moving:
        raise ParameterError("no axis moves, so that there is nothing to correct: name a job with a motion")
    return moving


def feeds_friction(loop: Loop) -> str:
    """Return the kinds of the blocks of the control that feed dry friction forward; empty if there are none.

    A block whose levels of friction are all 0 feeds none.
    """
    blocks = (block for block in loop.control.feedforward if "friction" in block.fed())
    kinds = [block.kind for block in blocks if _levels(block)]
    return ", ".join([*kinds, *([loop.control.law.kind] if "friction" in loop.control.law.fed() else [])])


def _levels(block: Block) -> bool:
    """Return True if a block holds a force other than 0."""
    return any(value != 0.0 for name, value in tree.leaves(block) if tree.declaration(block, name).unit == "N")


def hunting(machine: Machine, axes: Sequence[str]) -> list[str]:
    """Return a sentence for each axis whose loop is unstable at rest, where presliding holds it like a spring.

    Such an axis hunts around its set position as far as the presliding goes.  It is stable while it slides, so that no
    other check finds it, and no force along the plan can cancel it.
    """
    found: list[str] = []
    for axis in axes:
        loop = machine.loop(axis)
        frictions = (loop.axis.friction_load, loop.axis.friction_motor)
        if not any(friction is not None and remembers(friction) for friction in frictions):
            continue
        try:
            verdict = stability(loop, velocity=0.0)
        except NoSlopeError:
            # a law without a linear model is judged by its runs alone
            continue
        if verdict.stable or verdict.time_constant is None:
            continue
        found.append(
            Text(
                f"Axis {axis} hunts at rest, at {Quantity(verdict.frequency, 'Hz')}: its loop is unstable where "
                "presliding holds it like a spring, which no force along the plan can cancel; damp it there, or lower "
                "its bandwidth."
            )
        )
    return found


class Judge:
    """The machines on which a correction is judged, each with the figures of its run without correction.

    machine   nominal machine, with the couplings of the work
    plan      planned motion by axis
    counted   True for the samples that count, shape (n,)
    box       tolerances
    loads     force on the tables, by axis
    line      line of the part program by sample, for messages
    seed      seed of the noise; every run has another one, from seed + 1 on
    """

    def __init__(
        self,
        machine: Machine,
        plan: Mapping[str, Recorded],
        *,
        counted: np.ndarray | None = None,
        box: PlantBox | None = None,
        loads: Mapping[str, Load] | None = None,
        line: np.ndarray | None = None,
        seed: int = 0,
        progress: Progress | None = None,
        machines: Mapping[str, Machine] | None = None,
    ) -> None:
        self.plan, self.loads, self.line = plan, loads, line
        chosen = (box or PlantBox()).machines(machine) if machines is None else machines
        self.machines = noisy_machines(chosen)
        self.axes = tuple(moving_axes(machine, plan))
        self._progress = progress or Progress()
        self._seed = seed
        n = plan[self.axes[0]].position.size
        self.counted = np.ones(n, bool) if counted is None else np.asarray(counted, bool)
        self._path = PlannedPath(plan, self.axes, self.counted)
        self.errors: dict[str, dict[str, np.ndarray]] = {}
        self.contours: dict[str, ContourError] = {}
        for name, sampled in self.machines.items():
            self._require(name, sampled)
        self.left = tuple(hunting(next(iter(self.machines.values())), self.axes))
        self.plain = self._figures(list(self.machines), None)

    def _require(self, name: str, machine: Machine) -> None:
        """Raise the error of an unstable or nonlinear loop, with the machine on which it was found."""
        # chatter of the cut is another question: the axes are stable or not in air
        idle = tuple(coupling for coupling in machine.couplings if not isinstance(coupling, MillingCut))
        try:
            require_stable(dataclasses.replace(machine, couplings=idle))
        except FeeddriveError as error:
            raise type(error)(f"machine of the box '{name}': {error}") from None

    def figures(self, correction: Correction, *, all_machines: bool = True) -> list[PlantFigures]:
        """Return the figures of the machines with a correction; of the nominal one only unless `all_machines`."""
        names = list(self.machines) if all_machines else [next(iter(self.machines))]
        found = self._figures(names, correction)
        return [PlantFigures(name, self.plain[name], found[name]) for name in names]

    def _figures(self, names: Sequence[str], correction: Correction | None) -> dict[str, PathFigures]:
        """Run the part on some machines at once, and return their figures."""
        seeds = {name: self._seed + 1 + i for i, name in enumerate(names)}
        self._seed += len(names)
        machines = {name: self.machines[name] for name in names}
        references: dict[str, Reference] = dict.fromkeys(machines[names[0]].axes(), _still(self.plan))
        references |= self.plan if correction is None else correction.references
        n = self.counted.size
        forces = {} if correction is None else correction.forces
        # a force of 0 without a correction: all runs share one compiled program
        none, T = np.zeros(n), float(self.plan[self.axes[0]].sample_time)
        added = {axis: RecordedForce(force=forces.get(axis, none), sample_time=T) for axis in self.axes}
        positions = {name: {axis: np.empty(n) for axis in self.axes} for name in names}
        limits = {name: {axis: _limits(machine.loop(axis)) for axis in forces} for name, machine in machines.items()}
        squares = dict.fromkeys(((name, axis) for name in names for axis in forces), 0.0)
        for runs in stream_each(
            machines,
            references,
            load=self.loads,
            added_force=added,
            seeds=seeds,
            record=[f"{axis}.{signal}" for axis in self.axes for signal in _RECORDED],
            name=f"{'without' if correction is None else 'with'} correction",
            progress=self._progress,
        ):
            for name, run in runs.items():
                for axis, total in self._totals(run, limits[name], forces).items():
                    squares[name, axis] += float(np.sum(total**2))
                for axis, row in positions[name].items():
                    row[run.first : run.first + run.samples] = run[f"{axis}.position_load"]
        for (name, axis), square in squares.items():
            _refuse_continuous(name, axis, float(np.sqrt(square / n)), limits[name][axis].continuous)
        found: dict[str, PathFigures] = {}
        when = "plain" if correction is None else "corrected"
        for name in names:
            found[name], error = self._path.deviation(positions[name])
            self.errors.setdefault(name, {})[when] = error
        if len(self.axes) > 1 and names[0] == next(iter(self.machines)):
            self.contours[when] = self._path.contour(positions[names[0]], self.line)
        return found

    def _totals(
        self, run: Run, limits: Mapping[str, _Limits], forces: Mapping[str, np.ndarray]
    ) -> dict[str, np.ndarray]:
        """Return command and added force together, N, of the axes that have one, over a stretch of a run.

        Raises ParameterError for a trip of a guard, and for a total beyond a limit.
        """
        totals: dict[str, np.ndarray] = {}
        for axis in self.axes:
            tripped = np.flatnonzero(run[f"{axis}.trip"] > 0.0)
            if tripped.size:
                raise ParameterError(
                    f"machine of the box '{run.name}': the guard of axis {axis} tripped at "
                    f"{self._place(run, int(tripped[0]))}: a correction cannot be judged on it; check the "
                    "limits of guard and force"
                )
            if axis not in forces:
                continue
            total = totals[axis] = run[f"{axis}.force"] + forces[axis][run.first : run.first + run.samples]
            for what, limit in (("force_limit", limits[axis].force), ("peak current", limits[axis].peak)):
                over = np.flatnonzero(np.abs(total) > limit) if limit is not None else np.zeros(0)
                if over.size and limit is not None:
                    k = int(over[0])
                    raise ParameterError(
                        f"axis {axis}, {self._place(run, k)}, machine of the box '{run.name}': command and correction "
                        f"together are {Quantity(float(total[k]), 'N'):4}, beyond the {what} of "
                        f"{Quantity(float(limit), 'N'):4}: plan with less acceleration there, or give a smaller --share"
                    )
        return totals

    def _place(self, run: Run, k: int) -> str:
        k += run.first
        line = "" if self.line is None else f", line {int(self.line[min(k, self.line.size - 1)])}"
        return Text(f"{Quantity(k * run.sample_time, 's'):6 SI}{line}")


def _still(plan: Mapping[str, Recorded]) -> Recorded:
    path = next(iter(plan.values()))
    return Recorded(position=np.zeros(path.position.size), sample_time=path.sample_time)


class _Limits(NamedTuple):
    """What an axis can do, N: limit of its control, peak and continuous force of its motor; None without a limit."""

    force: Any
    peak: Any
    continuous: Any


def _limits(loop: Loop) -> _Limits:
    motor = loop.axis.actuator.motor
    return _Limits(loop.control.force_limit, *((None, None) if motor is None else motor.limits()))


def _refuse_continuous(name: str, axis: str, rms: float, continuous: Any) -> None:
    """Raise ParameterError for command and correction, N RMS, beyond the continuous current of a motor."""
    if continuous is not None and rms > float(continuous):
        raise ParameterError(
            f"axis {axis}, machine of the box '{name}': command and correction together are "
            f"{Quantity(rms, 'N'):4} RMS, beyond the continuous current of {Quantity(float(continuous), 'N'):4}: "
            "lower the feed or the accelerations"
        )


class PlannedPath:
    """The planned path of some axes, against which the positions of any number of parts are measured.

    plan     planned motion by axis
    axes     axes that move
    counted  True for the samples that count, shape (n,)
    """

    def __init__(self, plan: Mapping[str, Recorded], axes: Sequence[str], counted: np.ndarray) -> None:
        n = plan[axes[0]].position.size
        self.axes, self._T = tuple(axes), float(plan[axes[0]].sample_time)
        self._counted = np.zeros(n, bool)
        self._counted[: min(n, counted.size)] = counted[:n]
        if not np.any(self._counted):
            raise ParameterError("no sample of the motion counts: the program cuts nothing, and never moves at a feed")
        wanted = [plan[axis].at(np.arange(n) * self._T) for axis in axes]
        self._position, velocity = (
            np.column_stack([np.asarray(setpoint[order]) for setpoint in wanted]) for order in range(2)
        )
        self._curve = curve_of_motion(self._position, velocity, self._T) if len(axes) > 1 else None

    def contour(self, positions: Mapping[str, np.ndarray], line: np.ndarray | None = None) -> ContourError:
        """Return the contour error of positions, m, shape (n,), of two or more axes.

        line  line of the part program by sample, shape (n,) or shorter
        """
        n = len(self._position)
        return contour_error(
            np.column_stack([positions[axis] for axis in self.axes]),
            self._position,
            axes=self.axes,
            sample_time=self._T,
            line=None if line is None else np.append(line[:n], np.full(max(0, n - line.size), line[-1])),
            counted=self._counted,
            name="part",
            curve=self._curve,
        )

    def deviation(self, positions: Mapping[str, np.ndarray]) -> tuple[PathFigures, np.ndarray]:
        """Return the figures of positions, m, shape (n,), by axis, and the deviation over time, m, shape (n,).

        The deviation of two or more axes is the contour error of the table, that of one axis the lag behind its plan.
        """
        mask = self._counted
        if self._curve is None:
            error = self._position[:, 0] - positions[self.axes[0]]
            size = np.abs(error[mask])
            rms = float(np.sqrt(np.mean(size**2)))
            figures = PathFigures(rms, float(np.quantile(size, 0.95)), float(np.max(size)))
        else:
            contour = self.contour(positions)
            error = contour.error
            figures = PathFigures(float(contour.rms), float(contour.within()), float(contour.largest))
        return figures, np.where(mask, np.abs(error), np.nan)


def path_figures(
    run: Run, plan: Mapping[str, Recorded], axes: Sequence[str], counted: np.ndarray
) -> tuple[PathFigures, np.ndarray]:
    """Return the figures of a run against the plan, and its deviation over time, m, shape (n,): see `PlannedPath`."""
    return PlannedPath(plan, axes, counted).deviation({axis: run[f"{axis}.position_load"] for axis in axes})


@dataclass(frozen=True, eq=False, repr=False)
class CorrectedProgram(Result):
    """A correction of a part, with the judgment on it.

    correction  what is run: the accepted share of the correction, or all of it if it is refused
    accepted    accepted share of the correction; 0 if it is refused
    plants      figures of every machine of the box, the nominal one first
    tried       what was found against each larger share
    errors      deviation over time, m, of the nominal and of the worst machine: by name, "plain" and "corrected"
    box         tolerances of the box
    remarks     what a user must know
    left        what no correction can cancel: see `hunting`
    contours    contour errors of the nominal machine, "plain" and "corrected"; empty for one axis
    """

    correction: Correction
    accepted: float
    plants: tuple[PlantFigures, ...]
    tried: tuple[str, ...]
    errors: Mapping[str, Mapping[str, np.ndarray]]
    box: PlantBox
    remarks: tuple[str, ...] = ()
    left: tuple[str, ...] = ()
    contours: Mapping[str, ContourError] = field(default_factory=dict[str, ContourError])

    @property
    def nominal(self) -> PlantFigures:
        """The figures of the nominal machine."""
        return self.plants[0]

    @property
    def worst(self) -> PlantFigures:
        """The figures of the machine on which the corrected part has the largest RMS."""
        return max(self.plants, key=lambda plant: plant.corrected.rms)

    def table(self) -> Table:
        """Return a table of the figures of every machine of the box, without and with the correction."""
        columns = [
            "machine",
            Column("RMS plain", "m"),
            Column("corrected", "m"),
            Column("95 % plain", "m"),
            Column("corrected", "m"),
            Column("largest plain", "m"),
            Column("corrected", "m"),
        ]
        rows: list[list[Cell]] = []
        for plant in self.plants:
            pairs = zip(plant.plain, plant.corrected, strict=True)
            rows.append([plant.name, *(value for pair in pairs for value in pair)])
        axes = "path" if len(self.correction.plan) > 1 else "plan"
        return Table(f"Deviation from the {axes} on each machine of the box", columns, rows)


def judged(judge: Judge, correction: Correction, box: PlantBox, remarks: Sequence[str] = ()) -> CorrectedProgram:
    """Return a correction with the largest share that no machine of the box refuses.

    Shares of 1, 3/4, 1/2 and 1/4 are tried: RMS, 95 % and largest deviation must each be at most 1.02 times those
    without correction, on every machine, in runs with noise that no earlier run had.
    """
    tried: list[str] = []
    plants: list[PlantFigures] = []
    for fraction in _FRACTIONS:
        plants = judge.figures(correction.scaled(fraction))
        worse = [(plant, *plant.worst) for plant in plants if plant.worst[1] > _WORSE]
        if not worse:
            return _result(judge, correction.scaled(fraction), fraction, plants, tried, box, remarks)
        plant, figure, ratio = max(worse, key=lambda entry: entry[2])
        tried.append(
            Text(
                f"{Quantity(fraction, 'share'):3} of the correction makes {figure} {Quantity(ratio):.3f} times as "
                f"large as without it, on the machine '{plant.name}'; at most {Quantity(_WORSE):.2f} is accepted"
            )
        )
    return _result(judge, correction.scaled(_FRACTIONS[-1]), 0.0, plants, tried, box, remarks)


def _result(
    judge: Judge,
    correction: Correction,
    accepted: float,
    plants: Sequence[PlantFigures],
    tried: Sequence[str],
    box: PlantBox,
    remarks: Sequence[str],
) -> CorrectedProgram:
    result = CorrectedProgram(correction, accepted, tuple(plants), tuple(tried), {}, box, tuple(remarks))
    nominal = NOMINAL if NOMINAL in judge.errors else plants[0].name
    shown = dict.fromkeys((nominal, result.worst.name))
    return dataclasses.replace(
        result,
        errors={name: judge.errors[name] for name in shown},
        left=judge.left,
        contours=judge.contours,
    )
