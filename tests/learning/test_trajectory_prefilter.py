"""The prefilter's fit: exact on synthetic errors, second order on loops, honest about what a log can say."""

from __future__ import annotations

import contextlib
import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import feeddrive as fd
from feeddrive.blocks.signals import Setpoint
from feeddrive.language.errors import LogError, ParameterError
from feeddrive.learning.trajectory_prefilter import REGRESSORS, _check_clock, _fit
from feeddrive.learning.trial import differenced
from feeddrive.loop.loop import UNITS

T = 1e-4
MOVE = fd.blocks.SnapLimitedMove(distance=0.1, velocity=0.5, acceleration=8.0, jerk=600.0, snap=6e4, dwell_after=0.05)
SIZES = np.array([1e-5, 1e-7, 1e-9, 1e-11])  # of θ: each part is then of the order of µm
TIME = T * np.arange(round(MOVE.duration / T))


def synthetic(theta: np.ndarray, remainder: np.ndarray | float = 0.0) -> fd.loop.Run:
    """A run whose error is exactly θ on the derivatives of MOVE, and a remainder."""
    setpoint = MOVE.at(TIME)
    error = np.column_stack(setpoint[1:]) @ theta + remainder
    return fd.loop.Run("run", {"following_error": error}, T, TIME.size)


def loop(**control: object) -> fd.Loop:
    """A rigid axis under P-PI that follows well: feedforward of velocity and acceleration, one sample of delay."""
    made = fd.Control(
        **{
            "law": fd.blocks.CascadePPI(Kv=40.0, Kp=2.0e4, Tn=0.02),
            "feedforward": (fd.blocks.Inertia(mass=90.0, viscous=350.0),),
            "force_limit": 5000.0,
            **control,
        }
    )
    axis = fd.Axis(plant=fd.blocks.Rigid(mass=100.0, viscous=400.0), actuator=fd.blocks.Actuator(dead_time=T))
    return fd.Loop(control=made, axis=axis, sample_time=T)


parts = st.tuples(*(st.floats(-1.0, 1.0) for _ in range(4))).map(np.array)


@given(share=parts)
@settings(max_examples=30, deadline=None)
def test_an_error_of_derivatives_is_found_exactly(share: np.ndarray) -> None:
    found = fd.learning.fit_prefilter(synthetic(share * SIZES), MOVE)
    assert np.array(list(found.theta.values())) / SIZES == pytest.approx(share, abs=1e-9)
    assert found.rms(found.error - found.explained) < 1e-9 * np.linalg.norm(SIZES)


@pytest.mark.parametrize("regressors", [("acceleration", "snap"), ("jerk",), ("snap", "velocity"), REGRESSORS])
def test_a_subset_of_regressors_is_the_least_squares_of_it(regressors: tuple[str, ...]) -> None:
    remainder = 1e-7 * np.sin(40.0 * TIME)
    run = synthetic(np.array([0.3, -0.5, 0.7, 0.2]) * SIZES, remainder)
    found = fd.learning.fit_prefilter(run, MOVE, regressors=regressors)
    assert set(found.theta) == set(regressors)
    columns = np.column_stack([getattr(MOVE.at(TIME), each) for each in REGRESSORS if each in regressors])
    left = (found.error - found.explained)[found.counted]
    # of a least squares the remainder is normal to every column
    sizes = np.linalg.norm(columns[found.counted], axis=0) * np.linalg.norm(left)
    assert np.max(np.abs(columns[found.counted].T @ left) / sizes) < 1e-9


