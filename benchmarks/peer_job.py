"""The job of the peers: a two-mass ball screw under P-PI control, 2 s at 20 kHz, in numbers and in plain functions.

All forces and motions are seen at the table.  Friction is Coulomb's with tanh(v / 0.1 mm/s) in place of the sign and
viscous, on both bodies.  The law is a P position loop over a PI velocity loop with velocity, acceleration and friction
feedforward, a force limit that does act, and an integral that is held while the limit acts and the error would drive
it further out.  The force acts one sample later.  From 1.3 s to 1.7 s a force of 500 N pulls at the table.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from types import FunctionType
from typing import Any

import numpy as np

from feeddrive.blocks.reference.jerk_limited_move import JerkLimitedMove

T, SAMPLES = 50e-6, 40_000
PER_METER = 2.0 * math.pi / 0.01  # rad of the screw per m of the table
MASS_MOTOR, MASS_LOAD = 1.2e-3 * PER_METER**2, 200.0  # kg
STIFFNESS, DAMPING = 1.5e8, 4000.0  # N/m, N s/m
VISCOUS_MOTOR, VISCOUS_LOAD = 800.0, 400.0  # N s/m
COULOMB_MOTOR, COULOMB_LOAD = 150.0, 100.0  # N
TANH_VELOCITY = 1e-4  # m/s
KV, TN = 60.0, 0.01  # 1/s, s
KP = 2.0 * math.pi * 60.0 * (MASS_MOTOR + MASS_LOAD)  # N s/m: the velocity loop crosses over at 60 Hz
FORCE_LIMIT = 7.0 * PER_METER  # N: 7 N m
COUNT_MOTOR, COUNT_LOAD = 0.01 / 2**20, 1e-8  # m


def reference() -> JerkLimitedMove:
    """0.4 m at 0.5 m/s, 5 m/s² and 100 m/s³, then rest."""
    limits: dict[str, Any] = {"distance": 0.4, "velocity": 0.5, "acceleration": 5.0, "jerk": 100.0}
    rest = (SAMPLES - 1) * T - JerkLimitedMove(**limits).duration
    return JerkLimitedMove(**limits, dwell_after=rest)


def given() -> np.ndarray:
    """What the loop is given, (SAMPLES, 4): set position, its backward velocity, feedforward force, load force."""
    t = np.arange(SAMPLES) * T
    setpoint = reference().at(t)
    middle = setpoint.shifted(0.5 * T)
    feed = (MASS_MOTOR + MASS_LOAD) * middle.acceleration + (VISCOUS_MOTOR + VISCOUS_LOAD) * middle.velocity
    load = np.where((t >= 1.3) & (t < 1.7), 500.0, 0.0)
    return np.ascontiguousarray(np.column_stack([setpoint.position, setpoint.backward_velocity(T), feed, load]))


def control(
    x1: float, x2: float, last: float, integral: float, position: float, velocity: float, feed: float
) -> tuple[float, float, float]:
    """One sample of the law: the reading of the motor, the new integral, the force."""
    motor = COUNT_MOTOR * math.floor(x1 / COUNT_MOTOR + 0.5)
    load = COUNT_LOAD * math.floor(x2 / COUNT_LOAD + 0.5)
    e = KV * (position - load) + velocity - (motor - last) / T
    trial = integral + KP * T / TN * e
    wanted = KP * e + trial + feed
    force = min(max(wanted, -FORCE_LIMIT), FORCE_LIMIT)
    if wanted == force or (wanted - force) * e < 0.0:
        integral = trial
    return motor, integral, force


def rates(x1: float, x2: float, v1: float, v2: float, force: float, load: float) -> tuple[float, float, float, float]:
    """d/dt of x1, x2, v1, v2."""
    spring = STIFFNESS * (x1 - x2) + DAMPING * (v1 - v2)
    friction1 = COULOMB_MOTOR * math.tanh(v1 / TANH_VELOCITY) + VISCOUS_MOTOR * v1
    friction2 = COULOMB_LOAD * math.tanh(v2 / TANH_VELOCITY) + VISCOUS_LOAD * v2
    return v1, v2, (force - spring - friction1) / MASS_MOTOR, (spring - friction2 + load) / MASS_LOAD


def advance(x1: float, x2: float, v1: float, v2: float, force: float, load: float) -> tuple[float, float, float, float]:
    """One Runge-Kutta step of 4th order over a sample."""
    a1, a2, a3, a4 = rates(x1, x2, v1, v2, force, load)
    h = 0.5 * T
    b1, b2, b3, b4 = rates(x1 + h * a1, x2 + h * a2, v1 + h * a3, v2 + h * a4, force, load)
    c1, c2, c3, c4 = rates(x1 + h * b1, x2 + h * b2, v1 + h * b3, v2 + h * b4, force, load)
    d1, d2, d3, d4 = rates(x1 + T * c1, x2 + T * c2, v1 + T * c3, v2 + T * c4, force, load)
    s = T / 6.0
    return (
        x1 + s * (a1 + 2.0 * b1 + 2.0 * c1 + d1),
        x2 + s * (a2 + 2.0 * b2 + 2.0 * c2 + d2),
        v1 + s * (a3 + 2.0 * b3 + 2.0 * c3 + d3),
        v2 + s * (a4 + 2.0 * b4 + 2.0 * c4 + d4),
    )


def bound(function: Callable[..., Any], **names: Any) -> Any:
    """The same function with other meanings of global names: `math` of another library, a compiled `rates`."""
    return FunctionType(function.__code__, {**function.__globals__, **names}, function.__name__)
