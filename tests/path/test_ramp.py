"""Ramps and piecewise polynomials: limits, closed forms, and the bits of the interpreter."""

from __future__ import annotations

import math
import random
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from feeddrive.path.pieces import derivative, evaluate, piece_at
from feeddrive.path.ramp import boxcars, cube_root, endless_speed, ramp_distance, ramp_pieces, stays_below
from kernel_oracle import compare, drawn

LIMITS = 5.0, 100.0, 5e4  # acceleration m/s², jerk m/s³, snap m/s⁴


def limits(draw: random.Random) -> tuple[float, float, float]:
    """Acceleration, jerk and snap over decades, so that each of them binds."""
    return 10.0 ** draw.uniform(-1, 2), 10.0 ** draw.uniform(0, 4), 10.0 ** draw.uniform(2, 6)


def whole_ramp(start: float, end: float, limit: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray, float]:
    """Instants, pieces and the end of a ramp."""
    times, pieces = np.zeros(7), np.zeros((7, 5))
    count, time, _ = ramp_pieces(0.0, 0.0, start, end, *limit, times, pieces, 0)
    return times[:count], pieces[:count], time


def values(times: np.ndarray, pieces: np.ndarray, at: np.ndarray) -> np.ndarray:
    found = np.zeros((len(at), 5))
    evaluate(times, pieces, len(times), at, found)
    return found


def test_the_cube_root_is_within_two_units_of_the_last_place():
    draw = random.Random(1)
    for x in [0.0, 1.0, 8.0, 0.125, 5e-324, 1.7e308, *(10.0 ** draw.uniform(-300, 300) for _ in range(300))]:
        assert abs(cube_root(x) - math.cbrt(x)) <= 2.0 * math.ulp(math.cbrt(x))
    assert cube_root(math.inf) == math.inf
    assert math.isnan(cube_root(math.nan))
    with pytest.raises(ValueError, match="from 0 on"):
        cube_root(-1.0)


def test_a_ramp_keeps_its_limits_and_reaches_one_of_them():
    """Rounding: 1e-12 of each limit. Snap is constant in each of the seven pieces, so extremes lie at their ends."""
    draw = random.Random(2)
    for _ in range(100):
        limit = limits(draw)
        start, end = (draw.uniform(0.0, 1.0) * 10.0 ** draw.uniform(-4, 1) for _ in range(2))
        times, pieces, finish = whole_ramp(start, end, limit)
        ends = np.nextafter(np.append(times[1:], finish), 0.0)
        found = values(times, pieces, np.sort(np.concatenate([times, ends])))
        used = np.abs(found[:, 2:]).max(axis=0) / limit
        assert (used <= 1.0 + 1e-12).all()
        assert used.max() >= 1.0 - 1e-12


def test_a_ramp_is_smooth_and_ends_at_rest_of_acceleration_and_jerk():
    """Position, speed, acceleration and jerk have no jumps: 1e-12 of what occurs, of the jerk's limit 1e-11."""
    draw = random.Random(3)
    for _ in range(50):
        limit = limits(draw)
        start, end = draw.uniform(0.0, 1.0), draw.uniform(0.0, 1.0)
        times, pieces, finish = whole_ramp(start, end, limit)
        lengths = np.diff(np.append(times, finish))
        for k, t in enumerate(lengths):
            after = pieces[k + 1] if k + 1 < len(times) else np.array([ramp_distance(start, end, *limit), end, 0, 0, 0])
            scales = max(1.0, after[0]), 1.0, limit[0], limit[1]
            for order, scale in enumerate(scales):
                jump = derivative(pieces[k], order, t) - math.factorial(order) * after[order]
                assert abs(jump) <= (1e-12 if order < 3 else 1e-11) * scale


