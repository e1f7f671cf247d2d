"""Pole placement: golden gains, an independent solution, exact arithmetic, state commands, refusals."""

from __future__ import annotations

import dataclasses
from fractions import Fraction

import numpy as np
import pytest
import scipy.signal
from hypothesis import given, settings
from hypothesis import strategies as st

import feeddrive as fd
from axis_runs import fed
from feeddrive.blocks.plant.two_bodies import place, polynomial, series, two_bodies
from feeddrive.blocks.signals import Reading, Setpoint
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError, StructureError

MODEL = fd.blocks.TwoMass(
    mass_motor=130.0, mass_load=33.0, stiffness=1.8e7, damping=700.0, viscous_motor=1500.0, viscous_load=20.0
)
MODE = float(two_bodies("", MODEL).mode) / (2.0 * np.pi)


def coupled(m12: float, **others: float) -> fd.blocks.TwoMass:
    return dataclasses.replace(MODEL, coupling_mass=m12, **others)


def law(**changes: object) -> fd.blocks.PolePlacement:
    return fd.blocks.PolePlacement(**{"model": MODEL, "bandwidth": 50.0, **changes})


# printed to nine digits by another program, half a unit of the last digit
@pytest.mark.parametrize(
    ("made", "expected", "digits"),
    [
        (law(), (3.019800162e7, -1.361725288e5, 9.352522695e4, 1.084048136e4, 4.804480708e9), 2e-9),
        (
            law(bandwidth=45.0, rigid_damping=0.6, axial_frequency=0.98 * MODE),
            (3.00909354e7, -1.82273311e6, 9.68999923e4, 1.00054656e4, 3.53848128e9),
            2e-8,
        ),
        (
            law(model=coupled(3.0), bandwidth=40.0, rigid_damping=0.9, axial_damping=0.5, axial_frequency=MODE),
            (8.66516e7, -5.48614e7, 1.89844e5, -3.9239e4, 2.58223e9),
            2e-5,
        ),
    ],
    ids=["default", "softer", "full mass matrix"],
)
def test_gains_are_the_golden_ones(made: fd.blocks.PolePlacement, expected: tuple[float, ...], digits: float) -> None:
    assert tuple(made.gains()) == pytest.approx(expected, rel=digits)


def test_desired_polynomial_and_poles_are_the_golden_ones() -> None:
    found = law().polynomial()
    golden = (7.581660814e2, 9.339288004e5, 4.493216760e8, 1.269174965e11, 2.015866031e13)
    assert found[-2::-1] == pytest.approx(golden, rel=1e-9)
    poles = np.sort_complex(np.roots(found[::-1]))
    expected = [-314.159, -141.372 - 280.553j, -141.372 + 280.553j, -80.6317 - 802.276j, -80.6317 + 802.276j]
    assert poles == pytest.approx(np.sort_complex(expected), rel=2e-6)


def test_open_loop_poles_are_the_golden_ones() -> None:
    made = MODEL.mechanics()
    M, C, K = (np.array(each) for each in (made.mass, made.damping, made.stiffness))
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.linalg.solve(M, K), -np.linalg.solve(M, C)]])
    poles = np.linalg.eigvals(A)
    slow, fast = np.sort(poles.real[np.abs(poles.imag) < 1.0]), poles[poles.imag > 1.0][0]
    assert slow == pytest.approx([-9.33, 0.0], abs=0.005)
    assert fast == pytest.approx(-14.71 + 826.85j, abs=0.005)


def test_filter_pack_has_the_golden_coefficients() -> None:
    notch = fd.blocks.Notch(frequency=460.0, damping_zero=0.06, damping_pole=0.6).prepare(5e-5)
    assert (notch.b0, notch.b1, notch.b2, notch.a2) == pytest.approx(
        (0.92841922, -1.821741947, 0.91251238, 0.8409316), abs=6e-9
    )
    low = fd.blocks.LowPass2(frequency=2500.0, damping=0.7).prepare(5e-5)
    expected = (0.097959253, 0.195918506, 0.097959253, -0.945978228, 0.33781524)
    assert (low.b0, low.b1, low.b2, low.a1, low.a2) == pytest.approx(expected, abs=6e-9)


