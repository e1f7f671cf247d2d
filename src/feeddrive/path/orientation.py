"""Rotary joints of a row of tool axes: the branch over the whole row, the cone at the pole, turns, interpolation.

A five-axis machine gives a tool axis by two branches of its rotary joints, each with whole turns more or less, as far
as the travel allows.  `choose_rotary` takes the shortest way through all of them (dynamic programming), in

    Σₖ (maxⱼ |θⱼ(k) - θⱼ(k-1)| / speedⱼ + lift if the tool axis leaves the arc between both blocks)

A move that leaves the arc sweeps the tool through the workpiece, so that the tool must be lifted for it: `lift` is the
time of a whole turn of the slowest joint.

Where the tool axis lies on the axis of the joint next to the workpiece, the pole, the angle of this joint is free.
Within a cone about the pole it moves straight from its angle before the cone to the one behind it, and the other joint
comes as near to the tool axis as it can: the deviation is at most the half angle of the cone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from math import floor
from typing import NamedTuple

import numpy as np

from feeddrive.language.errors import ParameterError
from feeddrive.language.kernels.elementary import cos, sin
from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.source import Floats, Floats2, Floats3, Ints
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text
from feeddrive.path.kinematics import POLE, Kinematics, RotaryJoint, UnreachableError, unit_vectors

TURN = 2.0 * math.pi
MOST_WOUND = math.radians(1e6)
"""The largest angle of a rotary joint, rad: beyond it a position in float64 is no longer good for nanometers."""
_END = 1e-9  # rad beyond the end of a travel that still counts as its end: the rounding of a programmed angle
_SWEEP = 0.02  # rad from the arc, at the middle of a move, above which the choice of branch counts it as a lift
HALF_TURN = 0.5 * TURN + 1e-6  # rad, with the rounding of a turn by 180 degrees
_THROUGH = 0.1  # of the cone: an arc that comes so near to the pole may change the branch there
_SHARES = (0.25, 0.5, 0.75)  # of a move, at which its tool axis is compared with the arc between its ends


class Orientations(NamedTuple):
    """The rotary joints of a row of n tool axes.

    rotary    joint positions, rad, shape (2, n)
    branch    which of the two branches each block takes, -1 within the cone; shape (n,)
    deviation angle between the tool axis of the joints and the programmed one, rad, shape (n,)
    """

    rotary: np.ndarray
    branch: np.ndarray
    deviation: np.ndarray


def choose_rotary(
    kinematics: Kinematics,
    axis: np.ndarray,
    *,
    start: Sequence[float] | None = None,
    cone: float = 0.0,
    way: np.ndarray | None = None,
    speeds: Sequence[float] = (1.0, 1.0),
    in_plane: bool = False,
) -> Orientations:
    """Return the rotary joints that give tool axes, on the shortest way within the travel.

    axis    tool axes in the workpiece frame, shape (3, n)
    start   rotary joints before the first block, rad; absent: the first block may begin anywhere
    cone    half angle of the cone at the pole, rad: the orientation tolerance
    way     position of each block along the path, over which the free joint moves in the cone; absent: block by block
    speeds  speeds of the joints, by which their moves are compared
    in_plane  True if the tool turns along the arc between two blocks: then a move leaves it that changes the branch
              other than at the pole, or turns a joint by more than half a turn

    Raises UnreachableError for a tool axis that the joints or their travel do not reach, and ParameterError for a way
    that goes back and for speeds that are not above 0.
    """
    t = unit_vectors(axis)
    blocks = t.shape[1]
    if way is not None and (np.shape(way) != (blocks,) or not np.all(np.diff(way) >= 0.0)):
        raise ParameterError(f"the way must have a position for each of the {blocks} blocks, none before the last one")
    if not all(speed > 0.0 for speed in speeds):
        raise ParameterError(f"the speeds of the rotary joints must be above 0, not {', '.join(map(str, speeds))}")
    branches = kinematics.rotary(t)
    free, joints = branches.free, kinematics.joints
    pole = np.array(joints[free].direction)
    tilt = np.arctan2(np.linalg.norm(np.cross(pole, t, axisb=0), axis=-1), np.abs(pole @ t))
    inside = branches.at_pole | (tilt <= max(cone, POLE))
    outside = np.flatnonzero(~inside)
    rotary, branch = np.zeros((2, blocks)), np.full(blocks, -1)
    if outside.size:
        rotary[:, outside], branch[outside] = _shortest(
            kinematics,
            t[:, outside],
            branches.angles[:, :, outside],
            outside,
            start,
            speeds,
            cone if in_plane else None,
        )
    if outside.size < blocks:
        _cross_poles(kinematics, t, rotary, inside, free, start, way)
    deviation = angle_between(np.array(kinematics.tool_axis(rotary)), t)
    off = np.flatnonzero(deviation > max(cone, POLE) + _END)
    if off.size:
        other = joints[1 - free]
        raise UnreachableError(
            Text(
                f"within the cone at the pole joint {other.letter} would pass the end of its travel, "
                f"{_ends(other)}, and the tool axis be {Quantity(float(deviation[off[0]]), 'rad'):deg} off: keep "
                "farther from the pole, or give a larger orientation tolerance"
            ),
            int(off[0]),
        )
    return Orientations(rotary, branch, deviation)


def _shortest(
    kinematics: Kinematics,
    t: np.ndarray,
    angles: np.ndarray,
    blocks: np.ndarray,
    start: Sequence[float] | None,
    speeds: Sequence[float],
    along_arcs: float | None,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the angles, shape (2, n), and branches of the shortest way through all branches and turns.

    along_arcs  half angle of the cone at the pole, rad, if the tool follows arcs between the blocks; None: it need not
    """
    joints = kinematics.joints
    limited = [_is_limited(joint) for joint in joints]
    # a travel of a turn or more hinders few programs: first without its ends, which leaves two states a block
    wide = [joint.most - joint.least >= TURN for joint in joints]
    for endless in ([not a or b for a, b in zip(limited, wide, strict=True)], [not a for a in limited]):
        candidates, allowed = _candidates(joints, angles, endless)
        unreached = np.flatnonzero(~np.any(allowed, axis=1))
        if unreached.size:
            raise _beyond_travel(joints, angles[:, :, unreached[0]], int(blocks[unreached[0]]))
        chosen = _shortest_way(kinematics, t, candidates, allowed, endless, start, speeds, along_arcs)
        rotary = candidates[np.arange(blocks.size), chosen].T.copy()
        fits = True
        for j, joint in enumerate(joints):
            if endless[j]:
                try:
                    rotary[j] = unwound(rotary[j], start=None if start is None else start[j], letter=joint.letter)
                except UnreachableError as error:
                    raise UnreachableError(str(error), int(blocks[error.block])) from None
                if start is None:
                    rotary[j] += _turns_into(rotary[j], joint)
                fits = fits and joint.least <= np.min(rotary[j]) and np.max(rotary[j]) <= joint.most
        if fits:
            break
    return rotary, chosen // (allowed.shape[1] // 2)


