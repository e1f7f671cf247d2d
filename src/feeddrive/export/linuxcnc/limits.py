"""Limits of the axis in the .ini file: velocity, acceleration and following error, checked in a simulation."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from feeddrive.blocks.reference.trapezoidal_move import TrapezoidalMove
from feeddrive.language.errors import DivergedError, ParameterError
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import simulate

_VELOCITIES = (0.5, 0.25, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001)  # m/s, tried one after the other
_RAMP = 0.2  # s from rest to the velocity, and of the way between two ramps
_SHARE = 0.7  # of the limits of force, following error and speed that a move may use
_MARGIN = 2.0  # between the following error of the move and FERROR


@dataclass(frozen=True)
class Limits:
    """Of an axis that LinuxCNC moves: velocity (m/s), acceleration (m/s2), following error (m), ends of the travel (m).

    `peak_error` (m) and `peak_force` (N) are those of the move in which the axis was tried; `travel_known` says whether
    the ends stand in the guard, or are made up.
    """

    velocity: float
    acceleration: float
    following_error: float
    least: float
    most: float
    peak_error: float
    peak_force: float
    travel_known: bool


def limits(loop: Loop) -> Limits:
    """The fastest of some moves that leave a margin of 30 % to the limits of the control and of the motor.

    The move is LinuxCNC's own, a trapezoid of velocity.  Its following error is counted as LinuxCNC does, against the
    reading of one period later.  Raises ParameterError if even the slowest move is too much.
    """
    least, most = _travel(loop)
    found = None
    for velocity in _VELOCITIES:
        found = _tried(loop, velocity, least, most)
        if found is not None:
            break
    if found is None:
        raise ParameterError(
            f"the axis cannot be moved at {_VELOCITIES[-1]:g} m/s within 70 % of its limits of force, following error "
            f"and speed: LinuxCNC would switch it off at once; look at the simulation of this loop first"
        )
    return found


def _travel(loop: Loop) -> tuple[float, float]:
    """Ends of the travel in m: those of the guard, else half a metre either way."""
    guard = loop.control.guard
    least, most = (None, None) if guard is None else (guard.travel_least, guard.travel_most)
    if least is not None and most is not None:
        return least, most
    if least is not None:
        return least, least + 1.0
    if most is not None:
        return most - 1.0, most
    return -0.5, 0.5


def _tried(loop: Loop, velocity: float, least: float, most: float) -> Limits | None:
    """The limits if the axis can be moved like this."""
    acceleration = velocity / _RAMP
    distance = 2.0 * _RAMP * velocity
    if distance > most - least:
        return None
    middle = 0.5 * (least + most)
    move = TrapezoidalMove(
        distance=distance, start=middle - 0.5 * distance, velocity=velocity, acceleration=acceleration, dwell_after=0.1
    )
    try:
        run = simulate(
            loop, move, record=("set_position", "reading_load", "requested", "force", "trip", "velocity_load")
        )
    except DivergedError:
        return None
    error = float(np.max(np.abs(run["set_position"][:-1] - run["reading_load"][1:])))
    force = float(np.max(np.abs(run["requested"])))
    speed = float(np.max(np.abs(run["velocity_load"])))
    guard, motor = loop.control.guard, loop.axis.actuator.motor
    forces = [loop.control.force_limit, None if motor is None else motor.limits()[0]]
    bounds = [(force, each) for each in forces]
    bounds.append((speed, None if motor is None else motor.velocity_limit()))
    if guard is not None:
        bounds += [(error, guard.following_error_limit), (speed, guard.velocity_limit)]
    if np.any(run["trip"] > 0.0) or any(bound is not None and value > _SHARE * bound for value, bound in bounds):
        return None
    known = guard is not None and guard.travel_least is not None and guard.travel_most is not None
    return Limits(velocity, acceleration, _rounded_up(_MARGIN * error), least, most, error, force, known)


def _rounded_up(value: float) -> float:
    """To 1, 2 or 5 times a power of ten, in m, and at least 10 um."""
    value = max(value, 1e-5)
    power = 10.0 ** math.floor(math.log10(value))
    return next(round(step * power, 9) for step in (1.0, 2.0, 5.0, 10.0) if step * power >= value * (1.0 - 1e-9))
