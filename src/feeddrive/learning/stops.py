"""Friction feedforward with stops (elastic-plastic elements), learned from slow oscillations of the loop."""

import math
from dataclasses import replace

import numpy as np

from feeddrive.blocks.reference.recorded import Recorded
from feeddrive.identification.friction_curve import LearnedStops, learned_stops
from feeddrive.identification.motion.motion_log import HOLD, MotionLog, Preparation
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import simulate

# stops are 1 um to some mm wide: the large swing shows sliding, the small ones reverse within the narrow stops
_SWINGS = ((5e-3, 0.5), (3e-4, 2.3), (2e-5, 7.0))  # m (rad of an axis that turns) and Hz
_DURATION = 4.0  # s


def learn_stops(loop: Loop, *, seed: int = 0) -> tuple[Loop, LearnedStops]:
    """Return the loop with its friction feedforward replaced by identified stops, and the result of the identification.

    The stops are identified from a simulated log.  In the middle of its travel, the axis oscillates for 4 s with an
    amplitude of 5 mm at 0.5 Hz; smaller and faster oscillations are superposed.  The mass is known.  Viscous friction
    and a constant offset are identified together with the stops, but left to the other blocks.
    `seed` is the seed of the encoder noise.
    Raises NotIdentifiableError if the log does not show friction.
    """
    T = float(loop.sample_time)
    control = loop.control
    # the present friction feedforward would hide the friction that is to be identified
    others = tuple(block for block in control.feedforward if "friction" not in block.fed())
    bare = replace(loop, control=replace(control, feedforward=others))
    run = simulate(bare, _swings(_center(loop), T), seed=seed, record=["reading_load", "force"], name="swings")
    log = MotionLog(
        name=loop.name,
        position=run["reading_load"],
        force=run["force"],
        sample_time=T,
        rotary=loop.axis.rotary,
        turning=loop.axis.rotary,
    )
    how = Preparation(
        cutoff=200.0,
        decimation=max(1, round(1e-3 / T)),
        delay=HOLD + float(loop.axis.actuator.delay()) / T,
        reversals=True,
    )
    learned = learned_stops(log, mass=float(loop.axis.plant.rigid_mass()), how=how)
    return replace(bare, control=replace(bare.control, feedforward=(*others, learned.stops))), learned


def _center(loop: Loop) -> float:
    """Return the middle of the travel, or 0 if the travel has no limits."""
    guard = loop.control.guard
    ends = () if guard is None else tuple(x for x in (guard.travel_least, guard.travel_most) if x is not None)
    return 0.5 * (ends[0] + ends[1]) if len(ends) == 2 else 0.0


def _swings(center: float, T: float) -> Recorded:
    """Return the sum of the oscillations about `center` as a reference with its derivatives."""
    t = np.arange(round(_DURATION / T)) * T
    rows = [np.zeros(t.size) for _ in range(5)]
    for amplitude, frequency in _SWINGS:
        omega = 2.0 * math.pi * frequency
        for order, row in enumerate(rows):
            row += amplitude * omega**order * np.sin(omega * t + 0.5 * math.pi * order)
    rows[0] += center
    names = ("position", "velocity", "acceleration", "jerk", "snap")
    return Recorded(**dict(zip(names, rows, strict=True)), sample_time=T)