def _turns_into(row: np.ndarray, joint: RotaryJoint) -> float:
    """Return the whole turns, rad, by which a row of positions comes into the travel of a joint; 0 if none do."""
    if joint.least <= np.min(row) and np.max(row) <= joint.most:
        return 0.0
    up = TURN * math.ceil((joint.least - float(np.min(row))) / TURN) if not math.isinf(joint.least) else 0.0
    return up if float(np.max(row)) + up <= joint.most else 0.0


def _shortest_way(
    kinematics: Kinematics,
    t: np.ndarray,
    candidates: np.ndarray,
    allowed: np.ndarray,
    endless: Sequence[bool],
    start: Sequence[float] | None,
    speeds: Sequence[float],
    along_arcs: float | None,
) -> np.ndarray:
    """Return the state of each block on the shortest way through the candidates, shape (n,)."""
    count, states = allowed.shape
    pace, turning = np.array(speeds, float), np.array(endless, float)
    first = np.zeros(states)
    if start is not None:
        first = _cost(candidates[0] - np.array(start), turning, pace)
    cost = np.ascontiguousarray(np.where(allowed, 0.0, math.inf))
    middle, near = _middles(t)
    came, chosen = np.zeros(count * states, np.int64), np.zeros(count, np.int64)
    lift = TURN / float(np.min(pace))
    fixed = np.zeros(count)
    if along_arcs is not None:
        inner = (*reversed(kinematics.table), *kinematics.head)[0]
        pole = np.array(inner.direction)[:, None]
        before = np.roll(t, 1, axis=1)
        apart = np.minimum(_from_arc(before, t, pole), _from_arc(before, t, -pole))
        fixed = np.where(apart > max(_THROUGH * along_arcs, POLE), 1.0, 2.0)
    rules = Rules(kinematics.axis_terms(), middle, near, turning, pace, lift, fixed)
    shortest_way(np.ascontiguousarray(candidates), cost, first, rules, came, chosen)
    return chosen


