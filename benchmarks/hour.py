"""One hour at 20 kHz, 72 million samples, in constant memory.

    python benchmarks/hour.py [--hours 1]

The axis sways by 10 mm all the time.  Six signals of every sample are handed out in chunks and looked at; then the same
hour is run for the statistics alone.
"""

from __future__ import annotations

import argparse
import resource
import time

import numpy as np
import rounds
import workload

from feeddrive.blocks.reference.sine import Sine
from feeddrive.loop.simulate import simulate_batch, stream


def resident() -> float:
    """Memory of this process in MB, now."""
    try:
        with open("/proc/self/statm") as file:
            return int(file.read().split()[1]) * resource.getpagesize() / 1e6
    except OSError:
        return float("nan")


def clocks() -> tuple[float, float]:
    """Wall clock and CPU time, s."""
    return time.perf_counter(), time.process_time()


def passed(begun: tuple[float, float]) -> list[float]:
    """What both clocks say since then, s."""
    return [now - then for now, then in zip(clocks(), begun, strict=True)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hours", type=float, default=1.0)
    given = parser.parse_args()
    print(rounds.machine() + "\n")
    loop = workload.loop()
    duration = 3600.0 * given.hours
    reference = Sine(amplitude=0.01, frequency=2.0, cycles=round(2.0 * duration))
    warm = list(stream(loop, reference, duration=10.0, record=workload.RECORD))
    del warm

    def row(name: str, samples: int, before: float, spans: list[float], most: str) -> list[str]:
        figures = [f"{spans[0]:.1f}", f"{spans[1]:.1f}", f"{spans[0] / samples * 1e9:.0f}"]
        return [name, f"{samples}", *figures, f"{before:.0f}", most, f"{resident():.0f}"]

    before, begun = resident(), clocks()
    samples, worst, most = 0, 0.0, before
    for part in stream(loop, reference, duration=duration, record=workload.RECORD):
        samples += part.time.size
        worst = max(worst, float(np.max(np.abs(part["following_error"]))))
        most = max(most, resident())
    rows = [row("six signals of every sample", samples, before, passed(begun), f"{most:.0f}")]
    simulate_batch(loop, reference, duration=10.0)
    before, begun = resident(), clocks()
    batch = simulate_batch(loop, reference, duration=duration)
    rows.append(row("statistics alone", samples, before, passed(begun), "-"))
    rounds.table(
        ["run", "samples", "wall s", "CPU s", "ns/sample", "MB before", "MB at most", "MB after"],
        rows,
    )
    assert batch.samples == samples
    assert float(batch.peak["following_error"][0]) == worst, "stream and batch must see the same hour"


if __name__ == "__main__":
    main()
