"""Two axes without dry friction, and circles on them, for the tests of contour error and circle test."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.friction.viscous import Viscous
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.reference.circle import Circle
from feeddrive.files.machine import read_machine
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import Machine

MASS, VISCOUS, KV, KP, TN = 120.0, 400.0, 40.0, 4.5e4, 0.015


def axis(T: float = 2.5e-4, share: float = 1.0, Kv: float = KV, **physics: Any) -> Loop:
    """The axis of the golden values: a rigid mass with viscous friction under P-PI, exact in the linear core."""
    law = CascadePPI(Kv=Kv, Kp=KP, Tn=TN, velocity_feedforward=share)
    moved: dict[str, Any] = {"plant": Rigid(mass=MASS), "friction_load": Viscous(viscous=VISCOUS)} | physics
    return Loop(control=Control(law=law), axis=Axis(**moved), sample_time=T)


def smooth_xy_table() -> Machine:
    """The bundled x-y table without dry friction and without counts."""
    machine = read_machine("xy_table").machine()
    loops = {}
    for name, loop in machine.loops().items():
        physics = replace(loop.axis, friction_load=Viscous(viscous=VISCOUS), encoder_load=None)
        loops[name] = replace(loop, axis=physics, control=replace(loop.control, feedforward=()))
    return Machine.of(loops)


def circle(radius: float, feed: float, direction: int = 1, turns: float = 2.0) -> dict[str, Circle]:
    """The references of x and y on a circle about 0."""
    way = "counterclockwise" if direction > 0 else "clockwise"
    both = {"x": 0, "y": 90}
    return {
        name: Circle(radius=radius, feed=feed, turns=turns, phase=phase, direction=way, run_up_time=0.2)
        for name, phase in both.items()
    }


def response(omega: float, T: float | None, share: float, dead_time: float = 0.0) -> complex:
    """The closed loop of `axis` at a frequency in rad/s: continuous, or of the sampled law with the held plant."""
    if T is None:
        s = 1j * omega
        plant = np.exp(-s * dead_time) / (MASS * s * s + VISCOUS * s)
        control = KP * (1.0 + 1.0 / (TN * s))
        return plant * control * (KV + share * s) / (1.0 + plant * control * (s + KV))
    z = np.exp(1j * omega * T)
    slope = (1.0 - 1.0 / z) / T
    control = KP * (1.0 + (T / TN) / (1.0 - 1.0 / z))
    plant = held(z, T, dead_time)
    return control * (KV + share * slope) * plant / (1.0 + control * (KV + slope) * plant)


def held(z: complex, T: float, dead_time: float) -> complex:
    """1/(m s² + b s) behind a zero-order hold and a dead time: the force of sample k acts from kT + dead time on."""
    whole = int(dead_time / T)
    late = dead_time - whole * T
    a = VISCOUS / MASS

    def moved(t: float) -> np.ndarray:
        """Position and velocity from rest after a force of 1 N over t."""
        fast = -np.expm1(-a * t)
        return np.array([(t - fast / a) / VISCOUS, fast / VISCOUS])

    def free(t: float) -> np.ndarray:
        return np.array([[1.0, -np.expm1(-a * t) / a], [0.0, np.exp(-a * t)]])

    before, after = free(T - late) @ moved(late), moved(T - late)
    gain = np.linalg.solve(z * np.eye(2) - free(T), (before / z + after) / z**whole)
    return complex(gain[0])
