"""Drawn tests on new seeds: those of hypothesis, and those whose random numbers come from the fixture `seeded`.

    python tests/fresh_draws.py                  # two new seeds: make fresh
    python tests/fresh_draws.py --count 20
    python tests/fresh_draws.py 812 4711         # these seeds again
    python tests/fresh_draws.py --count 1 --share 0.1

It prints the seeds, and behind each failure the command that repeats it.
"""

from __future__ import annotations

import argparse
import hashlib
import subprocess
import sys
from collections.abc import Callable
from random import SystemRandom
from typing import Any, TypeAlias

import pytest

FIXTURE = "seeded"
Seeded: TypeAlias = Callable[[Any], Any]  # the seed of a test by its own number or text: see the fixture


def is_drawn(item: pytest.Item) -> bool:
    """Return whether a test draws its cases: by hypothesis, or by the seeds of the fixture."""
    by_hypothesis = getattr(getattr(item, "obj", None), "is_hypothesis_test", False)
    return bool(by_hypothesis) or FIXTURE in getattr(item, "fixturenames", ())


def in_share(name: str, seed: int, share: float) -> bool:
    """Return whether a test is among the share of all that a seed selects."""
    return int.from_bytes(hashlib.sha256(f"{seed} {name}".encode()).digest()[:8], "big") < share * 2.0**64


def mixed(seed: int | None) -> Seeded:
    """Return what makes the seed of a test from its own number: that number, or one that follows from both."""

    def seeded(number: Any) -> Any:
        if seed is None:
            return number
        return int.from_bytes(hashlib.sha256(f"{seed} {number}".encode()).digest()[:4], "big")

    return seeded


def command(seed: int, name: str = "") -> str:
    """Return the command that repeats the draws of a seed, of one test or of all."""
    return f"python -m pytest --fresh-seed {seed}" + (f" '{name}'" if name else " -n 2 -m 'not slow'")


def main() -> int:
    """Run the drawn tests on some seeds, all of them whatever fails; the exit status is that of the worst."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("seeds", type=int, nargs="*", help="seeds; new ones if left out")
    parser.add_argument("--count", type=int, default=2, help="how many new seeds")
    parser.add_argument("--share", type=float, default=1.0, help="share of the drawn tests, selected by the seed")
    asked = parser.parse_args()
    seeds = asked.seeds or [SystemRandom().randrange(1, 1_000_000) for _ in range(asked.count)]
    print(f"fresh seeds: {' '.join(map(str, seeds))}", flush=True)
    failed = list[int]()
    for seed in seeds:
        words = ["-m", "pytest", "-q", "-n", "2", "--dist", "worksteal", "-m", "not slow", "--fresh-seed", str(seed)]
        share = ["--fresh-share", str(asked.share)] if asked.share < 1.0 else []
        if subprocess.run([sys.executable, *words, *share], check=False).returncode:
            failed.append(seed)
    print(f"fresh seeds: {len(seeds) - len(failed)} of {len(seeds)} passed")
    for seed in failed:
        print(f"FAILED on seed {seed}: {command(seed)}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
