"""The loop of the speed bars: a two-mass ball-screw axis with everything that a real one has."""

from __future__ import annotations

from typing import Any

import numpy as np

from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.feedforward.inertia import Inertia
from feeddrive.blocks.filter.notch import Notch
from feeddrive.blocks.friction.stribeck import Stribeck
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.blocks.reference.snap_limited_move import SnapLimitedMove
from feeddrive.blocks.sensor.encoder import Encoder
from feeddrive.language import tree
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop

SAMPLE_TIME = 50e-6
SAMPLES = 40_000
RECORD = ("position_load", "velocity_load", "following_error", "force", "friction_load", "reading_motor")

# Leaves that differ between the variants of a batch.  What `prepare` makes of them differs too: with hold and notch
# more than 31 numbers of the inner loop are vectors.
VARIED = (
    "axis.x.control.law.Kv",
    "axis.x.control.law.Kp",
    "axis.x.control.law.Tn",
    "axis.x.control.law.velocity_feedforward",
    "axis.x.control.filters.0.frequency",
    "axis.x.control.filters.0.damping_zero",
    "axis.x.control.filters.0.damping_pole",
    "axis.x.control.feedforward.0.mass",
    "axis.x.control.feedforward.0.viscous",
    "axis.x.control.force_limit",
    "axis.x.plant.mass_motor",
    "axis.x.plant.mass_load",
    "axis.x.plant.stiffness",
    "axis.x.plant.damping",
    "axis.x.plant.viscous_motor",
    "axis.x.plant.viscous_load",
    "axis.x.friction_load.coulomb",
    "axis.x.friction_load.breakaway",
    "axis.x.friction_load.stribeck_velocity",
    "axis.x.friction_load.viscous",
    "axis.x.encoder_motor.resolution",
    "axis.x.encoder_load.resolution",
)


def reference() -> SnapLimitedMove:
    """40 mm there and back at up to 0.1 m/s and 1 m/s², with three dwells, in 40,000 samples.

    The axis sticks in the dwells, slips in between, and the force limit cuts the tops of the acceleration.
    """
    limits: dict[str, Any] = {"distance": 0.04, "velocity": 0.1, "acceleration": 1.0, "jerk": 50.0, "snap": 5e3}
    dwell = ((SAMPLES - 1) * SAMPLE_TIME - 2.0 * SnapLimitedMove(**limits).leg_time) / 3.0
    return SnapLimitedMove(**limits, back=True, dwell_before=dwell, dwell_after=dwell)


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
