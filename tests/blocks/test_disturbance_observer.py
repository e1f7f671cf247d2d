"""The disturbance observer under P-P and P-PI: golden forces, identities, and how wrong its mass may be."""

from __future__ import annotations

import math

import numpy as np
import pytest

from feeddrive.analysis.replay import observe
from feeddrive.blocks.compensation.disturbance_rejection import DisturbanceRejection
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.controller.dadsc import DADSC
from feeddrive.blocks.observer.disturbance_recovery import DisturbanceRecovery
from feeddrive.blocks.plant.rigid import Rigid
from field_laws import (
    T,
    golden_forces,
    judged,
    loop,
    loop_gain,
    stable_masses,
    start_under_load,
    step_into_the_limit,
    stiffness_at,
)


def observer(form: str, g: float, viscous: float = 60.0, late: int = 1) -> DisturbanceRejection:
    """The observer of the 40 kg axis with g in 1/s."""
    inverse = DisturbanceRecovery(
        mass=40.0, viscous=viscous, form=form, frequency=g / (2.0 * math.pi), delay_samples=late
    )
    return DisturbanceRejection(observer=inverse)


def test_the_golden_forces() -> None:
    one = golden_forces(CascadePPI(Kv=200.0, Kp=24000.0), observer("one_pole", 600.0, 0.0, 0))
    expected = [0.0, -141.1823749, -134.2024193, -115.3171682, -86.21358468, -49.49140526]
    assert one == pytest.approx(expected, rel=6e-10)  # ten digits are published
    two = golden_forces(CascadePPI(Kv=200.0, Kp=24000.0, Tn=8e-3), observer("two_poles", 600.0))
    expected = [0.0, -77.25711267, -76.23957330, -68.26585545, -54.07522629, -34.95920672]
    assert two == pytest.approx(expected, rel=6e-10)
    plain = golden_forces(CascadePPI(Kv=400.0 / 3.0, Kp=36000.0, Tn=7.5e-3))
    expected = [0.0, -109.2431817, -102.3596342, -86.35151871, -62.64879254, -33.36874962]
    assert plain == pytest.approx(expected, rel=6e-10)


def test_a_P_loop_with_a_one_pole_observer_is_a_PI_loop() -> None:
    """K' = α Kp + (1 - α) m/T, Tn' = T K'/((1 - α) Kp), without viscous friction and without dead time told."""
    Kp, alpha = 24000.0, math.exp(-600.0 * T)
    gain = alpha * Kp + (1.0 - alpha) * 40.0 / T
    time = T * gain / ((1.0 - alpha) * Kp)
    assert gain == pytest.approx(45896.53537, rel=1e-9)
    assert time == pytest.approx(3.283833303e-3, rel=1e-9)
    axis, none = Rigid(mass=40.0), 1e-12  # 1/s: as good as no position loop, which a cascade must have
    observed = loop(CascadePPI(Kv=none, Kp=Kp), observer("one_pole", 600.0, 0.0, 0), on=axis)
    plain = loop(CascadePPI(Kv=none, Kp=gain, Tn=time), on=axis)
    lines = np.geomspace(1.0, 4999.0, 200)
    assert np.max(np.abs(loop_gain(observed, lines) / loop_gain(plain, lines) - 1.0)) < 1e-9


def test_with_the_position_loop_it_is_a_PID_that_a_cascade_may_not_reach() -> None:
    """k_d = K', k_p = Kp (1 - α)/T + α Kp Kv, k_i = Kv Kp (1 - α)/T: the zeros may be complex."""
    Kv, Kp, g = 200.0, 24000.0, 600.0
    alpha = math.exp(-g * T)
    k_d = alpha * Kp + (1.0 - alpha) * 40.0 / T
    k_p, k_i = Kp * (1.0 - alpha) / T + alpha * Kp * Kv, Kv * Kp * (1.0 - alpha) / T
    assert [k_d, k_p, k_i] == pytest.approx([4.589653537e4, 1.849698e7, 2.795302e9], rel=5e-7)
    axis = Rigid(mass=40.0)
    given = loop(CascadePPI(Kv=Kv, Kp=Kp), observer("one_pole", g, 0.0, 0), on=axis)
    lines = np.geomspace(1.0, 4999.0, 200)
    z = np.exp(2j * np.pi * lines * T)
    controller = k_d * (1.0 - 1.0 / z) / T + k_p + k_i * T / (1.0 - 1.0 / z)
    plant = T * T / (2.0 * 40.0) * (z + 1.0) / (z - 1.0) ** 2 / z
    ratio = loop_gain(given, lines) / (controller * plant)
    assert np.max(np.abs(ratio - 1.0)) < 1e-8


