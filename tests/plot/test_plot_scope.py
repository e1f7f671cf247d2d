"""The picture of a scope: points that are kept of a long window, ranges that stand still, and panels by unit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from feeddrive.analysis.oscilloscope import Shown, readout
from feeddrive.plot.over_time import SCOPE_POINTS, Channel, kept_points, scope_chart, steady_range


@given(st.integers(SCOPE_POINTS + 1, 20_000), st.integers(0, 5), st.integers(0, 2**32 - 1))
def test_few_points_are_kept_and_no_peak_is_lost(rows: int, gaps: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    time = np.sort(rng.uniform(3.0, 4.0, rows))
    y = rng.normal(size=rows)
    y[rng.integers(0, rows, gaps)] = np.nan
    kept = kept_points(time, y, 2.0 / SCOPE_POINTS)
    assert kept.size <= 1000
    assert np.all(np.diff(kept) > 0)
    assert (kept[0], kept[-1]) == (0, rows - 1)
    assert (np.nanmin(y[kept]), np.nanmax(y[kept])) == (np.nanmin(y), np.nanmax(y))
    for k in np.flatnonzero(np.isnan(y)):  # a line is interrupted where it was
        stretch = np.floor(time * SCOPE_POINTS / 2.0) == np.floor(time[k] * SCOPE_POINTS / 2.0)
        assert np.isnan(y[kept[stretch[kept]]]).any()


def test_a_curve_that_runs_by_keeps_its_points() -> None:
    """A window that moves on by some rows shows the same points in the stretches that are in both."""
    time = np.arange(40_000) * 1e-4
    y = np.random.default_rng(2).normal(size=time.size)
    one, other = (kept_points(time[a : a + 30_000], y[a : a + 30_000], 6.0 / SCOPE_POINTS) + a for a in (0, 3317))
    both = (time > time[3317] + 6.0 / SCOPE_POINTS) & (time < time[29_999] - 6.0 / SCOPE_POINTS)
    np.testing.assert_array_equal(one[both[one]], other[both[other]])


@given(
    st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=20),
    st.one_of(st.none(), st.tuples(st.floats(-10, 0), st.floats(0.1, 10))),
)
def test_a_range_has_the_curves_in_it(values: list[float], before: tuple[float, float] | None) -> None:
    y = np.array(values)
    low, high = steady_range(y, before)
    assert low <= np.min(y)
    assert high >= np.max(y)
    assert low < high
    assert steady_range(y, (low, high)) == (low, high) or np.ptp(y) < 0.4 * (high - low)


def test_a_range_stays_as_long_as_it_fits() -> None:
    first = steady_range(np.array([-0.9, 0.93]))
    assert steady_range(np.array([-0.8, 0.7]), first) == first
    assert steady_range(np.array([-0.2, 0.2]), first) != first  # too large for them
    assert steady_range(np.array([-0.9, 1.6]), first)[1] > 1.6
    assert steady_range(np.empty(0)) == (-1.0, 1.0)
    for still in (0.0, 3.0, -2e-9):  # what stands still has a range of its own size
        low, high = steady_range(np.array([still, still]))
        assert low < still < high
        assert 0.5 * (abs(still) or 1.0) < high - low < 4.0 * (abs(still) or 1.0)


def shown(rows: int = 11) -> Shown:
    time = 5.0 + np.linspace(0.0, 1.0, rows)
    return Shown(time, np.column_stack([time, 2.0 * time, -time]), dict.fromkeys("abc", ""), 5.2, -0.2, 0.8, True)


def test_channels_of_one_unit_share_a_panel_and_lines_stand_where_they_are_read() -> None:
    window = shown()
    channels = [Channel("set", 0, "mm", 1e3), Channel("torque", 1), Channel("actual", 2, "mm", 1e3)]
    chart, ranges = scope_chart(window, channels, level=("actual", -5.5), cursors=readout(window, 0.1, 0.4))
    assert [each.label for each in chart.panels] == ["(mm)", "torque"]
    first = chart.panels[0]
    assert [each.name for each in first.curves] == ["set", "actual"]
    assert len({each.number for panel in chart.panels for each in panel.curves}) == 3
    np.testing.assert_allclose(first.curves[0].x, window.time - 5.2)
    np.testing.assert_allclose(first.curves[1].y, -1e3 * window.time)
    assert first.curves[0].caption == "6000 mm"
    assert [(each.value, each.upright) for each in first.levels] == [
        (-5500.0, False),
        (0.0, True),
        (0.1, True),
        (0.4, True),
    ]
    assert all(not each.upright or each.value != -5500.0 for each in chart.panels[1].levels)
    assert (chart.low, chart.high) == (-0.2, 0.8)
    again, kept = scope_chart(window, channels, before=ranges)
    assert kept["torque"] == ranges["torque"]
    assert again.panels[1].low == chart.panels[1].low


def test_what_runs_by_has_few_points_and_what_stands_has_all_to_be_enlarged() -> None:
    time = np.arange(20_000) * 1e-4
    window = Shown(time, np.sin(50.0 * time)[:, None], {"x": ""}, 1.9999, -2.0, 0.0, False)
    assert scope_chart(window, [Channel("x", 0)])[0].panels[0].curves[0].x.size <= 1000
    assert scope_chart(replace(window, triggered=True), [Channel("x", 0)])[0].panels[0].curves[0].x.size == 20_000


def test_it_is_drawn_in_a_report_too() -> None:
    from feeddrive.plot.drawing import drawn

    figure = drawn(scope_chart(shown(500), [Channel("set", 0, "mm"), Channel("torque", 1)])[0])
    assert len(figure.axes) == 2
    assert figure.axes[0].get_ylabel() == "set (mm)"
    assert figure.axes[-1].get_xlim() == pytest.approx((-0.2, 0.8))
