"""Run all drawn tests on new seeds: `make fresh`, or `python tests/fresh.py --seeds 3` for some of another number.

CI draws the same examples every time, so that a landing does not hang on the dice.  A newcomer draws others, and would
meet what they find first.  Each seed is printed before its run; `--seed N` repeats it.
"""

from __future__ import annotations

import argparse
import os
import random
import secrets
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
NONE = 5  # exit code of pytest where no test was chosen
LIMIT = 1800  # s of one run, which only a hang exceeds


def files() -> list[str]:
    """Return the test files that draw examples: others need not be imported."""
    drawing = ("hypothesis", "feeddrive.testing")
    found = sorted((ROOT / "tests").rglob("test_*.py"))
    return [str(each.relative_to(ROOT)) for each in found if any(word in each.read_text("utf-8") for word in drawing)]


def run(seed: int, share: list[str], workers: int) -> int:
    """Run the drawn tests of these files on a seed, without the examples of earlier runs; return the exit code."""
    environment = {name: value for name, value in os.environ.items() if name not in ("CI", "MAKEFLAGS")}
    with tempfile.TemporaryDirectory() as empty:
        environment["HYPOTHESIS_STORAGE_DIRECTORY"] = empty
        words = ["-m", "hypothesis and not slow", f"--hypothesis-seed={seed}", "-q", "-n", str(workers)]
        command = [sys.executable, "-m", "pytest", "--dist", "worksteal", *words, *share]
        return subprocess.run(command, cwd=ROOT, env=environment, timeout=LIMIT, check=False).returncode


def say(line: str) -> None:
    """Print a line at once, before the run that follows."""
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def main() -> int:
    """Run the seeds; the exit code is 1 if a drawn test failed on one of them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=2, help="how many new seeds (2: some 5 minutes on two cores)")
    parser.add_argument("--seed", type=int, help="repeat this one")
    parser.add_argument("--share", type=int, help="run so many of the files only, drawn by the seed, as .ci/run does")
    parser.add_argument("--workers", type=int, default=2)
    chosen = parser.parse_args()
    seeds = [secrets.randbelow(2**32) for _ in range(chosen.seeds)] if chosen.seed is None else [chosen.seed]
    failed = list[int]()
    for seed in seeds:
        every = files()
        share = every if chosen.share is None else random.Random(seed).sample(every, min(chosen.share, len(every)))
        say(f"== seed {seed}: {len(share)} of {len(every)} files with drawn tests")
        if run(seed, share, chosen.workers) not in (0, NONE):
            failed.append(seed)
    for seed in failed:
        say(f"FAILED ON SEED {seed}; again: python tests/fresh.py --seed {seed}")
        say("make what failed an @example, and mend it at its root")
    say(f"{len(seeds) - len(failed)} of {len(seeds)} seeds passed: {', '.join(map(str, seeds))}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
