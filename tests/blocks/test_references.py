"""References that are no moves: exact derivatives, spectra, circles, logs, shapers, sequences; and what is refused."""

from __future__ import annotations

from functools import partial
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.signal import chirp as scipy_chirp

from feeddrive.blocks.catalogue import catalogue
from feeddrive.blocks.families import Reference
from feeddrive.blocks.reference.bezier10 import Bezier10
from feeddrive.blocks.reference.chirp import Chirp
from feeddrive.blocks.reference.circle import Circle
from feeddrive.blocks.reference.input_shaped import InputShaped
from feeddrive.blocks.reference.jerk_limited_move import JerkLimitedMove
from feeddrive.blocks.reference.linear_move import LinearMove
from feeddrive.blocks.reference.multisine import Multisine
from feeddrive.blocks.reference.polynomial7 import Polynomial7
from feeddrive.blocks.reference.pulses import SHAPERS, pulses
from feeddrive.blocks.reference.recorded import Recorded
from feeddrive.blocks.reference.sequence import Sequence
from feeddrive.blocks.reference.sine import Sine
from feeddrive.blocks.reference.snap_limited_move import SnapLimitedMove
from feeddrive.blocks.reference.trapezoidal_move import TrapezoidalMove
from feeddrive.language.errors import ParameterError, StructureError

NAMES = ("position", "velocity", "acceleration", "jerk", "snap")
MOVE = SnapLimitedMove(distance=0.1, velocity=0.2, acceleration=3, jerk=100, snap=5000, start=0.02)
ROW = 0.01 * np.sin(np.linspace(0.0, 3.0, 301)) ** 2
EXAMPLES: dict[str, Reference] = {
    "snap_limited_move": MOVE,
    "jerk_limited_move": JerkLimitedMove(distance=-0.1, velocity=0.2, acceleration=3, jerk=100, back=True),
    "trapezoidal_move": TrapezoidalMove(distance=0.1, velocity=0.2, acceleration=3, dwell_after=0.1),
    "polynomial7": Polynomial7(distance=0.1, travel_time=0.4, back=True, dwell_between=0.1),
    "bezier10": Bezier10(distance=-0.1, travel_time=0.4, dwell_before=0.1),
    "linear_move": LinearMove(distance=-0.1, travel_time=0.4, dwell_before=0.1),
    "sine": Sine(amplitude=0.01, frequency=5, cycles=4, center=0.3, blend_time=0.15),
    "circle": Circle(radius=0.03, feed=0.1, turns=2.5, phase=90, center=-0.1, run_up_time=0.3),
    "multisine": Multisine(amplitude=1e-3, lowest=2, highest=40, period=0.5, periods=2, blend_time=0.2),
    "chirp": Chirp(amplitude=1e-3, first_frequency=2, last_frequency=60, sweep_time=2.0),
    "recorded": Recorded(position=ROW, sample_time=1e-3),
    "input_shaped": InputShaped(reference=MOVE, shaper="ei", frequency=30, damping=0.05),
    "sequence": Sequence(references=(MOVE, Circle(radius=0.03, feed=0.1), Polynomial7(distance=-0.1, travel_time=0.2))),
}
# times at which a derivative jumps, besides those of the snap itself
JUMPS = {
    "sine": [0.0, 0.15, 0.65, 0.8],
    "circle": [0.0, 0.3, EXAMPLES["circle"].duration - 0.3, EXAMPLES["circle"].duration],
    "multisine": [0.0, 0.2, 1.2, 1.4],
    "chirp": [0.0, 0.2, 1.8, 2.0],
    "polynomial7": [0.0, 0.4, 0.5, 0.9],
    "bezier10": [0.1, 0.5],
    "linear_move": [0.1, 0.5],
}


def test_every_reference_has_an_example_here():
    assert set(EXAMPLES) == set(catalogue()[Reference])


@pytest.mark.parametrize("kind", EXAMPLES)
def test_all_answer_in_arrays_and_rest_outside(kind: str):
    reference = EXAMPLES[kind]
    end = reference.duration
    rows = reference.at(np.array([-2.0, -1.0, end + 1.0, end + 2.0]))
    for name in NAMES:
        row = getattr(rows, name)
        assert isinstance(row, np.ndarray)
        assert row.dtype == np.float64
        assert row.shape == (4,)
        if name == "position":
            assert row[0] == row[1]
            assert row[2] == row[3]
        else:
            assert np.all(row == 0.0), name


