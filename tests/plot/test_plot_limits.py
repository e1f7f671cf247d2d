"""What a picture shows of a result and what it leaves out: each limit with a case on either side of it."""

from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace as Stand
from typing import Any

import numpy as np
import pytest

from feeddrive.analysis.oscilloscope import Shown
from feeddrive.figures.ranking import CRITERIA
from feeddrive.loop.frequency_response import FRF
from feeddrive.machining.circle_test import CirclePath, circle_test
from feeddrive.plot import complex_plane, over_frequency, part_program
from feeddrive.plot.chart import LINEAR, LOG, Chart, Curve, Panel
from feeddrive.plot.drawing import drawn
from feeddrive.plot.identification import cogging_chart, residuals_chart
from feeddrive.plot.laws import ScoreRow, ratios_chart, scores_chart
from feeddrive.plot.machining import _division, circle_unrolled_chart, lobes_chart
from feeddrive.plot.over_time import Channel, alike, log_chart, scope_chart, steady_range, step_response_chart
from feeddrive.plot.style import envelope


def curves(chart: Chart) -> tuple[Curve, ...]:
    return chart.panels[0].curves


def test_the_unit_circle_lies_whole_in_the_nyquist_plot() -> None:
    """The phase margin is read where the curve crosses it."""
    x, y = complex_plane._visible(np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 100)))
    assert np.all(np.isfinite(x))
    assert np.all(np.isfinite(y))


def poles(*rows: tuple[float, float]) -> Any:
    """A model with pairs of poles, each by frequency, Hz, and damping ratio."""
    s = [2.0 * np.pi * f * complex(-d, np.sqrt(1.0 - d * d)) for f, d in rows]
    z = np.exp(1e-4 * np.array([*s, *np.conj(s)]))
    return Stand(poles=lambda: z, zeros=lambda: np.empty(0), inputs=(), outputs=(), sample_time=1e-4)


def test_a_pole_map_reaches_as_far_as_the_poles_that_ring() -> None:
    """A pole with a damping ratio of 0.4 overshoots by a quarter; one of 0.7 is as far away as it likes."""
    for damping, reach in ((0.4, 1000.0), (0.7, 10.0)):
        high = complex_plane.plane_chart(poles((10.0, 0.1), (1000.0, damping))).panels[0].high
        assert high is not None
        assert reach < high < 2.0 * reach


def test_a_ray_of_a_pole_map_is_that_of_a_well_damped_pole() -> None:
    rays = complex_plane.plane_chart(poles((10.0, 0.1))).panels[0].curves[: len(complex_plane.DAMPINGS)]
    assert max(-ray.x[1] / ray.y[1] for ray in rays) == pytest.approx(1.0, abs=0.05)  # damping 1/sqrt(2)


