"""The P-PI cascade: its law by hand, and the position loop that runs every n-th sample."""

from __future__ import annotations

import numpy as np
import pytest

from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.signals import Reading, Setpoint
from feeddrive.language import tree

T = 1e-3


def run(law: CascadePPI, setpoints: list[Setpoint], readings: list[Reading]) -> np.ndarray:
    """Forces in N; without a limit, what is requested is applied."""
    state = law.start(CascadePPI.Prepared(T), setpoints[0], readings[0])
    prepared = law.prepare(T)
    found = []
    for setpoint, reading in zip(setpoints, readings, strict=True):
        state, force = law.step(prepared, state, setpoint, reading, T)
        found.append(force)
    return np.array(found, dtype=float)


def noisy(n: int) -> tuple[list[Setpoint], list[Reading]]:
    rng = np.random.default_rng(11)
    t = T * np.arange(n)
    setpoints = [Setpoint(0.1 * x + 0.5 * x**2, 0.1 + x, 1.0) for x in t]
    noise = rng.normal(0, 1e-5, (n, 2))
    readings = [Reading(s.position + a, s.position + b) for s, (a, b) in zip(setpoints, noise, strict=True)]
    return setpoints, readings


def test_the_cascade_is_the_recursion_on_paper() -> None:
    setpoints, readings = noisy(200)
    found = run(CascadePPI(Kv=80.0, Kp=2e4, Tn=0.01), setpoints, readings)
    before, total = readings[0].position_motor, 0.0
    for k, (s, r) in enumerate(zip(setpoints, readings, strict=True)):
        set_velocity = (s.position - (0.1 * (k - 1) * T + 0.5 * ((k - 1) * T) ** 2)) / T
        e = 80.0 * (s.position - r.position_load) + set_velocity - (r.position_motor - before) / T
        before = r.position_motor
        total += T / 0.01 * e
        # velocities of 20 mm/s from readings of 0.1 m: rounding 1e-16 m / 1 ms, times 2e4 N s/m
        assert found[k] == pytest.approx(2e4 * (e + total), rel=1e-9, abs=1e-8)


@pytest.mark.parametrize("every", [2, 4, 5])
def test_the_command_goes_in_equal_steps_to_what_the_position_loop_wants(every: int) -> None:
    setpoints, readings = noisy(60)
    # a P velocity loop, whose gain of 1 shows the velocity command itself
    found = run(CascadePPI(Kv=80.0, Kp=1.0, position_every=every), setpoints, readings)
    positions = np.array([r.position_motor for r in readings])
    command = found + np.diff(positions, prepend=positions[0]) / T
    pairs = list(zip(setpoints, readings, strict=True))[::every]
    wanted = np.array([80.0 * (s.position - r.position_load) + s.backward_velocity(T) for s, r in pairs])
    knots = np.r_[0.0, wanted]
    expected = np.interp(np.arange(1, 61), every * np.arange(len(knots)), knots)
    np.testing.assert_allclose(command, expected, atol=1e-12)


def test_running_in_every_sample_costs_nothing() -> None:
    law = CascadePPI(Kv=80.0, Kp=2e4, Tn=0.01)
    reading = Reading(0.1, 0.1)
    assert len(list(tree.leaves(law.start(CascadePPI.Prepared(T), Setpoint(0.1), reading)))) == 2
    slow = CascadePPI(Kv=80.0, Kp=2e4, Tn=0.01, position_every=3)
    assert len(list(tree.leaves(slow.start(CascadePPI.Prepared(T), Setpoint(0.1), reading)))) == 5


def test_a_slow_position_loop_follows_a_constant_velocity_with_the_same_error() -> None:
    # without velocity feedforward the following error is v / Kv, and interpolation does not change a constant
    n = 400
    moving = [Setpoint(0.2 * T * k, 0.2) for k in range(n)]
    for every in (1, 4):
        law = CascadePPI(Kv=50.0, Kp=1.0, velocity_feedforward=0.0, position_every=every)
        readings = [Reading(0.2 * T * k - 0.2 / 50.0, 0.2 * T * k - 0.2 / 50.0) for k in range(n)]
        force = run(law, moving, readings)
        np.testing.assert_allclose(force[2 * every :], 0.0, atol=1e-12)


def test_start_takes_over_the_force_that_acts() -> None:
    law = CascadePPI(Kv=50.0, Kp=1e4, Tn=0.01, position_every=2)
    reading = Reading(0.3, 0.3, applied=123.0, requested=123.0)
    state = law.start(CascadePPI.Prepared(T), Setpoint(0.3), reading)
    _, force = law.step(law.prepare(T), state, Setpoint(0.3), reading, T)
    assert force == 123.0


def test_a_lag_smooths_the_measured_velocity_alone() -> None:
    """Against the recursion on paper, over two samples and with a lag of 2 ms."""
    setpoints, readings = noisy(200)
    found = run(CascadePPI(Kv=80.0, Kp=2e4, Tn=0.01, velocity_samples=2, velocity_lag=2e-3), setpoints, readings)
    places = [readings[0].position_motor] * 2
    smooth = total = 0.0
    for k, (s, r) in enumerate(zip(setpoints, readings, strict=True)):
        set_velocity = (s.position - (0.1 * (k - 1) * T + 0.5 * ((k - 1) * T) ** 2)) / T
        smooth += T / (2e-3 + T) * ((r.position_motor - places[-2]) / (2 * T) - smooth)
        places.append(r.position_motor)
        e = 80.0 * (s.position - r.position_load) + set_velocity - smooth
        total += T / 0.01 * e
        # as above
        assert found[k] == pytest.approx(2e4 * (e + total), rel=1e-9, abs=1e-8)


@pytest.mark.parametrize("lag", [None, 2e-3])
@pytest.mark.parametrize("samples", [1, 2, 8])
def test_a_moving_axis_is_taken_over_without_a_bump(samples: int, lag: float | None) -> None:
    """At 0.1 m/s along the setpoint nothing is to be corrected: the force stays what it was, but for rounding."""
    law = CascadePPI(Kv=60.0, Kp=12e3, Tn=0.02, velocity_samples=samples, velocity_lag=lag)
    before = Reading(0.3, 0.3, 5.0, 5.0)._replace(velocity=0.1)
    state = law.start(law.prepare(T), Setpoint(0.3, 0.1), before)
    now = 0.3 + T * 0.1
    _, force = law.step(law.prepare(T), state, Setpoint(now, 0.1), Reading(now, now, 5.0, 5.0), T)
    assert force == pytest.approx(5.0, abs=1e-6)