@pytest.mark.parametrize("kind", sorted(set(EXAMPLES) - {"recorded"}))
def test_every_derivative_is_the_slope_of_the_one_below(kind: str):
    """Seventh-point differences of order 6 over h, away from jumps.

    Their error is h⁶/140 times the seventh derivative, which 1e-7 of the peak holds, and roundings of the row over h.
    """
    reference = EXAMPLES[kind]
    h = reference.duration * 2e-5
    t = np.random.default_rng(1).uniform(0.0, reference.duration, 3000)
    rows = [reference.at(t + k * h) for k in range(-3, 4)]
    weights = np.array([-1.0, 9.0, -45.0, 0.0, 45.0, -9.0, 1.0]) / (60.0 * h)
    if kind in JUMPS:
        calm = np.min(np.abs(t[:, None] - np.array(JUMPS[kind])), axis=1) > 4.0 * h
    else:  # pieces: all seven points lie in one, if the derivative that jumps agrees at both ends
        calm = np.full(t.shape, True)
        for name in ("acceleration", "snap"):
            values = np.stack([getattr(row, name) for row in rows])
            calm &= np.ptp(values, axis=0) <= np.max(np.abs(values)) * 1e-2
        if kind == "jerk_limited_move":
            calm &= np.ptp(np.stack([row.jerk for row in rows]), axis=0) == 0.0
    assert np.mean(calm) > 0.9
    for below, name in pairwise(NAMES):
        slope = np.einsum("k,kn->n", weights, np.stack([getattr(row, below) for row in rows]))
        exact = getattr(rows[3], name)
        rounding = 8.0 * np.spacing(np.max(np.abs(getattr(rows[3], below)))) / h
        np.testing.assert_allclose(slope[calm], exact[calm], rtol=0, atol=1e-7 * np.max(np.abs(exact)) + rounding)


@pytest.mark.parametrize("kind", ["sine", "circle", "multisine", "chirp", "polynomial7", "bezier10"])
def test_smooth_ends_are_smooth_up_to_the_jerk(kind: str):
    reference, tiny = EXAMPLES[kind], 1e-9
    for place in JUMPS[kind]:
        before, after = (reference.at(np.array([place + side])) for side in (-tiny, tiny))
        for name, above in pairwise(NAMES):
            # over 2 ns a derivative changes by the next one times that
            jump = abs(getattr(after, name)[0] - getattr(before, name)[0])
            most = np.max(np.abs(getattr(reference.at(np.linspace(0.0, reference.duration, 999)), above)))
            assert jump <= 3.0 * tiny * most + 1e-15, (place, name)


def test_a_sine_without_blend_is_a_sine():
    reference = Sine(amplitude=0.01, frequency=7, cycles=3, center=0.5)
    t = np.linspace(0.0, 3 / 7, 500)[:-1]
    rows, rate = reference.at(t), 2 * np.pi * 7
    for order, name in enumerate(NAMES):
        expected = 0.01 * rate**order * np.sin(rate * t + 0.5 * np.pi * order) + (0.5 if order == 0 else 0.0)
        np.testing.assert_allclose(getattr(rows, name), expected, rtol=0, atol=1e-14 * rate**order)
    assert reference.at(np.array([reference.duration])).position[0] == 0.5


@pytest.mark.parametrize("direction", ["counterclockwise", "clockwise"])
def test_two_axes_draw_a_circle_at_the_feed(direction: str):
    common = {"radius": 0.05, "feed": 0.2, "turns": 3.0, "run_up_time": 0.4, "direction": direction}
    x, y = Circle(**common, center=0.1), Circle(**common, phase=90)
    t = np.linspace(-0.1, x.duration + 0.1, 4001)
    a, b = x.at(t), y.at(t)
    # a rounding of 0.1 m
    np.testing.assert_allclose(np.hypot(a.position - 0.1, b.position), 0.05, rtol=0, atol=4 * np.spacing(0.1))
    at_feed = (t > 0.4) & (t < x.duration - 0.4)
    np.testing.assert_allclose(np.hypot(a.velocity, b.velocity)[at_feed], 0.2, rtol=1e-13)
    np.testing.assert_allclose(np.hypot(a.acceleration, b.acceleration)[at_feed], 0.2**2 / 0.05, rtol=1e-12)
    turned = np.unwrap(np.arctan2(b.position, a.position - 0.1))
    assert turned[-1] == pytest.approx((1 if direction == "counterclockwise" else -1) * 6.0 * np.pi, rel=1e-13)
    assert x.duration == pytest.approx(6.0 * np.pi * 0.05 / 0.2 + 0.4, rel=1e-14)


