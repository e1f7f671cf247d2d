"""The motions of a commissioning against their closed forms: speeds, accelerations, rests, lines and pulses in time."""

from __future__ import annotations

import numpy as np
import pytest

from feeddrive.commissioning import motions
from feeddrive.commissioning.motions import Pace

T = 1e-3  # s
PACE = Pace(speed=0.1, acceleration=2.0)


def at_top_speed(position: np.ndarray, speed: float) -> np.ndarray:
    """The rows at which set positions move with the speed, to a thousandth."""
    return np.flatnonzero(np.abs(np.gradient(position, T) - speed) < 1e-3 * abs(speed))


# moves


@pytest.mark.parametrize("distance", [0.05, -0.05])
def test_a_move_has_the_speed_and_acceleration_of_its_pace_and_30_ms_to_the_full_acceleration(distance: float) -> None:
    position = motions.moved(distance, PACE, T)
    assert position[0] == 0.0
    assert position[-1] == pytest.approx(distance, rel=1e-12)
    first, second, third = (np.max(np.abs(np.diff(position, order))) / T**order for order in (1, 2, 3))
    assert first == pytest.approx(0.1, rel=1e-6)
    # differences over 1 ms of a corner of the acceleration
    assert second == pytest.approx(2.0, rel=1e-3)
    assert third == pytest.approx(2.0 / 0.03, rel=1e-3)


def test_no_move_is_one_row() -> None:
    assert list(motions.moved(0.0, PACE, T)) == [0.0]


def test_a_path_rests_for_a_quarter_of_a_second_before_between_and_after() -> None:
    position = motions.path([(0.02, PACE), (0.01, Pace(0.01, 2.0))], T)
    changes = np.flatnonzero(np.diff(np.diff(position) == 0.0))
    begin, end, second, last = changes
    assert position[0] == 0.0
    assert position[-1] == 0.01
    # a move begins and ends with steps of its own
    assert [begin, second - end, position.size - last] == pytest.approx([250, 250, 250], abs=2)
    # 0.28 s for 20 mm at 100 mm/s, and 1 s for 10 mm at 10 mm/s
    assert last - second > 3 * (end - begin)
    assert float(np.min(np.diff(position))) == pytest.approx(-0.01 * T, rel=1e-6)


def test_a_profile_says_its_speed_and_adds_no_force_of_its_own() -> None:
    position = motions.path([(0.02, PACE)], T)
    made = motions.profile("there", position, T)
    assert made.sample_time == T
    assert np.array_equal(made.set_position, position)
    assert not np.any(made.excitation)
    assert np.max(made.velocity) == pytest.approx(0.1, rel=1e-6)
    assert motions.profile("nothing", np.zeros(1), T).velocity[0] == 0.0


# the push


def test_a_push_has_nine_lines_from_8_to_24_hz_of_one_size_that_repeat_every_half_second() -> None:
    made = motions.push(motions.push_distance(PACE), PACE, 50.0, T)
    assert made.period == 500
    assert list(made.lines / (made.period * T)) == [8.0, 10.0, 12.0, 14.0, 16.0, 18.0, 20.0, 22.0, 24.0]
    force = made.profile.excitation
    whole = force[made.first : made.first + 4 * made.period].reshape(4, made.period)
    assert np.allclose(whole, whole[0], rtol=0.0, atol=1e-9)
    assert float(np.max(np.abs(force))) == pytest.approx(50.0, rel=1e-12)
    sizes = np.abs(np.fft.rfft(whole[0]))
    assert np.ptp(sizes[made.lines]) < 1e-9 * sizes[made.lines[0]]
    assert np.max(np.delete(sizes, made.lines)) < 1e-9 * sizes[made.lines[0]]


def test_a_push_swells_and_fades_over_a_period_each_so_that_it_begins_and_ends_at_nothing() -> None:
    made = motions.push(motions.push_distance(PACE), PACE, 50.0, T)
    force = made.profile.excitation
    active = np.flatnonzero(force)
    assert active[0] >= made.first - made.period
    assert active[-1] + 1 == pytest.approx(made.first + 5 * made.period, abs=2)
    assert np.max(np.abs(force[active[0] : active[0] + 50])) < 0.03 * 50.0
    assert np.max(np.abs(force[active[-1] - 50 :])) < 0.03 * 50.0


