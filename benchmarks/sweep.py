"""10,000 variants of 40,000 samples as a sweep into Parquet files, against the same loop written by hand in C.

    python benchmarks/sweep.py [--variants 10000] [--rounds 5] [--memory 2000 20000]

The axis and the 22 numbers that vary are those of `benchmarks/batch.py`.  The sweep draws the variants, checks them,
prepares their numbers, simulates, gathers eight figures of each, and writes the rows, flushed to the disk; the C only
simulates and gathers, on as many threads, from numbers that were prepared before.  All candidates in every round.
"""

from __future__ import annotations

import argparse
import shutil
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import compiler
import numpy as np
import rounds
import workload
from batch import BOUND, ByHand

from feeddrive.files.machine import machine_toml
from feeddrive.files.section import to_toml
from feeddrive.language import tree
from feeddrive.loop.machine import Machine
from feeddrive.loop.runner import Prepared, Work
from feeddrive.loop.simulate import GATHERED
from feeddrive.study.study import Study, read_study
from feeddrive.study.sweep import sweep
from feeddrive.study.variants import variants

FIGURES = tuple(
    f"{signal}_{what}_{unit}"
    for signal, unit in (
        ("following_error", "m"),
        ("tracking_error", "m"),
        ("force", "N"),
        ("velocity_load", "m_per_s"),
    )
    for what in ("rms", "peak")
)


def study(folder: Path, count: int) -> Study:
    """The study of the speed bars, as a file with its machine beside it."""
    machine = Machine.of({"x": workload.loop()})
    (folder / "machine.toml").write_text(machine_toml(machine, "two masses"), encoding="utf-8")
    varied = [f'[[vary]]\nparameter = "{path}"\nkind = "uniform"\ntolerance_percent = 10' for path in workload.VARIED]
    head = f'machine = "machine.toml"\ncount = {count}\nseed = 1\nmeasure = {list(FIGURES)}'.replace("'", '"')
    text = "\n\n".join([head, to_toml(workload.reference(), "reference"), *varied])
    (folder / "study.toml").write_text(text + "\n", encoding="utf-8")
    return read_study(folder / "study.toml")


def by_hand(given: Study, command: list[str], width: int, groups: int) -> ByHand:
    """The C loop with the numbers of all variants."""
    loop, reference = tree.vary(workload.loop(), dict(variants(given).values)), workload.reference()
    work = Work(loop, reference)
    prepared = Prepared(loop, work.first(), None, 0, BOUND)
    program = prepared.program()
    probe = prepared.native(program, record=(), gather=GATHERED, bounded=["tracking_error"], lanes=8)
    setpoints = np.ascontiguousarray(work.inputs(probe, 0, workload.SAMPLES))
    flags = ["-DSUBSTEPS=1", "-ffp-contract=fast", "-DESTRIN"]
    return ByHand(prepared, setpoints, command, flags, width, groups)


def best(given: Study) -> tuple[str, ByHand]:
    """The quickest C of all compilers and widths, on one core."""
    found: dict[str, ByHand] = {}
    for name, command in compiler.compilers().items():
        for width, groups in ((8, 1), (8, 2), (16, 1)):
            if name == "gcc" and width > 8:
                continue  # gcc takes vectors that are wider than the machine's apart through memory
            try:
                found[f"C, {name}, {width}x{groups}"] = by_hand(given, command, width, groups)
            except RuntimeError as error:
                print(f"{name} is left out: {str(error).splitlines()[-1]}")
    if not found:
        raise SystemExit("this benchmark needs a compiler: gcc with C++, clang, or pip install ziglang")
    taken = rounds.measure(
        {name: lambda made=made: [made.run(i) for i in range(128 // made.lanes)] for name, made in found.items()}, 7
    )
    name = min(found, key=lambda each: statistics.median(taken[each]))
    return name, found[name]


def compare(count: int, repeated: int) -> None:
    """The sweep and the C on one and on two threads."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        given = study(folder, count)
        name, made = best(given)

        def c(threads: int) -> Callable[[], object]:
            def call() -> None:
                with ThreadPoolExecutor(threads) as pool:
                    list(pool.map(made.run, range(count // made.lanes)))

            return call

        def ours(workers: int) -> Callable[[], object]:
            def call() -> None:
                shutil.rmtree(folder / "out", ignore_errors=True)
                sweep(given, folder / "out", workers=workers)

            return call

        calls = {f"{what}, {n} thread(s)": call(n) for what, call in ((name, c), ("sweep", ours)) for n in (1, 2)}
        wall, cpu = rounds.measure_both(calls, repeated)
        rows = sweep(given, folder / "rows", workers=2).store.table()
        squares = rows.column("following_error_rms_m").to_numpy() ** 2 * workload.SAMPLES
        # where an axis sticks on the edge, the last bit decides how long: a few variants differ more
        apart = np.quantile(np.abs(made.squares() / squares - 1.0), [0.5, 0.99])
        assert apart[1] < 0.05, "the C simulates something else"
    lines = []
    for each in calls:
        seconds = statistics.median(wall[each])
        base = f"{name}, {each.rsplit(', ', 1)[1]}"
        alone = f"{each.rsplit(', ', 1)[0]}, 1 thread(s)"
        lines.append(
            [
                each,
                f"{seconds:.2f}",
                f"{count * workload.SAMPLES / seconds * 1e-6:.0f}",
                f"{rounds.ratio(wall, each, base):.2f}",
                f"{rounds.ratio(cpu, each, base):.2f}",
                f"{1.0 / rounds.ratio(wall, each, alone):.2f}",
            ]
        )
    print(
        f"## {count:,} variants x {workload.SAMPLES:,} samples; Σ e² is {apart[0]:.0e} from that of the C, of 1 % of "
        f"the variants more than {apart[1]:.0e}\n"
    )
    heads = ["candidate", "wall s", "million samples/s", "to C, wall", "to C, CPU", "times one thread"]
    rounds.table(heads, lines)


def peak(count: int) -> float:
    """MB of memory at most in a fresh process that sweeps so many variants, in chunks of 256."""
    return float(
        subprocess.run(
            [sys.executable, __file__, "--alone", str(count)], check=True, capture_output=True, text=True
        ).stdout
    )


def alone(count: int) -> None:
    """Sweep, and say the peak of the memory in MB."""
    import resource

    with tempfile.TemporaryDirectory() as place:
        given = replace(study(Path(place), count), chunk=256)
        sweep(given, Path(place) / "out")
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--variants", type=int, default=10_000)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--memory", type=int, nargs="*", default=[])
    parser.add_argument("--alone", type=int)
    given = parser.parse_args()
    if given.alone is not None:
        alone(given.alone)
        return
    print(rounds.machine(), "\n")
    if given.memory:
        rounds.table(["variants", "peak MB"], [[f"{count:,}", f"{peak(count):.0f}"] for count in given.memory])
    else:
        compare(given.variants, given.rounds)


if __name__ == "__main__":
    main()