@pytest.mark.parametrize(
    ("step", "widths"),
    [
        (1e-6, (1e-11 ** (1 / 3), 1e-11 ** (1 / 3), 2 * 1e-11 ** (1 / 3))),  # snap alone: dv = 2 S L1³
        (0.1, (0.002, (-0.002 + math.sqrt(4e-6 + 4e-3)) / 2, (0.002 + math.sqrt(4e-6 + 4e-3)) / 2)),  # and jerk
        (10.0, (0.002, 0.05, 2.0)),  # and acceleration
    ],
)
def test_closed_forms_of_the_widths(step: float, widths: tuple[float, float, float]):
    assert boxcars(step, *LIMITS) == pytest.approx(widths, rel=1e-14)
    assert boxcars(-step, *LIMITS) == boxcars(step, *LIMITS)


def test_no_ramp_is_faster_than_one_that_never_ends():
    """At every place of a ramp, whatever speed it leads to; and a longer step comes as near as one likes."""
    draw = random.Random(4)
    for _ in range(60):
        limit = limits(draw)
        start = draw.uniform(0.0, 1.0)
        end = start + 10.0 ** draw.uniform(-3, 1)
        times, pieces, finish = whole_ramp(start, end, limit)
        at = np.linspace(0.0, finish, 40)
        for x, v in values(times, pieces, at)[:, :2]:
            assert v <= endless_speed(start, x, *limit) * (1.0 + 1e-14)
        x, v = values(*whole_ramp(start, start + 1e3, limit)[:2], np.array([0.1 * finish]))[0, :2]
        assert endless_speed(start, x, *limit) == pytest.approx(v, rel=1e-9)


def test_a_cap_is_safe_if_no_ramp_reaches_it():
    reached = endless_speed(0.1, 0.01, *LIMITS)
    assert stays_below(math.nextafter(reached, 1.0), 0.1, 0.01, *LIMITS)
    assert not stays_below(reached, 0.1, 0.01, *LIMITS)
    assert endless_speed(0.1, 0.0, *LIMITS) == 0.1


def test_pieces_are_found_and_evaluated_as_numpy_does():
    draw = np.random.default_rng(5)
    times, pieces = np.sort(draw.uniform(0.0, 10.0, 50)), draw.normal(size=(50, 8))
    at = np.sort(np.concatenate([draw.uniform(-1.0, 11.0, 100), times]))
    found = np.zeros((len(at), 5))
    evaluate(times, pieces, 50, at, found)
    place = np.maximum(np.searchsorted(times, at, side="right") - 1, 0)
    for t, k, row in zip(at, place, found, strict=True):
        polynomial = np.polynomial.Polynomial(pieces[k])
        for order in range(5):
            exact = polynomial.deriv(order)(t - times[k]) if order else polynomial(t - times[k])
            largest = np.abs(polynomial.deriv(order).coef if order else polynomial.coef).max() * 3.0**8
            assert abs(row[order] - exact) <= 1e-14 * largest  # eight roundings of terms of this size
    assert [piece_at(times, 50, t, 0) for t in at] == place.tolist()
    with pytest.raises(ValueError, match="instants must ascend"):
        evaluate(times, pieces, 50, at[::-1].copy(), found)


def test_room_that_is_too_small_is_an_index_error():
    with pytest.raises(IndexError):
        ramp_pieces(0.0, 0.0, 0.0, 1.0, *LIMITS, np.zeros(6), np.zeros((7, 5)), 0)


def ramps(count: int) -> Iterator[list[Any]]:
    draw = random.Random(6)
    for _ in range(count):
        start, end = draw.uniform(0.0, 1.0), draw.uniform(0.0, 1.0)
        yield [0.0, 0.0, start, end, *limits(draw), np.zeros(12), np.zeros((12, 5)), draw.randint(0, 6)]


def test_machine_code_has_the_bits_of_the_interpreter():
    assert compare(ramp_pieces, ramps(100)) > 0
    for kernel in (cube_root, boxcars, endless_speed, stays_below, evaluate):
        compare(kernel, drawn(kernel, 40, seed=7))
