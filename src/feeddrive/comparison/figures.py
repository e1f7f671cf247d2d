"""The duty of a comparison, derived from the limits of the machine, and the figures of one law on it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from feeddrive.analysis.effort import effort
from feeddrive.analysis.loop_model import LoopModel
from feeddrive.analysis.margins import margins
from feeddrive.analysis.step_response import settling_time
from feeddrive.analysis.stiffness import Stiffness, force_noise, reading_deviation, rope_snap, stiffness
from feeddrive.blocks.families import Load, Reference
from feeddrive.blocks.load.step_force import StepForce
from feeddrive.blocks.reference.snap_limited_move import SnapLimitedMove
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Column
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import Run

TIE = 0.005  # share by which figures must differ to be ranked apart


class Criterion(NamedTuple):
    """A figure by which laws are ranked: its name in files, its head in tables, its SI unit, and what is better."""

    key: str
    head: str
    unit: str
    higher: bool = False

    def column(self) -> Column:
        """Return the column of this figure in a table."""
        return Column(self.head, self.unit, "3")

    def quantity(self, value: float) -> Quantity:
        """Return a value of this figure, read to three digits."""
        return Quantity(value, self.unit, form="3")


CRITERIA = (
    Criterion("rope_snap_ISE_root_m_per_N", "rope snap ISE^½", "m √s/N"),
    Criterion("stiffness_10_Hz_N_per_m", "stiffness at 10 Hz", "N/m", higher=True),
    Criterion("stiffness_100_Hz_N_per_m", "stiffness at 100 Hz", "N/m", higher=True),
    Criterion("tracking_error_rms_m", "tracking RMS", "m"),
    Criterion("tracking_error_peak_m", "tracking peak", "m"),
    Criterion("snap_peak_m", "rope snap peak", "m"),
    Criterion("snap_settling_s", "rope snap settling", "s"),
    Criterion("step_peak_m", "force step peak", "m"),
    Criterion("step_settling_s", "force step settling", "s"),
    Criterion("stiffness_100_1000_Hz_N_per_m", "stiffness 100-1000 Hz", "N/m", higher=True),
    Criterion("stiffness_least_N_per_m", "least stiffness", "N/m", higher=True),
    Criterion("force_noise_N", "noise in the force, RMS", "N"),
    Criterion("operations", "effort", "operations a sample"),
)


def ranks(criterion: Criterion, figures: Sequence[Mapping[str, float | None]]) -> list[int | None]:
    """The place of each law, 1 for the best; those within half a percent share one, and what has no figure has none.

    What is infinite (a law that never settles, a force that is never held) has a figure: the last place.
    """
    values = [row.get(criterion.key) for row in figures]
    found: list[int | None] = []
    for value in values:
        better = sum(
            1 for other in values if value is not None and other is not None and beats(criterion, other, value)
        )
        found.append(None if value is None else 1 + better)
    return found


def beats(criterion: Criterion, a: float, b: float) -> bool:
    """Whether a is better than b by more than a tie; two infinite values are equal."""
    better, worse = (b, a) if criterion.higher else (a, b)
    if math.isinf(better) or math.isinf(worse):
        return better < worse
    return better < (1.0 - TIE) * worse


AT = (10.0, 100.0)  # Hz
BANDS = ((1.0, 10.0), (10.0, 100.0), (100.0, 1000.0))  # Hz
_LINES = 60  # of a band


def linear(loop: Loop, both: LoopModel) -> dict[str, float | None]:
    """Margins, rope-snap error, stiffness by band, noise in the force, effort; of a stable loop."""
    found: dict[str, float | None] = dict(effort_of(loop))
    lines = both.lines(200)
    of = margins(both.loop_gain(lines))
    delay = of.delay_margin_samples
    found |= {
        "sensitivity_peak": of.sensitivity_peak,
        "delay_margin_samples": math.inf if delay is None else delay,
        "phase_margin_deg": of.phase_margin_deg,
        "crossover_Hz": of.crossover,
        "rope_snap_ISE_root_m_per_N": rope_snap(both.closed),
        "force_noise_N": _noise(loop, both),
        "noise_gain_N_per_m": noise_gain(loop, both),
    }
    nyquist = 0.5 / float(loop.sample_time)
    for low, high in BANDS:
        if high <= nyquist:
            band = np.geomspace(low, high, _LINES)
            found[f"stiffness_{low:g}_{high:g}_Hz_N_per_m"] = _stiffness(both, band).mean
    for frequency in AT:
        if frequency < nyquist:
            found[f"stiffness_{frequency:g}_Hz_N_per_m"] = _stiffness(both, np.array([frequency])).at(frequency)
    inside = lines[lines >= min(BANDS[0][0], 0.01 * nyquist)]
    found["stiffness_least_N_per_m"] = _stiffness(both, inside).minimum
    return found


def _stiffness(both: LoopModel, frequency: np.ndarray) -> Stiffness:
    return stiffness(both.closed.response(frequency, "position_load", "load_force"))


def effort_of(loop: Loop) -> dict[str, float]:
    """Operations of one sample."""
    return {"operations": float(effort(loop).total)}


def noise_gain(loop: Loop, both: LoopModel) -> float:
    """RMS of the force per RMS of white noise, alike in all readings and independent, N/m: by this it is bounded."""
    one = loop.axis.one_encoder()
    return force_noise(both.closed, 0.0 if one else 1.0, 1.0, shared=one)


def _noise(loop: Loop, both: LoopModel) -> float | None:
    """RMS of the force by counts and noise of the encoders; None if they have neither."""
    axis = loop.axis
    motor, load = reading_deviation(axis.encoder_motor), reading_deviation(axis.encoder_load)
    if motor == 0.0 and load == 0.0:
        return None
    if axis.one_encoder():
        return force_noise(both.closed, 0.0, motor + load, shared=True)
    return force_noise(both.closed, motor, load)


def counted(run: Run, duty: Duty) -> Run:
    """The run without the standstill at its start, in which a hanging axis finds its force."""
    skip = int(np.searchsorted(run.time, duty.skip))
    signals = {name: values[skip:] for name, values in run.signals.items()}
    return replace(run, signals=signals, samples=run.samples - skip, first=run.first + skip)


def tracked(run: Run) -> dict[str, float | None]:
    """Tracking error and force along the move."""
    error, force = run["tracking_error"], run["force"]
    return {
        "tracking_error_rms_m": rms(error),
        "tracking_error_peak_m": float(np.max(np.abs(error))),
        "force_rms_N": rms(force),
        "force_peak_N": float(np.max(np.abs(force))),
    }


def rms(values: np.ndarray) -> float:
    """The root of the mean square."""
    return float(np.sqrt(np.mean(values**2)))


def recovered(run: Run, duty: Duty, name: str) -> dict[str, float | None]:
    """Largest error after the force changed, and how long it stays further from 0 than `near`; infinite to the end."""
    begin = int(np.searchsorted(run.time, duty.begin - 1e-9))
    error = np.abs(run["tracking_error"][begin:])
    settled = settling_time(run.sample_time * np.arange(error.size), error, duty.near)
    return {f"{name}_peak_m": float(np.max(error)), f"{name}_settling_s": settled}


_SPEED_SHARE, _SPEED, _SPEED_ALONE = 0.5, 1.0, 0.2  # of the limit; at most, m/s; where no limit is stated
_FORCE_SHARE, _ACCELERATION, _FORCE_ALONE = 0.3, 10.0, 2.0  # of the force limit; at most, and without one, m/s²
_JERK, _SNAP = 80.0, 100.0  # 1/s: jerk over acceleration and snap over jerk, as a small machining center has them
_DWELL, _REST = 0.5, 0.3  # s before and after a leg
_STEP_SHARE, _STEP_FRICTION, _STEP_MOST = 0.05, 5.0, 0.5  # force step: of the limit; of dry friction; at most
_STEP_ALONE = 100.0  # N, without a limit
_NEAR = 0.5e-6  # m: settled is what stays within, or within ten counts


@dataclass(frozen=True)
class Duty:
    """One move (there and back), and a force in N that is released and switched on at `begin` s for `rest` s.

    `skip` is the standstill in s at the start that does not count; `near` in m is what counts as settled; `cut` acts
    on the axis at rest.
    """

    move: Reference
    force: float
    near: float
    skip: float = 0.8 * _DWELL
    begin: float = 1.0
    rest: float = 1.0
    cut: Load | None = None

    @property
    def snap(self) -> StepForce:
        """The rope: it pulls the table back with `force` until `begin`, and is cut."""
        return StepForce(force=-self.force, start=0.0, end=self.begin)

    @property
    def step(self) -> StepForce:
        """The step: `force` from `begin` on."""
        return StepForce(force=self.force, start=self.begin)

    def still(self) -> SnapLimitedMove:
        """No motion."""
        return SnapLimitedMove(distance=0.0, velocity=1.0, acceleration=1.0, jerk=1.0, snap=1.0)


def duty_of(loop: Loop, reference: Reference | None = None, force: float | None = None) -> Duty:
    """The work of an axis, from its limits of force and velocity; a reference and a force in N may be given.

    Speed: half of the limit of guard and motor, 1 m/s at most, 0.2 m/s without one.  Acceleration: what 30 % of the
    force limit gives, 10 m/s² at most.  The move is long enough to reach both.  Force: a twentieth of the limit, but
    five times the dry friction, so that the axis moves.
    Raises ParameterError for a force that is not positive.
    """
    mass = float(loop.axis.plant.rigid_mass())
    motor = loop.axis.actuator.motor
    guard = loop.control.guard
    peaks = [each for each in (loop.control.force_limit, None if motor is None else motor.limits()[0]) if each]
    limit = min(peaks, default=None)
    speeds = [
        each
        for each in (None if guard is None else guard.velocity_limit, None if motor is None else motor.velocity_limit())
        if each
    ]
    friction = _dry_friction(loop)
    if force is None:
        least = _STEP_FRICTION * friction
        force = _STEP_ALONE + least if limit is None else min(max(_STEP_SHARE * limit, least), _STEP_MOST * limit)
    if not (force > 0.0 and math.isfinite(force)):
        raise ParameterError(f"force = {Quantity(force, 'N'):6} must be a finite force > 0 N")
    if reference is None:
        v = min(_SPEED_SHARE * min(speeds), _SPEED) if speeds else _SPEED_ALONE
        a = _FORCE_ALONE if limit is None else min(_FORCE_SHARE * limit / mass, _ACCELERATION)
        v, a = _rounded(v), _rounded(a)
        reference = SnapLimitedMove(
            distance=_rounded(3.0 * v * v / a), velocity=v, acceleration=a, jerk=_JERK * a, snap=_SNAP * _JERK * a,
            back=True, dwell_before=_DWELL, dwell_between=_REST, dwell_after=_REST,
        )  # fmt: skip
    encoders = (loop.axis.encoder_motor, loop.axis.encoder_load)
    counts = [getattr(each, "resolution", None) or 0.0 for each in encoders]
    return Duty(reference, _rounded(force), max(_NEAR, 10.0 * max(counts)))


def _dry_friction(loop: Loop) -> float:
    """The dry friction of the axis in N, creeping."""
    there = [each for each in (loop.axis.friction_motor, loop.axis.friction_load) if each is not None]
    creep = 1e-4
    return sum(abs(float(each.steady(creep))) for each in there)


def _rounded(value: float) -> float:
    """Rounded to two digits."""
    return float(f"{value:.2g}")
