"""Recovered disturbances: the inverse of the plant, its noise and lag, and the Kalman filter against scipy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_are

from blocks.test_dadsc import T, law
from feeddrive.analysis.replay import observe
from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.families import Observer
from feeddrive.blocks.load.recorded_force import RecordedForce
from feeddrive.blocks.observer.disturbance_recovery import DisturbanceRecovery
from feeddrive.blocks.observer.gpi_observer import GpiObserver
from feeddrive.blocks.observer.kalman_recovery import KalmanRecovery
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.reference.polynomial7 import Polynomial7
from feeddrive.blocks.signals import Reading
from feeddrive.language import tree
from feeddrive.language.errors import LogError, ParameterError
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import Run, simulate

EXACT = DisturbanceRecovery(mass=40.0, viscous=60.0, form="exact")
FORMS = [
    EXACT,
    replace(EXACT, form="one_pole", frequency=300.0),
    replace(EXACT, form="butterworth", frequency=300.0),
    KalmanRecovery(mass=40.0, viscous=60.0, resolution=1e-8, force_step=20.0),
    KalmanRecovery(mass=40.0, viscous=0.0, resolution=1e-6, force_step=2.0),
]


def run(force: np.ndarray, dead_time: float = 0.0) -> Run:
    axis = Axis(plant=Rigid(mass=40.0, viscous=60.0), actuator=Actuator(dead_time=dead_time))
    slow = law(tracking_rate=100.0, reaching_rate=100.0, adaptation_rate=100.0)
    closed = Loop(control=Control(law=slow), axis=axis, sample_time=T)
    rest = Polynomial7(distance=0.0, travel_time=1.0)
    load = RecordedForce(force=force, sample_time=T)
    return simulate(closed, rest, load=load, duration=(force.size - 1) * T)


def test_a_constant_force_is_recovered_by_all_forms() -> None:
    found = run(np.full(8000, 150.0))
    for observer in FORMS:
        seen = observe(observer, found["reading_load"], found["force"], T)
        # the loop has settled: forces are constant to 1e-3 N, position noise there is none
        assert seen.disturbance[-1] == pytest.approx(150.0, abs=0.05), observer


def test_the_exact_form_is_the_inverse_of_the_plant_with_held_forces() -> None:
    """Without viscous friction a double difference is the mean of two samples' forces, less a command."""
    rng = np.random.default_rng(5)
    push = rng.normal(0.0, 100.0, 300)
    axis = Axis(plant=Rigid(mass=40.0))
    closed = Loop(control=Control(law=law(viscous=0.0)), axis=axis, sample_time=T)
    rest = Polynomial7(distance=0.0, travel_time=1.0)
    found = simulate(closed, rest, load=RecordedForce(force=push, sample_time=T), duration=299 * T)
    seen = observe(replace(EXACT, viscous=0.0), found["reading_load"], found["force"], T).disturbance
    u = found["force"]
    expected = 0.5 * (push[1:-1] + push[:-2]) + 0.5 * (u[1:-1] + u[:-2]) - u[1:-1]
    # 40 kg · 1e-16 · 1e-4 m / T² of rounding
    assert np.max(np.abs(seen[2:] - expected)) < 1e-6


def test_the_noise_of_the_exact_form_is_that_of_a_double_difference() -> None:
    rng = np.random.default_rng(6)
    q = 1e-8
    reading = q * (rng.random(200_000) - 0.5)
    seen = observe(replace(EXACT, viscous=0.0), reading, np.zeros(reading.size), T).disturbance
    expected = 40.0 * np.sqrt(6.0) * q / np.sqrt(12.0) / T**2
    assert expected == pytest.approx(28.3, abs=0.05)
    assert np.std(seen) == pytest.approx(expected, rel=0.01)  # 200 000 samples: 0.3 %


@pytest.mark.parametrize("observer", FORMS, ids=lambda o: f"{o.kind} {getattr(o, 'form', '')}")
def test_the_lag_is_that_of_a_force_that_rises_steadily(observer: Observer) -> None:
    """A ramp on an axis without control: the estimate follows it by `lag`, against the force held from kT on."""
    n = 400
    slope = 0.01  # N a sample
    push = slope * np.arange(n)
    m, b = 40.0, float(getattr(observer, "viscous", 0.0))
    made = expm(T * np.array([[0, 1, 0], [0, -b / m, 1 / m], [0, 0, 0]]))
    x = np.zeros((n, 2))
    for k in range(n - 1):
        x[k + 1] = made[:2, :2] @ x[k] + made[:2, 2] * push[k]
    seen = observe(observer, x[:, 0], np.zeros(n), T)
    late = (push[-1] - seen.disturbance[-1]) / slope
    # b v comes half a sample earlier than the rest, and takes 40 ms · b/m = 6 % of the force at the end
    assert late == pytest.approx(seen.lag / T, abs=0.05)