@pytest.mark.parametrize(("count", "rows"), [(5, 5), (9, 6)])
def test_a_certificate_is_drawn_for_its_plants_of_least_reserve(
    count: int, rows: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(complex_plane, "_room", lambda _, plant, *__, **___: Panel(plant["name"]))
    plants = [{"name": f"{k}", "reserve": 9.0 - k, "reserve_at_Hz": 200.0} for k in range(count)]
    chart = complex_plane.certificate_chart(Stand(document={"plants": plants}, sample_time=5e-4))  # type: ignore[arg-type]
    assert [panel.label for panel in chart.panels] == [f"{k}" for k in range(count - 1, count - 1 - rows, -1)]
    assert chart.low == pytest.approx(0.2)  # three decades below


def test_a_remainder_that_repeats_after_32_samples_is_seen() -> None:
    values = np.zeros(2000)
    residuals = Stand(values=values, unit="N", autocorrelation=lambda lag: 0.5 if lag == 32 else 0.0)
    boxes = residuals_chart(residuals).panels[1].boxes  # type: ignore[arg-type]
    assert max(box.high for box in boxes) == 0.5
    assert len(boxes) < 60  # that can be told apart


@pytest.mark.parametrize(("error", "end"), [(0.3, 0.4), (0.9, 0.3)])
def test_an_error_bar_ends_at_twice_the_error_or_above_0(error: float, end: float) -> None:
    order = Stand(order=1, even=Stand(value=1.0, error=error), odd=Stand(value=1.0, error=error), forward=None)
    bar = curves(cogging_chart(Stand(orders=[order], significant=[order], unit="N")))[0]  # type: ignore[arg-type]
    assert float(np.nanmin(bar.y)) == pytest.approx(end)
    assert float(np.nanmax(bar.y)) == pytest.approx(1.0 + 2.0 * error)


@pytest.mark.parametrize(("ratio", "full"), [(6.0, False), (10.0, True)])
def test_a_law_eight_times_as_bad_has_the_full_color(ratio: float, full: bool) -> None:
    criterion = next(row for row in CRITERIA if not row.higher)
    chart = ratios_chart([("a", {criterion.key: 1.0}), ("b", {criterion.key: ratio})], "a")
    level = max(box.level or 0.0 for box in chart.panels[0].boxes)
    assert (level == 1.0) is full


def test_a_detail_of_a_reversal_holds_all_that_is_searched_for_a_peak() -> None:
    """A spike 8.5 degrees behind each reversal, on one of 360 points."""
    angle = 2.0 * np.pi * (np.arange(360) + 0.5) / 360
    spike = 7e-6 * np.maximum(0.0, 1.0 - np.abs(angle % (0.5 * np.pi) - np.radians(8.5)) / np.radians(1.0))
    r = 0.05 + spike
    circle = CirclePath(r * np.cos(angle), r * np.sin(angle), 1, 0.02, 0.05, center=(0.0, 0.0))
    chart = circle_unrolled_chart(circle_test([circle], about="set-up"))
    details = [panel for panel in chart.panels if panel.abscissa is not None and panel.abscissa.high == 10.0]
    assert len(details) == 4
    for panel in details:
        assert float(np.max(panel.curves[0].y)) == pytest.approx(7.0, rel=0.1)


@pytest.mark.parametrize(("lines", "labels"), [(10, 10), (20, 12)])
def test_of_many_tooth_passing_lines_the_upper_ones_are_labeled(lines: int, labels: int) -> None:
    speed = np.linspace(2000.0, 12000.0, 20)
    lobes = Stand(
        spindle_speed=speed,
        depth=np.full(20, 1e-3),
        flip=np.zeros(20, bool),
        frequency=np.full(20, 400.0),
        deepest=0.01,
        islands=(),
        passing=lambda: [(12000.0 / k, 200.0, k) for k in range(lines, 0, -1)],
        natural=np.array([380.0]),
        own=None,
    )
    levels = [level for level in lobes_chart(lobes).panels[0].levels if level.upright]  # type: ignore[arg-type]
    assert [level.text for level in levels if level.text] == [f"{k}" for k in range(1, labels + 1)]


def test_a_band_of_a_magnitude_is_the_disc_until_it_nearly_holds_0(monkeypatch: pytest.MonkeyPatch) -> None:
    f = np.array([1.0, 2.0])
    monkeypatch.setattr(over_frequency, "_radius", lambda *_: np.array([0.85, 0.85]))
    (band,) = over_frequency.magnitude_band(FRF(f, np.array([1.0 + 0j, 1.0 + 0j])), 0)
    assert band.low == pytest.approx(20.0 * np.log10(0.15)) or band.low == pytest.approx(0.15)


def test_a_panel_of_gains_holds_its_curves() -> None:
    for scale in (LOG, LINEAR):
        panel = over_frequency._gains("", [Curve(np.array([1.0, 2.0]), np.array([3.0, 8.0]))], (), scale, 1.0)
        assert panel.low is not None
        assert panel.high is not None
        assert panel.low < 3.0
        assert panel.high > 8.0


def test_lines_of_a_spectrum_two_percent_apart_stay_two_and_a_dense_one_has_few_points() -> None:
    """Over three decades, of 500 bands each is 1.4 % wide."""
    frequency = np.concatenate([[0.0], np.geomspace(1.0, 1000.0, 20_001)])
    spectrum = Stand(frequency=frequency, amplitude=np.ones(20_002), cumulative_rms=np.ones(20_002))
    center, _, _ = over_frequency._banded(spectrum, 1.0, 1000.0)  # type: ignore[arg-type]
    assert np.max(center[1:] / center[:-1]) < 1.02
    assert center.size < 600


def margined(gains: int, phases: list[float]) -> tuple[list[Curve], list[Curve]]:
    """The bars of the gain and of the phase panel for some crossovers."""
    f = np.geomspace(1.0, 1000.0, 50)
    margins = Stand(
        loop_gain=Stand(frequency=f),
        gain_crossovers=[Stand(frequency=10.0 + k, phase_margin_deg=40.0) for k in range(gains)],
        phase_crossovers=[Stand(frequency=100.0 + k, gain_margin_dB=margin) for k, margin in enumerate(phases)],
    )
    bars = list[Curve](), list[Curve]()
    over_frequency._margins(
        margins,
        np.full(50, -140.0),
        0,
        True,
        bars,
        ([], []),
        Stand(  # type: ignore[arg-type]
            of=lambda _: ("Hz", 1.0), from_decibel=float, gain_text=lambda value: f"{value:.1f} dB"
        ),
    )
    return bars


def test_a_gain_margin_of_less_than_60_dB_is_drawn() -> None:
    bars, _ = margined(0, [50.0, -50.0, 80.0, -80.0])
    assert [bar.caption for bar in bars] == ["50.0 dB", "-50.0 dB"]


@pytest.mark.parametrize(("count", "labels"), [(2, 2), (7, 3)])
def test_the_first_crossovers_of_a_loop_are_labeled(count: int, labels: int) -> None:
    for bars in margined(count, count * [20.0]):
        assert [bool(f"{bar.caption}") for bar in bars] == [k < labels for k in range(count)]


@pytest.mark.parametrize(("count", "rows"), [(10, 10), (20, 12)])
def test_the_first_channels_of_a_log_are_drawn(count: int, rows: int) -> None:
    time = np.arange(5.0)
    log = Stand(channels={f"c{k}": time for k in range(count)}, units={}, time=time)
    assert [panel.label for panel in log_chart(log).panels] == [f"c{k}" for k in range(rows)]  # type: ignore[arg-type]


def response(overshoot: float) -> Any:
    time = np.linspace(0.0, 1.0, 1001)
    return Stand(
        time=time,
        position=np.ones(1001),
        final=1.0,
        overshoot=overshoot,
        overshoot_time=0.05,
        settled=0.02,
        settling_time=0.2,
    )


@pytest.mark.parametrize(("overshoot", "marks"), [(8e-4, 1), (1.5e-3, 2)])
def test_an_overshoot_of_a_thousandth_is_marked(overshoot: float, marks: int) -> None:
    chart = step_response_chart(response(overshoot))
    assert len(chart.panels[0].marks) == marks
    settled = chart.panels[0].marks[-1]
    assert settled.x == pytest.approx(200.0)  # ms
    assert chart.high is not None
    assert chart.high > settled.x
    assert float(curves(chart)[0].x[-1]) == pytest.approx(chart.high, abs=1.0)


def test_a_scope_keeps_400_spikes_of_a_long_window() -> None:
    y = np.zeros(40_000)
    y[50::100] = 1.0
    time = np.arange(y.size) / y.size
    window = Shown(time, y[:, None], {"x": ""}, 1.0, -1.0, 0.0, False)
    (curve,) = curves(scope_chart(window, [Channel("x", 0)])[0])
    assert np.count_nonzero(curve.y == 1.0) == 400
    assert curve.y.size <= 1_000


@pytest.mark.parametrize(("ratio", "one"), [(6.0, True), (10.0, False)])
def test_curves_up_to_eight_times_as_large_share_a_scale(ratio: float, one: bool) -> None:
    assert alike([np.array([0.0, 1.0]), np.array([0.0, ratio])]) is one


def test_a_curve_keeps_900_spikes_with_few_points() -> None:
    y = np.zeros(90_000)
    y[50::100] = 1.0
    x, kept = envelope(np.arange(y.size, dtype=float), y)
    assert np.count_nonzero(kept == 1.0) == 900
    assert x.size < 2_500


@pytest.mark.parametrize("largest", [0.08 / 120.0, 0.08 / 550.0])
def test_the_largest_deviation_of_a_path_is_drawn_between_a_twentieth_and_a_twelfth_of_it(largest: float) -> None:
    """The factor is 100 and 500."""
    path = np.array([[0.0, 0.0], [1.0, 0.5]])
    contour = Stand(position=path, vector=np.zeros((2, 2)), counted=np.ones(2, bool), largest=largest)
    factor = part_program._factor(contour, (0, 1))  # type: ignore[arg-type]
    assert 1.0 / 20.0 < factor * largest < 1.0 / 12.0


def test_a_path_keeps_9000_places_of_large_error_with_few_points() -> None:
    rows = 90_000
    error = np.zeros(rows)
    error[5::10] = 1e-5
    position = np.column_stack([np.linspace(0.0, 1.0, rows), np.zeros(rows)])
    contour = Stand(
        error=error,
        counted=np.ones(rows, bool),
        position=position,
        vector=np.zeros((rows, 2)),
        largest=1e-5,
        rms=1e-6,
        within=lambda: 1e-5,
        axes=("x", "y"),
        signed=False,
    )
    path = next(curve for curve in curves(part_program.contour_on_path_chart(contour)) if curve.heat is not None)  # type: ignore[arg-type]
    assert path.heat is not None
    assert np.count_nonzero(path.heat > 5.0) == 9_000
    assert path.heat.size < 25_000


@pytest.mark.parametrize(("peaks", "marks"), [(4, 4), (9, 5)])
def test_the_worst_places_of_a_path_are_marked(peaks: int, marks: int) -> None:
    error = np.linspace(0.0, 1e-6, 100)
    places = [Stand(along=0.1 * k, error=1e-6) for k in range(peaks)]
    contour = Stand(
        along=np.linspace(0.0, 1.0, 100),
        error=error,
        weights=np.full(100, 0.01),
        worst=lambda most: places[:most],
        largest=1e-6,
        rms=1e-6,
        within=lambda: 1e-6,
        signed=False,
    )
    worst = next(curve for curve in curves(part_program.contour_chart(contour)) if curve.name == "worst places")  # type: ignore[arg-type]
    assert worst.x.size == marks


def plan(third: float, stops: int) -> Any:
    place = np.array([[0.0, 0.0, 0.0], [100.0, 0.0, third], [100.0, 50.0, 0.0]])
    course = Stand(position=place, time=np.arange(3.0), feed=np.ones(3), speed=np.ones(3))
    limits = Stand(shown=[(1.0, "mm")] * 3, letters="xyz")
    return Stand(course=course, limits=limits, stops=[Stand(position=place[1])] * stops, kinematics=None)


@pytest.mark.parametrize(("third", "views"), [(1.5, 1), (3.0, 2)])
def test_an_axis_that_moves_by_two_percent_of_the_largest_has_a_view(third: float, views: int) -> None:
    assert len(part_program.planned_chart(plan(third, 0)).panels) == views


@pytest.mark.parametrize(("stops", "marks"), [(250, 250), (400, 300)])
def test_the_first_stops_of_a_plan_are_marked(stops: int, marks: int) -> None:
    drawn = curves(part_program.planned_chart(plan(0.0, stops)))
    assert [curve.x.size for curve in drawn if curve.name == "stop"] == [marks]


def test_estimates_are_drawn_for_150_ms() -> None:
    time = np.arange(2000) * 1e-3
    part = Stand(
        contour=Stand(time=time, axes=("x",)),
        cutting=np.exp(-(((time - 1.2) / 0.01) ** 2))[:, None],
        disturbances={"x": time},
        estimates={},
    )
    x = curves(part_program.part_estimates_chart(part, "x"))[0].x  # type: ignore[arg-type]
    assert x[0] < 1200.0 < x[-1]
    assert x[-1] - x[0] == pytest.approx(150.0, abs=2.0)


@pytest.mark.parametrize(("wanted", "division"), [(0.15, 0.2), (1.5, 2.0), (3.0, 5.0), (70.0, 100.0)])
def test_a_division_of_a_circle_is_1_2_or_5_times_a_power_of_ten(wanted: float, division: float) -> None:
    assert _division(wanted) == pytest.approx(division)


@pytest.mark.parametrize(("top", "stays"), [(8.0, True), (6.0, False)])
def test_a_range_stays_while_curves_use_four_tenths_of_it(top: float, stays: bool) -> None:
    assert (steady_range(np.array([3.0, top]), (0.0, 10.0)) == (0.0, 10.0)) is stays


@pytest.mark.parametrize(("least", "shown"), [(0.06, True), (3e-3, False)])
def test_numbers_of_narrow_panels_do_not_touch(least: float, shown: bool) -> None:
    """In three panels of one decade 2 and 5 are labeled, of two they are not: they were written over each other."""
    ratios = [ScoreRow([least, 1.0], 0.5)]
    figure = drawn(scores_chart((["a"], dict.fromkeys(("snap", "tracking", "cutting"), ratios))))
    figure.canvas.draw()
    for ax in figure.axes:
        low, high = ax.get_xlim()
        inside = [
            label
            for label, at in zip(ax.get_xticklabels(), ax.get_xticks(), strict=True)
            if low <= at <= high and label.get_text()
        ]
        assert ("0.5" in [label.get_text() for label in inside]) == shown
        boxes = [label.get_window_extent() for label in inside]
        assert all(left.x1 < right.x0 for left, right in pairwise(boxes))


@pytest.mark.parametrize(("best", "shown"), [(3.1, ["1", "2", "3"]), (3.9, ["1", "2"])])
def test_a_narrow_logarithmic_range_has_round_numbers(best: float, shown: list[str]) -> None:
    """Of 1, 2 and 5 a range of 0.9 to 1.4 has a single one, which says nothing of how far the dots are from it."""
    figure = drawn(scores_chart((["a"], {"snap": [ScoreRow([best], best)]})))
    figure.canvas.draw()
    (ax,) = figure.axes
    low, high = ax.get_xlim()
    labels = zip(ax.get_xticklabels(), ax.get_xticks(), strict=True)
    assert [label.get_text() for label, at in labels if low <= at <= high] == shown
    # and what the numbers are
    assert ax.get_xlabel() == "times better than P-PI"
