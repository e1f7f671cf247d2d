"""Bands of 95 % hold what a known variance leaves, low coherence is shaded, and a page may read other units."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.analysis.friction_map import FrictionMap
from feeddrive.analysis.margins import margins
from feeddrive.analysis.stiffness import stiffness
from feeddrive.identification.excitation.frequency_estimate import FrequencyEstimate, Level
from feeddrive.identification.response.plant_fit import fit_axis
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import DRAWN, Units
from feeddrive.language.table import READER
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.linearize import linearize
from feeddrive.plot.chart import DOTS, LOG
from feeddrive.plot.complex_plane import nyquist_chart
from feeddrive.plot.drawing import drawn
from feeddrive.plot.identification import friction_chart
from feeddrive.plot.over_frequency import (
    Overlay,
    doubtful,
    estimates_chart,
    magnitude_band,
    open_loop_chart,
    overlay_chart,
    phase_band,
    sensitivity_chart,
    stiffness_chart,
)

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
    other = Units(typographic=True, length="mm", force="kN", frequency="rad/s", gain="absolute")
    found = margins(measured())
    usual, chart = open_loop_chart(found), open_loop_chart(found, other).shown(other)
    assert chart.label == "frequency (rad/s)"
    assert chart.factor == pytest.approx(2.0 * np.pi)
    assert chart.panels[0].scale == LOG
    for before, after in zip(usual.panels[0].curves, chart.panels[0].curves, strict=True):
        np.testing.assert_allclose(after.x, 2.0 * np.pi * before.x)
        np.testing.assert_allclose(20.0 * np.log10(after.y), before.y, atol=1e-9)
    for mark, same in zip(usual.panels[0].marks, chart.panels[0].marks, strict=True):
        assert (same.x, 20.0 * np.log10(same.y)) == pytest.approx((2.0 * np.pi * mark.x, mark.y))
    assert "rad/s" in chart.panels[0].curves[0].caption
    compliance = FRF(F, 1e-8 / (1.0 + 1j * F / 50.0), "load_force", "position_load", "m/N")
    soft = stiffness_chart(stiffness(compliance), other).shown(other)
    assert soft.panels[0].label == "dynamic stiffness (kN/mm)"
    np.testing.assert_allclose(soft.panels[0].curves[0].y, 1e-6 * np.abs(1.0 / compliance.response))
    peak = sensitivity_chart(found, other).panels[0]
    assert peak.label == "|S|"
    assert peak.marks[0].y == pytest.approx(found.sensitivity_peak)
    with pytest.raises(ParameterError, match="one of N, kN"):
        Units(typographic=True, force="lbf")


def test_a_picture_of_an_axis_that_turns_says_torque_and_angle() -> None:
    compliance = FRF(F, 1e-8 / (1.0 + 1j * F / 50.0), "load_force", "position_load", "m/N")
    chart = stiffness_chart({"now": stiffness(compliance)}).shown(Units(rotary=True, typographic=True))
    assert chart.panels[0].label == "dynamic stiffness (N m/µrad)"
    assert "N m/µrad at" in chart.panels[0].curves[0].caption


def test_a_picture_is_drawn_in_the_units_of_its_reader() -> None:
    compliance = FRF(F, 1e-8 / (1.0 + 1j * F / 50.0), "load_force", "position_load", "m/N")
    found = stiffness(compliance)
    usual, turned = found.plot(), drawn(stiffness_chart(found), Units(rotary=True, typographic=True))
    assert [each.axes[0].get_ylabel() for each in (usual, turned)] == [
        "dynamic stiffness (N/µm)",
        "dynamic stiffness (N m/µrad)",
    ]
    note = READER.set(Units(rotary=True, typographic=True))
    try:
        again = drawn(stiffness_chart(found))
    finally:
        READER.reset(note)
    assert again.axes[0].get_ylabel() == "dynamic stiffness (N m/µrad)"


def test_the_band_of_an_identified_model_is_what_its_covariance_makes_of_its_response() -> None:
    """dG = J dθ with θ drawn from the covariance of the fit: E|dG|² on each line, by the model run again."""
    plant = fd.blocks.TwoMass(mass_motor=60.0, mass_load=40.0, stiffness=2e7, damping=2000.0)
    law = fd.blocks.CascadePPI(Kv=20.0, Kp=1e4)
    loop = fd.Loop(control=fd.Control(law=law), axis=fd.Axis(plant=plant), sample_time=1e-4)
    f, random = np.geomspace(10.0, 600.0, 120), np.random.default_rng(5)
    exact = linearize(loop, ["cut"], ["reading_motor", "reading_load"])
    made = list[FRF]()
    for reading in exact.outputs:
        G = exact.response(f, reading, "cut")
        error = (
            0.02 * G.magnitude * np.sqrt(0.5) * (random.standard_normal(f.size) + 1j * random.standard_normal(f.size))
        )
        made.append(FRF(f, G.response + error, "force", reading, "m/N", 1e-4, variance=(0.02 * G.magnitude) ** 2))
    fit = fit_axis(made[0], made[1], structure="two-mass").fit
    drawn = fit.agreement.drawn[1]
    assert drawn.variance is not None
    names = [each.name for each in fit.estimates]
    values = np.array([each.value for each in fit.estimates])

    def load(theta: np.ndarray) -> np.ndarray:
        found = dict(zip(names, theta, strict=True))
        tau = found.pop("dead_time", 0.0)
        pole = found.pop("current_loop", np.inf)
        s = 2j * np.pi * drawn.frequency
        m1, m2, k, c = (found[name] for name in ("mass_motor", "mass_load", "stiffness", "damping"))
        b1, b2 = (found.get(name, getattr(fit.plant, name)) for name in ("viscous_motor", "viscous_load"))
        cross = c * s + k
        whole = (m1 * s**2 + b1 * s + cross) * (m2 * s**2 + b2 * s + cross) - cross**2
        return np.asarray(cross / whole * np.exp(-s * tau) / (1.0 + s / (2.0 * np.pi * pole)))

    steps = np.diag(1e-5 * np.maximum(np.abs(values), 1e-5))
    slopes = np.stack([(load(values + each) - load(values - each)) / (2.0 * np.sum(each)) for each in steps], axis=1)
    hold = drawn.magnitude / np.abs(load(values))  # of the zero-order hold, the same for all parameters
    expected = np.real(np.einsum("li,ij,lj->l", slopes, fit.covariance, np.conj(slopes))) * hold**2
    np.testing.assert_allclose(drawn.variance, expected, rtol=2e-3)  # the hold differs at a resonance


def test_a_measured_response_lies_over_its_model_with_a_band_each() -> None:
    model = FRF(F, 1.02 * GAIN, "force", "load", "m/N")
    chart = overlay_chart(
        [Overlay("", replace(measured(np.linspace(0.5, 1.0, F.size)), unit="m/N"), model, model)]
    ).shown(DRAWN)
    assert [each.label for each in chart.panels] == [
        "magnitude (dB re 1 m/N)",
        "phase (deg)",
        "error (dB)",
        "coherence",
    ]
    assert [each.name for each in chart.panels[0].curves] == ["measured", "model"]
    np.testing.assert_allclose(chart.panels[2].curves[0].y, 20.0 * np.log10(0.02), atol=1e-9)
    assert [each.name for each in chart.panels[0].bands] == ["", "95 % of the measurement"]
    ratios = Units(typographic=True, gain="absolute")
    absolute = overlay_chart([Overlay("", None, None, model)], ratios).shown(ratios)
    assert absolute.panels[0].label == "magnitude (µm/N)"
    np.testing.assert_allclose(absolute.panels[0].curves[0].y, 1e6 * 1.02 * np.abs(GAIN))


def test_two_measurements_shade_what_they_share_once() -> None:
    coherence = np.ones(F.size)
    coherence[5:9] = 0.3
    other = np.ones(F.size)
    other[7:12] = 0.3
    (band,) = doubtful([measured(coherence), measured(other)])
    half = np.sqrt(F[1] / F[0])
    np.testing.assert_allclose(band.x[:2], [F[5] / half, F[11] * half])
    assert band.x.size == 3


def test_what_a_friction_model_leaves_of_the_measured_points_is_their_distance_from_all_of_its_friction() -> None:
    """Force 50 N sign(v) + 300 N s/m v, of which the plant has the viscous part."""
    axis = fd.Axis(plant=fd.blocks.Rigid(mass=100.0, viscous=300.0), friction_load=fd.blocks.Coulomb(coulomb=50.0))
    loop = fd.Loop(control=fd.Control(law=fd.blocks.CascadePPI(Kv=20.0, Kp=1e4)), axis=axis, sample_time=1e-3)
    v = np.array([-0.2, -0.1, 0.1, 0.2])
    off = np.array([1.0, -2.0, 3.0, 0.0])
    seen = FrictionMap(v, 50.0 * np.sign(v) + 300.0 * v + off, np.full(4, 0.5), np.full(4, 10))
    kilo = Units(typographic=True, force="kN")
    chart = friction_chart(loop, measured=seen, units=kilo).shown(kilo)
    above, below = chart.panels
    assert above.label == "friction (kN)"
    whole = next(each for each in above.curves if each.name.startswith("model with"))
    there = ~np.isnan(whole.x)
    np.testing.assert_allclose(whole.y[there], 0.05 * np.sign(whole.x[there]) + 3e-4 * whole.x[there], atol=1e-12)
    points = next(each for each in below.curves if each.look == DOTS)
    np.testing.assert_allclose(points.y, 1e-3 * off, atol=1e-12)


def test_the_band_of_an_estimate_counts_that_its_variance_is_estimated_too() -> None:
    noise = np.full(F.size, 0.5)
    level = {"noise": Level(F, 0.1 * np.abs(GAIN), 0.1 * np.abs(GAIN))}
    found = FrequencyEstimate(measured(np.ones(F.size)), "by hand", np.full(F.size, 3.0), noise, levels=level)
    chart = estimates_chart([found])
    (band,) = [each for each in chart.panels[0].bands if each.name == "95 % of the measurement"]
    np.testing.assert_allclose(band.high, 20.0 * np.log10(np.abs(GAIN) + found.radius()), rtol=1e-9)
    assert np.all(found.radius() > 1.1 * measured().radius)
    assert [each.name for each in chart.panels[0].curves] == ["measured", "noise"]
    np.testing.assert_allclose(chart.panels[0].curves[1].y, 20.0 * np.log10(0.1 * np.abs(GAIN)))


def test_the_nyquist_curve_of_a_measurement_lies_in_the_discs_of_its_lines() -> None:
    found = measured()
    chart = nyquist_chart({"today": margins(FRF(F, GAIN, "cut", "force", "N/N")), "now": margins(found)})
    (area,) = [each for each in chart.panels[0].curves if each.reach is not None]
    assert (area.name, area.number) == ("95 % of the measurement", 1)
    assert found.radius is not None
    near = np.flatnonzero((np.abs(GAIN) > 0.3) & (np.abs(GAIN) < 2.0))
    for k in near:  # each disc of a line is covered by the nearest that is drawn
        apart = np.hypot(area.x - GAIN[k].real, area.y - GAIN[k].imag)
        j = int(np.argmin(apart))
        assert apart[j] < 0.02
        assert area.reach[j] == pytest.approx(found.radius[k], rel=0.05)