def test_the_run_up_of_a_circle_takes_a_quarter_turn_if_nothing_is_said():
    circle = Circle(radius=0.05, feed=0.2, phase=90)
    run_up = np.pi * 0.05 / 0.2
    at = circle.at(np.array([run_up, 0.5 * circle.duration]))
    assert at.position[0] == pytest.approx(0.05, rel=1e-14)
    assert circle.at(np.array([run_up])).velocity[0] == pytest.approx(0.0, abs=1e-15)
    short = Circle(radius=0.05, feed=0.2, turns=0.25)
    assert short.duration == pytest.approx(2 * 0.25 * 2 * np.pi * 0.05 / 0.2, rel=1e-14)


@pytest.mark.parametrize("flat", ["position", "velocity", "acceleration"])
@pytest.mark.parametrize("phases", ["schroeder", "random"])
def test_a_multisine_has_its_lines_and_no_others(flat: str, phases: str):
    signal = Multisine(amplitude=2e-3, lowest=3, highest=90, period=0.5, flat=flat, phases=phases, seed=4, center=0.1)
    count = 1024
    rows = signal.at(np.arange(count) * (0.5 / count))
    spectrum = 2.0 * np.abs(np.fft.rfft(getattr(rows, flat) - (0.1 if flat == "position" else 0.0))) / count
    lines = np.arange(2, 46)  # 4 .. 90 Hz in steps of 2 Hz
    np.testing.assert_allclose(signal.frequencies(), 2.0 * lines)
    np.testing.assert_allclose(spectrum[lines], spectrum[2], rtol=1e-10)
    others = np.delete(spectrum, lines)
    assert np.max(others) < 1e-12 * spectrum[2] * count
    fine = signal.at(np.linspace(0.0, 0.5, 20001)[:-1]).position - 0.1
    assert 0.995 * 2e-3 <= np.max(np.abs(fine)) <= 2e-3
    assert abs(rows.position[0] - 0.1) < 4 * np.spacing(0.1)


def test_the_peak_of_a_multisine_is_bounded_from_a_grid_of_32_points_in_a_wave():
    """One line has its peak on the grid, so that it stays below the amplitude by all of Ehlich & Zeller's factor."""
    t = np.linspace(0.0, 1.0, 1001)
    row = Multisine(amplitude=1.0, lowest=1, highest=1, period=1).at(t).position
    assert np.max(np.abs(row)) == pytest.approx(np.cos(np.pi / 32.0), abs=1e-4)


def test_schroeder_phases_are_flatter_than_random_ones():
    def crest(phases: str) -> float:
        row = Multisine(amplitude=1, lowest=1, highest=100, period=1, phases=phases).at(np.arange(4096) / 4096).position
        return float(np.max(np.abs(row)) / np.sqrt(np.mean(row**2)))

    assert crest("schroeder") < 2.0 < crest("random")


def test_a_multisine_depends_on_its_seed_and_keeps_whole_periods_between_blends():
    common = {"amplitude": 1e-3, "lowest": 2.0, "highest": 50.0, "period": 0.5, "phases": "random"}
    t = np.linspace(0.0, 1.0, 400)[:-1]
    one = Multisine(**common, periods=2, seed=1).at(t)
    assert np.array_equal(one.position, Multisine(**common, periods=2, seed=1).at(t).position)
    assert np.max(np.abs(one.position - Multisine(**common, periods=2, seed=2).at(t).position)) > 1e-4
    blended = Multisine(**common, periods=2, seed=1, blend_time=0.3)
    assert blended.duration == pytest.approx(1.6)
    # times shifted by 0.3 s are rounded
    np.testing.assert_allclose(blended.at(t + 0.3).position, one.position, rtol=0, atol=1e-15)


@pytest.mark.parametrize(("spread", "expected"), [("linear", [10, 20, 30, 40]), ("logarithmic", [10, 16, 25, 40])])
def test_lines_are_spread_over_the_band(spread: str, expected: list[int]):
    signal = Multisine(amplitude=1, lowest=10, highest=40, period=1, lines=4, spread=spread)
    assert signal.frequencies().tolist() == expected


