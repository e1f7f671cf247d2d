"""Contour error: the distance of the tool from the commanded path, irrespective of its delay along the path.

The path is a curve through the set positions; the error is the distance of the tool from the nearest point of this
curve.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import sqrt
from typing import Any, NamedTuple

import numpy as np

from feeddrive.blocks.families import Reference
from feeddrive.language.errors import ParameterError
from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.source import Floats, Floats2, Ints
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Column, Result, Table
from feeddrive.language.text import Text
from feeddrive.loop.simulate import Run

_SAME = 1e-9  # m: set positions that lie closer are one
_BEND = 0.35  # rad: a larger angle between two chords is a corner if no velocity gives the tangent
_ALONG = 0.5  # cosine to the chord: below it a velocity belongs to the other side of a corner, or to a standstill
CORNER = 1e-3  # rad: a smaller turn of the tangent at a set position is no corner


class Curve(NamedTuple):
    """A piecewise cubic (Hermite) curve through nodes; a change of direction between two pieces is a corner.

    node    positions of the nodes, m, shape (n, N)
    along   path length at each node, m, shape (n,)
    begin, end  derivatives of piece k at its two ends with respect to its parameter 0 .. 1, m, shape (n - 1, N)
    row     row of the set position at each node, shape (n,)
    """

    node: np.ndarray
    along: np.ndarray
    begin: np.ndarray
    end: np.ndarray
    row: np.ndarray

    @property
    def turn(self) -> np.ndarray:
        """The change of the tangent direction at each node, rad, 0 at both ends of the path, shape (n,)."""
        angles = np.zeros(len(self.node))
        step = unit(self.begin[1:]) - unit(self.end[:-1])
        # an arccosine of the scalar product would lose turns below 1e-8 rad
        angles[1:-1] = 2.0 * np.arcsin(np.minimum(1.0, 0.5 * size(step)))
        return angles

    def place(self, rows: int) -> np.ndarray:
        """Return the path length at each set position of the curve, m, shape (rows,)."""
        return self.along[np.searchsorted(self.row, np.arange(rows), side="right") - 1]


def size(vectors: np.ndarray) -> np.ndarray:
    """Return the length of each vector, shape (n,), three times faster than numpy's norm."""
    return np.sqrt(np.einsum("ij,ij->i", vectors, vectors))


def unit(vectors: np.ndarray) -> np.ndarray:
    """Normalize vectors to length 1, shape (n, N); zero vectors remain zero."""
    length = size(vectors)
    return vectors / np.where(length > 0.0, length, 1.0)[:, None]


def lengths(position: np.ndarray) -> np.ndarray:
    """Return the length of the polyline up to each position, m, shape (n,)."""
    return np.concatenate([[0.0], np.cumsum(size(np.diff(position, axis=0)))])