def characteristic(model: fd.blocks.TwoMass, gains: tuple[float, ...]) -> list[Fraction]:
    """det(s M s + C s + K + feedback) · s over det M, in exact arithmetic, from the determinant itself."""
    made = model.mechanics()
    K1, K2, K3, K4, Ki = map(Fraction, gains)

    def entry(i: int, j: int) -> list[Fraction]:
        return [Fraction(each[i][j]) for each in (made.stiffness, made.damping, made.mass)]

    def times(a: list[Fraction], b: list[Fraction]) -> list[Fraction]:
        product = [Fraction(0)] * (len(a) + len(b) - 1)
        for i, x in enumerate(a):
            for j, y in enumerate(b):
                product[i + j] += x * y
        return product

    p11, p12, p21, p22 = entry(0, 0), entry(0, 1), entry(1, 0), entry(1, 1)
    # first row, multiplied by s: s P11 + s K1 + s² K3  and  s P12 + s K2 + s² K4 + Ki
    first = [Fraction(0), p11[0] + K1, p11[1] + K3, p11[2]]
    second = [Ki, p12[0] + K2, p12[1] + K4, p12[2]]
    total = [a - b for a, b in zip(times(first, p22), times(second, p21), strict=True)]
    return [each / total[-1] for each in total]


sizes = st.floats(np.log(0.2), np.log(5.0)).map(np.exp)


@st.composite
def designs(draw: st.DrawFn) -> fd.blocks.PolePlacement:
    scale = [draw(sizes) for _ in range(6)]
    model = fd.blocks.TwoMass(
        mass_motor=130.0 * scale[0],
        mass_load=33.0 * scale[1],
        stiffness=1.8e7 * scale[2],
        damping=700.0 * scale[3],
        viscous_motor=1500.0 * scale[4],
        viscous_load=20.0 * scale[5],
        coupling_mass=draw(st.one_of(st.none(), st.floats(-5.0, 5.0))),
    )
    return fd.blocks.PolePlacement(
        model=model,
        bandwidth=draw(st.floats(20.0, 150.0)),
        rigid_damping=draw(st.floats(0.2, 2.0)),
        axial_damping=draw(st.floats(0.02, 1.5)),
    )


@given(made=designs())
@settings(max_examples=60, deadline=None)
def test_the_closed_loop_has_the_desired_polynomial(made: fd.blocks.PolePlacement) -> None:
    """Exact arithmetic on the gains as they are: what is left is their rounding, amplified by few cancellations."""
    found = characteristic(made.model, tuple(made.gains()))  # type: ignore[arg-type]
    for got, wanted in zip(found, made.polynomial(), strict=True):
        assert abs(float(got / Fraction(wanted)) - 1.0) < 1e-12


@given(made=designs())
@settings(max_examples=60, deadline=None)
def test_poles_are_reproduced(made: fd.blocks.PolePlacement) -> None:
    """Each pole that stands apart from the others moves by less than 1e-12 of its size, to first order p/p'."""
    found = [
        float(each - Fraction(a))
        for each, a in zip(
            characteristic(made.model, tuple(made.gains())),  # type: ignore[arg-type]
            made.polynomial(),
            strict=True,
        )
    ]
    poles = np.roots(made.polynomial()[::-1])
    slope = np.polyder(np.array(made.polynomial()[::-1]))
    for i, pole in enumerate(poles):
        apart = np.min(np.abs(np.delete(poles, i) - pole)) / abs(pole)
        if apart > 0.1:
            assert abs(np.polyval(found[::-1], pole) / np.polyval(slope, pole)) < 1e-12 * abs(pole) / min(apart, 1.0)


def state_space(model: fd.blocks.TwoMass) -> tuple[np.ndarray, np.ndarray]:
    """[x1, x2, v1, v2, ∫x2] and the force on the screw."""
    made = model.mechanics()
    M, C, K = (np.array(each, dtype=float) for each in (made.mass, made.damping, made.stiffness))
    A = np.zeros((5, 5))
    A[:2, 2:4] = np.eye(2)
    A[2:4, :2], A[2:4, 2:4] = -np.linalg.solve(M, K), -np.linalg.solve(M, C)
    A[4, 1] = 1.0
    B = np.zeros((5, 1))
    B[2:4, 0] = np.linalg.solve(M, [1.0, 0.0])
    return A, B


