"""Linear ADRC: golden gains and forces, its observer's poles, and what it is against GPI control with Taylor states."""

from __future__ import annotations

import cmath
import math

import numpy as np
import pytest

from feeddrive.blocks.controller.active_disturbance_rejection import ActiveDisturbanceRejection
from feeddrive.blocks.controller.linear_adrc import LinearADRC
from feeddrive.blocks.observer.gpi_observer import GpiObserver
from feeddrive.blocks.signals import Reading, Setpoint
from field_laws import (
    T,
    W,
    golden_forces,
    judged,
    loop,
    stable_masses,
    start_under_load,
    step_into_the_limit,
    stiffness_at,
)


def ladrc(
    omega_c: float = 300.0, omega_o: float = 1200.0, late: int = 1, mass: float = 40.0, **more: str
) -> LinearADRC:
    return LinearADRC(mass=mass, omega_c=omega_c, omega_o=omega_o, delay_samples=late, **more)


def observer(states: int, zeta_o: float = 1.0, late: int = 1, omega_o: float = 1200.0) -> GpiObserver:
    return GpiObserver(mass=40.0, taylor_states=states, omega_o=omega_o, zeta_o=zeta_o, delay_samples=late)


def gpi(states: int, zeta: float = 1.0, late: int = 1) -> ActiveDisturbanceRejection:
    """GPI control at the rates of `ladrc`."""
    return ActiveDisturbanceRejection(mass=40.0, omega_c=300.0, zeta_c=zeta, observer=observer(states, zeta, late))


def test_the_golden_gains_and_forces() -> None:
    """To the ten digits that are published."""
    assert ladrc().prepare(T).gain == pytest.approx((0.3023236739, 361.9204243, 5783787.909), rel=3e-10)
    expected = [0.0, -4.597775281, -11.69570961, -19.39765297, -26.10021819, -30.56609662]
    assert golden_forces(ladrc(late=0)) == pytest.approx(expected, rel=6e-10)
    expected = [0.0, -4.597775281, -11.96470346, -20.06198357, -27.13851291, -31.84241429]
    assert golden_forces(ladrc()) == pytest.approx(expected, rel=6e-10)
    expected = [0.0, -3.347115252, -9.800759610, -17.38656780, -24.40064742, -29.49046712]
    assert golden_forces(gpi(1, late=0)) == pytest.approx(expected, rel=6e-10)


def test_it_is_the_published_recursion_far_from_zero_too() -> None:
    """x̂ itself, at 2 m, with a moving set point, against x̂ - y in the law: 1e-15 m of rounding at 3.6e6 N/m."""
    law, wc = ladrc(), 300.0
    beta = math.exp(-0.12)
    gains = np.array([1 - beta**3, 3 * (1 - beta) ** 2 * (1 + beta) / (2 * T), 40 * (1 - beta) ** 3 / T**2])
    prepared, state = law.prepare(T), law.start(law.prepare(T), Setpoint(2.0), Reading(2.0, 2.0))
    z, applied, before = np.array([2.0, 0.0, 0.0]), 0.0, 0.0
    for k in range(200):
        setpoint = Setpoint(2.0 + 1e-3 * math.sin(0.02 * k), 0.2 * math.cos(0.02 * k), -40.0 * math.sin(0.02 * k))
        y = 2.0 + 2e-6 * math.sin(0.3 * k)
        state, force = law.step(prepared, state, setpoint, Reading(y, y, applied), T)
        f = (before + z[2]) / 40.0
        guess = np.array([z[0] + T * z[1] + 0.5 * T * T * f, z[1] + T * f, z[2]])
        z = guess + gains * (y - guess[0])
        wanted = setpoint.acceleration + 2 * wc * (setpoint.velocity - z[1]) + wc**2 * (setpoint.position - z[0])
        assert force == pytest.approx(40.0 * wanted - z[2], abs=1e-6)
        before, applied = applied, 0.8 * float(force)


def test_all_poles_of_the_observer_lie_at_beta() -> None:
    """The characteristic polynomial of its error is (z - β)³."""
    step = np.array([[1.0, T, T * T / 80.0], [0.0, 1.0, T / 40.0], [0.0, 0.0, 1.0]])
    error = (np.eye(3) - np.outer(ladrc().prepare(T).gain, [1.0, 0.0, 0.0])) @ step
    assert np.poly(error) == pytest.approx(np.poly([math.exp(-0.12)] * 3), abs=1e-13)


def test_against_GPI_at_equal_rates() -> None:
    """Ms, ISE^½ in nm and noise at 300 and 1200 rad/s: more Taylor states are bought with margin and noise."""
    own, one, three, five = (judged(loop(law)) for law in (ladrc(), gpi(1), gpi(3), gpi(5)))
    assert [each.peak for each in (own, one, three, five)] == pytest.approx([1.791, 1.815, 2.67, 3.56], rel=2e-3)
    ise = [1e9 * each.ise for each in (own, one, three, five)]
    assert ise == pytest.approx([8.82, 8.99, 1.38, 0.73], rel=5e-3)
    assert [three.noise / own.noise, five.noise / own.noise] == pytest.approx([4.5, 11.6], rel=0.015)


