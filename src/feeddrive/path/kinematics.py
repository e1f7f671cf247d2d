"""Kinematics of machines with three linear and two rotary joints: joint positions and tool in the workpiece frame.

    workpiece - table joints - machine base - X Y Z - head joints - tool

A rotary joint j is a line through a point oⱼ with a direction uⱼ, both where they are when all joints stand at 0.
R(u, θ) v = cos θ v + sin θ (u x v) + (1 - cos θ) (u·v) u turns a vector right-handed.  With p the tip of the tool in
the workpiece frame and q the linear joints

    inverse   q = T(p + w) - h
    forward   p = T⁻¹(q + h) - w
    T  turns about the joints of the table:  v -> o + R(u, -θ) (v - o), from the workpiece on
    h  from the linear joints to the tip:    v -> o + R(u, θ) (v - o), from the tool on
    w  the origin of the workpiece, in machine coordinates

Signs are those of ISO 841: a positive angle turns the tool right-handed *relative to the workpiece*, so that a table
turns the other way.  `reversed` is for a joint that counts the other way, as LinuxCNC's tables do.
At rotary zero the tool points along +Z from its tip to the spindle, and q is the position of the spindle's gauge point
in machine coordinates: the tip lies at q - (0, 0, tool length).

`linear`, `tip` and `tool_axis` are plain arithmetic over + - *, sine and cosine.  They take floats, arrays (one entry
per block), symbols of a trace, and the numbers of `language/series.py`: Taylor series, changes, intervals.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple, TypeAlias, get_args

import numpy as np

from feeddrive.language import matrix, ops
from feeddrive.language.errors import ParameterError
from feeddrive.language.matrix import Matrix, Row
from feeddrive.language.quantity import Quantity
from feeddrive.language.series import Change
from feeddrive.language.text import Text

Vector: TypeAlias = tuple[float, float, float]
Numbers: TypeAlias = Sequence[Any] | np.ndarray
"""Numbers of any kind that the arithmetic takes: floats, arrays, symbols, series."""

Kind: TypeAlias = Literal["table_table", "head_head", "head_table"]
"""Where the rotary joints of a machine are."""

LINEAR = "XYZ"
"""The letters of the linear joints."""
DIRECTIONS: dict[str, Vector] = {"A": (1.0, 0.0, 0.0), "B": (0.0, 1.0, 0.0), "C": (0.0, 0.0, 1.0)}
"""The direction of each rotary joint by its letter (ISO 841): about X, Y and Z."""
NUTATING: dict[str, Vector] = {"A": (math.sqrt(0.5), 0.0, math.sqrt(0.5)), "B": (0.0, math.sqrt(0.5), math.sqrt(0.5))}
"""The direction of a nutating joint: 45 degrees between Z and the axis of its letter."""
POLE = 1e-9
"""Tilt from the pole, rad, below which the angle about the pole is free: a tool of 0.1 m moves by 0.1 nm at its tip."""
_ROUNDING = 1e-12  # rad: a tilt beyond the reach of a joint by no more is one of rounding
_UNIT = 1e-6  # a tool axis whose length differs more from 1 is an error of the program, not of its digits


class UnreachableError(ParameterError):
    """A tool axis that no position of the rotary joints gives; `block` is its index in the row of tool axes."""

    def __init__(self, message: str, block: int) -> None:
        super().__init__(message)
        self.block = block


@dataclass(frozen=True)
class RotaryJoint:
    """A rotary joint.

    letter     A, B or C
    direction  unit vector of its axis, when all joints stand at 0
    point      a point on its axis, m: of a table in machine coordinates, of a head from the spindle's gauge point
    reversed   True if it counts against ISO 841
    least, most  its travel, rad
    """

    letter: str
    direction: Vector
    point: Vector = (0.0, 0.0, 0.0)
    reversed: bool = False
    least: float = -math.inf
    most: float = math.inf

    def __post_init__(self) -> None:
        if self.letter not in DIRECTIONS:
            raise ParameterError(f"a rotary joint has the letter A, B or C, not '{self.letter}'")
        length = math.sqrt(sum(x * x for x in self.direction))
        if not abs(length - 1.0) < 1e-12:
            raise ParameterError(f"the direction of joint {self.letter} has the length {length}: give a unit vector")
        if not self.least < self.most:
            raise ParameterError(
                Text(
                    f"the travel of joint {self.letter} goes from {Quantity(self.least, 'rad'):deg} to "
                    f"{Quantity(self.most, 'rad'):deg}: its lower end must lie below the upper one"
                )
            )

    @property
    def sign(self) -> float:
        """Direction in which the tool turns relative to the workpiece: 1 right-handed, -1 reversed."""
        return -1.0 if self.reversed else 1.0


@dataclass(frozen=True)
class Kinematics:
    """A machine with the linear joints X, Y, Z and two rotary joints; see the module for equations and signs.

    table      rotary joints that turn the workpiece, from the machine base to the workpiece
    head       rotary joints that turn the tool, from the slide to the tool
    workpiece  origin of the workpiece frame in machine coordinates, rotary joints at 0, m
    tool       from the spindle's gauge point to the tip, rotary joints at 0, m
    """

    table: tuple[RotaryJoint, ...]
    head: tuple[RotaryJoint, ...]
    workpiece: Vector = (0.0, 0.0, 0.0)
    tool: Vector = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        letters = [joint.letter for joint in (*self.table, *self.head)]
        if len(letters) != 2 or len(set(letters)) != 2:
            raise ParameterError(f"kinematics of five axes have two different rotary joints, not '{''.join(letters)}'")

    @staticmethod
    def of(
        kind: Kind,
        letters: str,
        first: Vector = (0.0, 0.0, 0.0),
        second: Vector = (0.0, 0.0, 0.0),
        workpiece: Vector = (0.0, 0.0, 0.0),
        tool_length: float = 0.0,
        *,
        nutating: bool = False,
        reversed_joints: str = "",
    ) -> Kinematics:
        """Return a machine of a kind.

        kind       letters of both joints, such as
                   table_table  AC  a table that tilts (A on the base) and turns (C, carried by A): a trunnion
                   head_head    CB  a head that turns (C on the slide) and tilts (B, which holds the spindle)
                   head_table   BC  a head that tilts (B), and a table that turns (C)
        first, second  a point on the axis of each joint, in the order of the letters, m: of a table in machine
                   coordinates, of a head from the spindle's gauge point, such as (0, 0, pivot length)
        workpiece  origin of the workpiece in machine coordinates, m
        tool_length    from the spindle's gauge point to the tip, m
        nutating   True if an axis lies at 45 degrees between Z and the axis of its letter: that of the joint of a
                   table_table on the base, of a head_head that holds the spindle, of the head of a head_table
        reversed_joints  letters of joints that count against ISO 841
        """
        if len(letters) != 2:
            raise ParameterError(f"two letters of rotary joints are needed, such as AC, not '{letters}'")
        leaning = 1 if kind == "head_head" else 0
        one, other = (
            RotaryJoint(letter, _direction(letter, nutating and k == leaning), point, letter in reversed_joints)
            for k, (letter, point) in enumerate(zip(letters, (first, second), strict=True))
        )
        tables: dict[str, tuple[RotaryJoint, ...]] = {"table_table": (one, other), "head_table": (other,)}
        heads: dict[str, tuple[RotaryJoint, ...]] = {"head_head": (one, other), "head_table": (one,)}
        if kind not in tables | heads:
            raise ParameterError(f"a machine is a {', '.join(get_args(Kind))}, not '{kind}'")
        return Kinematics(tables.get(kind, ()), heads.get(kind, ()), workpiece, (0.0, 0.0, -tool_length))

    @property
    def joints(self) -> tuple[RotaryJoint, RotaryJoint]:
        """The rotary joints in the order of their letters, which is that of every row of rotary positions."""
        first, second = sorted((*self.table, *self.head), key=lambda joint: joint.letter)
        return first, second

    @property
    def rotary_letters(self) -> str:
        """The letters of the rotary joints, such as AC."""
        return "".join(joint.letter for joint in self.joints)

    @property
    def letters(self) -> str:
        """The letters of all joints, such as XYZAC."""
        return LINEAR + self.rotary_letters

    @property
    def cosine_of_axes(self) -> float:
        """The cosine of the angle between the axes of both rotary joints, which is the same in every position."""
        first, second = self.joints
        return sum(a * b for a, b in zip(first.direction, second.direction, strict=True))

    def with_tool(self, length: float) -> Kinematics:
        """Return the machine with a tool of a length, m, along the spindle."""
        return replace(self, tool=(self.tool[0], self.tool[1], -length))

    def with_travel(self, travel: dict[str, tuple[float, float]]) -> Kinematics:
        """Return the machine with travel limits of its rotary joints by letter, rad."""

        def limited(joints: tuple[RotaryJoint, ...]) -> tuple[RotaryJoint, ...]:
            ends = [travel.get(joint.letter, (joint.least, joint.most)) for joint in joints]
            return tuple(
                replace(joint, least=least, most=most) for joint, (least, most) in zip(joints, ends, strict=True)
            )

        return replace(self, table=limited(self.table), head=limited(self.head))

    def linear(self, tip: Numbers, rotary: Numbers) -> Row:
        """Return the linear joints X, Y, Z (m) that put the tip of the tool at a point of the workpiece.

        tip     x, y, z in the workpiece frame, m
        rotary  the rotary joints in the order of `rotary_letters`, rad
        """
        at = self._by_letter(rotary)
        point = _plus(tip, self.workpiece)
        for joint in reversed(self.table):
            point = _about(joint, _turn(joint, at[joint.letter], -joint.sign), point)
        return _minus(point, self._tip_from_slide(at))

    def tip(self, linear: Numbers, rotary: Numbers) -> Row:
        """Return the tip of the tool x, y, z in the workpiece frame (m): the inverse of `linear`."""
        at = self._by_letter(rotary)
        point = _plus(linear, self._tip_from_slide(at))
        for joint in self.table:
            point = _about(joint, _turn(joint, at[joint.letter], joint.sign), point)
        return _minus(point, self.workpiece)

    def tool_axis(self, rotary: Numbers) -> Row:
        """Return the unit vector from the tip along the tool to the spindle, in the workpiece frame."""
        at = self._by_letter(rotary)
        direction: Row = (0.0, 0.0, 1.0)
        for joint in reversed(self.head):
            direction = _turned(_turn(joint, at[joint.letter], joint.sign), direction)
        for joint in self.table:
            direction = _turned(_turn(joint, at[joint.letter], joint.sign), direction)
        return direction

    def linear_change(self, tip: Numbers, tip_change: Numbers, rotary: Numbers, rotary_change: Numbers) -> Row:
        """Return `linear` at tip + tip_change and rotary + rotary_change less `linear` at tip and rotary (m).

        Nothing of the size of the positions is subtracted: a small change keeps its relative accuracy.
        """
        moved = self.linear(_changes(tip, tip_change), _changes(rotary, rotary_change))
        return tuple(position.change if isinstance(position, Change) else 0.0 * position for position in moved)

    def tip_change(self, linear: Numbers, linear_change: Numbers, rotary: Numbers, rotary_change: Numbers) -> Row:
        """Return `tip` at linear + linear_change and rotary + rotary_change less `tip` at linear and rotary (m).

        A small change keeps its relative accuracy, as in `linear_change`.
        """
        moved = self.tip(_changes(linear, linear_change), _changes(rotary, rotary_change))
        return tuple(position.change if isinstance(position, Change) else 0.0 * position for position in moved)

    def rotary(self, axis: np.ndarray) -> Branches:
        """Return all rotary positions that give tool axes, in closed form.

        axis  unit vectors in the workpiece frame, shape (3,) or (3, n)

        With u₁ the joint next to the workpiece, u₂ the one next to the tool, z the tool axis at rotary zero,
        κ = ∠(u₁, u₂), λ = ∠(u₂, z) and τ = ∠(u₁, axis), the second angle is β₀ ± β with

            tan² β/2 = sin((τ + κ - λ)/2) sin((τ - κ + λ)/2) / (sin((κ + λ + τ)/2) sin((κ + λ - τ)/2))

        by the half-angle formula of the spherical triangle, which keeps small tilts accurate.  The first angle turns
        the tilted tool axis into `axis`.  Angles are in (-π, π], without regard to travel.
        Raises UnreachableError for a tilt that no angle gives, and ParameterError for a vector that is no unit vector.
        """
        t = unit_vectors(axis)
        first, second = self._from_workpiece()
        u, v, z = (np.array(x) for x in (first.direction, second.direction, (0.0, 0.0, 1.0)))
        kappa, lamda = _angle(u, v), _angle(v, z)
        tilt = np.arctan2(np.linalg.norm(np.cross(u, t, axisb=0), axis=-1), u @ t)
        above = np.sin(0.5 * (tilt + kappa - lamda)) * np.sin(0.5 * (tilt - kappa + lamda))
        below = np.sin(0.5 * (kappa + lamda + tilt)) * np.sin(0.5 * (kappa + lamda - tilt))
        least, most = abs(kappa - lamda), min(kappa + lamda, 2.0 * math.pi - kappa - lamda)
        beyond = np.flatnonzero((tilt < least - _ROUNDING) | (tilt > most + _ROUNDING))
        if beyond.size:
            raise self._beyond(int(beyond[0]), float(tilt[beyond[0]]), first, second, least, most)
        half = np.arctan2(np.sqrt(np.maximum(above, 0.0)), np.sqrt(np.maximum(below, 0.0)))
        # the second angle for which the tool axis comes nearest to the first joint
        middle = math.atan2(float(u @ np.cross(v, z)), float(u @ (z - (v @ z) * v)))
        across, angles = _across(u, t), np.empty((2, 2, t.shape[1]))
        at_pole = np.minimum(tilt, math.pi - tilt) < POLE
        order = self.rotary_letters
        for branch, sign in enumerate((1.0, -1.0)):
            beta = middle + sign * 2.0 * half
            # only what is across u turns: subtracting products of whole vectors would lose small tilts
            tilted = _across(u, _rotated(v, beta, z))
            alpha = np.arctan2(u @ np.cross(tilted, across, axis=0), _dot(tilted, across))
            angles[branch, order.index(first.letter)] = np.where(at_pole, 0.0, _wrapped(first.sign * alpha))
            angles[branch, order.index(second.letter)] = _wrapped(second.sign * beta)
        return Branches(angles, at_pole, order.index(first.letter))

    def axis_terms(self) -> np.ndarray:
        """Return the vectors mᵢⱼ of the tool axis Σᵢⱼ mᵢⱼ bᵢ(θ₁) bⱼ(θ₂), b = (1, cos, sin); shape (9, 3), row 3 i + j.

        θ₁, θ₂ are the rotary joints in the order of their letters.
        """
        first, second = self._from_workpiece()
        z = np.array((0.0, 0.0, 1.0))
        terms = np.array([[part @ inner for inner in _parts(second, z)] for part in _parts(first, np.eye(3))])
        # from the order of the chain to that of the letters
        ordered = terms if first is self.joints[0] else terms.swapaxes(0, 1)
        return np.ascontiguousarray(ordered.reshape(9, 3))

    def nearest_tilt(self, axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
        """Return the positions of the joint next to the tool that come nearest to tool axes, rad, shape (n,).

        axis   unit vectors, shape (3, n);  angle  positions of the joint next to the workpiece, rad, shape (n,)

        With t the tool axis turned back about the first joint, cos β (z - (u₂·z) u₂)·t + sin β (u₂ x z)·t is largest.
        """
        first, second = self._from_workpiece()
        v, z = np.array(second.direction), np.array((0.0, 0.0, 1.0))
        point: Row = tuple(axis)
        back = np.array(_turned(_turn(first, angle, -first.sign), point))
        beta = np.arctan2(np.cross(v, z) @ back, (z - (v @ z) * v) @ back)
        return _wrapped(second.sign * beta)

    def _from_workpiece(self) -> tuple[RotaryJoint, RotaryJoint]:
        """Return the joint next to the workpiece and the one next to the tool."""
        first, second = (*reversed(self.table), *self.head)
        return first, second

    def _beyond(
        self, block: int, tilt: float, first: RotaryJoint, second: RotaryJoint, least: float, most: float
    ) -> UnreachableError:
        return UnreachableError(
            Text(
                f"the tool axis lies {Quantity(tilt, 'rad'):deg} from the axis of joint {first.letter}, and joint "
                f"{second.letter} reaches {Quantity(least, 'rad'):deg} to {Quantity(most, 'rad'):deg}: tilt the tool "
                "within this range"
            ),
            block,
        )

    def _by_letter(self, rotary: Numbers) -> dict[str, Any]:
        return dict(zip(self.rotary_letters, rotary, strict=True))

    def _tip_from_slide(self, at: dict[str, Any]) -> Row:
        """Return the vector from the linear joints to the tip, in machine directions."""
        point: Row = self.tool
        for joint in reversed(self.head):
            point = _about(joint, _turn(joint, at[joint.letter], joint.sign), point)
        return point


class Branches(NamedTuple):
    """The rotary positions that give tool axes.

    angles   rad, in (-π, π], shape (2 branches, 2 joints, n); joints in the order of the letters
    at_pole  True where the tool axis lies on the axis of joint `free`, whose angle may then be any; shape (n,)
    free     index of the joint next to the workpiece
    """

    angles: np.ndarray
    at_pole: np.ndarray
    free: int


def _direction(letter: str, nutating: bool = False) -> Vector:
    directions = NUTATING if nutating else DIRECTIONS
    if letter not in directions:
        raise ParameterError(
            f"a {'nutating' if nutating else 'rotary'} joint has the letter {', '.join(directions)}, not '{letter}'"
        )
    return directions[letter]


def _turn(joint: RotaryJoint, angle: Any, sign: float) -> Matrix:
    """Return the matrix of a rotation about the direction of a joint by sign · angle."""
    u, sine, cosine = joint.direction, ops.sin(angle), ops.cos(angle)

    def entry(i: int, j: int) -> Any:
        # the entry of u x: +-u_k for i, j, k in cyclic order; literal zeros and ones cost no operation in `dot`
        across = 0.0 if i == j else sign * u[3 - i - j] * (1.0 if (j - i) % 3 == 2 else -1.0)
        along = u[i] * u[j]
        return matrix.dot((along, float(i == j) - along, across), (1.0, cosine, sine))

    return tuple(tuple(entry(i, j) for j in range(3)) for i in range(3))


def _parts(joint: RotaryJoint, v: np.ndarray) -> list[np.ndarray]:
    """Return the parts of a vector, or of each column of a matrix, turned about a joint: fixed, of cos and of sin."""
    u = np.array(joint.direction)
    fixed = np.outer(u, u)
    cross = np.array([[0.0, -u[2], u[1]], [u[2], 0.0, -u[0]], [-u[1], u[0], 0.0]])
    return [fixed @ v, (np.eye(3) - fixed) @ v, joint.sign * cross @ v]


def _turned(turn: Matrix, v: Row) -> Row:
    return tuple(matrix.dot(row, v) for row in turn)


def _about(joint: RotaryJoint, turn: Matrix, point: Row) -> Row:
    """Turn a point about the axis of a joint."""
    return _plus(_turned(turn, _minus(point, joint.point)), joint.point)


def _plus(a: Numbers, b: Numbers) -> Row:
    """Return a + b; a literal zero costs no operation."""
    return tuple(y if matrix.is_zero(x) else x if matrix.is_zero(y) else x + y for x, y in zip(a, b, strict=True))


def _minus(a: Numbers, b: Numbers) -> Row:
    return tuple(-y if matrix.is_zero(x) else x if matrix.is_zero(y) else x - y for x, y in zip(a, b, strict=True))


def _changes(start: Numbers, change: Numbers) -> tuple[Change, ...]:
    return tuple(Change(a, b) for a, b in zip(start, change, strict=True))


def unit_vectors(axis: np.ndarray) -> np.ndarray:
    """Return tool axes as unit vectors, shape (3, n). Raise ParameterError for another shape or length."""
    t = np.asarray(axis, float)
    t = t.reshape(3, -1) if t.ndim == 1 else t
    if t.ndim != 2 or len(t) != 3:
        raise ParameterError(f"tool axes have the shape (3, n), not {t.shape}")
    length = np.sqrt(_dot(t, t))
    wrong = np.flatnonzero(~(np.abs(length - 1.0) < _UNIT))
    if wrong.size:
        raise ParameterError(
            f"the tool axis {tuple(t[:, wrong[0]].tolist())} of block {wrong[0]} has the length "
            f"{length[wrong[0]]:.9g}: give a unit vector"
        )
    return t / length


def _angle(a: np.ndarray, b: np.ndarray) -> float:
    return math.atan2(float(np.linalg.norm(np.cross(a, b))), float(a @ b))


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("in,in->n", a, b)


def _across(u: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Return the part of each vector across u."""
    return vectors - np.outer(u, u @ vectors)


def _rotated(u: np.ndarray, angle: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Return a vector turned about u by each of the angles, shape (3, n)."""
    along = (u @ z) * u
    return np.outer(z - along, np.cos(angle)) + np.outer(np.cross(u, z), np.sin(angle)) + along[:, None]


def _wrapped(angle: np.ndarray) -> np.ndarray:
    """Return angles in (-π, π]."""
    return angle - 2.0 * math.pi * np.ceil(angle / (2.0 * math.pi) - 0.5)
