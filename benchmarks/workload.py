"""The loop of the speed bars: a two-mass ball-screw axis with everything that a real one has."""

from __future__ import annotations

import numpy as np

from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.families import Reference
from feeddrive.blocks.feedforward.inertia import Inertia
from feeddrive.blocks.filter.notch import Notch
from feeddrive.blocks.friction.stribeck import Stribeck
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.blocks.sensor.encoder import Encoder
from feeddrive.blocks.signals import Setpoint
from feeddrive.language import tree
from feeddrive.language.block import Number, parameter
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop

SAMPLE_TIME = 50e-6
SAMPLES = 40_000
RECORD = ("position_load", "velocity_load", "following_error", "force", "friction_load", "reading_motor")

# Leaves that differ between the variants of a batch.  What `prepare` makes of them differs too: with hold and notch
# more than 31 numbers of the inner loop are vectors.
VARIED = (
    "control.law.Kv", "control.law.Kp", "control.law.Tn", "control.law.velocity_feedforward",
    "control.filters.0.frequency", "control.filters.0.damping_zero", "control.filters.0.damping_pole",
    "control.feedforward.0.mass", "control.feedforward.0.viscous", "control.force_limit",
    "axis.plant.mass_motor", "axis.plant.mass_load", "axis.plant.stiffness", "axis.plant.damping",
    "axis.plant.viscous_motor", "axis.plant.viscous_load",
    "axis.friction_load.coulomb", "axis.friction_load.breakaway", "axis.friction_load.stribeck_velocity",
    "axis.friction_load.viscous", "axis.encoder_motor.resolution", "axis.encoder_load.resolution",
)  # fmt: skip


class Shuttle(Reference):
    """Out and back along polynomials of 7th degree (jerk is continuous, snap bounded), with rests in between.

    x(s) = length (35 s⁴ - 84 s⁵ + 70 s⁶ - 20 s⁷),   s = t / travel_time
    """

    length: Number = parameter("m", "distance", above=0)
    travel_time: Number = parameter("s", "time of one way", above=0)
    rest: Number = parameter("s", "rest before, between and after", least=0)

    @property
    def duration(self) -> float:
        """Two ways and three rests."""
        return 2.0 * self.travel_time + 3.0 * self.rest

    def at(self, t: np.ndarray) -> Setpoint:
        """Position and four derivatives."""
        out = np.clip((t - self.rest) / self.travel_time, 0.0, 1.0)
        back = np.clip((t - 2.0 * self.rest - self.travel_time) / self.travel_time, 0.0, 1.0)
        curve = np.polynomial.Polynomial([0.0, 0.0, 0.0, 0.0, 35.0, -84.0, 70.0, -20.0])
        fields = []
        for order in range(5):
            derived = curve.deriv(order) if order else curve
            fields.append(self.length * (derived(out) - derived(back)) / self.travel_time**order)
        return Setpoint(*fields)


def reference() -> Shuttle:
    """40 mm out and back at up to 145 mm/s and 1.8 m/s², in 40,000 samples."""
    return Shuttle(length=0.04, travel_time=0.6, rest=((SAMPLES - 1) * SAMPLE_TIME - 1.2) / 3.0)


def loop(substeps: int = 1) -> Loop:
    """The axis of the speed bars."""
    axis = Axis(
        plant=TwoMass(
            mass_motor=474.0, mass_load=200.0, stiffness=1.5e8, damping=4000.0, viscous_motor=600.0, viscous_load=300.0
        ),
        friction_load=Stribeck(coulomb=250.0, breakaway=400.0, stribeck_velocity=0.002, viscous=700.0),
        actuator=Actuator(dead_time=SAMPLE_TIME),
        encoder_motor=Encoder(resolution=0.01 / 2**20),
        encoder_load=Encoder(resolution=10e-9),
        substeps=substeps,
    )
    control = Control(
        law=CascadePPI(Kv=60.0, Kp=2.0e5, Tn=0.01),
        filters=(Notch(frequency=164.0),),
        feedforward=(Inertia(mass=674.0, viscous=1600.0),),
        force_limit=900.0,
    )
    return Loop(control=control, axis=axis, sample_time=SAMPLE_TIME)


def variants(count: int, substeps: int = 1, spread: float = 0.1) -> Loop:
    """The loop with arrays of `count` variants, each parameter within ±`spread` of its value."""
    base = loop(substeps)
    draw = np.random.default_rng(1)
    return tree.vary(
        base, {name: tree.get(base, name) * (1.0 + spread * draw.uniform(-1.0, 1.0, count)) for name in VARIED}
    )
