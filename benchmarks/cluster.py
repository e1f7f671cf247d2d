"""What a Dask cluster costs beside the same sweep on the cores of this machine.

    python benchmarks/cluster.py [--workers 1] [--seconds 20] [--rounds 5] [--chunks 0.25 1 4]

The study is that of `benchmarks/sweep.py`: the two-mass axis, 22 numbers vary, eight figures of each variant.  The
cluster is a `LocalCluster` with as many worker processes as the other path has threads.  It runs before the clock does,
and its scheduler shares a process with the client.  Chunks are as long as asked on one core, both paths write the same
bytes, and they take turns in every round.
"""

from __future__ import annotations

import argparse
import shutil
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import psutil
import rounds
from distributed import LocalCluster
from sweep import study

from feeddrive.study.chunk import run_chunk
from feeddrive.study.study import Study
from feeddrive.study.sweep import sweep


def cpu() -> float:
    """CPU time in s of this process and all that it began and that still run."""
    here = psutil.Process()
    times = [each.cpu_times() for each in (here, *here.children(recursive=True))]
    return sum(each.user + each.system for each in times)


def rows(folder: Path) -> dict[str, bytes]:
    """The files of the rows by their names."""
    return {each.name: each.read_bytes() for each in (folder / "rows").iterdir()}


def lengths(given: Study, wanted: list[float]) -> list[int]:
    """Variants of a chunk that takes so many seconds on one core, in whole vectors."""
    sample = replace(given, chunk=64)
    run_chunk(sample, 0)
    begun = time.thread_time()
    run_chunk(sample, 1)
    each = (time.thread_time() - begun) / 64
    return [max(round(seconds / each / 16), 1) * 16 for seconds in wanted]


def compare(given: Study, workers: int, address: str, repeated: int, folder: Path) -> list[str]:
    """Wall and CPU time of both paths, and what of it is client and scheduler."""
    here, there, own = folder / "here", folder / "there", list[float]()

    def embedded() -> None:
        sweep(given, here, workers=workers)

    def cluster() -> None:
        begun = time.process_time()
        sweep(given, there, scheduler=address)
        own.append((time.process_time() - begun) / given.chunks)

    paths: dict[str, Callable[[], None]] = {"here": embedded, "there": cluster}
    wall: dict[str, list[float]] = {name: [] for name in paths}
    used: dict[str, list[float]] = {name: [] for name in paths}
    for number in range(repeated + 1):
        for name, path in paths.items():
            shutil.rmtree(folder / name, ignore_errors=True)
            begun = time.perf_counter(), cpu()
            path()
            if number:  # the first one compiles
                wall[name].append(time.perf_counter() - begun[0])
                used[name].append(cpu() - begun[1])
        assert rows(here) == rows(there)
    one = statistics.median(wall["here"]) * workers / given.chunks
    return [
        f"{given.chunk:,}",
        f"{given.chunks}",
        f"{one:.2f}",
        *(f"{statistics.median(wall[name]):.2f}" for name in paths),
        f"{100.0 * (rounds.ratio(wall, 'there', 'here') - 1.0):+.1f} %",
        f"{100.0 * (rounds.ratio(used, 'there', 'here') - 1.0):+.1f} %",
        f"{1e3 * statistics.median(own[1:]):.1f}",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--chunks", type=float, nargs="*", default=[0.25, 1.0, 4.0])
    given = parser.parse_args()
    print(rounds.machine(), "\n")
    workers = given.workers
    with (
        tempfile.TemporaryDirectory() as place,
        LocalCluster(n_workers=workers, threads_per_worker=1, host="127.0.0.1", dashboard_address=None) as cluster,
    ):
        whole = study(Path(place), 1_000_000)
        lines = list[list[str]]()
        for seconds, chunk in zip(given.chunks, lengths(whole, given.chunks), strict=True):
            chunks = max(round(given.seconds / seconds) * workers, 2 * workers)
            some = replace(whole, count=chunk * chunks, chunk=chunk)
            lines.append(compare(some, workers, cluster.scheduler_address, given.rounds, Path(place)))
            print(*lines[-1], file=sys.stderr)
    heads = [
        "variants a chunk",
        "chunks",
        "s a chunk",
        "here, s",
        "cluster, s",
        "more wall time",
        "more CPU time",
        "client and scheduler, ms a chunk",
    ]
    print(f"## {workers} worker(s)\n")
    rounds.table(heads, lines)


if __name__ == "__main__":
    main()
