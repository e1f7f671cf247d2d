"""Charts of what is proven: their numbers are those of the results, in the units that their labels say."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from feeddrive.certificate.certificate import Certificate
from feeddrive.language.quantity import DRAWN, number
from feeddrive.machining.circle_test import (
    NEAR,
    CirclePath,
    CircleTest,
    circle_test,
    deviations,
    peaks_table,
    quadrant_peaks,
)
from feeddrive.machining.contour import ContourError, contour_error
from feeddrive.plot import style
from feeddrive.plot.chart import THIN
from feeddrive.plot.complex_plane import certificate_chart, certificate_discs_chart
from feeddrive.plot.laws import HEIGHTS, X, tradeoff_chart
from feeddrive.plot.machining import circle_chart, unrolled_chart
from feeddrive.plot.part_program import contour_on_path, contour_on_path_chart, place_chart
from feeddrive.workflow.certify import certify

UM = 1e-6
HEIGHT, AFTER = 7 * UM, np.radians(3.0)  # of the spikes that are drawn


def spiked(direction: int, feed: float = 0.02, height: float = HEIGHT) -> CirclePath:
    """A circle 2 um too large with a spike 3 degrees behind each reversal."""
    angle = direction * 2.0 * np.pi * (np.arange(3600) + 0.5) / 3600
    since = (direction * angle) % (0.5 * np.pi)
    spike = height * np.maximum(0.0, 1.0 - np.abs(since - AFTER) / np.radians(1.0))
    r = 0.05 + 2 * UM + spike
    return CirclePath(r * np.cos(angle), r * np.sin(angle), direction, feed, 0.05, center=(0.0, 0.0))


@cache
def spikes() -> CircleTest:
    return circle_test([spiked(1), spiked(-1), spiked(1, 0.1)], about="set-up")


@cache
def contour() -> ContourError:
    """A square whose corners are rounded, with a dwell that does not count, in 30,000 samples."""
    corners = np.array([[0, 0], [20, 0], [20, 15], [0, 15], [0, 0]]) * 1e-3
    share = np.linspace(0, 1, 7500, endpoint=False)[:, None]
    path = np.vstack([a + (b - a) * share for a, b in pairwise(corners)])
    kernel = np.exp(-np.arange(600) / 80.0)
    kernel /= kernel.sum()
    slow = np.column_stack([np.convolve(np.pad(path[:, i], (599, 0), "edge"), kernel, "valid") for i in range(2)])
    counted = np.arange(len(path)) > 2000
    return contour_error(slow, path, sample_time=1e-4, counted=counted)


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> Certificate:
    return certify("ball_screw", out=tmp_path_factory.mktemp("certificate") / "out")


def test_quadrant_peaks_are_the_spikes_behind_each_reversal() -> None:
    found = quadrant_peaks(spikes())
    assert len(found) == 12
    for each in found:
        circle = spikes().circles[each.circle]
        quarter = 2 * ("x", "y").index(each.axis) // 2 + (0 if each.side == "+" else 2)
        wanted = (0.5 * np.pi * quarter + circle.direction * AFTER) % (2.0 * np.pi)
        assert each.angle == pytest.approx(wanted, abs=np.radians(0.1))  # the angle between two points
        assert each.height == pytest.approx(HEIGHT, rel=0.06)  # a point may lie 0.05 of 1 degree beside the tip
        assert each.deviation == pytest.approx(each.height + 2 * UM, abs=0.01 * UM)
    assert np.radians(10.0) == NEAR
    assert [row[0] for row in peaks_table(spikes()).rows] == [each.name for each in spikes().circles]


def test_the_circle_plot_is_as_far_from_its_nominal_circle_as_the_machine_deviates() -> None:
    before = circle_test([spiked(1, height=15 * UM), spiked(-1, height=15 * UM)], about="set-up")
    chart = circle_chart(spikes(), before).shown(DRAWN)
    assert (chart.label, chart.panels[0].label, chart.square) == ("x (µm)", "y (µm)", True)
    (panel,) = chart.panels
    (ring,) = [each.radius for each in panel.discs if not each.faint]
    old = [each for each in panel.curves if each.look == THIN]
    new = [each for each in panel.curves if each.name]
    for test, curves in ((spikes(), new), (before, old)):
        for curve, (angle, r) in zip(curves, deviations(test), strict=True):
            assert np.hypot(curve.x, curve.y)[:-1] - ring == pytest.approx(1e6 * r, abs=1e-9)
            assert np.arctan2(curve.y, curve.x)[:-1] % (2.0 * np.pi) == pytest.approx(angle, abs=1e-12)
    assert [each.number for each in old] == [0, 1]  # as the circles of the same direction and feed
    for curve, figures in zip(new, spikes().figures, strict=False):
        assert f"G {number(1e6 * figures.G)} µm" in curve.caption
    assert f"before {number(1e6 * before.figures[1].G)} µm" in new[1].caption
    assert "before" not in new[2].caption  # there was no such feed
    assert {(mark.x, mark.y) for mark in panel.marks if mark.hollow} == {
        ((ring + 1e6 * e.deviation) * np.cos(e.angle), (ring + 1e6 * e.deviation) * np.sin(e.angle))
        for e in quadrant_peaks(spikes())
    }
    rings = np.sort([each.radius for each in panel.discs])
    assert np.diff(rings) == pytest.approx(5.0)  # 17 um on four divisions
    assert panel.high is not None
    assert max(float(np.max(np.hypot(each.x, each.y))) for each in panel.curves) < panel.high


def test_the_unrolled_circle_has_deviations_and_peaks_over_the_angle() -> None:
    chart = unrolled_chart(spikes()).shown(DRAWN)
    (panel,) = chart.panels
    assert (chart.label, panel.label) == ("angle (deg)", "radial deviation (µm)")
    for curve, (_, r) in zip(panel.curves, deviations(spikes()), strict=True):
        assert float(np.max(curve.y)) == pytest.approx(1e6 * float(np.max(r)), rel=1e-12)
    peaks = {(mark.x, mark.y) for mark in panel.marks}
    assert peaks == {(float(np.degrees(e.angle)), 1e6 * e.deviation) for e in quadrant_peaks(spikes())}
    assert [level.value for level in panel.levels] == [0.0, 90.0, 180.0, 270.0]


def test_the_path_has_the_contour_error_as_its_values_and_keeps_the_largest() -> None:
    found = contour()
    places = found.worst(2)
    chart = contour_on_path_chart(found, enlarged=10.0, places=places).shown(DRAWN)
    (panel,) = chart.panels
    for k, (mark, place) in enumerate(zip(panel.marks, places, strict=True)):
        assert (mark.x, mark.y) == pytest.approx(tuple(1e3 * place.position))
        assert mark.key == str(k)
    tool, path = panel.curves
    assert (chart.label, panel.label) == ("x (mm)", "y (mm)")
    assert panel.heat is not None
    assert path.heat is not None
    assert panel.heat.label == "contour error (µm)"
    assert panel.heat.high == pytest.approx(1e6 * found.largest)
    assert float(np.nanmax(path.heat)) == pytest.approx(1e6 * found.largest, rel=1e-12)
    foot = 1e3 * (found.position - found.vector)
    there = np.flatnonzero(np.isfinite(path.heat))
    off = np.hypot(tool.x - path.x, tool.y - path.y)[there]
    assert 1e3 * off / 10.0 == pytest.approx(path.heat[there], abs=1e-6)  # mm, ten times the error
    nearest = np.min(np.hypot(foot[:, 0] - path.x[there[::50], None], foot[:, 1] - path.y[there[::50], None]), axis=1)
    assert float(np.max(nearest)) < 1e-9
    first = found.position[found.counted][0] - found.vector[found.counted][0]
    assert (path.x[there[0]], path.y[there[0]]) == pytest.approx(tuple(1e3 * first), abs=0.02)


def test_what_does_not_count_has_no_place_on_the_path() -> None:
    nothing = replace(contour(), counted=np.zeros(len(contour().time), bool))
    (panel,) = contour_on_path_chart(nothing).panels
    assert all(np.all(np.isnan(each.x)) for each in panel.curves)
    contour_on_path(nothing)


def test_the_largest_errors_are_drawn_in_the_last_step_of_the_colors() -> None:
    figure = contour_on_path(contour())
    lines = [each for each in figure.axes[0].lines if each.get_color() is not None]
    widest = max(lines, key=lambda each: each.get_linewidth())
    (worst,) = contour().worst(1)
    foot = 1e3 * (contour().position - contour().vector)[int(np.argmin(np.abs(contour().time - worst.time)))]
    x, y = (np.asarray(each, float) for each in widest.get_data())
    assert float(np.nanmin(np.hypot(x - foot[0], y - foot[1]))) < 0.01
    assert figure.axes[1].get_ylabel() == "contour error (µm)"


def test_colors_of_values_fall_evenly_in_lightness() -> None:
    def lightness(tint: str) -> float:
        rgb = np.array([int(tint[k : k + 2], 16) for k in (1, 3, 5)]) / 255.0
        linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
        return 116.0 * float(linear @ (0.2126, 0.7152, 0.0722)) ** (1 / 3) - 16.0

    steps = np.diff([lightness(each) for each in style.HEAT])
    assert np.all(steps < -6.0)  # CIE L*: a step of 2 is seen
    assert np.ptp(steps) < 2.0


def test_a_worst_place_is_shown_1_to_1_with_its_error() -> None:
    found = contour()
    for place in found.worst(3):
        chart = place_chart(found, place).shown(DRAWN)
        (panel,) = chart.panels
        assert (chart.label, panel.label, chart.square) == ("x (µm)", "y (µm)", True)
        path, tool, off = panel.curves
        assert float(np.hypot(np.diff(off.x), np.diff(off.y))[0]) == pytest.approx(1e6 * abs(place.error), rel=1e-9)
        assert float(np.min(np.hypot(tool.x, tool.y))) == pytest.approx(0.0, abs=1e-6)
        nearest = float(np.min(np.hypot(path.x, path.y)))
        assert nearest == pytest.approx(1e6 * abs(place.error), rel=0.02)  # a sample of the path is 2.7 um long
    # beside another run of the same program, each with its name and its number
    chart = place_chart(found, place, [("today", 100, found), ("now", 101, found)])
    assert [(curve.name, curve.number) for curve in chart.panels[0].curves[1:3]] == [("today", 100), ("now", 101)]


def test_the_reserve_of_a_certificate_is_the_room_over_the_radius(certificate: Certificate) -> None:
    chart = certificate_chart(certificate).shown(DRAWN)
    plants = {each["name"]: each for each in certificate.document["plants"]}
    assert chart.label == "frequency (Hz)"
    (panel,) = chart.panels
    (plant,) = plants.values()
    room, radius = panel.curves[:2]
    (mark,) = panel.marks
    assert mark.x == plant["reserve_at_Hz"]
    assert mark.y / float(np.interp(mark.x, radius.x, radius.y)) == pytest.approx(plant["reserve"], rel=1e-6)
    assert np.all(room.y > radius.y)  # what is proven
    assert panel.caption == f"{plant['reserve']:.3g} × the room that is needed, at {plant['reserve_at_Hz']:.3g} Hz"
    (band,) = panel.bands
    assert np.array_equal(band.high, radius.y)


def test_no_disc_of_a_certificate_holds_the_critical_point(certificate: Certificate) -> None:
    (panel,) = certificate_discs_chart(certificate).panels
    may, model = panel.curves[:2]
    assert may.reach is not None
    away = np.hypot(may.x + 1.0, may.y)
    least = min(each["reserve"] for each in certificate.document["plants"])
    assert float(np.min(away / may.reach)) >= least * (1.0 - 1e-9)
    assert float(np.min(away / may.reach)) == pytest.approx(
        least, rel=0.05
    )  # one of 500 discs lies near the worst line
    nearest = np.min(np.hypot(model.x - may.x[:, None], model.y - may.y[:, None]), axis=1)
    assert float(np.max(nearest)) == 0.0


def test_the_trade_off_has_the_figures_of_each_law() -> None:
    rows = [
        ("P-PI", {X.key: 2e-6, HEIGHTS[0].key: 15e6, HEIGHTS[1].key: 6e6}, ""),
        ("P-PI + recovery", {X.key: 3e-6, HEIGHTS[0].key: 25e6, HEIGHTS[1].key: 5e6}, "not settled"),
        ("GPI", {X.key: 1e-6, HEIGHTS[0].key: 40e6, HEIGHTS[1].key: 9e6}, ""),
        ("unfit", {X.key: None, HEIGHTS[0].key: 15e6}, ""),
    ]
    chart = tradeoff_chart(rows).shown(DRAWN)
    assert chart.label.startswith("tracking RMS (µm)")
    for panel, key in zip(chart.panels, HEIGHTS, strict=True):
        assert panel.label.endswith("(N/µm)")
        found = {mark.key: mark for mark in panel.marks}
        assert list(found) == ["P-PI", "P-PI + recovery", "GPI"]
        for name, figures, why in rows[:3]:
            mark = found[name]
            assert (mark.x, mark.y) == pytest.approx((1e6 * figures[X.key], 1e-6 * figures[key.key]))  # type: ignore[operator]
            assert mark.hollow == bool(why)
            assert (mark.caption.endswith(f"not ranked: {why}")) == bool(why)
        assert found["P-PI"].number == found["P-PI + recovery"].number != found["GPI"].number
        assert panel.low is not None
        assert panel.high is not None
        assert panel.low < min(mark.y for mark in panel.marks)
        assert panel.high > max(mark.y for mark in panel.marks)


def test_a_trade_off_of_one_law_has_a_range() -> None:
    chart = tradeoff_chart([("P-PI", {X: 2e-6, HEIGHTS[0]: 15e6, HEIGHTS[1]: 6e6}, "")])
    assert chart.low is not None
    assert chart.high is not None
    assert chart.low < 2.0 < chart.high
    assert tradeoff_chart([]).panels[0].marks == ()


def test_the_page_has_the_colors_of_the_reports() -> None:
    page = Path(__file__).parents[2] / "page" / "src"
    text = "".join(each.read_text(encoding="utf-8") for each in sorted(page.rglob("*.ts")))
    assert [each for each in (*style.COLORS, *style.HEAT) if f'"{each}"' not in text] == []


def test_a_fit_is_not_drawn_where_its_rows_were_left_out() -> None:
    """Rows at 0, 1, 2, 6, 7 steps: a gap before the row at 6, none elsewhere."""
    from feeddrive.plot.identification import _apart

    time, values = _apart(0.01 * np.array([0.0, 1.0, 2.0, 6.0, 7.0]), np.arange(5.0))
    np.testing.assert_allclose(time, 0.01 * np.array([0.0, 1.0, 2.0, 6.0, 6.0, 7.0]))
    np.testing.assert_array_equal(values, [0.0, 1.0, 2.0, np.nan, 3.0, 4.0])
    assert _apart(np.array([0.3]), np.array([1.0]))[0].size == 1