def curve_through(position: np.ndarray, velocity: np.ndarray | None = None) -> Curve:
    """Return the curve through set positions, m, shape (n, N); a standstill becomes one node.

    The tangents have the direction of the velocity (m/s, same shape).  Without velocity, they are those of the circle
    through three neighboring nodes, unless its two chords differ in direction by more than 20°; the node is then a
    corner.  On an arc of radius R that turns by δ per row, the error of the curve is R δ⁶/1000.

    Raises ParameterError for positions of another shape and for a path shorter than 1 nm.
    """
    # By the length of the path, not row by row: rows of a slow motion are merged until they have moved by 1 nm.
    passed = np.floor(lengths(position) / _SAME)
    row = np.flatnonzero(np.diff(passed, prepend=-1.0) > 0.0)
    if len(row) < 2:
        raise ParameterError("the set positions do not move: a contour error needs a path")
    node = np.ascontiguousarray(position[row])
    chord = np.diff(node, axis=0)
    length = size(chord)
    direction = unit(chord)
    if velocity is None:
        # each chord weighted with the length of the other one: the tangent of the circle through the three nodes
        both = length[1:, None] * direction[:-1] + length[:-1, None] * direction[1:]
        at = unit(np.vstack([direction[:1], both, direction[-1:]]))
        if len(node) > 2:
            # The end tangents of the circles through the first and the last three nodes.
            at[0] = 2.0 * (at[1] @ direction[0]) * direction[0] - at[1]
            at[-1] = 2.0 * (at[-2] @ direction[-1]) * direction[-1] - at[-2]
            sharp = np.einsum("ij,ij->i", direction[1:], direction[:-1]) < np.cos(_BEND)
            at[1:-1][sharp] = np.nan
            at[0] = np.nan if sharp[0] else at[0]
            at[-1] = np.nan if sharp[-1] else at[-1]
    else:
        at = unit(velocity[row])
    sides = []
    for tangent in (at[:-1], at[1:]):
        fits = np.einsum("ij,ij->i", tangent, direction) > _ALONG
        sides.append(np.where(fits[:, None], tangent, direction))
    # of an arc that turns by δ, bent is δ² to second order; its tangents are 1/cos²(δ/4) and its length (δ/2)/sin(δ/2)
    # times the chord
    bent = size(sides[1] - sides[0]) ** 2
    arc = (length * (1.0 + bent / 16.0))[:, None]  # the length of the tangents with which a piece is an arc
    along = np.concatenate([[0.0], np.cumsum(length * (1.0 + bent / 24.0))])
    return Curve(node, along, np.ascontiguousarray(arc * sides[0]), np.ascontiguousarray(arc * sides[1]), row)


def curve_of_motion(position: np.ndarray, velocity: np.ndarray, sample_time: float) -> Curve:
    """Return the curve through set positions, m, with the directions of their velocities, m/s, shape (n, N).

    Velocities that are backward differences of the positions are not tangent to the path, and are not used.
    """
    return curve_through(position, None if _differenced(position, velocity, sample_time) else velocity)


class Feet(NamedTuple):
    """The nearest points of a curve to given positions.

    along   path length of the nearest point, m, shape (n,)
    vector  vector from the nearest point to the position, m, shape (n, N)
    tangent unit tangent of the curve there, shape (n, N)
    corner  True for a corner or an end of the path, which has no normal, shape (n,)
    """

    along: np.ndarray
    vector: np.ndarray
    tangent: np.ndarray
    corner: np.ndarray


def feet(curve: Curve, position: np.ndarray, expected: np.ndarray | None, window: float) -> Feet:
    """Return the points of the curve nearest to positions (m, shape (n, N)), each searched for within `window` m of
    path length around `expected`.

    expected  expected path length of each point, m, shape (n,); default: that of the previous point, and the whole
              path for the first one
    """
    position = np.ascontiguousarray(position, dtype=np.float64)
    n, axes = position.shape
    along, vector, tangent = np.empty(n), np.empty((n, axes)), np.empty((n, axes))
    corner = np.zeros(n, np.int64)
    around = np.zeros(0) if expected is None else np.ascontiguousarray(expected, dtype=np.float64)
    turn = curve.turn > CORNER
    # The path has no normal beyond its ends, as at a corner.
    turn[[0, -1]] = True
    longest = float(np.max(np.diff(curve.along)))
    path = (curve.node, curve.along, curve.begin, curve.end, np.ascontiguousarray(turn, dtype=np.int64))
    _feet(position, *path, around, window, longest, along, vector, tangent, corner)
    return Feet(along, vector, tangent, corner > 0)


@kernel
def _share(place: Floats, begin: Floats, end: Floats) -> float:
    """Return the parameter 0 .. 1 of the point of a straight piece that is nearest to a position."""
    on = 0.0
    length = 0.0
    for i in range(len(place)):
        d = end[i] - begin[i]
        on = on + d * (place[i] - begin[i])
        length = length + d * d
    return min(max(on / length, 0.0), 1.0)


@kernel
def _cubic(d: float, begin: float, end: float, u: float) -> tuple[float, float, float]:
    """Return the offset of a cubic piece from its start at parameter u, and its first and second derivative.

    The piece is defined by its chord d and the derivatives at its ends, in one coordinate.
    """
    b = 3.0 * d - 2.0 * begin - end
    c = begin + end - 2.0 * d
    return u * (begin + u * (b + u * c)), begin + u * (2.0 * b + 3.0 * c * u), 2.0 * b + 6.0 * c * u


