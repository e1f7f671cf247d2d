"""Filters: scipy's bilinear transform, the golden vectors of the ball-screw design, and the analog response at ω."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import bilinear, lfilter

from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.families import Filter
from feeddrive.blocks.filter.low_pass import LowPass
from feeddrive.blocks.filter.low_pass2 import LowPass2
from feeddrive.blocks.filter.notch import Notch
from feeddrive.blocks.filter.second_order import SecondOrder
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.language.errors import ParameterError
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop


def run(block: Filter, T: float, values: np.ndarray, start: float = 0.0) -> np.ndarray:
    with np.errstate(all="ignore"):
        made = block.prepare(T)
        state = block.start(made, start)
        out = []
        for value in values:
            state, output = block.step(made, state, float(value))
            out.append(output)
    return np.array(out, dtype=float)


def coefficients(block: Filter, T: float) -> tuple[np.ndarray, np.ndarray]:
    """b and a of a second-order section."""
    with np.errstate(all="ignore"):
        made = block.prepare(T)
    return np.array([made.b0, made.b1, made.b2]), np.array([1.0, made.b1 if made.a1 is None else made.a1, made.a2])


def bent(frequency: float, T: float) -> float:
    """The analog ω that Tustin takes to the wanted frequency."""
    return 2.0 / T * float(np.tan(np.pi * frequency * T))


def test_notch_of_the_ball_screw() -> None:
    b, a = coefficients(Notch(frequency=460.0, damping_zero=0.06, damping_pole=0.6), 5e-5)
    np.testing.assert_allclose(b, [0.92841922, -1.821741947, 0.91251238], atol=5e-9)  # to the digits given
    np.testing.assert_allclose(a, [1.0, -1.821741947, 0.8409316], atol=5e-8)


def test_low_pass_of_the_ball_screw() -> None:
    b, a = coefficients(LowPass2(frequency=2500.0, damping=0.7), 5e-5)
    np.testing.assert_allclose(b, [0.097959253, 0.195918506, 0.097959253], atol=5e-10)
    np.testing.assert_allclose(a, [1.0, -0.945978228, 0.33781524], atol=5e-9)


ratios = st.floats(0.01, 2.0)
shares = st.floats(0.01, 0.45)  # of the sample rate


@settings(max_examples=50, deadline=None)
@given(share=shares, zero=ratios, pole=ratios)
def test_notch_is_scipys_bilinear_of_the_prewarped_filter(share: float, zero: float, pole: float) -> None:
    T = 1e-4
    w = bent(share / T, T)
    b, a = bilinear([1.0, 2 * zero * w, w * w], [1.0, 2 * pole * w, w * w], fs=1 / T)
    found = coefficients(Notch(frequency=share / T, damping_zero=zero, damping_pole=pole), T)
    np.testing.assert_allclose(found[0], b, atol=1e-12)
    np.testing.assert_allclose(found[1], a, atol=1e-12)


@settings(max_examples=50, deadline=None)
@given(zero_at=shares, pole_at=shares, zero=ratios, pole=ratios)
def test_second_order_bends_each_frequency_by_itself(zero_at: float, pole_at: float, zero: float, pole: float) -> None:
    T = 1e-4
    wz, wp = bent(zero_at / T, T), bent(pole_at / T, T)
    b, a = bilinear([1 / wz**2, 2 * zero / wz, 1.0], [1 / wp**2, 2 * pole / wp, 1.0], fs=1 / T)
    block = SecondOrder(frequency_zero=zero_at / T, damping_zero=zero, frequency_pole=pole_at / T, damping_pole=pole)
    found = coefficients(block, T)
    np.testing.assert_allclose(found[0], b, rtol=1e-9, atol=1e-12 * float(np.max(np.abs(b))))
    np.testing.assert_allclose(found[1], a, atol=1e-12)


@settings(max_examples=50, deadline=None)
@given(share=shares, damping=ratios)
def test_low_passes_are_scipys_bilinear(share: float, damping: float) -> None:
    T = 2.5e-4
    w = bent(share / T, T)
    b, a = bilinear([w * w], [1.0, 2 * damping * w, w * w], fs=1 / T)
    found = coefficients(LowPass2(frequency=share / T, damping=damping), T)
    np.testing.assert_allclose(found[0], b, atol=1e-12)
    np.testing.assert_allclose(found[1], a, atol=1e-12)
    b, a = bilinear([w], [1.0, w], fs=1 / T)
    impulse = np.r_[1.0, np.zeros(30)]
    np.testing.assert_allclose(run(LowPass(frequency=share / T), T, impulse), lfilter(b, a, impulse), atol=1e-13)


def gain(block: Filter, frequency: float, T: float) -> complex:
    """H(e^jωT) from the impulse response, cut where it has died out."""
    h = run(block, T, np.r_[1.0, np.zeros(3000)])
    return complex(h @ np.exp(-2j * np.pi * frequency * T * np.arange(len(h))))


def test_at_its_own_frequency_a_filter_is_as_deep_as_the_analog_one() -> None:
    T = 1e-4
    assert gain(Notch(frequency=1800.0, damping_zero=0.05, damping_pole=0.5), 1800.0, T) == pytest.approx(
        0.1, abs=1e-10
    )
    assert gain(LowPass(frequency=1800.0), 1800.0, T) == pytest.approx(1 / (1 + 1j), abs=1e-10)
    assert gain(LowPass2(frequency=1800.0, damping=0.7), 1800.0, T) == pytest.approx(1 / 1.4j, abs=1e-10)
    # undamped zeros block their own frequency entirely, although the poles are bent differently
    block = SecondOrder(frequency_zero=900.0, damping_zero=0.0, frequency_pole=300.0, damping_pole=0.7)
    assert abs(gain(block, 900.0, T)) < 1e-10
    block = SecondOrder(frequency_zero=900.0, damping_zero=0.2, frequency_pole=900.0, damping_pole=0.8)
    assert gain(block, 900.0, T) == pytest.approx(0.25, abs=1e-10)


@pytest.mark.parametrize(
    "block",
    [
        Notch(frequency=460.0),
        LowPass(frequency=300.0),
        LowPass2(frequency=1000.0),
        SecondOrder(frequency_zero=800.0, frequency_pole=300.0),
    ],
    ids=lambda block: block.kind,
)
def test_a_filter_starts_without_a_transient_and_keeps_a_constant(block: Filter) -> None:
    np.testing.assert_allclose(run(block, 1e-4, np.full(50, 123.4), start=123.4), 123.4, rtol=1e-12)


@pytest.mark.parametrize(
    "block",
    [
        Notch(frequency=5000.0),
        LowPass(frequency=5000.0),
        LowPass2(frequency=6000.0),
        SecondOrder(frequency_zero=5000.0, frequency_pole=300.0),
        SecondOrder(frequency_zero=300.0, frequency_pole=5000.0),
    ],
    ids=lambda block: block.kind,
)
def test_a_filter_above_half_the_sample_rate_is_refused(block: Filter) -> None:
    control = Control(law=CascadePPI(Kv=50.0, Kp=1e4), filters=(block,))
    with pytest.raises(
        ParameterError, match=rf"{block.kind}\.frequency.* Hz must be below half the sample rate, 5000 Hz"
    ):
        Loop(control=control, axis=Axis(plant=Rigid(mass=40.0)), sample_time=1e-4)
