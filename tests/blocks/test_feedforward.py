"""Feedforward of friction: the level that the set motion meets."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from axis_runs import fed, move
from feeddrive.blocks.feedforward.friction_feedforward import FrictionFeedforward
from feeddrive.blocks.feedforward.inertia import Inertia
from feeddrive.blocks.friction.directional_stribeck import DirectionalStribeck
from feeddrive.blocks.friction.regularised import Regularised
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.signals import Setpoint
from feeddrive.language.errors import ParameterError
from feeddrive.loop.axis import Axis

T = 1e-4


@given(velocity=st.floats(-1.0, 1.0))
def test_it_is_the_steady_friction_of_the_same_parameters(velocity: float) -> None:
    smooth = FrictionFeedforward(
        coulomb_positive=70.0, coulomb_negative=60.0, breakaway=110.0, stribeck_velocity=4e-3, smoothing=2e-4
    )
    friction = Regularised(
        coulomb=70.0, coulomb_negative=60.0, breakaway=110.0, stribeck_velocity=4e-3, transition_velocity=2e-4
    )
    with np.errstate(all="ignore"):
        v = np.float64(velocity)
        assert fed(smooth, Setpoint(0.0, v), T) == friction.steady(v)
        if abs(velocity) > 1e-9:
            hard = FrictionFeedforward(
                coulomb_positive=70.0, coulomb_negative=60.0, breakaway=110.0, stribeck_velocity=4e-3
            )
            dry = DirectionalStribeck(
                coulomb_positive=70.0,
                coulomb_negative=60.0,
                breakaway_positive=110.0,
                breakaway_negative=110.0,
                stribeck_velocity=4e-3,
            )
            assert fed(hard, Setpoint(0.0, v), T) == dry.steady(v)


def test_within_the_dead_band_there_is_no_force() -> None:
    block = FrictionFeedforward(coulomb_positive=70.0, coulomb_negative=60.0, dead_band=1e-3)
    for velocity, force in ((0.0, 0.0), (9e-4, 0.0), (-9e-4, 0.0), (1.1e-3, 70.0), (-1.1e-3, -60.0)):
        assert fed(block, Setpoint(0.0, velocity), T) == force


def test_the_force_turns_with_the_velocity_in_the_middle_of_the_sample() -> None:
    block = FrictionFeedforward(coulomb_positive=70.0, coulomb_negative=60.0)
    # 10 µm/s at kT and -1 m/s²: the set motion has turned 10 µs later, before the middle at 50 µs
    assert fed(block, Setpoint(0.0, 1e-5, -1.0), T) == -60.0
    assert fed(block, Setpoint(0.0, 1e-4, -1.0), T) == 70.0


def test_an_axis_without_feedback_follows_its_feedforward() -> None:
    # open loop: mass, viscous and dry friction are all fed forward, the axis runs a sine with its reversals
    friction = DirectionalStribeck(
        coulomb_positive=70.0,
        coulomb_negative=60.0,
        breakaway_positive=70.0,
        breakaway_negative=60.0,
        stribeck_velocity=4e-3,
        viscous=300.0,
    )
    dry = FrictionFeedforward(coulomb_positive=70.0, coulomb_negative=60.0)
    inertia = Inertia(mass=100.0, viscous=300.0)
    w, size, n = 2 * np.pi * 2.0, 0.01, 5000
    t = T * np.arange(n)
    # one period, from a crest where the axis rests
    moves = [
        Setpoint(
            -size * np.cos(w * x),
            size * w * np.sin(w * x),
            size * w**2 * np.cos(w * x),
            -size * w**3 * np.sin(w * x),
            -size * w**4 * np.cos(w * x),
        )
        for x in t
    ]
    commands = [float(fed(inertia, s, T) + fed(dry, s, T)) for s in moves]
    found = move(Axis(plant=Rigid(mass=100.0), friction_load=friction), T, commands, position=-size)
    true = -size * np.cos(w * T * np.arange(n + 1))
    # what is left is the sample in which the velocity turns: up to 60 N over one sample shift the velocity by
    # 60 N · 0.1 ms / 100 kg = 60 µm/s, over the 0.25 s of a half wave at most 15 µm of 20 mm
    assert np.max(np.abs(found.position[:, 0] - true)) < 15e-6


def test_half_a_stribeck_curve_is_refused() -> None:
    with pytest.raises(ParameterError, match=r"stribeck_velocity is given without friction_feedforward\.breakaway"):
        FrictionFeedforward(coulomb_positive=70.0, coulomb_negative=60.0, stribeck_velocity=0.01)
    with pytest.raises(ParameterError, match=r"breakaway = 65 N must be >= friction_feedforward\.coulomb_positive"):
        FrictionFeedforward(coulomb_positive=70.0, coulomb_negative=60.0, breakaway=65.0, stribeck_velocity=0.01)
