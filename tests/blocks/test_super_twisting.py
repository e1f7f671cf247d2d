"""Super-twisting: golden forces, the inclusions that its forms solve, chatter, start, limit, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.blocks.controller.super_twisting import SuperTwisting
from feeddrive.blocks.load.step_force import StepForce
from feeddrive.blocks.reference.polynomial7 import Polynomial7
from feeddrive.blocks.signals import Reading, Setpoint
from field_axes import T, W, golden, judged, loop, overshoot, start_under_weight
from fresh_draws import Seeded

REST = Polynomial7(distance=0.0, travel_time=1.0)
GOLDEN = [
    ("explicit", 1e-6, [0, -760.0612766, -951.8239429, -1106.849305, -1220.656838, -1277.281935]),
    ("implicit", 1e-6, [0, -721.4579740, -834.1744715, -871.2391272, -681.2195790, -364.7600450]),
    ("zone", 1e-6, [0, -144.0365487, -145.5915789, -134.3777631, -111.3967981, -78.70150504]),
    ("zone", 1e-4, [0, -9326.367136, -9062.363413, -8237.465239, -6819.296575, -4595.570135]),
    ("implicit", 1e-4, [0, -9704.115749, -9446.007700, -8647.217331, -7292.711316, -5258.483439]),
]


def law(form: str = "zone", *, rate: float = 200.0, time: float = 1e-3, **more: Any) -> SuperTwisting:
    """On R; L = 5e4 m/s³ gives k1 = 335.41 and k2 = 55000."""
    given: dict[str, Any] = {"disturbance_rate": 5e4, "viscous": 60.0, **more}
    return SuperTwisting(mass=40.0, tracking_rate=rate, zone_time=time if form == "zone" else None, form=form, **given)


@pytest.mark.parametrize(("form", "amplitude", "forces"), GOLDEN)
def test_the_golden_forces(form: str, amplitude: float, forces: list[float]) -> None:
    """Ten digits are stated."""
    assert golden(law(form), amplitude) == pytest.approx(forces, rel=6e-10, abs=1e-12)


def test_the_forms_solve_their_inclusions(seeded: Seeded) -> None:
    """2.a: s in z + h k1 √|z| sgn z + h² k2 Sgn z with u = (s - z)/h + w, of the zone; of the implicit form with T for
    h and β = s - T w for s.
    """
    random = np.random.default_rng(seeded(1))
    for _ in range(2000):
        root, slope, L = random.uniform(0.1, 3.0), random.uniform(0.1, 3.0), 10.0 ** random.uniform(2.0, 6.0)
        s = random.normal() * 10.0 ** random.uniform(-5.0, 0.0)
        w = 0.1 * s
        for form, h in (("zone", T * random.uniform(2.0, 30.0)), ("implicit", T)):
            made = law(form, rate=1e-300, time=h, disturbance_rate=L, root_factor=root, sign_factor=slope, viscous=0.0)
            # the reading is 0 and was s T: e_v = s and e_x = 0
            after, force = made.step(made.prepare(T), made.State(s * T, w), Setpoint(0.0), Reading(0.0, 0.0), T)
            k1, k2 = root * np.sqrt(L), slope * L
            if form == "zone":
                target, sliding = s, (after.twist - w) * h * h / T
                root_of_z = (force / 40.0 - w - sliding / h) / k1
            else:
                target, sliding = s - T * w, (after.twist - w) * T
                root_of_z = (force / 40.0 - after.twist) / k1
            # what w took for Sgn: any value within ±h² k2 where z is 0, and an end of that elsewhere
            lost = 1e-13 * (abs(w) * h + abs(target) + h * h * k2)  # differences with w
            assert abs(sliding) <= h * h * k2 + lost * h / T
            if abs(target) > h * h * k2:
                assert sliding == pytest.approx(np.sign(target) * h * h * k2, abs=lost * h / T)
            residual = root_of_z * abs(root_of_z) + h * k1 * root_of_z + sliding - target
            assert abs(residual) < 1e-12  # m/s, as stated


def rest_after_a_push(form: str, late: int, resolution: float = 1e-8) -> tuple[float, float]:
    """RMS force in N and mean error in um of the last 0.1 s, half a second after a force step of 200 N."""
    run = fd.simulate(
        loop(law(form), late=late, resolution=resolution), REST, load=StepForce(force=200.0), duration=0.5
    )
    return float(np.std(run["force"][-1000:])), 1e6 * float(np.mean(run["tracking_error"][-1000:]))


@pytest.mark.parametrize(
    ("form", "late", "rms"),
    [("explicit", 0, 342.0), ("explicit", 1, 808.0), ("implicit", 1, 513.0), ("zone", 1, 0.8)],
)
def test_which_form_chatters(form: str, late: int, rms: float) -> None:
    """2.b, at counts of 10 nm."""
    assert rest_after_a_push(form, late)[0] == pytest.approx(rms, rel=0.2)


def test_the_implicit_form_is_silent_without_dead_time_and_keeps_an_error() -> None:
    """2.b and 2.c: T F_d/(m λ) = 2.5 um."""
    force, error = rest_after_a_push("implicit", 0, 0.0)
    assert force < 5e-4
    assert -error == pytest.approx(1e6 * T * 200.0 / (40.0 * 200.0), rel=1e-3)


@pytest.mark.parametrize("push", [200.0, 1500.0])
def test_the_nonlinearity_is_idle_in_a_well_tuned_loop(push: float) -> None:
    """2.d: peak and integral of the squared error with and without an end of the zone."""
    errors = [
        fd.simulate(loop(each, force_limit=1e5), REST, load=StepForce(force=push), duration=0.1)["tracking_error"]
        for each in (law(rate=1336.0, time=0.783e-3), law(rate=1336.0, time=0.783e-3, disturbance_rate=None))
    ]
    ended, endless = ((np.max(np.abs(each)), np.sum(each * each)) for each in errors)
    assert ended == pytest.approx(endless, rel=1e-4)


def test_a_narrow_zone_is_left_and_bounds_the_rate_of_the_force() -> None:
    """With k2 = 1100 m/s³ w moves by at most T k2 in a sample; the same push then costs more."""
    narrow = law(rate=1336.0, time=0.783e-3, disturbance_rate=1e3)
    errors = [
        np.max(np.abs(fd.simulate(loop(each), REST, load=StepForce(force=1500.0), duration=0.1)["tracking_error"]))
        for each in (narrow, replace(narrow, disturbance_rate=None))
    ]
    assert errors[0] > 1.05 * errors[1]


@pytest.mark.parametrize(("late", "least", "robust"), [(0, 1.66, 4.0), (1, 3.09, 7.5), (2, 4.60, 11.3)])
def test_the_least_stable_zone(late: int, least: float, robust: float) -> None:
    """h/T at λ = 200: unstable 1 % below the stated edge, stable 1 % above it; Ms = 2 at the stated h."""
    assert judged(law(time=1.01 * least * T), late=late)["growth"] < 1.0
    if late:
        assert judged(law(time=0.985 * least * T), late=late)["growth"] > 1.0
    else:
        with pytest.raises(fd.FeeddriveError, match="unstable without any dead time"):
            loop(law(time=0.985 * least * T))
    assert judged(law(time=robust * T), late=late)["Ms"] == pytest.approx(2.0, rel=0.02)


def test_the_rows_of_the_table_at_its_own_gains() -> None:
    """0.4: R with Ms 2 and N 1.50e9, W."""
    found = judged(law(rate=1336.0, time=0.783e-3))
    assert found["ISE"] == pytest.approx(2.54e-10, rel=5e-3)
    assert found["N"] == pytest.approx(1.50e9, rel=5e-3)
    assert found["Ms"] == pytest.approx(2.0, rel=5e-3)
    assert found["dm"] > 2.0
    screw = judged(SuperTwisting(mass=163.0, viscous=1520.0, tracking_rate=195.0, zone_time=3.06e-3), W)
    assert screw["ISE"] == pytest.approx(6.78e-9, rel=0.01)


def test_what_the_limit_cut_off_is_known() -> None:
    """0.5: a raw step of 5 mm with 400 N passes its goal by 2.0 mm; by 14.7 mm where the law trusts its own wish."""
    assert overshoot(law(), told=True) == pytest.approx(2.0, abs=0.05)
    assert overshoot(law(), told=False) == pytest.approx(14.7, abs=0.1)


def test_the_start_under_weight_makes_no_bump() -> None:
    force, shift = start_under_weight(law(), cold=False)
    assert force < 1e-11
    assert shift < 1e-12
    assert start_under_weight(law(), cold=True)[1] == pytest.approx(9.2, rel=0.01)


def test_a_change_of_mass_keeps_the_force() -> None:
    old = law()
    new = replace(old, mass=50.0)
    state = new.retune(
        old.start(old.prepare(T), Setpoint(0.0), Reading(0.0, 0.0, 120.0, 120.0)), old, old.prepare(T), new.prepare(T)
    )
    _, force = new.step(new.prepare(T), state, Setpoint(0.0), Reading(0.0, 0.0, 120.0, 120.0), T)
    assert force == pytest.approx(120.0, rel=1e-14)


def test_two_encoders_give_position_at_the_load_and_velocity_at_the_motor() -> None:
    made = law()
    state = made.start(made.prepare(T), Setpoint(0.0), Reading(0.0, 0.0))
    motor, load = (
        made.step(made.prepare(T), state, Setpoint(0.0), reading, T)[1]
        for reading in (Reading(1e-7, 0.0), Reading(0.0, 1e-7))
    )
    assert motor == pytest.approx(-(40.0 * (200.0 + 1e3) - 60.0) * 1e-7 / T, rel=1e-12)
    assert load == pytest.approx(-40.0 * 1e3 * 200.0 * 1e-7, rel=1e-12)


def test_the_explicit_form_has_no_margins_and_the_zone_those_of_its_PID() -> None:
    with pytest.raises(fd.FeeddriveError, match=r"slope|derivative|linear"):
        judged(law("explicit"))
    assert judged(law(disturbance_rate=1.0)) == judged(law(disturbance_rate=None))


@pytest.mark.parametrize(
    ("form", "given", "said"),
    [
        ("zone", {"zone_time": None}, "zone_time is missing"),
        ("implicit", {"zone_time": 1e-3}, "leave it out"),
        ("explicit", {"disturbance_rate": None}, "disturbance_rate is missing"),
    ],
)
def test_each_form_has_its_parameters(form: str, given: dict[str, Any], said: str) -> None:
    with pytest.raises(fd.FeeddriveError, match=said):
        replace(law(form), **given)


def test_too_fast_is_refused_with_the_nearest_that_is_not() -> None:
    with pytest.raises(fd.FeeddriveError, match="must be above") as refused:
        loop(law(time=1.2 * T))
    nearest = float(str(refused.value).split("must be above ")[1].split(")")[0])
    share = 1.2 * T / nearest
    assert loop(law(rate=200.0 * share * 0.999, time=nearest * 1.001))
    with pytest.raises(fd.FeeddriveError):
        loop(law(rate=200.0 * share * 1.002, time=nearest * 0.998))
    with pytest.raises(fd.FeeddriveError, match="tracking_rate = 30000 1/s"):
        loop(law("implicit", rate=3e4))


def test_its_zone_is_certified_and_the_other_forms_are_not() -> None:
    """The implicit form chatters on a sample of dead time: its zone is unstable there."""
    assert fd.certificate.certify_loop(loop(law())).reserve
    for form in ("implicit", "explicit"):
        with pytest.raises(fd.FeeddriveError):
            fd.certificate.certify_loop(loop(law(form)))