@given(share=parts, present=parts)
def test_the_exact_series_inverts(share: np.ndarray, present: np.ndarray) -> None:
    """(1 - θ(s)) (1 + exact) = 1 + present up to s⁴."""
    theta, before = 1e-3 ** np.arange(1, 5) * share, 1e-3 ** np.arange(1, 5) * present
    had = fd.blocks.TrajectoryPrefilter(**dict(zip(("theta1", "theta2", "theta3", "theta4"), before, strict=True)))
    found = dataclasses.replace(
        fd.learning.fit_prefilter(synthetic(SIZES), MOVE, present=had), theta=dict(zip(REGRESSORS, theta, strict=True))
    )
    exact = found.exact
    product = np.convolve([1.0, *-theta], [1.0, exact.theta1, exact.theta2, exact.theta3, exact.theta4])[:5]
    assert product / 1e-3 ** np.arange(5) == pytest.approx([1.0, *present], abs=1e-12)
    assert (found.prefilter.theta1, found.prefilter.theta4) == (before[0] + theta[0], before[3] + theta[3])


def proportional(fed: float) -> fd.Loop:
    """Without integral action, and with a share of the velocity fed forward: E(s) = 1 - H(s) is a series in s/Kv."""
    return loop(law=fd.blocks.CascadePPI(Kv=40.0, Kp=2.0e4, velocity_feedforward=fed))


def test_what_is_left_is_of_second_order() -> None:
    """With θ the series of E(s), the loop behind the prefilter leaves E(s)²: 1 - (1 - E)(1 + E)."""
    base = proportional(0.8)
    low = np.linspace(0.05, 0.4, 12)
    s = 2j * np.pi * low
    E = 1.0 - fd.tracking(base, low).response
    powers = np.column_stack([s**n for n in range(1, 7)])
    series = np.linalg.lstsq(np.vstack([powers.real, powers.imag]), np.r_[E.real, E.imag], rcond=None)[0]
    block = fd.blocks.TrajectoryPrefilter(**dict(zip(("theta1", "theta2", "theta3", "theta4"), series, strict=False)))
    held = dataclasses.replace(base, control=dataclasses.replace(base.control, prefilter=block))
    left = 1.0 - fd.tracking(held, low).response
    # what is cut off above the snap is of fifth order: it shows at the upper end
    assert np.abs(left - E**2) == pytest.approx(np.zeros(12), abs=0.02 * float(np.max(np.abs(E)) ** 2))
    assert np.max(np.abs(left)) < 0.02 * np.max(np.abs(E))


def test_the_prefilter_widens_tracking_and_takes_its_phase_out() -> None:
    base = proportional(0.8)
    fit = fd.learning.tune_prefilter(base, MOVE, runs=2)[-1]
    held = dataclasses.replace(base, control=dataclasses.replace(base.control, prefilter=fit.prefilter))
    lines = np.array([0.5, 2.0, 4.0])
    before, after = fd.tracking(base, lines), fd.tracking(held, lines)
    assert np.all(np.abs(after.response - 1.0) < 0.5 * np.abs(before.response - 1.0))
    assert np.all(np.abs(after.phase_deg) < np.abs(before.phase_deg))


def test_the_blocks_numbers_are_the_operator_on_each_derivative() -> None:
    """On a polynomial of degree 4 the output's derivatives are those of its position: nothing is cut off there."""
    block = fd.blocks.TrajectoryPrefilter(theta1=1e-2, theta2=2e-3, theta3=-3e-4, theta4=4e-5)
    at = [
        block.step(block.start(s), s, T)[1] for s in (Setpoint(0.0, 1.0, 2.0, 3.0, 4.0).shifted(h) for h in (0.0, 0.1))
    ]
    moved = at[0].shifted(0.1)
    assert tuple(moved) == pytest.approx(tuple(at[1]), rel=1e-12)


def test_standard_errors_are_those_of_repeated_runs() -> None:
    """Remainders that last some 5 ms: the scatter over 60 runs against the error that each run claims."""
    rng = np.random.default_rng(2)
    thetas, claimed = [], []
    for _ in range(60):
        noise = np.zeros(TIME.size)
        for k, step in enumerate(rng.normal(size=TIME.size - 1), start=1):
            noise[k] = 0.98 * noise[k - 1] + 1e-8 * step
        found = fd.learning.fit_prefilter(synthetic(SIZES, noise), MOVE)
        thetas.append(list(found.theta.values()))
        claimed.append(list(found.standard_error.values()))
    ratio = np.mean(claimed, axis=0) / np.std(thetas, axis=0)
    # 60 runs give a scatter to 9 %; Bartlett's weights are a little too small. White errors would claim a seventh
    assert np.all((ratio > 0.5) & (ratio < 1.4))