@kernel
def _chord(place: Floats, begin: Floats, end: Floats) -> float:
    """Return the squared distance of a point from a line segment."""
    u = _share(place, begin, end)
    square = 0.0
    for i in range(len(place)):
        r = place[i] - begin[i] - u * (end[i] - begin[i])
        square = square + r * r
    return square


@kernel
def _on_piece(place: Floats, node: Floats, after: Floats, begin: Floats, end: Floats) -> tuple[float, float]:
    """Return the nearest point of a piece by Newton's method: its parameter 0 .. 1 and the squared distance."""
    u = _share(place, node, after)
    square = 0.0
    for _ in range(8):
        slope = 0.0
        bend = 0.0
        speed = 0.0
        square = 0.0
        for i in range(len(place)):
            way, v, w = _cubic(after[i] - node[i], begin[i], end[i], u)
            r = way - (place[i] - node[i])
            slope = slope + r * v
            speed = speed + v * v
            bend = bend + r * w
            square = square + r * r
        curved = speed + bend
        if curved <= 0.0:
            # Beyond the center of curvature the second derivative is negative; this step still leads downhill.
            curved = speed
        moved = min(max(u - slope / curved, 0.0), 1.0)
        if abs(moved - u) < 1e-13:
            break
        u = moved
    return u, square


@kernel
def _feet(
    position: Floats2,
    node: Floats2,
    along: Floats,
    begin: Floats2,
    end: Floats2,
    turn: Ints,
    expected: Floats,
    window: float,
    longest: float,
    arc_length: Floats,
    vector: Floats2,
    tangent: Floats2,
    corner: Ints,
) -> int:
    """Find the nearest point of the curve to each position: the piece by its chord, the point by Newton's method."""
    last = len(node) - 2
    k = 0
    low = 0
    foot = 0.0
    for n in range(len(position)):
        place = position[n]
        reach = window
        if len(expected) > 0:
            foot = expected[n]
        elif n == 0:
            reach = along[-1] + longest
        while low < last and along[low + 1] < foot - reach:
            low = low + 1
        while low > 0 and along[low] > foot - reach:
            low = low - 1
        k = min(max(k, low), last)
        while k > low and along[k] > foot + reach:
            k = k - 1
        least = _chord(place, node[k], node[k + 1])
        j = low
        while j <= last and along[j] <= foot + reach:
            square = _chord(place, node[j], node[j + 1])
            if square < least:
                least = square
                k = j
            away = 0.0
            for i in range(len(place)):
                away = away + (place[i] - node[j, i]) * (place[i] - node[j, i])
            # no point that is nearer along the path can be nearer than the nearest one so far
            j = j + max(1, int((sqrt(away) - sqrt(least)) / longest))
        u, square = _on_piece(place, node[k], node[k + 1], begin[k], end[k])
        # near an end of the piece the nearest point may lie on the neighbor of the nearest chord
        for side in range(-1, 2, 2):
            other = k + side
            if other >= 0 and other <= last and ((side < 0 and u < 0.1) or (side > 0 and u > 0.9)):
                w, beside = _on_piece(place, node[other], node[other + 1], begin[other], end[other])
                if beside < square:
                    u = w
                    square = beside
                    k = other
                    break
        at = k
        if u >= 1.0:
            at = k + 1
        corner[n] = turn[at] if u <= 0.0 or u >= 1.0 else 0
        speed = 0.0
        for i in range(len(place)):
            way, v, _ = _cubic(node[k + 1, i] - node[k, i], begin[k, i], end[k, i], u)
            tangent[n, i] = v
            speed = speed + v * v
            vector[n, i] = place[i] - node[k, i] - way
        for i in range(len(place)):
            tangent[n, i] = tangent[n, i] / sqrt(speed)
        foot = along[k] + u * (along[k + 1] - along[k])
        arc_length[n] = foot
    return len(position)


WORST = 5  # places that the table names
_SLOW = 1e-6  # m/s: below it a path has no direction
_NEAR = 1e-3  # of a path: two places that lie closer are one
_LARGE = 0.5  # of a worst error: larger errors around it belong to the same place


