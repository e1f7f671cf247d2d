"""Drawn programs under drawn overrides: planned, sampled and checked."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from paths import KINDS, random_all_axes, random_program
from sample_check import Curve, check_limits, check_path, curves

from feeddrive.path.geometry.weights import ANGLE_TOLERANCE
from feeddrive.path.limits import AxisLimits, MachineLimits
from feeddrive.path.motion import Part
from feeddrive.path.program.moves import Arc, Feed, Move, PathMode, Spline, Straight
from feeddrive.path.schedule.override import MOST, Override, override
from feeddrive.path.setpoints import Setpoints, planned

ALL_KINDS = (*KINDS, "all axes")
_SAMPLES = 1999.3  # of a whole motion, nearly; its end is no instant
_FINE = 50  # times as many around a step of the factor
_SLOWEST, _LONGEST = 3.0, 20.0  # s, of a motion at 100 %, and under the override before its last step


class Case(NamedTuple):
    """A program, its machine, and steps of the factor of the feed: time (s) and factor."""

    name: str
    moves: list[Move]
    letters: str
    limits: np.ndarray
    steps: list[tuple[float, float]]


def ends(moves: list[Move], letters: str, limits: np.ndarray, steps: list[tuple[float, float]]) -> np.ndarray:
    """Plan moves under these steps; return 0 and the times at which the parts of the motion end, s."""
    found = [0.0]
    for part in planned(moves, letters, limits, override(steps), angle_tolerance(moves)):
        found.append(found[-1] + (float(np.sum(part.motion.duration)) if isinstance(part, Part) else part.duration))
    return np.array(found)


def _time(draw: np.random.Generator, ends: np.ndarray) -> float:
    """Draw a time: anywhere, near the start, near the end, or at the end of a part, to the last bit or nearly."""
    kind, near = draw.random(), float(draw.choice([-1.0, 0.0, 1.0]))
    if kind < 0.35:
        return float(draw.uniform(0.0, 1.05 * ends[-1]))
    if kind < 0.5:
        return float(10.0 ** draw.uniform(-9.0, -2.0))
    if kind < 0.65:
        return max(0.0, float(ends[-1]) + near * 10.0 ** draw.uniform(-9.0, -1.0))
    return max(0.0, float(draw.choice(ends)) + near * 10.0 ** draw.uniform(-12.0, -3.0))


def _factor(draw: np.random.Generator) -> float:
    """Draw a factor: a hold, any of 1 to 200 %, or an end of that."""
    kind = draw.random()
    if kind < 0.2:
        return 0.0
    if kind < 0.4:
        return float(draw.choice([0.01, 0.5, 1.0, MOST]))
    return float(10.0 ** draw.uniform(-2.0, np.log10(MOST)))


def _steps(draw: np.random.Generator, moves: list[Move], letters: str, limits: np.ndarray) -> list[tuple[float, float]]:
    """Draw one to five steps, the time of the second from the motion under the first; more if that takes too long."""
    plain = ends(moves, letters, limits, [])
    lasts = float(plain[-1])
    steps = [(_time(draw, plain), _factor(draw))]
    if draw.random() < 0.8:
        first = steps if steps[0][1] > 0.0 else [*steps, (steps[0][0] + 1e-3 * lasts, 1.0)]
        later = _time(draw, ends(moves, letters, limits, first))
        if later <= steps[0][0]:
            later = steps[0][0] + lasts * float(10.0 ** draw.uniform(-6.0, 0.0))
        steps.append((later, _factor(draw)))
    for _ in range(int(draw.choice([0, 0, 1, 3]))):
        steps.append((steps[-1][0] + lasts * float(10.0 ** draw.uniform(-4.0, 0.0)), _factor(draw)))
    if steps[-1][1] == 0.0 or _lasts(override(steps), lasts) > _LONGEST:
        steps.append((steps[-1][0] + lasts * float(10.0 ** draw.uniform(-3.0, 0.0)), 1.0))
    return steps


def drawn_case(number: int, seed: int, most: int = 12) -> Case:
    """Draw case `number` of a seed: a program of up to so many moves of each of `ALL_KINDS` in turn."""
    draw, kind = np.random.default_rng([seed, number]), ALL_KINDS[number % len(ALL_KINDS)]
    moves, letters, limits = _program(draw, kind, most)
    while not curves(moves, _columns(letters)):  # it may go along axes that the machine has not
        moves, letters, limits = _program(draw, kind, most)
    moves = [_faster(each, moves, letters) if isinstance(each, Feed) else each for each in moves]
    return Case(f"case {number} of seed {seed}, {kind}", moves, letters, limits, _steps(draw, moves, letters, limits))


def _program(draw: np.random.Generator, kind: str, most: int) -> tuple[list[Move], str, np.ndarray]:
    """Draw moves from zero, the letters of the axes, and their limits."""
    if kind in KINDS:
        (moves, _, limits), letters = random_program(draw, kind, most), "XYZ"
    else:
        moves, _, letters, limits = random_all_axes(draw)
    start = np.array(next(each.start for each in moves if isinstance(each, Straight | Arc | Spline)))
    return [_moved(each, start) for each in moves], letters, limits


def _moved(move: Move, start: np.ndarray) -> Move:
    """Return a move as it is if the program begins at zero."""
    if not isinstance(move, Straight | Arc | Spline):
        return move
    move = replace(move, start=tuple(np.array(move.start) - start), end=tuple(np.array(move.end) - start))
    if isinstance(move, Arc):
        return replace(move, center=(move.center[0] - start[move.axes[0]], move.center[1] - start[move.axes[1]]))
    if isinstance(move, Spline):
        return replace(move, points=tuple(tuple(np.array(point) - start) for point in move.points))
    return move


def _columns(letters: str) -> list[int]:
    """Return where the points of moves have the coordinates of these axes."""
    return ["XYZABCUVW".index(letter) for letter in letters]


def _faster(feed: Feed, moves: list[Move], letters: str) -> Feed:
    """Return the feed, or one that takes `_SLOWEST` s: each 50 ms of a motion under an override are a part."""
    least = _way(curves(moves, _columns(letters))) / _SLOWEST
    return replace(feed, linear=max(feed.linear, least), angular=max(feed.angular, least))


def _way(path: list[Curve]) -> float:
    """Return the length of a path, m, nearly."""
    return sum(float(np.linalg.norm(each.place(each.begin) - each.place(each.end))) for each in path)


def angle_tolerance(moves: list[Move]) -> float:
    """Return the tolerance of rotary axes, rad, with which 1 rad counts as 1 m, as it does in `curves`."""
    return next((each.tolerance for each in moves if isinstance(each, PathMode) and each.tolerance), ANGLE_TOLERANCE)


def machine_limits(letters: str, limits: np.ndarray, angle_tolerance: float) -> MachineLimits:
    """Return limits of velocity .. snap of each axis, shape (N, 4), as those of a machine."""
    names = ("velocity", "acceleration", "jerk", "snap")
    axes = zip(letters, limits.tolist(), strict=True)
    machine = MachineLimits({letter: AxisLimits(**dict(zip(names, row, strict=True))) for letter, row in axes})
    return machine.turning_within(angle_tolerance) if machine.rotary else machine


def _lasts(steps: Override, time: float) -> float:
    """Return how long a motion of so many seconds takes at most, nearly, if all of it is scaled by the factor, s."""
    for k, factor in enumerate(steps.factor):
        span = float(steps.time[k + 1] - steps.time[k]) if k + 1 < len(steps.time) else np.inf
        if factor > 0.0 and time <= factor * span:
            return float(steps.time[k] + time / factor)
        time -= factor * span
    raise AssertionError("the last factor is above 0")


def samples(case: Case, T: float, begin: float, end: float) -> np.ndarray:
    """Plan a case; return its samples from one time on to another one, s, of which none is missing or not proven."""
    machine = machine_limits(case.letters, case.limits, angle_tolerance(case.moves))
    setpoints = Setpoints(case.moves, machine, T, override(case.steps))
    parts, count = [], 0
    for each in setpoints:
        assert each.first == count, f"sample {each.first} follows {count - 1}"
        first, last = (np.clip(np.ceil(time / T) - count, 0, len(each.values)) for time in (begin, end))
        parts.append(each.values[int(first) : int(last)])
        count += len(each.values)
        if count * T > end:
            break
    else:
        assert count == setpoints.samples == int(np.ceil(setpoints.time / T * (1.0 - 1e-12))) + 1, "samples are missing"
    assert setpoints.proven, setpoints.prover.proof().faults[0]
    return np.concatenate(parts)


def check_case(case: Case) -> int:
    """Plan a case, check all its samples, and those around a step of its factor at a finer sample time; how many.

    Raise AssertionError if a limit, the path, its order, its feed or its end is not kept.
    """
    steps = override(case.steps)
    path = curves(case.moves, _columns(case.letters))
    way = _way(path)
    T = _lasts(steps, float(ends(case.moves, case.letters, case.limits, [])[-1])) / _SAMPLES
    values = samples(case, T, 0.0, np.inf)
    check_limits(T, values, case.limits, way)
    check_path(T, values, case.limits, path, float(steps.factor.max()))
    count = len(values)
    for time, _ in case.steps[:2]:
        fine = max(T / _FINE, (time + 0.5 * _SAMPLES * T / _FINE) / (_SAMPLES * _FINE))
        until = time + 0.5 * _SAMPLES * fine
        values = samples(case, fine, time - 0.5 * _SAMPLES * fine, until)
        if len(values):
            check_limits(fine, values, case.limits, way, until)
        count += len(values)
    return count
