"""The duty (test sequence) for comparing laws: a move and force steps, scaled to the axis limits, and its runs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from feeddrive.analysis.step_response import settling_time
from feeddrive.blocks.families import Load, Reference
from feeddrive.blocks.load.step_force import StepForce
from feeddrive.blocks.reference.snap_limited_move import SnapLimitedMove
from feeddrive.figures.figure import Figure
from feeddrive.figures.of_runs import (
    CUTTING_RMS,
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
from feeddrive.language.units import rounded
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import Run, simulate

_SPEED_SHARE, _SPEED, _SPEED_ALONE = 0.5, 1.0, 0.2  # of the limit; at most, m/s; where no limit is stated
_FORCE_SHARE, _ACCELERATION, _FORCE_ALONE = 0.3, 10.0, 2.0  # of the force limit; at most, and without one, m/s²
_JERK, _SNAP = 80.0, 100.0  # 1/s: jerk over acceleration and snap over jerk, as a small machining center has them
_DWELL, _REST = 0.5, 0.3  # s before and after a leg
_STEP_SHARE, _STEP_FRICTION, _STEP_MOST = 0.05, 5.0, 0.5  # force step: of the limit; of dry friction; at most
_STEP_ALONE = 100.0  # N, without a limit
_NEAR = 0.5e-6  # m: settled is what stays within, or within ten counts


@dataclass(frozen=True)
class Duty:
    """The duty of a comparison: a move and, with the axis at rest, the release and the application of a force.

    move   the set motion
    force  force that is released or applied at `begin` (s), N; the run then lasts for another `rest` (s)
    near   settling band, m
    skip   duration of the initial standstill, which is excluded from the figures, s
    cut    cutting load on the axis at rest, or None
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
        """The release of a load: `force` pulls the table back until `begin`, like a rope that is then cut."""
        return StepForce(force=-self.force, start=0.0, end=self.begin)

    @property
    def step(self) -> StepForce:
        """The load step: `force` from `begin` onward."""
        return StepForce(force=self.force, start=self.begin)

    def still(self) -> SnapLimitedMove:
        """Return a reference without motion."""
        return SnapLimitedMove(distance=0.0, velocity=1.0, acceleration=1.0, jerk=1.0, snap=1.0)

    def sliding(self, loop: Loop) -> float:
        """Return half of the largest set speed, in m/s; 10 mm/s for a move without motion."""
        t = np.linspace(0.0, self.move.duration, 4001)
        # at samples only: a recorded reference refuses times between its rows
        t = np.unique(np.round(t / loop.sample_time)) * loop.sample_time
        largest = float(np.max(np.abs(self.move.at(t).velocity)))
        return 0.5 * largest if largest > 0.0 else 0.01

    def runs(self, loop: Loop, seed: int, name: str) -> DutyRuns:
        """Simulate a loop over the duty. Raises DivergedError for a loop that leaves its bounds."""
        move = self.counted(simulate(loop, self.move, seed=seed, name=name))
        at_rest = {
            what: simulate(
                loop,
                self.still(),
                load=load,
                duration=self.begin + self.rest,
                seed=seed,
                record=["tracking_error", "force", "trip"],
                name=name,
            )
            for what, load in {"snap": self.snap, "step": self.step, "cut": self.cut}.items()
            if load is not None
        }
        return DutyRuns(self, move, at_rest["snap"], at_rest["step"], at_rest.get("cut"))

    def counted(self, run: Run) -> Run:
        """Return the run without its initial standstill, in which a vertical axis builds up its holding force."""
        skip = int(np.searchsorted(run.time, self.skip))
        signals = {name: values[skip:] for name, values in run.signals.items()}
        return replace(run, signals=signals, samples=run.samples - skip, first=run.first + skip)

    def recovered(self, run: Run, peak: Figure, settling: Figure) -> dict[str, float | None]:
        """Return the largest error after the change of the force, and the time until it stays within `near`."""
        # the time kT of the sample at `begin` may be rounded to just below it
        begin = int(np.searchsorted(run.time, self.begin - 1e-9))
        error = np.abs(run["tracking_error"][begin:])
        settled = settling_time(run.sample_time * np.arange(error.size), error, self.near)
        return {peak.key: float(np.max(error)), settling.key: settled}


