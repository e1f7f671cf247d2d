"""The exact hold against scipy's matrix exponential, dead time against exact switching, and the energy balance."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.signal import cont2discrete

from axis_runs import matrices, move
from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.families import Plant
from feeddrive.blocks.plant.modal import Modal
from feeddrive.blocks.plant.mode import Mode
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.plant.three_mass_chain import ThreeMassChain
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.loop.axis import Axis
from fresh_draws import Seeded

RIGID = Rigid(mass=40.0, viscous=60.0)
TWO_MASS = TwoMass(
    mass_motor=130.0, mass_load=33.0, stiffness=1.8e7, damping=700.0, viscous_motor=1500.0, viscous_load=20.0
)
FULL = TwoMass(
    mass_motor=130.0, mass_load=33.0, stiffness=1.8e7, damping=700.0, viscous_motor=1500.0, coupling_mass=8.0
)
THREE_MASS = ThreeMassChain(
    mass_motor=85.0,
    mass_screw=45.0,
    mass_load=33.0,
    coupling_stiffness=2.352e8,
    coupling_damping=2496.0,
    stiffness=1.8e7,
    damping=700.0,
    viscous_motor=750.0,
    viscous_screw=750.0,
    viscous_load=20.0,
)
MODAL = Modal(
    mass=163.0,
    viscous=300.0,
    modes=(
        Mode(frequency=131.6, damping_ratio=0.018, mass=650.0, load=-3.9),
        Mode(frequency=38.0, damping_ratio=0.03, mass=2500.0, motor=-1.0),
    ),
)
PLANTS = [RIGID, TWO_MASS, FULL, THREE_MASS, MODAL]
by_plant = pytest.mark.parametrize("plant", PLANTS, ids=["rigid", "two_mass", "full", "three_mass", "modal"])


def state_space(axis: Axis, lag: float | None) -> tuple[np.ndarray, np.ndarray]:
    """A and B of (q, q', drive force if it lags) with the inputs command, force on motor, force on load."""
    M, C, K = matrices(axis)
    n = len(M)
    made = axis.mechanics()
    rows = [np.array(made.shape[body], dtype=float) for body in (made.drive, made.motor, made.load)]
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(M, K), -np.linalg.solve(M, C)]])
    B = np.vstack([np.zeros((n, 3)), np.linalg.solve(M, np.array(rows).T)])
    if lag is None:
        return A, B
    A = np.block([[A, B[:, :1]], [np.zeros((1, 2 * n)), np.array([[-lag]])]])
    B = np.vstack([np.hstack([np.zeros((2 * n, 1)), B[:, 1:]]), [[lag, 0.0, 0.0]]])
    return A, B


def relative(found: Any, true: np.ndarray, h: float, n: int) -> float:
    """Largest difference of two holds as a share of the largest entry, with velocities in positions per substep."""
    size = np.ones(len(true))
    size[n : 2 * n] = h
    scale = size[:, None] / (size[None, :] if true.ndim == 2 and true.shape[1] == len(true) else 1.0)
    true = true * scale
    return float(np.max(np.abs(np.array(found, dtype=float) * scale - true)) / np.max(np.abs(true)))


@by_plant
@pytest.mark.parametrize("lag", [None, 1500.0], ids=["ideal", "lagging"])
@pytest.mark.parametrize("T", [5e-5, 1e-3])
def test_hold_is_the_matrix_exponential(plant: Plant, lag: float | None, T: float) -> None:
    axis = Axis(plant=plant, actuator=Actuator(current_loop=lag), substeps=2)
    made = axis.prepare(T, axis.timing(T))
    A, B = state_space(axis, None if lag is None else 2 * np.pi * lag)
    n = len(plant.mechanics().mass)
    h = T / 2
    Phi, Gamma, *_ = cont2discrete((A, B, np.eye(len(A)), np.zeros(B.shape)), h)
    columns = np.array([made.new[0], *made.forces], dtype=float).T
    # 1e-13: a Taylor series of order 16 on a norm of 1/2 with up to five squarings, each doubling a rounding error
    assert relative(made.change, Phi - np.eye(len(A)), h, n) < 1e-13
    assert relative(columns, Gamma, h, n) < 1e-13


