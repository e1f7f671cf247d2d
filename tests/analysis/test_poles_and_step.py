"""Poles, zeros and step response of a sampled loop against closed forms, and the pictures of them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

import feeddrive as fd
from feeddrive.analysis.step_response import settling_time, step_response
from feeddrive.language.errors import UnstableError
from feeddrive.language.quantity import Units
from feeddrive.loop.linearize import StateSpace, continuous, linearize, natural, zeros
from feeddrive.plot.chart import ALERT, CROSS, RING, Chart, Curve
from feeddrive.plot.complex_plane import damping_chart, plane_chart
from feeddrive.plot.over_time import step_response_chart

T, MASS, KV, KP, TN = 1e-3, 100.0, 20.0, 5000.0, 0.04


def cascade() -> StateSpace:
    """A P-PI on a free mass, from the set position to the table."""
    law = fd.blocks.CascadePPI(Kv=KV, Kp=KP, Tn=TN, velocity_feedforward=0.0)
    loop = fd.Loop(control=fd.Control(law=law), axis=fd.Axis(plant=fd.blocks.Rigid(mass=MASS)), sample_time=T)
    return linearize(loop, ["set_position"], ["position_load"])


def second_order(frequency: float, damping: float, step: float = 1e-5) -> StateSpace:
    """ω²/(s² + 2ζω s + ω²) held and sampled: exact at the samples."""
    w = 2.0 * np.pi * frequency
    whole = expm(step * np.array([[0.0, 1.0, 0.0], [-w * w, -2.0 * damping * w, w * w], [0.0, 0.0, 0.0]]))
    names = ("position", "velocity")
    return StateSpace(
        whole[:2, :2],
        whole[:2, 2:],
        np.array([[1.0, 0.0]]),
        np.zeros((1, 1)),
        step,
        names,
        ("set_position",),
        ("position_load",),
    )


def test_the_poles_of_a_cascade_on_a_free_mass_are_the_roots_of_its_characteristic_polynomial() -> None:
    """G = T²/2m (z+1)/(z-1)², C = Kp (1 + T/Tn z/(z-1)) (Kv + (z-1)/zT): poles of 1 + C G, zeros of Kv Kp(..) G."""
    integral = np.array([1.0 + T / TN, -1.0])
    both = KP * T**2 / (2.0 * MASS) * np.polymul(np.polymul([1.0, 1.0], integral), [KV + 1.0 / T, -1.0 / T])
    expected = np.roots(np.polyadd(np.polymul(np.poly([1.0, 1.0, 1.0]), [1.0, 0.0]), both))
    model = cascade()
    poles, found = model.poles(), model.zeros()
    poles, found = poles[np.abs(poles) > 1e-6], found[np.abs(found) > 1e-6]  # at 0: what a reading waits for a sample
    np.testing.assert_allclose(np.sort_complex(poles), np.sort_complex(expected), atol=1e-9)
    np.testing.assert_allclose(np.sort_complex(found), [-1.0, TN / (TN + T)], atol=1e-7)


def test_zeros_are_where_the_response_is_zero_and_do_not_depend_on_units() -> None:
    model = second_order(20.0, 0.4, 1e-3)
    b, c = model.B[:, 0], model.C[0] + np.array([0.3, 0.02])
    for scale in (1.0, 1e-9, 1e9):
        for z in zeros(model.A, scale * b, c / 3.0, 0.5 * scale):
            there = c / 3.0 @ np.linalg.solve(z * np.eye(2) - model.A, b) + 0.5
            assert abs(there) < 1e-9


@pytest.mark.parametrize("damping", [0.05, 0.3, 0.7])
def test_natural_frequency_and_damping_of_a_sampled_oscillator_are_those_it_was_made_of(damping: float) -> None:
    frequency, ratio = natural(second_order(35.0, damping, 2e-3).poles(), 2e-3)
    np.testing.assert_allclose(frequency, 35.0, rtol=1e-9)
    np.testing.assert_allclose(ratio, damping, rtol=1e-9)
    assert np.real(continuous(np.array([0.0]), T))[0] == -np.inf


@pytest.mark.parametrize("damping", [0.15, 0.4, 0.6])
def test_overshoot_and_settling_are_those_of_the_second_order(damping: float) -> None:
    """Overshoot e^(-πζ/√(1-ζ²)) at π/ω√(1-ζ²); settled at the last time at which the exact response leaves 2 %."""
    found = step_response(second_order(30.0, damping))
    w, root = 2.0 * np.pi * 30.0, np.sqrt(1.0 - damping**2)
    assert found.overshoot == pytest.approx(np.exp(-np.pi * damping / root), rel=1e-5)  # the top is flat
    assert found.overshoot_time == pytest.approx(np.pi / (w * root), abs=1e-5)  # a sample
    t = np.linspace(0.0, 1.0, 2_000_001)
    error = np.exp(-damping * w * t) * (np.cos(w * root * t) + damping / root * np.sin(w * root * t))
    last = t[np.flatnonzero(np.abs(error) > 0.02)[-1]]
    assert found.settling_time == pytest.approx(last, abs=1.1e-5)
    assert found.final == pytest.approx(1.0, abs=1e-9)
    rise = np.interp([0.1, 0.9], 1.0 - error[: int(np.argmax(1.0 - error))], t[: int(np.argmax(1.0 - error))])
    assert found.rise_time == pytest.approx(rise[1] - rise[0], abs=2e-5)


def test_a_slow_rest_that_is_small_is_waited_for() -> None:
    """1 - 0.975 e^(-t/0.001) - 0.025 e^(-t/0.5): settled to 2 % at 0.5 ln(0.025/0.02) s."""
    step, times = 1e-4, np.array([1e-3, 0.5])
    decay = np.exp(-step / times)
    shares = np.array([0.975, 0.025])
    model = StateSpace(
        np.diag(decay),
        (1.0 - decay)[:, None],
        shares[None],
        np.zeros((1, 1)),
        step,
        ("fast", "slow"),
        ("set_position",),
        ("position_load",),
    )
    found = step_response(model)
    assert found.settling_time == pytest.approx(0.5 * np.log(0.025 / 0.02), abs=2.1e-4)
    assert found.overshoot == 0.0


def test_a_loop_that_grows_has_no_step_response_and_what_never_settles_says_so() -> None:
    with pytest.raises(UnstableError, match="not stable"):
        step_response(second_order(30.0, -0.1))
    time = np.arange(5.0)
    assert settling_time(time, np.array([3.0, 0.1, 2.0, 0.1, 0.1]), 1.0) == 3.0
    assert settling_time(time, np.array([0.0, 0.0, 0.0, 0.0, 2.0]), 1.0) == np.inf
    assert settling_time(time, np.zeros(5), 1.0) == 0.0


def of_look(chart: Chart, look: str) -> list[Curve]:
    return [each for each in chart.panels[0].curves if each.look == look]


def test_a_pole_map_shows_s_in_the_unit_that_is_asked_for_and_what_grows_as_a_warning() -> None:
    light, grows = second_order(35.0, 0.2, 1e-3), second_order(50.0, -0.05, 1e-3)
    chart = plane_chart({"today": light, "now": grows})
    crosses = {each.name: each for each in of_look(chart, CROSS)}
    assert (crosses["today"].x[0], crosses["today"].y[0]) == pytest.approx((-7.0, 35.0 * np.sqrt(1.0 - 0.04)))
    assert crosses["today"].caption == "least damping 0.2 at 35 Hz"
    assert crosses["now grows"].number == ALERT
    assert crosses["now grows"].x[0] == pytest.approx(2.5)
    assert len(of_look(chart, RING)) == 2
    units = Units(typographic=True, frequency="rad/s")
    radian = plane_chart({"today": light}, units).shown(units)
    assert np.abs(of_look(radian, CROSS)[0].x[0]) == pytest.approx(2.0 * np.pi * 7.0)
    assert radian.label == "real part of s (rad/s)"
    flat = damping_chart({"today": light})
    assert (flat.panels[0].curves[0].x[0], flat.panels[0].curves[0].y[0]) == pytest.approx((35.0, 0.2))


def test_a_picture_of_a_step_says_overshoot_and_settling() -> None:
    found = step_response(second_order(30.0, 0.4))
    (curve,) = step_response_chart({"now": found}).panels[0].curves
    settled = f"{1e3 * found.settling_time:.4g}"
    assert curve.caption == f"overshoot {100.0 * found.overshoot:.1f} %, settled to 2 % in {settled} ms"


def first_order(samples: float) -> StateSpace:
    """A lag of a time constant in samples, of 1 ms."""
    a = float(np.exp(-1.0 / samples))
    one = np.ones((1, 1))
    return StateSpace(a * one, (1.0 - a) * one, one, 0.0 * one, T, ("x",), ("set_position",), ("position_load",))


def test_settled_means_within_two_percent() -> None:
    """e^(-t/τ) = 0.02 at t = τ ln 50."""
    assert step_response(first_order(100.0)).settling_time == pytest.approx(0.1 * np.log(50.0), abs=T)


@pytest.mark.parametrize(("samples", "length"), [(107.8, 2048), (115.6, 4096)])
def test_a_response_ends_when_its_second_half_is_at_rest_to_a_ten_thousandth(samples: float, length: int) -> None:
    """e^(-1024/τ) = 1e-4 at τ = 111.2 samples: with a slower lag 1024 samples are too few for the first half."""
    assert step_response(first_order(samples)).position.size == length


def test_a_response_is_at_most_a_million_samples_long() -> None:
    with pytest.raises(UnstableError, match="within a million samples"):
        step_response(first_order(3e5))
