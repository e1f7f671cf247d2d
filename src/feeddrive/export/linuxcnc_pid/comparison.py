"""Differences on an axis between LinuxCNC's pids and the designed control: in simulation and in margins."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from feeddrive.analysis.margins import margins
from feeddrive.analysis.stability import require_stable, stability
from feeddrive.blocks.reference.jerk_limited_move import JerkLimitedMove
from feeddrive.export.linuxcnc_pid.mapping import stock_law, stock_loop
from feeddrive.export.parameters.quantities import Cascade
from feeddrive.language.errors import DivergedError, UnstableError
from feeddrive.loop.linearize import loop_gain
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import Run, simulate

LINES = 1500  # of the loop gain, from 1 Hz to half the sample rate
_DWELL = 0.3  # s after a move, in which overshoot shows


class Figure(NamedTuple):
    """One figure of both controls; None where it does not exist."""

    what: str
    unit: str
    design: float | None
    stock: float | None


@dataclass(frozen=True)
class Difference:
    """The figures, and the two moves by which they were made."""

    figures: tuple[Figure, ...]
    move: JerkLimitedMove
    saturating: JerkLimitedMove | None


def require_stable_pids(cascade: Cascade, stock: Loop, route: str, units: float) -> None:
    """Raise UnstableError, with gains that would do, if the pids do not hold the axis."""
    require_stable(cascade.loop, where="the design")
    found = stability(stock)
    if found.stable:
        return
    hint = ""
    for share in np.linspace(0.95, 0.05, 19):
        law = replace(
            cascade.law,
            Kv=cascade.law.Kv * share,
            Kp=cascade.law.Kp * share,
            Tn=None if cascade.law.Tn is None else cascade.law.Tn / share,
        )
        slower = replace(cascade.loop, control=replace(cascade.loop.control, law=law))
        values = {**cascade.values, "Kv": law.Kv, "Kp": law.Kp, "Tn": law.Tn}
        values["Kp/Tn"] = None if law.Tn is None else law.Kp / law.Tn
        trial = Cascade(slower, law, values)
        if stability(stock_loop(trial, stock_law(trial, route=route, units=units))).stable:
            hint = (
                f"; with Kv = {law.Kv:.4g} 1/s, Kp = {law.Kp:.4g} N s/m"
                + ("" if law.Tn is None else f" and Tn = {law.Tn:.4g} s")
                + f" ({share:.0%}) it would be stable, at its edge"
            )
            break
    raise UnstableError(
        f"LinuxCNC's pid does not hold this axis, though the design does: {found.sentence()}{hint}; see what it cannot "
        f"hold, or export with the target linuxcnc, which computes the design itself"
    )


def difference(cascade: Cascade, stock: Loop) -> Difference:
    """The figures of both controls on the same axis, along the same moves."""
    move, saturating = moves(cascade.loop)
    figures = [*_margins(cascade.loop, stock)]
    designed, by_pid = (_run(loop, move) for loop in (cascade.loop, stock))
    figures += _along("a move", designed, by_pid)
    if saturating is not None:
        both = [_run(_free(loop), saturating) for loop in (cascade.loop, stock)]
        figures += _along("a move beyond the force limit", *both)
        figures.append(
            Figure(
                "largest following error after that move has ended", "um",
                *(_after(run, saturating) for run in both),
            )
        )  # fmt: skip
    return Difference(tuple(figures), move, saturating)


def moves(loop: Loop) -> tuple[JerkLimitedMove, JerkLimitedMove | None]:
    """A move at 40 % of the force limit, and one at 150 % where there is a limit.

    Half the velocity limit, at most 0.3 m/s; the acceleration is reached in 20 ms, or in 5 ms beyond the limit; within
    the travel.
    """
    guard, motor = loop.control.guard, loop.axis.actuator.motor
    mass, limit = float(loop.axis.plant.rigid_mass()), loop.control.force_limit
    speeds = [None if guard is None else guard.velocity_limit, None if motor is None else motor.velocity_limit()]
    velocity = min([0.3, *(0.5 * float(speed) for speed in speeds if speed is not None)])
    acceleration = 2.0 if limit is None else min(0.4 * limit / mass, 20.0)
    ends = (None, None) if guard is None else (guard.travel_least, guard.travel_most)
    first, distance = 0.0, 0.1
    if ends[0] is not None and ends[1] is not None:
        first, distance = 0.75 * ends[0] + 0.25 * ends[1], min(distance, 0.5 * (ends[1] - ends[0]))
    elif ends[0] is not None:
        first = ends[0] + 0.1
    elif ends[1] is not None:
        first = ends[1] - 0.2

    def move(acceleration: float, rise: float, *, back: bool) -> JerkLimitedMove:
        return JerkLimitedMove(
            distance=distance,
            start=first,
            velocity=velocity,
            acceleration=acceleration,
            jerk=acceleration / rise,
            back=back,
            dwell_after=_DWELL,
        )

    beyond = None if limit is None else move(1.5 * limit / mass, 0.005, back=False)
    return move(acceleration, 0.02, back=True), beyond


def _free(loop: Loop) -> Loop:
    """Without the trip that a saturated axis would soon meet."""
    guard = loop.control.guard
    if guard is None:
        return loop
    return replace(loop, control=replace(loop.control, guard=replace(guard, following_error_limit=None)))


def _run(loop: Loop, move: JerkLimitedMove) -> Run | None:
    """The run, or None if it leaves all bounds."""
    try:
        return simulate(loop, move, record=("set_velocity", "following_error", "force"))
    except DivergedError:
        return None


def _along(what: str, *runs: Run | None) -> list[Figure]:
    """Following error and force of both runs along a move."""
    errors = [None if run is None else run["following_error"] for run in runs]
    peaks = [None if e is None else 1e6 * float(np.max(np.abs(e))) for e in errors]
    means = [None if e is None else 1e6 * float(np.sqrt(np.mean(e * e))) for e in errors]
    forces = [None if run is None else float(np.max(np.abs(run["force"]))) for run in runs]
    return [
        Figure(f"largest following error along {what}", "um", *peaks),
        Figure(f"RMS following error along {what}", "um", *means),
        Figure(f"largest force along {what}", "N", *forces),
    ]


def _after(run: Run | None, move: JerkLimitedMove) -> float | None:
    if run is None:
        return None
    ended = run.time >= move.dwell_before + move.leg_time
    return 1e6 * float(np.max(np.abs(run["following_error"][ended])))


def _margins(*loops: Loop) -> list[Figure]:
    """Crossover and margins of the loop opened at the actuator, sliding."""
    found = []
    for loop in loops:
        frequency = np.geomspace(1.0, 0.5 / loop.sample_time, LINES)
        made = margins(loop_gain(loop, frequency))
        found.append((made.crossover, made.phase_margin_deg, made.gain_increase_dB, made.sensitivity_peak))
    names = (("crossover", "Hz"), ("phase margin", "degrees"), ("gain may rise by", "dB"), ("Ms", "1"))
    return [Figure(name, unit, *pair) for (name, unit), pair in zip(names, zip(*found, strict=True), strict=True)]
