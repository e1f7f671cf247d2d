"""Random part programs of seven kinds under random overrides: each case in which a sample does not hold is a line.

    python benchmarks/random_overrides.py [--first 0] [--count 10000] [--seed 24] [--moves 12]

Ten thousand cases take 55 minutes of processor time.  Case k of a seed is always the same one.
"""

from __future__ import annotations

import argparse
import sys
from importlib import import_module
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "path"))

cases = import_module("override_cases")

if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=24)
    parser.add_argument("--moves", type=int, default=12, help="largest number of moves of a program")
    asked = parser.parse_args()
    failed = samples = 0
    for done in range(1, asked.count + 1):
        number = asked.first + done - 1
        try:
            samples += cases.check_case(cases.drawn_case(number, asked.seed, asked.moves))
        except Exception as error:  # whatever it is, it counts
            failed += 1
            print(f"case {number}: {type(error).__name__}: {error}", flush=True)
        if done % 100 == 0 or done == asked.count:
            print(f"{done} cases, {samples} samples, {failed} failed", flush=True)