@pytest.mark.parametrize("m12", [None, 3.0, -3.0, 8.0])
def test_gains_are_those_of_place_poles(m12: float | None) -> None:
    made = law(model=MODEL if m12 is None else coupled(m12))
    A, B = state_space(made.model)  # type: ignore[arg-type]
    poles = np.roots(made.polynomial()[::-1])
    independent = scipy.signal.place_poles(A, B, poles).gain_matrix[0]
    K1, K2, K3, K4, Ki = made.gains()
    # the largest gain of a position bears the digits of all: place_poles works on the whole matrix
    assert np.array([K1, K2]) == pytest.approx(independent[:2], abs=1e-8 * abs(K1))
    assert np.array([K3, K4]) == pytest.approx(independent[2:4], abs=1e-8 * abs(K3))
    assert independent[4] == pytest.approx(Ki, rel=1e-8)


def test_repeated_poles_are_as_good_as_others() -> None:
    bodies = two_bodies("", MODEL)
    desired = polynomial(400.0, (400.0, 1.0), (400.0, 1.0))  # five times -400 1/s
    gains = place(bodies, desired)
    for got, wanted in zip(characteristic(MODEL, tuple(gains)), desired, strict=True):
        assert abs(float(got / Fraction(wanted)) - 1.0) < 1e-13
    A, B = state_space(MODEL)
    with pytest.raises(ValueError, match="is repeated more than rank"):
        scipy.signal.place_poles(A, B, [-400.0] * 5)


def test_the_sampled_loop_has_the_placed_poles_as_it_is_sampled_faster() -> None:
    """Without delay and filters, the poles of the real loop: the error of backward differences falls with T."""
    desired = np.roots(law().polynomial()[::-1])
    off = []
    for T in (2e-5, 1e-5):
        axis = fd.Axis(plant=MODEL)
        loop = fd.Loop(control=fd.Control(law=law()), axis=axis, sample_time=T)
        poles = fd.linearize(loop, ["set_position", "load_force"], ["position_load", "position_motor"]).poles()
        reached = np.log(poles[np.abs(poles) > 0.5].astype(complex)) / T
        off.append([np.min(np.abs(reached - pole)) / abs(pole) for pole in desired])
    assert np.max(off[1]) < 0.02
    assert np.array(off[0]) / np.array(off[1]) == pytest.approx(2.0, abs=0.1)


def test_a_screw_in_rotary_terms_gives_the_same_gains() -> None:
    lead = 0.02
    radius = lead / (2.0 * np.pi)
    rotary = fd.blocks.ScrewTwoMass(
        inertia_motor=130.0 * radius**2,
        lead=lead,
        mass_load=33.0,
        stiffness=1.8e7,
        damping=700.0,
        viscous_bearings=1500.0 * radius**2,
        viscous_load=20.0,
    )
    assert tuple(law(model=rotary).gains()) == pytest.approx(tuple(law().gains()), rel=1e-11)


def test_the_sum_of_the_position_gains_is_that_of_the_slow_poles() -> None:
    """K1 + K2 = m1 m2 a1/k + (c/k) Ki, and Ki = m1 m2 a0/k: the closed form of the diagonal matrix with c' = -c."""
    gains, a = law().gains(), law().polynomial()
    assert 130.0 * 33.0 * a[0] / 1.8e7 == pytest.approx(gains.Ki, rel=1e-14)
    assert (130.0 * 33.0 * a[1] - 700.0 * gains.Ki) / 1.8e7 == pytest.approx(gains.K1 + gains.K2, rel=1e-12)


# --- set position of the screw


def stepped(made: fd.blocks.PolePlacement, setpoints: list[Setpoint], T: float) -> list[tuple[float, float]]:
    """The screw's lead (m, m/s) at each setpoint, read off the state of the exact lag."""
    prepared = made.prepare(T)
    state = made.start(prepared, setpoints[0], Reading(0.0, 0.0))
    found = []
    for setpoint in setpoints:
        state, _ = made.step(prepared, state, setpoint, Reading(0.0, 0.0), T)
        found.append(state.lead.lead)
    return found


def test_the_exact_lag_settles_on_the_series_at_constant_jerk() -> None:
    """With b2 = 0 the relaxed lead of a constant jerk is a ramp, which a lag follows late by its time constant."""
    T, model = 5e-5, dataclasses.replace(MODEL, viscous_load=0.0)
    made = law(model=model, commands="exact")
    setpoints = [Setpoint(0.0, 0.0, 800.0 * k * T, 800.0, 0.0) for k in range(60)]
    found = stepped(made, setpoints, T)[-1]
    expected = series(two_bodies("", model), setpoints[-1])
    assert found == pytest.approx((expected.position, expected.velocity), rel=1e-12)


