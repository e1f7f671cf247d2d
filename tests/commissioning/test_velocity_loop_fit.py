"""The velocity loop of a drive by its responses, which are closed forms here: no line of the simulator made them."""

from __future__ import annotations

import numpy as np
import pytest

from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.commissioning import motions
from feeddrive.commissioning.motions import Pace
from feeddrive.commissioning.velocity_loop import fit_velocity_loop, gain_of
from feeddrive.language.errors import NotIdentifiableError
from feeddrive.loop.axis import Axis
from feeddrive.loop.frequency_response import FRF

T = 1e-3  # s
KP, TN, LAG, LATE = 12e3, 0.025, 6e-4, 2.4e-3
MOTOR, LOAD, STIFFNESS, DAMPING, VISCOUS = 22.0, 38.0, 1.1e7, 1500.0, 300.0
F = np.geomspace(1.0, 180.0, 60)  # Hz
S = 2j * np.pi * F
HOLD = (1.0 - np.exp(-S * T)) / (S * T)


def two_mass() -> tuple[np.ndarray, np.ndarray]:
    """Positions of motor and load over a force on the motor, m/N."""
    spring = STIFFNESS + DAMPING * S
    a, b = MOTOR * S**2 + VISCOUS * S + spring, LOAD * S**2 + spring
    det = a * b - spring**2
    return b / det, spring / det


def responses(
    noise: float = 0.0, smoothed: float | None = None, late: float = LATE
) -> tuple[dict[str, FRF], dict[str, FRF]]:
    """Responses to velocities, which the drive may smooth (Hz), and to forces held over a sample; with noise, a known
    share of them.
    """
    motor, load = two_mass()
    C = KP * (1.0 + 1.0 / (TN * S)) / (1.0 + S * LAG)
    smooth = 1.0 if smoothed is None else 1.0 / (1.0 + S / (2.0 * np.pi * smoothed))
    rng = np.random.default_rng(4)
    led, pushed = dict[str, FRF](), dict[str, FRF]()
    for name, P in (("reading_motor", motor), ("reading_load", load)):
        closed = P / (1.0 + S * C * motor) * HOLD * np.exp(-S * late)
        for made, values, unit in ((led, smooth * C * closed, "m/(m/s)"), (pushed, closed / (1.0 + S * LAG), "m/N")):
            spread = noise * np.abs(values)
            noisy = values + spread * (rng.normal(size=F.size) + 1j * rng.normal(size=F.size)) / np.sqrt(2.0)
            variance = np.maximum(spread, 1e-6 * np.abs(values)) ** 2
            made[name] = FRF(F, noisy, variance=variance, input="x", output=name, unit=unit)
    return led, pushed


def known(wrong: float = 1.0) -> Axis:
    plant = TwoMass(
        mass_motor=wrong * MOTOR,
        mass_load=wrong * LOAD,
        stiffness=STIFFNESS,
        damping=DAMPING,
        viscous_motor=1.0,
    )
    return Axis(plant=plant)


def test_gains_are_found_from_masses_that_are_a_fifth_off() -> None:
    led, pushed = responses(noise=0.02)
    found = fit_velocity_loop(known(1.2), led, pushed, T, 0.0)
    plant = found.axis.plant
    assert isinstance(plant, TwoMass)
    # 2 % of noise on 240 numbers leave a few tenths of a percent of what all lines tell, and 2 % of Tn and lag; the
    # rest is the order 1 of a loop that is sampled four times in a sample of 1 ms, whose half substep the lag takes
    assert float(found.loop.Kp) == pytest.approx(KP, rel=0.03)
    assert float(plant.mass_motor) + float(plant.mass_load) == pytest.approx(MOTOR + LOAD, rel=0.02)
    assert float(found.loop.Tn or 0.0) == pytest.approx(TN, rel=0.06)
    total = float(found.loop.lag or 0.0) + float(found.axis.actuator.dead_time)
    assert total == pytest.approx(LAG + LATE, abs=2.5e-4)  # s, a substep
    assert found.by_velocity < 0.03
    assert found.by_force < 0.03


