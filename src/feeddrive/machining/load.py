"""Load of motors and spindle due to a motion: RMS and peak force, heat, losses, energy and power."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity, unit_name
from feeddrive.language.table import Column, Result, Table
from feeddrive.language.text import Text
from feeddrive.language.units import turning
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import System, check_system
from feeddrive.loop.simulate import Run

WARN, TRIP = 0.8, 1.0
"""Shares of the continuous heat at which a drive warns and trips."""


@dataclass(frozen=True, eq=False, repr=False)
class AxisLoad(Result):
    """The load of one motor due to a motion. Forces in N at the table; for a rotary axis torques in N m.

    axis            name of the axis
    sample_time     sample time, s
    force           motor force, held over each sample, shape (n,)
    rms, peak       RMS and peak of the force; the RMS includes standstills
    continuous_force, peak_force  continuous and peak force of the motor; None if not stated
    time_constant   thermal time constant, s; None if not stated
    heat            heat relative to continuous load, shape (n + 1,), from the cold state; None if the continuous force
                    or the time constant is unknown
    heat_repeated   the largest heat when the motion is repeated indefinitely
    copper_loss     mean power lost in the winding, W; None if the motor constant is unknown
    work            net mechanical energy delivered to the axis, J: for friction, cut and change of height
    drawn           mechanical energy drawn without recovery of braking energy, J
    turning         True for a rotary axis
    """

    axis: str
    sample_time: float
    force: np.ndarray
    rms: float
    peak: float
    continuous_force: float | None
    peak_force: float | None
    time_constant: float | None
    heat: np.ndarray | None
    heat_repeated: float | None
    copper_loss: float | None
    work: float
    drawn: float
    turning: bool = False

    @property
    def duration(self) -> float:
        """The duration of the motion, s."""
        return len(self.force) * self.sample_time

    @property
    def of_continuous(self) -> float | None:
        """The ratio of the RMS force to the continuous force."""
        return None if self.continuous_force is None else self.rms / self.continuous_force

    @property
    def of_peak(self) -> float | None:
        """The ratio of the peak force to the peak force of the motor."""
        return None if self.peak_force is None else self.peak / self.peak_force

    @property
    def recovered(self) -> float:
        """The mechanical energy recovered by braking, J."""
        return self.drawn - self.work

    @property
    def loss(self) -> float | None:
        """The energy lost in the winding, J."""
        return None if self.copper_loss is None else self.copper_loss * self.duration

    @property
    def verdict(self) -> str:
        """The verdict for continuous operation: "fits", "warns" (from 80 % of the admissible heat), "trips", "beyond
        the peak force", or "no continuous force stated".
        """
        # Heat grows with the square of the force.
        shares = [] if self.of_continuous is None else [self.of_continuous**2]
        shares += [] if self.heat_repeated is None else [self.heat_repeated]
        if self.of_peak is not None and self.of_peak > 1.0:
            return "beyond the peak force"
        if not shares:
            return "no continuous force stated"
        most = max(shares)
        return "trips" if most >= TRIP else "warns" if most >= WARN else "fits"

    def table(self) -> Table:
        """Return a table with one row for the axis."""
        return _table([self], Text(f"load of axis {self.axis} over {Quantity(self.duration, 's'):SI}"))


@dataclass(frozen=True, eq=False, repr=False)
class SpindleLoad(Result):
    """The power and energy of the spindle.

    power, peak      mean and peak power, W
    energy           energy, J
    volume           removed volume, m³; None if unknown
    specific_energy  energy per volume, J/m³
    """

    power: float
    peak: float
    energy: float
    volume: float | None
    specific_energy: float | None

    def table(self) -> Table:
        """Return a table with one row for the spindle."""
        columns = [
            "",
            Column("mean", "W"),
            Column("peak", "W"),
            Column("energy", "J"),
            Column("energy by volume", "J/m3", "4 J/mm3"),
        ]
        return Table("spindle", columns, [["spindle", self.power, self.peak, self.energy, self.specific_energy]])


@dataclass(frozen=True, eq=False, repr=False)
class MachineLoad(Result):
    """The load of all axes, and of the spindle if known."""

    axes: Mapping[str, AxisLoad]
    spindle: SpindleLoad | None = field(default=None)

    def energy(self, *, recovers: bool = True) -> float:
        """Return the total energy in J: mechanical energy of the axes, known winding losses and spindle energy."""
        total = sum((axis.work if recovers else axis.drawn) + (axis.loss or 0.0) for axis in self.axes.values())
        return total + (0.0 if self.spindle is None else self.spindle.energy)

    def table(self) -> Table:
        """Return a table with one row for each axis, and the total energy in its title."""
        spindle = "" if self.spindle is None else Text(f", {Quantity(self.spindle.energy, 'J')} of them by the spindle")
        title = Text(
            f"load: {Quantity(self.energy(), 'J')} with recovery, {Quantity(self.energy(recovers=False), 'J')} "
            f"without{spindle}"
        )
        return _table(list(self.axes.values()), title)


def _table(rows: list[AxisLoad], title: str) -> Table:
    columns = [
        "axis",
        "RMS",
        "of continuous",
        "peak",
        "of peak",
        "heat, repeated",
        Column("copper", "W"),
        Column("work", "J"),
        Column("drawn", "J"),
        "",
    ]
    lines: list[list[str | float | Quantity | None]] = []
    for load in rows:
        unit = turning("N") if load.turning else "N"
        of_continuous, of_peak, heat = map(_percent, (load.of_continuous, load.of_peak, load.heat_repeated))
        lines.append(
            [
                load.axis,
                Quantity(load.rms, unit),
                of_continuous,
                Quantity(load.peak, unit),
                of_peak,
                heat,
                load.copper_loss,
                load.work,
                load.drawn,
                load.verdict,
            ]
        )
    return Table(title, columns, lines)


def _percent(share: float | None) -> Quantity | None:
    return None if share is None else Quantity(share, "share", form="3")


def axis_load(
    force: np.ndarray,
    position: np.ndarray,
    sample_time: float,
    *,
    continuous_force: float | None = None,
    peak_force: float | None = None,
    motor_constant: float | None = None,
    time_constant: float | None = None,
    axis: str = "x",
    turning: bool = False,
) -> AxisLoad:
    """Compute the load of a motor from its force, which is held over each sample.

        F_rms² = mean F²,   θ' = ((F / F_continuous)² - θ) / τ,   loss = (F / K_m)²,   work = Σ F(k) (x(k+1) - x(k))

    force           motor force, N, shape (n,)
    position        position at each sample and at the end of the last one, m, shape (n + 1,)
    motor_constant  K_m, N/√W: force per square root of the winding loss
    time_constant   τ, thermal time constant of the winding, s

    Raises ParameterError for arrays that do not match, numbers that are not finite, and constants that are not > 0.
    """
    force, position = np.asarray(force, dtype=np.float64), np.asarray(position, dtype=np.float64)
    if force.ndim != 1 or not len(force) or position.shape != (len(force) + 1,):
        raise ParameterError(
            f"axis {axis}: {np.size(force)} forces need one position more, the end of the last sample, not "
            f"{np.size(position)}"
        )
    if not (np.all(np.isfinite(force)) and np.all(np.isfinite(position))):
        raise ParameterError(f"axis {axis}: a force or a position is not finite")
    constants = {
        "sample_time": (sample_time, "s"),
        "continuous_force": (continuous_force, "N"),
        "peak_force": (peak_force, "N"),
        "motor_constant": (motor_constant, "N/W^0.5"),
        "time_constant": (time_constant, "s"),
    }
    for name, (value, unit) in constants.items():
        if value is not None and not 0.0 < value < float("inf"):
            raise ParameterError(
                f"axis {axis}: {name} = {Quantity(value, unit):6 SI} must be finite and > 0 {unit_name(unit, 'SI')}"
            )
    work = force * np.diff(position)
    rms = float(np.sqrt(np.mean(force * force)))
    heat = repeated = None
    if continuous_force is not None and time_constant is not None:
        # exact for a force that is held; expm1, since a sample is about a millionth of the time constant
        stays = np.exp(-sample_time / time_constant)
        heating = -np.expm1(-sample_time / time_constant) * (force / continuous_force) ** 2
        # Deferred: the import takes a second, for which reading a plan need not wait.
        from scipy.signal import lfilter

        heat = np.concatenate([[0.0], lfilter([1.0], [1.0, -stays], heating)])
        left = np.exp(-np.arange(len(heat)) * (sample_time / time_constant))
        # a cycle that repeats begins as warm as it ends
        repeated = float(np.max(heat + left * heat[-1] / -np.expm1(-len(force) * sample_time / time_constant)))
    return AxisLoad(
        axis=axis,
        sample_time=sample_time,
        force=force,
        rms=rms,
        peak=float(np.max(np.abs(force))),
        continuous_force=continuous_force,
        peak_force=peak_force,
        time_constant=time_constant,
        heat=heat,
        heat_repeated=repeated,
        copper_loss=None if motor_constant is None else (rms / motor_constant) ** 2,
        work=float(np.sum(work)),
        # Per sample: energy from braking in one sample does not supply another without a store.
        drawn=float(np.sum(np.maximum(work, 0.0))),
        turning=turning,
    )


def spindle_load(
    torque: np.ndarray, spindle_speed: float | np.ndarray, sample_time: float, volume: float | None = None
) -> SpindleLoad:
    """Compute power = torque · ω and energy of a spindle.

    torque         spindle torque, N m, shape (n,)
    spindle_speed  spindle speed, rpm: one number, or one per sample
    volume         removed volume for the specific energy, m³

    Raises ParameterError for numbers that are not finite and a volume that is not > 0.
    """
    power = np.asarray(torque, dtype=np.float64) * np.asarray(spindle_speed, dtype=np.float64) * (np.pi / 30.0)
    if not power.size or not np.all(np.isfinite(power)):
        raise ParameterError("the power of the spindle needs torques and speeds that are finite")
    if volume is not None and not volume > 0.0:
        raise ParameterError(
            f"volume = {Quantity(volume, 'm3'):6} of chips must be > 0 m3: leave it out where nothing is cut"
        )
    energy = float(np.sum(power)) * sample_time
    specific = None if volume is None else energy / volume
    return SpindleLoad(float(np.mean(power)), float(np.max(np.abs(power))), energy, volume, specific)


def machine_load(
    run: Run,
    system: System,
    *,
    motor_constant: Mapping[str, float] | None = None,
    time_constant: Mapping[str, float] | None = None,
    spindle: SpindleLoad | None = None,
) -> MachineLoad:
    """Compute the load of each axis of a run, with the motor limits of the machine file.

    The force of the last substep (`drive_force`) is taken as constant over the sample: with a dead time that is not a
    whole number of samples, or with a slow current loop, the energy is accurate to first order in the sample time.
    The last sample of the run is left out, since its motion is not recorded.

    Constants are given by axis.  Raises ParameterError for a run without `drive_force` and `position_motor` of an axis,
    for fewer than two samples, and for an unknown axis.
    """
    check_system(system)
    loops: dict[str, Loop] = dict(zip(system.ports(), system.loops().values(), strict=True))
    names = dict(zip(system.ports(), system.loops(), strict=True))
    by_axis = (motor_constant or {}, time_constant or {})
    for constants in by_axis:
        absent = [name for name in constants if name not in names.values()]
        if absent:
            raise ParameterError(f"there is no axis '{absent[0]}'; there are {', '.join(names.values())}")
    if run.samples < 2:
        raise ParameterError("a load needs a run of two samples or more")
    loads: dict[str, AxisLoad] = {}
    for port, loop in loops.items():
        name = names[port]
        peak, continuous = (None, None) if loop.axis.actuator.motor is None else loop.axis.actuator.motor.limits()
        loads[name] = axis_load(
            run[f"{port}drive_force"][:-1],
            run[f"{port}position_motor"],
            run.sample_time,
            continuous_force=None if continuous is None else float(continuous),
            peak_force=None if peak is None else float(peak),
            motor_constant=by_axis[0].get(name),
            time_constant=by_axis[1].get(name),
            axis=name,
            turning=bool(loop.axis.rotary),
        )
    return MachineLoad(loads, spindle)
