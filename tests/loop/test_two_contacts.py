"""Two dry contacts at once: the sweeps of the axis against the exact solution of both."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from axis_runs import move
from feeddrive.blocks.friction.coulomb import Coulomb
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.language.errors import StructureError
from feeddrive.loop.axis import Axis

T = 1e-3


def exact(free: np.ndarray, mobility: np.ndarray, levels: np.ndarray) -> np.ndarray:
    """Friction forces with v = free + mobility · F, each at rest within ±level or sliding at it: nine cases."""
    best, least = np.zeros(2), np.inf
    for modes in product((-1, 0, 1), repeat=2):
        stuck = [i for i in range(2) if modes[i] == 0]
        F = -np.array(modes) * levels
        if stuck:
            others = free + mobility @ np.where(np.array(modes) == 0, 0.0, F)
            F[stuck] = np.linalg.solve(mobility[np.ix_(stuck, stuck)], -others[stuck])
        v = free + mobility @ F
        beyond = max(abs(F[i]) - levels[i] for i in range(2))
        wrong = max([beyond / np.max(levels), *(-modes[i] * v[i] / np.max(np.abs(free)) for i in range(2))])
        if wrong < least:
            best, least = F, wrong
    assert least < 1e-9
    return best


@settings(max_examples=60, deadline=None)
@given(
    drive=st.floats(-400.0, 400.0),
    load=st.floats(-200.0, 200.0),
    velocity=st.floats(-0.05, 0.05),
    levels=st.tuples(st.floats(5.0, 120.0), st.floats(5.0, 80.0)),
    coupling=st.sampled_from([None, 8.0, -20.0]),
)
def test_sweeps_find_the_forces_that_fit_both_velocities(
    drive: float, load: float, velocity: float, levels: tuple[float, float], coupling: float | None
) -> None:
    plant = TwoMass(
        mass_motor=130.0, mass_load=33.0, stiffness=1.8e7, damping=700.0, coupling_mass=coupling, viscous_motor=500.0
    )
    axis = Axis(plant=plant, friction_motor=Coulomb(coulomb=levels[0]), friction_load=Coulomb(coulomb=levels[1]))
    made = axis.prepare(T, axis.timing(T))
    mobility = np.array([[made.forces[j][2 + i] for j in range(2)] for i in range(2)], dtype=float)
    without = move(Axis(plant=plant), T, [drive], loads=[load], velocity=velocity).velocity[1]
    if np.max(np.abs(without)) < 1e-9:
        return  # at rest without friction: nothing to solve
    true = exact(without, mobility, np.array(levels))
    found = move(axis, T, [drive], loads=[load], velocity=velocity)
    # A sweep shrinks the error by the coupling w12²/(w11 w22): 3e-3 over the spring in 1 ms (2 sweeps), 0.11 with the
    # largest off-diagonal mass (6 sweeps).
    forces = np.array([found.friction_motor[0], found.friction_load[0]])
    assert np.max(np.abs(forces - true)) < 1e-3 * max(levels)


def test_a_rigid_axis_has_one_contact() -> None:
    with pytest.raises(StructureError, match="the plant 'rigid' has one body; give its friction as friction_load"):
        Axis(plant=Rigid(mass=40.0), friction_motor=Coulomb(coulomb=30.0))