# --- logs


def measured() -> fd.loop.Run:
    return fd.simulate(loop(), MOVE)


def test_a_log_gives_what_the_run_gives() -> None:
    run = measured()
    by_run = fd.learning.fit_prefilter(run, MOVE)
    arguments = (run.time + 5.0, run["set_position"], run["reading_load"], T)
    exact = fd.learning.fit_prefilter_to_log(*arguments, reference=MOVE)
    assert list(exact.theta.values()) == pytest.approx(list(by_run.theta.values()), rel=0.01)  # steps of the snap
    # lie on samples, so that the rounding of a time that starts at 5 s moves a few of them by a sample
    by_differences = fd.learning.fit_prefilter_to_log(*arguments)
    for name, value in by_run.theta.items():
        # central differences are those of a motion smoothed over two samples
        assert by_differences.theta[name] == pytest.approx(value, abs=2.0 * by_run.standard_error[name])


def test_differences_are_of_second_order() -> None:
    motion = fd.blocks.Polynomial7(distance=0.1, travel_time=0.4)
    worst = []
    for step in (2e-3, 1e-3):
        t = step * np.arange(round(0.4 / step) + 1)
        true, found = motion.at(t), differenced("a", np.asarray(motion.at(t).position), step, REGRESSORS)
        inner = (t > 0.05) & (t < 0.35)
        off = [getattr(found, each)[inner] - getattr(true, each)[inner] for each in REGRESSORS]
        worst.append([float(np.sqrt(np.mean(each**2))) for each in off])
    assert np.array(worst[0]) / np.array(worst[1]) == pytest.approx(4.0, abs=0.1)


def test_a_prefilter_that_was_there_is_kept() -> None:
    had = fd.blocks.TrajectoryPrefilter(theta1=1e-4)
    found = fd.learning.fit_prefilter(synthetic(SIZES), MOVE, present=had)
    assert found.prefilter.theta1 == pytest.approx(1e-4 + 1e-5, rel=1e-9)


# --- what cannot be


def test_a_motion_without_jerk_is_refused() -> None:
    move = fd.blocks.TrapezoidalMove(distance=0.1, velocity=0.1, acceleration=1.0)
    run = fd.simulate(loop(), move)
    with pytest.raises(LogError, match=r"no jerk .* only the regressors velocity, acceleration"):
        fd.learning.fit_prefilter(run, move)
    assert set(fd.learning.fit_prefilter(run, move, regressors=("velocity", "acceleration")).theta) == {
        "velocity",
        "acceleration",
    }


def test_a_sine_cannot_tell_velocity_from_jerk() -> None:
    sine = fd.blocks.Sine(amplitude=0.01, frequency=5.0, cycles=5)
    run = fd.simulate(loop(force_limit=None), sine)
    with pytest.raises(LogError, match=r"(velocity and jerk|acceleration and snap) cannot be told apart"):
        fd.learning.fit_prefilter(run, sine)


def test_saturation_is_refused() -> None:
    run = fd.simulate(fd.vary(loop(), {"axis.x.control.force_limit": 600.0}), MOVE)
    with pytest.raises(LogError, match=r"met its limit in \d+ samples"):
        fd.learning.fit_prefilter(run, MOVE)
    limited = fd.vary(loop(), {"axis.x.control.force_limit": 600.0})
    with pytest.raises(LogError, match="met its limit"):
        fd.learning.fit_prefilter_to_log(
            run.time, run["set_position"], run["reading_load"], T, force=run["force"], control=limited
        )


def test_another_clock_is_refused_with_the_controllers() -> None:
    run = measured()
    with pytest.raises(LogError, match=r"0\.00012 s is not the controller's, 0\.0001 s: they differ by 20 %"):
        fd.learning.fit_prefilter_to_log(
            1.2 * run.time, run["set_position"], run["reading_load"], 1.2 * T, control=loop()
        )


