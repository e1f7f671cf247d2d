"""The friction that was put into a motion is found again."""

from __future__ import annotations

import numpy as np
import pytest

from feeddrive.analysis.friction_map import friction_map
from feeddrive.language.errors import ParameterError

T, MASS, COULOMB, VISCOUS, GRAVITY = 1e-3, 95.0, 20.0, 200.0, 3.0


def recorded() -> tuple[np.ndarray, np.ndarray]:
    """Position rounded to 50 nm and drive force of a sine stroke of 60 mm/s under Coulomb and viscous friction."""
    t = T * np.arange(20_000)
    w = 2 * np.pi * 0.3
    velocity = 0.06 * np.sin(w * t)
    position = 50e-9 * np.round(-0.06 / w * np.cos(w * t) / 50e-9)
    force = MASS * 0.06 * w * np.cos(w * t) + COULOMB * np.sign(velocity) + VISCOUS * velocity + GRAVITY
    return position, force


def test_coulomb_viscous_and_constant_force_are_found() -> None:
    found = friction_map(*recorded(), MASS, T)
    expected = COULOMB * np.sign(found.velocity) + VISCOUS * found.velocity + GRAVITY
    # a count of 50 nm, uniform, through the second derivative of a 31-sample parabola: 0.02 m/s² times 95 kg is 2 N in
    # a sample; hundreds of samples a bin bring the mean below 0.2 N
    assert np.max(np.abs(found.force - expected)) < 0.2
    assert np.count_nonzero(found.velocity > 0) == np.count_nonzero(found.velocity < 0) > 20
    assert "mm/s" in str(found)


def test_reversals_are_left_out() -> None:
    found = friction_map(*recorded(), MASS, T)
    # in 15 ms, half a window, the velocity changes by 0.06 * w * 15 ms = 1.7 mm/s
    assert np.min(np.abs(found.velocity)) > 1e-3


def test_a_short_log_is_refused() -> None:
    with pytest.raises(ParameterError, match="at least 90 samples"):
        friction_map(np.zeros(50), np.zeros(50), MASS, T)
