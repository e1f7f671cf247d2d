"""Paths for the tests of the planner."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from feeddrive.path.motion import ARC, LINE, POLYNOMIAL, Part, Pieces, derivatives
from feeddrive.path.program.blocks import Line
from feeddrive.path.program.moves import Arc, Feed, Move, PathMode, Point, Spline, Straight
from feeddrive.path.proof import Prover
from feeddrive.path.setpoints import planned

# m/s, m/s², m/s³, m/s⁴ of each of three axes
LIMITS = np.array([[0.5, 5.0, 100.0, 5e4]] * 3)


def lines(points: np.ndarray, feed: float) -> Pieces:
    """A polyline, shape (n + 1, N)."""
    points = np.asarray(points, float)
    moves = np.diff(points, axis=0)
    n, axes = moves.shape
    shape = np.zeros((n, axes, 8))
    shape[:, :, 1] = moves
    length = np.linalg.norm(moves, axis=1)
    return Pieces(np.full(n, LINE), length, points[:-1].copy(), shape, np.full(n, float(feed)), np.arange(n))


def arc(center: tuple[float, float], radius: float, begin: float, end: float, feed: float, pitch: float = 0) -> Pieces:
    """An arc in the plane of the first two axes of three, angles in rad; `pitch` is the way of the third axis, m."""
    turn, sense = abs(end - begin), np.sign(end - begin)
    length = float(np.hypot(radius * turn, pitch))
    shape = np.zeros((1, 3, 8))
    shape[0, :2, 0] = radius * np.cos(begin), radius * np.sin(begin)
    shape[0, :2, 1] = -sense * radius * np.sin(begin), sense * radius * np.cos(begin)
    shape[0, 2, 2] = pitch / length
    shape[0, :, 3] = turn / length
    origin = np.array([[center[0] + shape[0, 0, 0], center[1] + shape[0, 1, 0], 0.0]])
    return Pieces(np.array([ARC]), np.array([length]), origin, shape, np.array([float(feed)]), np.array([0]))


def joined_up(*parts: Pieces) -> Pieces:
    """One after the other."""
    return Pieces(*(np.concatenate(each) for each in zip(*parts, strict=True)))


def square(side: float, radius: float, feed: float) -> Pieces:
    """A square with rounded corners in the plane of the first two of three axes, from the end of a corner, m."""
    r, s, quarter = radius, side, 0.5 * np.pi
    ends = [((r, 0), (s - r, 0)), ((s, r), (s, s - r)), ((s - r, s), (r, s)), ((0, s - r), (0, r))]
    centers = [(s - r, r), (s - r, s - r), (r, s - r), (r, r)]
    parts = []
    for k, ((x0, y0), (x1, y1)) in enumerate(ends):
        parts.append(lines(np.array([[x0, y0, 0.0], [x1, y1, 0.0]]), feed))
        parts.append(arc(centers[k], r, (k - 1) * quarter, k * quarter, feed))
    return joined_up(*parts)


def random_curve(draw: np.random.Generator) -> Pieces:
    """Polynomials of seventh degree through random states of r' .. r''' at their ends, from 10 um to 30 mm long."""
    n, axes = int(draw.integers(1, 120)), 3
    step, wild = 10.0 ** draw.uniform(-5.0, -1.5), 10.0 ** draw.uniform(-2.0, 0.0)

    def direction(near: np.ndarray) -> np.ndarray:
        found = near + wild * draw.normal(size=axes)
        return found / np.linalg.norm(found)

    t = direction(np.zeros(axes))
    left, origin = np.array([t, 0.0 * t, 0.0 * t]), np.zeros(axes)
    lengths, origins, shapes = [], [], []
    for k in range(n):
        B = step * np.exp(0.7 * draw.normal())
        new = direction(t)
        bend, twist = 0.5 * draw.normal() * (new - t) / B, wild * draw.normal(size=axes) / B**2
        right = np.array([new, bend, twist]) * (1.0 if k < n - 1 else np.array([[1.0], [0.0], [0.0]]))
        move = 0.5 * (t + new) * B * (1.0 + 0.02 * draw.normal())
        c1, c2, c3 = left[0] * B, left[1] * B**2 / 2, left[2] * B**3 / 6
        # the four others from r, r', r'' and r''' at the end
        system = np.array([[1, 1, 1, 1], [4, 5, 6, 7], [12, 20, 30, 42], [24, 60, 120, 210]], float)
        rest = [move - c1 - c2 - c3, right[0] * B - c1 - 2 * c2 - 3 * c3, right[1] * B**2 - 2 * c2 - 6 * c3]
        high = np.linalg.solve(system, np.array([*rest, right[2] * B**3 - 6 * c3]))
        shape = np.zeros((axes, 8))
        shape[:, 1:] = np.array([c1, c2, c3, *high]).T
        lengths.append(B)
        origins.append(origin.copy())
        shapes.append(shape)
        origin, left, t = origin + shape.sum(axis=1), right, new
    feed = np.full(n, 10.0 ** draw.uniform(-3.0, 1.0))
    return Pieces(np.full(n, POLYNOMIAL), np.array(lengths), np.array(origins), np.array(shapes), feed, np.arange(n))


def random_limits(draw: np.random.Generator) -> np.ndarray:
    """Unequal axes, over decades."""
    return LIMITS * np.exp(draw.normal(size=LIMITS.shape))


KINDS = ("free lines", "micro segments", "reversals", "parallel to the axes", "arcs", "mixed")
_LINE = Line("random", 0, "")


def _point(xyz: np.ndarray) -> Point:
    return (*(float(each) for each in xyz), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def _arc(draw: np.random.Generator, here: np.ndarray, size: float) -> Arc:
    """An arc or helix of up to three turns in one of the three planes; one in four is a full circle."""
    first, second, across = ((0, 1, 2), (2, 0, 1), (1, 2, 0))[int(draw.integers(3))]
    radius, begin = size * draw.uniform(0.2, 2.0), draw.uniform(0.0, 2.0 * np.pi)
    center = float(here[first] - radius * np.cos(begin)), float(here[second] - radius * np.sin(begin))
    turns = int(draw.choice([-3, -1, -1, 1, 1, 2]))
    end = here.copy()
    if draw.random() > 0.25:
        angle = begin + np.sign(turns) * draw.uniform(0.05, 6.2)
        end[first], end[second] = center[0] + radius * np.cos(angle), center[1] + radius * np.sin(angle)
    if draw.random() < 0.5:
        end[across] += size * draw.normal()
    return Arc(_LINE, _point(here), _point(end), (first, second, across), center, turns)


def random_program(draw: np.random.Generator, kind: str, most: int = 30) -> tuple[list[Move], np.ndarray, np.ndarray]:
    """Moves of one of `KINDS`, at most so many, their end and limits: feed 0.1 to 1000 mm/s, within nothing to 0.5 mm.

    Half of them have limits of each axis drawn over three decades.
    """
    limits = LIMITS * 10.0 ** draw.uniform(-1.5, 1.5, LIMITS.shape) if draw.random() < 0.5 else LIMITS.copy()
    mode = str(draw.choice(["exact_path", "exact_stop", *["continuous"] * 8]))
    tolerance = 10.0 ** draw.uniform(-6.0, np.log10(5e-4)) if mode == "continuous" else 0.0
    feed = 10.0 ** draw.uniform(-4.0, 0.0)
    found: list[Move] = [PathMode(_LINE, mode, tolerance), Feed(_LINE, feed, 0.0)]
    here, heading = 0.2 * draw.normal(size=3), draw.normal(size=3)
    size, count = 10.0 ** draw.uniform(-5.0, -1.3), int(draw.integers(1, most + 1))
    if kind == "micro segments":
        size, count = 10.0 ** draw.uniform(-6.0, -3.0), 3 * count
    bend = 10.0 ** draw.uniform(-2.5, 0.0)
    for _ in range(count):
        this = str(draw.choice(KINDS[:5])) if kind == "mixed" else kind
        if this == "arcs" and draw.random() < 0.7:
            move = _arc(draw, here, size)
        else:
            if this == "free lines" or this == "arcs":
                heading = draw.normal(size=3)
            elif this == "micro segments":
                heading = heading / np.linalg.norm(heading) + bend * draw.normal(size=3)
            elif this == "reversals":
                heading = -heading if draw.random() < 0.7 else draw.normal(size=3)
            else:
                heading = np.eye(3)[int(draw.integers(3))] * draw.choice([-1.0, 1.0])
            step = size * np.exp(draw.normal()) * heading / np.linalg.norm(heading)
            move = Straight(_LINE, _point(here), _point(here + step), bool(draw.random() < 0.1))
        found.append(move)
        here = np.array(move.end[:3])
    return found, here, limits


def check_random(number: int, seed: int, most: int = 30) -> tuple[int, int]:
    """Plans and proves random program `number` of a seed; its moves and spans of time.  Raises if one does not hold."""
    draw = np.random.default_rng([seed, number])
    kind = KINDS[number % len(KINDS)]
    moves, end, limits = random_program(draw, kind, most)
    prover, last = Prover(limits), None
    for each in planned(moves, "XYZ", limits):
        if isinstance(each, Part):
            prover.prove(each)
            last = each
    proof = prover.proof()
    assert proof.count == 0, f"program {number} of seed {seed}, {kind}: {proof.faults[0]}"
    assert proof.jump <= 1e-9, f"program {number} of seed {seed}, {kind}: {proof.jump}"
    assert last is not None
    pieces, r = last.pieces, np.zeros((3, 5))
    length = float(pieces.length[-1])
    derivatives(int(pieces.kind[-1]), length, pieces.shape[-1], length, r)
    miss = np.abs(pieces.origin[-1] + r[:, 0] - end).max()
    assert miss <= 1e-12 * (1.0 + np.abs(end).max()), f"program {number} of seed {seed}, {kind}: ends {miss} m away"
    return len(moves) - 2, proof.spans


def random_all_axes(draw: np.random.Generator) -> tuple[list[Move], np.ndarray, str, np.ndarray]:
    """Return moves with splines and of up to nine axes, their end (9,), the letters of the axes, and their limits.

    Limits of each axis over decades; a helix may turn other axes, and chords of curves are in any of them.
    """
    letters = "XYZ" + "".join(letter for letter in "ABCUVW" if draw.random() < 0.4)
    columns = ["XYZABCUVW".index(letter) for letter in letters]
    limits = 10.0 ** (draw.uniform(-2.0, 0.5, (len(letters), 1)) + np.array([0.0, 1.0, 3.0, 5.0]))
    limits[:, 1:] *= 10.0 ** draw.uniform(-1.0, 1.5, (len(letters), 3))
    mode = str(draw.choice(["exact_path", "exact_stop", *["continuous"] * 4]))
    tolerance = 10.0 ** draw.uniform(-6.0, -3.3) if mode == "continuous" and draw.random() < 0.8 else 0.0
    feed, size = 10.0 ** draw.uniform(-4.0, 0.0), 10.0 ** draw.uniform(-5.0, -1.0)
    found: list[Move] = [PathMode(_LINE, mode, tolerance), Feed(_LINE, feed, feed)]
    here = np.zeros(9)

    def near(moved: np.ndarray) -> np.ndarray:
        return here + size * moved * draw.normal(size=9)

    inside = np.isin(np.arange(9), columns)
    for _ in range(int(draw.integers(1, 12))):
        some, plane = inside & (draw.random(9) < 0.6), np.arange(9) < 2
        kind = draw.random()
        if kind < 0.4:
            *points, end = (near(plane) for _ in range(3 if kind < 0.3 else 2))
            found.append(Spline(_LINE, tuple(here), tuple(end), tuple(map(tuple, points))))
        elif kind < 0.5:
            turn = _arc(draw, here[:3], size)
            end = np.where(np.arange(9) < 3, np.array(turn.end), near(some))
            found.append(replace(turn, start=tuple(here), end=tuple(end)))
        elif kind < 0.9:
            end = near(some)
            found.append(Straight(_LINE, tuple(here), tuple(end), bool(draw.random() < 0.1)))
        else:
            curve = here + size * some * (np.cos(0.05 * np.arange(40)[:, None] + np.arange(9)) - np.cos(np.arange(9)))
            found += [Straight(_LINE, tuple(a), tuple(b), False) for a, b in pairwise(curve)]
            end = curve[-1]
        here = end
    return found, here, letters, limits


def check_all_axes(number: int, seed: int) -> None:
    """Plan and prove program `number` of a seed of `random_all_axes`; raise as `check_random` does."""
    found, here, letters, limits = random_all_axes(np.random.default_rng([seed, number]))
    columns = ["XYZABCUVW".index(letter) for letter in letters]
    prover, stands = Prover(limits), None
    for each in planned(found, letters, limits):
        if isinstance(each, Part):
            prover.prove(each)
            stands = each
    proof = prover.proof()
    assert proof.count == 0, f"program {number} of seed {seed}, {letters}: {proof.faults[0]}"
    if stands is not None:
        pieces, r = stands.pieces, np.zeros((len(letters), 5))
        length = float(pieces.length[-1])
        derivatives(int(pieces.kind[-1]), length, pieces.shape[-1], length, r)
        miss = np.abs(pieces.origin[-1] + r[:, 0] - here[columns]).max()
        assert miss <= 1e-12 * (1.0 + np.abs(here).max()), f"program {number} of seed {seed}: ends {miss} m away"
