"""Curves that were thinned out look the same."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from feeddrive.plot.style import envelope


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=400), st.integers(2, 100))
def test_points_are_kept_not_invented_and_extremes_and_ends_stay(values, points) -> None:
    y = np.array(values)
    x = np.arange(y.size, dtype=float)
    a, b = envelope(x, y, points)
    assert a.size <= max(points + 2, min(y.size, points))
    assert np.all(np.diff(a) > 0.0)
    assert np.array_equal(y[a.astype(int)], b)
    assert (a[0], a[-1]) == (0.0, y.size - 1)
    assert (b.min(), b.max()) == (y.min(), y.max())


def test_every_stretch_keeps_its_spike() -> None:
    y = np.zeros(100_000)
    spikes = np.arange(50, 100_000, 1000)
    y[spikes] = np.where(np.arange(spikes.size) % 2, 1.0, -1.0)
    a, b = envelope(np.arange(y.size, dtype=float), y, 2000)
    assert a.size <= 2002
    assert np.array_equal(a[b != 0.0], spikes)


def test_a_short_curve_comes_back_as_it_is() -> None:
    x, y = np.arange(5.0), np.array([3.0, 1.0, 4.0, 1.0, 5.0])
    a, b = envelope(x, y, 5)
    assert a is x
    assert b is y
