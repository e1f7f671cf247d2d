"""The duty of a comparison: one move, one rope snap and one force step, derived from the limits of the machine."""

from __future__ import annotations

import math
from dataclasses import dataclass

from feeddrive.blocks.families import Reference
from feeddrive.blocks.load.step_force import StepForce
from feeddrive.blocks.reference.snap_limited_move import SnapLimitedMove
from feeddrive.language.errors import ParameterError
from feeddrive.loop.loop import Loop

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

    `skip` is the standstill in s at the start that does not count; `near` in m is what counts as settled.
    """

    move: Reference
    force: float
    near: float
    skip: float = 0.8 * _DWELL
    begin: float = 1.0
    rest: float = 1.0

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
        raise ParameterError(f"force = {force:g} N must be a finite force > 0 N")
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