def test_the_dead_time_of_a_slow_bus_is_found() -> None:
    led, pushed = responses(late=0.03)
    found = fit_velocity_loop(known(), led, pushed, T, 0.0)
    assert float(found.axis.actuator.dead_time) == pytest.approx(0.03, abs=2.5e-4)  # s, a substep


@pytest.mark.slow(reason="a long search for a loop that there is not; the other refusals are quick")
def test_a_drive_that_smooths_its_command_slowly_is_refused() -> None:
    led, pushed = responses(smoothed=4.0)
    with pytest.raises(
        NotIdentifiableError, match=r"no PI velocity loop explains the responses of the drive: up to .* % off"
    ):
        fit_velocity_loop(known(), led, pushed, T, 0.0)


def test_lines_that_are_lost_in_noise_say_nothing() -> None:
    led, pushed = responses()
    for group in (led, pushed):
        for name, frf in group.items():
            wrong, variance = frf.response.copy(), np.array(frf.variance)
            wrong[:15] *= 7.0
            variance[:15] = np.abs(wrong[:15]) ** 2
            group[name] = FRF(F, wrong, variance=variance, input="x", output=name, unit=frf.unit)
    found = fit_velocity_loop(known(), led, pushed, T, 0.0)
    assert float(found.loop.Kp) == pytest.approx(KP, rel=0.03)


def test_the_rough_gain_is_the_least_impedance() -> None:
    # of a rigid axis, |C + m s + b| is least near the gain
    s = S
    C = KP * (1.0 + 1.0 / (TN * s))
    answer = 1.0 / (s * (C + 60.0 * s + VISCOUS))
    assert gain_of(FRF(F, answer, input="f", output="x")) == pytest.approx(KP, rel=0.1)


def test_a_rigid_plant_is_fitted_too() -> None:
    C = KP * (1.0 + 1.0 / (TN * S)) / (1.0 + S * LAG)
    closed = HOLD * np.exp(-S * LATE) / (S * (60.0 * S + VISCOUS) + S * C)
    of = {"input": "x", "output": "reading_load", "variance": (1e-3 * np.abs(closed)) ** 2}
    led = {"reading_load": FRF(F, C * closed, **of | {"variance": (1e-3 * np.abs(C * closed)) ** 2})}
    found = fit_velocity_loop(
        Axis(plant=Rigid(mass=50.0)), led, {"reading_load": FRF(F, closed / (1.0 + S * LAG), **of)}, T, 7.0
    )
    # 4 %: a force offset is held over a sample, and the velocities that stand for it make a ramp of T/Tn in it
    assert float(found.axis.plant.rigid_mass()) == pytest.approx(60.0, rel=0.04)
    assert found.loop.held_force == 7.0


def test_the_lines_of_a_multisine_are_a_share_apart() -> None:
    lines = motions.lines_of(200.0, 0.5)
    assert lines[0] == 1
    assert lines[-1] * 0.5 <= 200.0
    apart = np.diff(lines)
    # near each other they are all there, far up a line comes after 6 % of its frequency, rounded to a multiple
    assert np.all(apart[lines[:-1] < 10] == 1)
    high = lines[:-1] > 100
    assert apart[high] / lines[:-1][high] == pytest.approx(0.06, abs=0.01)


def test_an_even_move_carries_whole_periods() -> None:
    period, pace = 400, Pace(speed=0.1, acceleration=1.0)
    made = motions.shaken("responses", 0.05, np.array([1, 3, 8]), period, 3, pace, T, seed=2)
    rows = made.whole
    wave = made.profile.excitation[rows].reshape(3, period)
    assert np.ptp(wave, axis=0) == pytest.approx(np.zeros(period), abs=1e-12)
    # the speed is even meanwhile, m/s: the axis slides one way
    speed = np.diff(made.profile.set_position[rows]) / T
    assert speed == pytest.approx(np.full(speed.size, speed[0]), rel=1e-9)
    assert speed[0] > 0.0
    sized = made.sized(25.0, "N")
    assert np.max(np.abs(sized.excitation)) == pytest.approx(25.0, rel=1e-12)
    assert sized.unit == "N"
