"""Load: RMS force, heat, losses and energy against closed forms, and on a machine that ran."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.actuator.direct import Direct
from feeddrive.blocks.reference.trapezoidal_move import TrapezoidalMove
from feeddrive.language.errors import ParameterError
from feeddrive.loop.machine import Machine
from feeddrive.loop.simulate import simulate
from feeddrive.machining.load import axis_load, machine_load, spindle_load
from machining.circles import VISCOUS, axis

STEPS = 110_000  # of 10 us: the course is a straight line in each, so that its middle is right to second order
T = 1.1 / STEPS


def trapezoid() -> tuple[np.ndarray, np.ndarray]:
    """Force in the middle of each step and position at its ends: 400 kg, 400 N s/m, 150 N, 0.5 m, 0.5 m/s, 5 m/s²."""

    def course(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        ramps = [np.clip(t, 0.0, 0.1), np.clip(1.1 - t, 0.0, 0.1)]
        speed = 5.0 * np.minimum(*ramps)
        place = (
            2.5 * ramps[0] ** 2 + 0.5 * np.clip(t - 0.1, 0.0, 0.9) + np.where(t > 1.0, 0.025 - 2.5 * ramps[1] ** 2, 0)
        )
        return place, speed, np.where(t < 0.1, 5.0, np.where(t > 1.0, -5.0, 0.0))

    _, speed, acceleration = course((np.arange(STEPS) + 0.5) * T)
    return 400.0 * acceleration + 400.0 * speed + 150.0, course(np.arange(STEPS + 1) * T)[0]


def test_the_golden_trapezoid() -> None:
    force, position = trapezoid()
    assert position[-1] == pytest.approx(0.5, abs=1e-12)
    found = axis_load(force, position, T)
    assert found.duration == pytest.approx(1.1)
    assert found.rms == pytest.approx(916.2257893, abs=1e-7)
    assert found.work == pytest.approx(171.6666667, abs=1e-7)
    # what braking gives back begins with it: 2150 N x 25 mm + 10/3 J + 350 N x 0.45 m are drawn
    assert found.drawn == pytest.approx(53.75 + 10.0 / 3.0 + 157.5, abs=1e-7)
    assert found.recovered == pytest.approx(found.drawn - found.work)


def test_heat_against_its_closed_form() -> None:
    """Twice the continuous force for a third of the cycle: 4/3 of the heat in the mean, more at the end of the push."""
    force = np.concatenate([np.full(100, 200.0), np.zeros(200)])
    found = axis_load(
        force, np.zeros(301), 0.1, continuous_force=100.0, peak_force=250.0, time_constant=20.0, motor_constant=8.0
    )
    assert found.heat is not None
    assert found.heat[100] == pytest.approx(4.0 * -np.expm1(-0.5), rel=1e-12)
    assert found.heat[-1] == pytest.approx(4.0 * -np.expm1(-0.5) * np.exp(-1.0), rel=1e-12)
    assert found.heat_repeated == pytest.approx(4.0 * np.expm1(-0.5) / np.expm1(-1.5), rel=1e-12)
    assert found.verdict == "trips"
    assert found.copper_loss == pytest.approx(200.0**2 / 8.0**2 / 3.0)
    assert found.of_peak == pytest.approx(0.8)


@pytest.mark.parametrize(
    ("force", "said"), [(85.0, "fits"), (95.0, "warns"), (100.0, "trips"), (300.0, "beyond the peak force")]
)
def test_drives_warn_at_80_percent_of_the_heat(force: float, said: str) -> None:
    found = axis_load(np.full(10, force), np.zeros(11), 1.0, continuous_force=100.0, peak_force=250.0)
    assert found.verdict == said
    assert axis_load(np.full(10, force), np.zeros(11), 1.0).verdict == "no continuous force stated"


def test_the_work_of_a_run_is_what_friction_took() -> None:
    """Between rest and rest all mechanical energy goes into the viscous friction b ∫ v² dt."""
    loop = axis()
    motor = Direct(force_constant=100.0, continuous_force=500.0, peak_force=2000.0)
    loop = replace(loop, axis=replace(loop.axis, actuator=Actuator(motor=motor)))
    machine = Machine.of({"x": loop, "y": loop})
    moves = {
        "x": TrapezoidalMove(distance=0.1, velocity=0.2, acceleration=2.0, dwell_after=1.0),
        "y": TrapezoidalMove(distance=0.05, velocity=0.2, acceleration=2.0, dwell_after=1.0),
    }
    run = simulate(machine, moves)
    found = machine_load(run, machine, motor_constant={"x": 50.0}, time_constant={"x": 60.0})
    assert found.axes["x"].continuous_force == 500.0
    assert found.axes["y"].copper_loss is None
    for name, load in found.axes.items():
        v = run[f"{name}.velocity_load"]
        taken = VISCOUS * float(np.sum(0.5 * (v[1:] ** 2 + v[:-1] ** 2))) * run.sample_time
        assert load.work == pytest.approx(taken, rel=1e-5)  # the trapezoidal rule of v²
        assert load.drawn > load.work
    spent = found.axes["x"].loss
    assert spent is not None
    whole = found.axes["x"].work + found.axes["y"].work + spent
    assert found.energy() == pytest.approx(whole, rel=1e-12)
    assert "500" not in str(found)
    assert "fits" in str(found)


def test_power_of_the_spindle() -> None:
    found = spindle_load(np.array([2.0, 4.0, 0.0]), 6000.0, 0.5, volume=1e-6)
    omega = 6000.0 * 2.0 * np.pi / 60.0
    assert found.power == pytest.approx(2.0 * omega)
    assert found.peak == pytest.approx(4.0 * omega)
    assert found.energy == pytest.approx(3.0 * omega)
    assert found.specific_energy == pytest.approx(3e6 * omega)


def test_wrong_input_is_named() -> None:
    for wrong, said in (
        (lambda: axis_load(np.ones(3), np.ones(3), 1.0), "one position more"),
        (lambda: axis_load(np.array([np.nan]), np.ones(2), 1.0), "not finite"),
        (lambda: axis_load(np.ones(1), np.ones(2), 1.0, continuous_force=0.0), "continuous_force = 0 N must be"),
        (lambda: spindle_load(np.ones(3), 100.0, 1.0, volume=0.0), "volume = 0 m3"),
    ):
        with pytest.raises(ParameterError, match=said):
            wrong()
    loop = axis()
    run = simulate(loop, TrapezoidalMove(distance=0.1, velocity=0.2, acceleration=2.0))
    assert machine_load(run, loop).axes["x"].peak > 0.0
    with pytest.raises(ParameterError, match="no axis 'y'; there are x"):
        machine_load(run, loop, motor_constant={"y": 1.0})