@pytest.mark.parametrize(
    ("mass", "viscous", "resolution", "force_step", "sample_time"),
    [
        (40.0, 60.0, 1e-8, 20.0, 1e-4),
        (40.0, 0.0, 1e-6, 1.0, 1e-4),
        (5.0, 1e4, 1e-9, 100.0, 5e-5),
        (500.0, 60.0, 1e-5, 5.0, 1e-3),
        (1.0, 1e5, 1e-6, 1.0, 2e-4),
        (300.0, 500.0, 1e-6, 0.05, 1e-3),
    ],
)
def test_the_gain_is_that_of_the_riccati_equation(
    mass: float, viscous: float, resolution: float, force_step: float, sample_time: float
) -> None:
    observer = KalmanRecovery(mass=mass, viscous=viscous, resolution=resolution, force_step=force_step)
    made = observer.prepare(sample_time)
    A = expm(sample_time * np.array([[0, 1, 0], [0, -viscous / mass, 1 / mass], [0, 0, 0]]))
    S = np.diag([1.0, 1.0 / sample_time, mass / sample_time**2]) * resolution
    A = np.linalg.solve(S, A @ S)
    C = np.array([[1.0, 0.0, 0.0]])
    Q = np.diag([0.0, 0.0, (force_step / S[2, 2]) ** 2])
    R = np.array([[1.0 / 12.0]])
    P = solve_discrete_are(A.T, C.T, Q, R)
    gain = S @ (P @ C.T / (C @ P @ C.T + R))[:, 0] / resolution
    np.testing.assert_allclose(np.array(made.gain, dtype=float), gain, rtol=1e-6)
    assert np.max(np.abs(np.linalg.eigvals(A - np.outer(P @ C.T / (C @ P @ C.T + R), C @ A)))) < 1.0


@pytest.mark.parametrize("viscous", [0.0, 60.0])
@pytest.mark.parametrize("decades", [2, 4, 6, 10, 100])
def test_an_encoder_without_noise_has_a_gain_too(viscous: float, decades: int) -> None:
    """Every reading is true, L = (1, 2/T, 2 m/T²); the pole that is left, near -1, is the zero of the held plant."""
    observer = KalmanRecovery(mass=40.0, viscous=viscous, resolution=1e-8 * 10.0**-decades, force_step=20.0)
    gain = np.array(observer.prepare(T).gain, dtype=float)
    np.testing.assert_allclose(gain, [1.0, 2.0 / T, 2.0 * 40.0 / T**2], rtol=0.05)
    A = expm(T * np.array([[0, 1, 0], [0, -viscous / 40.0, 1 / 40.0], [0, 0, 0]]))
    assert np.max(np.abs(np.linalg.eigvals(A - np.outer(gain, A[0])))) < 1.0


def test_dead_time_is_taken_into_account() -> None:
    """Commands act two samples late: an observer that knows it is as good as one without dead time."""
    rng = np.random.default_rng(7)
    push = np.cumsum(rng.normal(0.0, 5.0, 3000))
    aware, blind = (replace(EXACT, form="butterworth", delay_samples=d) for d in (2, 0))
    late = run(push, dead_time=2.0 * T)
    known, unknown = (observe(o, late["reading_load"], late["force"], T) for o in (aware, blind))
    prompt = run(push)
    reference = observe(blind, prompt["reading_load"], prompt["force"], T)
    best = reference.error(push, skip=200, aligned=True)
    assert known.error(push, skip=200, aligned=True) < 1.05 * best
    assert unknown.error(push, skip=200, aligned=True) > known.error(push, skip=200, aligned=True)


@pytest.mark.parametrize("observer", FORMS, ids=lambda o: f"{o.kind} {getattr(o, 'form', '')}")
def test_start_takes_the_force_that_acts_for_balanced(observer: Observer) -> None:
    made = observer.prepare(T)
    reading = Reading(0.2, 0.2, applied=80.0, requested=80.0)
    state = observer.start(made, reading)
    for _ in range(5):
        state, estimate = observer.step(made, state, reading, T)
        assert estimate.disturbance == pytest.approx(-80.0, abs=1e-9)
        assert estimate.velocity == pytest.approx(0.0, abs=1e-12)


def test_a_filter_above_half_the_sample_rate_is_refused() -> None:
    with pytest.raises(ParameterError, match="below half the sample rate, 500 Hz"):
        tree.check_sampled(replace(EXACT, form="butterworth", frequency=600.0), 1e-3)
    tree.check_sampled(replace(EXACT, frequency=600.0), 1e-3)  # the exact form has no filter


def test_observing_says_what_is_wrong_with_a_log() -> None:
    with pytest.raises(LogError, match="one force for each position"):
        observe(EXACT, np.zeros(5), np.zeros(4), T)
    with pytest.raises(LogError, match="finite"):
        observe(EXACT, np.array([0.0, np.nan]), np.zeros(2), T)
    with pytest.raises(ParameterError, match="> 0 s"):
        observe(EXACT, np.zeros(5), np.zeros(5), 0.0)


