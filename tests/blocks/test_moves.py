"""Moves: limits, distance, symmetry and continuity over random parameters; closed forms; what is refused."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from feeddrive.blocks.reference.bezier10 import Bezier10
from feeddrive.blocks.reference.boxcars import limited_profile
from feeddrive.blocks.reference.jerk_limited_move import JerkLimitedMove
from feeddrive.blocks.reference.polynomial7 import Polynomial7
from feeddrive.blocks.reference.profile import Profile
from feeddrive.blocks.reference.snap_limited_move import SnapLimitedMove
from feeddrive.blocks.reference.trapezoidal_move import TrapezoidalMove
from feeddrive.blocks.signals import Setpoint
from feeddrive.language.errors import ParameterError, StructureError

NAMES = ("velocity", "acceleration", "jerk", "snap")
LIMITED = {2: TrapezoidalMove, 3: JerkLimitedMove, 4: SnapLimitedMove}
decades = st.floats(-5.0, 6.0).map(lambda exponent: 10.0**exponent)
distances = st.floats(-9.0, 1.0).map(lambda exponent: 10.0**exponent)  # m; with the limits above never over 1e7 s


def limited(limits: tuple[float, ...], distance: float, **others: float) -> SnapLimitedMove:
    return LIMITED[len(limits)](distance=distance, **dict(zip(NAMES, limits, strict=False)), **others)


def around_switches(move: SnapLimitedMove) -> np.ndarray:
    """Switch times, the numbers next to them, and times in between."""
    assert move.profile is not None
    switches = np.append(move.profile.starts, move.duration)
    near = [switches, np.nextafter(switches, -np.inf), np.nextafter(switches, np.inf)]
    return np.unique(np.concatenate([*near, np.linspace(0.0, move.duration, 97)]))


@settings(max_examples=300)
@given(st.lists(decades, min_size=2, max_size=4), distances, st.booleans())
def test_any_limits_are_kept_and_the_distance_is_exact(given_limits: list[float], distance: float, forward: bool):
    limits = tuple(given_limits)
    move = limited(limits, distance if forward else -distance, start=0.25)
    t = around_switches(move)
    rows = move.at(t)
    for name, limit in zip(NAMES, limits, strict=False):
        # 1e-12: roots and products of the lengths are rounded a few times each
        assert np.max(np.abs(getattr(rows, name))) <= limit * (1.0 + 1e-12), name
    sense = 1.0 if forward else -1.0
    assert np.all(sense * rows.velocity >= -1e-12 * limits[0])
    assert move.at(np.array([-1.0, 0.0])).position.tolist() == [0.25, 0.25]
    after = move.at(np.array([move.duration, move.duration + 1.0]))
    assert after.position.tolist() == [0.25 + move.distance] * 2
    assert all(np.all(row == 0.0) for row in after[1:])


@settings(max_examples=300)
@given(st.lists(decades, min_size=2, max_size=4), distances)
def test_all_derivatives_below_the_limited_ones_are_continuous(given_limits: list[float], distance: float):
    move = limited(tuple(given_limits), distance)
    assert move.profile is not None
    switches = np.append(move.profile.starts, move.duration)
    before, after = move.at(np.nextafter(switches, -np.inf)), move.at(switches)
    reached = dict(zip(("position", *NAMES), (distance, *move.profile.peaks), strict=False))
    orders = list(reached)
    for name, above in pairwise(orders):
        jump = np.max(np.abs(getattr(after, name) - getattr(before, name)))
        # times are known to a rounding of the duration, in which the next derivative changes this one
        assert jump <= 4.0 * np.spacing(move.duration) * reached[above] + 1e-13 * reached[name], name


@settings(max_examples=200)
@given(st.lists(decades, min_size=2, max_size=4), distances)
def test_a_limited_move_is_its_own_mirror_image_in_time(given_limits: list[float], distance: float):
    move = limited(tuple(given_limits), distance)
    t = np.linspace(0.0, move.duration, 101)
    there, back = move.at(t), move.at(move.duration - t)
    slack = 4.0 * np.spacing(move.duration) * move.profile.peaks[0] + 1e-13 * distance  # type: ignore[union-attr]
    np.testing.assert_allclose(there.position + back.position, distance, rtol=0, atol=slack)
    for order, name in enumerate(NAMES[: len(given_limits) - 2], 1):
        peak, above = move.profile.peaks[order - 1 : order + 1]  # type: ignore[union-attr]
        slack = 4.0 * np.spacing(move.duration) * above + 1e-12 * peak
        mirrored = getattr(back, name) * (1.0 if order % 2 else -1.0)
        np.testing.assert_allclose(getattr(there, name), mirrored, rtol=0, atol=slack)


@pytest.mark.parametrize("count", [2, 3, 4])
def test_with_all_limits_reached_the_velocity_is_the_convolution_of_boxcars(count: int):
    limits = (0.4, 4.0, 100.0, 10000.0)[:count]
    move = limited(limits, 0.2)
    ratios = (0.2 / 0.4, 0.4 / 4.0, 4.0 / 100.0, 100.0 / 10000.0)[:count]
    assert move.profile is not None
    np.testing.assert_allclose(move.profile.lengths[::-1], ratios, rtol=1e-14)
    dt = 1e-4  # all ratios are multiples of it
    velocity = np.full(round(ratios[0] / dt), 0.4)
    for length in ratios[1:]:
        velocity = np.convolve(velocity, np.full(round(length / dt), dt / length))
    # a cell stands for its middle, so `count` cells start at count/2 cells
    t = (0.5 * count + np.arange(velocity.size)) * dt
    # midpoint rule, for each convolution dt²/24 of the second derivative; of the trapezoid only its kinks
    bound = count * dt**2 / 24.0 * limits[2] if count > 2 else 0.5 * dt * limits[1]
    assert np.max(np.abs(move.at(t).velocity - velocity)) <= bound * 1.001


@pytest.mark.parametrize("count", [2, 3, 4])
def test_without_other_limits_the_time_is_that_of_the_highest_limit_alone(count: int):
    top, distance = 70.0, 0.3
    limits = (*(1e5, 1e6, 1e7)[: count - 1], top)
    closed = {
        2: 2.0 * (distance / top) ** 0.5,
        3: (32.0 * distance / top) ** (1 / 3),
        4: 8.0 * (distance / top / 8) ** 0.25,
    }
    assert limited(limits, distance).duration == pytest.approx(closed[count], rel=1e-14)


def test_the_snap_limited_family_costs_seven_percent_at_most_against_the_shortest_move_of_all():
    """The least T of a fourth-order chain obeys T⁴ = 384 D/s: the L1 norm of the best monic cubic, 1/4 on [-1, 1]."""
    move = limited((1e5, 1e6, 1e7, 70.0), 0.3)
    assert 1.07 < move.duration / (384.0 * 0.3 / 70.0) ** 0.25 < 1.08


@settings(max_examples=60)
@given(st.lists(decades, min_size=2, max_size=4), distances, st.integers(0, 2**32))
def test_no_other_boxcars_within_the_limits_are_shorter(given_limits: list[float], distance: float, seed: int):
    limits = np.array(given_limits)
    profile = limited_profile("move", distance, tuple(given_limits))
    randoms = np.random.default_rng(seed)
    for _ in range(50):
        spread = randoms.choice([0.01, 0.1, 1.0, 3.0])
        lengths: list[float] = []
        for length in profile.lengths:
            lengths.append(max(sum(lengths), length * np.exp(spread * randoms.normal())))
        peaks = distance / np.cumprod(lengths[::-1])
        stretch = np.max((peaks / limits) ** (1.0 / np.arange(1, limits.size + 1)))  # the least that keeps all limits
        assert stretch * sum(lengths) >= profile.duration * (1.0 - 1e-12)


@pytest.mark.parametrize("limits", [(0.5, 4.0, 60.0), (5.0, 4.0, 60.0), (0.5, 40.0, 60.0)])
def test_no_jerk_limited_motion_goes_farther_in_the_same_time(limits: tuple[float, ...]):
    """A linear program over jerks that are constant in 240 cells finds the largest distance within the limits."""
    move = limited(limits, 0.3)
    cells = 240
    dt = move.duration / cells
    steps = np.tril(np.ones((cells, cells)))
    acceleration = dt * steps
    velocity = dt * (steps @ acceleration - 0.5 * acceleration)
    after = dt * np.arange(cells - 1, -1, -1)
    reach = dt * (0.5 * after**2 + 0.5 * after * dt + dt**2 / 6.0)
    bounded = np.vstack([acceleration, -acceleration, velocity, -velocity])
    sizes = np.repeat([limits[1], limits[1], limits[0], limits[0]], cells)
    ends = np.vstack([acceleration[-1], velocity[-1]])
    found = linprog(-reach, bounded, sizes, ends, [0.0, 0.0], bounds=(-limits[2], limits[2]))
    # limits hold at the ends of cells only, and switches lie inside of them: second order in the cell
    assert -found.fun == pytest.approx(0.3, rel=1e-3)


def test_a_move_out_and_back_stands_where_and_as_long_as_it_says():
    move = SnapLimitedMove(
        distance=-0.1,
        velocity=0.2,
        acceleration=3,
        jerk=100,
        snap=5000,
        start=0.05,
        back=True,
        dwell_before=0.1,
        dwell_between=0.2,
        dwell_after=0.3,
    )
    leg = move.leg_time
    assert move.duration == pytest.approx(0.1 + leg + 0.2 + leg + 0.3, rel=1e-15)
    at = move.at(np.array([0.05, 0.1, 0.1 + leg, 0.2 + leg, 0.3 + leg - 1e-9, move.duration - 0.3, move.duration + 9]))
    assert at.position.tolist() == [0.05, 0.05, 0.05 - 0.1, 0.05 - 0.1, 0.05 - 0.1, 0.05, 0.05]
    assert at.velocity.tolist() == [0.0] * 7
    there = move.at(0.1 + np.linspace(0.01, leg - 0.01, 50))
    home = move.at(0.3 + leg + np.linspace(0.01, leg - 0.01, 50))
    np.testing.assert_allclose(there.position + home.position, 0.05 + (0.05 - 0.1), atol=1e-16)
    for name in NAMES:
        # both legs are the same polynomials; their local times differ by the rounding of t
        np.testing.assert_allclose(getattr(home, name), -getattr(there, name), rtol=1e-9, atol=1e-9)
    assert replace(move, dwell_between=None).duration == pytest.approx(0.1 + leg + 0.3 + leg + 0.3, rel=1e-15)


@given(st.permutations(range(40)))
@settings(max_examples=20)
def test_times_may_come_in_any_order(order: list[int]):
    move = SnapLimitedMove(
        distance=0.1, velocity=0.2, acceleration=3, jerk=100, snap=5000, back=True, dwell_between=0.1
    )
    t = np.linspace(-0.1, move.duration + 0.1, 40)
    for straight, shuffled in zip(move.at(t), move.at(t[order]), strict=True):
        assert np.array_equal(straight[order], shuffled)


def test_what_is_impulsive_is_reported_as_zero():
    t = np.linspace(0.0, 2.0, 1001)
    jerky = JerkLimitedMove(distance=0.1, velocity=0.2, acceleration=3, jerk=100).at(t)
    assert np.any(jerky.jerk != 0.0)
    assert np.all(jerky.snap == 0.0)
    trapezoid = TrapezoidalMove(distance=0.1, velocity=0.2, acceleration=3).at(t)
    assert set(np.unique(trapezoid.acceleration)) == {-3.0, 0.0, 3.0}
    assert np.all(trapezoid.jerk == 0.0)
    assert np.all(trapezoid.snap == 0.0)


def test_within_a_piece_the_backward_velocity_is_the_difference_of_positions():
    move = SnapLimitedMove(distance=0.1, velocity=0.2, acceleration=3, jerk=100, snap=5000)
    T = 1e-4
    t = np.arange(0.0, move.duration, T)
    rows = move.at(t)
    differences = np.diff(rows.position) / T
    assert move.profile is not None
    same = np.searchsorted(move.profile.starts, t, "right")
    clean = same[1:] == same[:-1]
    # a rounding of 0.1 m over T
    assert np.max(np.abs(rows.backward_velocity(T)[1:] - differences)[clean]) < 4 * np.spacing(0.1) / T


def test_bezier_peaks_are_those_of_the_golden_facts():
    tau = np.linspace(0.0, 1.0, 900_001)
    rows = Bezier10(distance=1, travel_time=1).at(tau)
    assert np.max(rows.velocity) == pytest.approx(2.601824, abs=5e-7)
    assert tau[np.argmax(rows.velocity)] == pytest.approx(4 / 9, abs=1e-6)
    assert np.max(np.abs(rows.acceleration)) == pytest.approx(11.058, abs=5e-4)
    assert rows.position[-1] == 1.0


@pytest.mark.parametrize(
    ("kind", "coefficients"),
    [
        (Polynomial7, [0, 0, 0, 0, 35, -84, 70, -20]),
        (Bezier10, [0, 0, 0, 0, 0, 252, -1050, 1800, -1575, 700, -126]),
    ],
)
def test_polynomials_are_those_of_the_papers(kind: type[Polynomial7], coefficients: list[float]):
    polynomial = np.polynomial.Polynomial(coefficients)
    tau = np.linspace(0.0, 1.0, 401)[:-1]
    rows = kind(distance=-0.3, travel_time=0.7, start=1.0).at(0.7 * tau)
    for order, row in enumerate(rows):
        expected = (polynomial.deriv(order) if order else polynomial)(tau) * -0.3 / 0.7**order + (
            1.0 if order == 0 else 0.0
        )
        size = 0.3 / 0.7**order * np.sum(np.abs(polynomial.deriv(order).coef if order else polynomial.coef))
        # the plain polynomial cancels digits: roundings of its largest terms
        np.testing.assert_allclose(row, expected, rtol=0, atol=1e-14 * size)


def test_the_seventh_degree_peaks_where_its_docstring_says():
    rows = Polynomial7(distance=1, travel_time=1).at(np.array([0.5, 0.5 - 0.5 / 5**0.5, 0.0]))
    assert rows.velocity[0] == pytest.approx(35 / 16, rel=1e-14)
    assert rows.acceleration[1] == pytest.approx(84 / (5 * 5**0.5), rel=1e-14)
    assert rows.jerk[0] == pytest.approx(-52.5, rel=1e-14)
    assert rows.snap[2] == pytest.approx(840, rel=1e-14)


@pytest.mark.parametrize("kind", [Polynomial7, Bezier10])
def test_a_distance_of_zero_is_a_dwell(kind: type[Polynomial7]):
    still = kind(distance=0, travel_time=0.7, start=0.2, dwell_after=0.1)
    assert still.duration == pytest.approx(0.8, rel=1e-15)
    rows = still.at(np.linspace(-1.0, 2.0, 31))
    assert np.all(rows.position == 0.2)
    assert all(np.all(row == 0.0) for row in rows[1:])


def test_a_limited_move_over_no_distance_takes_no_time():
    still = SnapLimitedMove(distance=0, velocity=1, acceleration=1, jerk=1, snap=1, start=0.2)
    assert still.duration == 0.0
    rows: Setpoint = still.at(np.array([-1.0, 0.0, 1.0]))
    assert rows.position.tolist() == [0.2, 0.2, 0.2]  # type: ignore[attr-defined]
    assert all(np.all(row == 0.0) for row in rows[1:])


GOOD = {"distance": 0.1, "velocity": 0.2, "acceleration": 3.0, "jerk": 100.0, "snap": 5000.0}


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"velocity": -0.2}, r"snap_limited_move\.velocity = -0\.2 m/s .* must be > 0 m/s"),
        ({"acceleration": 0.0}, "must be > 0"),
        ({"snap": float("nan")}, "must be a finite number"),
        ({"distance": float("inf")}, "must be a finite number"),
        ({"distance": 1e7}, "<= 1000000 m"),
        ({"dwell_after": -1.0}, ">= 0 s"),
        ({"back": "yes"}, "must be one of False, True"),
        ({"velocity": 1e-12}, "would take 1e.11 s"),
        ({"dwell_before": 1e8}, "would take 1e.08 s"),
        ({"velocity": 1e-300, "snap": 1e300}, "too far apart"),
        ({"velocity": np.array([0.1, 0.2])}, "holds variants"),
    ],
)
def test_what_is_refused(wrong: dict[str, float], words: str):
    with pytest.raises((ParameterError, StructureError), match=words):
        SnapLimitedMove(**(GOOD | wrong))  # type: ignore[arg-type]


@given(st.lists(st.floats(5e-324, 1.7e308), min_size=4, max_size=4), st.floats(-1e6, 1e6))
@settings(max_examples=300)
def test_absurd_numbers_give_a_move_or_an_error_but_never_nonsense(limits: list[float], distance: float):
    try:
        move = limited(tuple(limits), distance)
    except StructureError:
        return
    rows = move.at(np.linspace(0.0, move.duration, 33))
    assert all(np.all(np.isfinite(row)) for row in rows)
    assert np.max(np.abs(rows.velocity)) <= limits[0] * (1.0 + 1e-9)


def test_a_profile_that_breaks_a_limit_is_not_handed_out():
    profile = Profile(0.1, (0.02, 0.03, 0.06, 0.5))
    velocity, acceleration, jerk, snap = profile.peaks
    profile.check("move", profile.peaks)
    for place, name in enumerate(NAMES):
        limits = [velocity, acceleration, jerk, snap]
        limits[place] *= 0.999
        with pytest.raises(StructureError, match=f"its {name} reaches"):
            profile.check("move", limits)


def test_a_profile_whose_ramps_overlap_is_not_handed_out():
    with pytest.raises(StructureError, match=r"not continuous|reaches"):
        Profile(0.1, (0.02, 0.03, 0.06, 0.08)).check("move", (9.0, 9.0, 9.0, 9.0))


@pytest.mark.parametrize(("excess", "kept"), [(0.75e-9, True), (1.5e-9, False)])
def test_a_limit_is_kept_to_a_billionth(excess: float, kept: bool) -> None:
    """Rounding of pieces of unequal length is far below it, and a violation that matters far above."""
    profile = Profile(1.0, (0.5, 2.0))  # velocity 1/2, acceleration 1
    limits = (0.5 / (1.0 + excess), 1.0)
    if kept:
        profile.check("move", limits)
    else:
        with pytest.raises(StructureError, match="velocity reaches"):
            profile.check("move", limits)