class DutyRuns(NamedTuple):
    """The runs of a loop over a duty: the move, the force release, the force step, and the cut."""

    duty: Duty
    move: Run
    snap: Run
    step: Run
    cut: Run | None

    @property
    def figures(self) -> Mapping[str, float | None]:
        """The figures of these runs by key, in SI units."""
        moved = _Statistics(self.move)
        along = (TRACKING_RMS, TRACKING_PEAK, FORCE_RMS, FORCE_PEAK)
        figures: dict[str, float | None] = {figure.key: figure.read(moved) for figure in along}
        figures |= self.duty.recovered(self.snap, SNAP_PEAK, SNAP_SETTLING)
        figures |= self.duty.recovered(self.step, STEP_PEAK, STEP_SETTLING)
        if self.cut is not None:
            figures[CUTTING_RMS.key] = _Statistics(self.duty.counted(self.cut)).rms("tracking_error")
        return figures

    @property
    def tripped(self) -> bool:
        """True if the guard tripped in one of the runs."""
        return any(bool(np.any(run["trip"] > 0.0)) for run in self[1:] if run is not None)


@dataclass(frozen=True)
class _Statistics:
    """The statistics of one run, with the interface that figures of a batch expect."""

    run: Run

    def rms(self, signal: str) -> float:
        return float(np.sqrt(np.mean(self.run[signal] ** 2)))

    def peak(self, signal: str) -> float:
        return float(np.max(np.abs(self.run[signal])))


def duty_of(loop: Loop, reference: Reference | None = None, force: float | None = None) -> Duty:
    """Return the duty of an axis, from its limits of force and velocity, or with a given reference or force in N.

    Speed: half of the lower limit of the guard and of the motor, at most 1 m/s; 0.2 m/s if there is no limit.
    Acceleration: that of 30 % of the force limit, at most 10 m/s²; 2 m/s² if there is no limit.  The move is long
    enough to reach both.  Force: a twentieth of the limit, or five times the dry friction if that is larger, so that
    the axis moves, but at most half of the limit; if there is no limit, 100 N more than five times the dry friction.
    Raises ParameterError for a force that is not positive.
    """
    mass = float(loop.axis.plant.rigid_mass())
    motor = loop.axis.actuator.motor
    guard = loop.control.guard
    peaks = [peak for peak in (loop.control.force_limit, None if motor is None else motor.limits()[0]) if peak]
    limit = min(peaks, default=None)
    speeds = [
        speed
        for speed in (
            None if guard is None else guard.velocity_limit,
            None if motor is None else motor.velocity_limit(),
        )
        if speed
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
        v, a = rounded(v, 2), rounded(a, 2)
        reference = SnapLimitedMove(
            # v²/a is enough only with unlimited jerk; the rest is for the ramps of the acceleration and a cruise
            distance=rounded(3.0 * v * v / a, 2),
            velocity=v,
            acceleration=a,
            jerk=_JERK * a,
            snap=_SNAP * _JERK * a,
            back=True,
            dwell_before=_DWELL,
            dwell_between=_REST,
            dwell_after=_REST,
        )
    encoders = (loop.axis.encoder_motor, loop.axis.encoder_load)
    counts = [getattr(encoder, "resolution", None) or 0.0 for encoder in encoders]
    return Duty(reference, rounded(force, 2), max(_NEAR, 10.0 * max(counts)))


def _dry_friction(loop: Loop) -> float:
    """Return the dry friction of the axis at creep speed, in N."""
    frictions = [friction for friction in (loop.axis.friction_motor, loop.axis.friction_load) if friction is not None]
    # m/s: so slow that the viscous part of `steady` is negligible
    creep = 1e-4
    return sum(abs(float(friction.steady(creep))) for friction in frictions)
