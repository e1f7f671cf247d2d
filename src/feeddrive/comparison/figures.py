"""The duty of a comparison, derived from the limits of the machine, and the figures of one law on it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from feeddrive.analysis.loop_model import LoopModel
from feeddrive.analysis.step_response import settling_time
from feeddrive.blocks.families import Load, Reference
from feeddrive.blocks.load.step_force import StepForce
from feeddrive.blocks.reference.snap_limited_move import SnapLimitedMove
from feeddrive.figures.figure import Figure
from feeddrive.figures.linear_loop import LinearLoop
from feeddrive.figures.of_loops import (
    CROSSOVER,
    DELAY_MARGIN,
    EFFORT,
    FORCE_NOISE,
    NOISE_GAIN,
    PHASE_MARGIN,
    ROPE_SNAP,
    SENSITIVITY_PEAK,
    STIFFNESS_AT,
    STIFFNESS_LEAST,
    STIFFNESS_OVER,
    StiffnessAt,
    StiffnessOver,
)
from feeddrive.figures.of_runs import (
    FORCE_PEAK,
    FORCE_RMS,
    SNAP_PEAK,
    SNAP_SETTLING,
    STEP_PEAK,
    STEP_SETTLING,
    TRACKING_PEAK,
    TRACKING_RMS,
)
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import Run

TIE = 0.005  # share by which figures must differ to be ranked apart


CRITERIA = (
    ROPE_SNAP, *STIFFNESS_AT, TRACKING_RMS, TRACKING_PEAK, SNAP_PEAK, SNAP_SETTLING, STEP_PEAK, STEP_SETTLING,
    STIFFNESS_OVER[2], STIFFNESS_LEAST, FORCE_NOISE, EFFORT,
)  # fmt: skip
"""The figures by which laws are ranked."""
LINEAR = (
    SENSITIVITY_PEAK, DELAY_MARGIN, PHASE_MARGIN, CROSSOVER, ROPE_SNAP, FORCE_NOISE, NOISE_GAIN, *STIFFNESS_OVER,
    *STIFFNESS_AT, STIFFNESS_LEAST,
)  # fmt: skip
"""The figures of a law that come from its linear model."""


def ranks(criterion: Figure, figures: Sequence[Mapping[str, float | None]]) -> list[int | None]:
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


def beats(criterion: Figure, a: float, b: float) -> bool:
    """Whether a is better than b by more than a tie; two infinite values are equal."""
    better, worse = (b, a) if criterion.higher else (a, b)
    if math.isinf(better) or math.isinf(worse):
        return better < worse
    return better < (1.0 - TIE) * worse


def linear(loop: Loop, both: LoopModel) -> dict[str, float | None]:
    """Margins, rope-snap error, stiffness by band, noise in the force, effort; of a stable loop."""
    model = LinearLoop(loop, known=both)
    return effort_of(loop) | {figure.key: figure.value(model) for figure in LINEAR if _below(figure, model.nyquist)}


def _below(figure: Figure, nyquist: float) -> bool:
    """Return True for a figure whose frequencies lie below half the sample rate."""
    of: Any = figure.of
    if isinstance(of, StiffnessAt):
        return of.frequency < nyquist
    return of.high <= nyquist if isinstance(of, StiffnessOver) else True


def effort_of(loop: Loop) -> dict[str, float | None]:
    """Return the operations of one sample."""
    return {EFFORT.key: EFFORT.read(LinearLoop(loop))}


def counted(run: Run, duty: Duty) -> Run:
    """The run without the standstill at its start, in which a hanging axis finds its force."""
    skip = int(np.searchsorted(run.time, duty.skip))
    signals = {name: values[skip:] for name, values in run.signals.items()}
    return replace(run, signals=signals, samples=run.samples - skip, first=run.first + skip)


def tracked(run: Run) -> dict[str, float | None]:
    """Tracking error and force along the move."""
    error, force = run["tracking_error"], run["force"]
    return {
        TRACKING_RMS.key: rms(error),
        TRACKING_PEAK.key: float(np.max(np.abs(error))),
        FORCE_RMS.key: rms(force),
        FORCE_PEAK.key: float(np.max(np.abs(force))),
    }


def rms(values: np.ndarray) -> float:
    """The root of the mean square."""
    return float(np.sqrt(np.mean(values**2)))


def recovered(run: Run, duty: Duty, peak: Figure, settling: Figure) -> dict[str, float | None]:
    """Largest error after the force changed, and how long it stays further from 0 than `near`; infinite to the end."""
    begin = int(np.searchsorted(run.time, duty.begin - 1e-9))
    error = np.abs(run["tracking_error"][begin:])
    settled = settling_time(run.sample_time * np.arange(error.size), error, duty.near)
    return {peak.key: float(np.max(error)), settling.key: settled}


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
