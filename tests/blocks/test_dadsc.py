"""DADSC: the paper's equations by hand, anti-windup, start, and rates that are too fast."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from feeddrive.blocks.controller.dadsc import DADSC
from feeddrive.blocks.controller.polynomial_stability import is_stable
from feeddrive.blocks.feedforward.inertia import Inertia
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.signals import Reading, Setpoint
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError, StructureError
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.linearize import linearize
from feeddrive.loop.loop import Loop
from feeddrive.papers.altintas2009.testbed import dadsc as triple
from feeddrive.papers.altintas2009.testbed import run_ideal
from fresh_draws import Seeded

T = 1e-4


def law(**changes: float) -> DADSC:
    made = DADSC(mass=40.0, viscous=60.0, tracking_rate=200.0, reaching_rate=300.0, adaptation_rate=500.0)
    return replace(made, **changes)


def loop(control: DADSC, sample_time: float = T) -> Loop:
    return Loop(control=Control(law=control), axis=Axis(plant=Rigid(mass=40.0, viscous=60.0)), sample_time=sample_time)


def test_the_gains_follow_from_three_frequencies() -> None:
    g1, g2 = triple(300.0).prepare(T)
    assert g1 == pytest.approx(12360.0, rel=1e-14)
    assert g2 == pytest.approx(12000.0, rel=1e-14)
    assert law(adaptation_ratio=0.5).prepare(T).g2 == pytest.approx(10_000.0, rel=1e-14)


def test_the_law_is_the_recursion_of_the_paper(seeded: Seeded) -> None:
    """(3) to (5) line by line, with in-step back-calculation: what the next sample makes of `applied` is the same."""
    rng = np.random.default_rng(seeded(3))
    control, limit = law(), 300.0
    g1, g2 = control.prepare(T)
    readings = np.cumsum(rng.normal(0.0, 2e-6, 400))
    state = control.start(control.prepare(T), Setpoint(0.0), Reading(0.0, 0.0))
    before = s_before = estimate = applied = requested = 0.0
    for k, x in enumerate(readings):
        t = k * T
        setpoint = Setpoint(0.3 * t * t, 0.6 * t, 0.6)
        state, found = control.step(
            control.prepare(T), state, setpoint, Reading(float(x), float(x), applied, requested), T
        )
        v = (x - before) / T
        v_r = (0.3 * t * t - 0.3 * (t - T) ** 2) / T
        s = 200.0 * (setpoint.position - x) + v_r - v
        estimate = estimate - g1 * s + g2 * s_before
        force = 40.0 * 0.6 + 40.0 * 300.0 * s - estimate + 60.0 * v + 40.0 * 200.0 * (v_r - v)
        assert found == pytest.approx(force, rel=1e-9, abs=1e-8)  # N: rounding of differences over T
        before, s_before = x, s
        applied, requested = float(np.clip(force, -limit, limit)), float(force)
        estimate += force - applied


def test_start_continues_with_the_force_that_acts() -> None:
    control = law()
    reading = Reading(0.3, 0.3, applied=120.0, requested=120.0)
    state = control.start(control.prepare(T), Setpoint(0.3), reading)
    _, force = control.step(control.prepare(T), state, Setpoint(0.3), reading, T)
    assert force == pytest.approx(120.0, abs=1e-12)


def test_two_encoders_give_position_at_the_load_and_velocity_at_the_motor() -> None:
    control = law()
    state = control.start(control.prepare(T), Setpoint(0.0), Reading(0.0, 0.0))
    _, motor = control.step(control.prepare(T), state, Setpoint(0.0), Reading(1e-6, 0.0), T)
    _, load = control.step(control.prepare(T), state, Setpoint(0.0), Reading(0.0, 1e-6), T)
    g1 = control.prepare(T).g1
    slope = 40.0 * 300.0 + g1 + 40.0 * 200.0 - 60.0  # N s/m of the velocity
    assert motor == pytest.approx(-slope * 1e-6 / T, rel=1e-12)
    assert load == pytest.approx(-(40.0 * 300.0 + g1) * 200.0 * 1e-6, rel=1e-12)


@pytest.mark.parametrize("mass", [2.0, 40.0, 900.0])
@pytest.mark.parametrize("sample_time", [5e-5, 1e-3])
def test_the_poles_of_the_ideal_loop_are_the_design_frequencies(mass: float, sample_time: float) -> None:
    """Any mass and sample time: an error on s = 0 falls by 1/(1 + λT) each sample, in the ideal loop."""
    control = law(mass=mass)
    still = np.zeros(40)
    way = np.concatenate([[0.0], np.full(39, 1e-3)])  # the reference jumps: the law follows it in one sample
    run = run_ideal(control, mass, 60.0, sample_time, still, setpoint=way)
    assert np.max(np.abs(run.position_error)) < 1e-15
    push = np.zeros(4000)
    push[0] = 1.0
    error = run_ideal(control, mass, 60.0, sample_time, push).position_error
    factors = [1.0 / (1.0 + rate * sample_time) for rate in (200.0, 300.0, 500.0)]
    ratio = np.poly(factors)
    # the three poles annihilate the tail of the response
    left = np.convolve(error, ratio)[4 : error.size]
    assert np.max(np.abs(left)) < 1e-9 * np.max(np.abs(error))


def test_the_edge_of_what_is_refused_is_the_edge_of_stability() -> None:
    """The bound is an independent polynomial; the poles of the linearised loop agree with it from below."""
    with pytest.raises(ParameterError, match="must be below 41") as refused:
        loop(triple(4300.0))
    bound = float(str(refused.value).split("must be below ")[1].split(")")[0])
    assert bound * T == pytest.approx(0.418, rel=2e-3)
    within = linearize(loop(triple(0.9995 * bound)), ["load_force"], ["position_load"])
    assert 0.998 < np.max(np.abs(within.poles())) < 1.0
    assert "too fast for the sample time" in str(refused.value)


@pytest.mark.parametrize("ratios", [(1.0, 1.0, 1.0), (0.2, 1.0, 3.0), (3.0, 0.1, 1.0), (1.0, 5.0, 0.3)])
def test_rates_inside_the_bound_are_stable_and_beyond_it_refused(ratios: tuple[float, float, float]) -> None:
    rates = dict(zip(DADSC.tunables, (100.0 * r for r in ratios), strict=True))
    for factor in np.geomspace(1.0, 300.0, 25):
        made = law(**{name: factor * rate for name, rate in rates.items()}, viscous=0.0)
        try:
            tree.check_sampled(made, T)
        except ParameterError:
            break
        closed = Loop(control=Control(law=made), axis=Axis(plant=Rigid(mass=40.0)), sample_time=T)
        assert np.max(np.abs(linearize(closed, ["load_force"], ["position_load"]).poles())) < 1.0
    else:
        pytest.fail("no rates were refused")


def test_a_coupling_that_makes_the_estimate_drift_is_refused_with_the_bound() -> None:
    with pytest.raises(ParameterError, match=r"adaptation_ratio = 1\.2 must be at most 1\.0[0-9]+ at these rates"):
        loop(law(adaptation_ratio=1.2))
    loop(law(adaptation_ratio=0.9))


def test_acceleration_is_not_fed_forward_twice() -> None:
    with pytest.raises(StructureError, match="acceleration forward, which dadsc does already"):
        Control(law=law(), feedforward=(Inertia(mass=40.0),))


@pytest.mark.parametrize("degree", [1, 2, 3, 4, 6])
def test_roots_in_the_left_half_plane_are_found_without_roots(degree: int, seeded: Seeded) -> None:
    rng = np.random.default_rng(seeded(degree))
    found = set()
    for _ in range(400):
        roots = rng.normal(-0.8, 1.0, size=degree // 2) + 1j * rng.normal(size=degree // 2)
        roots = np.concatenate([roots, roots.conj(), rng.normal(-0.8, 1.0, size=degree % 2)])
        if np.min(np.abs(roots.real)) > 1e-6:
            found.add(stable := bool(np.max(roots.real) < 0.0))
            assert is_stable(list(np.poly(roots).real[::-1])) == stable
    assert found == {True, False}


@pytest.mark.parametrize("rate", [1e-9, 1e-3, 1.0])
def test_slow_rates_are_not_too_fast(rate: float) -> None:
    """Their poles lie closer to 1 than a number resolves."""
    tree.check_sampled(triple(rate), T)
    tree.check_sampled(law(tracking_rate=rate), T)


def test_a_missing_coupling_is_refused_with_the_bound() -> None:
    """Without g2 the estimate integrates at g1/T; slow reaching cannot damp that, however slow all rates are made."""
    rates = {"tracking_rate": 10.0, "reaching_rate": 10.0}
    with pytest.raises(
        ParameterError, match=r"adaptation_ratio = 0 must be at least 0\.[0-9]+ at these rates"
    ) as refused:
        tree.check_sampled(law(adaptation_ratio=0.0, **rates), T)
    least = float(str(refused.value).split("at least ")[1].split()[0])
    for ratio, stable in ((least + 1e-4, True), (least - 1e-4, False)):
        made = law(adaptation_ratio=max(least, ratio), viscous=0.0, **rates)
        closed = Loop(control=Control(law=made), axis=Axis(plant=Rigid(mass=40.0)), sample_time=T)
        assert np.max(np.abs(linearize(closed, ["load_force"], ["position_load"]).poles())) < 1.0
        if not stable:
            with pytest.raises(ParameterError, match="at least"):
                tree.check_sampled(law(adaptation_ratio=ratio, **rates), T)
