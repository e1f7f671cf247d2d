"""The proof that the tip of the tool follows its path: bounds between two points of every piece, without samples.

The joints r(ξ) of a piece are polynomials of seventh degree, and the tip is tip(r).  With p the path of the tip that
was joined from the program, e = tip(r) - p has the Taylor coefficients e₀ .. e₃ at both ends, which are computed, and

    |e(ξ)| <= Σ |e_k| of both ends + M/256,     M >= |e⁽⁸⁾|/8!

since the rest of a two-point Hermite polynomial is e⁽⁸⁾/8! ξ⁴ (1 - ξ)⁴, and its basis functions are at most 1.  M is
the eighth Taylor coefficient of tip(r), bounded for the whole piece by the magnitudes of all numbers that enter into
it, plus that of p, which is 0 if p is a polynomial.

The direction of the tool is that of the angles, and these are the ones of the joined path: e of their columns is
computed in the same way.  The angle between two directions of the tool is at most the distance of the rotary angles
times the largest singular value of both axes of rotation, √(1 + |n1 · n2|).

The distance of the joined path from the program is bounded where it is joined (`geometry/joints.py`).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import comb, factorial
from typing import Any, NamedTuple

import numpy as np

from feeddrive.language.series import Magnitude, Taylor
from feeddrive.path.geometry.tip import ToolPoint, series, ways
from feeddrive.path.motion import ARC, Pieces

_ORDER = 8
_ROUNDED = 1e-14  # relative to the largest coordinate: of the numbers e₀ .. e₃, which some hundred roundings make


class TipProof(NamedTuple):
    """What is proven of the tip and of the direction of the tool.

    deviation   largest distance of the tip from the programmed path, m
    angle       largest angle between the direction of the tool and the programmed one, rad
    mapped      part of the deviation that is due to the polynomials of the joints, m
    pieces      number of pieces
    """

    deviation: float
    angle: float
    mapped: float
    pieces: int


@dataclass
class TipProver:
    """The prover of consecutive sections of a path of the tip."""

    joined: float = 0.0
    turned: float = 0.0
    mapped: float = 0.0
    skewed: float = 0.0
    pieces: int = 0

    def join(self, deviation: float, weights: np.ndarray) -> None:
        """Take a bound on the distance of the joined path from the program, in coordinates in which angles are
        multiplied by the smallest of `weights`, m/rad.
        """
        self.joined = max(self.joined, deviation)
        self.turned = max(self.turned, deviation / float(np.min(weights)))

    def prove(self, tip: Pieces, joints: Pieces, tool: ToolPoint) -> float:
        """Return a bound on the distance of the tip from its path over pieces, m, and keep the largest."""
        apart, skewed = tip_bounds(tip, joints, tool)
        most = float(np.max(apart, initial=0.0))
        # a bound that is no number must not pass as the smallest one
        self.mapped = most if not most <= self.mapped else self.mapped
        self.skewed = max(self.skewed, float(np.max(skewed, initial=0.0)))
        self.pieces += len(apart)
        return most

    def proof(self, tool: ToolPoint) -> TipProof:
        """Return the proof of all sections so far."""
        gain = float(np.sqrt(1.0 + abs(tool.kinematics.cosine_of_axes)))
        deviation = self.joined + self.mapped
        return TipProof(deviation, gain * (self.turned + self.skewed), self.mapped, self.pieces)


def tip_bounds(tip: Pieces, joints: Pieces, tool: ToolPoint) -> tuple[np.ndarray, np.ndarray]:
    """Return bounds on |tip(r) - p|, m, and on the distance of all other coordinates, over each piece, shape (n,)."""
    linear, rotary = list(tool.linear), list(tool.rotary)
    n, axes = tip.origin.shape
    apart, skewed = np.zeros(n), np.zeros(n)
    size = 1.0 + np.abs(joints.origin).max(axis=1, initial=0.0) + np.abs(joints.shape).sum(axis=(1, 2))
    for share in (0.0, 1.0):
        values = [(piece.origin + ways(piece, share)) if share else piece.origin for piece in (joints, tip)]
        terms = [series(piece, share) for piece in (joints, tip)]
        r = [Taylor(values[0][:, k], *(term[:, k] for term in terms[0])) for k in range(axes)]
        reached = tool.kinematics.tip([r[k] for k in linear], [r[k] for k in rotary])
        for term in range(4):
            here = np.stack([np.broadcast_to(np.asarray(axis.terms[term]), n) for axis in reached], axis=1)
            there = values[1] if term == 0 else terms[1][term - 1]
            apart += np.linalg.norm(here - there[:, linear], axis=1)
    others = [k for k in range(axes) if k not in linear]
    straight = tip.shape[:, others].copy()
    arc = tip.kind == ARC
    straight[arc] = 0.0
    straight[arc, :, 1] = tip.shape[arc][:, others, 2] * tip.length[arc, None]
    gaps = np.abs(joints.shape[:, others] - straight).sum(axis=2) + np.abs(joints.origin - tip.origin)[:, others]
    skewed += np.linalg.norm(gaps, axis=1)
    # magnitudes of all Taylor coefficients at any point of a piece
    bounds = [np.abs(joints.origin) + np.abs(joints.shape).sum(axis=2)]
    bounds += [sum(comb(j, k) * np.abs(joints.shape[:, :, j]) for j in range(k, 8)) for k in range(1, 8)]
    bounds.append(np.zeros_like(bounds[0]))
    m = [Taylor(*(Magnitude(bound[:, k]) for bound in bounds)) for k in range(axes)]
    most = tool.kinematics.tip([m[k] for k in linear], [m[k] for k in rotary])
    rest = np.zeros((n, len(linear)))
    for column, axis in enumerate(most):
        rest[:, column] = axis.terms[_ORDER].size
    if arc.any():
        amplitude = np.linalg.norm(tip.shape[arc][:, linear, :2], axis=2)
        turn = tip.shape[arc][:, linear, 3] * tip.length[arc, None]
        rest[arc] += amplitude * turn**_ORDER / factorial(_ORDER)
    return apart + np.linalg.norm(rest, axis=1) / 256.0 + _ROUNDED * size, skewed