@pytest.mark.parametrize("damping", [0.0, 1.0, 700.0, 1e5])
def test_the_exact_lag_is_that_of_first_order_hold(damping: float) -> None:
    """Against scipy's solution of c/k lead' + lead = relaxed for inputs that are straight between samples."""
    T, model = 5e-5, dataclasses.replace(MODEL, damping=damping)
    rng = np.random.default_rng(1)
    accelerations = np.r_[0.0, rng.normal(size=40)]
    found = stepped(law(model=model, commands="exact"), [Setpoint(0.0, 0.0, float(a)) for a in accelerations], T)
    relaxed = 33.0 / 1.8e7 * accelerations
    if damping == 0.0:
        expected = relaxed
    else:
        time = T * np.arange(relaxed.size)
        expected = scipy.signal.lsim(([1.0], [damping / 1.8e7, 1.0]), relaxed, time, interp=True)[1]
    assert [lead for lead, _ in found] == pytest.approx(expected, abs=1e-12 * float(np.max(np.abs(relaxed))))


@given(
    m12=st.floats(-10.0, 10.0),
    motion=st.tuples(*(st.floats(-size, size) for size in (1.0, 10.0, 1e3, 1e5))),
)
def test_the_series_solves_the_tables_equation_up_to_its_first_term(m12: float, motion: tuple[float, ...]) -> None:
    """k lead - c12 lead' = led a + dragged v, with what the series leaves out: (c/k)² k relaxed''."""
    v, a, j, s = motion
    bodies = two_bodies("", coupled(m12))
    lead = series(bodies, Setpoint(0.0, v, a, j, s))
    left = bodies.k * lead.position - bodies.c12 * lead.velocity
    rest = (700.0 / 1.8e7) ** 2 * (bodies.led * s + bodies.dragged * j)
    assert left == pytest.approx(bodies.led * a + bodies.dragged * v - rest, abs=1e-9)


@pytest.mark.parametrize("m12", [None, 3.0, -3.0])
def test_the_inverse_is_that_of_both_equations(m12: float | None) -> None:
    """The sum of both rows: the spring is inner, so the force is what accelerates and drags both bodies."""
    model = MODEL if m12 is None else coupled(m12)
    setpoint = Setpoint(0.1, 0.3, 4.0, 300.0, 2e4)
    middle = setpoint.shifted(2.5e-5)
    lead = series(two_bodies("", model), middle)
    made = model.mechanics()
    M, C = np.array(made.mass), np.array(made.damping)
    a = np.array([middle.acceleration + lead.acceleration, middle.acceleration])
    v = np.array([middle.velocity + lead.velocity, middle.velocity])
    expected = float(np.sum(M @ a + C @ v))
    assert fed(fd.blocks.InverseDynamics(model=model), setpoint, 5e-5) == pytest.approx(expected, rel=1e-12)
    rigid = fed(fd.blocks.InverseDynamics(model=model, order="rigid"), setpoint, 5e-5)
    assert rigid == pytest.approx(float(np.sum(M)) * middle.acceleration + 1520.0 * middle.velocity, rel=1e-12)


def test_without_damping_the_inverse_has_the_fourth_order_form() -> None:
    """u = (m1 + m2) a + m1 m2/k snap (Lambrechts, Boerlage & Steinbuch 2005)."""
    model = fd.blocks.TwoMass(mass_motor=130.0, mass_load=33.0, stiffness=1.8e7)
    force = fed(fd.blocks.InverseDynamics(model=model), Setpoint(0.0, 0.0, 0.0, 0.0, 8e4), 1e-12)
    assert force == pytest.approx(130.0 * 33.0 / 1.8e7 * 8e4, rel=1e-9)


# --- the law in a loop


def test_an_offset_between_the_encoders_makes_no_force() -> None:
    made = law()
    prepared = made.prepare(5e-5)
    reading = Reading(3e-4, 1e-4, 40.0, 40.0)
    state = made.start(prepared, Setpoint(1e-4), reading)
    _, force = made.step(prepared, state, Setpoint(1e-4), reading, 5e-5)
    assert force == pytest.approx(40.0, abs=1e-9)  # it goes on with the force that acts


def test_a_step_beyond_the_limit_settles() -> None:
    """Freezing the integral: 1 mm at once with 400 N, where an integral that goes on runs away."""
    control = fd.Control(law=law(), force_limit=400.0)
    loop = fd.Loop(control=control, axis=fd.Axis(plant=MODEL), sample_time=5e-5)
    set_position = np.r_[0.0, np.full(8000, 1e-3)]
    step = fd.blocks.Recorded(position=set_position, velocity=np.zeros(8001), sample_time=5e-5)
    run = fd.simulate(loop, step)
    assert np.max(np.abs(run["requested"])) > 400.0
    assert np.max(run["position_load"]) < 1.6e-3
    assert abs(run["position_load"][-1] - 1e-3) < 1e-8