@pytest.mark.parametrize("sweep", ["linear", "logarithmic"])
@pytest.mark.parametrize(("first", "last"), [(2.0, 80.0), (80.0, 2.0), (20.0, 20.0)])
def test_a_chirp_is_that_of_scipy_between_its_blends(sweep: str, first: float, last: float):
    reference = Chirp(
        amplitude=0.01, first_frequency=first, last_frequency=last, sweep_time=3.0, sweep=sweep, blend_time=0.2
    )
    t = np.linspace(0.2, 2.8, 2000)
    expected = 0.01 * scipy_chirp(t, first, 3.0, last, method=sweep, phi=-90)
    # up to 250 rad: their rounding, times the amplitude, a few times
    np.testing.assert_allclose(reference.at(t).position, expected, rtol=0, atol=0.01 * 1000 * 4e-16)


@given(st.integers(0, 10**7), st.sampled_from([1e-3, 1e-4, 5e-5, 1 / 3000, 0.7]))
def test_a_log_gives_back_its_rows_at_every_sample(first: int, T: float):
    rows = np.random.default_rng(0).normal(size=(5, 40))
    log = Recorded(**dict(zip(NAMES, rows, strict=True)), sample_time=T)
    shift = first % 40
    k = np.arange(shift, 40)
    for name, row in zip(NAMES, rows, strict=True):
        assert np.array_equal(getattr(log.at(k * T), name), row[k])
        assert np.array_equal(getattr(log.at(np.cumsum(np.full(40, T)) - T), name), row)  # a clock that adds up


def test_a_long_log_is_exact_to_its_last_row():
    count, T = 3_000_000, 5e-5
    log = Recorded(position=np.arange(float(count)), sample_time=T)
    k = np.arange(count - 1000, count)
    assert np.array_equal(log.at(k * T).position, k.astype(float))
    with pytest.raises(StructureError, match="none at t = "):
        log.at((k + 1e-3)[:10] * T)


def test_the_backward_velocity_of_a_log_is_its_recorded_difference_to_the_bit():
    T = 1e-3
    rows = Recorded(position=ROW, sample_time=T).at(np.arange(ROW.size) * T)
    assert np.array_equal(rows.backward_velocity(T)[1:], np.diff(ROW) / T)
    assert rows.velocity[0] == 0.0


def test_times_between_rows_are_refused_or_interpolated_as_chosen():
    log = Recorded(position=ROW, sample_time=1e-3)
    with pytest.raises(StructureError, match=r'a row every 0\.001 s and none at t = 0\.0105 s.*between = "linear"'):
        log.at(np.array([0.01, 0.0105, 0.5]))
    T = 2.5e-4
    t = np.arange(4 * ROW.size - 3) * T
    rows = Recorded(position=ROW, sample_time=1e-3, between="linear").at(t)
    np.testing.assert_allclose(rows.position, np.interp(t, np.arange(ROW.size) * 1e-3, ROW), rtol=0, atol=1e-17)
    # the slope of the straight lines, as a law at the finer sample time differences them
    np.testing.assert_allclose(rows.velocity[1:], np.diff(rows.position) / T, rtol=0, atol=1e-13)
    assert np.array_equal(rows.position[::4], ROW)
    both = Recorded(position=ROW, velocity=10 * ROW, sample_time=1e-3, between="linear").at(t)
    np.testing.assert_allclose(both.velocity, 10 * rows.position, rtol=0, atol=1e-16)


@pytest.mark.parametrize(
    ("tables", "words"),
    [
        ({"velocity": [0.0, 1.0]}, "has 2 rows"),
        ({"acceleration": [0.0, 1.0, 2.0]}, "acceleration is given without recorded.velocity"),
        ({"velocity": [0.0, np.nan, 1.0]}, "not finite"),
        ({"sample_time": 0.0}, "> 0 s"),
        ({"position": [1.0]}, "at least two"),
    ],
)
def test_logs_that_do_not_fit_are_refused(tables: dict[str, list[float]], words: str):
    with pytest.raises((ParameterError, StructureError), match=words):
        Recorded(**({"position": [0.0, 1.0, 2.0], "sample_time": 1e-3} | tables))  # type: ignore[arg-type]