class Worst(NamedTuple):
    """A large contour error: time (s), path length (m), error (m, signed), position and program line."""

    time: float
    along: float
    error: float
    position: np.ndarray
    line: int | None


class Corner(NamedTuple):
    """A corner of the path and the passage of the tool around it.

    along, position  path length and position of the vertex, m
    turn             change of direction, rad
    nearest          distance at which the tool passes the vertex, m
    error            the largest contour error around it, m, unsigned
    rows             samples during which the tool passes it
    line             line of the part program that begins there, if known
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
    """The contour error of a run: the distance of each actual position from the commanded path.

    name, axes   name of the run, and the axes in the order of the columns
    time         time, s, shape (n,)
    set_position, position  commanded and actual positions, m, shape (n, N)
    error        distance from the nearest point of the path, m, shape (n,); for two axes it is positive on the left of
                 the path (on a counter-clockwise circle: inside), but unsigned where the nearest point is a corner or
                 an end; for more axes it is unsigned
    vector       vector from the path to the tool, m, shape (n, N)
    along        path length of the nearest point, m, shape (n,)
    at_corner    True where the nearest point is a corner or an end, shape (n,)
    estimate     contour error estimated from the tracking error to second order, m, shape (n,); None if there are no
                 velocities
    lag          lag of the tool behind its set position along the path, m, shape (n,)
    line         part program lines, shape (n,), or None
    counted      True for samples that are included in the figures and the worst places, shape (n,)
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
        """True if the error is signed, which it is for two axes."""
        return len(self.axes) == 2

    @property
    def largest(self) -> float:
        """The largest contour error of all included samples, m."""
        return float(np.max(np.abs(self.error[self.counted]), initial=0.0))

    @cached_property
    def weights(self) -> np.ndarray:
        """The weight of each sample by path length: half the distance to both neighbors, 0 at a standstill."""
        way = np.diff(lengths(self.set_position))
        share = 0.5 * (np.append(way, 0.0) + np.insert(way, 0, 0.0)) * self.counted
        total = float(np.sum(share))
        return share / total if total > 0.0 else share

    @property
    def rms(self) -> float:
        """The RMS contour error along the path, m."""
        return float(np.sqrt(np.sum(self.weights * self.error**2)))

    def within(self, share: float = 0.95) -> float:
        """Return the contour error (m) that is not exceeded on this fraction of the path; 0 if there are no samples."""
        sizes, weights = np.abs(self.error[self.counted]), self.weights[self.counted]
        order = np.argsort(sizes)
        # rounding may leave the sum of all weights just below 1
        place = np.searchsorted(np.cumsum(weights[order]), share - 1e-12)
        return float(sizes[order[min(int(place), len(order) - 1)]]) if len(order) else 0.0

    def worst(self, count: int = WORST, apart: float | None = None) -> list[Worst]:
        """Return the largest errors of the included samples, largest first, each from a separate peak of the error.

        apart  minimum path length between two of them, m; default: a thousandth of the path
        """
        reach = _NEAR * float(self.curve.along[-1]) if apart is None else apart
        left = np.where(self.counted, np.abs(self.error), 0.0)
        places: list[Worst] = []
        while len(places) < count and np.max(left, initial=0.0) > 0.0:
            i = int(np.argmax(left))
            line = None if self.line is None else int(self.line[i])
            places.append(
                Worst(float(self.time[i]), float(self.along[i]), float(self.error[i]), self.position[i], line)
            )
            # one place is its neighborhood on the path, and all around it where the error stays large
            away = np.abs(self.along - self.along[i]) > reach
            calm = np.flatnonzero(away & (np.abs(self.error) < _LARGE * abs(self.error[i])))
            k = int(np.searchsorted(calm, i))
            begin, end = calm[k - 1] + 1 if k else 0, calm[k] if k < len(calm) else len(left)
            left[begin:end] = 0.0
            left[~away] = 0.0
        return places

    def corners(self, least: float = np.radians(5.0), reach: float | None = None) -> list[Corner]:
        """Return the corners of the path that turn by at least `least`, rad.

        reach  path length before and after a corner that belongs to it, m; default: twice the largest lag, but at most
               half the distance to the next corner
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
        corners_seen: list[Corner] = []
        for node, place, low, high in zip(nodes, places, lows, highs, strict=True):
            # the tool lags: it still passes the corner after the set position has left its range
            begin, stop = np.searchsorted(commanded, [low, high + (high - place)])
            rows = slice(int(begin), max(int(stop), int(begin) + 1))
            vertex = self.curve.node[node]
            here = np.abs(self.error[rows])[(self.along[rows] >= low) & (self.along[rows] <= high)]
            distance = _to_point(self.position[rows], vertex)
            behind = min(int(np.searchsorted(commanded, place, side="right")), len(self.time) - 1)
            line = None if self.line is None else int(self.line[behind])
            corners_seen.append(
                Corner(float(place), vertex, float(turn[node]), distance, float(np.max(here, initial=0.0)), rows, line)
            )
        return corners_seen

    def table(self) -> Table:
        """Return a table of the worst places, with the largest, RMS and 95 % error in its title."""
        title = Text(
            f"{self.name}: contour error {Quantity(self.largest, 'm')} at most, {Quantity(self.rms, 'm')} RMS, "
            f"{Quantity(self.within(0.95), 'm')} on 95 % of {Quantity(float(self.curve.along[-1]), 'm'):mm}; lag at "
            f"most {Quantity(float(np.max(np.abs(self.lag))), 'm')}"
        )
        columns = [
            Column("worst places"),
            Column("error", "m", "+.4g" if self.signed else ""),
            Column("time", "s", "4 s"),
            Column("along the path", "m", "5 mm"),
            *(Column(name, "m", "5 mm") for name in self.axes),
            *([] if self.line is None else [Column("line")]),
        ]
        rows = [
            [
                i + 1,
                place.error,
                place.time,
                place.along,
                *map(float, place.position),
                *([] if self.line is None else [place.line]),
            ]
            for i, place in enumerate(self.worst())
        ]
        return Table(title, columns, rows)


def _to_point(position: np.ndarray, point: np.ndarray) -> float:
    """Return the distance, in m, of a point from the polyline through positions."""
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
    curve: Curve | None = None,
) -> ContourError:
    """Compute the distance of the tool from its path: ε = ± |P - c(u)| with (c(u) - P) · c'(u) = 0.

        estimate  ε = -e_n - κ e_t²/2,  e = set - actual position, n left of the direction t, κ > 0 in a left turn

    actual        a run of a machine, or positions, m, shape (n, N), one row per set position
    path          set positions, m, shape (n, N), or references by axis; default: those of the run
    axes          names of the columns; default: all linear axes of the run
    velocity, acceleration  derivatives of set positions given as an array, m/s and m/s², shape (n, N): without them,
                  or with velocities that are backward differences, tangents follow from the set positions, and there is
                  no estimate
    signal        actual position of the run: `tool`, the tool point of a machine with geometry errors, or else the
                  table; `position_load`, the table; or `reading_load`, the table as measured by the controller
    line          part program line of each row
    counted       True for rows that are included in the figures, shape (n,); default: all
    sample_time   sample time of arrays, s
    window        range of path length around the set position that is searched for the nearest point, m; default: twice
                  the largest tracking error, which is at least 2 V (lag + dead time).  Parts of a path that are closer
                  to each other than the window are not distinguished

    curve         `curve_of_motion` of the set positions, if several runs follow them; default: `curve_through`

    The path between two set positions is a cubic (`curve_through`); a standstill is one point, a corner has no normal.
    The estimate is accurate to second order.  Source: definition of the contour error, Koren & Lo 1991.
    Raises ParameterError for fewer than two axes, an unknown name, shapes that differ, numbers that are not finite, and
    a path that does not move.
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
    optional = {"path": path, "velocity": velocity, "acceleration": acceleration}
    rows = {key: _checked(key, value, position) for key, value in optional.items() if value is not None}
    _checked("positions", position, position)
    if "velocity" in rows and _differenced(rows["path"], rows["velocity"], step):
        del rows["velocity"]
    if line is not None and np.shape(line) != time.shape:
        raise ParameterError(f"line has {np.size(line)} rows, the positions have {len(time)}")
    if counted is not None and np.shape(counted) != time.shape:
        raise ParameterError(f"counted has {np.size(counted)} rows, the positions have {len(time)}")
    setpoint, speed = rows["path"], rows.get("velocity")
    if curve is None:
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
    """Return the contour error: positive on the left of the path, unsigned at corners or with more than two axes."""
    distance = size(vector)
    if vector.shape[1] != 2:
        return distance
    left = tangent[:, 0] * vector[:, 1] - tangent[:, 1] * vector[:, 0]
    return np.where((left < 0.0) & ~corner, -distance, distance)