def test_DADSC_is_nearly_a_P_loop_with_this_observer() -> None:
    """Kv = λ K/(λ + K), Kp = m (λ + K), g = ω_d is an identity in continuous time."""
    rate = 300.0
    sliding = loop(DADSC(mass=40.0, viscous=60.0, tracking_rate=rate, reaching_rate=rate, adaptation_rate=rate))
    lines = np.geomspace(1.0, 2000.0, 300)
    cascade = loop(CascadePPI(Kv=0.5 * rate, Kp=80.0 * rate), observer("one_pole", rate, 60.0, 0))
    apart = loop_gain(cascade, lines) / loop_gain(sliding, lines) - 1.0
    assert 0.02 < np.max(np.abs(apart)) < 0.026  # its terms of the order of the rates times T
    assert [judged(sliding).peak, judged(cascade).peak] == pytest.approx([1.194, 1.190], abs=6e-4)


def test_what_an_integral_more_costs() -> None:
    """P-PI with the observer at the tuned points: ten times as stiff at 1 Hz, and softer at 100 Hz."""
    plain = stiffness_at(loop(CascadePPI(Kv=688.0, Kp=93825.0, Tn=1.456e-3)), [1.0, 100.0])
    given = loop(CascadePPI(Kv=52.5, Kp=95617.0, Tn=1.08e-3), observer("two_poles", 1322.0))
    more = stiffness_at(given, [1.0, 100.0])
    assert plain == pytest.approx([7059.0, 118.0], rel=2e-3)  # N/um; the knobs are published to three digits
    assert more == pytest.approx([73672.0, 113.0], rel=5e-3)
    assert more[0] > 8.0 * plain[0]
    assert more[1] < plain[1]


@pytest.mark.parametrize(
    ("g", "low", "high"), [(300.0, 0.107, 6.76), (600.0, 0.136, 6.84), (1200.0, 0.188, 8.13), (2400.0, 0.266, 10.95)]
)
def test_how_wrong_the_mass_may_be(g: float, low: float, high: float) -> None:
    """True mass over that of the observer: a fast observer bears less that its mass is too large."""
    found = stable_masses(loop(CascadePPI(Kv=200.0, Kp=24000.0), observer("one_pole", g)))
    assert found == pytest.approx((low, high), rel=0.03)


def test_the_noise_of_the_estimate() -> None:
    """N of the estimate per m of white noise: 3.39e8 of one pole, 1.41e7 of two at 600 1/s."""
    white = 1e-8 * np.random.default_rng(0).standard_normal(400_000)
    for form, expected in (("one_pole", 3.39e8), ("two_poles", 1.41e7)):
        inverse = observer(form, 600.0).observer
        found = np.std(observe(inverse, white, np.zeros(white.size), T).disturbance) / 1e-8
        assert found == pytest.approx(expected, rel=0.01)  # 400,000 samples: 0.4 %


def test_what_sums_knows_the_limit() -> None:
    """A jump of 5 mm with 400 N: mm of overshoot."""
    P, PI = CascadePPI(Kv=200.0, Kp=24000.0), CascadePPI(Kv=200.0, Kp=24000.0, Tn=8e-3)
    assert step_into_the_limit(CascadePPI(Kv=400.0 / 3.0, Kp=36000.0, Tn=7.5e-3)) < 1e-8
    assert step_into_the_limit(PI, observer("two_poles", 600.0)) < 0.05e-3
    assert step_into_the_limit(P, observer("one_pole", 600.0)) < 2.5e-3


@pytest.mark.parametrize("time", [None, 8e-3])
@pytest.mark.parametrize("form", ["one_pole", "two_poles", "butterworth"])
def test_a_start_under_400_N_of_gravity_is_felt_by_nobody(form: str, time: float | None) -> None:
    """Law and observer do not both take over the force: what the observer holds is not in the integral."""
    step, moved = start_under_load(CascadePPI(Kv=200.0, Kp=24000.0, Tn=time), observer(form, 600.0))
    assert abs(step) < 1e-11  # N
    assert moved < 1e-16  # m
