"""Axes and moves for the tests of iterative feedforward."""

from __future__ import annotations

from typing import Any

import numpy as np

from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.families import Reference
from feeddrive.blocks.feedforward.disturbance_compensator import DisturbanceCompensator
from feeddrive.blocks.load.recorded_force import RecordedForce
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.reference.snap_limited_move import SnapLimitedMove
from feeddrive.learning.trial import Trial, simulated_trial
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import samples, simulate

T = 2.5e-4
MASS, VISCOUS, POSITIVE, NEGATIVE = 120.0, 400.0, 95.0, 80.0
TRUE = {"mass": MASS, "viscous": VISCOUS, "coulomb_positive": POSITIVE, "coulomb_negative": NEGATIVE}
START = {"mass": 30.0, "viscous": 0.0, "coulomb_positive": 0.0, "coulomb_negative": 0.0}
RECORD = ("following_error", "force", "requested", "trip")
OUT_AND_BACK: dict[str, Any] = {
    "velocity": 0.25,
    "acceleration": 3.0,
    "jerk": 60.0,
    "snap": 15e3,
    "back": True,
    "dwell_before": 0.02,
    "dwell_between": 0.2,
    "dwell_after": 0.2,
}
MOVE = SnapLimitedMove(distance=0.1, **OUT_AND_BACK)


def linear_loop(
    theta: dict[str, float],
    *,
    law: Any = None,
    mass: float = MASS,
    viscous: float = VISCOUS,
    sample_time: float = T,
    dead_time: float = T,
    stribeck_velocity: float | None = None,
    **control: Any,
) -> Loop:
    """A rigid axis without dry friction and without quantiser under a P-PI cascade."""
    block = DisturbanceCompensator(**theta, stribeck_velocity=stribeck_velocity)
    law = CascadePPI(Kv=40.0, Kp=375.0 * mass, Tn=0.015) if law is None else law
    axis = Axis(plant=Rigid(mass=mass, viscous=viscous), actuator=Actuator(dead_time=dead_time))
    return Loop(control=Control(law=law, feedforward=(block,), **control), axis=axis, sample_time=sample_time)


def along(reference: Reference, sample_time: float = T) -> np.ndarray:
    """The instants of a run."""
    return np.arange(samples(reference.duration, sample_time)) * sample_time


def trial_with_friction(
    loop: Loop, reference: Reference, dry: DisturbanceCompensator | None = None, noise: float = 0.0, seed: int = 0
) -> Trial:
    """A run in which dry friction acts along the set velocity, as late as the drive's force, beside noise in N."""
    step = float(loop.sample_time)
    t = along(reference, step)
    dry = dry or DisturbanceCompensator(coulomb_positive=POSITIVE, coulomb_negative=NEGATIVE)
    setpoint = reference.at(t)
    force = -np.broadcast_to(dry.step(dry.start(setpoint), setpoint, step)[1], t.shape)
    late = round(float(loop.axis.actuator.dead_time) / step)
    force = np.concatenate([np.zeros(late), force[: t.size - late]])
    force = force + noise * np.random.default_rng(seed).standard_normal(t.size)
    run = simulate(loop, reference, load=RecordedForce(force=force, sample_time=step), record=RECORD)
    return simulated_trial(run, reference)
