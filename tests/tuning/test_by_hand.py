"""Tuning by hand: any number of a control moved, and the loop that follows, against the linear model of the loop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError
from feeddrive.loop.linearize import loop_gain
from feeddrive.loop.loop import Loop
from feeddrive.tuning.by_hand import ByHand, knobs
from feeddrive.tuning.criteria import Limits
from feeddrive.tuning.operating_point import modelled_point


@pytest.fixture(scope="module")
def loop() -> Loop:
    return fd.read_machine("ball_screw").loop(None)


@pytest.fixture(scope="module")
def by_hand(loop: Loop) -> ByHand:
    return ByHand(loop.control, [modelled_point(loop)])


def test_a_look_is_the_linear_model_of_the_loop_with_that_control(loop: Loop, by_hand: ByHand) -> None:
    """Two ways to one loop gain: the control traced alone and joined to the axis, and the whole loop linearized."""
    values = by_hand.values | {"law.Kv": 77.0, "filters.0.frequency": 300.0, "law.Tn": 0.02}
    seen = by_hand.at(values).figures[0].loop_gain
    lines = seen.frequency[::40]
    whole = loop_gain(replace(loop, control=tree.vary(loop.control, values)), lines)
    # both are exact; what they differ by is the rounding of two orders of summation
    assert np.max(np.abs(seen.response[::40] / whole.response - 1.0)) < 1e-6


def test_every_number_of_the_control_is_a_knob_within_its_bounds(loop: Loop) -> None:
    found = {each.name: each for each in knobs(loop.control, float(loop.sample_time))}
    there = {name for name, value in tree.leaves(loop.control) if isinstance(value, float)}
    assert set(found) == {name for name in there if not name.startswith(("guard", "force_limit"))}
    for each in found.values():
        assert each.low <= each.value <= each.high
        assert each.low < each.high
        for end in (each.low, each.high):  # at a bound that is open the slider ends a little inside
            assert each.declared.least is None or end >= each.declared.least
    assert found["filters.0.frequency"].high < 0.5 / loop.sample_time
    assert found["filters.0.frequency"].block == "notch"
    assert found["law.Kv"].logarithmic


def test_a_number_outside_of_its_bounds_is_refused_with_its_unit(by_hand: ByHand) -> None:
    with pytest.raises(ParameterError, match=r"Kv = -1 1/s .* must be > 0 1/s"):
        by_hand.at({"law.Kv": -1.0})
    with pytest.raises(ParameterError, match=r"there is no parameter 'law\.Kw'"):
        by_hand.at({"law.Kw": 1.0})


def test_of_several_points_the_worst_leads(loop: Loop) -> None:
    """A lighter table moves the resonance: the point whose Ms is largest is judged."""
    light, heavy = (tree.vary(loop, {"axis.x.plant.mass_load": 33.0 * share}) for share in (0.7, 1.4))
    points = [modelled_point(each, name) for each, name in ((light, "light"), (heavy, "heavy"))]
    both = ByHand(loop.control, points, Limits(sensitivity_peak=1.5))
    look = both.at(both.values)
    peaks = {each.point: each.margins.sensitivity_peak for each in look.figures}
    assert look.leading.point == max(peaks, key=lambda name: peaks[name])
    (verdict,) = look.judged
    assert verdict.judged.value == max(peaks.values())
    assert verdict.point == look.leading.point
    assert verdict.frequency == look.leading.margins.modulus_frequency
    assert not verdict.keeps
    assert not both.at(both.values | {"law.Kp": 1e6}).stable


def test_the_limit_that_is_broken_most_leads_with_its_place(loop: Loop, by_hand: ByHand) -> None:
    """Each figure at its own frequency; their order is that of the share of the limit that they use."""
    limits = Limits(
        sensitivity_peak=4.0, phase_margin_deg=30.0, compliance_peak_m_per_N=1e-9, delay_margin_samples=1e-3
    )
    look = by_hand.at(by_hand.values, limits)
    kinds = [each.judged.figure.title for each in look.judged]
    assert kinds[0] == "peak compliance"
    assert kinds[-1] == "delay margin"
    assert [each.keeps for each in look.judged] == [False, True, True, True]
    stiff, found = look.leading.stiffness, {each.judged.figure.title: each for each in look.judged}
    assert found["peak compliance"].used == pytest.approx(1e9 / stiff.minimum)
    assert stiff.at(found["peak compliance"].frequency) == pytest.approx(stiff.minimum, rel=1e-3)
    margins = look.leading.margins
    place = next(each for each in margins.gain_crossovers if each.phase_margin_deg == margins.phase_margin_deg)
    assert str(found["phase margin"]).endswith(f"deg at {place.frequency:.4g} Hz")
    assert found["Ms"].used == pytest.approx(margins.sensitivity_peak / 4.0)


def test_noise_of_the_readings_is_judged_where_it_is_given(by_hand: ByHand) -> None:
    limits = Limits(force_noise_N=1.0, reading_noise=(1e-8, 1e-8))
    noise = {each.judged.figure.title: each for each in by_hand.at(by_hand.values, limits).judged}["force noise"]
    twice = Limits(force_noise_N=1.0, reading_noise=(2e-8, 2e-8))
    more = {each.judged.figure.title: each for each in by_hand.at(by_hand.values, twice).judged}["force noise"]
    assert more.judged.value == pytest.approx(2.0 * (noise.judged.value or 0.0))
    assert noise.frequency is None
