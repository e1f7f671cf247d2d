"""Dry friction along a plan: its direction over each sample, and its level."""

from __future__ import annotations

import numpy as np
import pytest

from feeddrive.blocks.friction.coulomb import Coulomb
from feeddrive.blocks.friction.directional import Directional
from feeddrive.blocks.friction.stribeck import Stribeck
from feeddrive.learning.planned_friction import KEPT, RAMP, direction_along, friction_along

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
