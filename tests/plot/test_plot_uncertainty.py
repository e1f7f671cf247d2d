"""Bands of 95 % hold what a known variance leaves, low coherence is shaded, and a page may read other units."""

from __future__ import annotations

import numpy as np
import pytest

from feeddrive.analysis.margins import margins
from feeddrive.analysis.stiffness import stiffness
from feeddrive.language.errors import ParameterError
from feeddrive.language.shown_units import ShownUnits
from feeddrive.loop.frequency_response import FRF
from feeddrive.plot.chart import LOG
from feeddrive.plot.over_frequency import open_loop_chart, sensitivity_chart, stiffness_chart
from feeddrive.plot.uncertainty import doubtful, magnitude_band, phase_band

F = np.geomspace(1.0, 1000.0, 31)
GAIN = 40.0 / (2j * np.pi * F / 30.0 * (1.0 + 1j * F / 200.0))
SPREAD = 0.03 * np.abs(GAIN)  # root of E|dG|²


def measured(coherence: np.ndarray | None = None) -> FRF:
    return FRF(F, GAIN, "cut", "force", "N/N", variance=SPREAD**2, coherence=coherence)


def test_the_disc_of_95_percent_holds_95_of_100_complex_normal_errors_and_the_bands_hold_the_disc() -> None:
    found = measured()
    random = np.random.default_rng(3)
    draws = 20_000
    error = (
        SPREAD * np.sqrt(0.5) * (random.standard_normal((draws, F.size)) + 1j * random.standard_normal((draws, F.size)))
    )
    assert found.radius is not None
    inside = np.mean(np.abs(error) <= found.radius, axis=0)
    np.testing.assert_allclose(inside, 0.95, atol=6.0 * np.sqrt(0.05 * 0.95 / draws))
    (size,), (turn,) = magnitude_band(found, 0), phase_band(found, found.phase_deg, 0)
    disc = GAIN + found.radius * np.exp(2j * np.pi * np.arange(720)[:, None] / 720)
    level = 20.0 * np.log10(np.abs(disc))
    np.testing.assert_allclose(level.max(axis=0), size.high, atol=1e-3)  # dB: the disc is drawn by 720 points
    np.testing.assert_allclose(level.min(axis=0), size.low, atol=1e-3)
    turned = np.degrees(np.angle(disc / GAIN))
    np.testing.assert_allclose(turned.max(axis=0), turn.high - found.phase_deg, atol=1e-3)  # deg


def test_what_is_not_to_be_trusted_is_shaded_up_to_half_way_to_its_neighbors() -> None:
    coherence = np.ones(F.size)
    coherence[[0, 10, 11, 30]] = 0.5, 0.9, 0.2, 0.85
    (band,) = doubtful([measured(coherence)])
    parts = band.x[~np.isnan(band.x)].reshape(-1, 2)
    half = np.sqrt(F[1] / F[0])  # of a step of the lines, which are even over ln f
    expected = [[F[0], F[0] * half], [F[10] / half, F[11] * half], [F[30] / half, F[30]]]
    np.testing.assert_allclose(parts, expected, rtol=1e-12)
    assert doubtful([measured(np.ones(F.size)), measured()]) == ()


def test_an_open_loop_that_was_measured_shows_its_coherence_and_its_bands_and_a_model_neither() -> None:
    chart = open_loop_chart(margins(measured(np.linspace(0.5, 1.0, F.size))))
    assert [each.label for each in chart.panels] == ["open loop |L| (dB)", "phase (deg)", "coherence"]
    assert [len(each.bands) for each in chart.panels] == [2, 2, 1]
    model = open_loop_chart(margins(FRF(F, GAIN, "cut", "force", "N/N")))
    assert [len(each.bands) for each in model.panels] == [0, 0]


def test_other_units_are_other_numbers_of_the_same_picture() -> None:
    other = ShownUnits(length="mm", force="kN", frequency="rad/s", gain="absolute")
    found = margins(measured())
    usual, chart = open_loop_chart(found), open_loop_chart(found, other)
    assert chart.label == "frequency (rad/s)"
    assert chart.factor == pytest.approx(2.0 * np.pi)
    assert chart.panels[0].scale == LOG
    for before, after in zip(usual.panels[0].curves, chart.panels[0].curves, strict=True):
        np.testing.assert_allclose(after.x, 2.0 * np.pi * before.x)
        np.testing.assert_allclose(20.0 * np.log10(after.y), before.y, atol=1e-9)
    for mark, same in zip(usual.panels[0].marks, chart.panels[0].marks, strict=True):
        assert (same.x, 20.0 * np.log10(same.y)) == pytest.approx((2.0 * np.pi * mark.x, mark.y))
    assert "rad/s" in chart.panels[0].curves[0].said
    compliance = FRF(F, 1e-8 / (1.0 + 1j * F / 50.0), "load_force", "position_load", "m/N")
    soft = stiffness_chart(stiffness(compliance), other)
    assert soft.panels[0].label == "dynamic stiffness (kN/mm)"
    np.testing.assert_allclose(soft.panels[0].curves[0].y, 1e-6 * np.abs(1.0 / compliance.response))
    peak = sensitivity_chart(found, other).panels[0]
    assert peak.label == "|S|"
    assert peak.marks[0].y == pytest.approx(found.sensitivity_peak)
    with pytest.raises(ParameterError, match="one of N, kN"):
        ShownUnits(force="lbf")


def test_a_picture_of_an_axis_that_turns_says_torque_and_angle() -> None:
    compliance = FRF(F, 1e-8 / (1.0 + 1j * F / 50.0), "load_force", "position_load", "m/N")
    chart = stiffness_chart({"now": stiffness(compliance)}).turning()
    assert chart.panels[0].label == "dynamic stiffness (N m/µrad)"
    assert "N m/µrad at" in chart.panels[0].curves[0].said
