"""An axis under a force below breakaway stands: its velocity is exactly 0 and its position keeps every bit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from axis_runs import move
from feeddrive.blocks.families import Friction
from feeddrive.blocks.friction.coulomb import Coulomb
from feeddrive.blocks.friction.directional import Directional
from feeddrive.blocks.friction.directional_stribeck import DirectionalStribeck
from feeddrive.blocks.friction.stribeck import Stribeck
from feeddrive.blocks.plant.modal import Modal
from feeddrive.blocks.plant.mode import Mode
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.plant.three_mass_chain import ThreeMassChain
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.loop.axis import Axis

# each holds at least 80 N in both directions
HOLDING: list[Friction] = [
    Coulomb(coulomb=80.0, viscous=300.0),
    Stribeck(coulomb=60.0, breakaway=80.0, stribeck_velocity=0.01),
    Directional(coulomb_positive=95.0, coulomb_negative=80.0, viscous_positive=100.0, viscous_negative=300.0),
    DirectionalStribeck(
        coulomb_positive=60.0,
        coulomb_negative=50.0,
        breakaway_positive=80.0,
        breakaway_negative=90.0,
        stribeck_velocity=0.01,
    ),
]
by_friction = pytest.mark.parametrize("friction", HOLDING, ids=lambda friction: friction.kind)
TWO_MASS = TwoMass(mass_motor=130.0, mass_load=33.0, stiffness=1.8e7, damping=700.0)


@by_friction
@settings(max_examples=25, deadline=None)
@given(forces=st.lists(st.floats(-79.9, 79.9), min_size=5, max_size=20), mass=st.floats(1.0, 1e3))
def test_rigid_axis_below_breakaway_does_not_move(friction: Friction, forces: list[float], mass: float) -> None:
    found = move(Axis(plant=Rigid(mass=mass), friction_load=friction), 1e-4, forces, position=0.123456789)
    assert np.all(found.velocity == 0.0)
    assert np.all(found.position == 0.123456789)
    np.testing.assert_allclose(found.friction_load, -np.array(forces), rtol=1e-12, atol=1e-12)


@by_friction
def test_table_stands_while_the_screw_winds_the_spring(friction: Friction) -> None:
    # the motor is free and swings on the spring; the table feels at most twice the drive force
    commands = 35.0 * np.sign(np.sin(0.3 * np.arange(200)))
    commands[60:] = 0.0
    found = move(Axis(plant=TWO_MASS, friction_load=friction), 5e-5, commands)
    spring = 1.8e7 * (found.position[:-1, 0] - found.position[:-1, 1])
    assert np.max(np.abs(spring)) < 79.0
    assert np.all(found.velocity[:, 1] == 0.0)
    assert np.all(found.position[:, 1] == 0.0)
    assert np.max(np.abs(found.velocity[:, 0])) > 1e-5


@by_friction
def test_both_bodies_of_a_full_mass_matrix_stand(friction: Friction) -> None:
    plant = TwoMass(mass_motor=130.0, mass_load=33.0, stiffness=1.8e7, coupling_mass=8.0)
    axis = Axis(plant=plant, friction_motor=friction, friction_load=Coulomb(coulomb=50.0))
    found = move(axis, 5e-5, np.full(100, 70.0), loads=np.full(100, -40.0))
    assert np.all(found.velocity == 0.0)
    assert np.all(found.position == 0.0)


def test_screw_of_a_three_mass_chain_stands() -> None:
    plant = ThreeMassChain(
        mass_motor=85.0,
        mass_screw=45.0,
        mass_load=33.0,
        coupling_stiffness=2.352e8,
        coupling_damping=2496.0,
        stiffness=1.8e7,
    )
    axis = Axis(plant=plant, friction_motor=Stribeck(coulomb=70.0, breakaway=110.0, stribeck_velocity=4e-3))
    found = move(axis, 5e-5, np.full(200, 50.0))
    assert np.all(found.velocity[:, 1] == 0.0)
    assert np.all(found.position[:, 1] == 0.0)
    assert np.max(np.abs(found.velocity[:, 0])) > 1e-5


@by_friction
def test_a_modal_axis_stands_although_its_modes_swing(friction: Friction) -> None:
    modes = (
        Mode(frequency=131.6, damping_ratio=0.018, mass=650.0, load=-3.9),
        Mode(frequency=38.0, damping_ratio=0.03, mass=2500.0, motor=-1.0),
    )
    axis = Axis(plant=Modal(mass=163.0, modes=modes), friction_load=friction)
    found = move(axis, 5e-5, np.full(100, 20.0))
    motions = [axis.motion(state) for state in found.states]
    assert all(motion.velocity_load == 0.0 for motion in motions)
    # the position of a body that is a sum of coordinates of about 1e-6 m is kept to their rounding
    assert max(abs(motion.position_load) for motion in motions) < 1e-20
    assert max(abs(motion.velocity_motor) for motion in motions) > 1e-6


@by_friction
def test_a_sliding_axis_comes_to_rest_and_stays(friction: Friction) -> None:
    found = move(Axis(plant=Rigid(mass=100.0), friction_load=friction), 1e-3, np.zeros(700), velocity=0.2)
    rest = int(np.argmax(found.velocity[:, 0] == 0.0))
    assert 0 < rest < 650
    assert np.all(found.velocity[:rest, 0] > 0.0)
    assert np.all(found.velocity[rest:, 0] == 0.0)
    assert np.all(found.position[rest:, 0] == found.position[rest, 0])


@by_friction
def test_it_breaks_away_above_breakaway(friction: Friction) -> None:
    for sign in (1.0, -1.0):
        found = move(Axis(plant=Rigid(mass=100.0), friction_load=friction), 1e-3, np.full(20, sign * 96.0))
        assert np.all(sign * found.velocity[1:, 0] > 0.0)
