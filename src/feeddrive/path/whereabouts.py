"""Where the parts of a plan are at given times and at their ends: piece and line, feed, position and direction."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.source import Floats, Ints
from feeddrive.language.series import Taylor
from feeddrive.path.feed_loss import CORNER
from feeddrive.path.motion import Changes, Motion, Part, Pieces, TipColumns, cubic, derivatives, direction, way

TANGENT = 1e-6  # rad: a smaller angle is not a corner
_STANDS = 1e-9  # speed of the tip over u': below it only angles change, and the feed is theirs


def tip_speed(values: np.ndarray, tip: TipColumns, rate: np.ndarray, feed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the speed of the tip in the frame of the workpiece and its feed, m/s; where the tip stands, u' and its
    bound.

    values  samples of the joints;  rate  u', m/s;  feed  the bound of u'
    """
    linear, rotary = ([Taylor(values[:, k, 0], values[:, k, 1]) for k in columns] for columns in tip[1:])
    speed = np.sqrt(sum(axis.terms[1] ** 2 for axis in tip.kinematics.tip(linear, rotary)))
    moves = (rate > 0.0) & (speed > _STANDS * rate)
    # the feed of paced pieces bounds u', of which the speed of the tip is a multiple
    multiple = np.where(moves, speed, 1.0) / np.where(moves, rate, 1.0)
    return np.where(moves, speed, rate), feed * multiple


class Where(NamedTuple):
    """Where a part is at given times.

    line        program line
    feed        bound of the path speed of the run, m/s
    shape       LINE, ARC, POLYNOMIAL or PACED, or CORNER where two runs overlap
    programmed  programmed feed, m/s; where two runs overlap that of both ways: (u0' + u1')/F = u0'/F0 + u1'/F1
    rate        u' of the run, m/s
    """

    line: np.ndarray
    feed: np.ndarray
    shape: np.ndarray
    programmed: np.ndarray
    rate: np.ndarray


def where_at(part: Part, times: np.ndarray, velocity: np.ndarray) -> Where:
    """Return where a part is at given times, s, from its start.

    velocity  velocity limits of the axes, m/s, which are the feed of a traverse where two runs overlap
    """
    at = _along_path(part.pieces, part.motion, part.lines, times)
    feed = part.pieces.feed[at.piece]
    if part.entering is None:
        return Where(at.line, feed, part.pieces.kind[at.piece], feed, at.rate)
    entering = part.entering
    other = _along_path(entering.pieces, entering.motion, entering.lines, times)
    # that of the run that is farther from the corner: the distance to the path is measured from its point (`proof`)
    entered = other.gone > float(np.sum(part.pieces.length)) - at.gone
    first, second = np.abs(at.rate), np.abs(other.rate)
    slowness = first / _feed(part.pieces, velocity, part.weights)
    slowness += second / _feed(entering.pieces, velocity, part.weights)
    return Where(
        np.where(entered, other.line, at.line),
        np.where(entered, entering.pieces.feed[other.piece], feed),
        np.full(len(times), CORNER),
        np.where(slowness > 0.0, (first + second) / np.where(slowness > 0.0, slowness, 1.0), feed),
        at.rate,
    )


class _Along(NamedTuple):
    """Distance from the start of the first piece (m), index of the piece, program line and u' (m/s) of a run."""

    gone: np.ndarray
    piece: np.ndarray
    line: np.ndarray
    rate: np.ndarray


@kernel
def _walk(far: Floats, motion: Motion, times: Floats, gone: Floats, piece: Ints, rate: Floats) -> int:
    """Write distance, piece and u' at ascending times; `far` are the distances to the ends of the pieces, m."""
    m = 0
    ends = motion.duration[0]  # of time interval m
    begin = ends - motion.duration[0]
    last = len(motion.duration) - 1
    for k in range(len(times)):
        while m < last and (ends + motion.duration[m + 1]) - motion.duration[m + 1] <= times[k]:
            m = m + 1
            ends = ends + motion.duration[m]
            begin = ends - motion.duration[m]
        p = int(motion.piece[m])
        since = times[k] - begin
        v, a, j, s = motion.speed[m], motion.acceleration[m], motion.jerk[m], motion.snap[m]
        u = (far[p - 1] if p > 0 else 0.0) + motion.x[m] + way(v, a, j, s, since)
        while p + 1 < len(far) and far[p] < u:
            p = p + 1
        gone[k] = u
        piece[k] = p
        rate[k] = cubic(v, a, j, s, since)
    return 0


def _along_path(pieces: Pieces, motion: Motion, lines: Changes | None, times: np.ndarray) -> _Along:
    """Return where a run is at given times, s, from the start of its motion."""
    n = len(times)
    u, p, rate = np.empty(n), np.empty(n, np.int64), np.empty(n)
    _walk(pieces.length.cumsum(), motion, times, u, p, rate)
    if lines is None:
        return _Along(u, p, pieces.line[p], rate)
    k = np.maximum(lines.at.searchsorted(u, side="right") - 1, 0)
    return _Along(u, p, lines.line[k], rate)


def _feed(pieces: Pieces, velocity: np.ndarray, weights: np.ndarray | None) -> float:
    """Return the feed of a single piece, on a traverse the largest speed along it within the velocity limits, m/s."""
    feed = float(pieces.feed[0])
    if math.isfinite(feed):
        return feed
    along = np.abs(direction(pieces, 0))
    length = float(np.linalg.norm(along if weights is None else along * weights))
    return length / max(float(np.max(along / velocity)), 1e-300)


def end_of(part: Part) -> tuple[np.ndarray, np.ndarray]:
    """Return the position and direction at the end of a part that ends at rest."""
    pieces, motion = part.pieces, part.motion
    p, last = int(motion.piece[-1]), len(pieces.length) - 1
    x = float(motion.x[-1] + way(*(float(column[-1]) for column in (*motion[3:], motion.duration))))
    # a run ends exactly at the end of its path, from which x differs by rounding
    while p < last and (part.ends or x > pieces.length[p]):
        x, p = x - float(pieces.length[p]), p + 1
    length = float(pieces.length[p])
    r = np.zeros((pieces.origin.shape[1], 5))
    derivatives(int(pieces.kind[p]), length, pieces.shape[p], length if part.ends else min(x, length), r)
    place = pieces.origin[p] + r[:, 0]
    if part.weights is not None:
        r *= part.weights[:, None]
    return place, direction_of(r, length, -1.0)


def direction_of(r: np.ndarray, length: float, side: float) -> np.ndarray:
    """Return the path direction at the start (`side` 1) or end (-1) of a piece, also where r' of a spline is 0."""
    # r' vanishes at the end of a spline whose control points coincide: the next derivative has the direction
    for k in (1, 2, 3):
        size = float(np.linalg.norm(r[:, k]))
        if size * length ** (k - 1) > TANGENT:
            return side ** (k - 1) * r[:, k] / size
    return np.zeros(len(r))