def _estimate(e: np.ndarray, velocity: np.ndarray, acceleration: np.ndarray) -> np.ndarray:
    """Return the estimate ε = -e_n - κ e_t²/2, or NaN where the set position is at rest."""
    speed = size(velocity)
    moves = speed > _SLOW
    t = unit(velocity)
    behind = np.sum(e * t, axis=1)
    bend = acceleration - np.sum(acceleration * t, axis=1)[:, None] * t
    bend = bend / np.where(moves, speed, 1.0)[:, None] ** 2
    vector = behind[:, None] * t - e - (0.5 * behind**2)[:, None] * bend
    return np.where(moves, _signed(vector, t, np.zeros(len(e), bool)), np.nan)


def _differenced(position: np.ndarray, velocity: np.ndarray, T: float) -> bool:
    """Return True if the velocities are backward differences of the positions; these are not tangent to the path."""
    # a backward difference is the velocity of half a sample ago: on an arc it is not tangential
    step = np.diff(position, axis=0)
    away = np.max(np.abs(T * velocity[1:] - step), initial=0.0)
    return bool(away <= 1e-9 * np.max(np.abs(step), initial=0.0))


def _axes(run: Run, axes: Sequence[str] | None) -> tuple[str, ...]:
    """Return the requested axes of a run, by default all linear axes."""
    ports = [signal.removesuffix("set_position") for signal in run.signals if signal.endswith(".set_position")]
    if axes is None:
        return tuple(port[:-1] for port in ports if port not in run.turning)
    for name in axes:
        if f"{name}." not in ports:
            raise ParameterError(f"the run has no axis '{name}'; it has {', '.join(port[:-1] for port in ports)}")
    return tuple(axes)