def ringing(reference: Reference, hertz: float, damping: float) -> float:
    """Amplitude (m) in which a mode with a base that follows the reference rings at its end; by solve_ivp."""
    rate = 2.0 * np.pi * hertz

    def slope(t: float, y: np.ndarray) -> list[float]:
        push = float(np.asarray(reference.at(np.array([t])).acceleration)[0])
        return [y[1], -push - 2.0 * damping * rate * y[1] - rate**2 * y[0]]

    y = solve_ivp(slope, (0.0, reference.duration), [0.0, 0.0], "DOP853", rtol=1e-8, atol=1e-13, max_step=2e-3).y[:, -1]
    return float(np.hypot(y[0], (y[1] + damping * rate * y[0]) / (rate * np.sqrt(1.0 - damping**2))))


QUICK = Polynomial7(distance=0.01, travel_time=0.06)


@pytest.mark.parametrize(("shaper", "damping"), [("zv", 0.0), ("zv", 0.1), ("zvd", 0.1), ("ei", 0.0)])
def test_a_shaped_motion_leaves_the_vibration_it_promises(shaper: str, damping: float):
    shaped = InputShaped(reference=QUICK, shaper=shaper, frequency=12.0, damping=damping, tolerance=0.05)
    alone, left = ringing(QUICK, 12.0, damping), ringing(shaped, 12.0, damping)
    assert alone > 1e-3
    if shaper == "ei":
        assert left == pytest.approx(0.05 * alone, rel=1e-5)
    else:
        assert left < 1e-6 * alone  # the tolerance of the integration


@pytest.mark.parametrize("ratio", [0.9, 1.1])
def test_off_its_frequency_zvd_leaves_the_square_of_what_zv_leaves(ratio: float):
    alone = ringing(QUICK, 12.0 * ratio, 0.0)
    left = {
        shaper: ringing(InputShaped(reference=QUICK, shaper=shaper, frequency=12.0, tolerance=0.05), 12.0 * ratio, 0.0)
        / alone
        for shaper in SHAPERS
    }
    swing = np.cos(0.5 * np.pi * ratio)
    assert left["zv"] == pytest.approx(abs(swing), rel=1e-5)
    assert left["zvd"] == pytest.approx(swing**2, rel=1e-4)
    assert left["ei"] == pytest.approx(abs(1.05 * np.cos(np.pi * ratio) + 0.95) / 2.0, abs=1e-5)
    assert left["zvd"] < left["zv"]
    assert left["ei"] < 0.05


@given(st.sampled_from(SHAPERS), st.floats(0.1, 500.0), st.floats(0.0, 0.9), st.floats(0.0, 0.5))
def test_pulses_are_positive_sum_to_one_and_cancel_the_mode(
    shaper: str, hertz: float, damping: float, tolerance: float
):
    heights, times = pulses(shaper, hertz, damping, tolerance)
    assert min(heights) > 0.0
    assert sum(heights) == pytest.approx(1.0, abs=4e-16)
    rate = 2.0 * np.pi * hertz
    pole = rate * complex(damping, np.sqrt(1.0 - damping**2))
    left = abs(sum(height * np.exp(pole * (time - times[-1])) for height, time in zip(heights, times, strict=True)))
    assert left <= (tolerance if shaper == "ei" else 0.0) * (1.0 + 1e-12) + 1e-14


def test_a_shaped_motion_keeps_the_limits_and_the_end_of_its_reference():
    shaped = InputShaped(reference=MOVE, shaper="zvd", frequency=17.0, damping=0.02)
    t = np.linspace(0.0, shaped.duration, 5001)
    rows, bare = shaped.at(t), MOVE.at(t)
    for name in NAMES[1:]:
        assert np.max(np.abs(getattr(rows, name))) <= np.max(np.abs(getattr(bare, name))) * (1.0 + 1e-12)
    assert shaped.at(np.array([shaped.duration])).position[0] == MOVE.at(np.array([MOVE.duration])).position[0]
    heights, times = shaped.pulses()
    for name in NAMES:
        summed = sum(height * getattr(MOVE.at(t - time), name) for height, time in zip(heights, times, strict=True))
        np.testing.assert_allclose(getattr(rows, name), summed, rtol=0, atol=1e-12 * np.max(np.abs(summed)))


