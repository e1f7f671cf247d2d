"""Looser limits: times of public programs, zigzags and drawn ones as limits are scaled up or left out.

    python benchmarks/looser.py [--lines 600] [--drawn 300] [--seed 1] [--more]

Each program is planned and proven with velocity 0.5 m/s, acceleration 5 m/s², jerk 100 m/s³ and snap 5e4 m/s⁴ on every
axis, then with one or several of them scaled by 10 to 1000, without a limit of the snap, and without those of jerk and
snap.  For each the table has the time, the largest rise of the time by any loosening, in %, and the largest ratio of
the processor times.  `--more` prints the time of each set of limits.  Of a long program the first lines are taken.
Refused programs are left out; one of less than 20 ms of planning has no ratio of processor times.
"""

from __future__ import annotations

import argparse
import random
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from pathlib import Path

import numpy as np

sys.path += [
    str(Path(__file__).parent),
    str(Path(__file__).parents[1] / "tests" / "path"),
    str(Path(__file__).parents[1] / "tests"),
]

import planner
from test_looser_limits import PROGRAMS, drawn_limits, loosened
from test_plan_drawn import LIMITS as MILL
from test_plan_drawn import program

from feeddrive.language.errors import FeeddriveError
from feeddrive.path.motion import Part
from feeddrive.path.program.moves import Move
from feeddrive.path.program.reading import read_program
from feeddrive.path.proof import Prover
from feeddrive.path.setpoints import planned

USUAL = np.array([0.5, 5.0, 100.0, 5e4])
NONE = np.inf
SETS = {
    "snap x 10": (1, 1, 1, 10),
    "snap x 1000": (1, 1, 1, 1000),
    "no snap": (1, 1, 1, NONE),
    "jerk x 10": (1, 1, 10, 1),
    "jerk x 10, snap x 20": (1, 1, 10, 20),
    "jerk x 100, snap x 2000": (1, 1, 100, 2000),
    "jerk x 1000, snap x 2e5": (1, 1, 1000, 2e5),
    "jerk x 1000, no snap": (1, 1, 1000, NONE),
    "no jerk, no snap": (1, 1, NONE, NONE),
    "acceleration x 10": (1, 10, 1, 1),
    "velocity x 10": (10, 1, 1, 1),
    "all x 10": (10, 10, 10, 10),
    "all x 1000": (1000, 1000, 1000, 1000),
}
LONG = 0.02  # s of planning, below which a ratio of processor times is noise


def timed(moves: Sequence[Move], limits: np.ndarray) -> tuple[float, float]:
    """The time of a proven motion, and the processor time of planning it, s."""
    begun = time.process_time()
    parts = [part for part in planned(moves, "XYZ", limits) if isinstance(part, Part)]
    took = time.process_time() - begun
    prover = Prover(limits)
    for part in parts:
        if not prover.prove(part):
            raise SystemExit(f"not proven with limits {limits.tolist()}: {prover.proof().faults[0]}")
    return sum(float(part.motion.duration.sum()) for part in parts), took


def known(lines: int) -> Iterator[tuple[str, Sequence[Move]]]:
    """The public programs that are read, and those of `planner`."""
    for path in sorted([*PROGRAMS.rglob("*.ngc"), *PROGRAMS.rglob("*.gcode")]):
        try:
            yield path.stem, list(islice(read_program(path, front_end="own"), lines))
        except FeeddriveError:
            continue
    for step, tolerance in ((1e-3, 1e-5), (1e-3, 1e-6), (5e-3, 1e-5)):
        name = f"zigzag {1e3 * step:g} mm, {1e6 * tolerance:g} um"
        yield name, list(planner.moves(planner.zigzag(step, lines // 2), tolerance, 0.1))
    yield "chords of 1 mm", list(planner.moves(planner.curve(1e-3, lines), 1e-5, 0.1))
    yield "arcs with lines", list(planner.mixed(lines, 1e-5, 0.05))


def table(lines: int, more: Callable[[str], None]) -> None:
    print("| program | usual, s | no snap | no jerk, no snap | largest rise, % | with | largest CPU ratio |")
    print("|---|--:|--:|--:|--:|---|--:|")
    for name, moves in known(lines):
        try:
            timed(moves, np.tile(USUAL, (3, 1)))  # compiled before it is timed
            usual, begun = timed(moves, np.tile(USUAL, (3, 1)))
            rows = {key: timed(moves, np.tile(USUAL * factors, (3, 1))) for key, factors in SETS.items()}
        except FeeddriveError:
            continue
        if usual == 0.0:
            continue
        rises = {key: 100.0 * (found / usual - 1.0) for key, (found, _) in rows.items()}
        worst = max(rises, key=lambda key: rises[key])
        ratio = f"{max(took for _, took in rows.values()) / begun:.1f}" if begun > LONG else ""
        none, neither = (rows[key][0] for key in ("no snap", "no jerk, no snap"))
        times = f"{usual:.3f} | {none:.3f} | {neither:.3f}"
        print(f"| {name} | {times} | {rises[worst]:.2f} | {worst} | {ratio} |", flush=True)
        more(f"{name}: " + ", ".join(f"{key} {found:.4f} s in {took:.3f}" for key, (found, took) in rows.items()))


def drawn(count: int, seed: int) -> None:
    """Drawn programs with five sets of looser limits each."""
    rises, slow, usual_took, looser_took = list[float](), 0, 0.0, 0.0
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "drawn.ngc"
        for k in range(count):
            draw = random.Random(f"{seed} {k}")
            path.write_text(program(draw), encoding="utf-8")
            limits = drawn_limits(draw)
            try:
                moves = list(read_program(path, axes=MILL.travel, front_end="own"))
                usual, begun = timed(moves, limits)
            except FeeddriveError:
                continue
            for _ in range(5 if usual else 0):
                found, took = timed(moves, loosened(draw, limits))
                rises.append(found / usual - 1.0)
                slow += begun > LONG and took > 2.0 * begun
                usual_took, looser_took = usual_took + begun, looser_took + took
    above = [int(np.sum(np.array(rises) > share)) for share in (1e-4, 1e-3, 5e-3)]
    print(
        f"{len(rises)} loosenings of drawn programs, seed {seed}: {above[0]} rise by more than 0.01 %, {above[1]} by "
        f"more than 0.1 %, {above[2]} by more than 0.5 %, the largest by {100.0 * max(rises):.2f} %; {looser_took:.1f} "
        f"s of processor time with looser limits, {usual_took:.1f} s before, {slow} more than twice"
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--lines", type=int, default=600)
    parser.add_argument("--drawn", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--more", action="store_true")
    asked = parser.parse_args()
    table(asked.lines, print if asked.more else lambda _: None)
    drawn(asked.drawn, asked.seed)
