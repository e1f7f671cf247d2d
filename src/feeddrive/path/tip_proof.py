"""The proof that the tip of the tool follows its path: bounds between two points of every piece, without samples.

The joints r(ξ) of a piece are polynomials of seventh degree, and the tip is tip(r).  With p the path of the tip that
was joined from the program, e = tip(r) - p has the Taylor coefficients e₀ .. e₃ at both ends, which are computed, and

    |e(ξ)| <= Σ |e_k| of both ends + M/256,     M >= |e⁽⁸⁾|/8!

since the rest of a two-point Hermite polynomial is e⁽⁸⁾/8! ξ⁴ (1 - ξ)⁴, and its basis functions are at most 1.  M is
the eighth Taylor coefficient of tip(r), bounded for the whole piece by the magnitudes of all numbers that enter into
it, plus that of p, which is 0 if p is a polynomial.

The direction of the tool is that of the angles, and these are the ones of the joined path.  The angle between two
directions is at most the distance of the rotary angles times the largest singular value of both axes of rotation,
√(1 + |n1 · n2|).  The distance of the joined path from the program is bounded where it is joined
(`geometry/joints.py`), and that of straight moves of the joints from an arc of directions where it is divided
(`turning.py`).

The feed of a paced piece bounds u'; the largest |p'| on it times this bound must not exceed the feed of the program.

The tip proof uses the evaluation of paths, the kinematics of the machine forward, and no other code of the planner.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import comb, factorial
from typing import NamedTuple

import numpy as np

from feeddrive.language.errors import ProgramError
from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.source import Floats, Floats2, Floats3, Ints
from feeddrive.language.quantity import Quantity
from feeddrive.language.series import Majorant, Taylor
from feeddrive.language.text import Text
from feeddrive.path.geometry.segments import Chain
from feeddrive.path.geometry.tip import beyond, mapped, series, shifted, ways
from feeddrive.path.kinematics import Kinematics
from feeddrive.path.motion import ARC, LINE, Pieces, Section, TipColumns, counted
from feeddrive.path.program.blocks import Line
from feeddrive.path.program.moves import ToolPoint
from feeddrive.path.proof import WIDENED, slopes

# far below what a drive resolves, and above the rounding of positions of some m
LEFT = 2e-9
"""The part of a tolerance that is left for the polynomials of the joints, m."""
NEAR = 1e-9
"""The bound above which a piece is halved, m."""
_ORDER = 8
_ROUNDED = 1e-14  # relative to the largest coordinate: of e₀ .. e₃, which some hundred roundings make


class TipProof(NamedTuple):
    """What is proven of the tip and of the direction of the tool.

    deviation  largest distance of the tip from the programmed path, m
    angle      largest angle between the direction of the tool and the programmed one, rad
    mapped     the part of the deviation that is due to the polynomials of the joints, m
    pieces     number of pieces
    faults     number of pieces whose deviation or feed is not proven to be within the bounds of the program
    """

    deviation: float
    angle: float
    mapped: float
    pieces: int
    faults: int


class TipProver:
    """The mapper and prover of consecutive sections of paths of the tip.

    travel  travel of each axis of the machine, m or rad; absent: none has ends
    source  the line that began the tool point, for messages
    kinematics  of the machine with the first tool
    """

    kinematics: Kinematics | None

    def __init__(self, travel: Sequence[tuple[float, float] | None] | None = None) -> None:
        self._travel = travel
        self.source, self.kinematics = Line("", 0, ""), None
        self._joined = self._turned = self._mapped = self._angle = 0.0
        self._pieces = self._count = 0

    def begin(self, move: ToolPoint) -> None:
        """Take the begin or end of a tool point."""
        self.source = move.source
        self.kinematics = self.kinematics or move.kinematics

    @property
    def proven(self) -> bool:
        """True if all pieces so far are proven."""
        return self._count == 0

    def join(self, deviation: np.ndarray, off: np.ndarray, chain: Chain) -> None:
        """Take bounds next to joints: on the distance of the joined path from the program, in the weighted coordinates
        of a chain, and on the angle between its directions and those of the program, rad.
        """
        assert chain.tip is not None
        self._joined = max(self._joined, float(np.max(deviation, initial=0.0)))
        if chain.weights is not None:
            turned = deviation / float(np.min(chain.weights[list(chain.tip.rotary)]))
            angles = np.sqrt(1.0 + abs(chain.tip.kinematics.cosine_of_axes)) * turned + off
            self._angle = max(self._angle, float(np.max(angles, initial=0.0)))

    def pass_corner(self, tolerance: float) -> None:
        """Take the tolerance of a corner at which runs of the joints may overlap, m, which their proof keeps."""
        self._joined = max(self._joined, tolerance)

    def joints(self, section: Section, chain: Chain, tip: TipColumns) -> Section:
        """Map a section of a chain to the joints and prove it; raise ProgramError where a joint leaves its travel."""
        pieces = section.pieces if chain.weights is None else counted(section.pieces, 1.0 / chain.weights)
        columns = tip.rotary if chain.turns else tip.linear
        path, joints = mapped(pieces, tip, columns, lambda path, joints: ~(tip_bounds(path, joints, tip) <= NEAR))
        out = None if self._travel is None else beyond(joints, self._travel, tip.linear)
        if out is not None:
            least, most = self._travel[out.column]  # type: ignore[index]
            place, least, most = (Quantity(x, "m", form="6 mm", stays=True) for x in (out.position, least, most))
            reason = Text(
                f"joint {'XYZ'[tip.linear.index(out.column)]} would go to {place} while the tip of the tool is moved, "
                f"its travel is {least} to {most}: move the work offset, tilt the tool less, or use a shorter tool"
            )
            raise ProgramError(self.source.file, int(joints.line[out.piece]), 1, "", reason)
        self.prove(path, joints, tip, columns)
        return Section(joints, section.ends, 0.0)

    def prove(self, path: Pieces, joints: Pieces, tip: TipColumns, columns: Sequence[int]) -> None:
        """Prove that the tip follows its path along joint pieces, and that the feed bounds the speed of `columns`."""
        apart = tip_bounds(path, joints, tip)
        # a bound that is no number is none
        self._count += int(np.count_nonzero(~(apart <= LEFT)))
        self._mapped = max(self._mapped, float(np.max(apart, initial=0.0)))
        shape = np.ascontiguousarray(path.shape[:, list(columns)])
        halves, r = np.zeros((64, 2)), np.zeros((len(columns), 4, 2))
        lines = joints.kind == LINE
        self._count += int(np.count_nonzero(joints.feed[lines] > path.feed[lines]))
        paced = np.where(lines, 0.0, joints.feed)
        self._count += too_fast(path.kind, path.length, shape, paced, path.feed, WIDENED, halves, r)
        self._pieces += len(apart)

    def proof(self) -> TipProof | None:
        """Return the proof of all sections so far; None if the tip was never moved."""
        if not self._pieces:
            return None
        return TipProof(self._joined + self._mapped, float(self._angle), self._mapped, self._pieces, self._count)


@kernel
def too_fast(
    kind: Ints, length: Floats, shape: Floats3, rate: Floats, feed: Floats, widened: float, halves: Floats2, r: Floats3
) -> int:
    """Return the number of pieces on which |p'| times the largest u' is not proven to be within the feed."""
    wrong = 0
    for p in range(len(length)):
        if not (feed[p] < 1e300):
            continue
        count = 1
        halves[0] = 0.0, length[p]
        while count > 0:
            count = count - 1
            b = halves[count, 0]
            e = halves[count, 1]
            if slopes(kind[p], length[p], shape[p], b, e, r) * rate[p] <= feed[p] * (1.0 + widened):
                continue
            middle = 0.5 * (b + e)
            here = slopes(kind[p], length[p], shape[p], middle, middle, r) * rate[p]
            if not (here <= feed[p] * (1.0 + widened)) or e - b <= 1e-12 * length[p] or count + 2 > len(halves):
                wrong = wrong + 1
                break
            halves[count] = middle, e
            halves[count + 1] = b, middle
            count = count + 2
    return wrong


def tip_bounds(path: Pieces, joints: Pieces, tip: TipColumns) -> np.ndarray:
    """Return bounds on |tip(r) - p|, m, plus the distance of all other coordinates, over each piece, shape (n,)."""
    linear, rotary = list(tip.linear), list(tip.rotary)
    n, axes = path.origin.shape
    # both ends at once: half as many operations on twice the numbers
    values, terms = list[np.ndarray](), list[list[np.ndarray]]()
    for pieces in (joints, path):
        values.append(np.concatenate([pieces.origin, pieces.origin + ways(pieces, 1.0)]))
        ends = zip(series(pieces, 0.0), series(pieces, 1.0), strict=True)
        terms.append([np.concatenate(both) for both in ends])
    r = [Taylor(values[0][:, k], *(term[:, k] for term in terms[0])) for k in range(axes)]
    reached = tip.kinematics.tip([r[k] for k in linear], [r[k] for k in rotary])
    apart = np.zeros(2 * n)
    for term in range(4):
        here = np.stack([np.broadcast_to(np.asarray(axis.terms[term]), 2 * n) for axis in reached], axis=1)
        there = values[1] if term == 0 else terms[1][term - 1]
        apart += np.linalg.norm(here - there[:, linear], axis=1)
    apart = apart[:n] + apart[n:]
    others = [k for k in range(axes) if k not in linear]
    straight = path.shape[:, others].copy()
    arc = path.kind == ARC
    straight[arc] = 0.0
    straight[arc, :, 1] = path.shape[arc][:, others, 2] * path.length[arc, None]
    gaps = np.abs(joints.shape[:, others] - straight).sum(axis=2) + np.abs(joints.origin - path.origin)[:, others]
    apart += np.linalg.norm(gaps, axis=1)
    # magnitudes of all Taylor coefficients at any point of a piece, from those at its middle
    middle = shifted(joints.shape, 0.5, 1.0)
    size = [np.abs(c) for c in (joints.origin + middle[0], *middle[1:])]
    bounds = np.zeros((_ORDER + 1, *joints.origin.shape))
    for k in range(_ORDER):
        bounds[k] = np.sum([comb(j, k) * 0.5 ** (j - k) * size[j] for j in range(k, _ORDER)], axis=0)
    m = [Majorant(bounds[:, :, k]) for k in range(axes)]
    most = tip.kinematics.tip([m[k] for k in linear], [m[k] for k in rotary])
    rest = np.stack([axis.terms[_ORDER] for axis in most], axis=1)
    if arc.any():
        amplitude = np.linalg.norm(path.shape[arc][:, linear, :2], axis=2)
        turn = path.shape[arc][:, linear, 3] * path.length[arc, None]
        rest[arc] += amplitude * turn**_ORDER / factorial(_ORDER)
    largest = 1.0 + bounds[0].max(axis=1, initial=0.0)
    return apart + np.linalg.norm(rest, axis=1) / 256.0 + _ROUNDED * largest