def _candidates(
    joints: Sequence[RotaryJoint], angles: np.ndarray, endless: Sequence[bool]
) -> tuple[np.ndarray, np.ndarray]:
    """Return all positions of the joints within their travel, shape (n, states, 2), and which of them there are.

    A joint that turns without end has one, whose whole turns follow later.
    """
    by_joint: list[tuple[np.ndarray, np.ndarray]] = []
    for j, joint in enumerate(joints):
        theta = angles[:, j]
        if endless[j]:
            by_joint.append((theta[None], np.ones_like(theta, bool)[None]))
            continue
        lowest = theta + TURN * np.ceil((joint.least - _END - theta) / TURN)
        turns = np.arange(math.floor((joint.most - joint.least + 2.0 * _END) / TURN) + 1)
        positions = lowest + TURN * turns[:, None, None]
        by_joint.append((np.clip(positions, joint.least, joint.most), positions <= joint.most + _END))
    (a, a_there), (b, b_there) = by_joint
    shape = (2, len(a), len(b), angles.shape[2])
    first = np.broadcast_to(np.swapaxes(a, 0, 1)[:, :, None], shape)
    second = np.broadcast_to(np.swapaxes(b, 0, 1)[:, None], shape)
    there = np.swapaxes(a_there, 0, 1)[:, :, None] & np.swapaxes(b_there, 0, 1)[:, None]
    states = shape[0] * shape[1] * shape[2]
    return np.stack([first, second], axis=-1).reshape(states, -1, 2).swapaxes(0, 1), there.reshape(states, -1).T


def _cost(moves: np.ndarray, endless: np.ndarray, speeds: np.ndarray) -> np.ndarray:
    wrapped = np.where(endless > 0.0, moves - TURN * np.floor(moves / TURN + 0.5), moves)
    return np.max(np.abs(wrapped) / speeds, axis=-1)


