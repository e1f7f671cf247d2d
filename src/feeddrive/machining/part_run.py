"""Evaluation of a part program on a machine: errors with their program lines, motor load and cutting force."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from feeddrive.analysis.replay import observe
from feeddrive.blocks.families import Observer
from feeddrive.blocks.force.gravity import Gravity
from feeddrive.language import matrix
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Column, Result, Table
from feeddrive.language.text import Text
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import Machine
from feeddrive.loop.simulate import Run
from feeddrive.machining.contour import ContourError, Worst, contour_error
from feeddrive.machining.load import MachineLoad, SpindleLoad, machine_load

_AFTER = 0.05  # s after a reversal in which its glitch stands
_MOVES = 1e-3  # m/s along the path: another axis moves while one reverses
_BEGUN = 0.2  # s in which an observer begins
_LISTED = 8
_APART = 3e-3  # m of path: places that lie closer are one


class AxisRun(NamedTuple):
    """The figures of one axis under a part program, in SI; `line` and `time` are those of the largest following error.

    following_rms, following_peak  m, over all samples
    glitch, glitches               the largest contour error in the 50 ms after a reversal, m; the number of reversals
    """

    following_rms: float
    following_peak: float
    line: int
    time: float
    glitch: float
    glitches: int


class Estimated(NamedTuple):
    """The accuracy of a disturbance observer on an axis, compared with the true disturbance.

    The true disturbance is that of `disturbance_of` without the viscous friction in the observer's own model.

    error, true  N, RMS of estimate - truth, and of the truth without its mean; the lag of the estimate is compensated
    slow         N, RMS of the error averaged over a turn of the spindle; None without a spindle
    lag          s
    disturbance  N, the estimate, shape (n,)
    """

    error: float
    true: float
    slow: float | None
    lag: float
    disturbance: np.ndarray


@dataclass(frozen=True, eq=False, repr=False)
class PartRun(Result):
    """The result of a controller under a part program.

    contour    contour error of all moving axes; samples count in which the tool leaves a wall of the part (`on_part`),
               or moves at a feed
    axes       figures by axis
    load       of the motors, and of the spindle if there is a cut
    cutting    N, cutting force on the axes that exist among x, y, z, shape (n, N); None without a cut
    estimates  by observer and axis
    disturbances  N, the true disturbance of the axes with observers, by axis
    """

    name: str
    contour: ContourError
    axes: Mapping[str, AxisRun]
    load: MachineLoad
    cutting: np.ndarray | None
    estimates: Mapping[str, Mapping[str, Estimated]]
    disturbances: Mapping[str, np.ndarray]

    def worst(self, count: int = _LISTED) -> list[Worst]:
        """Return the largest contour errors that count, a few millimeters of path apart."""
        return self.contour.worst(count, apart=max(_APART, 2e-3 * float(self.contour.along[-1])))

    @property
    def cutting_rms(self) -> float | None:
        """The RMS of the resultant cutting force on all axes during the cut, N; None without a cut."""
        if self.cutting is None or not np.any(self.contour.counted):
            return None
        return _rms(np.linalg.norm(self.cutting[self.contour.counted], axis=1))

    @property
    def duty(self) -> float | None:
        """The largest ratio of RMS force to continuous force among the axes; None if none is stated."""
        shares = [axis.of_continuous for axis in self.load.axes.values() if axis.of_continuous is not None]
        return max(shares, default=None)

    def numbers(self) -> dict[str, float | None]:
        """Return all figures by name, in SI."""
        figures: dict[str, float | None] = {
            "contour_error_rms_m": self.contour.rms,
            "contour_error_95_percent_m": self.contour.within(),
            "contour_error_peak_m": self.contour.largest,
        }
        for axis, axis_run in self.axes.items():
            figures |= {
                f"{axis}.following_error_rms_m": axis_run.following_rms,
                f"{axis}.following_error_peak_m": axis_run.following_peak,
                f"{axis}.following_error_peak_line": float(axis_run.line),
                f"{axis}.reversals": float(axis_run.glitches),
                f"{axis}.reversal_glitch_m": axis_run.glitch,
            }
        for axis, motor in self.load.axes.items():
            figures |= {
                f"{axis}.drive_force_rms_N": motor.rms,
                f"{axis}.drive_force_peak_N": motor.peak,
                f"{axis}.force_rms_of_continuous": motor.of_continuous,
                f"{axis}.force_peak_of_peak": motor.of_peak,
                f"{axis}.work_J": motor.work,
                f"{axis}.drawn_without_recovery_J": motor.drawn,
            }
        figures["energy_J"] = self.load.energy()
        figures["energy_without_recovery_J"] = self.load.energy(recovers=False)
        if self.load.spindle is not None:
            figures["spindle_power_mean_W"] = self.load.spindle.power
            figures["spindle_power_peak_W"] = self.load.spindle.peak
            figures["spindle_energy_J"] = self.load.spindle.energy
            figures["chip_volume_m3"] = self.load.spindle.volume
            figures["specific_energy_J_per_m3"] = self.load.spindle.specific_energy
        if self.cutting is not None:
            figures["cutting_force_rms_N"] = self.cutting_rms
            figures["cutting_force_peak_N"] = float(np.max(np.linalg.norm(self.cutting, axis=1)))
        for observer, axes in self.estimates.items():
            for axis, estimate in axes.items():
                figures[f"{axis}.{observer}.disturbance_error_rms_N"] = estimate.error
                figures[f"{axis}.{observer}.disturbance_error_over_a_turn_rms_N"] = estimate.slow
                figures[f"{axis}.disturbance_deviation_N"] = estimate.true
        return figures

    def table(self) -> Table:
        """Return a table with one row for each axis."""
        title = Text(
            f"{self.name}: contour error {Quantity(self.contour.largest, 'm')} at most, "
            f"{Quantity(self.contour.rms, 'm')} RMS, {Quantity(self.contour.within(), 'm')} on 95 % of the path that "
            "counts"
        )
        columns = [
            "axis",
            Column("following RMS", "m"),
            Column("peak", "m"),
            "in line",
            Column("force RMS", "N"),
            Column("peak", "N"),
            Column("reversal", "m"),
        ]
        rows = [
            [
                name,
                axis.following_rms,
                axis.following_peak,
                axis.line,
                motor.rms,
                motor.peak,
                axis.glitch if axis.glitches else None,
            ]
            for name, axis, motor in ((name, axis, self.load.axes[name]) for name, axis in self.axes.items())
        ]
        return Table(title, columns, rows)


def part_run(
    run: Run,
    machine: Machine,
    axes: Iterable[str],
    line: np.ndarray,
    *,
    counted: np.ndarray | None = None,
    cuts: bool = False,
    turn: float | None = None,
    spindle: SpindleLoad | None = None,
    observers: Mapping[str, Mapping[str, Observer]] | None = None,
) -> PartRun:
    """Evaluate a run of a machine along a part program.

    run        run of the machine, with all signals
    machine    the machine that was simulated
    axes       axes that the program moves
    line       program line by sample, shape (n,); the run may be longer
    counted    True for samples that count for the contour, shape (n,); default: all
    cuts       True if the machine has a cut, whose force is then `load_force`
    turn       s, longest duration of a spindle turn; None without a spindle
    spindle    load of the spindle, if known
    observers  observers by name and axis, applied to the readings and forces of the run by `observe`

    Raises ParameterError for lines that do not match the run, and as `contour_error`.
    """
    names, loops = tuple(axes), machine.loops()
    n = min(run.samples, len(line))
    if abs(run.samples - len(line)) > 2:
        raise ParameterError(f"the run has {run.samples} samples, the program {len(line)}: they do not belong together")
    lines = np.append(line[:n], np.full(run.samples - n, line[n - 1]))
    mask = np.ones(run.samples, bool) if counted is None else np.append(counted[:n], np.zeros(run.samples - n, bool))
    contour = contour_error(run, axes=names, line=lines, counted=mask)
    speed = np.sqrt(sum(run[f"{axis}.set_velocity"] ** 2 for axis in names))
    by_axis = {axis: _axis(run, axis, lines, contour, speed) for axis in names}
    cutting = np.column_stack([run[f"{axis}.load_force"] for axis in names]) if cuts else None
    heard = {axis for by in (observers or {}).values() for axis in by if axis in names}
    true = {axis: disturbance_of(run, loops[axis], axis) for axis in names if axis in heard}
    estimates = {
        name: {
            axis: _estimated(run, axis, observer, true[axis], turn) for axis, observer in by.items() if axis in names
        }
        for name, by in (observers or {}).items()
    }
    acting = {axis: disturbance.astype(np.float32) for axis, disturbance in true.items()}
    return PartRun(run.name, contour, by_axis, machine_load(run, machine, spindle=spindle), cutting, estimates, acting)


def _axis(run: Run, axis: str, line: np.ndarray, contour: ContourError, speed: np.ndarray) -> AxisRun:
    error = run[f"{axis}.following_error"]
    worst = int(np.argmax(np.abs(error)))
    velocity = run[f"{axis}.set_velocity"]
    turns = np.flatnonzero((np.sign(velocity[1:]) * np.sign(velocity[:-1]) <= 0.0) & (velocity[:-1] != 0.0))
    turns = turns[(speed[turns] > _MOVES) & contour.counted[turns]]
    after = max(1, round(_AFTER / run.sample_time))
    heights = [float(np.max(np.abs(contour.error[i : i + after]))) for i in turns]
    return AxisRun(
        _rms(error),
        float(np.abs(error[worst])),
        int(line[worst]),
        float(run.time[worst]),
        max(heights, default=0.0),
        len(heights),
    )


def _estimated(run: Run, axis: str, observer: Observer, true: np.ndarray, turn: float | None) -> Estimated:
    """Compare an observer with the true disturbance in the same run."""
    encoder = getattr(observer, "encoder", "load")
    T, before = run.sample_time, float(run[f"{axis}.force"][0])
    seen = observe(observer, run[f"{axis}.reading_{encoder}"], run[f"{axis}.force"], T, before=before)
    late, skip = round(seen.lag / T), round(_BEGUN / T)
    # viscous friction that the observer's own model holds is none of its disturbance
    true = true + float(getattr(observer, "viscous", 0.0)) * run[f"{axis}.velocity_load"]
    off = (seen.disturbance[late:] - true[: len(true) - late])[skip:]
    slow = None
    if turn is not None:
        width = max(1, round(turn / T))
        total = np.cumsum(np.insert(off, 0, 0.0))
        slow = _rms((total[width:] - total[:-width]) / width)
    return Estimated(_rms(off), float(np.std(true[skip:])), slow, seen.lag, seen.disturbance.astype(np.float32))


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0


def disturbance_of(run: Run, loop: Loop, axis: str) -> np.ndarray:
    """Return the true disturbance of an axis over each sample, N, shape (n,): cut, weight, dry and viscous friction."""
    mechanics = loop.axis.mechanics()
    along = mechanics.rigid_motion()
    viscous = float(matrix.dot([matrix.dot(row, along) for row in mechanics.damping], along))
    weight = sum(float(force.force) for force in loop.axis.forces if isinstance(force, Gravity))
    dry = run[f"{axis}.friction_motor"] + run[f"{axis}.friction_load"]
    return run[f"{axis}.load_force"] + weight + dry - viscous * run[f"{axis}.velocity_load"]
