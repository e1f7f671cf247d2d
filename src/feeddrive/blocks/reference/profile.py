"""A rest-to-rest motion with piecewise constant snap, jerk or acceleration: convolved boxcars in closed form."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from feeddrive.blocks.reference.derivatives import Derivatives
from feeddrive.blocks.reference.stretches import Piece, moved
from feeddrive.blocks.sampled import check_duration
from feeddrive.language.errors import StructureError
from feeddrive.language.quantity import Quantity

_NAMES = ("position", "velocity", "acceleration", "jerk", "snap")
_UNITS = ("m/s", "m/s2", "m/s3", "m/s4")  # without that of the position
# relative to a limit or distance: far above the rounding errors of pieces of unequal length
_ROUNDING = 1e-9
# absolute: a number this small has no relative tolerance
_TINY = 1e-300


@dataclass(frozen=True, eq=False)
class Profile:
    """A rest-to-rest motion whose velocity is a rectangle convolved with boxcars, shortest boxcar first.

    `lengths` = (L₁, .., Lₙ) in s, the last being that of the rectangle; the velocity is a rectangle of length Lₙ and
    area `distance`, convolved with boxcars of unit area and lengths L₁ .. Lₙ₋₁.  Its highest derivative is piecewise
    constant, ± distance / (L₁ ⋯ Lₙ).  Each length is at least the sum of the shorter ones, so ramps never overlap.

    `starts` (s), `spans` (s) and `states` (5, pieces; position to snap at the start of a piece) are built from the
    recursion of the moves M₀ = constant, Mₖ(t) = ∫ Mₖ₋₁(t) - Mₖ₋₁(t - Lₖ) dt: a rise, a constant part, and the reversed
    rise.  Constant parts, zeros and mirror images are set exactly rather than accumulated, which avoids drift.
    """

    distance: float
    lengths: tuple[float, ...]

    @cached_property
    def duration(self) -> float:
        """The sum of all lengths, s."""
        return math.fsum(self.lengths)

    @cached_property
    def peaks(self) -> tuple[float, ...]:
        """The largest velocity, acceleration, ... in SI units, up to the derivative that is piecewise constant."""
        peaks, height = [], self.distance
        for length in reversed(self.lengths):
            height = height / length
            peaks.append(height)
        return tuple(peaks)

    @cached_property
    def _pieces(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        starts, spans, states = np.zeros(0), np.zeros(0), np.zeros((1, 0))
        height, span = self.peaks[-1], 0.0
        heights = (*reversed(self.peaks[:-1]), self.distance)
        for length, top in zip(self.lengths, heights, strict=True):
            integral = np.zeros(starts.size + 1)
            for i in range(starts.size):
                integral[i + 1] = integral[i] + _advance(states[:, i], spans[i])
            # set, not accumulated: a rise is point-symmetric, and a rounded sum would break the mirror image
            integral[-1] = 0.5 * height * span
            rise = np.vstack([integral[:-1], states])
            hold = np.zeros((states.shape[0] + 1, 1))
            hold[0], hold[1] = integral[-1], height
            back = np.vstack([top - integral[:0:-1], height - states[:1], -states[1:]])
            starts = np.concatenate([starts, [span], length + starts])
            spans = np.concatenate([spans, [length - span], spans])
            states = np.hstack([rise, hold, back])
            height, span = top, span + length
        return starts, spans, np.vstack([states, np.zeros((5 - states.shape[0], states.shape[1]))])

    @property
    def starts(self) -> np.ndarray:
        """The times at which the pieces start, s."""
        return self._pieces[0]

    @property
    def spans(self) -> np.ndarray:
        """The lengths of the pieces, s."""
        return self._pieces[1]

    @property
    def states(self) -> np.ndarray:
        """The position, velocity, acceleration, jerk and snap at the start of each piece, shape (5, pieces)."""
        return self._pieces[2]

    @cached_property
    def pieces(self) -> tuple[Piece, ...]:
        """The pieces in order of time."""
        return tuple(Piece(*row) for row in np.vstack(self._pieces).T.tolist())

    def at(self, t: np.ndarray) -> Derivatives:
        """Return the position and its derivatives at times t in 0 .. duration, integrated piece by piece."""
        # a sort costs more than the check, and times are nearly always ascending
        order = None if t.size < 2 or bool(np.all(t[1:] >= t[:-1])) else np.argsort(t, kind="stable")
        rising = t if order is None else t[order]
        # slices of ascending times: gathering the coefficients for each time would cost more
        bounds = [*np.searchsorted(rising, self.starts).tolist(), t.size]
        out = np.empty((5, t.size))
        for piece, (low, high) in zip(self.pieces, pairwise(bounds), strict=True):
            if low < high:
                for row, values in zip(out, piece.at(rising[low:high]), strict=True):  # type: ignore[arg-type]
                    row[low:high] = values
        if order is not None:
            # a copy: the assignment would overwrite columns before they are read
            out[:, order] = out.copy()
        return out[0], out[1], out[2], out[3], out[4]

    def check(self, kind: str, limits: Sequence[float]) -> None:
        """Integrate the pieces; raise StructureError for an exceeded limit (velocity first) or a wrong end position.

        Within a piece every derivative is monotone, so its extremes are at the ends.
        """
        check_duration(kind, self.duration)
        _, spans, states = self._pieces
        ends = np.stack(moved(states, spans))  # type: ignore[arg-type]
        after = np.zeros((5, spans.size))
        after[:, :-1], after[0, -1] = states[:, 1:], self.distance
        order = len(self.lengths)
        scales = (self.distance, *self.peaks)
        for name, end, start, scale in zip(_NAMES[:order], ends, after, scales, strict=False):
            if np.any(np.abs(end - start) > _ROUNDING * scale + _TINY):
                raise StructureError(f"{kind}: the {name} of the move is not continuous; please report its parameters")
        for name, unit, limit, start, end in zip(_NAMES[1:], _UNITS, limits, states[1:], ends[1:], strict=False):
            most = float(max(np.max(np.abs(start)), np.max(np.abs(end))))
            if not most <= limit * (1.0 + _ROUNDING):
                raise StructureError(
                    f"{kind}: its {name} reaches {Quantity(most, unit):6 SI}, over the limit of "
                    f"{Quantity(limit, unit):6 SI}"
                )


def _advance(state: np.ndarray, span: float) -> float:
    """Return the integral over a span of the polynomial whose value and derivatives at its start are in `state`."""
    total = 0.0
    for order in range(state.size - 1, -1, -1):
        total = span / (order + 1) * (state[order] + total)
    return total
