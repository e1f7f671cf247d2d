"""A gantry for tests: two sides of unlike mass and friction with sluggish controls, and the beam between them."""

from __future__ import annotations

from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.coupling.cross_beam import CrossBeam
from feeddrive.blocks.friction.coulomb import Coulomb
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.sensor.encoder import Encoder
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.guard import Guard
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import Machine

T = 5e-4  # s
MASSES = (130.0, 90.0)  # kg
COULOMB = (40.0, 30.0)  # N
VISCOUS = (300.0, 200.0)  # N s/m
STIFFNESS, DAMPING = 4e6, 1200.0  # N/m, N s/m: 44 Hz, damped by 4 %
COUNT = 1e-7  # m


def side(mass: float, coulomb: float, viscous: float, sample_time: float = T) -> Loop:
    guard = Guard(following_error_limit=3e-3, velocity_limit=1.0)
    return Loop(
        control=Control(law=CascadePPI(Kv=15.0, Kp=60.0 * mass, Tn=0.06), force_limit=2000.0, guard=guard),
        axis=Axis(
            plant=Rigid(mass=mass, viscous=viscous),
            friction_load=Coulomb(coulomb=coulomb) if coulomb else None,
            actuator=Actuator(dead_time=2.5e-4),
            encoder_load=Encoder(resolution=COUNT),
            substeps=4,
        ),
        sample_time=sample_time,
    )


def gantry(stiffness: float = STIFFNESS, damping: float = DAMPING, sample_time: float = T) -> Machine:
    y, y2 = (side(*each, sample_time) for each in zip(MASSES, COULOMB, VISCOUS, strict=True))
    beam = CrossBeam(axis="y", follower="y2", stiffness=stiffness, damping=damping)
    return Machine.of({"y": y, "y2": y2}, (beam,))