def _middles(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return, for each block, the middle of the arc from the block before, shape (n, 3), and the cosine of the largest
    angle from there that is no sweep, shape (n,).
    """
    total = t + np.roll(t, 1, axis=1)
    length = np.linalg.norm(total, axis=0)
    half = 0.5 * angle_between(t, np.roll(t, 1, axis=1))
    middle = total / np.where(length > 0.0, length, 1.0)
    return np.ascontiguousarray(middle.T), np.cos(np.minimum(half + _SWEEP, math.pi))


class Rules(NamedTuple):
    """What decides about the way of the rotary joints.

    terms     of the tool axis in products of 1, cos, sin of both angles (`Kinematics.axis_terms`), shape (9, 3)
    middle    middle of the arc that leads to each block, shape (n, 3);  near  cosine of the largest angle from there
    endless   1 for a joint that turns without end, shape (2,)
    speeds    of the joints, shape (2,);  lift  cost of a move that leaves the arc
    along     0 if the joints move straight to a block; if along the arc, 2 if it passes the pole, otherwise 1,
              shape (n,)
    """

    terms: Floats2
    middle: Floats2
    near: Floats
    endless: Floats
    speeds: Floats
    lift: float
    along: Floats


@kernel
def shortest_way(positions: Floats3, cost: Floats2, first: Floats, rules: Rules, came: Ints, chosen: Ints) -> float:
    """Find the shortest way through one state of each block; write its states to `chosen`, and return its cost.

    positions  two joints of each state of each block;  cost  0, or infinite for a state that does not exist
    first      cost of each state of the first block
    came       work room for the state before each state of each block
    """
    blocks = len(positions)
    states = len(positions[0])
    for s in range(states):
        cost[0, s] += first[s]
    for k in range(1, blocks):
        for s in range(states):
            best = -1
            least = 0.0
            for r in range(states):
                x = positions[k, s, 0] - positions[k - 1, r, 0]
                y = positions[k, s, 1] - positions[k - 1, r, 1]
                if rules.endless[0] > 0.0:
                    x = x - TURN * floor(x / TURN + 0.5)
                if rules.endless[1] > 0.0:
                    y = y - TURN * floor(y / TURN + 0.5)
                total = cost[k - 1, r] + max(abs(x) / rules.speeds[0], abs(y) / rules.speeds[1])
                if rules.along[k] > 0.0:
                    other = 2 * s // states != 2 * r // states
                    if (other and rules.along[k] < 1.5) or max(abs(x), abs(y)) > HALF_TURN:
                        total += rules.lift
                # a small move of the joints is a small one of the tool axis
                elif abs(x) + abs(y) > 2.0 * _SWEEP and (best < 0 or total < least):
                    # at half a turn, which is farthest away, in place of the middle of several turns
                    share = min(0.5, 0.5 * TURN / max(abs(x), abs(y)))
                    a = positions[k - 1, r, 0] + share * x
                    b = positions[k - 1, r, 1] + share * y
                    if cosine_from(a, b, rules.terms, rules.middle[k]) < rules.near[k]:
                        total += rules.lift
                if best < 0 or total < least:
                    best = r
                    least = total
            cost[k, s] += least
            came[k * states + s] = best
    last = 0
    for s in range(states):
        if cost[blocks - 1, s] < cost[blocks - 1, last]:
            last = s
    shortest = cost[blocks - 1, last]
    for k in range(blocks - 1, -1, -1):
        chosen[k] = last
        last = came[k * states + last]
    return shortest


@kernel
def cosine_from(a: float, b: float, terms: Floats2, direction: Floats) -> float:
    """Return the cosine of the angle between the tool axis at two rotary angles and a direction."""
    total = 0.0
    for i in range(3):
        p = 1.0 if i == 0 else cos(a) if i == 1 else sin(a)
        for j in range(3):
            q = 1.0 if j == 0 else cos(b) if j == 1 else sin(b)
            row = terms[3 * i + j]
            total += p * q * (row[0] * direction[0] + row[1] * direction[1] + row[2] * direction[2])
    return total


def _cross_poles(
    kinematics: Kinematics,
    t: np.ndarray,
    rotary: np.ndarray,
    inside: np.ndarray,
    free: int,
    start: Sequence[float] | None,
    way: np.ndarray | None,
) -> None:
    """Set the joints of the blocks within the cone: the free one moves straight, the other follows the tool axis."""
    outside = np.flatnonzero(~inside)
    blocks = np.flatnonzero(inside)
    place = np.arange(len(inside), dtype=float) if way is None else np.asarray(way, float)
    if outside.size:
        places, angles = place[outside], rotary[free, outside]
        if start is not None and inside[0]:
            places, angles = np.append(place[0] - 1.0 if way is None else 0.0, places), np.append(start[free], angles)
        rotary[free, blocks] = np.interp(place[blocks], places, angles)
    else:
        held = kinematics.joints[free]
        rotary[free, blocks] = np.clip(0.0 if start is None else start[free], held.least, held.most)
    other = 1 - free
    joint = kinematics.joints[other]
    nearest = kinematics.nearest_tilt(t[:, blocks], rotary[free, blocks])
    middle = np.interp(place[blocks], place[outside], rotary[other, outside]) if outside.size else np.zeros(blocks.size)
    # the whole turns of the neighbours outside of the cone
    followed = nearest + TURN * np.floor((middle - nearest) / TURN + 0.5)
    rotary[other, blocks] = np.clip(followed, joint.least, joint.most)


def unwound(
    angle: np.ndarray, *, start: float | None = None, least: float = -math.inf, most: float = math.inf, letter: str = ""
) -> np.ndarray:
    """Return each angle with the whole turns that bring it nearest to the one before it, within a travel.

    angle        positions of a rotary joint, rad, shape (n,)
    start        position before the first; absent: the first angle stays, if it lies in the travel
    least, most  the travel, rad

    A joint at the end of its travel turns back by whole turns.  Raises UnreachableError for an angle without an
    equivalent in the travel, and for one that is wound beyond 1e6 degrees.
    """
    wanted = np.ascontiguousarray(angle, dtype=float)
    if not wanted.size:
        return wanted
    out = np.empty_like(wanted)
    begin = float(np.clip(wanted[0] if start is None else start, least, most))
    reached = unwind(wanted, begin, least - _END, most + _END, out)
    wound = np.flatnonzero(np.abs(out[:reached]) > MOST_WOUND)
    if reached == len(wanted) and not wound.size:
        return np.clip(out, least, most)
    joint = f"joint {letter}" if letter else "the rotary joint"
    if wound.size:
        block = int(wound[0])
        raise UnreachableError(
            Text(
                f"{joint} would be wound to {Quantity(float(out[block]), 'rad'):deg}, and at most "
                f"{Quantity(MOST_WOUND, 'rad'):deg} are planned: unwind it in the program"
            ),
            block,
        )
    raise UnreachableError(
        Text(
            f"{joint} at {Quantity(float(wanted[reached]), 'rad'):deg} has no position in its travel of "
            f"{Quantity(least, 'rad'):deg} to {Quantity(most, 'rad'):deg}: turn the workpiece, or tilt the tool less"
        ),
        reached,
    )


@kernel
def unwind(angle: Floats, begin: float, least: float, most: float, out: Floats) -> int:
    """Write the nearest equivalents within the travel; return how many there are before the first without any."""
    before = begin
    for k in range(len(angle)):
        turned = angle[k] + TURN * floor((before - angle[k]) / TURN + 0.5)
        while turned > most:
            turned -= TURN
        while turned < least:
            turned += TURN
        if turned > most:
            return k
        out[k] = turned
        before = turned
    return len(angle)


def interpolate_axes(
    kinematics: Kinematics, begin: np.ndarray, end: np.ndarray, share: np.ndarray | float
) -> np.ndarray:
    """Return tool axes while the rotary joints move straight, rotary = (1 - s) begin + s end; shape (3, n).

    begin, end  rotary joints, rad, shape (2, n) or (2, 1);  share  s from 0 to 1, shape (n,)
    """
    return np.array(kinematics.tool_axis(begin + np.asarray(share) * (end - begin)))


def interpolate_vector(begin: np.ndarray, end: np.ndarray, share: np.ndarray | float) -> np.ndarray:
    """Return tool axes whose components move straight, ((1 - s) begin + s end) made a unit vector; shape (3, n).

    They lie in the plane of both, as those of `interpolate_plane`, and turn faster in the middle: over an angle φ
    by 1/cos² φ/2.  Raises UnreachableError for opposite tool axes.
    """
    a, b = unit_vectors(begin), unit_vectors(end)
    _check_opposite(a, b)
    straight = (1.0 - np.asarray(share)) * a + np.asarray(share) * b
    return straight / np.linalg.norm(straight, axis=0)


def interpolate_plane(begin: np.ndarray, end: np.ndarray, share: np.ndarray | float) -> np.ndarray:
    """Return tool axes that turn in the plane of both at a constant rate (great circle); shape (3, n).

        t = (sin((1 - s) φ) begin + sin(s φ) end) / sin φ,   φ the angle between both

    Raises UnreachableError for opposite tool axes, which lie in no plane.
    """
    a, b = unit_vectors(begin), unit_vectors(end)
    _check_opposite(a, b)
    phi = angle_between(a, b)
    s = np.asarray(share)
    # sin(sφ)/sin φ -> s for a small angle
    small = phi < _END
    sine = np.where(small, 1.0, np.sin(phi))
    first = np.where(small, 1.0 - s, np.sin((1.0 - s) * phi) / sine)
    second = np.where(small, s, np.sin(s * phi) / sine)
    return first * a + second * b


def _check_opposite(a: np.ndarray, b: np.ndarray) -> None:
    opposite = np.flatnonzero(angle_between(a, b) > math.pi - _OPPOSITE)
    if opposite.size:
        raise UnreachableError(
            "the tool axis turns to the opposite direction in one block, which leaves the plane of its turn open: give "
            "a block between, or interpolate by axes",
            int(opposite[0]),
        )


_OPPOSITE = 1e-6  # rad: nearer to opposite, rounding of the components decides about the plane


def leaves_arc(kinematics: Kinematics, rotary: np.ndarray, tolerance: float) -> np.ndarray:
    """Return the blocks into which the rotary joints move so that the tool axis leaves the arc between both ends.

    rotary     rotary joints of n blocks, rad, shape (2, n)
    tolerance  distance from the arc, rad

    Such a move sweeps the tool through the workpiece: a turn of C by 180 degrees, a change of branch, a joint that is
    unwound.  Lift the tool before it.  The tool axis is compared at a quarter, half and three quarters of each move
    and after half a turn.
    """
    axis = np.array(kinematics.tool_axis(rotary))
    a, b = axis[:, :-1], axis[:, 1:]
    moved = np.max(np.abs(np.diff(rotary, axis=1)), axis=0)
    # and at half a turn, since whole turns return to the same tool axis
    half_turn = np.where(moved > math.pi, math.pi / np.maximum(moved, math.pi), 0.5)
    off = np.zeros(a.shape[1])
    for share in (*_SHARES, half_turn):
        off = np.maximum(off, _from_arc(a, b, interpolate_axes(kinematics, rotary[:, :-1], rotary[:, 1:], share)))
    return np.flatnonzero(off > tolerance) + 1


def _from_arc(a: np.ndarray, b: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Return the angle between each t and the arc from a to b; shapes (3, n)."""
    normal = np.cross(a, b, axis=0)
    length = np.linalg.norm(normal, axis=0)
    after = np.einsum("in,in->n", np.cross(normal, a, axis=0), t) > 0.0
    before = np.einsum("in,in->n", np.cross(b, normal, axis=0), t) > 0.0
    across = np.abs(np.einsum("in,in->n", normal, t)) / np.where(length > 0.0, length, 1.0)
    ends = np.minimum(angle_between(t, a), angle_between(t, b))
    return np.where(after & before, np.arcsin(np.minimum(across, 1.0)), ends)


def angle_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the angles between unit vectors, shape (3, n), rad: 2 atan2(|a - b|, |a + b|), accurate at both ends."""
    return 2.0 * np.arctan2(np.linalg.norm(a - b, axis=0), np.linalg.norm(a + b, axis=0))


def _is_limited(joint: RotaryJoint) -> bool:
    if math.isinf(joint.least) != math.isinf(joint.most):
        raise ParameterError(
            f"the travel of joint {joint.letter} has one end: give both, travel_least and travel_most, or none"
        )
    return not math.isinf(joint.least)


def _ends(joint: RotaryJoint) -> str:
    return Text(f"{Quantity(joint.least, 'rad'):deg} to {Quantity(joint.most, 'rad'):deg}")


def _beyond_travel(joints: Sequence[RotaryJoint], angles: np.ndarray, block: int) -> UnreachableError:
    """Return the error for a tool axis whose two branches, shape (2, 2), both lie beyond the travel."""
    reasons: list[str] = []
    for branch in angles:
        for joint, angle in zip(joints, branch.tolist(), strict=True):
            if _is_limited(joint) and angle + TURN * math.ceil((joint.least - _END - angle) / TURN) > joint.most + _END:
                reasons.append(f"joint {joint.letter} at {Quantity(angle, 'rad'):deg}, and it goes from {_ends(joint)}")
                break
    return UnreachableError(
        Text(f"the tool axis needs {' or '.join(dict.fromkeys(reasons))}: tilt the tool less, or turn the workpiece"),
        block,
    )
