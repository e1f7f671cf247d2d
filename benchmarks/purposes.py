"""What --for sets, on a part program: cycle time, and the size of acceleration, jerk and snap over time.

    python benchmarks/purposes.py PROGRAM [--moves 900]

Tolerances of the program are replaced by those of the purposes; limits of each axis: 500 mm/s, 5 m/s2, 100 m/s3,
5e4 m/s4.  The last row has more acceleration and jerk than precision.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from feeddrive.path.motion import Part
from feeddrive.path.program.moves import Move, PathMode
from feeddrive.path.program.reading import read_program
from feeddrive.path.purpose import PURPOSES, Dynamics
from feeddrive.path.setpoints import Sampler, planned

LIMITS = np.array([[0.5, 5.0, 100.0, 5e4]] * 3)  # m/s .. m/s⁴


def moves(program: Path, most: int, tolerance: float) -> Iterator[Move]:
    """The first moves of a program within a tolerance, m."""
    for move in itertools.islice(read_program(program), most):
        yield PathMode(move.source, "continuous", tolerance) if isinstance(move, PathMode) else move


def measured(program: Path, most: int, tolerance: float, dynamics: Dynamics) -> tuple[float, np.ndarray]:
    """Cycle time, s, and the root mean square of acceleration, jerk and snap of all axes, m/s² .. m/s⁴."""
    limits = LIMITS * np.array([1.0, *dynamics])
    sampler, samples, time = Sampler(1e-3), list[np.ndarray](), 0.0
    for part in planned(moves(program, most, tolerance), "XYZ", limits):
        if isinstance(part, Part):
            samples.append(sampler.sample(part))
            time += float(part.motion.duration.sum())
    values = np.concatenate(samples)[:, :, 2:]
    return time, np.sqrt(np.mean(np.sum(values**2, axis=1), axis=0))


def main() -> None:
    """Plan the program for each purpose."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program", type=Path)
    parser.add_argument("--moves", type=int, default=900)
    given = parser.parse_args()
    rows = [(name, purpose.tolerance, purpose.dynamics) for name, purpose in PURPOSES.items()]
    rows.append(("5 um, jerk 50 %, acceleration 70 %", 5e-6, Dynamics(0.7, 0.5, 0.5)))
    for name, tolerance, dynamics in rows:
        time, size = measured(given.program, given.moves, tolerance, dynamics)
        print(f"{name:45} {time:8.3f} s   {size[0]:.3f} m/s2  {size[1]:.2f} m/s3  {size[2]:.0f} m/s4")


if __name__ == "__main__":
    main()
