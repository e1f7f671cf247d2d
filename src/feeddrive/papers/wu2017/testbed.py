"""The x-y table of the experiments: its axes with either friction model, the moves, and the noise."""

from __future__ import annotations

import dataclasses
from functools import lru_cache

import numpy as np

from feeddrive.blocks.feedforward.disturbance_compensator import DisturbanceCompensator
from feeddrive.blocks.friction.directional_stribeck import DirectionalStribeck
from feeddrive.blocks.friction.regularised import Regularised
from feeddrive.blocks.load.recorded_force import RecordedForce
from feeddrive.blocks.reference.snap_limited_move import SnapLimitedMove
from feeddrive.files.machine import read_machine
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text
from feeddrive.learning.iterative_feedforward import compensated
from feeddrive.loop.loop import Loop

TRANSITION = 2e-4  # m/s, v_t of the tanh friction of the tables
FORCE_CONSTANT = 300.0  # N/A
NOISE = 5.0  # N, standard deviation of the force noise added in each sample
TRIALS = 6
SAMPLES = 20_000  # number of noise samples, more than in any move
# columns by set, and as the tables call them
SETS = {
    "a, b": ("mass", "viscous"),
    "+ Coulomb": ("mass", "viscous", "coulomb_positive", "coulomb_negative"),
    "+ Stribeck": ("mass", "viscous", "coulomb_positive", "coulomb_negative", "stribeck"),
}
PLANT = (
    "bundled machine xy_table: x 120 kg, 400 N s/m, Coulomb +95/-80 N, static 130 N, v_s 6 mm/s; P-PI Kv 40 1/s, "
    "150 A s/m at 300 N/A, Tn 15 ms; 4 kHz, one sample of dead time, 0.1 um"
)
TANH = "tanh friction, v_t 0.2 mm/s"
SET_VALUED = "set-valued friction"
RULE = Text(
    f"x axis, theta from [0.15 A s²/m, 0, 0, 0], model-free, gamma 1, {Quantity(NOISE, 'N'):6} force noise, seeds 0 to "
    "5"
)


@lru_cache
def _machine(axis: str) -> Loop:
    return read_machine("xy_table").loop(axis)


def table_axis(axis: str, columns: tuple[str, ...], *, smooth: bool = True, exact: bool = False) -> Loop:
    """Return an axis of the table with a compensator that has these basis functions.

    smooth  tanh friction, as in the tables; otherwise the friction model of the machine file
    exact   mass and viscous friction of the axis are fed forward from the start; otherwise 45 kg and 0
    """
    loop = _machine(axis)
    friction = loop.axis.friction_load
    assert isinstance(friction, DirectionalStribeck)
    if smooth:
        tanh = Regularised(
            coulomb=friction.coulomb_positive,
            coulomb_negative=friction.coulomb_negative,
            breakaway=friction.breakaway_positive,
            stribeck_velocity=friction.stribeck_velocity,
            transition_velocity=TRANSITION,
            viscous=friction.viscous,
        )
        loop = dataclasses.replace(loop, axis=dataclasses.replace(loop.axis, friction_load=tanh))
    start_values = dict.fromkeys(columns, 0.0) | {"mass": 45.0}
    if exact:
        start_values |= {"mass": float(loop.axis.plant.rigid_mass()), "viscous": float(friction.viscous)}
    speed = float(friction.stribeck_velocity) if "stribeck" in columns else None
    return compensated(loop, DisturbanceCompensator(**start_values, stribeck_velocity=speed))


def move(distance: float, velocity: float, acceleration: float, jerk: float) -> SnapLimitedMove:
    """Return a move out and back; the snap corresponds to a jerk ramp of 4 ms."""
    return SnapLimitedMove(
        distance=distance,
        velocity=velocity,
        acceleration=acceleration,
        jerk=jerk,
        snap=jerk / 4e-3,
        back=True,
        dwell_before=0.02,
        dwell_between=0.2,
        dwell_after=0.2,
    )


SAME = move(0.1, 0.25, 3.0, 60.0)
OTHERS = (move(0.06, 0.15, 2.0, 40.0), move(0.2, 0.4, 4.0, 80.0), move(0.03, 0.1, 1.5, 50.0))
CHANGING = (SAME, *OTHERS, SAME, SAME)


def noise(trial: int, size: float = NOISE) -> RecordedForce:
    """Return white force noise; the trial number is its seed."""
    values = np.random.default_rng(trial).standard_normal(SAMPLES)
    return RecordedForce(force=size * values, sample_time=float(_machine("x").sample_time))


def amperes(value: float) -> float:
    """Convert a parameter to units of the drive."""
    return value / FORCE_CONSTANT
