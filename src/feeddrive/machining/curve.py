"""A commanded path as a curve through its set positions, and the nearest point of it to each actual position."""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from feeddrive.language.errors import ParameterError
from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.source import Floats, Floats2, Ints

_SAME = 1e-9  # m: set positions that lie closer are one
_BEND = 0.35  # rad: between two chords; a larger one is a corner where no velocity tells the tangent
_ALONG = 0.5  # cosine to the chord: a velocity that differs more is that of another side, or of a standstill
CORNER = 1e-3  # rad: a smaller turn of the tangent at a set position is none


class Curve(NamedTuple):
    """Pieces of third degree (Hermite) from node to node; a turn between two pieces is a corner.

    node    m, shape (n, N)
    along   path length at each node, m, shape (n,)
    begin, end  derivatives of piece k at its two ends by the share of the piece, m, shape (n - 1, N)
    row     of the set position that each node is, shape (n,)
    """

    node: np.ndarray
    along: np.ndarray
    begin: np.ndarray
    end: np.ndarray
    row: np.ndarray

    @property
    def turn(self) -> np.ndarray:
        """The turn of the tangent at each node, rad, 0 at both ends of the path, shape (n,)."""
        found = np.zeros(len(self.node))
        step = unit(self.begin[1:]) - unit(self.end[:-1])
        found[1:-1] = 2.0 * np.arcsin(np.minimum(1.0, 0.5 * size(step)))
        return found

    def place(self, rows: int) -> np.ndarray:
        """Path length at each of the set positions of which it was made, m, shape (rows,)."""
        return self.along[np.searchsorted(self.row, np.arange(rows), side="right") - 1]


def size(vectors: np.ndarray) -> np.ndarray:
    """The length of each of some vectors, shape (n,); a third of the time of numpy's norm."""
    return np.sqrt(np.einsum("ij,ij->i", vectors, vectors))


def unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors of length 1, shape (n, N); one of length 0 stays."""
    length = size(vectors)
    return vectors / np.where(length > 0.0, length, 1.0)[:, None]


def lengths(position: np.ndarray) -> np.ndarray:
    """Length of the straight lines up to each of some positions, m, shape (n,)."""
    return np.concatenate([[0.0], np.cumsum(size(np.diff(position, axis=0)))])


def curve_through(position: np.ndarray, velocity: np.ndarray | None = None) -> Curve:
    """The curve through set positions, m, shape (n, N); standstills become one node.

    The tangent is that of the velocity (m/s, the same shape); without one, that of the circle through three nodes
    unless their chords turn by more than 20°, a corner.  On an arc that turns by δ from row to row the curve is right
    to R δ⁶/1000.

    Raises ParameterError if the positions are no such array or do not move by 1 nm.
    """
    passed = np.floor(lengths(position) / _SAME)
    row = np.flatnonzero(np.diff(passed, prepend=-1.0) > 0.0)
    if len(row) < 2:
        raise ParameterError("the set positions do not move: a contour error needs a path")
    node = np.ascontiguousarray(position[row])
    chord = np.diff(node, axis=0)
    length = size(chord)
    direction = unit(chord)
    if velocity is None:
        both = length[1:, None] * direction[:-1] + length[:-1, None] * direction[1:]
        at = unit(np.vstack([direction[:1], both, direction[-1:]]))
        if len(node) > 2:  # the ends of the circle through the first, the last three nodes
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
    bent = size(sides[1] - sides[0]) ** 2
    arc = (length * (1.0 + bent / 16.0))[:, None]  # the length of the tangents with which a piece is an arc
    along = np.concatenate([[0.0], np.cumsum(length * (1.0 + bent / 24.0))])
    return Curve(node, along, np.ascontiguousarray(arc * sides[0]), np.ascontiguousarray(arc * sides[1]), row)


class Feet(NamedTuple):
    """The nearest point of a curve to each of some positions.

    along   its path length, m, shape (n,)
    vector  from it to the position, m, shape (n, N)
    tangent of the curve there, length 1, shape (n, N)
    corner  whether it is a corner or an end of the path, which has no normal, shape (n,)
    """

    along: np.ndarray
    vector: np.ndarray
    tangent: np.ndarray
    corner: np.ndarray


def feet(curve: Curve, position: np.ndarray, expected: np.ndarray | None, window: float) -> Feet:
    """The nearest points to positions, m, shape (n, N), each within `window` m of path length around where it belongs.

    expected  path length at which each belongs, m, shape (n,); without it that of the foot before, and the whole path
              for the first one
    """
    position = np.ascontiguousarray(position, dtype=np.float64)
    n, axes = position.shape
    along, vector, tangent = np.empty(n), np.empty((n, axes)), np.empty((n, axes))
    corner = np.zeros(n, np.int64)
    around = np.zeros(0) if expected is None else np.ascontiguousarray(expected, dtype=np.float64)
    turn = curve.turn > CORNER
    turn[[0, -1]] = True
    longest = float(np.max(np.diff(curve.along)))
    path = (curve.node, curve.along, curve.begin, curve.end, np.ascontiguousarray(turn, dtype=np.int64))
    _feet(position, *path, around, window, longest, along, vector, tangent, corner)
    return Feet(along, vector, tangent, corner > 0)


@kernel
def _share(place: Floats, begin: Floats, end: Floats) -> float:
    """The share of a straight piece, 0 .. 1, at which it is nearest to a place."""
    on = 0.0
    length = 0.0
    for i in range(len(place)):
        d = end[i] - begin[i]
        on = on + d * (place[i] - begin[i])
        length = length + d * d
    return min(max(on / length, 0.0), 1.0)


@kernel
def _cubic(d: float, begin: float, end: float, u: float) -> tuple[float, float, float]:
    """A piece by its chord and the derivatives at its ends: way from its begin, first and second derivative by u."""
    b = 3.0 * d - 2.0 * begin - end
    c = begin + end - 2.0 * d
    return u * (begin + u * (b + u * c)), begin + u * (2.0 * b + 3.0 * c * u), 2.0 * b + 6.0 * c * u


@kernel
def _chord(place: Floats, begin: Floats, end: Floats) -> float:
    """Squared distance of a place from a straight piece."""
    u = _share(place, begin, end)
    found = 0.0
    for i in range(len(place)):
        r = place[i] - begin[i] - u * (end[i] - begin[i])
        found = found + r * r
    return found


@kernel
def _on_piece(place: Floats, node: Floats, after: Floats, begin: Floats, end: Floats) -> tuple[float, float]:
    """The nearest point of a piece, by Newton's method: its share of the piece, 0 .. 1, and the squared distance."""
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
            curved = speed  # beyond the center of the curvature: downhill still
        moved = min(max(u - slope / curved, 0.0), 1.0)
        if abs(moved - u) < 1e-13:
            break
        u = moved
    return u, square


@kernel
def _feet(
    position: Floats2, node: Floats2, along: Floats, begin: Floats2, end: Floats2, turn: Ints, expected: Floats,
    window: float, longest: float, found: Floats, vector: Floats2, tangent: Floats2, corner: Ints,
) -> int:  # fmt: skip
    """The foot of each position: straight pieces decide which piece it is, Newton's method where."""
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
        found[n] = foot
    return len(position)
