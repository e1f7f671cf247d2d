"""Where a motion reverses, and which stretch of a run is worth a closer look."""

from __future__ import annotations

import numpy as np
import pytest

from feeddrive.analysis.friction_map import reversals, set_velocity, worst_window
from feeddrive.loop.simulate import Run

T = 1e-3
TIME = T * np.arange(4000)


def run(velocity: np.ndarray, error: np.ndarray, stated: bool = True) -> Run:
    position = np.concatenate([[0.0], np.cumsum(0.5 * T * (velocity[1:] + velocity[:-1]))])
    signals = {
        "set_position": position,
        "set_velocity": velocity if stated else np.zeros_like(velocity),
        "following_error": error,
    }
    return Run("run", signals, T, TIME.size)


SINE = 0.1 * np.sin(2 * np.pi * 0.5 * TIME)


def test_a_sine_reverses_at_its_zeros() -> None:
    # the threshold of 1e-3 of the peak is passed 1e-3 / (2π 0.5 Hz) = 0.3 ms after the zero
    assert T * reversals(SINE) == pytest.approx([1.0, 2.0, 3.0], abs=1.1e-3)


def test_a_stop_is_no_reversal_and_after_one_the_start_counts() -> None:
    on = np.where(TIME < 1.0, 1.0, np.where(TIME < 2.0, 0.0, 1.0))
    assert reversals(on).size == 0
    back = np.where(TIME < 1.0, 1.0, np.where(TIME < 2.0, 0.0, -1.0))
    assert T * reversals(back) == pytest.approx([2.0])
    assert reversals(np.zeros(10)).size == 0


def test_a_log_without_velocity_is_differenced() -> None:
    found = set_velocity(run(SINE, SINE, stated=False))
    # central differences of a sine: (ωT)²/6 of the amplitude, one-sided at the ends: ωT/2
    assert np.max(np.abs(found - SINE)[1:-1]) < 0.1 * (2 * np.pi * 0.5 * T) ** 2
    assert np.array_equal(set_velocity(run(SINE, SINE)), SINE)


def test_the_reversal_with_the_largest_error_is_chosen() -> None:
    error = 1e-6 * np.exp(-(((TIME - 2.02) / 0.01) ** 2)) + 0.5e-6 * np.exp(-(((TIME - 1.02) / 0.01) ** 2))
    window = worst_window([run(SINE, error)])
    assert window.reversal == pytest.approx(2.0, abs=1.1e-3)
    assert window.begin < 2.0 < 2.02 < window.end
    # each run counts in shares of its own peak: the small error at 1 s of a second run is as loud as a large one
    small = run(SINE, 1e-9 * np.exp(-(((TIME - 1.02) / 0.01) ** 2)))
    both = worst_window([run(SINE, error), small])
    assert both.reversal == pytest.approx(1.0, abs=1.1e-3)


def test_without_a_reversal_the_largest_error_is_shown() -> None:
    error = np.where(np.abs(TIME - 3.0) < 0.01, 1e-6, 0.0)
    window = worst_window([run(np.full(4000, 0.1), error)])
    assert window.reversal is None
    assert window.begin < 3.0 < window.end <= TIME[-1]


@pytest.mark.parametrize(("backward", "count"), [(0.8e-3, 0), (1.5e-3, 2)])
def test_a_velocity_below_a_thousandth_of_the_largest_is_standstill(backward: float, count: int) -> None:
    """A set position that was rounded in a log creeps back by a digit while it stands."""
    velocity = np.where((TIME > 1.0) & (TIME < 2.0), -backward, 1.0)
    assert reversals(velocity).size == count
