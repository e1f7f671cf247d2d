"""The proof of a plan with a changed path: no dense sample exceeds what was proven, and what exceeds is refused."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import BSpline

from feeddrive.path.changed_path import changed_use, keeps

T, H, N = 1e-3, 20, 2001
LIMITS = np.array([0.2, 2.0, 80.0, 2000.0])


def plan(t: np.ndarray, share: float) -> list[np.ndarray]:
    """Velocity to snap of a sine whose snap takes a share of the limit."""
    w = 2.0 * np.pi * 5.0
    a = share * LIMITS[3] / w**4
    return [a * w**k * np.sin(w * t + 0.5 * np.pi * k) for k in range(1, 5)]


def change(c: np.ndarray, t: np.ndarray) -> list[np.ndarray]:
    knots = H * T * np.arange(-5, c.size + 1)
    return [BSpline(knots, c, 5)(t, nu=k) for k in range(1, 5)]


def of(seed: int, size: float, share: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The use that is proven, the largest of a dense evaluation, and the coefficients."""
    c = size * np.random.default_rng(seed).standard_normal(N // H + 5)
    c[:6] = c[-6:] = 0.0
    t = T * np.arange(N)
    rows = np.array(plan(t, share)) + np.array(change(c, t))
    proven = np.array([float(np.max(np.abs(row))) for row in plan(np.linspace(0.0, 0.2, 20001), share)]) / LIMITS
    use = changed_use(rows, c, H, T, LIMITS, proven * (1.0 + 1e-9))
    dense = np.linspace(0.0, T * (N - 1), 40 * (N - 1) + 1)
    there = np.array(plan(dense, share)) + np.array(change(c, dense))
    return use, np.max(np.abs(there), axis=1) / LIMITS, c


@pytest.mark.parametrize("seed", range(8))
def test_no_instant_exceeds_what_is_proven(seed: int) -> None:
    use, dense, _ = of(seed, 1e-7, 0.9)
    assert np.all(dense <= use * (1.0 + 1e-9))
    # and the bound is not loose: within 10 % of what is reached
    assert np.all(use < 1.1 * dense)


def test_a_sum_beyond_a_limit_is_not_proven() -> None:
    small, _, _ = of(1, 1e-9, 0.9)
    large, _, _ = of(1, 1e-5, 0.9)
    assert keeps(small)
    assert not keeps(large)


def test_peaks_between_samples_count() -> None:
    """The snap of a plan jumps between samples: its proven bound stands, whatever the samples show."""
    t = T * np.arange(N)
    use = changed_use(np.zeros((4, N)), np.zeros(N // H + 5), H, T, LIMITS, np.array([0.1, 0.1, 0.1, 0.99]))
    assert use[3] == pytest.approx(0.99)
    assert use[2] <= 0.1
    assert t.size == N
