"""Dry friction along a plan: its direction over each sample, and its level."""

from __future__ import annotations

import numpy as np
import pytest

from feeddrive.blocks.friction.coulomb import Coulomb
from feeddrive.blocks.friction.directional import Directional
from feeddrive.blocks.friction.generalized_maxwell_slip import GeneralizedMaxwellSlip
from feeddrive.blocks.friction.lugre import Lugre
from feeddrive.blocks.friction.stribeck import Stribeck
from feeddrive.learning.planned_friction import KEPT, RAMP, direction_along, friction_along, remembers

T = 1e-3


def test_a_reversal_changes_the_sign_at_the_zero_crossing() -> None:
    """The mean of the sign over the sample in which v crosses 0, a quarter of it before: s = -1/2."""
    v = np.array([0.3, 0.1, -0.3, -0.7])
    assert direction_along(v, T) == pytest.approx([1.0, -0.5, -1.0, -1.0])


def test_a_zero_crossing_at_a_sample_is_no_rest() -> None:
    assert direction_along(np.array([0.2, 0.0, -0.2]), T) == pytest.approx([1.0, -1.0, -1.0])


def test_a_long_rest_keeps_half_and_is_ready_for_the_start() -> None:
    """From +1 to -1 over 100 ms: half after 20 ms, all of the new direction at the first moving sample."""
    n, ramp = 100, round(RAMP / T)
    v = np.concatenate([np.full(5, 0.1), np.zeros(n), np.full(5, -0.1)])
    s = direction_along(v, T)
    assert s[4] == 1.0
    assert s[4 + ramp] == pytest.approx(KEPT)
    assert np.all(s[4 + ramp : 5 + n - ramp] == pytest.approx(KEPT))
    assert s[4 + n] == pytest.approx(-1.0)
    assert np.all(np.diff(s[4 : 6 + n]) <= 1e-15)  # no overshoot
    assert np.max(np.abs(np.diff(s))) < 1.5 * 1.875 / ramp  # the steepest slope of the quintic is 15/8 of its mean


def test_a_rest_without_a_reversal_comes_back_to_the_same_sign() -> None:
    s = direction_along(np.concatenate([np.full(5, 0.1), np.zeros(100), np.full(5, 0.1)]), T)
    assert s[55] == pytest.approx(0.5)
    assert s[104] == pytest.approx(1.0)


def test_the_first_motion_begins_from_0_and_the_last_one_ends_there() -> None:
    s = direction_along(np.concatenate([np.zeros(60), np.full(5, 0.1), np.zeros(60)]), T)
    assert s[0] == 0.0
    assert s[39] == 0.0
    assert s[42] > 0.0  # 20 ms before the motion
    assert s[59] == pytest.approx(1.0)
    assert s[-1] == pytest.approx(0.0)
    assert np.all(direction_along(np.zeros(10), T) == 0.0)


def test_a_motion_backwards_in_time_has_the_mirrored_force() -> None:
    """x(-t) moves with -v: without rests the friction changes its sign and the order of its intervals."""
    v = 0.05 * np.sin(2.0 * np.pi * np.arange(801) * T / 0.2 + 0.1)
    friction = Stribeck(coulomb=100.0, breakaway=150.0, stribeck_velocity=5e-3)
    forward, back = friction_along(friction, v, T), friction_along(friction, -v[::-1], T)
    assert back[:-1] == pytest.approx(-forward[:-1][::-1], abs=1e-9)


def test_the_level_is_that_of_the_law_without_its_viscous_part() -> None:
    v = np.full(10, 3e-3)
    friction = Stribeck(coulomb=100.0, breakaway=150.0, stribeck_velocity=5e-3, viscous=700.0)
    assert friction_along(friction, v, T)[3] == pytest.approx(100.0 + 50.0 * np.exp(-0.36))
    assert friction_along(Coulomb(coulomb=80.0), -v, T)[3] == pytest.approx(-80.0)
    # at rest the limit from the side of the direction, not 0
    rest = friction_along(friction, np.concatenate([v, np.zeros(100), v]), T)
    assert rest[60] == pytest.approx(KEPT * 150.0)


def test_both_directions_have_their_own_level() -> None:
    friction = Directional(coulomb_positive=90.0, coulomb_negative=60.0)
    force = friction_along(friction, np.concatenate([np.full(5, 0.1), np.full(5, -0.1)]), T)
    assert force[0] == pytest.approx(90.0)
    assert force[-1] == pytest.approx(-60.0)


def there_and_back(way: float, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Velocities of a way of constant speed forwards and backwards, and the way since the reversal at each sample."""
    v = way / (steps * T)
    velocity = np.concatenate([np.full(steps, v), np.full(steps, -v), np.zeros(60)])
    return velocity, np.arange(steps) * way / steps


def test_presliding_needs_its_way_after_a_reversal() -> None:
    """LuGre with one level F: F(x) = -F (1 - 2 e^(-σ0 x/F)), x the way since the reversal; at rest it stays, then ends.

    The step is of first order: 1 % of a way of F/σ0 in a sample.
    """
    F, stiffness = 100.0, 5e7  # N, N/m: 2 um
    friction = Lugre(coulomb=F, breakaway=F, stribeck_velocity=1e-3, bristle_stiffness=stiffness, viscous=500.0)
    steps = 2000
    velocity, way = there_and_back(4e-5, steps)
    force = friction_along(friction, velocity, T)
    assert force[0] == pytest.approx(0.0, abs=1.0)
    assert force[steps - 2] == pytest.approx(F, rel=1e-3)
    middle = way[1:] + 0.5 * (way[1] - way[0])
    expected = -F * (1.0 - 2.0 * np.exp(-stiffness * middle / F))
    # the interval of the reversal itself stands: the mean of both velocities is 0
    assert np.max(np.abs(force[steps + 1 : 2 * steps - 1] - expected[: steps - 2])) < 0.02 * F
    assert force[2 * steps + round(RAMP / T) :] == pytest.approx(0.0, abs=1e-9)


def test_the_elements_of_maxwell_slip_turn_one_after_the_other() -> None:
    """Two elements of 50 N that yield at 1 and 4 um: after a reversal twice that way (Masing), piecewise linear."""
    friction = GeneralizedMaxwellSlip(
        coulomb=100.0, breakaway=100.0, stribeck_velocity=1e-3, stiffness=[50.0 / 1e-6, 50.0 / 4e-6], share=[0.5, 0.5]
    )
    steps = 2000
    velocity, way = there_and_back(4e-5, steps)
    force = friction_along(friction, velocity, T)
    middle = way[1:] + 0.5 * (way[1] - way[0])
    expected = np.maximum(50.0 - 50.0e6 * middle, -50.0) + np.maximum(50.0 - 12.5e6 * middle, -50.0)
    # exact but at the corners and the reversal: a sample of 20 nm on 62.5 N/um
    assert np.max(np.abs(force[steps + 1 : 2 * steps - 1] - expected[: steps - 2])) < 62.5e6 * 2e-8


def test_friction_without_a_memory_is_not_followed() -> None:
    assert not remembers(Stribeck(coulomb=100.0, breakaway=150.0, stribeck_velocity=5e-3))
    assert remembers(Lugre(coulomb=1.0, breakaway=1.0, stribeck_velocity=1e-3, bristle_stiffness=1e6))