def test_a_sequence_joins_each_to_the_end_of_the_last():
    first = Polynomial7(distance=0.1, travel_time=0.2, start=0.5)
    second = Circle(radius=0.02, feed=0.1, turns=1.25)
    log = Recorded(position=[3.0, 3.1, 3.2], sample_time=0.1, between="linear")
    joined = Sequence(references=(first, second, log))
    assert joined.duration == pytest.approx(0.2 + second.duration + 0.2)
    begins = 0.2 + second.duration
    near = joined.at(np.array([-1.0, 0.2, begins, begins + 0.1, joined.duration, joined.duration + 1.0]))
    # the circle goes from its right to its top: by (-radius) in x
    expected = [0.5, 0.6, 0.58, 0.68, 0.78, 0.78]
    np.testing.assert_allclose(near.position, expected, rtol=0, atol=1e-15)
    np.testing.assert_allclose(near.velocity, [0.0, 0.0, 0.0, 1.0, 1.0, 0.0], rtol=0, atol=1e-14)
    t = np.linspace(0.25, begins - 0.05, 50)
    np.testing.assert_allclose(joined.at(t).jerk, second.at(t - 0.2).jerk, rtol=1e-12)


@settings(max_examples=30)
@given(st.lists(st.floats(-0.2, 0.2).map(lambda distance: round(distance, 12)), min_size=1, max_size=6))
def test_a_sequence_of_moves_travels_the_sum_of_their_distances(distances: list[float]):
    moves = tuple(
        JerkLimitedMove(distance=distance, velocity=0.3, acceleration=2, jerk=50, dwell_after=0.1)
        for distance in distances
    )
    joined = Sequence(references=moves)
    t = np.arange(0.0, joined.duration + 0.2, 1e-3)
    rows = joined.at(t)
    assert rows.position[-1] == pytest.approx(sum(distances), abs=1e-15)
    assert rows.velocity[-1] == 0.0
    steps = np.abs(np.diff(rows.position))
    assert np.max(steps, initial=0.0) <= 0.3e-3 * (1.0 + 1e-9)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Sine(amplitude=1, frequency=1, blend_time=0.6), r"blend_time = 0\.6 s must be <= 0\.5 s"),
        (lambda: Sine(amplitude=1, frequency=1, cycles=0), ">= 1"),
        (lambda: Circle(radius=0.1, feed=1, turns=0.1, run_up_time=1), r"run_up_time = 1 s must be <= 0\.0628"),
        (lambda: Circle(radius=0.1, feed=1, phase=45), "must be one of 0, 90"),
        (
            lambda: Chirp(amplitude=1, first_frequency=1, last_frequency=2, sweep_time=1, blend_time=0.7),
            "half of the sweep",
        ),
        (lambda: Multisine(amplitude=1, lowest=5, highest=4, period=1), r"highest = 4 Hz must be >="),
        (lambda: Multisine(amplitude=1, lowest=1.1, highest=1.9, period=1), "no line"),
        (lambda: Multisine(amplitude=1, lowest=1, highest=1e6, period=1), "more than 20000"),
        (lambda: InputShaped(reference=QUICK, frequency=1, damping=1), "< 1"),
        (lambda: InputShaped(reference=QUICK, frequency=1e-9), "would take"),
        (lambda: InputShaped(reference=None, frequency=1), "must be a reference"),
        (lambda: Sequence(references=()), "at least one reference"),
        (lambda: Sequence(references=QUICK), "at least one reference"),
        (lambda: Sequence(references=(QUICK, None)), "at least one reference"),
    ],
)
def test_what_is_refused(make: object, words: str):
    with pytest.raises((ParameterError, StructureError), match=words):
        make()  # type: ignore[operator]


@pytest.mark.parametrize(("dwell", "admitted"), [(0.75e7, True), (1.5e7, False)])
def test_a_motion_of_more_than_four_months_is_in_a_wrong_unit(dwell: float, admitted: bool):
    make = partial(Polynomial7, distance=0.1, travel_time=1.0, dwell_after=dwell)
    if admitted:
        assert make().duration == dwell + 1.0
    else:
        with pytest.raises(StructureError, match="would take"):
            make()


@pytest.mark.parametrize(("beside", "is_row"), [(0.75e-6, True), (1.5e-6, False)])
def test_a_time_counts_as_that_of_a_row_within_a_millionth_of_their_spacing(beside: float, is_row: bool):
    log = Recorded(position=ROW, sample_time=1e-3)
    times = np.array([(5.0 + beside) * 1e-3])
    if is_row:
        assert log.at(times).position[0] == ROW[5]
    else:
        with pytest.raises(StructureError, match="none at t = "):
            log.at(times)


def test_a_log_seen_through_a_shaper_needs_values_between_its_rows():
    log = Recorded(position=ROW, sample_time=1e-3)
    with pytest.raises(StructureError, match="none at t = "):
        InputShaped(reference=log, frequency=33.0).at(np.arange(100) * 1e-3)
