"""What the first moves tell, on logs in closed form and of a foreign simulator: sign, mass, friction, gear."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import foreign_axis as fa
from feeddrive.commissioning import motions
from feeddrive.commissioning.first_facts import ratio_by_ruler, rough_mass, small_move
from feeddrive.commissioning.motions import Pace, Push
from feeddrive.files.log import Log
from feeddrive.language.errors import NotIdentifiableError

T = 1e-3  # s
PACE = Pace(speed=0.02, acceleration=0.5)


def log_of(**channels: np.ndarray) -> Log:
    rows = next(iter(channels.values())).size
    return Log(name="drive", time=T * np.arange(rows), channels=channels, units={}, sample_time=T)


# a slow move

MOVE = motions.path([(0.01, PACE), (0.0, PACE)], T)


def moved(mass: float = 0.0, coulomb: float = 40.0, held: float = 0.0, lag: float = 0.02, follows: float = 1.0) -> Log:
    """A rigid axis that follows a move `lag` s late in its speed, with gravity and Coulomb friction."""
    speed = np.gradient(MOVE, T)
    reading = follows * (MOVE - lag * speed)
    force = held + coulomb * np.sign(speed) + mass * np.gradient(speed, T)
    return log_of(set_position=MOVE, reading_load=5.0 + reading, force=force)


def test_the_weight_is_the_mean_of_both_directions_and_friction_half_their_difference() -> None:
    told = small_move(moved(mass=300.0, coulomb=40.0, held=700.0))
    assert told.holding == pytest.approx(700.0, rel=1e-9)
    assert told.friction == pytest.approx(40.0, rel=1e-9)


def test_a_force_that_counts_against_positions_shows_in_the_sign_of_the_friction() -> None:
    log = moved(held=-700.0)
    told = small_move(log_of(**{**log.channels, "force": -log["force"]}))
    assert told.holding == pytest.approx(700.0, rel=1e-9)
    assert told.friction == pytest.approx(-40.0, rel=1e-9)


def test_the_lag_is_the_following_error_over_the_speed() -> None:
    # the fifth decimal of the position is the rounding of its differences
    assert small_move(moved(lag=0.03)).lag == pytest.approx(0.03, rel=1e-3)
    assert small_move(moved(lag=-0.001)).lag == 0.0


def test_the_resistance_is_the_largest_force_of_the_even_motion() -> None:
    """Friction, weight and cogging together, both ways."""
    log = moved(coulomb=40.0, held=-100.0)
    cogging = 20.0 * np.sin(2.0 * np.pi * MOVE / 2e-3)
    told = small_move(log_of(**{**log.channels, "force": log["force"] + cogging}))
    # a thousandth of the rows may lie above it
    assert told.resistance == pytest.approx(160.0, rel=0.01)
    assert told.holding == pytest.approx(-100.0, rel=0.02)


def test_the_noise_is_that_of_the_reading_at_rest() -> None:
    rng = np.random.default_rng(3)
    log = moved()
    noisy = log["reading_load"] + 2e-6 * rng.standard_normal(len(log))
    # 250 rows of rest: a standard deviation is known to 4.5 %
    assert small_move(log_of(**{**log.channels, "reading_load": noisy})).noise == pytest.approx(2e-6, rel=0.15)


@pytest.mark.parametrize("follows", [0.55, 1.0, 1.8])
def test_a_reading_that_makes_more_than_half_of_the_set_travel_follows(follows: float) -> None:
    assert small_move(moved(follows=follows, lag=0.0)).friction == pytest.approx(40.0)


@pytest.mark.parametrize("follows", [0.45, 2.2, 0.0, -1.0])
def test_a_reading_that_stands_still_or_runs_away_does_not(follows: float) -> None:
    with pytest.raises(NotIdentifiableError, match=r"the drive does not follow, .*0x6064"):
        small_move(moved(follows=follows, lag=0.0))


def test_only_rows_above_nine_tenths_of_the_speed_are_even_motion() -> None:
    """A long ramp to the speed, whose force is that of the mass, and a short stop."""
    ramp, even, stop = 1000, 200, 20
    speed = 0.02 * np.concatenate(
        [np.zeros(200), np.arange(ramp) / ramp, np.ones(even), 1.0 - np.arange(stop) / stop, np.zeros(200)]
    )
    speed = np.concatenate([speed, -speed])
    target = np.cumsum(speed) * T
    slopes = np.gradient(speed, T)
    told = small_move(
        log_of(set_position=target, reading_load=target, force=10.0 * np.sign(speed) + 1000.0 * np.abs(slopes))
    )
    # of 300 rows 200 are even; below 0.83 of the speed those of the ramp would be more
    assert told.holding == pytest.approx(0.0, abs=1e-6)
    assert told.friction == pytest.approx(10.0)


# a push


def pushed(masses: np.ndarray, sign: float = 1.0) -> tuple[Log, Push]:
    """The log of a push under which each line moves a mass of its own: X = -F / (M w^2)."""
    made = motions.push(motions.push_distance(PACE), PACE, 60.0, T)
    force = made.profile.excitation
    spectrum = np.fft.rfft(force[made.first : made.first + made.period])
    omega = 2.0 * np.pi * made.lines / (made.period * T)
    moves = np.zeros(spectrum.size, complex)
    moves[made.lines] = -spectrum[made.lines] / (masses * omega**2)
    wave = np.tile(np.fft.irfft(moves, made.period), 20)
    rows = np.arange(force.size) - made.first
    reading = made.profile.set_position + wave[rows % made.period]
    return log_of(force=sign * force, reading_load=reading, excitation=force), made


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_mass_and_the_sign_of_the_force_are_those_of_a_free_mass(sign: float) -> None:
    """The straight line that is taken off four periods takes 2 per mille of the lowest line, and a 64th of that off 24
    Hz.
    """
    rough = rough_mass(*pushed(np.full(9, 85.0), sign))
    assert rough.mass == pytest.approx(85.0, rel=2e-3)
    assert rough.force_sign == sign
    assert rough.scatter < 2e-3


def spread(share: float) -> np.ndarray:
    """Masses of the nine lines, the middle one of 100 kg, the others a share above or below it."""
    return 100.0 * (1.0 + share * np.array([1, -1, 1, -1, 0, 1, -1, 1, -1]))


def test_lines_that_scatter_by_less_than_half_of_the_mass_are_a_rough_mass() -> None:
    rough = rough_mass(*pushed(spread(0.45)))
    assert rough.mass == pytest.approx(100.0, rel=1e-2)
    assert rough.scatter == pytest.approx(0.45, rel=1e-2)


def test_lines_that_scatter_by_more_contradict_each_other() -> None:
    with pytest.raises(NotIdentifiableError, match=r"masses from 44.9 kg to 158 kg: .*0x6077"):
        rough_mass(*pushed(spread(0.55)))


def test_an_axis_that_no_force_moves_has_no_mass() -> None:
    log, made = pushed(np.full(9, 85.0))
    rng = np.random.default_rng(5)
    idle = made.profile.set_position + 1e-6 * rng.standard_normal(len(log))
    with pytest.raises(NotIdentifiableError, match="does not move the axis as a mass"):
        rough_mass(log_of(force=log["force"], reading_load=idle, excitation=log["excitation"]), made)


@cache
def foreign() -> tuple[fa.Logs, Push]:
    """A push of four axes under a P-PI of their drives; a frame is a row."""
    pace = Pace(speed=0.05, acceleration=0.5)
    made = motions.push(motions.push_distance(pace), pace, 120.0, T)
    axes = fa.Axes(
        mass=np.array([60.0, 60.0, 150.0, 25.0]),
        coulomb_positive=np.array([0.0, 60.0, 80.0, 30.0]),
        coulomb_negative=np.array([0.0, 60.0, 80.0, 30.0]),
        viscous=np.array([0.0, 200.0, 100.0, 300.0]),
        gravity=np.array([0.0, -400.0, 0.0, 200.0]),
        dead_time=np.array([0.0, 1e-3, 1e-3, 2e-3]),
        noise_log=2.0,
        resolution=1e-7,
    )
    # position loops of 3 to 5 Hz, whose velocity loops are eight times as fast
    wn = np.array([20.0, 20.0, 30.0, 25.0])
    law = fa.Cascade(Kv=wn, Kp=8.0 * wn * axes.mass, rate=15.0, ff=1.0)
    rng = np.random.default_rng(11)
    return fa.simulate(
        axes, law, made.profile.set_position, T, rng, count=4, added=made.profile.excitation, substeps=2
    ), made


@pytest.mark.parametrize("axis", range(4))
@pytest.mark.parametrize("sign", [1, -1])
def test_the_mass_of_a_foreign_axis_that_slides_is_known_to_three_percent(axis: int, sign: int) -> None:
    """Whatever its drive's control does: the force that it reports is all that moves the axis but friction and weight.

    The dead time takes 1 - cos(2 pi f Td) of the mass, 3 % at 16 Hz and 2.5 ms, the time from a reading to the middle
    of the force that acts.
    """
    logs, made = foreign()
    assert logs.stable[axis]
    log = logs.log(axis)
    rough = rough_mass(
        log_of(force=sign * log["force"], reading_load=log["position"], excitation=made.profile.excitation), made
    )
    assert rough.force_sign == sign
    assert rough.mass == pytest.approx(logs.true("mass", axis), rel=0.03)
    assert rough.scatter < 0.03


def test_a_slow_move_of_a_foreign_axis_that_hangs_tells_weight_friction_and_lag() -> None:
    axes = fa.Axes(
        mass=60.0, viscous=200.0, coulomb_positive=50.0, coulomb_negative=50.0, gravity=-400.0, resolution=1e-8
    )
    law = fa.Cascade(Kv=20.0, Kp=8000.0, rate=20.0)
    log = fa.simulate(axes, law, MOVE, T, np.random.default_rng(2), substeps=2).log(0)
    told = small_move(log_of(set_position=MOVE, reading_load=log["position"], force=log["force"]))
    # 200 N s/m at 20 mm/s beside Coulomb friction
    assert told.friction == pytest.approx(54.0, rel=0.01)
    assert told.holding == pytest.approx(400.0, rel=0.01)
    # a position loop of 1/Kv, settled but for a few per cent when the move is at its even speed for half a second
    assert told.lag == pytest.approx(0.05, rel=0.05)


# a ruler


def test_a_ruler_is_good_for_a_fifth_of_a_millimetre_and_a_protractor_for_a_tenth_of_a_degree() -> None:
    # 0.2 mm and 0.5 % of 30 mm are 1.17 %; 2 mrad and 0.5 % of 1 rad are 0.7 %
    assert ratio_by_ruler(0.03 * 1.011, 0.03) == 1.0
    assert ratio_by_ruler(0.03 * 1.013, 0.03) == pytest.approx(1.013)
    assert ratio_by_ruler(1.0065, 1.0, rotary=True) == 1.0
    assert ratio_by_ruler(1.0075, 1.0, rotary=True) == pytest.approx(1.0075)


def test_half_a_percent_of_a_long_way_is_read_besides() -> None:
    assert ratio_by_ruler(4.018, 4.0) == 1.0
    assert ratio_by_ruler(4.024, 4.0) == pytest.approx(1.006)


def test_any_other_ratio_is_taken_as_it_was_measured() -> None:
    assert ratio_by_ruler(0.0124, 0.01002) == pytest.approx(0.0124 / 0.01002)


def test_a_move_against_the_counts_is_negative() -> None:
    assert ratio_by_ruler(-0.01, 0.01) == pytest.approx(-1.0)
