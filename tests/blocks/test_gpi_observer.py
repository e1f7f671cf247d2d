"""The GPI observer and active disturbance rejection: golden numbers, an independent sampling, limits, loops."""

from __future__ import annotations

import dataclasses
import re
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from feeddrive.analysis.replay import observe
from feeddrive.analysis.stability import stability
from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.compensation.disturbance_rejection import DisturbanceRejection
from feeddrive.blocks.controller.active_disturbance_rejection import ActiveDisturbanceRejection
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.force.gravity import Gravity
from feeddrive.blocks.load.step_force import StepForce
from feeddrive.blocks.observer.disturbance_recovery import DisturbanceRecovery
from feeddrive.blocks.observer.gpi_observer import GpiObserver
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.reference.linear_move import LinearMove
from feeddrive.blocks.signals import Reading
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError, StructureError
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.linearize import linearize
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import simulate
from slow_share import all_but

PAPER = GpiObserver(mass=1.0, omega_o=700.0, zeta_o=0.7071)


def sampled(observer: GpiObserver, T: float) -> dict[str, np.ndarray]:
    """F, Gu, Gy0, Gy1 of the scaled observer from its differential equation, by a matrix exponential of its own."""
    order, w = 2 + observer.taylor_states, observer.omega_o
    roots: list[complex] = []
    pair = complex(-observer.zeta_o, np.sqrt(complex(1.0 - observer.zeta_o**2)).real)
    if observer.zeta_o <= 1.0:
        roots = [pair, pair.conjugate()] * (order // 2)
    if order % 2:
        roots.append(-(1.0 if observer.p0 is None else observer.p0 / w))
    polynomial = np.poly(roots).real
    A = w * (np.diag(np.ones(order - 1), 1) - np.outer(polynomial[1:], np.eye(order)[0]))
    whole = np.zeros((order + 3, order + 3))  # states, u, y and its slope
    whole[:order, :order] = A
    whole[1, order] = 1.0 / w
    whole[:order, order + 1] = w * polynomial[1:]
    whole[order + 1, order + 2] = 1.0
    made = expm(whole * T)
    constant, ramp = made[:order, order + 1], made[:order, order + 2] / T
    first = observer.hold == "first_order"
    return {
        "F": made[:order, :order],
        "Gu": made[:order, order],
        "Gy0": constant - ramp if first else constant,
        "Gy1": ramp if first else np.zeros(order),
    }


def prepared(observer: GpiObserver, T: float) -> dict[str, np.ndarray]:
    """The same from the block: z_0 there is the distance from y, and a reading that stands moves nothing."""
    made = observer.prepare(T)
    F, Gu, Gy = (np.array(each, dtype=float) for each in made)
    first = np.eye(len(F))[0]
    return {"F": F, "Gu": Gu * observer.mass, "Gy0": -F[:, 0] - Gy, "Gy1": Gy + first}


def test_the_sampled_form_has_the_printed_digits() -> None:
    made = prepared(PAPER, 1e-4)
    printed = {
        "F": "0.6664821314 0.05794469090 2.164193531e-3 5.211723395e-5 9.292755985e-7 1.317209555e-8 1.550357223e-10",
        "Gu": "4.416721e-9 1.414096e-7 -2.199453e-9 -2.185826e-9 -1.418463e-9 -5.595083e-10 -1.063617e-10",
        "Gy0": "0.161299167 0.387550202 0.578380558 0.568028322 0.365394681 0.143114770 0.027027640",
        "Gy1": "0.172218701 0.424814743 0.643332146 0.637960599 0.413335133 0.162830261 0.030917050",
    }
    for name, text in printed.items():
        row = made[name][0] if name == "F" else made[name]
        for got, digits in zip(row, text.split(), strict=True):
            decimals = len(digits.split("e")[0].split(".")[1])
            unit = 10.0 ** (-decimals + int(digits.split("e")[1] if "e" in digits else 0))
            assert abs(got - float(digits)) <= 0.51 * unit, (name, got, digits)


def test_the_gains_have_the_printed_digits() -> None:
    expected = [3669.82, 6.488818e6, 6.967507e9, 4.877255e12, 2.225664e15, 6.167866e17, 8.23543e19]
    np.testing.assert_allclose(np.array(PAPER.gains()), expected, rtol=5e-7)


@pytest.mark.parametrize("taylor_states", range(8))
def test_the_normalised_polynomial_reads_the_same_backwards(taylor_states: int) -> None:
    made = GpiObserver(mass=1.0, omega_o=123.0, zeta_o=2**-0.5, taylor_states=taylor_states).polynomial()
    np.testing.assert_allclose(made, made[::-1], rtol=1e-14)
    if taylor_states == 5:
        printed = [1, 5.242641, 13.242641, 20.313709, 20.313709, 13.242641, 5.242641, 1]
        np.testing.assert_allclose(made, printed, rtol=0, atol=5.1e-7)


@settings(max_examples=60, deadline=None)
@given(
    taylor_states=st.integers(0, 7),
    turn=st.floats(1e-3, 0.6),
    T=st.floats(2e-5, 2e-3),
    zeta=st.floats(0.3, 1.0),
    mass=st.floats(1.0, 2000.0),
    p0=st.one_of(st.none(), st.floats(0.3, 3.0)),
    hold=st.sampled_from(["first_order", "zero_order"]),
)
def test_any_order_mass_and_sample_time_is_sampled_exactly(
    taylor_states: int, turn: float, T: float, zeta: float, mass: float, p0: float | None, hold: str
) -> None:
    """Against scipy's exponential with y as an input; both are exact to the rounding of entries of the size of one."""
    observer = GpiObserver(
        mass=mass,
        omega_o=turn / T,
        zeta_o=zeta,
        p0=None if p0 is None else p0 * turn / T,
        taylor_states=taylor_states,
        hold=hold,
    )
    got, expected = prepared(observer, T), sampled(observer, T)
    np.testing.assert_allclose(got["F"], expected["F"], rtol=0, atol=1e-11)
    if hold == "first_order":
        np.testing.assert_allclose(got["Gy1"], expected["Gy1"], rtol=0, atol=1e-11)
        np.testing.assert_allclose(got["Gy0"], expected["Gy0"], rtol=0, atol=1e-11)
    scale = T / observer.omega_o
    np.testing.assert_allclose(got["Gu"] / scale, expected["Gu"] / scale, rtol=0, atol=1e-11)


@pytest.mark.parametrize("hold", ["first_order", "zero_order"])
def test_the_kept_reading_is_the_one_of_the_last_sample(hold: str) -> None:
    """Step by step against the scaled equations with absolute positions, far from zero."""
    observer = GpiObserver(mass=7.0, omega_o=400.0, taylor_states=3, hold=hold)
    T, k = 2e-4, np.arange(300)
    y, force = 0.2 + 1e-3 * np.sin(0.05 * k), 50.0 * np.cos(0.03 * k)
    made = sampled(observer, T)
    z = np.zeros(5)
    z[0] = y[0]
    expected = [0.0]
    for i in range(1, k.size):
        z = made["F"] @ z + made["Gu"] * force[i - 1] / 7.0 + made["Gy0"] * y[i - 1] + made["Gy1"] * y[i]
        expected.append(7.0 * 400.0**2 * z[2])
    got = observe(observer, y, force, T)
    # the first reading of `observe` is a step too: nothing has moved yet
    np.testing.assert_allclose(got.disturbance, expected, rtol=0, atol=1e-6)  # N, of some 1e3 N


def test_scaled_coordinates_are_well_conditioned() -> None:
    c = np.array(PAPER.polynomial()[1:])
    scaled = np.diag(np.ones(6), 1) - np.outer(c, np.eye(7)[0])
    scale = np.diag(700.0 ** np.arange(7))
    assert np.linalg.cond(700.0 * scaled) == pytest.approx(1.2e3, rel=0.05)
    assert np.linalg.cond(scale @ (700.0 * scaled) @ np.linalg.inv(scale)) > 1e19


def test_single_precision_is_enough() -> None:
    """2 mm of motion: a float32 knows it to 1e-10 m, times the noise gain 1.1e6 /s² that is 1e-4 m/s²."""
    T, k = 1e-4, np.arange(4000)
    y = 2e-3 * np.sin(2.0 * np.pi * 5.0 * k * T)
    made = PAPER.prepare(T)
    single = type(made)(*(np.float32(np.array(each, dtype=float)) for each in made))
    worst = 0.0
    exact = state = None
    for position in y:
        wide, narrow = Reading(position, position), Reading(np.float32(position), np.float32(position), np.float32(0))
        if exact is None or state is None:
            exact, state = PAPER.start(made, wide), PAPER.start(single, narrow)
        exact, estimate = PAPER.step(made, exact, wide, T)
        state, rounded = PAPER.step(single, state, narrow, np.float32(T))
        assert state.z[3].dtype == np.float32
        worst = max(worst, abs(float(rounded.disturbance) - float(estimate.disturbance)))
    assert worst <= 0.01  # m/s², of 2.0 m/s²


@pytest.mark.parametrize("taylor_states", [1, 2, 5, 7])
def test_a_constant_disturbance_is_found_exactly(taylor_states: int) -> None:
    """q'' = 3 m/s² without a force; the straight line between samples cuts the parabola, by less than (ωT)²/100."""
    observer = GpiObserver(mass=20.0, omega_o=500.0, taylor_states=taylor_states)
    T = 1e-4
    t = np.arange(3000) * T
    found = observe(observer, 1.5 * t**2, np.zeros_like(t), T)
    assert found.disturbance[-1] == pytest.approx(60.0, rel=2.5e-5)
    assert found.velocity[-1] == pytest.approx(3.0 * t[-1], abs=3.0 * T)


def test_a_single_state_says_how_late_it_is() -> None:
    """A disturbance that rises by 100 N/s is seen `lag` late, up to half a sample."""
    observer = GpiObserver(mass=20.0, omega_o=500.0, taylor_states=1)
    T = 1e-4
    t = np.arange(5000) * T
    found = observe(observer, 5.0 * t**3 / 6.0, np.zeros_like(t), T)
    late = t[-1] - found.disturbance[-1] / 100.0
    assert found.lag == pytest.approx(2.0 * (2**-0.5 + 0.5) / 500.0, rel=1e-4)
    assert late == pytest.approx(found.lag, abs=0.6 * T)


def law(mass: float = 139.0, omega_c: float = 12.0, **observer: Any) -> ActiveDisturbanceRejection:
    seen = GpiObserver(**({"mass": mass, "omega_o": 700.0} | observer))
    return ActiveDisturbanceRejection(mass=mass, omega_c=omega_c, observer=seen)


def loop(law: Any, mass: float = 139.0, T: float = 1e-4, **axis: Any) -> Loop:
    return Loop(control=Control(law=law), axis=Axis(plant=Rigid(mass=mass), **axis), sample_time=T)


@pytest.mark.parametrize(("mass", "T", "taylor_states"), [(139.0, 1e-4, 5), (8.0, 2e-4, 3), (1500.0, 5e-5, 1)])
def test_law_and_observer_place_their_poles_apart(mass: float, T: float, taylor_states: int) -> None:
    """Two poles of s² + 2ζω s + ω² with omega_c, the others with omega_o; sampling moves them by the order of ωT."""
    made = law(mass, taylor_states=taylor_states)
    model = linearize(loop(made, mass, T), ["set_position", "load_force"], ["position_load", "force"], velocity=0.0)
    poles = np.log(model.poles().astype(complex)) / T
    slow = poles[np.abs(poles) < 100.0]
    assert len(slow) == 2
    np.testing.assert_allclose(np.poly(slow).real, [1.0, 2 * 0.7071 * 12.0, 144.0], rtol=0.01)
    assert model.is_stable()


@pytest.mark.parametrize(
    ("hold", "limit", "T"),
    [("first_order", 2.58e-3, 3e-3), ("first_order", 2.58e-3, 5e-3), ("zero_order", 0.17e-3, 3e-4)],
)
def test_an_observer_too_fast_for_the_sample_time_is_refused(hold: str, limit: float, T: float) -> None:
    made = law(hold=hold)
    tree.check_sampled(made, 0.98 * limit)
    with pytest.raises(ParameterError, match=r"over the limit 1") as refused:
        loop(made, T=T)
    text = str(refused.value)
    nearest = float(re.findall(r"sample every ([0-9.e-]+) s", text)[0])
    assert nearest == pytest.approx(limit, rel=0.005)
    tree.check_sampled(made, 0.999 * nearest)
    # each of the others that the message names is admitted, alone
    named = re.findall(r"take ([a-z_.0]+) <= ([0-9.e-]+)", text)
    assert "observer.omega_o" in dict(named)
    for name, value in named:
        tree.check_sampled(tree.vary(made, {name: 0.999 * float(value)}), T)


@pytest.mark.parametrize(("taylor_states", "hold"), [(3, "first_order"), (5, "first_order"), (7, "zero_order")])
def test_an_observer_alone_says_its_limit(taylor_states: int, hold: str) -> None:
    """As part of a compensation, where no law knows of it."""
    made = GpiObserver(mass=5.0, omega_o=3000.0, taylor_states=taylor_states, hold=hold)
    with pytest.raises(ParameterError, match=r"omega_o T = [0-9.]+ is [0-9.]+ over the limit") as refused:
        tree.check_sampled(made, 2e-3)
    rate = float(re.findall(r"omega_o <= ([0-9.]+)", str(refused.value))[0])
    tree.check_sampled(dataclasses.replace(made, omega_o=0.999 * rate), 2e-3)
    with pytest.raises(ParameterError):
        tree.check_sampled(dataclasses.replace(made, omega_o=1.001 * rate), 2e-3)


@pytest.mark.parametrize("late", all_but([1], [0, 1, 3], "the same search of a limit for other dead times"))
def test_what_is_admitted_is_stable_and_what_is_refused_is_not(late: int) -> None:
    """The check of the law against the poles of the loop, on either side of its limit."""

    def stable(T: float) -> bool:
        made = loop(law(delay_samples=late), T=1e-4, actuator=Actuator(dead_time=late * 1e-4))
        # another sample time by hand, past the check of the constructor
        moved = object.__new__(Loop)
        object.__setattr__(moved, "control", made.control)
        object.__setattr__(moved, "axis", dataclasses.replace(made.axis, actuator=Actuator(dead_time=late * T)))
        object.__setattr__(moved, "sample_time", T)
        return bool(np.max(np.abs(_poles(moved))) < 1.0)

    made = law(delay_samples=late)
    good, bad = 1e-4, 5e-3
    for _ in range(12):
        middle = 0.5 * (good + bad)
        try:
            tree.check_sampled(made, middle)
        except ParameterError:
            bad = middle
        else:
            good = middle
    assert stable(0.99 * good)
    assert not stable(1.01 * bad)


def _poles(loop: Loop) -> np.ndarray:
    """Of one sample of a law on a free mass with whole samples of dead time, built here from its equations."""
    made: Any = loop.control.law
    observer, T = made.observer, float(loop.sample_time)
    form, mass = sampled(observer, T), made.mass
    order, late = 2 + observer.taylor_states, round(float(loop.axis.actuator.dead_time) / T)
    w, wc = observer.omega_o, made.omega_c
    # x = (q, v, past forces / mass newest first, z)
    n = 2 + late + order
    gain = np.zeros(n)
    gain[0] = -(wc**2)
    gain[2 + late + 1], gain[2 + late + 2] = -2.0 * made.zeta_c * wc * w, -(w**2)
    acting = gain if late == 0 else np.eye(n)[2 + late - 1]
    A = np.zeros((n, n))
    A[0] = np.eye(n)[0] + T * np.eye(n)[1] + 0.5 * T * T * acting
    A[1] = np.eye(n)[1] + T * acting
    if late:
        A[2] = gain
        for i in range(1, late):
            A[2 + i, 2 + i - 1] = 1.0
    A[2 + late :, 2 + late :] = form["F"]
    A[2 + late :] += np.outer(form["Gu"], acting) + np.outer(form["Gy0"], np.eye(n)[0]) + np.outer(form["Gy1"], A[0])
    assert mass > 0.0
    return np.linalg.eigvals(A)


def test_a_tracking_frequency_beyond_the_observer_is_refused_with_the_largest() -> None:
    made = law(omega_c=300.0)
    with pytest.raises(ParameterError, match="take omega_c <= ") as refused:
        tree.check_sampled(made, 2.5e-3)
    largest = float(re.findall(r"omega_c <= ([0-9.]+)", str(refused.value))[0])
    tree.check_sampled(dataclasses.replace(made, omega_c=0.999 * largest), 2.5e-3)


@pytest.mark.parametrize("omega_c", [1e6, 1e12])
def test_a_tracking_frequency_that_is_absurd_gets_the_same_remedy(omega_c: float) -> None:
    def refusal(value: float) -> str:
        made = ActiveDisturbanceRejection(mass=40.0, omega_c=value, observer=GpiObserver(mass=40.0, omega_o=500.0))
        with pytest.raises(ParameterError) as refused:
            tree.check_sampled(made, 1e-4)
        return str(refused.value)

    near, far = (refusal(value).split("take omega_c <= ")[1].split()[0] for value in (2e4, omega_c))
    assert float(far) == pytest.approx(float(near), rel=1e-3)


@pytest.mark.parametrize("mass", [8.0, 139.0, 2000.0])
def test_the_true_mass_may_be_off_by_known_factors(mass: float) -> None:
    """True over believed gain between 0.74 and 2.01, that is a true mass of 0.497 to 1.35 times the believed one."""
    for share, stable in ((0.500, True), (0.490, False), (1.32, True), (1.37, False)):
        assert stability(loop(law(mass), share * mass)).stable is stable, share


def test_the_observer_sees_what_the_limit_left() -> None:
    """A force limit far below what a step of 1 mm wants: the estimate of a free axis stays at zero."""
    made = dataclasses.replace(loop(law()), control=Control(law=law(), force_limit=5.0))
    run = simulate(made, LinearMove(distance=1e-3, travel_time=1e-3, dwell_after=2.0), start=(0.0, 0.0))
    assert np.max(np.abs(run["requested"])) > 4.0 * 5.0
    seen = observe(law().observer, run["reading_load"], run["force"], 1e-4)
    assert np.max(np.abs(seen.disturbance)) <= 0.02 * 5.0


def test_a_hanging_axis_starts_without_a_sag_if_the_weight_is_known() -> None:
    weight = Gravity(force=-400.0)
    still = LinearMove(distance=0.0, travel_time=0.5)

    def sag(**observer: Any) -> float:
        return float(np.max(np.abs(simulate(loop(law(**observer), forces=(weight,)), still)["tracking_error"])))

    assert sag(start_disturbance=-400.0) <= 1e-9
    assert sag() >= 1e-6


def test_share_zero_leaves_the_disturbance_over_omega_squared() -> None:
    made = dataclasses.replace(law(), share=0.0)
    run = simulate(loop(made), LinearMove(distance=0.0, travel_time=3.0), load=StepForce(force=139.0))
    assert run["position_load"][-1] == pytest.approx(1.0 / 144.0, rel=1e-6)


@pytest.mark.parametrize("late", [0, 2])
def test_a_known_dead_time_does_not_disturb_the_estimate(late: int) -> None:
    """A moving free axis has no disturbance; with a dead time that the observer does not know of it sees one."""
    made = loop(law(delay_samples=late), actuator=Actuator(dead_time=late * 1e-4))
    run = simulate(made, LinearMove(distance=5e-3, travel_time=0.5), start=(0.0, 0.0))
    seen = observe(law(delay_samples=late).observer, run["reading_load"], run["force"], 1e-4)
    blind = observe(law().observer, run["reading_load"], run["force"], 1e-4)
    # under the held force the straight line between the readings is off by a u T²/8
    assert np.max(np.abs(seen.disturbance)) <= 1.0
    assert bool(np.max(np.abs(blind.disturbance)) > 5.0) is (late > 0)


@pytest.mark.parametrize("taylor_states", [1, 2, 3, 5])
def test_under_a_cascade_without_integral_it_takes_out_a_constant_force(taylor_states: int) -> None:
    observer = GpiObserver(mass=139.0, omega_o=200.0, taylor_states=taylor_states)
    cascade = CascadePPI(Kv=20.0, Kp=139.0 * 150.0)
    control = Control(law=cascade, compensation=(DisturbanceRejection(observer=observer),))
    made = Loop(control=control, axis=Axis(plant=Rigid(mass=139.0)), sample_time=1e-4)
    assert stability(made).stable
    run = simulate(made, LinearMove(distance=0.0, travel_time=2.0), load=StepForce(force=100.0))
    assert abs(run["position_load"][-1]) <= 1e-9
    assert np.max(np.abs(run["position_load"])) > 1e-6


def test_rejecting_twice_is_refused() -> None:
    twice = DisturbanceRejection(observer=PAPER)
    with pytest.raises(StructureError, match="twice"):
        Loop(control=Control(law=law(), compensation=(twice,)), axis=Axis(plant=Rigid(mass=139.0)), sample_time=1e-4)


def test_the_law_takes_another_observer() -> None:
    """A constant force, found by the inverse of the axis instead."""
    other = DisturbanceRecovery(mass=139.0, frequency=40.0)
    made = ActiveDisturbanceRejection(mass=139.0, omega_c=12.0, observer=other)
    assert stability(loop(made)).stable
    run = simulate(loop(made), LinearMove(distance=0.0, travel_time=2.0), load=StepForce(force=100.0))
    assert abs(run["position_load"][-1]) <= 1e-8