def test_observing_natively_gives_the_bits_of_the_step() -> None:
    found = run(np.random.default_rng(8).normal(0.0, 50.0, 500))
    for observer in FORMS:
        seen = observe(observer, found["reading_load"], found["force"], T)
        plain = observer.prepare(np.float64(T))
        state, applied = observer.start(plain, Reading(0.0, 0.0)), 0.0
        for k in range(500):
            x = found["reading_load"][k]
            state, estimate = observer.step(plain, state, Reading(x, x, applied, applied), T)
            assert estimate.disturbance == seen.disturbance[k]
            applied = found["force"][k]


@pytest.mark.parametrize(
    "observer",
    [
        DisturbanceRecovery(mass=40.0, viscous=60.0, form="exact"),
        DisturbanceRecovery(mass=40.0, viscous=60.0),
        KalmanRecovery(mass=40.0, viscous=60.0, resolution=1e-8, force_step=20.0),
        GpiObserver(mass=40.0, omega_o=500.0),
    ],
    ids=lambda observer: f"{observer.kind} {getattr(observer, 'form', '')}",
)
def test_a_log_that_begins_in_motion_is_no_blow(observer: Observer) -> None:
    """0.1 m/s, held by 6 N against viscous friction; at rest before, the first sample would be 40 kN."""
    t = T * np.arange(2000)
    seen = observe(observer, 0.3 + 0.1 * t, np.full(t.size, 6.0), T, before=6.0, velocity=0.1)
    drag = 0.0 if isinstance(observer, DisturbanceRecovery | KalmanRecovery) else -6.0
    np.testing.assert_allclose(seen.disturbance, drag, atol=0.01)


@pytest.mark.parametrize(
    ("held", "cancelled", "samples"), [(True, False, 1.5), (False, False, 1.0), (True, True, 1.0), (False, True, 0.5)]
)
def test_how_late_a_ramp_comes_depends_on_how_it_acts_and_on_the_motor(
    *, held: bool, cancelled: bool, samples: float
) -> None:
    """1000 N/s on 40 kg at 0.2 ms in closed form; `lag` is that of a held force beside a motor force that stands."""
    T, slope, mass = 2e-4, 1000.0, 40.0
    force = slope * T * np.arange(400)
    motor = -force if cancelled else np.zeros(400)
    # per sample: what stands over it, and what rises in it (velocity slope T²/2m, way slope T³/6m)
    rising = 0.0 if held else slope
    push = (force + motor) / mass
    velocity = np.concatenate([[0.0], np.cumsum(push * T + 0.5 * rising * T * T / mass)])
    moved = velocity[:-1] * T + 0.5 * push * T * T + rising * T**3 / (6.0 * mass)
    position = np.concatenate([[0.0], np.cumsum(moved)])[:400]
    seen = observe(DisturbanceRecovery(mass=mass, form="exact"), position, motor, T)
    late = (force - seen.disturbance)[-1] / slope
    assert late == pytest.approx(samples * T, abs=1e-3 * T)  # rounding of the double difference: 1e-12 m m/T² = 1e-3 N
    assert seen.lag == pytest.approx(1.5 * T, rel=1e-12)


def test_an_observation_shows_itself() -> None:
    found = run(np.full(500, 150.0))
    seen = observe(EXACT, found["reading_load"], found["force"], T)
    assert "disturbance_recovery" in str(seen)
    assert list(seen.to_pandas().columns) == ["position", "velocity", "disturbance"]
    assert seen.plot().axes
    with pytest.raises(ParameterError, match="has 3 rows, the estimate 500"):
        seen.error(np.zeros(3))


def test_a_slow_filter_is_settled_and_has_the_gain_in_closed_form() -> None:
    """w = ∛ρ T << 1: the filter of a triple integrator in continuous time, with poles of a Butterworth filter at w."""
    w, mass, resolution = 2e-4, 400.0, 1e-5
    force_step = w**3 * mass * resolution / 12.0**0.5 / T**2
    observer = KalmanRecovery(mass=mass, viscous=0.0, resolution=resolution, force_step=force_step)
    gain = np.array(observer.prepare(T).gain, dtype=float)
    np.testing.assert_allclose(gain, [2.0 * w, 2.0 * w**2 / T, mass * w**3 / T**2], rtol=1e-3)


def test_finer_encoders_than_a_walk_of_a_hundred_thousand_standard_deviations_have_one_gain() -> None:
    """ρ = force_step T² √12/(mass resolution): above 1e5 the gain no longer depends on the noise."""

    def gain(ratio: float) -> tuple[float, ...]:
        step = ratio * 40.0 * 1e-8 / 12.0**0.5 / T**2
        return KalmanRecovery(mass=40.0, viscous=0.0, resolution=1e-8, force_step=step).prepare(T).gain

    assert gain(1.5e5) == gain(3e5)
    assert gain(0.75e5) != gain(3e5)
