"""Random part programs of six kinds, planned and proven; each that does not hold is a line.

    python benchmarks/random_programs.py [--first 0] [--count 100000] [--seed 13]

Program k of a seed is always the same one: two processes share the work by `--first`.
"""

from __future__ import annotations

import argparse
import sys
from importlib import import_module
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "path"))

check_random = import_module("paths").check_random

if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=13)
    asked = parser.parse_args()
    failed = moves = spans = 0
    for done in range(1, asked.count + 1):
        program = asked.first + done - 1
        try:
            made, looked = check_random(program, asked.seed)
            moves, spans = moves + made, spans + looked
        except Exception as error:  # whatever it is, it counts
            failed += 1
            print(f"program {program}: {type(error).__name__}: {error}", flush=True)
        if done % 1000 == 0 or done == asked.count:
            print(f"{done} programs, {moves} moves, {spans} spans of time, {failed} failed", flush=True)
