"""Paths of the tool's tip mapped to the joints of a machine: polynomials that follow the inverse kinematics.

A path of the tip has in each piece polynomials, or an arc, for the tip p in the frame of the workpiece, the angles α of
the rotary axes, and all other axes.  The joints of the linear axes are q = linear(p, α) (`path/kinematics.py`).  On
each piece q is replaced by the polynomial of seventh degree that equals it up to the third derivative at both ends:

    q, q', q'', q''' at the ends       from Taylor series of p and α, so that q is C3 where p and α are
    q(end) - q(start)                  from the displacements of p and α, without subtracting positions

A piece is halved until the distance is proven to be small enough (`path/tip_proof.py`).  Angles and other axes are
exact.

The feed F bounds the speed of the tip |p'| u'.  The joint pieces are paced: u' is at most F/max |p'|, where |p'|² is a
polynomial of twelfth degree, which the largest of its Bernstein coefficients bounds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import comb
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from feeddrive.language.series import Taylor
from feeddrive.path.geometry.hermite import BERNSTEIN_7, State, hermite
from feeddrive.path.geometry.segments import part_of
from feeddrive.path.motion import ARC, LINE, PACED, ArcAxis, Pieces, TipColumns, line_shapes

_TURN = 0.3  # rad, largest change of the angles on a piece
_HALVINGS, _TURNS = 12, 40  # largest number of halvings of a piece for its distance, and for its change of angles
ROUNDING = 1e-9  # m by which a joint may pass the end of its travel, as the axes of a program may
_ROUNDED = 1.0 + 1e-12  # relative, of |p'|
_DEGREE = 12  # of |p'|²


IsFar: TypeAlias = Callable[[Pieces, Pieces], np.ndarray]


class Mapped(NamedTuple):
    """The pieces of the tip's path (angles in rad), and the joint pieces, one for each of them."""

    tip: Pieces
    joints: Pieces


def mapped(pieces: Pieces, tool: TipColumns, counted: Sequence[int], is_far: IsFar) -> Mapped:
    """Map the pieces of a path of the tip to the joints.

    pieces   tip in the frame of the workpiece (m) in the columns of the linear axes, angles (rad), other axes
    counted  columns whose speed the feed bounds: those of the tip, or of the angles if it stands
    is_far   function that returns which joint pieces are too far from the inverse kinematics, for their tip pieces
    """
    tip, begin, of = pieces, np.zeros(len(pieces.length)), np.arange(len(pieces.length))
    for _ in range(_TURNS):
        turned = _turns(tip, tool) > _TURN
        if not turned.any():
            break
        tip, begin, of = _halved(tip, begin, of, turned)
    done = list[tuple[Pieces, Pieces, np.ndarray, np.ndarray]]()
    for halved in range(_HALVINGS + 1):
        joints = _joints(tip, tool)
        # what is too far after the last halving is left to the proof
        far = is_far(tip, joints) & (halved < _HALVINGS)
        done.append((_rows(tip, ~far), _rows(joints, ~far), begin[~far], of[~far]))
        if not far.any():
            break
        tip, begin, of = _halved(_rows(tip, far), begin[far], of[far], np.ones(int(far.sum()), bool))
    tips, joint_pieces, begins, indices = zip(*done, strict=True)
    tip, joints = tips[0], joint_pieces[0]
    if len(done) > 1:
        order = np.lexsort((np.concatenate(begins), np.concatenate(indices)))
        tip, joints = (
            Pieces._make([np.concatenate(columns)[order] for columns in zip(*parts, strict=True)])
            for parts in (tips, joint_pieces)
        )
    with np.errstate(divide="ignore"):
        paced = tip.feed / fastest(tip, list(counted))
    return Mapped(tip, joints._replace(feed=np.where(joints.kind == LINE, tip.feed, paced)))


def _rows(pieces: Pieces, which: np.ndarray) -> Pieces:
    return Pieces._make([column[which] for column in pieces])


def _turns(pieces: Pieces, tool: TipColumns) -> np.ndarray:
    """Bound the change of the angles on each piece, rad."""
    shape = pieces.shape[:, list(tool.rotary)]
    along = _arcs(shape).slope * pieces.length[:, None]
    ways = np.where((pieces.kind == ARC)[:, None], along, np.abs(shape).sum(axis=2))
    return np.abs(ways).sum(axis=1)


