"""The common ground of the laws of the field: two axes, golden stimulus, and how a loop is judged."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from feeddrive.analysis.loop_model import loop_model
from feeddrive.analysis.margins import margins
from feeddrive.analysis.stability import stability
from feeddrive.analysis.stiffness import force_noise, rope_snap, stiffness
from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.families import Compensation, Law, Plant
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.blocks.reference.recorded import Recorded
from feeddrive.blocks.sensor.encoder import Encoder
from feeddrive.blocks.signals import Setpoint
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.guard import Guard
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import simulate

T = 1e-4  # s
R = Rigid(mass=40.0, viscous=60.0)
W = TwoMass(mass_motor=130.0, mass_load=33.0, stiffness=1.8e7, damping=700.0, viscous_motor=1500.0, viscous_load=20.0)
ENCODERS = {Rigid: {"encoder_load": Encoder()}, TwoMass: {"encoder_motor": Encoder(), "encoder_load": Encoder()}}


def loop(law: Law, *beside: Compensation, on: Plant = R, dead_samples: float = 1.0, **control: Any) -> Loop:
    """A law on an axis: R with one encoder, W with one on the motor and one on the load."""
    encoders: dict[str, Any] = ENCODERS[type(on)]
    axis = Axis(plant=on, actuator=Actuator(dead_time=dead_samples * T), **encoders)
    return Loop(control=Control(law=law, compensation=beside, **control), axis=axis, sample_time=T)


def golden_forces(law: Law, *beside: Compensation, count: int = 6, amplitude: float = 1e-6) -> list[float]:
    """N: the first commands at set point 0 while both readings are amplitude · sin(0.3 k) m, from states of zero."""
    control = Control(law=law, compensation=beside)
    prepared = control.prepare(T)
    state = control.start(prepared, Setpoint(0.0), 0.0, 0.0)
    found = []
    for k in range(count):
        y = float(amplitude * np.sin(0.3 * k))
        state, command = control.step(prepared, state, Setpoint(0.0), y, y, 1.0, T)
        found.append(float(command.applied))
    return found


def loop_gain(given: Loop, lines: np.ndarray) -> np.ndarray:
    """L at frequencies in Hz, cut at the actuator."""
    return loop_model(given).loop_gain(lines).response


class Judged(NamedTuple):
    """Ms; delay margin in samples; the largest |z| of the closed loop; ISE^½ in m √s/N; N/m of force per reading."""

    peak: float
    delay: float
    growth: float
    ise: float
    noise: float


def judged(given: Loop, per_decade: int = 200) -> Judged:
    """The figures of a loop, cut at the actuator with the `applied` of the law inside the law."""
    both = loop_model(given)
    shown = margins(both.loop_gain(both.lines(per_decade)))
    one = given.axis.one_encoder()
    delay = np.inf if shown.delay_margin_samples is None else shown.delay_margin_samples
    growth = stability(given).growth
    noise = force_noise(both.closed, 0.0 if one else 1.0, 1.0, shared=one)
    return Judged(shown.sensitivity_peak, delay, growth, rope_snap(both.closed), noise)


def stiffness_at(given: Loop, frequency: Sequence[float]) -> np.ndarray:
    """N/um at frequencies in Hz."""
    model = loop_model(given)
    found = stiffness(model.closed.response(np.array(frequency), "position_load", "load_force"))
    return 1e-6 * found.magnitude


def stable_masses(given: Loop, low: float = 0.02, high: float = 12.0) -> tuple[float, float]:
    """Between which factors of the mass of a rigid axis, around 1, the loop is stable; bisected to 0.1 %."""
    plant = given.axis.plant
    assert isinstance(plant, Rigid)

    def stable(factor: float) -> bool:
        other = replace(plant, mass=factor * plant.mass)
        return stability(replace(given, axis=replace(given.axis, plant=other))).stable

    def edge(inside: float, outside: float) -> float:
        if stable(outside):
            return outside
        while abs(outside / inside - 1.0) > 1e-3:
            middle = float(np.sqrt(inside * outside))
            inside, outside = (middle, outside) if stable(middle) else (inside, middle)
        return inside

    return edge(1.0, low), edge(1.0, high)


def step_into_the_limit(law: Law, *beside: Compensation, distance: float = 5e-3, limit: float = 400.0) -> float:
    """m by which axis R overshoots a set position that jumps, while the force is limited to `limit` in N."""
    given = loop(law, *beside, force_limit=limit)
    jump = Recorded(position=np.full(4000, distance), sample_time=T)
    run = simulate(given, jump, start=(0.0, 0.0), record=["position_load"])
    return float(np.max(run["position_load"])) - distance


def start_under_load(law: Law, *beside: Compensation, force: float = 400.0) -> tuple[float, float]:
    """N and m: how far the force of the first sample, and the axis in 50 ms, are off where gravity is -force.

    The controller starts while `force` already acts and holds axis R at rest.
    """
    control = Control(law=law, compensation=beside, guard=Guard(safe_force=force))
    prepared, setpoint = control.prepare(T), Setpoint(0.1)
    state = control.start(prepared, setpoint, 0.1, 0.1)
    Phi, Gamma = held(R, T)
    x, acting, first, most = np.zeros(2), force, 0.0, 0.0
    for k in range(500):
        y = 0.1 + float(x[0])
        state, command = control.step(prepared, state, setpoint, y, y, 1.0, T)
        first = float(command.applied) - force if k == 0 else first
        x = Phi @ x + Gamma * (acting - force)
        acting, most = float(command.applied), max(most, abs(float(x[0])))
    return first, most


def held(plant: Rigid, T: float) -> tuple[np.ndarray, np.ndarray]:
    """Φ and Γ of m x'' + b x' = F with F held over T."""
    rate = plant.viscous / plant.mass
    fade = math.exp(-rate * T)
    Phi = np.array([[1.0, (1.0 - fade) / rate], [0.0, fade]])
    return Phi, np.array([(T - (1.0 - fade) / rate) / plant.viscous, (1.0 - fade) / plant.viscous])
