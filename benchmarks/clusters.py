"""Short lines from segments to proven motions: lines a minute of processor time, and where it goes.

    python benchmarks/clusters.py [--lines 100000]

Segments come in windows of 1,000, as from a program; reading it is not in the figures.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from feeddrive.path.geometry.joints import Joiner
from feeddrive.path.geometry.segments import AT_ONCE, Chain
from feeddrive.path.motion import LINE, Pieces
from feeddrive.path.proof import Prover
from feeddrive.path.schedule.run import Schedule

LIMITS = np.array([[0.5, 5.0, 100.0, 5e4]] * 3)  # m/s .. m/s4
TOLERANCE, FEED = 1e-5, 0.1  # m, m/s


def circle(chord: float, count: int) -> np.ndarray:
    """Chords of circles of 30 mm, round and round."""
    angle = np.arange(count + 1) * chord / 0.03
    return 0.03 * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])


def wandering(chord: float, count: int) -> np.ndarray:
    draw = np.random.default_rng(1)
    angle = np.cumsum(np.cumsum(draw.normal(size=count + 1) * 0.002) * 0.02)
    return np.cumsum(chord * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle]), axis=0)


def chain(corners: np.ndarray, ends: bool) -> Chain:
    moves = np.diff(corners, axis=0)
    n = len(moves)
    shape = np.zeros((n, 3, 8))
    shape[:, :, 1] = moves
    length = np.linalg.norm(moves, axis=1)
    pieces = Pieces(np.full(n, LINE), length, corners[:-1].copy(), shape, np.full(n, FEED), np.arange(n))
    return Chain(pieces, np.full(n, TOLERANCE), ends)


def measured(corners: np.ndarray) -> tuple[float, float, float, float]:
    """Processor time of geometry, schedule and proof, s, and the time of the motion."""
    joiner, schedule, prover = Joiner(), Schedule(LIMITS), Prover(LIMITS)
    times, takes, n = [0.0, 0.0, 0.0], 0.0, len(corners) - 1
    for first in range(0, n, AT_ONCE):
        given = chain(corners[first : first + AT_ONCE + 1], first + AT_ONCE >= n)
        marks = [time.process_time()]
        sections = joiner.join(given)[0]
        marks.append(time.process_time())
        parts = [part for section in sections for part in schedule.add(section)]
        marks.append(time.process_time())
        assert all(map(prover.prove, parts)), prover.proof().faults[0]
        marks.append(time.process_time())
        times = [t + b - a for t, a, b in zip(times, marks[:-1], marks[1:], strict=True)]
        takes += sum(float(np.sum(part.motion.duration)) for part in parts)
    return times[0], times[1], times[2], takes


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lines", type=int, default=100_000)
    count = parser.parse_args().lines
    measured(circle(5e-5, 5000))  # the kernels are compiled
    print(f"{'':22}{'geometry':>10}{'schedule':>10}{'proof':>10}{'us a line':>11}{'lines/min':>11}{'motion/feed':>13}")
    for name, corners in [
        ("circle, 1 um", circle(1e-6, count)),
        ("circle, 50 um", circle(5e-5, count)),
        ("circle, 1 mm", circle(1e-3, count // 10)),
        ("wandering, 0.1 mm", wandering(1e-4, count)),
    ]:
        *times, takes = measured(corners)
        n = len(corners) - 1
        each = [1e6 * t / n for t in times]
        least = float(np.linalg.norm(np.diff(corners, axis=0), axis=1).sum()) / FEED
        row = "".join(f"{t:10.2f}" for t in each)
        print(f"{name:22}{row}{sum(each):11.2f}{60e6 / sum(each):11.2g}{takes / least:13.4f}")


if __name__ == "__main__":
    main()
