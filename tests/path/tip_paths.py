"""Random paths of the tip of a tool for random five-axis machines, and an independent look at what was planned."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple, TypeAlias

import numpy as np

from feeddrive.path.kinematics import Kinematics, UnreachableError
from feeddrive.path.motion import Part
from feeddrive.path.orientation import choose_rotary
from feeddrive.path.program.blocks import Line
from feeddrive.path.program.moves import Arc, Dwell, Feed, Move, Orientation, PathMode, Spline, Straight, ToolPoint
from feeddrive.path.proof import Prover
from feeddrive.path.setpoints import Sampler, planned
from feeddrive.path.tip_proof import TipProver

ROW = np.array([0.5, 5.0, 100.0, 5e4])  # m/s .. m/s⁴
TURN = np.array([5.0, 30.0, 600.0, 3e5])  # rad/s .. rad/s⁴


class Drawn(NamedTuple):
    """A random program: its moves and points, the machine, its limits, and the largest tolerances."""

    moves: list[Move]
    points: np.ndarray  # tip (m) and rotary joints (rad) of straight moves, shape (n, 5)
    kinematics: Kinematics
    letters: str
    limits: np.ndarray
    tolerance: float
    angle: float


def machine(draw: np.random.Generator) -> Kinematics:
    """Return kinematics of any kind with offsets up to 0.3 m."""

    def point() -> tuple[float, float, float]:
        x, y, z = draw.uniform(-0.3, 0.3, 3) * (draw.random() < 0.7)
        return float(x), float(y), float(z)

    tool, nutating = float(draw.choice([0.0, 0.12])), bool(draw.random() < 0.25)
    kind = draw.integers(3)
    if kind == 0:
        letters = "BC" if draw.random() < 0.5 else "AC"
        return Kinematics.of("table_table", letters, point(), point(), point(), tool, nutating=nutating)
    if kind == 1:
        letters = "CB" if draw.random() < 0.5 else "CA"
        return Kinematics.of("head_head", letters, point(), point(), point(), tool, nutating=nutating)
    letters = "BC" if draw.random() < 0.5 else "AC"
    return Kinematics.of("head_table", letters, point(), point(), point(), tool, nutating=nutating)


def curve(draw: np.random.Generator, count: int) -> np.ndarray:
    """Return points of a smooth curve through space and angles, some with noise of a postprocessor's digits."""
    s = np.linspace(0.0, 1.0, count)[:, None]
    waves = draw.integers(1, 5, 5) * draw.uniform(0.3, 1.0, 5)
    size = np.append(draw.uniform(0.005, 0.1, 3), draw.uniform(0.0, 1.0, 2) * draw.choice([0.05, 0.5, 3.0]))
    points = size * np.sin(2.0 * np.pi * waves * s + draw.uniform(0.0, 6.0, 5)) + np.append(
        draw.uniform(-0.1, 0.1, 3), draw.uniform(-1.0, 1.0, 2)
    )
    if draw.random() < 0.5:
        points = np.round(points, int(draw.integers(6, 9)))
    return points


def corners(draw: np.random.Generator, count: int) -> np.ndarray:
    """Return points of a free polyline, in which some blocks move only the tip, or only angles."""
    steps = draw.normal(size=(count, 5)) * np.append(
        np.full(3, 10.0 ** draw.uniform(-5, -1.5)), np.full(2, 10.0 ** draw.uniform(-4, -0.5))
    )
    for row in steps:
        which = draw.random()
        if which < 0.1:
            row[:3] = 0.0
        elif which < 0.25:
            row[3:] = 0.0
        elif which < 0.3:
            row *= 1e-4
    return np.cumsum(steps, axis=0) * 0.7 + np.append(draw.uniform(-0.1, 0.1, 3), draw.uniform(-1.0, 1.0, 2))


def poles(draw: np.random.Generator, count: int) -> np.ndarray:
    """Return points whose tilt passes 0 by 1e-12 to 0.1 rad, or at it, while the joint at the workpiece turns."""
    points = corners(draw, count)
    reach = 10.0 ** draw.uniform(-3.0, 0.0)
    points[:, 3] = np.linspace(-reach * draw.random(), reach, count)
    nearest = np.argmin(np.abs(points[:, 3]))
    points[nearest, 3] = 0.0 if draw.random() < 0.5 else 10.0 ** draw.uniform(-12.0, -1.0)
    points[:, 4] = np.cumsum(draw.normal(size=count) * 10.0 ** draw.uniform(-3.0, 0.3))
    return points


