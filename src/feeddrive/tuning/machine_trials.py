"""Repeated runs of a part program on a machine: feedforward or prefilter of all its axes, learned together."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from feeddrive.blocks.families import Reference
from feeddrive.blocks.prefilter.trajectory_prefilter import TrajectoryPrefilter
from feeddrive.language.block import Block
from feeddrive.language.errors import FeeddriveError, ParameterError
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity, unit_name
from feeddrive.language.table import Result, Table
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import Machine
from feeddrive.loop.simulate import Run, simulate
from feeddrive.machining.contour import contour_error
from feeddrive.tuning.iterative_feedforward import begin_compensation, compensated, compensator, next_iteration
from feeddrive.tuning.trajectory_prefilter import REGRESSORS, fit_prefilter
from feeddrive.tuning.trial import simulated_trial

_RECORDED = (
    "set_position",
    "set_velocity",
    "set_acceleration",
    "position_load",
    "following_error",
    "requested",
    "force",
    "trip",
)
_STANDS = 1e-9  # m of travel


@dataclass(frozen=True, eq=False, repr=False)
class MachineTrials(Result):
    """Runs of the same motion, each with what was learned from the one before.

    error    RMS of the following error of each run, m, by axis
    contour  largest and RMS of the contour error of each run, m; empty if fewer than two axes move along lines
    learned  the block of the last run by axis: a disturbance compensator or a trajectory prefilter
    machine  of the last run
    remarks  what was not learned, and why
    """

    error: Mapping[str, np.ndarray]
    contour: tuple[tuple[float, float], ...]
    learned: Mapping[str, Block]
    machine: Machine
    remarks: tuple[str, ...]

    def table(self) -> Table:
        """Errors, a column for each run."""
        runs = len(next(iter(self.error.values())))
        curves = {f"{axis}: error RMS": row for axis, row in self.error.items()}
        if self.contour:
            curves |= zip(("contour error, largest", "contour error, RMS"), np.transpose(self.contour), strict=True)
        rows = [
            [f"{name} {unit_name('m')}", *(Quantity(value, "m", bare=True) for value in values)]
            for name, values in curves.items()
        ]
        heads = ["run", *(str(j + 1) for j in range(runs))]
        return Table(f"{runs} runs of the same motion on {', '.join(self.error)}", heads, rows)


def iterate_machine(
    machine: Machine, references: Mapping[str, Reference], runs: int = 4, *, form: str = "model_free",
    gamma: float = 1.0, columns: Sequence[str] | None = None, least_mass: float = 0.0, seed: int = 0,
    progress: Progress | None = None,
) -> MachineTrials:  # fmt: skip
    """Feedforward parameters of all axes that move, from run to run (`next_iteration` has the law and its arguments).

    Each axis learns from its own error; what couples it with others is seen as a disturbance that repeats.  An axis
    whose run teaches nothing keeps what it has, with a remark.
    Raises ParameterError for fewer than two runs, and as `simulate`.
    """

    def learned(loop: Loop, run: Run, reference: Reference) -> tuple[Loop, Block]:
        trial = simulated_trial(run, reference)
        found = next_iteration(loop, trial, form=form, gamma=gamma, columns=columns, least_mass=least_mass)
        return compensated(loop, found.after), found.after

    def begun(loop: Loop) -> Loop:
        return begin_compensation(loop, columns)

    return _repeated(machine, references, runs, begun, learned, compensator, seed, progress)


def tune_prefilters(
    machine: Machine, references: Mapping[str, Reference], runs: int = 3, *,
    regressors: Sequence[str] = REGRESSORS, seed: int = 0, progress: Progress | None = None,
) -> MachineTrials:  # fmt: skip
    """Trajectory prefilters of all axes that move, from run to run (`fit_prefilter` has the law).

    Raises ParameterError for fewer than two runs and for a prefilter of another kind, and as `simulate`.
    """

    def present(loop: Loop) -> TrajectoryPrefilter | None:
        held = loop.control.prefilter
        if held is not None and not isinstance(held, TrajectoryPrefilter):
            raise ParameterError(
                f"axis.{loop.name}.control.prefilter is a {held.kind}: take it out, or tune a trajectory_prefilter"
            )
        return held

    def learned(loop: Loop, run: Run, reference: Reference) -> tuple[Loop, Block]:
        found = fit_prefilter(run, reference, regressors=regressors, present=present(loop)).prefilter
        return dataclasses.replace(loop, control=dataclasses.replace(loop.control, prefilter=found)), found

    def begun(loop: Loop) -> Loop:
        present(loop)
        return loop

    return _repeated(machine, references, runs, begun, learned, present, seed, progress)


def _repeated(
    machine: Machine, references: Mapping[str, Reference], runs: int, begun: Callable[[Loop], Loop],
    learned: Callable[[Loop, Run, Reference], tuple[Loop, Block]], held: Callable[[Loop], Block | None], seed: int,
    progress: Progress | None,
) -> MachineTrials:  # fmt: skip
    """Run after run, with what each axis learned from the one before."""
    if runs < 2:
        raise ParameterError(f"runs = {runs} must be >= 2: the first shows the error, the second what was learned")
    moving = [name for name, each in references.items() if _moves(each, float(machine.sample_time))]
    if not moving:
        raise ParameterError("references: no axis moves, so that there is nothing to learn")
    machine = machine.with_loops({name: begun(machine.loop(name)) for name in moving})
    along = [name for name in moving if not machine.axes()[name].axis.rotary]
    there = set(machine.signals())
    record = [f"{name}.{each}" for name in machine.axes() for each in _RECORDED]
    record += [each for each in ("tool.x", "tool.y", "tool.z") if each in there]
    error: dict[str, list[float]] = {name: [] for name in moving}
    contour: list[tuple[float, float]] = []
    remarks: dict[str, str] = {}
    for j in range(runs):
        if progress is not None:
            progress.step("runs", j + 1, runs)
        run = simulate(machine, references, seed=seed + j, record=record, name=f"run {j + 1}")
        for name in moving:
            error[name].append(float(np.sqrt(np.mean(run[f"{name}.following_error"] ** 2))))
        if 2 <= len(along) <= 3:
            found = contour_error(run, axes=tuple(along), signal="position_load")
            contour.append((float(found.largest), float(found.rms)))
        if j == runs - 1:
            break
        loops: dict[str, Loop] = {}
        for name in moving:
            try:
                loops[name], _ = learned(machine.loop(name), run.axis(name), references[name])
            except FeeddriveError as wrong:
                remarks[name] = f"axis {name} learned nothing from run {j + 1}: {wrong}"
        machine = machine.with_loops(loops)
    blocks = {name: held(machine.loop(name)) for name in moving}
    return MachineTrials(
        {name: np.array(row) for name, row in error.items()},
        tuple(contour),
        {name: each for name, each in blocks.items() if each is not None},
        machine,
        tuple(remarks.values()),
    )


def _moves(reference: Reference, T: float) -> bool:
    t = T * np.unique(np.linspace(0.0, reference.duration / T, 1001).round())
    return bool(np.ptp(np.asarray(reference.at(t).position)) > _STANDS)
