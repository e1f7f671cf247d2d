"""The feedforward that is linear in its parameters: its columns, and what it says that it feeds."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from axis_runs import fed
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.feedforward.disturbance_compensator import DisturbanceCompensator
from feeddrive.blocks.feedforward.friction_feedforward import FrictionFeedforward
from feeddrive.blocks.feedforward.inertia import Inertia
from feeddrive.blocks.reference.snap_limited_move import SnapLimitedMove
from feeddrive.blocks.signals import Setpoint
from feeddrive.language.errors import StructureError
from feeddrive.loop.control import Control

T = 1e-4
WHOLE = DisturbanceCompensator(
    mass=120.0,
    viscous=400.0,
    coulomb_positive=95.0,
    coulomb_negative=80.0,
    stribeck=35.0,
    stribeck_velocity=6e-3,
    jerk_feedforward=0.02,
    snap_feedforward=1e-5,
)


def moved() -> tuple[Setpoint, np.ndarray]:
    reference = SnapLimitedMove(
        distance=0.01,
        velocity=0.05,
        acceleration=1.0,
        jerk=50.0,
        snap=5e3,
        back=True,
        dwell_before=0.01,
        dwell_after=0.01,
    )
    t = np.arange(int(reference.duration / T)) * T
    return reference.at(t), t


@given(velocity=st.floats(-0.5, 0.5), acceleration=st.floats(-5.0, 5.0))
def test_without_stribeck_jerk_and_snap_it_is_inertia_and_friction_feedforward(
    velocity: float, acceleration: float
) -> None:
    """Two other blocks, written on their own."""
    setpoint = Setpoint(0.0, np.float64(velocity), np.float64(acceleration))
    block = DisturbanceCompensator(mass=120.0, viscous=400.0, coulomb_positive=95.0, coulomb_negative=80.0)
    others = (Inertia(mass=120.0, viscous=400.0), FrictionFeedforward(coulomb_positive=95.0, coulomb_negative=80.0))
    total = sum(float(fed(each, setpoint, T)) for each in others)
    # four terms of at most 700 N are added in another order
    assert float(fed(block, setpoint, T)) == pytest.approx(total, abs=1e-12)


def test_the_stribeck_column_is_what_friction_feedforward_adds() -> None:
    """With one Coulomb level; the amplitude is breakaway - coulomb."""
    setpoint, _ = moved()
    block = DisturbanceCompensator(coulomb_positive=95.0, coulomb_negative=95.0, stribeck=35.0, stribeck_velocity=6e-3)
    other = FrictionFeedforward(coulomb_positive=95.0, coulomb_negative=95.0, breakaway=130.0, stribeck_velocity=6e-3)
    assert np.max(np.abs(fed(block, setpoint, T) - fed(other, setpoint, T))) < 1e-12


def test_the_force_is_linear_in_the_parameters() -> None:
    setpoint, _ = moved()
    columns = WHOLE.regressors(setpoint, T)
    total = sum(np.asarray(columns[name]) * value for name, value in WHOLE.parameters().items())
    assert np.array_equal(np.asarray(fed(WHOLE, setpoint, T)), total)


def test_all_columns_vanish_at_rest() -> None:
    for name, value in WHOLE.regressors(Setpoint(0.3), T).items():
        assert value == 0.0, name


def test_the_column_of_the_negative_direction_is_negative() -> None:
    columns = WHOLE.regressors(Setpoint(0.0, -0.1), T)
    assert columns["coulomb_negative"] == -1.0
    assert columns["coulomb_positive"] == 0.0


def test_what_is_left_out_is_no_column_and_is_not_fed() -> None:
    block = DisturbanceCompensator(coulomb_positive=0.0, coulomb_negative=0.0)
    assert block.fed() == ("friction",)
    assert list(block.regressors(Setpoint(0.0), T)) == ["coulomb_positive", "coulomb_negative"]
    assert WHOLE.fed() == DisturbanceCompensator.feeds
    assert fed(DisturbanceCompensator(), Setpoint(0.0, 0.2), T) == 0.0


def test_nothing_is_fed_twice() -> None:
    law = CascadePPI(Kv=40.0, Kp=45e3, Tn=0.015)
    inertia = Inertia(mass=100.0, viscous=10.0)
    friction = DisturbanceCompensator(coulomb_positive=0.0, coulomb_negative=0.0)
    assert Control(law=law, feedforward=(inertia, friction)).feedforward == (inertia, friction)
    with pytest.raises(StructureError, match="feeds the acceleration forward, which inertia does already"):
        Control(law=law, feedforward=(inertia, DisturbanceCompensator(mass=1.0)))