def test_all_contributions_together_follow_the_models_own_axis() -> None:
    """On the very axis that the law believes in, without delay, compatible commands leave a tenth and less."""

    def left(commands: str, order: str | None) -> float:
        forward = () if order is None else (fd.blocks.InverseDynamics(model=MODEL, order=order),)
        control = fd.Control(law=law(commands=commands), feedforward=forward)
        loop = fd.Loop(control=control, axis=fd.Axis(plant=MODEL), sample_time=5e-5)
        return float(np.max(np.abs(fd.tracking(loop, np.array([5.0, 10.0, 20.0])).response - 1.0)))

    whole = left("series", "full")
    assert whole < 2e-3
    assert whole < 0.1 * min(left("rigid", "full"), left("series", None), left("rigid", "rigid"))
    assert left("exact", "full") == pytest.approx(whole, rel=0.05)


# --- what cannot be


def test_an_unstable_command_filter_is_refused_with_bound_and_nearest_value() -> None:
    with pytest.raises(ParameterError) as refused:
        law(model=coupled(3.0), commands="exact")
    assert all(part in str(refused.value) for part in ("+2568.93 1/s", "3 kg", "> 0 kg", "nearest", "0 kg"))
    with pytest.raises(ParameterError, match=r"rings at 389\.8 Hz"):
        law(model=coupled(-3.0), commands="exact")
    law(model=coupled(0.0), commands="exact")
    law(model=coupled(3.0))


def test_a_table_that_the_screw_cannot_move_is_refused_with_the_nearest_value() -> None:
    model = coupled(-33.0, viscous_load=0.0)
    with pytest.raises(ParameterError, match=r"nearest admissible value is -32\.967 kg"):
        law(model=model)
    law(model=coupled(-32.966, viscous_load=0.0))
    stuck = dataclasses.replace(MODEL, viscous_load=1.8e7 * 33.0 / 700.0)
    with pytest.raises(ParameterError, match=r"guideway is 848571 N s/m; the nearest"):
        law(model=stuck)


def test_a_model_of_another_form_is_refused() -> None:
    with pytest.raises(StructureError, match="one spring between them"):
        law(model=fd.blocks.Rigid(mass=100.0))


def test_poles_beyond_nyquist_are_refused_with_the_nearest_value() -> None:
    with pytest.raises(ParameterError, match=r"bandwidth < 5000 Hz"):
        tree.check_sampled(law(bandwidth=6000.0), 1e-4)
    with pytest.raises(ParameterError, match=r"rigid_frequency < 505\.1"):
        tree.check_sampled(law(rigid_frequency=600.0, rigid_damping=5.0), 1e-4)


def test_one_encoder_is_refused() -> None:
    axis = fd.Axis(plant=MODEL, encoder_load=fd.blocks.Encoder(resolution=1e-8))
    with pytest.raises(StructureError, match="needs the position of the motor and that of the load"):
        fd.Loop(control=fd.Control(law=law()), axis=axis, sample_time=5e-5)


def test_the_inverse_is_not_fed_beside_an_inertia() -> None:
    with pytest.raises(StructureError, match="feeds the acceleration forward"):
        fd.Control(law=law(), feedforward=(fd.blocks.InverseDynamics(model=MODEL), fd.blocks.Inertia(mass=163.0)))


def test_gains_may_vary_within_a_batch() -> None:
    """Each lane has the gains of its own poles: the batch gives what single runs give."""
    loop = fd.Loop(control=fd.Control(law=law()), axis=fd.Axis(plant=MODEL), sample_time=5e-5)
    move = fd.blocks.SnapLimitedMove(distance=0.01, velocity=0.3, acceleration=5.0, jerk=400.0, snap=4e4)
    widths = np.array([30.0, 50.0, 70.0])
    batch = fd.simulate_batch(fd.vary(loop, {"axis.x.control.law.bandwidth": widths}), move)
    for i, width in enumerate(widths):
        run = fd.simulate(fd.vary(loop, {"axis.x.control.law.bandwidth": float(width)}), move)
        assert batch.peak["tracking_error"][i] == np.max(np.abs(run["tracking_error"]))