def tool_columns(run: Run, axes: Sequence[str], signal: str) -> np.ndarray:
    """Return positions of axes, m, shape (n, N): the tool point if the run has it, or a signal of each axis."""
    if signal == "tool":
        there = all(f"tool.{name}" in run.signals for name in axes)
        names = [f"tool.{name}" if there else f"{name}.position_load" for name in axes]
    else:
        names = [f"{name}.{signal}" for name in axes]
    return np.column_stack([run[name] for name in names]) if axes else np.zeros((run.samples, 0))


def _followed(path: Mapping[str, Reference], axes: Sequence[str], time: np.ndarray) -> tuple[Any, Any, Any]:
    """Return the position, velocity and acceleration of the references of all axes at each time (s)."""
    absent = [name for name in axes if name not in path]
    if absent:
        raise ParameterError(f"there is no reference of axis {', '.join(absent)}; there are {', '.join(path)}")
    points = [path[name].at(time) for name in axes]
    position, velocity, acceleration = (np.column_stack([row[i] for row in points]) for i in range(3))
    return position, velocity, acceleration


def _checked(name: str, values: Any, position: np.ndarray) -> np.ndarray:
    """Convert values to an array of the shape of the positions. Raise ParameterError for another shape or NaN."""
    array = np.asarray(values, dtype=np.float64)
    if array.shape != position.shape:
        raise ParameterError(f"{name} is of shape {array.shape}, the positions are of shape {position.shape}")
    if not np.all(np.isfinite(array)):
        row = int(np.flatnonzero(~np.all(np.isfinite(array), axis=1))[0])
        raise ParameterError(f"{name}: row {row} holds a number that is not finite")
    return array
