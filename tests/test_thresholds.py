"""Numbers that decide what a person is told: a case on either side of each, which a halved or doubled number swaps.

Beside them, terms of an equation that no test of its room would miss: against a closed form.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from feeddrive.analysis.margins import margins
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.families import Reading
from feeddrive.blocks.observer.gpi_observer import GpiObserver
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.plant.two_bodies import TwoBodies
from feeddrive.blocks.prefilter.trajectory_prefilter import TrajectoryPrefilter
from feeddrive.blocks.sensor.encoder import Encoder
from feeddrive.blocks.signals import Setpoint
from feeddrive.evaluation.duty import Duty, duty_of
from feeddrive.figures.of_loops import ROPE_SNAP
from feeddrive.figures.ranking import beats, ranks
from feeddrive.identification.regression import TABLE
from feeddrive.language.errors import NotIdentifiableError, ParameterError
from feeddrive.learning.trajectory_prefilter import PrefilterFit
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.guard import TRIP_FOLLOWING_ERROR, Guard
from feeddrive.loop.loop import Loop
from feeddrive.machining.lobes import chatter_signs
from feeddrive.tuning.criteria import require_covered, require_good
from feeddrive.workflow.friction import kept_away

# chatter: four teeth at 3000 rpm pass at 200 Hz; one sample a tooth at the phase of `start` sees a line beside them

STEP = 1e-4
TIME = STEP * np.arange(40_000)  # 800 teeth
TEETH = np.sin(2.0 * np.pi * 200.0 * TIME)  # swings by 2 within a tooth


def dots(beside: np.ndarray) -> int:
    return chatter_signs(TEETH + beside, STEP, speed=3000.0, teeth=4, start=0.0).dots


@pytest.mark.parametrize(("second_half", "expected"), [(0.45, 1), (0.55, 0)])
def test_a_ring_that_shrinks_to_less_than_half_dies_out(second_half: float, expected: int) -> None:
    size = np.where(TIME < 2.0, 1.0, second_half)
    assert dots(0.3 * size * np.sin(2.0 * np.pi * 273.0 * TIME)) == expected


@pytest.mark.parametrize(("spread", "expected"), [(0.008, 1), (0.012, 0)])
def test_samples_that_spread_by_less_than_a_hundredth_of_the_swing_are_one_dot(spread: float, expected: int) -> None:
    # the RMS of a sine of size 2 sqrt(2) s is 2 s: the share s of the swing of 2
    assert dots(2.0 * np.sqrt(2.0) * spread * np.sin(2.0 * np.pi * 273.0 * TIME)) == expected


@pytest.mark.parametrize(("share", "expected"), [(0.2, 2), (0.3, 0)])
def test_two_dots_spread_by_less_than_a_quarter_of_their_distance(share: float, expected: int) -> None:
    flip = 0.3 * np.cos(2.0 * np.pi * 100.0 * TIME)  # RMS 0.3 at the samples: it changes its sign at each tooth
    ring = np.sqrt(2.0) * 0.3 * share / np.sqrt(1.0 - share**2) * np.sin(2.0 * np.pi * 273.0 * TIME)
    assert dots(flip + ring) == expected


def test_a_harmonic_is_five_lines_wide() -> None:
    """The window of the spectrum spreads a line over two to each side."""
    signs = chatter_signs(TEETH, STEP, speed=3000.0, teeth=4)
    near = signs.harmonic & (np.abs(signs.spectrum.frequency - 200.0) < 50.0)
    assert np.count_nonzero(near) == 5


def test_sixteen_teeth_are_enough() -> None:
    def signs(teeth: float) -> int:
        values = TEETH[: round(50 * teeth) + 1]
        return chatter_signs(values, STEP, speed=3000.0, teeth=4, start=0.0).samples.size

    assert signs(16.0) == 16
    with pytest.raises(ParameterError, match="lasts 15 teeth: at least 16 are needed"):
        signs(15.9)


# comparison: half a percent is a tie


@pytest.mark.parametrize(("worse", "places"), [(1.004, [1, 1]), (1.006, [1, 2])])
def test_laws_within_half_a_percent_share_a_place(worse: float, places: list[int]) -> None:
    assert ranks(ROPE_SNAP, [{ROPE_SNAP.key: 1.0}, {ROPE_SNAP.key: worse}]) == places
    assert beats(ROPE_SNAP, 1.0, worse) is (places == [1, 2])


def test_an_axis_without_limits_is_pulled_with_100_n_and_settles_within_half_a_micrometer_or_ten_counts() -> None:
    def duty(resolution: float) -> Duty:
        axis = Axis(plant=Rigid(mass=50.0, viscous=100.0), encoder_load=Encoder(resolution=resolution))
        return duty_of(Loop(sample_time=1e-3, control=Control(law=CascadePPI(Kv=20.0, Kp=1e3, Tn=0.02)), axis=axis))

    assert duty(1e-9).force == 100.0
    assert duty(1e-9).near == 0.5e-6
    assert duty(1e-6).near == pytest.approx(1e-5)


# friction: a curve that leaves more than 15 % of the force is advised against


def friction_curve(share: float, error: float = 0.0, stribeck: float | None = None) -> Any:
    """A curve that leaves a share of the force, from six runs up to 0.5 m/s in each direction."""
    velocity = np.array([0.01, 0.02, 0.03, 0.1, 0.2, 0.5])
    force = np.repeat([100.0, -100.0], 6)
    return SimpleNamespace(
        frame=TABLE,
        residual=share * force,
        runs=SimpleNamespace(force=force, velocity=np.append(velocity, -velocity)),
        estimates=(SimpleNamespace(name="coulomb", value=100.0, error=error),),
        values={} if stribeck is None else {"stribeck_velocity": stribeck},
    )


@pytest.mark.parametrize(("share", "why"), [(0.14, ""), (0.16, "the curve leaves 16 % of the force")])
def test_a_curve_that_leaves_more_than_15_percent_is_kept_away(share: float, why: str) -> None:
    assert str(kept_away(friction_curve(share), None)) == why


@pytest.mark.parametrize(("error", "why"), [(45.0, ""), (55.0, "coulomb is known to 55 % only")])
def test_a_level_that_is_known_to_less_than_half_is_open(error: float, why: str) -> None:
    assert str(kept_away(friction_curve(0.05, error), None)) == why


@pytest.mark.parametrize(
    ("stribeck", "why"),
    [
        (0.025, ""),  # two runs in each direction are slower
        (0.015, "fewer than 2 runs in a direction are slower than the Stribeck velocity, 0.015 m/s"),
        (0.44, ""),
        (0.46, "the Stribeck velocity came out at the fastest run, 0.46 m/s"),
    ],
)
def test_a_stribeck_velocity_is_seen_between_the_second_and_the_fastest_run(stribeck: float, why: str) -> None:
    told = str(kept_away(friction_curve(0.05, 0.0, stribeck), None))
    assert told.startswith(why)
    assert bool(told) == bool(why)


# tuning on a measurement: what makes it too poor


def measured(noise: float = 0.0, gain: Any = None, last: float = 400.0, gap: float = 1.0) -> Any:
    """L = 50 Hz / (j f) on lines up to `last`, without those by a factor `gap` around 30 Hz; noise: k sigma / |1+L|."""
    f = np.geomspace(1.0, last, 400)
    f = f[(f < 30.0) | (f > 30.0 * gap)]
    L = 50.0 / (1j * f) if gain is None else gain(f)
    variance = 2.0 * (noise * np.abs(1.0 + L) / 3.0) ** 2  # 3 sigma are that share of the distance to -1
    point = SimpleNamespace(
        frequency=f, name="X", loop=None, sample_time=1e-4, variance=np.ones((2, f.size)), by_force=np.ones((2, f.size))
    )
    return SimpleNamespace(point=point, gain=L, gain_variance=variance)


def test_noise_may_take_half_of_the_distance_to_the_critical_point() -> None:
    require_good([measured(noise=0.45)], 3.0)
    with pytest.raises(NotIdentifiableError, match=r"too noisy from 1 to 148\.5 Hz"):
        require_good([measured(noise=0.55)], 3.0)


def test_noise_counts_up_to_three_times_the_crossover() -> None:
    for begin, counts in ((145.0, True), (155.0, False)):
        answer = measured(noise=0.6)
        answer.gain_variance = np.where(answer.point.frequency > begin, answer.gain_variance, 0.0)
        if counts:
            with pytest.raises(NotIdentifiableError, match="too noisy"):
                require_good([answer], 3.0)
        else:
            require_good([answer], 3.0)


@pytest.mark.parametrize(("last", "fits"), [(155.0, True), (145.0, False)])
def test_lines_go_up_to_three_times_the_crossover(last: float, fits: bool) -> None:
    answer = measured(last=last)
    if fits:
        require_covered([answer])
    else:
        with pytest.raises(NotIdentifiableError, match=r"ends at 145 Hz, where the loop gain is still 0\.34"):
            require_covered([answer])


@pytest.mark.parametrize(("last_gain", "fits"), [(0.29, True), (0.31, False)])
def test_or_until_the_loop_gain_is_below_a_third(last_gain: float, fits: bool) -> None:
    answer = measured(last=100.0, gain=lambda f: np.where(f < 50.0, 50.0 / (1j * f), -1j * last_gain))
    if fits:
        require_covered([answer])
    else:
        with pytest.raises(NotIdentifiableError, match=r"where the loop gain is still 0\.31"):
            require_covered([answer])


@pytest.mark.parametrize(("gap", "fits"), [(1.55, True), (1.68, False)])
def test_neighboring_lines_near_the_crossover_are_at_most_a_factor_of_1_6_apart(gap: float, fits: bool) -> None:
    answer = measured(gap=gap)
    if fits:
        require_covered([answer])
    else:
        with pytest.raises(NotIdentifiableError, match=r"has no lines from 29\.77 to 51\.12 Hz"):
            require_covered([answer])


@pytest.mark.parametrize(("first", "fits"), [(24.0, True), (26.0, False)])
def test_the_crossover_is_at_least_twice_the_first_line(first: float, fits: bool) -> None:
    answer = measured()
    keep = answer.point.frequency >= first
    answer.point.frequency, answer.gain = answer.point.frequency[keep], answer.gain[keep]
    if fits:
        require_covered([answer])
    else:
        with pytest.raises(NotIdentifiableError, match="begins at 26"):
            require_covered([answer])


# margins, guard


@pytest.mark.parametrize("decibels", [0.3, 0.9, 6.0])
def test_a_gain_margin_is_told_however_small(decibels: float) -> None:
    """L = k / (jf (1 + jf/10)²) turns by 180° at 10 Hz, where its size is k/20."""
    f = np.geomspace(0.5, 100.0, 2000)
    k = 20.0 * 10.0 ** (-decibels / 20.0)
    loop_gain = FRF(f, k / (1j * f * (1.0 + 0.1j * f) ** 2), 1e-5)
    assert margins(loop_gain).gain_increase_dB == pytest.approx(decibels, abs=1e-3)  # between two lines


def guard_steps(positions: np.ndarray, enable: np.ndarray, setpoints: np.ndarray, **parts: Any) -> list[Any]:
    """Steps of a guard at 1 kHz, as (state, verdict)."""
    guard, zero = Guard(**parts), 0.0
    prepared = guard.prepare(1e-3)
    setpoint = Setpoint(float(setpoints[0]), zero, zero, zero, zero)
    state = guard.start(prepared, setpoint, positions[0], positions[0], zero)
    steps: list[Any] = []
    for position, on, wanted in zip(positions.tolist(), enable.tolist(), setpoints.tolist(), strict=True):
        setpoint = Setpoint(wanted, zero, zero, zero, zero)
        state, verdict = guard.step(prepared, state, setpoint, position, position, on)
        steps.append((state, verdict))
    return steps


def test_the_velocity_at_enable_is_smoothed_over_32_samples() -> None:
    """An axis that begins to move evenly: travel(k) = v T (1 - (31/32)^k)."""
    k = np.arange(40)
    steps = guard_steps(1e-4 * k, np.zeros(40), 1e-4 * k)
    velocities = [verdict.velocity for _, verdict in steps]
    np.testing.assert_allclose(velocities, 0.1 * (1.0 - (31.0 / 32.0) ** k), rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("velocity", [0.0, 0.5, 2.0])
@pytest.mark.parametrize(("error", "trips"), [(0.99e-3, False), (1.01e-3, True)])
def test_the_bound_of_the_following_error_does_not_depend_on_the_velocity(
    velocity: float, error: float, trips: bool
) -> None:
    """Of 1 mm at any speed: the error builds up over the move, in steps below the bound."""
    k = np.arange(60)
    setpoints = velocity * 1e-3 * k
    positions = setpoints - error * np.minimum(k / 40.0, 1.0)
    steps = guard_steps(positions, np.ones(60), setpoints, following_error_limit=1e-3)
    assert (steps[-1][0].mode == -TRIP_FOLLOWING_ERROR) == trips


# terms of equations


def test_the_gpi_observer_starts_with_a_disturbance_that_balances_the_force() -> None:
    """An axis at rest under a force of 60 N feels -60 N, and stays so: x and v are at rest in all samples."""
    observer = GpiObserver(mass=20.0, omega_o=400.0)
    prepared = observer.prepare(1e-3)
    reading = Reading(position_motor=0.1, position_load=0.1, velocity=0.0, applied=60.0)
    state = observer.start(prepared, reading)
    for _ in range(50):
        state, estimate = observer.step(prepared, state, reading, 1e-3)
        assert estimate.disturbance == pytest.approx(-60.0, rel=1e-9)
        assert estimate.position == pytest.approx(0.1, rel=1e-12)
        assert estimate.velocity == pytest.approx(0.0, abs=1e-10)


@pytest.mark.parametrize("m12", [0.0, 3.0, -2.0])
def test_the_axial_mode_of_two_bodies_is_the_eigenvalue_of_their_matrices(m12: float) -> None:
    bodies = TwoBodies(m11=30.0, m12=m12, m22=50.0, c11=0.0, c12=0.0, c22=0.0, k=4e7)
    mass, stiffness = np.array([[30.0, m12], [m12, 50.0]]), 4e7 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    mode = np.sqrt(np.linalg.eigvals(np.linalg.solve(mass, stiffness)).real.max())
    assert bodies.mode == pytest.approx(mode, rel=1e-12)


def test_the_predicted_error_of_a_prefilter_is_the_second_power_of_theta() -> None:
    """theta(s)² x up to the snap: t1² a + 2 t1 t2 j + (2 t1 t3 + t2²) s, column by column."""
    t1, t2, t3 = 2e-3, 3e-6, 5e-9
    columns = {"a": t1 * t1, "j": 2.0 * t1 * t2, "s": 2.0 * t1 * t3 + t2 * t2}
    zero = np.zeros(3)
    for place, (_, factor) in enumerate(columns.items()):
        derivatives = [zero, zero, *(np.ones(3) if i == place else zero for i in range(3))]
        fit = PrefilterFit(
            theta={"velocity": t1, "acceleration": t2, "jerk": t3},
            standard_error={},
            condition=1.0,
            present=TrajectoryPrefilter(),
            time=np.arange(3.0),
            error=np.full(3, 7e-6),
            explained=np.full(3, 2e-6),
            setpoint=Setpoint(*derivatives),
            counted=np.ones(3, bool),
        )
        np.testing.assert_allclose(fit.predicted, 5e-6 + factor, rtol=1e-12)