def _halved(
    pieces: Pieces, begin: np.ndarray, of: np.ndarray, which: np.ndarray
) -> tuple[Pieces, np.ndarray, np.ndarray]:
    """Return the pieces with some of them halved, and for each where it begins, m, in which piece of the whole path."""
    order = np.repeat(np.arange(len(begin)), np.where(which, 2, 1))
    second = np.concatenate([[False], order[1:] == order[:-1]])
    size = np.where(which, 0.5, 1.0)[order]
    rows = _rows(pieces, order)
    values, shape = parts(rows, np.where(second, 0.5, 0.0), size)
    length = size * rows.length
    return (
        rows._replace(length=length, origin=values, shape=shape),
        begin[order] + np.where(second, length, 0.0),
        of[order],
    )


def parts(pieces: Pieces, start: np.ndarray, size: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return origin and shape of the part of each piece that begins at the share `start` and has the share `size`."""
    whole = size == 1.0
    first, *others = shifted(pieces.shape, start[:, None], size[:, None])
    shape = np.stack([np.zeros_like(first), *others], axis=2)
    arc = pieces.kind == ARC
    if arc.any():
        e1, e2, slope, kappa = _arcs(pieces.shape[arc])
        x = (start[arc] * pieces.length[arc])[:, None]
        s, v = np.sin(kappa * x), 2.0 * np.sin(0.5 * kappa * x) ** 2
        c = 1.0 - v
        first[arc] = e2 * s - e1 * v + slope * x
        turned = np.stack([e1 * c + e2 * s, e2 * c - e1 * s, slope, kappa], axis=2)
        shape[arc] = np.pad(turned, ((0, 0), (0, 0), (0, 4)))
    shape[whole] = pieces.shape[whole]
    first[whole] = 0.0
    return pieces.origin + first, shape


def _arcs(shape: np.ndarray) -> ArcAxis:
    """Return the shapes of arcs, (n, N, 8), by their names, each of shape (n, N)."""
    columns: Any = np.moveaxis(shape, -1, 0)[:4]
    return ArcAxis(*columns)


def shifted(shape: np.ndarray, begin: np.ndarray | float, size: np.ndarray | float) -> list[np.ndarray]:
    """Return the coefficients of part of each polynomial, with the constant term; `part_of` on arrays (n, N)."""
    out: list[Any] = [None] * 8
    shift: Any = part_of.python  # plain arithmetic, which also accepts arrays
    shift([np.ascontiguousarray(shape[:, :, k]) for k in range(8)], begin, size, out)
    return out


def ways(pieces: Pieces, share: float) -> np.ndarray:
    """Return the displacement of each axis from the start of each piece to a share of its length, shape (n, N)."""
    out = np.zeros(pieces.origin.shape)
    for k in range(7, 0, -1):
        out = (out + pieces.shape[:, :, k]) * share
    arc = pieces.kind == ARC
    if arc.any():
        e1, e2, slope, kappa = _arcs(pieces.shape[arc])
        x = (share * pieces.length[arc])[:, None]
        out[arc] = e2 * np.sin(kappa * x) - e1 * 2.0 * np.sin(0.5 * kappa * x) ** 2 + slope * x
    return out


def series(pieces: Pieces, share: float, order: int = 3) -> list[np.ndarray]:
    """Return the Taylor coefficients of each axis in ξ = x/length from first to last order, at the start (0) or the end
    (1) of each piece, each of shape (n, N).
    """
    shape = pieces.shape
    if share == 0.0:
        terms = [shape[:, :, k].copy() for k in range(1, order + 1)]
    else:
        terms = [shape[:, :, k:] @ [float(comb(j, k)) for j in range(k, 8)] for k in range(1, order + 1)]
    arc = pieces.kind == ARC
    if arc.any():
        e1, e2, slope, kappa = _arcs(shape[arc])
        length = pieces.length[arc][:, None]
        turn = kappa * length
        s, c = np.sin(turn * share), np.cos(turn * share)
        cosine, sine = e2 * c - e1 * s, e1 * c + e2 * s
        scale = np.ones_like(turn)
        for k in range(1, order + 1):
            scale = scale * turn / k
            value = (cosine, -sine, -cosine, sine)[(k - 1) % 4]
            terms[k - 1][arc] = scale * value + (slope * length if k == 1 else 0.0)
    return terms


def _joints(tip: Pieces, tool: TipColumns) -> Pieces:
    """Return the joint pieces."""
    linear, rotary = list(tool.linear), list(tool.rotary)
    n, axes = tip.origin.shape
    whole = ways(tip, 1.0)
    # both ends at once: half as many operations on twice the numbers
    values = np.concatenate([tip.origin, tip.origin + whole])
    terms = [np.concatenate(both) for both in zip(series(tip, 0.0), series(tip, 1.0), strict=True)]
    at = [Taylor(values[:, k], *(term[:, k] for term in terms)) for k in range(axes)]
    q = [axis.terms for axis in tool.kinematics.linear([at[k] for k in linear], [at[k] for k in rotary])]
    moved = tool.kinematics.linear_change(
        *([table[:, k] for k in columns] for columns in (linear, rotary) for table in (tip.origin, whole))
    )
    left, right = list[Any](), list[Any]()
    for (_, first, second, third), way in zip(q, moved, strict=True):
        left.append(State(0.0, first[:n], 2.0 * second[:n], 6.0 * third[:n]))
        right.append(State(way, first[n:], 2.0 * second[n:], 6.0 * third[n:]))
    out: list[Any] = [None] * len(q)
    connect: Any = hermite.python  # plain arithmetic, which also accepts arrays
    connect(left, right, 1.0, out)
    shape, origin = tip.shape.copy(), tip.origin.copy()
    arc = tip.kind == ARC
    if arc.any():
        shape[arc] = line_shapes(_arcs(tip.shape[arc]).slope * tip.length[arc, None])
    for column, row, coefficients in zip(linear, q, out, strict=True):
        origin[:, column] = row[0][:n]
        for k in range(8):
            shape[:, column, k] = coefficients[k]
    # a line on which nothing but the tip moves is a line of the joints
    others = np.delete(np.arange(axes), linear)
    still = (tip.kind == LINE) & ~np.any(tip.shape[:, others], axis=(1, 2))
    shape[still, :, 2:] = 0.0
    return Pieces(np.where(still, LINE, PACED), tip.length, origin, shape, tip.feed, tip.line)


# Bernstein coefficients of a polynomial of degree 12 from its power coefficients
_BERNSTEIN = np.array(
    [[comb(k, j) / comb(_DEGREE, j) if j <= k else 0.0 for j in range(_DEGREE + 1)] for k in range(_DEGREE + 1)]
)


def _square(shape: np.ndarray) -> np.ndarray:
    """Return the Bernstein coefficients of |dr/dξ|², shape (n, 13), of polynomials with the coefficients (n, N, 8)."""
    slope = shape[:, :, 1:] * np.arange(1.0, 8.0)
    square = np.zeros((len(shape), _DEGREE + 1))
    for i in range(7):
        for j in range(i, 7):
            square[:, i + j] += (1.0 if i == j else 2.0) * np.einsum("na,na->n", slope[:, :, i], slope[:, :, j])
    return square @ _BERNSTEIN.T


def fastest(tip: Pieces, counted: Sequence[int]) -> np.ndarray:
    """Return a bound of |p'| on each piece, with p of the counted columns."""
    most = np.max(_square(tip.shape[:, list(counted)]), axis=1)
    arc = tip.kind == ARC
    if arc.any():
        e1, e2, slope, kappa = _arcs(tip.shape[arc][:, list(counted)])
        e1, e2 = kappa * e1, kappa * e2
        one, two, skew = (np.einsum("na,na->n", a, b) for a, b in ((e1, e1), (e2, e2), (e1, e2)))
        # the larger eigenvalue of the Gram matrix bounds |e2 cos θ - e1 sin θ|² at any θ
        ring = 0.5 * (one + two + np.hypot(one - two, 2.0 * skew))
        along = np.hypot(*(np.einsum("na,na->n", e, slope) for e in (e1, e2)))
        most[arc] = (ring + 2.0 * along + np.einsum("na,na->n", slope, slope)) * tip.length[arc] ** 2
    return np.sqrt(most) / tip.length * _ROUNDED


class Beyond(NamedTuple):
    """A linear joint beyond its travel: the piece, the column of the joint, and its position, m."""

    piece: int
    column: int
    position: float


_HULLS = 8  # parts of a piece whose Bernstein points bound its joints: within 0.1 % of the bend of the piece


def beyond(joints: Pieces, travel: Sequence[tuple[float, float] | None], columns: Sequence[int]) -> Beyond | None:
    """Return the first joint that may leave its travel (m) between the ends of a piece, or None."""
    limited = [column for column in columns if travel[column] is not None]
    if not limited:
        return None
    reach = np.abs(joints.shape).sum(axis=2)
    low, high = joints.origin - reach, joints.origin + reach
    ends = np.array([travel[column] for column in limited]) + np.array([-ROUNDING, ROUNDING])
    near = np.any((low[:, limited] < ends.min(axis=1)) | (high[:, limited] > ends.max(axis=1)), axis=1)
    for piece in np.flatnonzero(near).tolist():
        one = _rows(joints, np.full(_HULLS, piece))
        values, shape = parts(one, np.arange(_HULLS) / _HULLS, np.full(_HULLS, 1.0 / _HULLS))
        points = values[:, :, None] + shape @ BERNSTEIN_7.T
        for column, (least, most) in zip(limited, ends, strict=True):
            for position in (float(points[:, column].min()), float(points[:, column].max())):
                if not least <= position <= most:
                    return Beyond(piece, column, position)
    return None
