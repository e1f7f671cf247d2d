"""How a tool turns between two directions while its tip moves: rotary joints along an arc of directions.

By axes both rotary joints move straight, and the direction leaves the plane of both ends.  In the plane it is

    g(s) = cos ψ a + sin ψ n        a the first direction, n the one across it in the plane, ψ from 0 to φ

with ψ = φ s (plane), or tan ψ = s sin φ / (1 - s + s cos φ), by which the components move straight (vector).  The
joints take the positions of g at some shares of the block and move straight between them.  Over a part of the block,
with the tool axis t of the joints, the distance e = t - g is at most

    Σ |e_k| 2⁻ᵏ + M 2⁻⁶,  k = 0 .. 5        e_k the Taylor coefficients of e in the middle of the part
    M = (ρ |α|⁶ + (|α| + |β|)⁶ - |α|⁶ + |ψ|⁶) / 6!

where α, β are the changes of the joint next to the workpiece and of the other one, ψ that of the angle of g, and ρ
the largest sine of the angle between the tool and the axis of the first joint, the pole, about which α turns the tool.
The rate of ψ by vector differs from a constant one by less than max |ψ''|/8.  Parts are halved until this is near.

Without a tolerance the joints are polynomials of seventh degree that equal those of g up to the third derivative where
they meet, so that the tool follows g within EXACT.  The derivatives follow from t(θ) = g, order by order:

    J θ_k = g_k - (t of θ_0 .. θ_k-1)_k,  J = [n₁ x t, n₂ x t]       Taylor coefficients, k = 1 .. 3
    |e| <= Σ |e_k| of both ends + M/256,  M >= |e⁽⁸⁾|/8!              as the proof of the tip (`tip_proof.py`)

with M from magnitudes of the coefficients of t and of g: |ψ|⁸/8! in the plane; by vector, whose g has its nearest
singularities d = 1/(2 tan φ/2) beside the block, at most 3/cos φ/2 (2 h/d)⁸ by Cauchy's bound, h the share of a part.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from feeddrive.language.quantity import Quantity
from feeddrive.language.series import Majorant, Taylor
from feeddrive.language.text import Text
from feeddrive.path.geometry.hermite import BERNSTEIN_7, State, hermite
from feeddrive.path.kinematics import POLE, Kinematics, RotaryJoint, UnreachableError
from feeddrive.path.orientation import angle_between, interpolate_plane, interpolate_vector
from feeddrive.path.program.moves import Orientation

TURN = 2.0 * math.pi
_ORDER = 6  # of the rest
_LITTLE = 0.2  # rad, change of the joints up to which a block is one part if second derivatives show it
_LONGEST = 0.5  # rad, largest change of the joints on the first parts
_HALVINGS, _MOST = 40, 4096  # largest numbers of halvings, and of parts of a block: what is not near then jumps
EXACT = 1e-9
"""The angle from the arc that is none, rad: a tool of 0.1 m moves by 0.1 nm at its tip."""
_ROUNDED = 1e-14  # of e₀ .. e₃, which some hundred roundings make
_INSIDE = 1e-9  # rad beyond the end of a travel that still counts as its end
_OUTSIDE = 1e3  # rad: more than the way between any two branches, which is at most half a turn of each joint


class Parts(NamedTuple):
    """A block whose rotary joints move straight over each of n parts.

    share   where the parts begin and end, from 0 to 1, shape (n + 1,)
    rotary  joint positions between the parts, rad, shape (2, n - 1)
    off     largest angle between the tool axis and the programmed one, rad
    angle   angle by which the tool turns, rad, or more
    """

    share: np.ndarray
    rotary: np.ndarray
    off: float
    angle: float


class Curves(NamedTuple):
    """A block whose rotary joints follow the arc along n polynomials of seventh degree.

    share   where they begin and end, from 0 to 1, shape (n + 1,)
    origin  joint positions at the start of each, rad, shape (n, 2)
    shape   coefficients in ξ = 0 .. 1 along each, rad, shape (n, 2, 8)
    off     largest angle between the tool axis and the programmed one, rad
    """

    share: np.ndarray
    origin: np.ndarray
    shape: np.ndarray
    off: float


STRAIGHT = Parts(np.array([0.0, 1.0]), np.zeros((2, 0)), 0.0, 0.0)
"""A block whose joints move straight."""


def in_plane(
    kinematics: Kinematics, begin: Sequence[float], end: Sequence[float], how: Orientation, near: float
) -> Parts:
    """Return the parts of a block in which the tool turns in the plane of both directions, within an angle `near`.

    begin, end  rotary joints, rad, in the order of the letters
    how         plane or vector

    Raises UnreachableError for opposite directions, and where the joints cannot follow: if the branch changes, or the
    travel ends, on the way.
    """
    a, b = np.array(begin, float), np.array(end, float)
    reach = float(np.abs(b - a).sum())
    # most blocks turn by little, and need no more
    off = 0.25 * reach * reach + (_uneven(reach) if how == "vector" and reach < _LITTLE else 0.0)
    if off <= near and reach < _LITTLE:
        return Parts(STRAIGHT.share, STRAIGHT.rotary, off, reach)
    count = 1
    if reach < _LITTLE:
        off, angle = _of_little(kinematics, a, b, how)
        if off <= near:
            return Parts(STRAIGHT.share, STRAIGHT.rotary, off, angle)
        count = math.ceil(math.sqrt(off / near)) if off < near * _MOST else 1
    arc = Swing.between(kinematics, a, b, how, 0.5 * near)
    count = max(count, math.ceil(max(reach, arc.angle) / _LONGEST))
    share = np.linspace(0.0, 1.0, count + 1)
    halvings = 0
    while True:
        rotary = arc.joints(a, b, share)
        distances = arc.distances(rotary, share)
        far = np.flatnonzero(~(distances <= near))
        if not far.size:
            _within(kinematics, rotary, share)
            return Parts(share, rotary[:, 1:-1], float(np.max(distances)), arc.angle)
        if halvings == _HALVINGS or share.size > _MOST:
            k = int(far[np.argmax(distances[far])])
            raise _jumps(kinematics, rotary[:, k], rotary[:, k + 1], float(share[k]))
        halvings += 1
        share = np.sort(np.concatenate([share, 0.5 * (share[far] + share[far + 1])]))


def along_arc(kinematics: Kinematics, begin: Sequence[float], end: Sequence[float], how: Orientation) -> Curves:
    """Return the polynomials of a block in which the tool follows the arc of both directions within `EXACT`.

    begin, end  rotary joints, rad, in the order of the letters
    how         plane or vector

    Raises UnreachableError as `in_plane` does, and at a pole that is passed while the joint about it should turn.
    """
    a, b = np.array(begin, float), np.array(end, float)
    arc = Swing.between(kinematics, a, b, how, POLE)
    both = np.array([0.0, 1.0])
    off = float(arc.distances(np.stack([a, b], axis=1), both)[0])
    if off <= EXACT:
        shape = np.zeros((1, 2, 8))
        shape[0, :, 1] = b - a
        return Curves(both, a[None], shape, off)
    share = np.linspace(0.0, 1.0, math.ceil(max(float(np.abs(b - a).sum()), arc.angle) / _LONGEST) + 1)
    halvings = 0
    while True:
        rotary = arc.joints(a, b, share)
        shape = arc.curves(rotary, share)
        distances = arc.curve_distances(rotary, shape, share)
        far = np.flatnonzero(~(distances <= EXACT))
        if not far.size:
            hulls = rotary[:, :-1, None] + (shape @ BERNSTEIN_7.T).swapaxes(0, 1)
            _within(kinematics, hulls.reshape(2, -1), np.repeat(share[:-1], 8))
            return Curves(share, rotary[:, :-1].T, shape, float(np.max(distances)))
        if halvings == _HALVINGS or share.size > _MOST:
            k = int(far[np.argmax(distances[far])])
            raise _jumps(kinematics, rotary[:, k], rotary[:, k + 1], float(share[k]))
        halvings += 1
        share = np.sort(np.concatenate([share, 0.5 * (share[far] + share[far + 1])]))


def _within(kinematics: Kinematics, rotary: np.ndarray, share: np.ndarray) -> None:
    """Raise UnreachableError for joint positions (rad, shape (2, n)) at shares of a block that leave a travel."""
    for joint, angles in zip(kinematics.joints, rotary, strict=True):
        beyond = np.maximum(angles - joint.most, joint.least - angles)
        k = int(np.argmax(beyond))
        if beyond[k] > _INSIDE:
            raise UnreachableError(
                Text(
                    f"joint {joint.letter} would go to {Quantity(float(angles[k]), 'rad'):deg} at "
                    f"{Quantity(100.0 * float(share[k])):2} % of this block, in which the tool turns in the plane of "
                    f"its directions at both ends, and its travel is {Quantity(joint.least, 'rad'):deg} to "
                    f"{Quantity(joint.most, 'rad'):deg}: turn the tool by axes, or give blocks between"
                ),
                0,
            )


@lru_cache(16)
def _terms(kinematics: Kinematics) -> np.ndarray:
    return kinematics.axis_terms()


def _of_little(kinematics: Kinematics, a: np.ndarray, b: np.ndarray, how: Orientation) -> tuple[float, float]:
    """Bound the angle of straight joints from the arc over a whole block that turns by little, by second derivatives.

    Returns it with φ, rad.  The second derivative of e is known in the middle, the third at most (|α| + |β|)³ + φ³.
    """
    terms, middle, way = _terms(kinematics), 0.5 * (a + b), b - a

    def waves(angle: float) -> tuple[list[float], list[float], list[float]]:
        c, s = math.cos(angle), math.sin(angle)
        return [1.0, c, s], [0.0, -s, c], [0.0, -c, -s]

    first, last = (np.outer(waves(x)[0], waves(y)[0]).ravel() @ terms for x, y in (a.tolist(), b.tolist()))
    (x, dx, ddx), (y, dy, ddy) = (waves(angle) for angle in middle.tolist())
    alpha, beta = way.tolist()
    bend = alpha * alpha * np.outer(ddx, y) + 2.0 * alpha * beta * np.outer(dx, dy) + beta * beta * np.outer(x, ddy)
    total = first + last
    size = math.sqrt(float(total @ total))
    angle = 2.0 * math.atan2(math.sqrt(float((last - first) @ (last - first))), size)
    rest = bend.ravel() @ terms + angle * angle / size * total
    most = math.sqrt(float(rest @ rest)) + 0.5 * ((abs(alpha) + abs(beta)) ** 3 + angle**3)
    return (most / 8.0 + (_uneven(angle) if how == "vector" else 0.0)) * (1.0 + angle * angle), angle


def _uneven(angle: float) -> float:
    """Bound the distance of ψ by vector from φ s over a whole block, rad.

    It is 0 at both ends and in the middle: at most max |s (s - 1/2) (s - 1)|/6 = 0.00802 times the third derivative,
    with ψ' = sin φ/Q, Q = 1 - 2 k s (1 - s) >= cos² φ/2, k = 1 - cos φ, which is at most sin φ (4 k/Q² + 8 k²/Q³).
    """
    k, q = 2.0 * math.sin(0.5 * angle) ** 2, math.cos(0.5 * angle) ** 2
    return 0.00802 * math.sin(angle) * (4.0 * k / q**2 + 8.0 * k * k / q**3)


def _rate(angle: float) -> float:
    """Bound |ψ''| by vector over an angle φ of the arc."""
    return 4.0 * math.sin(angle) * math.sin(0.5 * angle) / math.cos(0.5 * angle) ** 3


def _jumps(kinematics: Kinematics, before: np.ndarray, behind: np.ndarray, share: float) -> UnreachableError:
    joint = int(np.argmax(np.abs(behind - before)))
    turned = Quantity(float(abs(behind[joint] - before[joint])), "rad")
    return UnreachableError(
        Text(
            f"joint {kinematics.joints[joint].letter} would jump by {turned:deg} at {Quantity(100.0 * share):2} % of "
            "this block, in which the tool turns in the plane of its directions at both ends: the branch changes "
            "there, or a travel ends; turn the tool by axes, give other angles at the end, or lift the tool and write "
            "G0"
        ),
        0,
    )


class Swing(NamedTuple):
    """The programmed directions g of a block: `first` at its start, `last` at its end, `across` = n, `angle` = φ.

    cone  angle from the pole within which the joint next to the workpiece may stand anywhere, rad
    free  index of this joint
    """

    kinematics: Kinematics
    how: Orientation
    first: np.ndarray
    last: np.ndarray
    across: np.ndarray
    angle: float
    cone: float
    free: int

    @classmethod
    def between(
        cls, kinematics: Kinematics, begin: np.ndarray, end: np.ndarray, how: Orientation, cone: float
    ) -> Swing:
        """Return the directions of a block from its joints at both ends, rad."""
        first, last = (np.array(kinematics.tool_axis(rotary), float) for rotary in (begin, end))
        angle = float(angle_between(first, last))
        # n sin φ, without the cancellation of last - cos φ first
        across = last - first + 2.0 * math.sin(0.5 * angle) ** 2 * first
        size = float(np.linalg.norm(across))
        inner = (*reversed(kinematics.table), *kinematics.head)[0]
        free = kinematics.rotary_letters.index(inner.letter)
        return cls(kinematics, how, first, last, across / size if size else across, angle, cone, free)

    def joints(self, begin: np.ndarray, end: np.ndarray, share: np.ndarray) -> np.ndarray:
        """Return the rotary joints at shares of the block, shape (2, n).

        They follow the start, and from some place on they lead to the end: where they turn the tool least for it, as at
        the pole.
        """
        ahead, back = self._followed(begin, end, share), self._followed(end, begin, share[::-1])[:, ::-1]
        pole = self._pole()
        sine = [
            np.linalg.norm(np.cross(pole, np.array(self.kinematics.tool_axis(x)), axisb=0), axis=-1)
            for x in (ahead, back)
        ]

        def turned(first: np.ndarray, second: np.ndarray, sines: np.ndarray) -> np.ndarray:
            way = np.abs(second - first)
            return way[1 - self.free] + way[self.free] * sines

        before = turned(ahead[:, :-1], ahead[:, 1:], np.minimum(sine[0][:-1], sine[0][1:]))
        behind = turned(back[:, :-1], back[:, 1:], np.minimum(sine[1][:-1], sine[1][1:]))
        change = turned(ahead[:, :-1], back[:, 1:], np.minimum(sine[0][:-1], sine[1][1:]))
        # with a change in step k, which the steps of the start precede, and those of the end follow
        total = np.cumsum(before) - before + change + np.sum(behind) - np.cumsum(behind)
        k = int(np.argmin(total))
        return np.concatenate([ahead[:, : k + 1], back[:, k + 1 :]], axis=1)

    def _followed(self, before: np.ndarray, end: np.ndarray, share: np.ndarray) -> np.ndarray:
        """Return the rotary joints at shares of the block, each the nearest to the one before, shape (2, n)."""
        out = np.empty((2, share.size))
        out[:, 0], out[:, -1] = before, end
        if share.size == 2:
            return out
        interpolate = interpolate_plane if self.how == "plane" else interpolate_vector
        axis = interpolate(self.first[:, None], self.last[:, None], share[1:-1])
        at_pole = np.linalg.norm(np.cross(self._pole(), axis, axisb=0), axis=-1) <= self.cone
        angles = self.kinematics.rotary(axis).angles
        for k in range(share.size - 2):
            turned = angles[:, :, k]
            if at_pole[k]:
                turned[:, self.free] = before[self.free]
                turned[:, 1 - self.free] = self.kinematics.nearest_tilt(axis[:, [k]], before[[self.free]])
            turned = turned + TURN * np.floor((before - turned) / TURN + 0.5)
            inside = [_inside(self.kinematics.joints, angles) for angles in turned]
            # where no branch is inside, the nearest one leaves its travel, which is refused
            cost = np.max(np.abs(turned - before), axis=1) + np.where(inside, 0.0, _OUTSIDE)
            best = int(np.argmin(cost))
            before = out[:, k + 1] = turned[best]
        return out

    def distances(self, rotary: np.ndarray, share: np.ndarray) -> np.ndarray:
        """Bound the angle between tool axis and g on each part, rad; shapes (2, n + 1), (n + 1,) -> (n,)."""
        places = self._places(share)
        way, rate = np.diff(rotary, axis=1), np.diff(places)
        none = [np.zeros_like(rate)] * (_ORDER - 2)
        middle = 0.5 * (rotary[:, 1:] + rotary[:, :-1])
        axis = self.kinematics.tool_axis([Taylor(m, w, *none) for m, w in zip(middle, way, strict=True)])
        s, c = np.sin(0.5 * (places[1:] + places[:-1])), np.cos(0.5 * (places[1:] + places[:-1]))
        first, across = self.first[:, None], self.across[:, None]
        waves = [c * first + s * across, c * across - s * first]
        total, scale = np.zeros_like(rate), np.ones_like(rate)
        for k in range(_ORDER):
            scale = scale if k == 0 else scale * rate / k
            sign = 1.0 if k % 4 < 2 else -1.0
            here = np.stack([np.broadcast_to(_term(x, k), rate.shape) for x in axis])
            total += 0.5**k * np.linalg.norm(here - sign * scale * waves[k % 2], axis=0)
        here = np.stack([np.broadcast_to(_term(x, 0), rate.shape) for x in axis])
        alpha, beta = np.abs(way[self.free]), np.abs(way[1 - self.free])
        sine = np.minimum(1.0, np.linalg.norm(np.cross(self._pole(), here, axisb=0), axis=-1) + 0.5 * beta)
        rest = sine * alpha**_ORDER + (alpha + beta) ** _ORDER - alpha**_ORDER + np.abs(rate) ** _ORDER
        total += rest / (math.factorial(_ORDER) * 2.0**_ORDER)
        if self.how == "vector":
            total += _rate(self.angle) / 8.0 * np.diff(share) ** 2
        return 2.0 * np.arcsin(np.minimum(1.0, 0.5 * total))

    def curves(self, rotary: np.ndarray, share: np.ndarray) -> np.ndarray:
        """Return the polynomials of the joints over each part, (n, 2, 8), from their positions (2, n + 1) between."""
        rates = self._rates(rotary, share)
        h, way = np.diff(share), np.diff(rotary, axis=1)
        scales: list[Any] = [h, 2.0 * h**2, 6.0 * h**3]
        left, right = list[Any](), list[Any]()
        for joint in range(2):
            first, last = (
                [rate[joint, ends] * scale for rate, scale in zip(rates, scales, strict=True)]
                for ends in (slice(None, -1), slice(1, None))
            )
            left.append(State(0.0, *first))
            displacement: Any = way[joint]
            right.append(State(displacement, *last))
        out: list[Any] = [None, None]
        connect: Any = hermite.python  # plain arithmetic, which also accepts arrays
        connect(left, right, 1.0, out)
        shape = np.zeros((len(h), 2, 8))
        for joint, coefficients in enumerate(out):
            for k in range(1, 8):
                shape[:, joint, k] = coefficients[k]
        return shape

    def curve_distances(self, rotary: np.ndarray, shape: np.ndarray, share: np.ndarray) -> np.ndarray:
        """Bound the angle between tool axis and g over each part of `curves`, rad, shape (n,)."""
        h = np.diff(share)
        total, goal = np.full(h.shape, _ROUNDED), self._series(share)
        for here, terms in ((slice(None, -1), shape), (slice(1, None), shape @ _shifts(1.0))):
            axis = self.kinematics.tool_axis(
                [Taylor(rotary[j, here], *(terms[:, j, k] for k in (1, 2, 3))) for j in (0, 1)]
            )
            for k in range(4):
                there = goal[k][:, here] * h**k
                total += np.linalg.norm(np.stack([_term(x, k) for x in axis]) - there, axis=0)
        size = np.abs(shape @ _shifts(0.5))
        size[:, :, 0] += np.abs(rotary[:, :-1].T)
        # of all coefficients at any point of a part, from those in its middle
        bounds = np.concatenate([size @ np.abs(_shifts(0.5)), np.zeros((len(h), 2, 1))], axis=2)
        most = self.kinematics.tool_axis([Majorant(np.ascontiguousarray(bounds[:, j].T)) for j in (0, 1)])
        rest = np.linalg.norm([x.terms[8] if isinstance(x, Majorant) else np.zeros_like(h) for x in most], axis=0)
        total += (rest + self._eighth(h)) / 256.0
        return 2.0 * np.arcsin(np.minimum(1.0, 0.5 * total))

    def _rates(self, rotary: np.ndarray, share: np.ndarray) -> list[np.ndarray]:
        """Return the Taylor coefficients of first to third order of the joints in the share, each of shape (2, n)."""
        goal, zero = self._series(share), np.zeros_like(share)
        unit = [[Taylor(rotary[j], zero + float(i == j)) for j in (0, 1)] for i in (0, 1)]
        turns = [np.stack([zero + _term(x, 1) for x in self.kinematics.tool_axis(angles)]) for angles in unit]
        normal = np.cross(turns[0], turns[1], axis=0)
        # along the tool axis, by the sine of the angle between the tool and the pole
        axis = np.stack([zero + _term(x, 0) for x in self.kinematics.tool_axis(list(rotary))])
        sine = np.einsum("in,in->n", axis, normal)
        at_pole = np.abs(sine) < POLE
        found: list[np.ndarray] = []
        for k in (1, 2, 3):
            angles = [Taylor(rotary[j], *(terms[j] for terms in found), zero) for j in (0, 1)]
            left = goal[k] - np.stack([zero + _term(x, k) for x in self.kinematics.tool_axis(angles)])
            rates = np.empty_like(rotary)
            for j, first, second in ((0, left, turns[1]), (1, turns[0], left)):
                across = np.einsum("in,in->n", axis, np.cross(first, second, axis=0))
                rates[j] = across / np.where(at_pole, 1.0, sine)
            if at_pole.any():
                # there the free joint turns nothing
                tilt = turns[1 - self.free][:, at_pole]
                rates[self.free, at_pole] = 0.0
                along = np.einsum("in,in->n", tilt, left[:, at_pole])
                rates[1 - self.free, at_pole] = along / np.einsum("in,in->n", tilt, tilt)
            found.append(rates)
        return found

    def _series(self, share: np.ndarray) -> list[np.ndarray]:
        """Return the Taylor coefficients of g in the share up to the third order, each of shape (3, n)."""
        first, across = self.first[:, None], self.across[:, None]
        if self.how == "plane":
            s, c = np.sin(self.angle * share), np.cos(self.angle * share)
            waves = [c * first + s * across, c * across - s * first]
            return [(1.0 if k % 4 < 2 else -1.0) * self.angle**k / math.factorial(k) * waves[k % 2] for k in range(4)]
        # v/|v| of v = first + s (last - first): y = w^(-1/2) of w = |v|², by k w₀ y_k = Σ (i/2 - k) w_i y_k-i
        way = self.last[:, None] - first
        v = first + share * way
        w = [np.einsum("in,in->n", v, v), 2.0 * np.einsum("in,ik->n", v, way), float((way * way).sum()), 0.0]
        y = [1.0 / np.sqrt(w[0])]
        for k in range(1, 4):
            y.append(sum((0.5 * i - k) * w[i] * y[k - i] for i in range(1, k + 1)) / (k * w[0]))
        return [y[0] * v, *(y[k] * v + y[k - 1] * way for k in range(1, 4))]

    def _eighth(self, h: np.ndarray) -> np.ndarray:
        """Bound |g⁽⁸⁾|/8! in ξ over parts of the shares h."""
        if self.how == "plane":
            return (self.angle * h) ** 8 / math.factorial(8)
        half = 0.5 * self.angle
        return 3.0 / math.cos(half) * (4.0 * math.tan(half) * h) ** 8

    def _places(self, share: np.ndarray) -> np.ndarray:
        """Return ψ at shares of the block, rad."""
        if self.how == "plane":
            return self.angle * share
        return np.arctan2(share * math.sin(self.angle), 1.0 - share + share * math.cos(self.angle))

    def _pole(self) -> np.ndarray:
        return np.array(self.kinematics.joints[self.free].direction)


def _shifts(place: float) -> np.ndarray:
    """Return the matrix, (8, 8), that takes coefficients of ξ to those of ξ - place, of degree 0 to 7."""
    return np.array([[math.comb(j, k) * place ** (j - k) if j >= k else 0.0 for k in range(8)] for j in range(8)])


def _term(x: Any, k: int) -> Any:
    """Return a Taylor coefficient of a component of the tool axis, which may be a plain number."""
    return x.terms[k] if isinstance(x, Taylor) else x if k == 0 else 0.0


def _inside(joints: Sequence[RotaryJoint], angles: np.ndarray) -> bool:
    return all(
        joint.least - _INSIDE <= angle <= joint.most + _INSIDE
        for joint, angle in zip(joints, angles.tolist(), strict=True)
    )
