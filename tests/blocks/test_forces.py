"""Forces: their closed forms, what an axis does under them, and on which plants they have a meaning."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from axis_runs import move
from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.families import Force
from feeddrive.blocks.force.backlash import Backlash
from feeddrive.blocks.force.cogging import Cogging
from feeddrive.blocks.force.force_map import ForceMap
from feeddrive.blocks.force.gravity import Gravity
from feeddrive.blocks.force.harmonic import Harmonic
from feeddrive.blocks.force.ripple import Ripple
from feeddrive.blocks.force.screw_error import ScrewError
from feeddrive.blocks.friction.coulomb import Coulomb
from feeddrive.blocks.plant.lead_error import LeadError
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.plant.three_mass_chain import ThreeMassChain
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.blocks.signals import Motion
from feeddrive.language.errors import StructureError
from feeddrive.loop.axis import Axis
from slow_share import all_but

TWO_MASS = TwoMass(mass_motor=130.0, mass_load=33.0, stiffness=1.8e7, damping=700.0)
RIGID = Rigid(mass=40.0)
ERROR = LeadError(row=[0.0, 8e-6, -4e-6, 2e-6], start=-0.02, spacing=0.02)


def forces(force: Force, position: float, *, motor: float | None = None, drive: float = 0.0, time: float = 0.0) -> Any:
    motion = Motion(position if motor is None else motor, position, 0.0, 0.0)
    with np.errstate(all="ignore"):
        _, *found = force.step(force.start(TWO_MASS, motion), TWO_MASS, motion, drive, time, 1e-4)
        return found


def test_cogging_is_its_fourier_series() -> None:
    parts = (Harmonic(order=1, share=1.0, phase=0.4), Harmonic(order=2, share=-0.3), Harmonic(order=6, share=0.05))
    force = Cogging(force=12.0, period=0.032, harmonics=parts)
    for x in np.linspace(-0.1, 0.2, 41):
        angle = 2 * np.pi * x / 0.032
        series = np.sin(angle + 0.4) - 0.3 * np.sin(2 * angle) + 0.05 * np.sin(6 * angle)
        on_motor, on_load = forces(force, 0.7, motor=float(x))
        assert on_motor == pytest.approx(12.0 * series, abs=1e-11)  # 1e-15 of the angle's 40 rad, times 12 N
        assert on_load == 0.0


def test_cogging_holds_an_axis_in_its_valleys() -> None:
    # a rigid axis between two teeth swings about the stable zero of the force, where its slope is negative
    force = Cogging(force=50.0, period=0.02)
    axis = Axis(plant=Rigid(mass=40.0, viscous=2000.0), forces=(force,))
    found = move(axis, 1e-3, np.zeros(3000), position=0.006)
    assert found.position[-1, 0] == pytest.approx(0.01, abs=1e-9)


def test_force_at_the_middle_of_the_substep_makes_order_two() -> None:
    force = Cogging(force=50.0, period=0.004)
    stiff = 2 * np.pi / 0.004

    def slope(_t: float, y: np.ndarray) -> list[float]:
        return [y[1], 50.0 / 40.0 * np.sin(stiff * y[0])]

    true = solve_ivp(slope, (0.0, 0.2), [0.001, 0.05], method="DOP853", rtol=1e-12, atol=1e-14).y[0, -1]
    errors = []
    for substeps in (1, 2, 4, 8):
        axis = Axis(plant=RIGID, forces=(force,), substeps=substeps)
        errors.append(abs(move(axis, 2e-3, np.zeros(100), position=0.001, velocity=0.05).position[-1, 0] - true))
    assert np.polyfit(np.log([1, 2, 4, 8]), np.log(errors), 1)[0] == pytest.approx(-2.0, abs=0.1)


def test_ripple_is_a_share_of_the_drive_force() -> None:
    force = Ripple(period=0.032, harmonics=(Harmonic(order=1, share=0.02), Harmonic(order=6, share=0.01, phase=1.0)))
    x = 0.0047
    share = 0.02 * np.sin(2 * np.pi * x / 0.032) + 0.01 * np.sin(12 * np.pi * x / 0.032 + 1.0)
    for drive in (0.0, 300.0, -120.0):
        on_motor, on_load = forces(force, x, drive=drive)
        assert on_motor == pytest.approx(drive * share, abs=1e-12)
        assert on_load == 0.0


@pytest.mark.parametrize("lag", [None, 300.0])
def test_ripple_follows_the_force_that_acts_and_not_the_one_commanded(lag: float | None) -> None:
    # With a ripple that is a constant factor (its phase does not move with x), the axis is one with another gain.
    T = 1e-3
    rng = np.random.default_rng(5)
    commands = rng.normal(0.0, 200.0, 40)
    whole = Ripple(period=1e6, harmonics=(Harmonic(order=1, share=0.1, phase=float(np.pi / 2)),))
    actuator = Actuator(dead_time=0.4e-3, current_loop=lag)
    gains = []
    for substeps in (1, 4, 16):
        found = move(Axis(plant=RIGID, actuator=actuator, forces=(whole,), substeps=substeps), T, commands)
        plain = move(Axis(plant=RIGID, actuator=actuator, substeps=substeps), T, 1.1 * commands)
        gains.append(float(np.max(np.abs(found.velocity - plain.velocity)) / np.max(np.abs(plain.velocity))))
    # without lag the impulse of the mean force is exact; with it the mean is that of the two ends of the substep
    assert gains[0] < (1e-10 if lag is None else 0.05)
    assert gains[2] < (1e-10 if lag is None else 0.05 / 16)


def test_gravity_is_held_by_friction_or_accelerates() -> None:
    down = Gravity(force=-390.0)
    held = move(Axis(plant=RIGID, forces=(down,), friction_load=Coulomb(coulomb=391.0)), 1e-3, np.zeros(20))
    assert np.all(held.velocity == 0.0)
    free = move(Axis(plant=RIGID, forces=(down,)), 1e-3, np.zeros(20))
    np.testing.assert_allclose(free.position[:, 0], -0.5 * 390.0 / 40.0 * (1e-3 * np.arange(21)) ** 2, atol=1e-17)
    balanced = move(Axis(plant=RIGID, forces=(down,)), 1e-3, np.full(20, 390.0))
    np.testing.assert_allclose(balanced.velocity, 0.0, atol=1e-15)


def test_gravity_of_a_two_mass_axis_stretches_its_spring() -> None:
    found = move(Axis(plant=TWO_MASS, forces=(Gravity(force=-330.0),)), 1e-3, np.full(3000, 330.0))
    stretch = found.position[-1, 1] - found.position[-1, 0]
    assert stretch == pytest.approx(-330.0 / 1.8e7, rel=1e-6)


def test_force_map_interpolates_and_swings() -> None:
    still = ForceMap(row=[0.0, 100.0, 40.0], begin=0.1, spacing=0.05)
    for x, force in ((0.0, 0.0), (0.1, 0.0), (0.125, 50.0), (0.15, 100.0), (0.175, 70.0), (0.2, 40.0), (0.3, 40.0)):
        assert tuple(forces(still, x, time=3.3)) == (0.0, pytest.approx(force, abs=1e-10))
    swinging = ForceMap(row=[200.0, 200.0], begin=0.0, spacing=1.0, mean=0.5, swing=0.25, frequency=60.0, phase=0.3)
    for t in np.linspace(0.0, 0.1, 17):
        expected = 200.0 * (0.5 + 0.25 * np.sin(2 * np.pi * 60.0 * t + 0.3))
        assert forces(swinging, 0.5, time=float(t))[1] == pytest.approx(expected, abs=1e-10)


def test_screw_error_moves_the_table_of_a_held_screw() -> None:
    # the screw is so heavy that it stands; the table then rests where its spring is relaxed
    plant = TwoMass(mass_motor=1e9, mass_load=33.0, stiffness=1.8e7, damping=2e4)
    for place, error in ((0.0, 8e-6), (0.01, 2e-6), (0.02, -4e-6), (0.5, 2e-6), (-0.5, 0.0)):
        found = move(Axis(plant=plant, forces=(ScrewError(lead_error=ERROR),)), 1e-3, np.zeros(200), position=place)
        assert found.position[-1, 1] - place == pytest.approx(error, abs=1e-12)


def dead_zone(stretch: float, half: float) -> float:
    return stretch - min(max(stretch, -half), half)


@pytest.mark.parametrize("with_error", all_but([True], [False, True], "the same without the error of the lead"))
def test_backlash_is_the_dead_zone_of_the_spring(with_error: bool) -> None:
    gap, k, c = 20e-6, 1.8e7, 700.0
    error = ERROR if with_error else None

    def slope(t: float, y: np.ndarray) -> list[float]:
        e = float(np.interp(y[0], [-0.02, 0.0, 0.02, 0.04], ERROR.row)) if with_error else 0.0
        spring = k * dead_zone(y[0] + e - y[1], 0.5 * gap) + c * (y[2] - y[3])
        force = 400.0 * float(np.sin(2 * np.pi * 8.0 * (np.floor(t / T + 1e-9) * T)))
        return [y[2], y[3], (force - spring - 200.0 * y[2]) / 130.0, (spring - 200.0 * y[3]) / 33.0]

    T, n = 5e-4, 400
    plant = TwoMass(mass_motor=130.0, mass_load=33.0, stiffness=k, damping=c, viscous_motor=200.0, viscous_load=200.0)
    y = np.zeros(4)
    rows = [y]
    for i in range(n):
        done = solve_ivp(slope, (i * T, (i + 1) * T - 1e-12), y, method="DOP853", rtol=1e-9, atol=1e-13, max_step=T / 4)
        y = done.y[:, -1]
        rows.append(y)
    true = np.array(rows)
    stretch = true[:, 0] - true[:, 1]
    assert np.mean(np.abs(stretch) < 0.4 * gap) > 0.03  # it does cross the gap
    commands = 400.0 * np.sin(2 * np.pi * 8.0 * T * np.arange(n))
    errors = []
    for substeps in (1, 2, 4, 8, 16):
        axis = Axis(plant=plant, forces=(Backlash(gap=gap, lead_error=error),), substeps=substeps)
        found = move(axis, T, commands)
        errors.append(float(np.max(np.abs(found.position[:, 1] - true[:, 1]))))
    # At a substep of a fifteenth of the mode's period, an eighth of the gap in 1 mm of travel.  The edge of the gap is
    # a kink that falls anywhere in a substep: order 2 in the mean, and at least order 1 over a factor of 16.
    assert errors[0] < gap / 8
    assert errors[-1] < errors[0] / 16


def test_no_gap_is_no_backlash() -> None:
    commands = np.random.default_rng(2).normal(0.0, 500.0, 50)
    plain = move(Axis(plant=TWO_MASS), 1e-3, commands)
    found = move(Axis(plant=TWO_MASS, forces=(Backlash(gap=0.0),)), 1e-3, commands)
    assert np.array_equal(found.position, plain.position)


@pytest.mark.parametrize("force", [Backlash(gap=1e-5), ScrewError(lead_error=ERROR)], ids=lambda force: force.kind)
def test_a_plant_without_a_spring_is_refused(force: Force) -> None:
    with pytest.raises(StructureError, match=rf"'{force.kind}' acts on the spring .* the plant 'rigid' has no spring"):
        Axis(plant=RIGID, forces=(force,))
    Axis(
        plant=ThreeMassChain(mass_motor=85, mass_screw=45, mass_load=33, coupling_stiffness=2e8, stiffness=1.8e7),
        forces=(force,),
    )


def test_one_deflection_is_not_counted_twice() -> None:
    for other in (ScrewError(lead_error=ERROR), Backlash(gap=1e-5)):
        with pytest.raises(StructureError, match="count a deflection twice"):
            Axis(plant=TWO_MASS, forces=(Backlash(gap=1e-5), Gravity(force=1.0), other))


def test_a_force_without_harmonics_is_refused() -> None:
    with pytest.raises(StructureError, match=r"cogging.harmonics is empty"):
        Cogging(force=10.0, period=0.02, harmonics=())
    with pytest.raises(StructureError, match=r"ripple.harmonics is empty"):
        Ripple(period=0.02, harmonics=())
