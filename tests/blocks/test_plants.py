"""Plants: what holds for every mechanics, the same axis declared in different terms, and published eigenvalues."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import eigh

from axis_runs import matrices
from feeddrive.blocks.actuator.screw import Screw
from feeddrive.blocks.catalogue import catalogue
from feeddrive.blocks.families import Plant
from feeddrive.blocks.plant.milling_axis import MillingAxis
from feeddrive.blocks.plant.modal import Modal
from feeddrive.blocks.plant.mode import Mode
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.plant.screw_rigid import ScrewRigid
from feeddrive.blocks.plant.screw_two_mass import ScrewTwoMass
from feeddrive.blocks.plant.three_mass_chain import ThreeMassChain
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.blocks.plant.with_mode import WithMode
from feeddrive.language.errors import ParameterError
from feeddrive.loop.axis import Axis
from feeddrive.testing.strategies import blocks_of

TWO_MASS = TwoMass(
    mass_motor=130.0, mass_load=33.0, stiffness=1.8e7, damping=700.0, viscous_motor=1500.0, viscous_load=20.0
)


def poles(plant: Plant) -> np.ndarray:
    M, C, K = matrices(Axis(plant=plant))
    n = len(M)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(M, K), -np.linalg.solve(M, C)]])
    return np.linalg.eigvals(A)


def response(plant: Any, frequency: float) -> np.ndarray:
    """Positions of motor and load in m per N of drive force and of force on the load, shape (2, 2)."""
    made = plant.mechanics()
    M, C, K = matrices(Axis(plant=plant))
    s = 2j * np.pi * frequency
    S = np.array(made.shape, dtype=float)
    return S[[made.motor, made.load]] @ np.linalg.solve(M * s * s + C * s + K, S[[made.drive, made.load]].T)


@pytest.mark.parametrize("plant", catalogue()[Plant].values(), ids=lambda plant: plant.kind)
@settings(max_examples=20, deadline=None)
@given(data=st.data())
def test_any_plant_is_a_body_that_can_move_freely(plant: type[Plant], data: st.DataObject) -> None:
    drawn = data.draw(blocks_of(plant))
    made = drawn.mechanics()
    M, C, K = matrices(Axis(plant=drawn))
    along = np.array(made.rigid_motion(), dtype=float)
    assert np.array_equal(M, M.T)
    assert np.array_equal(K, K.T)
    assert np.array_equal(C, C.T)
    assert np.min(np.linalg.eigvalsh(M)) > 0.0
    # passive: rounding of an eigenvalue is of the size of the largest entry
    assert np.min(np.linalg.eigvalsh(K)) >= -1e-12 * np.max(np.abs(K))
    assert np.min(np.linalg.eigvalsh(C)) >= -1e-12 * np.max(np.abs(C))
    np.testing.assert_allclose(np.array(made.shape, dtype=float) @ along, 1.0, rtol=1e-15)
    np.testing.assert_allclose(K @ along, 0.0, atol=1e-15 * float(np.max(np.abs(K))))
    assert drawn.rigid_mass() == pytest.approx(along @ M @ along, rel=1e-12)


def test_two_mass_axis_has_the_published_poles() -> None:
    found = np.sort_complex(poles(TWO_MASS))
    # design model of the ball screw: 0, -9.33, -14.71 ± 826.85j rad/s, given to these digits
    np.testing.assert_allclose(found[0].real, -14.71, atol=5e-3)
    np.testing.assert_allclose(np.abs(found[:2].imag), 826.85, atol=5e-3)
    np.testing.assert_allclose(found[2:].real, [-9.33, 0.0], atol=5e-3)


def test_three_mass_chain_has_the_modes_of_the_truth_plant() -> None:
    chain = ThreeMassChain(
        mass_motor=85.0, mass_screw=45.0, mass_load=33.0, coupling_stiffness=2.352e8, stiffness=1.8e7
    )
    M, _, K = matrices(Axis(plant=chain))
    frequencies = np.sqrt(np.maximum(eigh(K, M, eigvals_only=True), 0.0)) / (2 * np.pi)
    # the coupling alone between motor and screw makes 450 Hz; the table on the spring stiffens it by k/2m_screw
    alone = np.sqrt(2.352e8 * (1 / 85.0 + 1 / 45.0)) / (2 * np.pi)
    assert alone == pytest.approx(450.0, abs=0.1)
    assert frequencies[2] == pytest.approx(np.sqrt(alone**2 + 1.8e7 / 45.0 / (2 * np.pi) ** 2 * 85 / 130), rel=5e-3)
    # below it, the chain is the two-mass model with 130 kg
    assert frequencies[1] == pytest.approx(131.6, rel=0.02)
    assert frequencies[0] < 1e-3


def test_three_mass_chain_with_a_hard_coupling_is_the_two_mass_axis() -> None:
    chain = ThreeMassChain(
        mass_motor=85.0,
        mass_screw=45.0,
        mass_load=33.0,
        coupling_stiffness=1e13,
        stiffness=1.8e7,
        damping=700.0,
        viscous_motor=700.0,
        viscous_screw=800.0,
        viscous_load=20.0,
    )
    for frequency in (1.0, 100.0, 400.0):
        # what the coupling gives, as a share: 85 kg (2π 400 Hz)² / 1e13 N/m = 5e-5
        np.testing.assert_allclose(response(chain, frequency), response(TWO_MASS, frequency), rtol=6e-5)


def test_modal_axis_is_the_two_mass_axis_in_modal_coordinates() -> None:
    m1, m2, k, ratio = 130.0, 33.0, 1.8e7, 0.018
    omega = float(np.sqrt(k * (1 / m1 + 1 / m2)))
    reduced = m1 * m2 / (m1 + m2)
    damped = TwoMass(mass_motor=m1, mass_load=m2, stiffness=k, damping=2 * ratio * omega * reduced)
    # the mode moves the bodies against each other, so that their momenta cancel
    mode = Mode(frequency=omega / (2 * np.pi), damping_ratio=ratio, mass=m1 + m1 * m1 / m2, motor=1.0, load=-m1 / m2)
    modal = Modal(mass=m1 + m2, modes=(mode,))
    for frequency in (0.5, 20.0, 117.5, 131.6, 800.0):
        np.testing.assert_allclose(response(modal, frequency), response(damped, frequency), rtol=1e-9)


def test_modes_add_to_the_response_of_the_rigid_axis() -> None:
    modes = (
        Mode(frequency=80.0, damping_ratio=0.02, mass=900.0, motor=0.5, load=-2.0),
        Mode(frequency=33.0, damping_ratio=0.05, mass=4000.0, motor=-1.0, load=1.0),
    )
    s = 2j * np.pi * 50.0
    expected = np.ones((2, 2)) / (120.0 * s * s + 400.0 * s)
    for mode in modes:
        omega = 2 * np.pi * mode.frequency
        shape = np.array([mode.motor, mode.load])
        expected = expected + np.outer(shape, shape) / (
            mode.mass * (s * s + 2 * mode.damping_ratio * omega * s + omega**2)
        )
    found = response(Modal(mass=120.0, viscous=400.0, modes=modes), 50.0)
    # columns: drive force, which acts on the motor's body, and force on the load
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_milling_axes_have_the_published_masses() -> None:
    for carriage, total in ((60.0, 139.0), (100.0, 179.0), (40.0, 119.0)):
        axis = MillingAxis(inertia=2e-4, lead=0.010, carriage_mass=carriage, c_b=40.0, c_t=2e-4)
        # lead 10 mm and 2e-4 kg m² make 78.957 kg; the published totals are rounded to 1 kg
        assert axis.rigid_mass() == pytest.approx(total, abs=0.05)
        a = 0.010 / (2 * np.pi)
        assert axis.mechanics().damping[0][0] == pytest.approx(40.0 + 2e-4 / a**2, rel=1e-12)


def test_rotary_data_sheet_and_table_terms_agree() -> None:
    # torque to angular acceleration by hand: motor 2e-4 kg m², gear 2, screw 1e-4 kg m², lead 20 mm, table 100 kg
    plant = ScrewRigid(inertia_motor=2e-4, inertia_screw=1e-4, gear=2.0, lead=0.02, mass=100.0, viscous_bearings=1e-3)
    motor = Screw(torque_constant=0.8, lead=0.02, gear=2.0, peak_current=10.0, continuous_current=3.0, rated_speed=3000)
    current = 5.0
    radius = 0.02 / (2 * np.pi)
    inertia_at_motor = 2e-4 + (1e-4 + 100.0 * radius**2) / 2.0**2
    table_acceleration = 0.8 * current / inertia_at_motor / 2.0 * radius
    assert motor.force_per_unit() * current / plant.rigid_mass() == pytest.approx(table_acceleration, rel=1e-12)
    assert plant.mechanics().damping[0][0] == pytest.approx(1e-3 / radius**2, rel=1e-12)
    peak, continuous = motor.limits()
    assert peak == pytest.approx(0.8 * 10.0 * 2.0 / radius, rel=1e-12)
    assert continuous == pytest.approx(0.3 * peak, rel=1e-12)
    # 3000 turns of the motor a minute are 25 turns of the screw a second: 0.5 m/s
    assert motor.velocity_limit() == pytest.approx(0.5, rel=1e-12)


def test_power_is_the_same_at_motor_and_table() -> None:
    motor = Screw(torque_constant=0.5, lead=0.01, gear=3.0)
    speed = 0.2  # m/s at the table
    angular = speed / 0.01 * 2 * np.pi * 3.0  # rad/s at the motor
    assert motor.force_per_unit() * speed == pytest.approx(0.5 * angular, rel=1e-12)


def test_screw_two_mass_is_the_two_mass_axis_with_reflected_inertia() -> None:
    r = 2 * np.pi / 0.02
    plant = ScrewTwoMass(
        inertia_motor=1e-3,
        inertia_screw=3.5e-4,
        lead=0.02,
        mass_load=33.0,
        stiffness=1.8e7,
        damping=700.0,
        viscous_bearings=0.015,
        viscous_load=20.0,
    )
    same = TwoMass(
        mass_motor=1.35e-3 * r**2,
        mass_load=33.0,
        stiffness=1.8e7,
        damping=700.0,
        viscous_motor=0.015 * r**2,
        viscous_load=20.0,
    )
    assert plant.mechanics().mass[0][0] == pytest.approx(
        133.0, abs=0.5
    )  # motor, coupling and screw of the design model
    for one, other in zip(matrices(Axis(plant=plant)), matrices(Axis(plant=same)), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12)


def test_a_mass_matrix_that_is_not_positive_definite_is_refused() -> None:
    with pytest.raises(ParameterError, match=r"two_mass.coupling_mass = 70 kg must be smaller .* 65\.4981 kg"):
        TwoMass(mass_motor=130.0, mass_load=33.0, stiffness=1e7, coupling_mass=70.0)


@pytest.mark.parametrize("load", [1.0, -1.0])
def test_a_rigid_axis_with_a_mode_is_the_modal_one(load: float) -> None:
    mode = Mode(frequency=600.0, mass=800.0, load=load)
    one = WithMode(plant=Rigid(mass=40.0, viscous=30.0), mode=mode).mechanics()
    assert one == Modal(mass=40.0, viscous=30.0, modes=(mode,)).mechanics()


def test_a_mode_is_added_to_the_compliances_of_any_plant() -> None:
    """x = (G + φ φᵀ/(m (ω² - s² ...))) f at each body, with the shape φ of the mode."""
    mode = Mode(frequency=400.0, damping_ratio=0.02, mass=900.0, motor=1.0, load=0.5)
    s = 2j * np.pi * 230.0

    def compliance(plant: Plant) -> np.ndarray:
        found = plant.mechanics()
        M, C, K, S = (np.array(part, float) for part in found[:4])
        return S @ np.linalg.inv(M * s * s + C * s + K) @ S.T

    w = 2.0 * np.pi * 400.0
    eta = 1.0 / (900.0 * (s * s + 2.0 * 0.02 * w * s + w * w))
    shape = np.array([1.0, 0.5])
    np.testing.assert_allclose(
        compliance(WithMode(plant=TWO_MASS, mode=mode)), compliance(TWO_MASS) + eta * np.outer(shape, shape), rtol=1e-9
    )
    assert WithMode(plant=TWO_MASS, mode=mode).stiffness == TWO_MASS.stiffness
    assert WithMode(plant=TWO_MASS, mode=mode).rigid_mass() == pytest.approx(TWO_MASS.rigid_mass(), rel=1e-12)


def test_the_drive_may_act_on_another_body_than_that_of_the_motors_encoder() -> None:
    plant = ThreeMassChain(mass_motor=60.0, mass_screw=70.0, mass_load=33.0, coupling_stiffness=1e8, stiffness=1.8e7)
    mode = Mode(frequency=900.0, mass=900.0)
    plain, found = plant.mechanics(), WithMode(plant=plant, mode=mode).mechanics()
    assert plain.drive != plain.motor
    for name in ("drive", "motor", "load"):
        assert found.shape[getattr(found, name)][1:] == plain.shape[getattr(plain, name)]
