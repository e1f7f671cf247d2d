"""A motion along a path as pieces of constant snap in time, and where it is when."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.source import Floats2
from feeddrive.path.pieces import Pieces


class Motion(NamedTuple):
    """u(t) along a path as m pieces of constant u''''.

    duration  s, shape (m,)
    piece     index of the piece of the path in which each begins, shape (m,)
    x         m, where in it
    speed, acceleration, jerk, snap  u' .. u'''' at its begin, m/s .. m/s⁴
    """

    duration: np.ndarray
    piece: np.ndarray
    x: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    jerk: np.ndarray
    snap: np.ndarray


class Entering(NamedTuple):
    """The next run, from rest, while a part ends the run before: q is the sum of both, less the corner between them.

    Its pieces of time are those of that part, and each of both stays on one piece of its path.

    tolerance  m, of the distance between q and the two pieces, which is proven, too
    """

    pieces: Pieces
    motion: Motion
    tolerance: float


class Part(NamedTuple):
    """A part of a run, which goes from rest to rest: some pieces of its path and the motion on them.

    The first piece of the path is the one on which the part before ended.  `ends` says that the run does.  If the next
    run is `entering` then, the part behind goes on from where that one has come.

    mode  of the path (`PathMode`) for which the run ends; empty where its tolerance is not enough
    """

    pieces: Pieces
    motion: Motion
    ends: bool
    entering: Entering | None = None
    mode: str = ""


class Pause(NamedTuple):
    """A standstill: a dwell or a hold of `duration` s, or 0 s at what waits for something else."""

    duration: float
    why: str
    line: int


def rows(motion: Motion) -> np.ndarray:
    """Duration, x, speed, acceleration, jerk and snap as the columns of one array, without the index of the piece."""
    found = np.empty((len(motion.duration), 6))
    found[:, 0] = motion.duration
    for k, each in enumerate(motion[2:]):
        found[:, k + 1] = each
    return found


def from_rows(new: np.ndarray, piece: int, x: float = 0.0) -> Motion:
    """The motion of such rows from x on, on one piece of the path."""
    duration, place, *state = new.T.copy()
    place += x
    return Motion(duration, np.full(len(new), piece), place, *state)


@kernel
def cubic(a: float, b: float, c: float, d: float, t: float) -> float:
    """a + b t + c t²/2 + d t³/6: u' from u' .. u'''' at t = 0."""
    return a + t * (b + t * (0.5 * c + t * d / 6.0))


@kernel
def way(v: float, a: float, j: float, s: float, t: float) -> float:
    """∫ u' from 0 to t."""
    return t * (v + t * (0.5 * a + t * (j / 6.0 + t * s / 24.0)))


@kernel
def when(far: float, v: float, a: float, j: float, s: float, t0: float, t1: float) -> float:
    """The time in [t0, t1] when a rising u has come this far: bisection, with Newton's step where it is inside."""
    low = t0
    high = t1
    t = 0.5 * (low + high)
    for _ in range(200):
        miss = way(v, a, j, s, t) - far
        if miss > 0.0:
            high = t
        else:
            low = t
        slope = cubic(v, a, j, s, t)
        step = t - miss / slope if slope > 0.0 else low
        if step <= low or step >= high:
            step = 0.5 * (low + high)
        if step == t or step <= low or step >= high:
            break
        t = step
    return t


@kernel
def chain(v: float, a: float, j: float, s: float, r: Floats2, out: Floats2) -> int:
    """q' .. q'''' of each axis from u' .. u'''' and r' .. r'''' in columns 1 to 4 of r; into columns 1 to 4 of out."""
    for i in range(len(r)):
        out[i, 1] = r[i, 1] * v
        out[i, 2] = r[i, 2] * v * v + r[i, 1] * a
        out[i, 3] = r[i, 3] * v * v * v + 3.0 * r[i, 2] * v * a + r[i, 1] * j
        out[i, 4] = (
            r[i, 4] * v * v * v * v + 6.0 * r[i, 3] * v * v * a + r[i, 2] * (3.0 * a * a + 4.0 * v * j) + r[i, 1] * s
        )
    return 0
