"""Random part programs of six kinds, planned and proven; each that does not hold is a line.

    python benchmarks/random_programs.py [--first 0] [--count 100000] [--seed 13] [--tip [--short]]

`--tip` takes five-axis programs of the tip of a tool (`tests/path/tip_paths.py`) in place of those of axes, `--short`
those of a few blocks.
Program k of a seed is always the same one: two processes share the work by `--first`.
"""

from __future__ import annotations

import argparse
import sys
from functools import partial
from importlib import import_module
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "path"))

check_random = import_module("paths").check_random


def check_tip(program: int, seed: int, short: bool = False) -> tuple[int, int]:
    """Check a program of the tip; return the numbers of its moves and of its pieces."""
    tip_paths = import_module("tip_paths")
    drawn = (tip_paths.short if short else tip_paths.drawn)(np.random.default_rng([seed, program]))
    outcome = tip_paths.look(drawn)
    if outcome.wrong:
        raise RuntimeError(outcome.wrong)
    return len(drawn.moves), outcome.pieces


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=13)
    parser.add_argument("--tip", action="store_true")
    parser.add_argument("--short", action="store_true")
    asked = parser.parse_args()
    check = partial(check_tip, short=asked.short) if asked.tip else check_random
    failed = moves = spans = 0
    for done in range(1, asked.count + 1):
        program = asked.first + done - 1
        try:
            made, looked = check(program, asked.seed)
            moves, spans = moves + made, spans + looked
        except Exception as error:  # whatever it is, it counts
            failed += 1
            print(f"program {program}: {type(error).__name__}: {error}", flush=True)
        if done % 1000 == 0 or done == asked.count:
            print(f"{done} programs, {moves} moves, {spans} spans of time, {failed} failed", flush=True)
