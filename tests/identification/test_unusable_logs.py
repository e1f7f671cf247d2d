"""Logs that are no motion of a drive: each ends with a reason, none with a traceback."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import foreign_axis as foreign
from feeddrive.identification.motion.identify import identify_motion
from feeddrive.identification.motion.motion_log import (
    MotionLog,
    Preparation,
    _stretches,
    count_of,
    prepare,
    reach,
    spread,
)
from feeddrive.identification.motion.rigid import find_delay, identify_rigid
from feeddrive.language.errors import FeeddriveError, LogError, NotIdentifiableError

ROWS = 10000


def unusable(name: str, T: float = 1e-3) -> tuple[np.ndarray, np.ndarray]:
    """Position in m and force in N of a log by name."""
    random, t = np.random.default_rng(0), np.arange(ROWS) * T
    noise = random.standard_normal(ROWS)
    match name.split():
        case ["sine", frequency]:
            w = 2.0 * np.pi * float(frequency)
            force = -95.0 * 1e-3 * w * w * np.sin(w * t) + 20.0 * np.sign(np.cos(w * t)) + noise
            return 1e-3 * np.sin(w * t), force
        case ["rest"]:
            return 5e-8 * np.round(0.4 * random.standard_normal(ROWS)), noise
        case ["one", "count"]:
            return np.where(np.arange(ROWS) == ROWS // 2, 5e-8, 0.0), noise
        case ["noise"]:
            return random.standard_normal(ROWS), noise
        case ["frequencies"]:  # a frequency response without its header: lines in Hz and a magnitude
            return np.geomspace(1.0, 1000.0, ROWS), np.exp(-np.arange(ROWS) / 1000.0) * noise
        case ["jump"]:
            return np.where(t > 0.5 * t[-1], 1.0, 0.0), noise
        case ["one", "force"]:
            return 1e-2 * np.sin(2.0 * np.pi * t), np.where(np.arange(ROWS) == 0, 1e-9, 0.0)
        case _:
            return 1e300 * np.sin(2.0 * np.pi * t), 1e300 * np.cos(2.0 * np.pi * t)


NAMES = ("sine 20", "sine 35", "sine 100", "rest", "one count", "noise", "frequencies", "jump", "one force", "huge")


@pytest.mark.parametrize("T", [1e-3, 5e-5], ids=["1 kHz", "20 kHz"])
@pytest.mark.parametrize("name", NAMES)
def test_what_is_no_motion_is_refused_with_a_reason(name: str, T: float) -> None:
    for work in (identify_motion, identify_rigid, find_delay):
        position, force = unusable(name, T)
        if work is find_delay and name == "frequencies":
            continue  # a motion in one direction tells a delay, and no mass
        with pytest.raises(FeeddriveError):
            work(MotionLog(name=name, position=position, force=force, sample_time=T))


def test_the_reason_is_the_right_one() -> None:
    def refused(name: str) -> str:
        position, force = unusable(name)
        with pytest.raises(NotIdentifiableError) as caught:
            find_delay(MotionLog(name=name, position=position, force=force, sample_time=1e-3))
        return str(caught.value)

    assert "one frequency" in refused("sine 20")
    assert "rows are left where the axis moves" in refused("sine 35")
    assert "rows are left where the axis moves" in refused("rest")


@pytest.mark.parametrize("rows", [0, 20])
def test_friction_that_holds_an_axis_is_no_second_clock(rows: int) -> None:
    """A circle at the table's encoder: near its reversals the force changes while friction holds the table.

    With all rows the force seems to act 12 samples before it was logged. A force that was logged `rows` samples late,
    10 ms, is refused as before.
    """
    T = 5e-4
    table = foreign.Axes(
        mass=269.3,
        mass_load=93.5,
        stiffness=1.288e7,
        damping=3135.0,
        viscous=1279.0,
        coulomb_positive=322.0,
        coulomb_negative=404.0,
        gravity=-215.5,
        offset=11.7,
        dead_time=5.5e-4,
        resolution=1.9e-7,
        resolution_load=2.4e-7,
        noise_log=22.4,
        noise_drive=6.7,
    )
    law = foreign.Cascade(Kv=37.9, Kp=60428.0, rate=36.2, ff=0.509, n=1, friction_ff=225.6)
    rng = np.random.default_rng(5)
    path = foreign.circle(T, 0.029, 0.32, 2.13, 0.27)[1]
    channels = foreign.simulate(table, law, path, T, rng).log(0)
    log = MotionLog(
        name="circle",
        position=channels["position_load"],
        force=np.roll(channels["force"], rows),
        set_position=channels["setpoint"],
        sample_time=T,
    )
    if rows == 0:
        assert abs(find_delay(log).dead_time - 1.1) < 2.0 * find_delay(log).error
        return
    with pytest.raises(NotIdentifiableError, match="are not synchronised"):
        find_delay(log)


def test_a_log_at_20_khz_is_decimated_by_a_filter_that_is_stable() -> None:
    """Eighth order, edge at 0.4 % of Nyquist: as one polynomial its rounding explodes; a slow sine passes unchanged."""
    from feeddrive.identification.motion.motion_log import decimated

    t = np.arange(100000) * 5e-5
    wave = np.sin(2.0 * np.pi * 2.0 * t)
    # ripple of 0.05 dB forth and back: 1.2 % at most
    kept = slice(20, -20)
    np.testing.assert_allclose(decimated(wave, 200)[kept], wave[199::200][kept], atol=0.012)


# ---------------------------------------------------------------- what decides: a case on either side of each bound


def motion(position: np.ndarray, force: np.ndarray, T: float = 1e-3, **more: Any) -> MotionLog:
    return MotionLog(name="log", position=position, force=force, sample_time=T, **more)


def ramp(rows: int = 500) -> np.ndarray:
    return 1e-5 * np.arange(float(rows))


def humming(rows: int = 500) -> np.ndarray:
    """A force of ±1 with a gentle wave, so that no value repeats."""
    k = np.arange(float(rows))
    return np.where(k % 20 < 10, 1.0, -1.0) * (1.0 + 1e-3 * np.sin(k))


@pytest.mark.parametrize(("rows", "enough"), [(70, False), (140, True)])
def test_a_log_has_a_hundred_rows(rows: int, enough: bool) -> None:
    if enough:
        assert motion(ramp(rows), humming(rows)).position.size == rows
        return
    with pytest.raises(LogError, match="at least 100"):
        motion(ramp(rows), humming(rows))


@pytest.mark.parametrize(("size", "fits"), [(0.7e100, True), (1.5e100, False)])
def test_a_channel_stays_within_1e100(size: float, fits: bool) -> None:
    """Its square does not overflow."""
    position = size * ramp() / ramp()[-1]
    if fits:
        assert np.isfinite(np.sum(motion(position, humming()).position ** 2))
        return
    with pytest.raises(LogError, match="reaches"):
        motion(position, humming())


@pytest.mark.parametrize(("times", "rows", "spike"), [(4.0, 1, False), (7.0, 1, True), (7.0, 3, True), (7.0, 5, False)])
def test_up_to_three_samples_of_five_times_the_usual_force_are_a_spike(times: float, rows: int, spike: bool) -> None:
    """Of 2000 rows even five are far fewer than the hundredth that the usual force leaves out."""
    force = humming(2000)
    force[1000 : 1000 + rows] = times * (1.0 + 1e-3 * np.arange(rows))
    if not spike:
        assert motion(ramp(2000), force).force.size == 2000
        return
    with pytest.raises(NotIdentifiableError, match="1 spike"):
        motion(ramp(2000), force)


def test_the_usual_force_is_that_of_99_percent_of_the_rows() -> None:
    """Pulses of ten times the force at rest in a tenth of the rows are what the axis does, and no spikes."""
    force = 0.1 * humming(2000)
    force[::20] *= 10.0
    force[1::20] *= 10.0
    assert motion(ramp(2000), force).force.size == 2000


@pytest.mark.parametrize(
    ("rows", "off", "jump"), [(500, 3.2, False), (500, 5.0, True), (5000, 5.2, False), (5000, 8.0, True)]
)
def test_a_row_three_steps_or_a_thousandth_of_the_travel_off_is_a_jump(rows: int, off: float, jump: bool) -> None:
    """Of 500 steps a thousandth is half of one, of 5000 it is five; the median beside the row is one step nearer."""
    position = ramp(rows)
    position[rows // 2] += off * 1e-5
    if not jump:
        assert motion(position, humming(rows)).position.size == rows
        return
    with pytest.raises(NotIdentifiableError, match="1 jump"):
        motion(position, humming(rows))


def with_lost_rows(times: int, share: float = 1.0, off: float = 0.0) -> np.ndarray:
    """A ramp, and one of a share of its speed in which `times` steps are 2 + `off` usual ones."""
    k = np.arange(1000.0)
    # the speed swings slowly, so that the readings stand on no counts
    steps = np.where(k < 500, 1e-5, 1e-5 * share) * (1.0 + 0.05 * np.sin(0.01 * k))
    steps[600 : 600 + 50 * times : 50] *= 2.0 + off
    return np.cumsum(steps)


@pytest.mark.parametrize(("share", "seen"), [(0.2, False), (0.5, True)])
def test_lost_rows_show_from_three_tenths_of_the_fastest_step_on(share: float, seen: bool) -> None:
    position = with_lost_rows(3, share)
    if not seen:
        assert motion(position, humming(1000)).position.size == 1000
        return
    with pytest.raises(NotIdentifiableError, match="rows were lost: after row"):
        motion(position, humming(1000))


@pytest.mark.parametrize(("off", "lost"), [(0.2, True), (0.4, False)])
def test_a_step_over_a_lost_row_is_a_whole_number_of_usual_ones_to_a_quarter(off: float, lost: bool) -> None:
    position = with_lost_rows(3, off=off)
    if not lost:
        assert motion(position, humming(1000)).position.size == 1000
        return
    with pytest.raises(NotIdentifiableError, match="3 such rows, 3 rows lost"):
        motion(position, humming(1000))


@pytest.mark.parametrize(("times", "with_set", "refused"), [(1, False, False), (2, False, True), (1, True, True)])
def test_one_such_step_is_enough_where_the_set_position_has_it_too(times: int, with_set: bool, refused: bool) -> None:
    position = with_lost_rows(times)
    goal = position + 1e-5 if with_set else None
    if not refused:
        assert motion(position, humming(1000), set_position=goal).position.size == 1000
        return
    with pytest.raises(NotIdentifiableError, match="rows were lost"):
        motion(position, humming(1000), set_position=goal)


def test_a_set_position_without_the_step_speaks_against_lost_rows() -> None:
    position = with_lost_rows(3)
    goal = np.linspace(position[0], position[-1], position.size)
    assert motion(position, humming(1000), set_position=goal).position.size == 1000


@pytest.mark.parametrize(("times", "fits"), [(1.03, True), (1.08, False)])
def test_a_force_5_percent_beyond_its_limit_was_not_under_it(times: float, fits: bool) -> None:
    force = 0.9 * humming()
    force[250] = times
    if fits:
        assert motion(ramp(), force, force_limit=1.0).force_limit == 1.0
        return
    with pytest.raises(NotIdentifiableError, match="beyond the limit of"):
        motion(ramp(), force, force_limit=1.0)


@pytest.mark.parametrize(("rows", "fits"), [(15, True), (31, False)])
def test_a_force_at_its_limit_in_1_percent_of_the_rows_is_saturated(rows: int, fits: bool) -> None:
    force = 0.9 * humming(2000)
    force[500 : 500 + rows] = 1.0
    if fits:
        assert motion(ramp(2000), force).force.size == 2000
        return
    with pytest.raises(NotIdentifiableError, match="of the rows"):
        motion(ramp(2000), force)


@pytest.mark.parametrize(("off", "counted"), [(0.035, True), (0.08, False)])
def test_readings_within_a_twentieth_of_a_count_stand_on_it(off: float, counted: bool) -> None:
    levels = np.arange(101.0)
    levels[50] += off
    assert count_of(levels) == (1.0 if counted else 0.0)


def test_the_spread_of_runs_is_averaged_over_51_rows() -> None:
    runs = np.zeros((4, 2, 201))
    runs[:, :, 100] = np.arange(4.0)[:, None]
    assert np.count_nonzero(spread(runs)[0] > 1e-12) == 51


@pytest.mark.parametrize(("rows", "enough"), [(450, False), (700, True)])
def test_forty_rows_of_ten_milliseconds_are_left_after_the_ends_are_cut(rows: int, enough: bool) -> None:
    """Fifty samples are cut at each end, and a row has ten."""
    log = motion(np.cumsum(ramp(rows)), humming(rows))
    if enough:
        assert prepare(log, Preparation()).force.size >= 40
        return
    with pytest.raises(LogError, match="400 are needed"):
        prepare(log, Preparation())


@pytest.mark.parametrize(("speed", "pieces"), [(3.5e-3, 2), (8e-3, 1)])
def test_an_axis_slower_than_half_a_percent_of_its_top_speed_rests(speed: float, pieces: int) -> None:
    velocity = np.repeat([1.0, speed, 1.0], 200)
    assert len(_stretches(velocity, slice(0, 600), 12)) == pieces


def test_the_low_pass_of_the_position_shows_a_stop_for_12_ms() -> None:
    """At 100 Hz and samples of a millisecond, until a hundredth of it is left."""
    assert reach(0.1) == 12
