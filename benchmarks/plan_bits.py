"""A digest of plans: two versions of the planner that print the same one give the same plans, to the last bit.

    python benchmarks/plan_bits.py [--programs 300] [--seed 1]

Plans random programs (those of `tests/path/test_plan_drawn.py`), the bundled ones, chords, zigzags and arcs; every
fourth program is planned with a feed override that changes while it runs.  Programs that are refused count with their
message.
"""

from __future__ import annotations

import argparse
import hashlib
import random
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np

sys.path += [
    str(Path(__file__).parent),
    str(Path(__file__).parents[1] / "tests" / "path"),
    str(Path(__file__).parents[1] / "tests"),
]

import planner
from test_plan_drawn import LIMITS, program

import feeddrive
from feeddrive.language.errors import ProgramError
from feeddrive.path.motion import Pause
from feeddrive.path.program.reading import read_program
from feeddrive.path.schedule.override import Override, override
from feeddrive.path.setpoints import planned

BUNDLED = Path(feeddrive.__file__).parent / "files" / "bundled" / "programs"


def digest(moves, limits: np.ndarray, factor: Override | None, total) -> str:
    """Add a program's plan to `total`; how it ended."""
    try:
        for part in planned(moves, "XYZ", limits, factor):
            if isinstance(part, Pause):
                total.update(f"{part.duration!r} {part.why}".encode())
                continue
            for values in part.motion:
                total.update(np.ascontiguousarray(values).tobytes())
            total.update(bytes([part.ends]))
    except ProgramError as error:
        total.update(str(error).partition(": ")[2].encode())
        return "refused"
    return "planned"


def changing(draw: random.Random) -> Override:
    """A feed override that changes up to four times, also to a feed hold that ends."""
    times = sorted(draw.uniform(0.0, 3.0) for _ in range(draw.randint(1, 4)))
    return override([(at, draw.choice([0.0, 0.2, 0.7, 1.0, 1.5])) for at in times] + [(4.0, 1.0)])


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--programs", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    total, ends, begun = hashlib.sha256(), Counter(), time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        for k in range(asked.programs):
            draw = random.Random(f"{asked.seed} {k}")
            path = Path(folder) / "drawn.ngc"
            path.write_text(program(draw), encoding="utf-8")
            factor = changing(draw) if k % 4 == 3 else None
            ends[digest(read_program(path, axes=LIMITS.travel, front_end="own"), LIMITS.array, factor, total)] += 1
    for path in sorted(BUNDLED.glob("*.ngc")):
        ends[digest(read_program(path, axes=LIMITS.travel, front_end="own"), LIMITS.array, None, total)] += 1
    for points, tolerance in (
        (planner.curve(1e-3, 3000), 1e-5),
        (planner.curve(5e-5, 5000), 1e-5),
        (planner.zigzag(1e-3, 2000), 1e-6),
    ):
        ends[digest(planner.moves(points, tolerance, 0.1), planner.LIMITS, None, total)] += 1
    ends[digest(planner.mixed(3000, 1e-5, 0.05), planner.LIMITS, None, total)] += 1
    print(f"{feeddrive.__file__}: {dict(ends)}, {time.process_time() - begun:.1f} s\n{total.hexdigest()}")