def test_the_dead_time_told_and_the_noise_of_a_fast_observer() -> None:
    fast = judged(loop(ladrc(omega_o=4800.0)))
    assert judged(loop(ladrc(omega_o=4800.0, late=0))).peak == pytest.approx(1.828, abs=6e-4)
    assert fast.peak == pytest.approx(1.616, abs=6e-4)
    noise = [judged(loop(ladrc(omega_o=rate))).noise for rate in (600.0, 1200.0, 2400.0)]
    assert [*noise, fast.noise] == pytest.approx([7.3e6, 2.4e7, 9.1e7, 3.7e8], rel=0.012)  # N/m, of two digits


def test_how_wrong_the_mass_may_be() -> None:
    """True mass over the model's: far less of GPI with five Taylor states (damping ratios of its paper)."""
    assert stable_masses(loop(ladrc())) == pytest.approx((0.281, 4.99), rel=0.01)
    assert stable_masses(loop(gpi(5, 0.7071))) == pytest.approx((0.641, 1.27), rel=0.01)


def left(block: LinearADRC | GpiObserver, ratio: float, rate: float) -> float:
    """|1 - H|: what is left of a sine force on a free mass, at a ratio of the observer's frequency."""
    omega, prepared = ratio * rate, block.prepare(T)
    z, y = cmath.exp(1j * omega * T), 1.0 / (40.0 * (1j * omega) ** 2)
    at_rest, found = Reading(y, y), 0.0
    state = (
        block.start(prepared, at_rest)
        if isinstance(block, GpiObserver)
        else block.start(prepared, Setpoint(0.0), at_rest)
    )
    for k in range(1, round(60.0 / (rate * T))):
        reading = Reading(y * z**k, y * z**k)
        if isinstance(block, GpiObserver):
            state, estimate = block.step(prepared, state, reading, T)
            found = estimate.disturbance
        else:
            state, _ = block.step(prepared, state, Setpoint(0.0), reading, T)
            found = state.disturbance
        last = abs(1.0 - found / z**k)
    return last


def test_what_of_a_disturbance_is_left() -> None:
    """Published in continuous time, with ζ 0.7071 of GPI: at a slow rate, and less of the sampled law at a fast one."""
    slow = 120.0
    blocks = (ladrc(omega_o=slow), *(observer(n, 0.7071, omega_o=slow) for n in (1, 3, 5)))
    expected = [0.29605, 0.24042, 0.00679, 0.00013]
    # sampled every 0.012/omega_o: 0.2 % of the first, 2 % of a fifth power
    assert [left(block, 0.1, slow) for block in blocks] == pytest.approx(expected, rel=3e-3, abs=2.5e-6)
    assert left(ladrc(omega_o=slow), 0.866, slow) == pytest.approx(1.286, rel=2e-3)


def test_the_published_rows_on_both_axes() -> None:
    """At the published knobs: ISE^½, Ms and stiffness; on W the observer belongs on the motor."""
    tuned = loop(ladrc(806.0, 8059.0))
    assert judged(tuned).ise == pytest.approx(3.05e-10, rel=2e-3)
    assert judged(tuned).noise == pytest.approx(1.5e9, rel=2e-3)
    assert stiffness_at(tuned, [10.0, 100.0]) == pytest.approx([759.0, 118.0], rel=6e-3)
    alone = judged(loop(ladrc(129.0, 253.0, mass=163.0), on=W))
    both = judged(loop(ladrc(256.0, 1728.0, mass=0.81 * 163.0, encoder="motor", position="load"), on=W))
    assert [1e9 * alone.ise, 1e9 * both.ise] == pytest.approx([43.8, 7.09], rel=3e-3)
    assert [alone.peak, both.peak] == pytest.approx([2.0, 2.0], rel=3e-3)


def test_a_jump_into_the_limit_and_a_start_under_load() -> None:
    """1.5 mm of overshoot at 400 N, 13.7 mm published of a law that is blind to the limit; no step at a start."""
    assert 1e3 * step_into_the_limit(ladrc()) == pytest.approx(1.5, abs=0.06)
    step, moved = start_under_load(ladrc())
    assert abs(step) < 1e-11  # N
    assert moved < 1e-16  # m


def test_a_live_change_of_the_rates_keeps_the_estimate() -> None:
    """At rest under 400 N the new observer holds them too."""
    old, new, reading = ladrc(), ladrc(400.0, 2000.0), Reading(0.1, 0.1, 400.0, 400.0)
    state = old.start(old.prepare(T), Setpoint(0.1), reading)
    for _ in range(3):
        state, _ = old.step(old.prepare(T), state, Setpoint(0.1), reading, T)
    state = new.retune(state, old, old.prepare(T), new.prepare(T))
    _, force = new.step(new.prepare(T), state, Setpoint(0.1), reading, T)
    assert force == pytest.approx(400.0, abs=1e-11)