@pytest.mark.parametrize("pace", [PACE, Pace(0.02, 0.5), Pace(0.3, 3.0)])
def test_the_axis_slides_evenly_as_long_as_it_is_pushed_and_comes_back(pace: Pace) -> None:
    distance = motions.push_distance(pace)
    made = motions.push(distance, pace, 50.0, T)
    even = at_top_speed(made.profile.set_position, pace.speed)
    active = np.flatnonzero(made.profile.excitation)
    assert even[0] <= active[0]
    # rounding of the times of the ramp and of the periods to samples
    assert even[-1] >= active[-1] - 3
    assert made.profile.set_position[-1] == pytest.approx(distance, rel=1e-12)
    back = made.back(T)
    assert back.set_position[-1] == pytest.approx(-distance, rel=1e-12)
    assert not np.any(back.excitation)


# strokes


def test_strokes_come_back_from_each_of_five_speeds_and_slow_ones_are_short() -> None:
    made = motions.strokes(0.2, PACE, T)
    position = made.set_position
    assert position[0] == position[-1] == 0.0
    speed = np.abs(np.gradient(position, T))
    # between two rests at the beginning lies a stroke
    rests = np.flatnonzero((np.abs(position) < 1e-12) & (speed == 0.0))
    cuts = np.flatnonzero(np.diff(rests) > 10)
    strokes = [slice(rests[cut], rests[cut + 1]) for cut in cuts]
    assert [np.max(position[stroke]) for stroke in strokes] == pytest.approx([0.2, 0.1, 0.04, 0.01, 0.002])
    tops = [float(np.max(speed[stroke])) for stroke in strokes]
    assert tops == pytest.approx([0.1, 0.05, 0.02, 0.005, 0.001], rel=1e-3)


# the trial


def test_a_trial_pushes_for_a_tenth_of_a_second_after_as_long_of_even_motion() -> None:
    made = motions.trial(0.1, PACE, 30.0, T)
    force, position = made.pushed.excitation, made.pushed.set_position
    assert np.array_equal(made.alone.set_position, position)
    assert not np.any(made.alone.excitation)
    active = np.flatnonzero(force)
    assert active[0] == made.pulsed.start
    assert active.size == 100
    even = at_top_speed(position, 0.1)
    assert (active[0] - even[0]) * T == pytest.approx(0.1, abs=3.0 * T)
    # edges of 2 ms: a third, two thirds, and all of it
    assert force[active[:3]] == pytest.approx([10.0, 20.0, 30.0])
    assert force[active[-3:]] == pytest.approx([30.0, 20.0, 10.0])
    assert made.pulsed.stop - made.pulsed.start == 150
    assert even[-1] >= made.pulsed.start
    assert position[0] == position[-1] == 0.0


def test_a_trial_rests_for_six_tenths_of_a_second_of_which_the_last_two_thirds_count() -> None:
    made = motions.trial(0.1, PACE, 30.0, T)
    position = made.alone.set_position
    begin = int(np.argmax(position != 0.0))
    assert begin == pytest.approx(600, abs=2)
    assert (made.rest.start, made.rest.stop) == (200, 600)
    assert made.moving.start == 600
    assert np.ptp(position[made.rest]) == 0.0
    assert position.size - made.moving.stop == 600


@pytest.mark.parametrize("pace", [PACE, Pace(0.5, 4.0), Pace(0.01, 1.0)])
def test_over_the_least_travel_the_axis_moves_evenly_until_the_pulse_has_decayed(pace: Pace) -> None:
    made = motions.trial(motions.least_travel(pace), pace, 30.0, T)
    even = at_top_speed(made.alone.set_position[: made.moving.stop], pace.speed)
    assert even[0] < made.pulsed.start
    assert even[-1] >= made.pulsed.stop - 3
    # and it is the least: a fifth of a second of even motion is not added in vain
    assert even[-1] <= made.pulsed.stop + 200


def test_a_weaker_pulse_is_the_same_in_time() -> None:
    made = motions.trial(0.1, PACE, 30.0, T)
    weaker = made.weaker(10.0)
    assert weaker.force == 10.0
    assert weaker.pushed.excitation == pytest.approx(made.pushed.excitation / 3.0)
    assert np.array_equal(weaker.pushed.set_position, made.pushed.set_position)
    assert (weaker.rest, weaker.moving, weaker.pulsed) == (made.rest, made.moving, made.pulsed)
