"""The length that counts for one radian of a rotary axis, by which one tolerance bounds lengths and angles.

A path of linear and rotary axes is joined and measured in coordinates in which an angle is multiplied by the weight
P / α (m/rad), with the tolerance P of lengths and the tolerance α of the axis.  A path within P of the program in these
coordinates is within P of it in the linear axes, and within α in each rotary axis.  With any other weight w both hold
within the tolerance min(P, α w).

The direction of a tool whose tip is moved turns by at most √(1 + |n₁·n₂|) times the distance of the angles of both
rotary joints, n the directions of their axes.  With this factor in the weights α bounds the direction as well.

The weights hold for a whole run, since its parameter u is measured by them.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

ROTARY = "ABC"
"""The letters of the rotary axes, whose positions are in rad instead of m."""
ANGLE_TOLERANCE = math.radians(0.05)
"""The tolerance of a rotary axis that states none, rad."""
# a path without a tolerance has weights as well, for its speed
_USUAL = 1e-5  # m, the tolerance of which it then has the weights
# beyond, lengths would leave the range for which knots and windows of the planner are made
_LIGHTEST, _HEAVIEST = 1e-3, 10.0  # m/rad
_EQUAL = 1e-9  # relative: weights that differ by less are the same


class Weights:
    """The weights of the axes in the current run.

    values  the length that counts for one m or rad of each axis, m, shape (N,); None without a rotary axis: 1

    axes             letters of the axes
    angle_tolerance  tolerance of each axis, rad, one number or shape (N,); that of linear axes has no effect
    """

    def __init__(self, axes: str, angle_tolerance: ArrayLike = ANGLE_TOLERANCE) -> None:
        angles = np.broadcast_to(np.asarray(angle_tolerance, float), len(axes))
        self._angles = np.where([letter in ROTARY for letter in axes], angles, math.inf)
        turns = bool(np.isfinite(self._angles).any())
        self._tolerance, self._turned, self._gain = 0.0, False, 1.0
        self.values = self._wanted(_USUAL) if turns else None
        self._suit, self._bound = True, math.inf
        self.allow(0.0)

    def _wanted(self, tolerance: float) -> np.ndarray:
        wanted = np.clip(self._gain * tolerance / self._angles, _LIGHTEST, _HEAVIEST)
        return np.where(np.isfinite(self._angles), wanted, 1.0)

    def allow(self, tolerance: float) -> None:
        """Set the tolerance of the following moves, m; 0: no deviation."""
        self._tolerance = tolerance
        if self.values is not None:
            # computed here and not for each move, of which there may be millions
            self._suit = not tolerance or np.allclose(self._wanted(tolerance), self.values, rtol=_EQUAL, atol=0.0)
            self._bound = float(np.min(self._angles * self.values)) / self._gain

    def aim(self, cosine: float) -> None:
        """Take the cosine of the angle between the axes of both rotary joints, which aim a tool from the next run on; 0
        where no tool is aimed.
        """
        self._gain = math.sqrt(1.0 + abs(cosine))
        self.allow(self._tolerance)

    def begin(self) -> None:
        """Choose the weights of the next run."""
        self._turned = False
        if self.values is not None and self._tolerance > 0.0:
            self.values = self._wanted(self._tolerance)
            self.allow(self._tolerance)

    def fit(self, turns: bool) -> bool:
        """Return True if the weights suit a move, so that it may continue the run; `turns`: it moves a rotary axis."""
        if not turns and not self._turned:
            return True
        # the first move that turns reduces the tolerance of the run, if the weights are bounded
        return self._suit and (self._turned or self._bound >= self._tolerance * (1.0 - _EQUAL))

    def tolerance_of(self, turns: bool, off: float = 0.0) -> float:
        """Return the tolerance of the next move in weighted coordinates, m; `turns` as in `fit`.

        off  part of the tolerance of the angles that is used up, rad
        """
        self._turned = self._turned or turns
        # an axis that does not turn in the whole run deviates by nothing
        if not self._turned:
            return self._tolerance
        if not off:
            return min(self._tolerance, self._bound)
        assert self.values is not None
        return max(0.0, min(self._tolerance, float(np.min((self._angles - off) * self.values)) / self._gain))

    @property
    def angle(self) -> float:
        """The smallest tolerance of a rotary axis, rad, where a deviation is allowed; otherwise 0."""
        return float(np.min(self._angles)) if self._tolerance > 0.0 else 0.0
