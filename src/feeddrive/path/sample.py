"""Setpoints of a planned motion: position to snap of each axis at the sampling instants of a loop."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.source import Floats, Floats2, Floats3, Ints
from feeddrive.path.motion import Motion, Part, chain, cubic, way
from feeddrive.path.pieces import Pieces, derivatives


@kernel
def _sample(
    kind: Ints, length: Floats, origin: Floats2, shape: Floats3,
    duration: Floats, piece: Ints, x: Floats, speed: Floats, acceleration: Floats, jerk: Floats, snap: Floats,
    begin: float, sample_time: float, first: int, out: Floats3, r: Floats2,
) -> int:  # fmt: skip
    """Samples `first`, `first` + 1 ... of a motion that begins at the time `begin`; how many lie within it."""
    count = 0
    since = begin
    last = len(length) - 1
    for m in range(len(duration)):
        T = duration[m]
        p = int(piece[m])
        x0 = x[m]
        while count < len(out):
            t = (first + count) * sample_time - since
            if t >= T:
                break
            t = max(t, 0.0)
            here = x0 + way(speed[m], acceleration[m], jerk[m], snap[m], t)
            while here > length[p] and p < last:
                x0 = x0 - length[p]
                here = here - length[p]
                p = p + 1
            here = min(max(here, 0.0), length[p])
            derivatives(kind[p], length[p], shape[p], here, r)
            v = cubic(speed[m], acceleration[m], jerk[m], snap[m], t)
            chain(v, acceleration[m] + t * (jerk[m] + 0.5 * t * snap[m]), jerk[m] + t * snap[m], snap[m], r, out[count])
            for i in range(len(r)):
                out[count, i, 0] = origin[p, i] + r[i, 0]
            count = count + 1
        since = since + T
    return count


class Sampler:
    """Samples the parts of runs one after the other at k T, k = 0, 1, 2 ...; `sample_time` in s."""

    def __init__(self, sample_time: float) -> None:
        self._sample_time = sample_time
        self._begin, self._first = 0.0, 0

    def sample(self, part: Part) -> np.ndarray:
        """Position, velocity .. snap of each axis at the instants within a part, m .. m/s⁴, shape (n, N, 5)."""
        return np.concatenate(list(self.slices(part)))

    def slices(self, part: Part, most: int = 16384) -> Iterator[np.ndarray]:
        """The same, at most so many instants at once: a part may last for hours."""
        ends = self._begin + float(np.sum(part.motion.duration))
        full = True
        while full:
            found = self._along(part.pieces, part.motion, ends, most)
            full = len(found) == most
            if part.entering is not None:
                corner = part.entering.pieces.origin[0]
                other = self._along(part.entering.pieces, part.entering.motion, ends, most)
                found[:, :, 0] -= corner
                found += other
            self._first += len(found)
            yield found
        self._begin = ends

    def _along(self, pieces: Pieces, motion: Motion, ends: float, most: int) -> np.ndarray:
        axes = pieces.origin.shape[1]
        left = max(0, int(np.ceil(ends / self._sample_time)) + 1 - self._first)
        out = np.empty((min(most, left), axes, 5))
        path = (pieces.kind, pieces.length, pieces.origin, pieces.shape)
        count = _sample(*path, *motion, self._begin, self._sample_time, self._first, out, np.zeros((axes, 5)))
        return out[:count]

    def rest(self, position: np.ndarray, duration: float) -> np.ndarray:
        """The same of a standstill of `duration` s at a position (m, shape (N,)), as at a dwell or at the end."""
        ends = self._begin + duration
        count = max(0, int(np.ceil(ends / self._sample_time)) - self._first)
        out = np.zeros((count, len(position), 5))
        out[:, :, 0] = position
        self._begin, self._first = ends, self._first + count
        return out
