"""Five-axis parts planned along the tip of the tool: cycle time, proven deviation, blocks a minute; the same posted.

    python benchmarks/five_axes.py [--rounds 3]
    python benchmarks/five_axes.py --write src/feeddrive/files/bundled/programs

The parts are formulas.  `--write` writes them as part programs with G43.4, as a postprocessor does: four decimals of mm
and degrees; the S curve also with the directions of the tool (G43.5), for machines with other joints.  "Posted" is the
same part as a program of the joints, with a feed in each block that moves the tip at F.

S curve  a wave of 150 mm by 70 mm with the tool tilted by 7 to 27 degrees, whose table follows the tangent.  It has the
         idea of the S-shaped test piece of ISO 10791-7, axes that reverse while the tip runs evenly; it is not that
         piece, which is a ruled surface given by control points.
blade    five passes over a twisted surface, forth and back, tilt 20 to 50 degrees
dome     twelve turns from 70 degrees to 3 degrees of the pole of a hemisphere of 30 mm, the tool normal to it
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np

from feeddrive.files.machine import planned_kinematics, planned_limits, read_machine
from feeddrive.path.kinematics import Kinematics
from feeddrive.path.motion import Part
from feeddrive.path.program.blocks import Line
from feeddrive.path.program.moves import Feed, Move, PathMode, Straight, ToolPoint
from feeddrive.path.proof import Prover
from feeddrive.path.setpoints import Sampler, planned
from feeddrive.path.tip_proof import TipProver

TOLERANCE, ANGLE, FEED = 1e-5, math.radians(0.05), 0.1  # m, rad, m/s


def s_curve(n: int = 2000) -> np.ndarray:
    """Return x, y, z (m), a, c (rad) of the points, shape (n, 5)."""
    s = np.linspace(0.0, 1.0, n)
    wave = 2.0 * np.pi * s
    tangent = np.arctan2(0.035 * 2.0 * np.pi * np.cos(wave), 0.15)
    tilt = np.radians(17.0 + 10.0 * np.sin(wave))
    return np.stack([0.15 * (s - 0.5), 0.035 * np.sin(wave), np.full(n, 0.02), -tilt, -tangent], axis=1)


def blade(n: int = 2500, passes: int = 5) -> np.ndarray:
    """As `s_curve`."""
    u = np.linspace(0.0, passes, n)
    number = np.minimum(np.floor(u), passes - 1)
    f = np.where(number % 2 == 1, 1.0 - (u - number), u - number)
    f = 0.5 * (1.0 - np.cos(np.pi * f))
    wave = 2.0 * np.pi * f
    y = 0.012 * np.sin(wave) + 0.004 * np.sin(3.0 * wave)
    a = np.radians(35.0 + 15.0 * np.sin(wave + 0.3 * u))
    c = np.radians(60.0 * np.sin(wave) + 15.0 * np.cos(2.0 * wave))
    return np.stack([0.08 * (f - 0.5), y, 0.02 + 0.004 * u, -a, -c], axis=1)


def dome(n: int = 3000, pole: float = 3.0, radius: float = 0.03, turns: int = 12) -> np.ndarray:
    """As `s_curve`; `pole` is the distance from the pole at the end, degrees."""
    s = np.linspace(0.0, 1.0, n)
    theta, phi = np.radians(70.0 + (pole - 70.0) * s), 2.0 * np.pi * turns * s
    x, y, z = np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)
    return np.stack([radius * x, radius * y, radius * z, -theta, phi - 0.5 * np.pi], axis=1)


PARTS: dict[str, tuple[str, Callable[[], np.ndarray]]] = {
    "s_curve": (
        "S curve: the table follows the tangent, tilt 7 to 27 degrees; the idea of the S-shaped test piece of ISO "
        "10791-7, not that piece",
        s_curve,
    ),
    "blade": ("blade: five passes forth and back over a twisted surface, tilt 20 to 50 degrees", blade),
    "dome": ("dome: twelve turns from 70 to 3 degrees of the pole, tool normal to the surface", dome),
}


def program(text: str, points: np.ndarray) -> str:
    """Return a part program that moves the tip through points."""
    rows = np.round(points * [1e3, 1e3, 1e3, *[math.degrees(1.0)] * 2], 4) + 0.0
    x, y, z, a, c = rows[0].tolist()
    lines = [
        f"({text})",
        "G21 G90 G94 G17",
        f"G64 P{1e3 * TOLERANCE:g}",
        f"G0 A{a:g} C{c:g}",
        "G43.4 H0 (from here on X Y Z are the tip of the tool on the workpiece)",
        f"G0 X{x:g} Y{y:g} Z{z:g}",
        f"G1 F{6e4 * FEED:g}",
    ]
    last = rows[0]
    for row in rows[1:]:
        words = [f"{letter}{value:.4f}" for letter, value, old in zip("XYZAC", row, last, strict=True) if value != old]
        lines.append(" ".join(words))
        last = row
    return "\n".join([*lines, "G49", "M2", ""])


def vector_program(text: str, points: np.ndarray, kinematics: Kinematics) -> str:
    """Return a part program that moves the tip through points, with the directions that the tool has there as I J K."""
    axes = np.stack(kinematics.tool_axis(points[:, 3:].T), axis=1)
    rows = np.hstack([np.round(1e3 * points[:, :3], 4), np.round(axes, 6)]) + 0.0
    blocks = [
        " ".join(f"{letter}{value:.9g}" for letter, value in zip("XYZIJK", row, strict=True)) for row in rows.tolist()
    ]
    lines = [
        f"({text})",
        "G21 G90 G94 G17",
        f"G64 P{1e3 * TOLERANCE:g}",
        "G43.5 H0 (X Y Z are the tip of the tool on the workpiece, I J K its direction)",
        f"G0 {blocks[0]}",
        f"G1 F{6e4 * FEED:g}",
    ]
    return "\n".join([*lines, *blocks[1:], "G49", "M2", ""])


def moves(points: np.ndarray, kinematics: Kinematics, posted: bool = False) -> Iterator[Move]:
    """Yield a part as moves of the tip, or of the joints if `posted`."""
    line = Line("part", 1, "")
    yield PathMode(line, "continuous", TOLERANCE)
    feeds = np.full(len(points), FEED)
    if posted:
        joints = np.stack(kinematics.linear(points[:, :3].T, points[:, 3:].T), axis=1)
        ways = [np.linalg.norm(np.diff(table[:, :3], axis=0), axis=1) for table in (joints, points)]
        feeds[:-1] *= ways[0] / ways[1]
        points = np.hstack([joints, points[:, 3:]])
    else:
        yield ToolPoint(line, kinematics)
    rows = [(x, y, z, a, 0.0, c, 0.0, 0.0, 0.0) for x, y, z, a, c in points.tolist()]
    for k, (start, end) in enumerate(pairwise(rows)):
        if posted or k == 0:
            yield Feed(line, float(feeds[k]), 0.0)
        yield Straight(Line("part", k + 1, ""), start, end, False)


def off(joints: np.ndarray, points: np.ndarray, kinematics: Kinematics) -> float:
    """Return the largest distance of the tip at samples of the joints from the polyline of the part, m."""
    tips = np.stack(kinematics.tip(joints[:, :3].T, joints[:, 3:].T), axis=1)
    begin, way = points[:-1, :3], np.diff(points[:, :3], axis=0)
    square, most = np.einsum("nk,nk->n", way, way), 0.0
    for rows in np.array_split(tips, max(1, len(tips) // 500)):
        share = np.clip(np.einsum("mnk,nk->mn", rows[:, None] - begin, way) / square, 0.0, 1.0)
        apart = np.linalg.norm(rows[:, None] - begin - share[:, :, None] * way, axis=2)
        most = max(most, float(apart.min(axis=1).max()))
    return most


def row(name: str, points: np.ndarray, posted: bool = False) -> None:
    """Print a row of the table of docs/explanation/five_axes.md."""
    machine = read_machine("trunnion_ac")
    limits = planned_limits(machine, None)
    kinematics = planned_kinematics(machine, limits)
    assert kinematics is not None
    given = list(moves(points, kinematics, posted))
    begun = time.process_time()
    tip, prover, lasts, stops = TipProver(tuple(limits.travel.values())), Prover(limits.array), 0.0, -1
    parts = list[Part]()
    sampler, rows = Sampler(1e-3), list[np.ndarray]()
    for part in planned(given, limits.letters, limits.array, angle_tolerance=ANGLE, tip=tip):
        if isinstance(part, Part):
            prover.prove(part)
            lasts += float(part.motion.duration.sum())
            stops += part.ends
            parts.append(part)
    spent = time.process_time() - begun
    for part in parts if posted else ():
        rows.append(sampler.sample(part)[:, :, 0])
    proof, of_tip, count = prover.proof(), tip.proof(), len(points) - 1
    if of_tip is None:
        told = f"{1e6 * off(np.concatenate(rows), points, kinematics):.2f} µm sampled | -"
    else:
        told = f"{1e6 * of_tip.deviation:.2f} µm | {math.degrees(of_tip.angle):.4f}°"
    faults = proof.count + (0 if of_tip is None else of_tip.faults)
    print(f"| {name} | {count:,} | {lasts:.3f} s | {stops} | {faults} | {told} | {60 * count / spent:.1e} |")


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--rounds", type=int, default=2, help="the first one compiles")
    options.add_argument("--write", type=Path, help="write the part programs into this folder")
    given = options.parse_args()
    if given.write:
        for name, (text, points) in PARTS.items():
            (given.write / f"{name}.ngc").write_text(program(text, points()), encoding="utf-8")
        kinematics = read_machine("trunnion_ac").kinematics
        assert kinematics is not None
        text = "S curve as s_curve.ngc, with the direction of the tool in place of angles: for any five axes"
        (given.write / "s_curve_vectors.ngc").write_text(vector_program(text, s_curve(), kinematics), encoding="utf-8")
        return
    for _ in range(given.rounds):
        print("| part | blocks | cycle time | stops | violations | tip within | tool within | blocks a minute |")
        print("|---|--:|--:|--:|--:|--:|--:|--:|")
        for name, (_, points) in PARTS.items():
            row(name, points())
            row(f"{name}, posted", points(), posted=True)
        for pole in (0.3, 0.03):
            row(f"dome to {pole}° of the pole", dome(pole=pole))
        row("dome", dome(12000))


if __name__ == "__main__":
    main()