def windings(draw: np.random.Generator, count: int) -> np.ndarray:
    """Return points whose joints have been wound up to 1e6 degrees, and turn up to two turns in a block."""
    points = corners(draw, count)
    points[:, 3:] += np.cumsum(draw.uniform(-1.0, 1.0, (count, 2)) * draw.choice([0.0, 3.0, 12.0], 2), axis=0)
    points[:, 3:] += 2.0 * np.pi * np.round(draw.choice([-1.0, 1.0], 2) * 10.0 ** draw.uniform(-1.0, 3.44, 2))
    return points


def directions(draw: np.random.Generator, kinematics: Kinematics, count: int) -> np.ndarray:
    """Return rotary joints of random directions of the tool, which arcs lead to, rad, shape (count, 2).

    Raises UnreachableError for directions that the machine does not have.
    """
    tilts = np.abs(draw.normal(size=count)) * draw.choice([1e-4, 0.05, 0.5])
    turns = np.cumsum(draw.normal(size=count) * draw.choice([0.05, 0.4]))
    axis = np.array([np.sin(tilts) * np.cos(turns), np.sin(tilts) * np.sin(turns), np.cos(tilts)])
    return choose_rotary(kinematics, axis, in_plane=True).rotary.T


Shape: TypeAlias = Callable[[np.random.Generator, int], np.ndarray]


def short(draw: np.random.Generator) -> Drawn:
    """Draw a program of two to six blocks: all that `drawn` has, poles, windings, splines, dwells, turns in planes."""
    return drawn(draw, 8, (curve, corners, poles, windings), 0.08)


def drawn(
    draw: np.random.Generator, most: int = 60, shapes: Sequence[Shape] = (curve, corners), rare: float = 0.0
) -> Drawn:
    """Draw a program of fewer than `most` points of one of the shapes, with a share of splines and of dwells.

    With such a share an eighth of the programs, too, turn the tool in planes.
    """
    kinematics = machine(draw)
    letters = kinematics.letters
    limits = np.vstack([np.tile(ROW, (3, 1)), np.tile(TURN, (2, 1))])
    if draw.random() < 0.5:
        limits = limits * 10.0 ** draw.uniform(-1.0, 0.5, (5, 1)) * 10.0 ** draw.uniform(-0.5, 0.5, limits.shape)
    tolerance, angle = 10.0 ** draw.uniform(-6, -3.3), math.radians(10.0 ** draw.uniform(-3, 0))
    exact = draw.random() < 0.15
    line = Line("", 0, "")
    moves: list[Move] = [
        PathMode(line, "exact_path" if exact else "continuous", 0.0 if exact else tolerance),
        Feed(line, 10.0 ** draw.uniform(-4, 0), 10.0 ** draw.uniform(-2, 1)),
        ToolPoint(line, kinematics),
    ]
    shape = shapes[int(draw.random() * len(shapes))]
    points = shape(draw, int(draw.integers(3, most)))
    orientation: Orientation = "axes"
    if rare and draw.random() < 0.15:
        with contextlib.suppress(UnreachableError):
            points[:, 3:] = directions(draw, kinematics, len(points))
            orientation = "plane" if draw.random() < 0.5 else "vector"
    place = [3 + "ABC".index(letter) for letter in kinematics.rotary_letters]
    arcs, splines = draw.random() < 0.25, False
    rows = np.zeros((len(points), 9))
    rows[:, :3], rows[:, place] = points[:, :3], points[:, 3:]
    for k, (start, end) in enumerate(pairwise(rows)):
        source = Line("", k + 1, "")
        if np.array_equal(start, end):
            continue
        if arcs and k % 3 == 0 and orientation == "axes":
            end[2] = start[2]
            middle, across = 0.5 * (start[:2] + end[:2]), np.array([start[1] - end[1], end[0] - start[0]])
            center = middle + draw.uniform(-2.0, 2.0) * across
            if np.linalg.norm(across) > 1e-6:
                x, y = center.tolist()
                moves.append(
                    Arc(
                        source, tuple(start.tolist()), tuple(end.tolist()), (0, 1, 2), (x, y), int(draw.choice([-1, 1]))
                    )
                )
                continue
        if rare and draw.random() < rare:
            moves.append(Dwell(source, 10.0 ** draw.uniform(-4.0, -1.0)))
        if rare and draw.random() < rare and orientation == "axes":
            splines = True
            one, two = (start + share * (end - start) for share in (0.4, 0.7))
            one[:3] += 0.2 * draw.normal(size=3) * np.linalg.norm(end[:3] - start[:3])
            control = (tuple(one.tolist()), tuple(two.tolist()))
            moves.append(Spline(source, tuple(start.tolist()), tuple(end.tolist()), control))
            continue
        traverse = bool(draw.random() < 0.03)
        how: Orientation = "axes" if traverse else orientation
        moves.append(Straight(source, tuple(start.tolist()), tuple(end.tolist()), traverse, how))
        if draw.random() < 0.02 and not exact:
            moves.append(PathMode(source, "continuous", tolerance * draw.uniform(0.3, 1.0)))
    points = np.hstack([rows[:, :3], rows[:, place]])
    points = points[-1:] if arcs or splines else points
    return Drawn(moves, points, kinematics, letters, limits, 0.0 if exact else tolerance, angle)