def test_too_short_a_motion_is_refused_with_the_least_length() -> None:
    move = fd.blocks.SnapLimitedMove(
        distance=1e-9, velocity=0.5, acceleration=8.0, jerk=600.0, snap=6e4, dwell_after=0.05
    )
    with pytest.raises(LogError, match="need at least 100"):
        fd.learning.fit_prefilter(fd.simulate(loop(), move), move)


@pytest.mark.parametrize("read", ["dead encoder", "another unit", "another axis' zero"])
def test_a_position_that_does_not_follow_is_refused(read: str) -> None:
    run = measured()
    x = run["reading_load"]
    position = {"dead encoder": 0.0 * x, "another unit": 1e3 * x, "another axis' zero": x + 1.0}[read]
    with pytest.raises(
        LogError, match=r"away from the set position, less than half the travel, 0\.[0-9]+ m, is allowed"
    ):
        fd.learning.fit_prefilter_to_log(run.time, run["set_position"], position, T)


def test_another_reference_is_refused() -> None:
    run = measured()
    with pytest.raises(LogError, match="differ by up to"):
        fd.learning.fit_prefilter_to_log(
            run.time, run["set_position"], run["reading_load"], T, reference=dataclasses.replace(MOVE, jerk=500.0)
        )


@pytest.mark.parametrize(("count", "refused"), [(1e-6, "acceleration"), (1e-9, "jerk"), (1e-12, "snap")])
def test_rounded_set_positions_are_refused_where_rounding_is_the_derivative(count: float, refused: str) -> None:
    run = measured()
    rounded = count * np.round(run["set_position"] / count)
    with pytest.raises(LogError, match=f"of their {refused} by differences") as error:
        fd.learning.fit_prefilter_to_log(run.time, rounded, run["reading_load"], T)
    assert "at most 5 % is admitted" in str(error.value)
    # the reference in closed form has derivatives whatever the log's rounding
    fd.learning.fit_prefilter_to_log(run.time, rounded, run["reading_load"], T, reference=MOVE)


def test_unknown_regressors_are_refused() -> None:
    with pytest.raises(ParameterError, match="there are velocity, acceleration, jerk, snap"):
        fd.learning.fit_prefilter(synthetic(SIZES), MOVE, regressors=("crackle",))


def test_the_result_shows_itself() -> None:
    found = fd.learning.fit_prefilter(synthetic(SIZES), MOVE)
    assert "velocity" in str(found)
    assert found.to_pandas().shape == (TIME.size, 3)
    assert len(found.plot().axes) == 2
    assert UNITS["following_error"] == "m"


@pytest.mark.parametrize(("condition", "accepted"), [(700.0, True), (1500.0, False)])
def test_regressors_up_to_a_condition_of_a_thousand_are_told_apart(condition: float, accepted: bool) -> None:
    """Two columns of equal RMS with the correlation r have the condition √((1 + r)/(1 - r))."""
    r = (condition**2 - 1.0) / (condition**2 + 1.0)
    turn = 2.0 * np.pi * np.arange(1000) / 1000
    velocity = np.sqrt(2.0) * np.cos(turn)
    other = r * velocity + np.sqrt(2.0 * (1.0 - r**2)) * np.sin(turn)
    setpoint: Any = Setpoint(0.0, velocity, other)
    if accepted:
        fit = _fit("log", turn, velocity, setpoint, ("velocity", "acceleration"), None)
        assert fit.condition == pytest.approx(condition, rel=0.01)
        return
    with pytest.raises(LogError, match="cannot be told apart"):
        _fit("log", turn, velocity, setpoint, ("velocity", "acceleration"), None)


@pytest.mark.parametrize(("off", "accepted"), [(0.7e-6, True), (1.5e-6, False)])
def test_a_clock_is_the_controllers_to_a_millionth(off: float, accepted: bool) -> None:
    with contextlib.nullcontext() if accepted else pytest.raises(LogError, match="is not the controller's"):
        _check_clock("log", (1.0 + off) * T, T)
