"""Contour error: how far the tool is from the commanded path, whatever its delay along it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from feeddrive.blocks.families import Reference
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Column, Result, Table
from feeddrive.language.text import Text
from feeddrive.loop.simulate import Run
from feeddrive.machining.curve import CORNER, Curve, curve_through, feet, lengths, size, unit

WORST = 5  # places that the table names
_SLOW = 1e-6  # m/s: below it a path has no direction
_NEAR = 1e-3  # of a path: two places that lie closer are one
_LARGE = 0.5  # of a worst error: what is larger around it belongs to it


class Worst(NamedTuple):
    """A place of a large contour error: when (s), at which path length (m), how much (m, signed), where, which line."""

    time: float
    along: float
    error: float
    position: np.ndarray
    line: int | None


class Corner(NamedTuple):
    """A corner of the path, and how the tool passes it.

    along, position  path length and place of the vertex, m
    turn             of the direction, rad
    nearest          distance at which the tool passes the vertex, m
    error            the largest contour error around it, m, unsigned
    rows             of the samples between which it is passed
    line             of the part program that begins there, if known
    """

    along: float
    position: np.ndarray
    turn: float
    nearest: float
    error: float
    rows: slice
    line: int | None


@dataclass(frozen=True, eq=False, repr=False)
class ContourError(Result):
    """The distance of each actual position from the commanded path.

    name, axes   of the run, and the axes in the order of the columns
    time         s, shape (n,)
    set_position, position  commanded and actual, m, shape (n, N)
    error        to the nearest point of the path, m, shape (n,); of two axes it is positive at the left of the path (on
                 a counter-clockwise circle: inside), and unsigned where the nearest point is a corner or an end; of
                 more axes it is unsigned
    vector       from the path to the tool, m, shape (n, N)
    along        path length of the nearest point, m, shape (n,)
    at_corner    whether the nearest point is a corner or an end, shape (n,)
    estimate     of the error from the tracking error alone, right to second order, m, shape (n,); None without
                 velocities
    lag          of the tool behind its set position along the path, m, shape (n,)
    line         of the part program, shape (n,), or None
    counted      which samples the figures and the worst places count, shape (n,)
    curve        the path
    """

    name: str
    axes: tuple[str, ...]
    time: np.ndarray
    set_position: np.ndarray
    position: np.ndarray
    error: np.ndarray
    vector: np.ndarray
    along: np.ndarray
    at_corner: np.ndarray
    estimate: np.ndarray | None
    lag: np.ndarray
    line: np.ndarray | None
    counted: np.ndarray
    curve: Curve

    @property
    def signed(self) -> bool:
        """Whether left and right of the path are told apart: for two axes."""
        return len(self.axes) == 2

    @property
    def largest(self) -> float:
        """The largest distance that counts, m."""
        return float(np.max(np.abs(self.error[self.counted]), initial=0.0))

    @cached_property
    def weights(self) -> np.ndarray:
        """The share of each sample in the path that counts: half of the way to both neighbors, 0 at a standstill."""
        way = np.diff(lengths(self.set_position))
        share = 0.5 * (np.append(way, 0.0) + np.insert(way, 0, 0.0)) * self.counted
        total = float(np.sum(share))
        return share / total if total > 0.0 else share

    @property
    def rms(self) -> float:
        """Root of the mean square along the path, m."""
        return float(np.sqrt(np.sum(self.weights * self.error**2)))

    def within(self, share: float = 0.95) -> float:
        """The distance that is kept on this share of the path that counts, m; 0 where nothing counts."""
        sizes, weights = np.abs(self.error[self.counted]), self.weights[self.counted]
        order = np.argsort(sizes)
        place = np.searchsorted(np.cumsum(weights[order]), share - 1e-12)
        return float(sizes[order[min(int(place), len(order) - 1)]]) if len(order) else 0.0

    def worst(self, count: int = WORST, apart: float | None = None) -> list[Worst]:
        """The largest errors that count, largest first: peaks that fall to half between them.

        apart  least path length between two of them, m; default: a thousandth of the path
        """
        reach = _NEAR * float(self.curve.along[-1]) if apart is None else apart
        left = np.where(self.counted, np.abs(self.error), 0.0)
        found: list[Worst] = []
        while len(found) < count and np.max(left, initial=0.0) > 0.0:
            i = int(np.argmax(left))
            line = None if self.line is None else int(self.line[i])
            found.append(Worst(float(self.time[i]), float(self.along[i]), float(self.error[i]), self.position[i], line))
            # one place is its neighborhood on the path, and all around it where the error stays large
            away = np.abs(self.along - self.along[i]) > reach
            calm = np.flatnonzero(away & (np.abs(self.error) < _LARGE * abs(self.error[i])))
            k = int(np.searchsorted(calm, i))
            begin, end = calm[k - 1] + 1 if k else 0, calm[k] if k < len(calm) else len(left)
            left[begin:end] = 0.0
            left[~away] = 0.0
        return found

    def corners(self, least: float = np.radians(5.0), reach: float | None = None) -> list[Corner]:
        """Corners of the path that turn by at least so many radians.

        reach  path length before and behind a corner that counts as around it, m; default: twice the largest lag, but
               not beyond the middle to the next corner
        """
        turn = self.curve.turn
        nodes = np.flatnonzero(turn >= max(least, CORNER))
        if not len(nodes):
            return []
        places = self.curve.along[nodes]
        commanded = self.curve.place(len(self.time))
        most = 2.0 * float(np.max(np.abs(self.lag))) if reach is None else reach
        middles = 0.5 * (places[1:] + places[:-1])
        lows = np.maximum(np.concatenate([[0.0], middles]), places - most)
        highs = np.minimum(np.concatenate([middles, self.curve.along[-1:]]), places + most)
        found: list[Corner] = []
        for node, place, low, high in zip(nodes, places, lows, highs, strict=True):
            begin, stop = np.searchsorted(commanded, [low, high + (high - place)])
            rows = slice(int(begin), max(int(stop), int(begin) + 1))
            vertex = self.curve.node[node]
            here = np.abs(self.error[rows])[(self.along[rows] >= low) & (self.along[rows] <= high)]
            distance = _to_point(self.position[rows], vertex)
            behind = min(int(np.searchsorted(commanded, place, side="right")), len(self.time) - 1)
            line = None if self.line is None else int(self.line[behind])
            found.append(
                Corner(float(place), vertex, float(turn[node]), distance, float(np.max(here, initial=0.0)), rows, line)
            )
        return found

    def table(self) -> Table:
        """Largest, RMS and 95 % of the error, and the worst places."""
        title = Text(
            f"{self.name}: contour error {Quantity(self.largest, 'm')} at most, {Quantity(self.rms, 'm')} RMS, "
            f"{Quantity(self.within(0.95), 'm')} on 95 % of {Quantity(float(self.curve.along[-1]), 'm'):mm}; lag at "
            f"most {Quantity(float(np.max(np.abs(self.lag))), 'm')}"
        )
        columns = [
            Column("worst places"), Column("error", "m", "+.4g" if self.signed else ""), Column("time", "s", "4 s"),
            Column("along the path", "m", "5 mm"), *(Column(name, "m", "5 mm") for name in self.axes),
            *([] if self.line is None else [Column("line")]),
        ]  # fmt: skip
        rows = [
            [i + 1, place.error, place.time, place.along, *map(float, place.position),
             *([] if self.line is None else [place.line])]
            for i, place in enumerate(self.worst())
        ]  # fmt: skip
        return Table(title, columns, rows)


def _to_point(position: np.ndarray, point: np.ndarray) -> float:
    """The distance at which straight lines between positions pass a point, m."""
    if len(position) < 2:
        return float(np.min(size(position - point)))
    step, from_begin = np.diff(position, axis=0), point - position[:-1]
    square = np.sum(step * step, axis=1)
    share = np.clip(np.sum(step * from_begin, axis=1) / np.where(square > 0.0, square, 1.0), 0.0, 1.0)
    return float(np.min(size(from_begin - share[:, None] * step)))


def contour_error(
    actual: Run | np.ndarray,
    path: Mapping[str, Reference] | np.ndarray | None = None,
    *,
    axes: Sequence[str] | None = None,
    velocity: np.ndarray | None = None,
    acceleration: np.ndarray | None = None,
    signal: str = "tool",
    line: np.ndarray | None = None,
    counted: np.ndarray | None = None,
    sample_time: float = 1.0,
    window: float | None = None,
    name: str | None = None,
) -> ContourError:
    """The distance of the tool from its path:  ε = ± |P - c(u)|  with  (c(u) - P) · c'(u) = 0.

        estimate  ε = -e_n - κ e_t²/2,  e = set - actual position, n left of the direction t, κ > 0 in a left turn

    actual        a run of a machine, or positions, m, shape (n, N); a sample belongs to the set position of its row
    path          set positions, m, shape (n, N), or references by axis; default: those of the run
    axes          names of the columns; default: all axes of the run that do not turn
    velocity, acceleration  of the set positions given as an array, m/s and m/s², shape (n, N): without them tangents
                  follow from the set positions, and there is no estimate; nor with velocities that are differences
    signal        of the run that is the position: `tool`, the tool point of a machine with geometry errors and else the
                  table, `position_load`, the table, or `reading_load`, the table as the control sees it
    line          of the part program for each row
    counted       whether each row counts in the figures, shape (n,); default: all do
    sample_time   s, for arrays
    window        path length around the set position in which the nearest point is looked for, m; default: twice the
                  largest tracking error, which is at least 2 V (lag + dead time).  A path that comes near itself within
                  the window is one path there

    The path between two set positions is of third degree (`curve_through`); a standstill is one point, a corner has no
    normal.  Source: definition of the contour error, Koren & Lo 1991; the estimate right to second order.
    Raises ParameterError for fewer than two axes, a name that is not there, shapes that differ, numbers that are not
    finite, and a path that does not move.
    """
    run = actual if isinstance(actual, Run) else None
    if isinstance(actual, Run):
        chosen = _axes(actual, axes)
        position = tool_columns(actual, chosen, signal)
        time, step = actual.time, actual.sample_time
        if path is None:
            path, velocity = tool_columns(actual, chosen, "set_position"), tool_columns(actual, chosen, "set_velocity")
            acceleration = tool_columns(actual, chosen, "set_acceleration")
    else:
        position = np.asarray(actual, dtype=np.float64)
        if position.ndim != 2:
            raise ParameterError(f"positions must be of shape (samples, axes), not {position.shape}")
        step = sample_time
        time = step * np.arange(len(position))
        chosen = tuple(axes) if axes is not None else tuple("xyzabcuvw"[: position.shape[1]])
    if len(chosen) < 2 or position.shape[1] != len(chosen):
        raise ParameterError(f"a contour error needs the positions of two or more axes, not of {', '.join(chosen)}")
    if path is None:
        raise ParameterError("positions need a path: give the set positions, or references by axis")
    if isinstance(path, Mapping):
        path, velocity, acceleration = _followed(path, chosen, time)
    given = {"path": path, "velocity": velocity, "acceleration": acceleration}
    rows = {key: _checked(key, value, position) for key, value in given.items() if value is not None}
    _checked("positions", position, position)
    if "velocity" in rows and _differenced(rows["path"], rows["velocity"], step):
        del rows["velocity"]
    if line is not None and np.shape(line) != time.shape:
        raise ParameterError(f"line has {np.size(line)} rows, the positions have {len(time)}")
    if counted is not None and np.shape(counted) != time.shape:
        raise ParameterError(f"counted has {np.size(counted)} rows, the positions have {len(time)}")
    setpoint, speed = rows["path"], rows.get("velocity")
    curve = curve_through(setpoint, speed)
    away = setpoint - position
    reach = 2.0 * float(np.max(size(away))) if window is None else window
    expected = curve.place(len(time))
    foot = feet(curve, position, expected, reach)
    return ContourError(
        name=(run.name if run is not None else "positions") if name is None else name,
        axes=chosen,
        time=time,
        set_position=setpoint,
        position=position,
        error=_signed(foot.vector, foot.tangent, foot.corner),
        vector=foot.vector,
        along=foot.along,
        at_corner=foot.corner,
        estimate=None if speed is None or "acceleration" not in rows else _estimate(away, speed, rows["acceleration"]),
        lag=expected - foot.along,
        line=None if line is None else np.asarray(line),
        counted=np.ones(len(time), bool) if counted is None else np.asarray(counted, bool),
        curve=curve,
    )


def _signed(vector: np.ndarray, tangent: np.ndarray, corner: np.ndarray) -> np.ndarray:
    """Of two axes positive at the left of the path, and unsigned at corners; else unsigned."""
    distance = size(vector)
    if vector.shape[1] != 2:
        return distance
    left = tangent[:, 0] * vector[:, 1] - tangent[:, 1] * vector[:, 0]
    return np.where((left < 0.0) & ~corner, -distance, distance)


def _estimate(e: np.ndarray, velocity: np.ndarray, acceleration: np.ndarray) -> np.ndarray:
    """ε = -e_n - κ e_t²/2; NaN where the set position stands."""
    speed = size(velocity)
    moves = speed > _SLOW
    t = unit(velocity)
    behind = np.sum(e * t, axis=1)
    bend = acceleration - np.sum(acceleration * t, axis=1)[:, None] * t
    bend = bend / np.where(moves, speed, 1.0)[:, None] ** 2
    vector = behind[:, None] * t - e - (0.5 * behind**2)[:, None] * bend
    return np.where(moves, _signed(vector, t, np.zeros(len(e), bool)), np.nan)


def _differenced(position: np.ndarray, velocity: np.ndarray, T: float) -> bool:
    """Whether the velocities are backward differences of the positions, which are no tangents."""
    step = np.diff(position, axis=0)
    away = np.max(np.abs(T * velocity[1:] - step), initial=0.0)
    return bool(away <= 1e-9 * np.max(np.abs(step), initial=0.0))


def _axes(run: Run, axes: Sequence[str] | None) -> tuple[str, ...]:
    """The axes of a run that are asked for, or all that do not turn."""
    ports = [each.removesuffix("set_position") for each in run.signals if each.endswith(".set_position")]
    if axes is None:
        return tuple(port[:-1] for port in ports if port not in run.turning)
    for name in axes:
        if f"{name}." not in ports:
            raise ParameterError(f"the run has no axis '{name}'; it has {', '.join(port[:-1] for port in ports)}")
    return tuple(axes)


def tool_columns(run: Run, axes: Sequence[str], signal: str) -> np.ndarray:
    """Positions of axes, m, shape (n, N): the tool point where the run has it, or a signal of each axis."""
    if signal == "tool":
        there = all(f"tool.{name}" in run.signals for name in axes)
        names = [f"tool.{name}" if there else f"{name}.position_load" for name in axes]
    else:
        names = [f"{name}.{signal}" for name in axes]
    return np.column_stack([run[name] for name in names]) if axes else np.zeros((run.samples, 0))


def _followed(path: Mapping[str, Reference], axes: Sequence[str], time: np.ndarray) -> tuple[Any, Any, Any]:
    """Position, velocity and acceleration of references at instants, s."""
    absent = [name for name in axes if name not in path]
    if absent:
        raise ParameterError(f"there is no reference of axis {', '.join(absent)}; there are {', '.join(path)}")
    points = [path[name].at(time) for name in axes]
    position, velocity, acceleration = (np.column_stack([each[i] for each in points]) for i in range(3))
    return position, velocity, acceleration


def _checked(name: str, values: Any, position: np.ndarray) -> np.ndarray:
    """An array of the shape of the positions, all finite."""
    found = np.asarray(values, dtype=np.float64)
    if found.shape != position.shape:
        raise ParameterError(f"{name} is of shape {found.shape}, the positions are of shape {position.shape}")
    if not np.all(np.isfinite(found)):
        row = int(np.flatnonzero(~np.all(np.isfinite(found), axis=1))[0])
        raise ParameterError(f"{name}: row {row} holds a number that is not finite")
    return found