@settings(max_examples=40, deadline=None)
@given(
    m=st.floats(1.0, 1e3),
    ratio=st.floats(0.05, 5.0),
    frequency=st.floats(10.0, 1500.0),
    damping=st.floats(0.0, 0.3),
    viscous=st.floats(0.0, 5e3),
    full=st.floats(-0.5, 0.5),
    T=st.sampled_from([5e-5, 2.5e-4, 1e-3]),
)
def test_hold_of_any_two_mass_axis(
    m: float, ratio: float, frequency: float, damping: float, viscous: float, full: float, T: float
) -> None:
    m2 = m * ratio
    reduced = m * m2 / (m + m2)
    omega = 2 * np.pi * frequency
    plant = TwoMass(
        mass_motor=m,
        mass_load=m2,
        stiffness=reduced * omega**2,
        damping=2 * damping * reduced * omega,
        viscous_motor=viscous,
        coupling_mass=full * float(np.sqrt(m * m2)),
    )
    axis = Axis(plant=plant)
    made = axis.prepare(T, axis.timing(T))
    A, B = state_space(axis, None)
    Phi = expm(np.block([[A, B], [np.zeros((3, 7))]]) * T)[:4]
    assert relative(made.change, Phi[:, :4] - np.eye(4), T, 2) < 1e-12
    assert relative(np.array([made.new[0], *made.forces]).T, Phi[:, 4:], T, 2) < 1e-12


@pytest.mark.parametrize("samples", [0.0, 0.3, 1.0, 1.75, 3.5])
@pytest.mark.parametrize("lag", [None, 400.0], ids=["ideal", "lagging"])
@pytest.mark.parametrize("substeps", [1, 3])
def test_dead_time_switches_the_force_at_the_exact_instant(
    samples: float, lag: float | None, substeps: int, seeded: Seeded
) -> None:
    T = 1e-3
    dead_time = samples * T
    axis = Axis(plant=TWO_MASS, actuator=Actuator(dead_time=dead_time, current_loop=lag), substeps=substeps)
    commands = np.random.default_rng(seeded(7)).normal(0.0, 500.0, 25)
    found = move(axis, T, commands, position=0.1, velocity=0.05)

    A, B = state_space(axis, None if lag is None else 2 * np.pi * lag)
    y = np.zeros(len(A))
    y[:2], y[2:4] = 0.1, 0.05
    instants = np.unique(np.concatenate([np.arange(26) * T, dead_time + np.arange(26) * T]).round(12))
    rows = {0.0: y}
    for t0, t1 in pairwise(instants):
        k = int(np.floor((0.5 * (t0 + t1) - dead_time) / T))
        u = commands[k] if 0 <= k < len(commands) else 0.0

        def slope(_t: float, y: np.ndarray, u: float = u) -> np.ndarray:
            return A @ y + B[:, 0] * u

        y = solve_ivp(slope, (t0, t1), y, method="DOP853", rtol=1e-12, atol=1e-15).y[:, -1]
        rows[float(t1)] = y
    true = np.array([rows[float(np.round(k * T, 12))] for k in range(26)])
    # the truth's own tolerance, 1e-12 a step over up to 50 steps, of travels of 0.1 m and speeds of 0.1 m/s
    np.testing.assert_allclose(found.position, true[:, :2], rtol=0, atol=1e-11)
    np.testing.assert_allclose(found.velocity, true[:, 2:4], rtol=0, atol=1e-9)