class Outcome(NamedTuple):
    """What is wrong with a plan, empty if nothing is; its duration, s, and number of pieces."""

    wrong: str
    lasts: float
    pieces: int


def look(program: Drawn, sampled: bool = True) -> Outcome:
    """Plan and prove a program; compare its end, and tip and tool at samples with the program."""
    prover, tip, lasts = Prover(program.limits), TipProver(), 0.0
    last: Part | None = None
    sampler, rows = Sampler(1e-3), list[np.ndarray]()
    for part in planned(program.moves, program.letters, program.limits, angle_tolerance=program.angle, tip=tip):
        if isinstance(part, Part):
            prover.prove(part)
            lasts += float(part.motion.duration.sum())
            if sampled and lasts < 100.0:
                rows.append(sampler.sample(part)[:, :, 0])
            last = part
    proof, of_tip = prover.proof(), tip.proof()
    assert of_tip is not None
    assert last is not None
    if proof.count:
        return Outcome(f"{proof.count} faults: {proof.faults[0]}", lasts, of_tip.pieces)
    if of_tip.faults:
        return Outcome(f"{of_tip.faults} faults of the tip", lasts, of_tip.pieces)
    if of_tip.deviation > max(program.tolerance, 6e-9):
        return Outcome(f"deviation {of_tip.deviation} of {program.tolerance}", lasts, of_tip.pieces)
    if program.tolerance and of_tip.angle > (1.0 + 1e-9) * program.angle:
        return Outcome(f"angle {of_tip.angle} of {program.angle}", lasts, of_tip.pieces)
    end = program.points[-1]
    pieces = last.pieces
    q = pieces.origin[-1] + (pieces.shape[-1].sum(axis=1) if pieces.kind[-1] != 1 else np.nan)
    there = np.append(np.array(program.kinematics.linear(end[:3], end[3:])), end[3:])
    # and a rounding of an angle that is wound up
    if not np.max(np.abs(q - there)) < 1e-11 + 1e-15 * np.max(np.abs(end)):
        return Outcome(f"ends {np.max(np.abs(q - there))} off", lasts, of_tip.pieces)
    if sampled and len(program.points) > 1 and rows:
        q = np.concatenate(rows)
        q = q[:: max(1, len(q) // 400)]
        tips = np.array(program.kinematics.tip(q[:, :3].T, q[:, 3:].T)).T
        begin, way = program.points[:-1, :3], np.diff(program.points[:, :3], axis=0)
        square = np.maximum(np.einsum("nk,nk->n", way, way), 1e-300)
        share = np.clip(np.einsum("mnk,nk->mn", tips[:, None] - begin, way) / square, 0.0, 1.0)
        off = np.linalg.norm(tips[:, None] - begin - share[:, :, None] * way, axis=2).min(axis=1)
        if off.max() > of_tip.deviation + 1e-12:
            return Outcome(f"a sample is {off.max()} off the path, {of_tip.deviation} proven", lasts, of_tip.pieces)
    return Outcome("", lasts, of_tip.pieces)


def seeds(seed: int, count: int) -> Iterator[tuple[int, np.random.Generator]]:
    """Yield numbers and generators of programs."""
    for k in range(count):
        yield k, np.random.default_rng([seed, k])
