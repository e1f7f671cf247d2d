"""Quadrant glitches: the contour errors due to dry friction at each reversal of an axis."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Column, Result, Table
from feeddrive.loop.simulate import Run
from feeddrive.machining.contour import ContourError, contour_error

_BASE = 0.2  # of the way from the reversal before: where the circle has come to rest again
# a simulated axis that sticks has a velocity of 0, except for rounding
_STUCK = 1e-12  # m/s


class Reversal(NamedTuple):
    """A reversal of the set velocity of an axis.

    axis, side  the axis and the end of its travel, such as "x" and "+" for the most positive position
    time        time of the reversal of the set velocity, s
    base        outward contour error before the reversal, m
    height, peak_time  the largest outward contour error above the base, m, and its time after the reversal, s
    width       width of the peak at half its height, s
    stick_begin, stick_time  start of sticking after the reversal and its duration, s, to within a sample; 0 if the axis
                             does not stick
    rows        samples from the reversal to the next one of any axis
    """

    axis: str
    side: str
    time: float
    base: float
    height: float
    peak_time: float
    width: float
    stick_begin: float
    stick_time: float
    rows: slice


@dataclass(frozen=True, eq=False, repr=False)
class Reversals(Result):
    """The reversals of a run along a curved path.

    outward  contour error away from the center of curvature, m, shape (n,)
    """

    name: str
    reversals: tuple[Reversal, ...]
    time: np.ndarray
    outward: np.ndarray

    def table(self) -> Table:
        """Return a table with one row for each reversal."""
        rows = [
            [
                f"{turn.axis} {turn.side}",
                turn.time,
                turn.height,
                turn.peak_time,
                turn.width,
                turn.stick_begin,
                turn.stick_time,
                turn.base,
            ]
            for turn in self.reversals
        ]
        highest = max((abs(turn.height) for turn in self.reversals), default=0.0)
        columns = [
            "reversal",
            Column("at", "s", "5 s"),
            Column("height", "m"),
            Column("after", "s"),
            Column("width", "s"),
            Column("stands from", "s"),
            Column("for", "s"),
            Column("base", "m"),
        ]
        return Table(f"{self.name}: quadrant glitches up to {Quantity(highest, 'm')}", columns, rows)


def reversals(run: Run, contour: ContourError | None = None, *, begin: float = 0.0) -> Reversals:
    """Return the reversals of the two axes of a run along a curved path, such as a circle.

    contour  the contour error of the run, if already computed
    begin    time before which reversals are excluded as run-in, s

    The base is the mean over the last fifth of the path from the previous reversal, or from the start of the run.
    Raises ParameterError for a run that does not have two axes, or has no velocities.
    """
    deviation = contour_error(run) if contour is None else contour
    if not deviation.signed:
        raise ParameterError(
            f"reversals are those of a plane path: give the contour error of two axes, not of "
            f"{', '.join(deviation.axes)}"
        )
    v = np.column_stack([run[f"{axis}.set_velocity"] for axis in deviation.axes])
    a = np.column_stack([run[f"{axis}.set_acceleration"] for axis in deviation.axes])
    left_turn = v[:, 0] * a[:, 1] - v[:, 1] * a[:, 0] >= 0.0
    outward = np.where(left_turn, -deviation.error, deviation.error)
    places: list[tuple[float, int, int]] = []
    for i in range(2):
        # A row at rest has no sign: a dwell between two directions is one reversal.
        moves = np.flatnonzero(v[:, i] != 0.0)
        turned = np.flatnonzero(np.sign(v[moves[1:], i]) != np.sign(v[moves[:-1], i]))
        for before, after in zip(moves[turned], moves[turned + 1], strict=True):
            share = v[before, i] / (v[before, i] - v[after, i])
            time = float(deviation.time[before] + share * (deviation.time[after] - deviation.time[before]))
            if time >= begin:
                places.append((time, int(after), i))
    places.sort()
    ends = [row for _, row, _ in places[1:]] + [len(outward)]
    starts = [0] + [row for _, row, _ in places[:-1]]
    rows = [
        _reversal(run, deviation, outward, place, start, end)
        for place, start, end in zip(places, starts, ends, strict=True)
    ]
    return Reversals(deviation.name, tuple(rows), deviation.time, outward)


def _reversal(
    run: Run, contour: ContourError, outward: np.ndarray, place: tuple[float, int, int], start: int, end: int
) -> Reversal:
    time, row, i = place
    axis = contour.axes[i]
    before = outward[row - max(1, int(_BASE * (row - start))) : row]
    base = float(np.mean(before))
    course = outward[row:end] - base
    top = int(np.argmax(course))
    height = float(course[top])
    above = course >= 0.5 * height
    first, last = top, top
    while first > 0 and above[first - 1]:
        first -= 1
    while last + 1 < len(above) and above[last + 1]:
        last += 1
    step = run.sample_time
    near = slice(max(0, row - (end - row) // 4), end)
    stuck = np.flatnonzero(np.abs(run[f"{axis}.velocity_load"][near]) <= _STUCK) + near.start
    # one stand: the samples that follow each other from the first one on
    length = 0 if not len(stuck) else int(np.argmax(np.append(np.diff(stuck) > 1, True))) + 1
    return Reversal(
        axis=axis,
        # At its most positive position an axis accelerates towards smaller positions.
        side="+" if float(run[f"{axis}.set_acceleration"][row]) < 0.0 else "-",
        time=time,
        base=base,
        height=height,
        peak_time=float(contour.time[row + top]) - time,
        width=(last - first + 1) * step,
        stick_begin=float(contour.time[stuck[0]]) - time if length else 0.0,
        stick_time=length * step,
        rows=slice(row, end),
    )


def stick_time(
    acceleration: float, *, mass: float, coulomb: float, breakaway: float, Kv: float, Kp: float, Tn: float | None = None
) -> float:
    """Return the time for which an axis under P-PI control sticks at a reversal, s, to about 0.5 %: the root of

        Kp A (t + (Kv + 1/Tn) t²/2 + Kv t³/(6 Tn)) = F_c + F_s - m A,   A = V²/R

    A is the acceleration of the set position at the reversal, m/s²; the share of velocity feedforward hardly matters.
    The result is 0 if the axis does not stick, F_c + F_s <= m A.  Raises ParameterError for numbers that are not > 0.
    """
    positive = {
        "acceleration": (acceleration, "m/s2"),
        "mass": (mass, "kg"),
        "Kv": (Kv, "1/s"),
        "Kp": (Kp, "N s/m"),
    } | ({} if Tn is None else {"Tn": (Tn, "s")})
    for name, (value, unit) in positive.items():
        if not 0.0 < value < float("inf"):
            raise ParameterError(f"{name} = {Quantity(value, unit):6 SI} must be finite and > 0")
    wanted = (coulomb + breakaway - mass * acceleration) / (Kp * acceleration)
    if wanted <= 0.0:
        return 0.0
    rate = 0.0 if Tn is None else 1.0 / Tn

    def left(t: float) -> float:
        return t + (Kv + rate) * t * t / 2.0 + Kv * rate * t**3 / 6.0 - wanted

    # Deferred: commands that only read files do not need it.
    from scipy.optimize import brentq

    # The left side is at least t, so that the root lies below `wanted`.
    root: Any = brentq(left, 0.0, wanted, xtol=1e-15)
    return float(root)
