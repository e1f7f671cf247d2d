"""Margins against closed forms, python-control, and what they promise: that gain and delay really reach -1."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from feeddrive.analysis.loop_model import LoopModel, loop_model
from feeddrive.analysis.margins import (
    bandwidth,
    complementary_sensitivity,
    logarithms,
    margin_intervals,
    margins,
    peak_deviation,
    sensitivity,
    tracking_bandwidth,
)
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.language.errors import ParameterError
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.linearize import StateSpace
from feeddrive.loop.loop import Loop

F = np.geomspace(0.05, 2000.0, 2000)
# 200 lines a decade: the error of straight pieces over ln f is (step²/8) times the bend, which for poles is below 1
STEP = np.log(F[1] / F[0])


def continuous(function, frequency=F) -> FRF:
    return FRF(frequency, function(2j * np.pi * frequency))


def test_two_poles_have_the_crossover_and_phase_of_the_closed_form() -> None:
    a, wc = 2 * np.pi * 30.0, 2 * np.pi * 17.0
    K = wc * np.hypot(wc, a)
    found = margins(continuous(lambda s: K / (s * (s + a))))
    assert len(found.gain_crossovers) == 1
    assert found.crossover == pytest.approx(17.0, rel=STEP**2)
    lead = 90.0 - np.degrees(np.arctan(wc / a))
    assert found.phase_margin_deg == pytest.approx(lead, abs=np.degrees(STEP**2))
    assert found.delay_margin == pytest.approx(np.radians(lead) / wc, rel=3 * STEP**2)
    assert found.delay_margin_samples is None
    # the phase stays above -180° for all frequencies
    assert found.phase_crossovers == ()
    assert found.gain_increase_dB is None
    assert found.gain_reduction_dB is None


def test_three_poles_have_the_gain_margin_of_routh() -> None:
    a, b, K = 2 * np.pi * 12.0, 2 * np.pi * 90.0, 9e6
    found = margins(continuous(lambda s: K / (s * (s + a) * (s + b))))
    assert len(found.phase_crossovers) == 1
    assert found.phase_crossovers[0].frequency == pytest.approx(np.sqrt(12.0 * 90.0), rel=STEP**2)
    assert found.gain_increase_dB == pytest.approx(20 * np.log10(a * b * (a + b) / K), abs=9 * STEP**2)


def test_an_integrator_with_dead_time_has_all_its_phase_crossovers() -> None:
    K, delay = 2 * np.pi * 40.0, 2e-3
    f = np.linspace(0.5, 2000.0, 4000)  # 0.5 Hz turn the phase by 0.36°
    found = margins(continuous(lambda s: K / s * np.exp(-s * delay), f))
    expected = (0.25 + np.arange(4)) / delay
    places = [c.frequency for c in found.phase_crossovers]
    assert places == pytest.approx(expected, abs=0.01)
    # |L| falls as 1/f: each crossover has its own gain margin, the first is the smallest
    margins_dB = 20 * np.log10(2 * np.pi * expected / K)
    assert [c.gain_margin_dB for c in found.phase_crossovers] == pytest.approx(margins_dB, abs=1e-3)
    assert found.gain_increase_dB == pytest.approx(margins_dB[0], abs=1e-3)
    assert found.crossover == pytest.approx(40.0, rel=1e-6)
    assert found.phase_margin_deg == pytest.approx(90.0 - np.degrees(K * delay), abs=1e-3)
    assert found.delay_margin == pytest.approx((np.pi / 2 - K * delay) / K, rel=1e-4)


def test_a_conditionally_stable_loop_has_a_margin_for_less_gain() -> None:
    z, K = 2 * np.pi * 5.0, 2 * np.pi * 60.0
    found = margins(continuous(lambda s: K * (s + z) ** 2 / s**3))
    assert found.phase_crossovers[0].frequency == pytest.approx(5.0, rel=STEP**2)
    assert found.gain_reduction_dB == pytest.approx(20 * np.log10(2 * K / z), abs=9 * STEP**2)
    assert found.gain_increase_dB is None


def test_a_sampled_integrator_meets_its_gain_margin_at_nyquist() -> None:
    T, K = 1e-3, 150.0
    f = np.geomspace(1.0, 500.0, 800)
    z = np.exp(2j * np.pi * f * T)
    found = margins(FRF(f, K * T / (z - 1.0), sample_time=T))
    assert found.phase_crossovers[-1].frequency == pytest.approx(500.0)
    assert found.gain_increase_dB == pytest.approx(20 * np.log10(2.0 / (K * T)), abs=1e-9)
    assert found.delay_margin_samples == pytest.approx(found.delay_margin / T)
    # |z - 1| = 2 sin(πfT) = KT
    assert found.crossover == pytest.approx(np.arcsin(K * T / 2) / (np.pi * T), rel=1e-4)


def test_a_resonance_above_the_crossover_gives_three_gain_crossovers_and_the_delay_margin_of_the_last() -> None:
    w, damping = 2 * np.pi * 300.0, 0.01
    found = margins(
        continuous(
            lambda s: (2 * np.pi * 40.0 / s) * w**2 / (s**2 + 2 * damping * w * s + w**2), np.geomspace(1, 1e3, 8000)
        )
    )
    assert len(found.gain_crossovers) == 3
    assert found.crossover == pytest.approx(40.7, abs=0.1)
    # each crossover needs its own delay; the smallest is at the top of the resonance, not at the first crossover
    assert found.delay_margin == min(c.delay_margin for c in found.gain_crossovers)
    assert found.delay_margin < found.gain_crossovers[0].delay_margin


def test_the_sensitivity_peak_agrees_with_a_dense_search() -> None:
    def loop(s):
        return 2 * np.pi * 60.0 * np.exp(-1.2e-3 * s) / s

    dense = np.linspace(20.0, 400.0, 2_000_001)
    peak = np.abs(1.0 / (1.0 + loop(2j * np.pi * dense)))
    found = margins(continuous(loop))
    assert found.sensitivity_peak == pytest.approx(peak.max(), rel=STEP**2)
    # the place of a flat minimum is known to a part of the grid only
    assert found.modulus_frequency == pytest.approx(dense[np.argmax(peak)], rel=0.1 * STEP)
    assert found.modulus_margin * found.sensitivity_peak == pytest.approx(1.0)


@pytest.mark.parametrize("gain", [0.01, 0.02, 0.035, 0.05])
def test_python_control_finds_the_same(gain: float) -> None:
    control = pytest.importorskip("control", reason="NOT TESTED: pip install 'feeddrive[control]'")
    s = control.tf("s")
    model = gain * 4e3 * (s + 40) / (s * (s + 300) * (1 + s / 900)) / (1 + 0.2 * s / 500 + (s / 500) ** 2)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        gm, pm, sm, wpc, wgc, wms = control.stability_margins(model, returnall=True)
    found = margins(FRF(F, model(2j * np.pi * F)))
    assert [c.frequency for c in found.gain_crossovers] == pytest.approx(np.sort(wgc) / 2 / np.pi, rel=1e-3)
    order = np.argsort(wgc)
    assert [c.phase_margin_deg for c in found.gain_crossovers] == pytest.approx(pm[order], abs=0.3)
    order = np.argsort(wpc)
    assert [c.frequency for c in found.phase_crossovers] == pytest.approx(wpc[order] / 2 / np.pi, rel=1e-3)
    assert [c.gain_margin_dB for c in found.phase_crossovers] == pytest.approx(20 * np.log10(gm[order]), abs=0.02)
    assert found.modulus_margin == pytest.approx(sm.min(), rel=1e-3)
    assert found.modulus_frequency == pytest.approx(wms[np.argmin(sm)] / 2 / np.pi, rel=1e-2)


@settings(max_examples=40, deadline=None)
@given(
    crossover=st.floats(5.0, 80.0),
    pole=st.floats(20.0, 300.0),
    delay=st.floats(0.0, 1e-3),
    resonance=st.floats(150.0, 600.0),
    damping=st.floats(0.02, 0.5),
)
def test_gain_and_delay_margins_really_reach_minus_one(crossover, pole, delay, resonance, damping) -> None:
    def loop(s):
        w = 2 * np.pi * resonance
        lag = 1.0 / (1.0 + s / (2 * np.pi * pole))
        return 2 * np.pi * crossover / s * lag * np.exp(-s * delay) * w**2 / (s**2 + 2 * damping * w * s + w**2)

    f = np.geomspace(1.0, 3000.0, 6000)
    L = continuous(loop, f)
    found = margins(L)
    # near a crossing the curve passes -1 within the bow of one grid step, at most step * |dL/dln f| ~ 1.3e-3 * 50
    for c in found.phase_crossovers:
        assert np.min(np.abs(1.0 + 10 ** (c.gain_margin_dB / 20) * L.response)) < 0.07
    for c in found.gain_crossovers:
        late = L.response * np.exp(-2j * np.pi * f * c.delay_margin)
        assert np.min(np.abs(1.0 + late)) < 0.07
        assert 0.0 <= c.delay_margin <= 1.0 / c.frequency
        assert -180.0 < c.phase_margin_deg <= 180.0
    assert np.min(np.abs(1.0 + L.response)) >= found.modulus_margin > 0.0


def test_what_does_not_occur_is_absent_and_never_nan() -> None:
    found = margins(continuous(lambda s: 0.1 / (1 + s)))
    numbers = found.numbers()
    assert [name for name, value in numbers.items() if value is None] == [
        "crossover_Hz",
        "phase_margin_deg",
        "gain_increase_dB",
        "gain_reduction_dB",
        "delay_margin_s",
        "delay_margin_samples",
    ]
    assert all(np.isfinite(value) for value in numbers.values() if value is not None)
    assert "nan" not in str(found).lower()


def test_a_loop_through_minus_one_has_no_margin_left() -> None:
    # 1/s² lies on the negative real axis: its crossover at 1/(2π) Hz is exactly -1
    f = np.geomspace(0.01, 1.0, 401) / (0.1 * 2 * np.pi)
    found = margins(continuous(lambda s: 1.0 / s**2, f))
    assert found.phase_margin_deg == pytest.approx(0.0, abs=1e-6)
    assert found.modulus_margin == pytest.approx(0.0, abs=1e-3)
    assert found.sensitivity_peak > 1e3


def test_two_lines_are_needed() -> None:
    with pytest.raises(ParameterError, match="at least two lines"):
        margins(FRF(np.array([1.0]), np.array([1.0 + 0j])))


def test_sensitivities_sum_to_one_and_know_the_edge() -> None:
    L = continuous(lambda s: 2 * np.pi * 60.0 * np.exp(-1.2e-3 * s) / s)
    total = sensitivity(L) + complementary_sensitivity(L)
    assert np.max(np.abs(total.response - 1.0)) < 1e-12
    edge = FRF(np.array([1.0, 2.0]), np.array([-1.0 + 0j, 0.5]))
    with pytest.raises(ParameterError, match="-1 at 1 Hz"):
        sensitivity(edge)


def test_bandwidths_of_an_integrator() -> None:
    """L = a/(jf): |S| = f/(a² + f²)^½ rises through √½ at f = a, and |T| = a/(a² + f²)^½ falls through it there."""
    lines = np.geomspace(1.0, 1000.0, 400)
    L = 37.0 / (1j * lines)
    # ln |S| over ln f has slope 1/2 and curvature -1/2 there: a chord over h is off by h²/16, its zero by h²/8
    near = np.log(lines[1] / lines[0]) ** 2 / 8.0
    assert bandwidth(lines, L) == pytest.approx(37.0, rel=near)
    assert tracking_bandwidth(FRF(lines, L / (1.0 + L))) == pytest.approx(37.0, rel=near)
    assert bandwidth(lines[lines > 40.0], L[lines > 40.0]) is None


def test_deviation_of_the_peak_is_that_of_noisy_lines() -> None:
    """At one line, Ms of 4000 loop gains with a circular error of 1 %: 5 % are four deviations of a deviation."""
    L, deviation, random = np.array([-0.4 + 0.2j]), 0.01, np.random.default_rng(3)
    noise = deviation * np.sqrt(0.5) * (random.standard_normal(4000) + 1j * random.standard_normal(4000))
    peaks = 1.0 / np.abs(1.0 + L + noise)
    assert peak_deviation(L, np.array([deviation**2])) == pytest.approx(np.std(peaks), rel=0.05)


@pytest.mark.parametrize(("off", "level"), [(0.7e-9, 0.0), (1.5e-9, 1.5e-9)])
def test_a_billionth_beside_a_crossing_is_rounding(off: float, level: float) -> None:
    lines = logarithms(np.array([1.0, 2.0]), np.array([np.exp(off), -np.exp(1j * off)]))
    assert lines.level[0] == pytest.approx(level, rel=1e-6)
    assert lines.lead[1] == pytest.approx(level, rel=1e-6)


def test_the_spread_of_draws_is_known_to_six_percent() -> None:
    """The deviation of n normal draws has a relative error of 1/√(2 n)."""
    f = np.geomspace(1.0, 100.0, 50)
    intervals = margin_intervals(FRF(f, 20.0 / (1j * f), variance=np.full(f.size, 1e-4)))
    assert 1.0 / np.sqrt(2.0 * intervals.draws) < 0.06


def test_a_slow_loop_has_its_crossover_on_the_lines() -> None:
    """Kp/m = 2π 0.075 Hz at a Nyquist frequency of 5 kHz, 1.5e-5 of it."""
    law = CascadePPI(Kv=0.01, Kp=2.0 * np.pi * 0.075 * 100.0)
    loop = Loop(control=Control(law=law), axis=Axis(plant=Rigid(mass=100.0)), sample_time=1e-4)
    assert margins(loop).crossover == pytest.approx(0.075, rel=1e-3)


def resonant(damping: float, *frequencies: float) -> np.ndarray:
    """Return the lines about 100 Hz of a loop with resonances there of this damping ratio."""
    T, n = 1e-3, 2 * len(frequencies)
    A = np.zeros((n, n))
    for k, f in enumerate(frequencies):
        s = 2.0 * np.pi * f * (-damping + 1j)
        turn = s.imag * T
        part = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = np.exp(s.real * T) * part
    one = np.ones((n, 1))
    model = StateSpace(A, one, one.T, np.zeros((1, 1)), T, tuple(map(str, range(n))), ("cut",), ("force",))
    lines = LoopModel(model, model).lines()
    return lines[np.abs(lines - 100.0) < 4.1 * damping * 100.0]


@pytest.mark.parametrize("damping", [1e-3, 6e-4, 1e-5, 1e-7])
def test_a_resonance_has_a_line_every_quarter_of_its_half_width(damping: float) -> None:
    assert resonant(damping, 100.0).size >= 32


@pytest.mark.parametrize(
    ("damping", "apart", "both"),
    [(1e-2, 0.03, True), (1e-2, 0.015, False), (1e-4, 0.00125, True), (1e-4, 0.0007, False)],
)
def test_lines_of_two_resonances_that_nearly_coincide_are_not_both_kept(
    damping: float, apart: float, both: bool
) -> None:
    """They keep 0.02 Hz at 100 Hz, or 0.1 of the half width, 0.01 Hz with a damping ratio of 1e-4, if that is less."""
    assert (resonant(damping, 100.0, 100.0 + apart).size > 60) is both


@pytest.mark.parametrize("damping", [1e-2, 1e-3, 5e-4, 1e-5])
def test_the_lines_of_a_loop_meet_the_peak_of_a_resonance_with_little_damping(damping: float) -> None:
    """At the pole s = -ζw ± jw√(1 - ζ²) a resonance has its peak, to ζ², and 30 and 70 kg have one of w² = k/21 kg."""
    w, reduced = 2.0 * np.pi * 60.0, 21.0
    plant = TwoMass(mass_motor=70.0, mass_load=30.0, stiffness=w * w * reduced, damping=2.0 * damping * w * reduced)
    law = CascadePPI(Kv=5.0, Kp=2000.0, Tn=0.1, velocity_encoder="motor")
    model = loop_model(Loop(control=Control(law=law), axis=Axis(plant=plant), sample_time=1e-3))
    f = model.lines()
    peak = np.abs(model.loop_gain(np.array([60.0 * np.sqrt(1.0 - damping**2)])).response[0])
    # 1 % for the slope of the loop gain beside the resonance, over the half width of the largest damping
    assert np.max(np.abs(model.loop_gain(f).response[np.abs(f - 60.0) < 3.0])) == pytest.approx(peak, rel=0.01)
    # no two lines nearly coincide but for the width of the resonance
    assert np.min(np.diff(f) / f[1:]) > 0.5 * min(2e-4, 0.1 * damping)