def test_substeps_change_nothing_without_friction_and_forces() -> None:
    actuator = Actuator(dead_time=0.37e-3, current_loop=800.0)
    commands = np.random.default_rng(1).normal(0.0, 300.0, 60)
    one = move(Axis(plant=THREE_MASS, actuator=actuator), 1e-3, commands)
    many = move(Axis(plant=THREE_MASS, actuator=actuator, substeps=7), 1e-3, commands)
    # both are exact: what is left is rounding of 420 substeps, on a travel of about 1e-4 m
    np.testing.assert_allclose(many.position, one.position, rtol=0, atol=1e-16)


def test_current_loop_answers_a_step_as_a_first_order_lag() -> None:
    T, bandwidth = 5e-5, 300.0
    axis = Axis(plant=RIGID, actuator=Actuator(current_loop=bandwidth))
    found = move(axis, T, np.full(100, 200.0))
    force = np.array([state.drive[0] for state in found.states], dtype=float)
    true = 200.0 * (1.0 - np.exp(-2 * np.pi * bandwidth * T * np.arange(101)))
    np.testing.assert_allclose(force, true, rtol=1e-12, atol=1e-12)


def energy(axis: Axis, position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """Kinetic and elastic energy in J of each row."""
    M, _, K = matrices(axis)
    kinetic = 0.5 * np.einsum("ki,ij,kj->k", velocity, M, velocity)
    return kinetic + 0.5 * np.einsum("ki,ij,kj->k", position, K, position)


@pytest.mark.parametrize(
    "plant",
    [
        Rigid(mass=40.0),
        TwoMass(mass_motor=130.0, mass_load=33.0, stiffness=1.8e7),
        TwoMass(mass_motor=130.0, mass_load=33.0, stiffness=1.8e7, coupling_mass=-8.0),
        ThreeMassChain(mass_motor=85.0, mass_screw=45.0, mass_load=33.0, coupling_stiffness=2.352e8, stiffness=1.8e7),
        Modal(mass=163.0, modes=(Mode(frequency=131.6, damping_ratio=0.0, mass=650.0, load=-3.9),)),
    ],
    ids=["rigid", "two_mass", "full", "three_mass", "modal"],
)
def test_work_of_the_forces_is_the_change_of_energy(plant: Plant, seeded: Seeded) -> None:
    T = 2e-4
    axis = Axis(plant=plant)
    rng = np.random.default_rng(seeded(3))
    commands, loads = rng.normal(0.0, 800.0, 400), rng.normal(0.0, 300.0, 400)
    found = move(axis, T, commands, loads=loads, velocity=0.2)
    made = plant.mechanics()
    drive, load = (np.array(made.shape[body], dtype=float) for body in (made.drive, made.load))
    travel = np.diff(found.position, axis=0)
    # a force that is held over the step does the work force · travel exactly: no order of convergence, only rounding
    work = commands * (travel @ drive) + loads * (travel @ load)
    stored = energy(axis, found.position, found.velocity)
    np.testing.assert_allclose(stored[1:] - stored[0], np.cumsum(work), rtol=0, atol=1e-11 * np.max(stored))


def test_viscous_friction_takes_energy_and_never_gives() -> None:
    axis = Axis(plant=TWO_MASS)
    found = move(axis, 2e-4, np.zeros(500), velocity=0.3)
    assert np.all(np.diff(energy(axis, found.position, found.velocity)) <= 0.0)


@by_plant
def test_an_axis_starts_as_one_body_with_relaxed_springs(plant: Plant) -> None:
    axis = Axis(plant=plant)
    timing = axis.timing(1e-3)
    state = axis.start(0.3, -0.2, timing)
    assert axis.motion(state) == pytest.approx((0.3, 0.3, -0.2, -0.2), abs=1e-16)
    _, _, K = matrices(axis)
    spring_force = K @ np.array(state.position, dtype=float)
    np.testing.assert_allclose(spring_force, 0.0, atol=1e-15 * float(np.max(np.abs(K))))
