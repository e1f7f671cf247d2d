"""Timing on a machine that others use too: all candidates alternate, in random order, in every round.

Ratios are medians of the ratios within a round, so that a slow moment of the machine hits both sides.
"""

from __future__ import annotations

import os
import platform
import random
import statistics
import time
from collections.abc import Callable, Mapping


def measure(
    candidates: Mapping[str, Callable[[], object]], rounds: int, clock: Callable[[], int] = time.thread_time_ns
) -> dict[str, list[float]]:
    """Seconds of every candidate in every round, by the CPU time of this thread unless another clock is given."""
    for call in candidates.values():
        call()
    order = list(candidates)
    taken: dict[str, list[float]] = {name: [] for name in order}
    for _ in range(rounds):
        random.shuffle(order)
        for name in order:
            begun = clock()
            candidates[name]()
            taken[name].append((clock() - begun) * 1e-9)
    return taken


def measure_both(
    candidates: Mapping[str, Callable[[], object]], rounds: int
) -> tuple[dict[str, list[float]], dict[str, list[float]]]:
    """Seconds by the wall clock, and CPU time of all threads: the second says more where others use the cores, too."""
    for call in candidates.values():
        call()
    order = list(candidates)
    wall: dict[str, list[float]] = {name: [] for name in order}
    cpu: dict[str, list[float]] = {name: [] for name in order}
    for _ in range(rounds):
        random.shuffle(order)
        for name in order:
            begun = time.perf_counter(), time.process_time()
            candidates[name]()
            wall[name].append(time.perf_counter() - begun[0])
            cpu[name].append(time.process_time() - begun[1])
    return wall, cpu


def ratio(taken: Mapping[str, list[float]], name: str, base: str) -> float:
    """Median of the ratios of two candidates within their rounds."""
    return statistics.median(a / b for a, b in zip(taken[name], taken[base], strict=True))


def table(heads: list[str], rows: list[list[str]]) -> None:
    """A table in Markdown."""
    print("| " + " | ".join(heads) + " |")
    print("|---" + "|--:" * (len(heads) - 1) + "|")
    for row in rows:
        print("| " + " | ".join(row) + " |")
    print()


def machine() -> str:
    """Processor and system, without names of hosts or paths."""
    import llvmlite
    import numpy

    name = platform.processor() or platform.machine()
    try:
        with open("/proc/cpuinfo") as file:
            name = next(line.split(":", 1)[1].strip() for line in file if line.startswith("model name"))
    except (OSError, StopIteration):
        pass
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return (
        f"{name}, {cores} cores, {platform.system()}; Python {platform.python_version()}, numpy {numpy.__version__}, "
        f"llvmlite {llvmlite.__version__}"
    )
