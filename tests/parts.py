"""A small machine of two axes with dry friction, and a motion with starts, stops and reversals of both."""

from __future__ import annotations

from dataclasses import replace

from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.families import Friction
from feeddrive.blocks.feedforward.inertia import Inertia
from feeddrive.blocks.friction.stribeck import Stribeck
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.blocks.reference.recorded import Recorded
from feeddrive.blocks.reference.snap_limited_move import SnapLimitedMove
from feeddrive.blocks.sensor.encoder import Encoder
from feeddrive.learning.part_correction import planned_rows
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import Machine

T = 5e-4
FRICTION = Stribeck(coulomb=80.0, breakaway=120.0, stribeck_velocity=5e-3)
PLANT = TwoMass(mass_motor=60.0, mass_load=90.0, stiffness=8e7, damping=4e3)


def loop(
    name: str = "x",
    friction: Friction | None = FRICTION,
    motor: Friction | None = None,
    velocity_feedforward: float = 1.0,
) -> Loop:
    """One axis under P-PI with the mass fed forward."""
    axis = Axis(
        plant=PLANT,
        actuator=Actuator(dead_time=T, current_loop=800.0),
        friction_load=friction,
        friction_motor=motor,
        encoder_motor=Encoder(resolution=2e-8),
        encoder_load=Encoder(resolution=2e-8),
        substeps=4,
    )
    law = CascadePPI(Kv=45.0, Kp=1.6e4, Tn=0.025, velocity_feedforward=velocity_feedforward)
    control = Control(law=law, feedforward=(Inertia(mass=150.0),), force_limit=4000.0)
    return Loop(control=control, axis=axis, sample_time=T, name=name)


def machine(**changes: object) -> Machine:
    return Machine.of({name: loop(name, **changes) for name in ("x", "y")})  # type: ignore[arg-type]


def plan() -> dict[str, Recorded]:
    """x goes out and back, y the same a little later: each reverses, and rests while the other one moves."""
    move = SnapLimitedMove(
        distance=0.02,
        velocity=0.08,
        acceleration=2.0,
        jerk=80.0,
        snap=2e4,
        back=True,
        dwell_before=0.1,
        dwell_between=0.15,
        dwell_after=0.1,
    )
    return planned_rows({"x": move, "y": replace(move, distance=0.015, dwell_before=0.35)}, T)
