"""Kernels against C by hand, and the first call of their file, without and with the machine code on disk.

    python benchmarks/kernels.py [--rounds 30] [--processes 9]

The plan of a path of 300 pieces with its setpoints at 1 kHz; both sides give the same bits, which is checked.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

PIECES, SAMPLES = 300, 4000
LIMITS = 5.0, 100.0, 5e4  # m/s², m/s³, m/s⁴


def child() -> None:
    """One fresh process: CPU time (ms) of imports, of printing LLVM text and of machine code."""
    begun = time.process_time()
    import llvmlite.binding  # noqa: F401
    import numpy  # noqa: F401

    libraries = time.process_time()
    import kernel_plan

    given = arguments(1)
    marks = {"llvmlite and numpy": libraries - begun, "imports of feeddrive": time.process_time() - libraries}
    begun = time.process_time()
    kernel_plan.plan_and_sample(*given)
    marks["first call"] = time.process_time() - begun
    text = kernel_plan.plan_and_sample.unit.text()
    print(json.dumps({**{name: 1e3 * span for name, span in marks.items()}, "lines of LLVM text": text.count("\n")}))


def arguments(seed: int) -> list[Any]:
    """A path and the room for its plan."""
    import numpy as np

    draw = np.random.default_rng(seed)
    ends = np.concatenate([[0.0], np.cumsum(10.0 ** draw.uniform(-4.0, -2.0, PIECES))])
    caps = 10.0 ** draw.uniform(-1.5, -0.5, PIECES)
    stack, speeds = np.zeros(9 * PIECES, dtype=np.int64), np.zeros((3 * PIECES, 2))
    times, pieces = np.zeros(30 * PIECES), np.zeros((30 * PIECES, 5))
    return [ends, caps, *LIMITS, stack, speeds, times, pieces, np.arange(SAMPLES) * 1e-3, np.zeros((SAMPLES, 5))]


def by_hand(library: Any, given: list[Any]) -> int:
    """The same plan in C."""
    ends, caps, a, j, s, stack, speeds, times, pieces, at, values = given
    address = [ctypes.c_void_p(each.ctypes.data) for each in (ends, caps, stack, speeds, times, pieces, at, values)]
    numbers = [ctypes.c_double(each) for each in (a, j, s)]
    size, samples = ctypes.c_int64(len(caps)), ctypes.c_int64(len(at))
    widths = [ctypes.c_int64(each.shape[1]) for each in (pieces, values)]
    return library.plan_and_sample(*address[:2], size, *numbers, *address[2:7], samples, address[7], *widths)


def run_times(rounds: int) -> None:
    """Ratios to C of every compiler that is here."""
    import compiler
    import kernel_plan
    import numpy as np
    from rounds import machine, measure, ratio, table

    from feeddrive.language.kernels.kernel import THOROUGH, interpreted

    kernel_plan.plan_and_sample.unit.make(THOROUGH)
    paths = [arguments(seed) for seed in range(3)]
    candidates: dict[str, Any] = {"kernels": lambda: [kernel_plan.plan_and_sample(*each) for each in paths]}
    source = Path(__file__).with_name("kernel_plan.c").read_text(encoding="utf-8")
    for name, command in compiler.compilers().items():
        for level in ("-O2", "-O3"):
            library = compiler.library(source, command, [level, "-march=native", "-ffp-contract=off"])
            library.plan_and_sample.restype = ctypes.c_int64
            candidates[f"{name} {level}"] = lambda library=library: [by_hand(library, each) for each in paths]
            for seed, each in enumerate(paths):
                count, _, _ = kernel_plan.plan_and_sample(*each)
                other = arguments(seed)
                assert by_hand(library, other) == count
                assert np.array_equal(each[-1], other[-1]), "C and kernels differ"
                assert np.array_equal(each[-3][:count], other[-3][:count])
    taken = measure(candidates, rounds)
    with interpreted():
        begun = time.thread_time()
        kernel_plan.plan_and_sample(*arguments(0))
        plain = time.thread_time() - begun
    print(f"{machine()}\n")
    rows = [
        [name, f"{1e3 * statistics.median(taken[name]) / len(paths):.3f}", f"{ratio(taken, 'kernels', name):.2f}"]
        for name in candidates
    ]
    table(["way", "ms a path", "kernels / this"], rows)
    print(f"plain Python: {1e3 * plain:.0f} ms a path\n")


def first_calls(processes: int) -> None:
    """Medians over fresh processes."""
    from rounds import table

    found: dict[str, list[dict[str, float]]] = {"cold": [], "from disk": []}
    for _ in range(processes):
        with tempfile.TemporaryDirectory() as cache:
            for name in found:
                done = subprocess.run(
                    [sys.executable, __file__, "--child"],
                    capture_output=True,
                    text=True,
                    check=True,
                    env={**os.environ, "FEEDDRIVE_CACHE": cache},
                )
                found[name].append(json.loads(done.stdout))
    parts = list(found["cold"][0])
    rows = [
        [part, *[f"{statistics.median(each[part] for each in found[name]):.0f}" for name in found]] for part in parts
    ]
    table(["ms of CPU", *found], rows)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=30)
    parser.add_argument("--processes", type=int, default=9)
    parser.add_argument("--child", action="store_true")
    chosen = parser.parse_args()
    if chosen.child:
        child()
    else:
        first_calls(chosen.processes)
        run_times(chosen.rounds)
