"""4096 variants of 40,000 samples, against the same loop written by hand with vectors in C.

    python benchmarks/batch.py [--rounds 15] [--substeps 1 4] [--whole 3]

The first table times groups of 128 variants on one core, by CPU time, all candidates in every round.  The second one is
the whole batch on one and on two threads, against C on as many.
"""

from __future__ import annotations

import argparse
import ctypes
import statistics
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import compiler
import numpy as np
import rounds
import workload
from single import PARAMETERS, STATES

from feeddrive.loop.runner import Prepared, Work
from feeddrive.loop.simulate import GATHERED, simulate_batch

SOURCE = (Path(__file__).parent / "batch.cpp").read_text()
VARIANTS = 4096
GROUP = 128
BOUND = 1.0
WHAT = ("squares", "least", "most")


def aligned(*shape: int) -> np.ndarray:
    """Zeros at an address that vectors like."""
    size = int(np.prod(shape))
    held = np.zeros(size + 16)
    begin = (-held.ctypes.data // 8) % 16
    return held[begin : begin + size].reshape(shape)


class ByHand:
    """The C loop: `run(group)` simulates one group of variants, `squares()` is Σ e² of the following error."""

    def __init__(
        self, prepared: Prepared, setpoints: np.ndarray, command: list[str], flags: list[str], width: int, groups: int
    ) -> None:
        self.lanes = width * groups
        given = ["-x", "c++", f"-DWIDTH={width}", f"-DGROUPS={groups}", "-O3", "-march=native", "-Wno-psabi", *flags]
        self.made = compiler.library(SOURCE, command, given)
        self.call = self.made.run
        self.call.restype = None
        self.call.argtypes = [ctypes.c_long, ctypes.c_double, *[ctypes.c_void_p] * 4, ctypes.c_double]
        self.setpoints = setpoints
        count = prepared.lanes() // width
        self.parameters, self.states = aligned(count, len(PARAMETERS), width), aligned(count, len(STATES), width)
        for i, name in enumerate(PARAMETERS):
            self.parameters[:, i] = np.broadcast_to(prepared.numbers[name], (count * width,)).reshape(count, width)
        for i, name in enumerate(STATES):
            self.states[:, i] = np.broadcast_to(prepared.first[name], (count * width,)).reshape(count, width)
        self.gathered = aligned(count, 3 * len(GATHERED) + 1, width)
        self.step = groups

    def run(self, group: int) -> None:
        """One group."""
        i = group * self.step
        part = slice(i, i + self.step)
        states, gathered = aligned(*self.states[part].shape), self.gathered[part]
        states[:] = self.states[part]
        n = len(GATHERED)
        gathered[:, :n], gathered[:, n : 2 * n], gathered[:, 2 * n : 3 * n] = 0.0, np.inf, -np.inf
        gathered[:, 3 * n] = -1.0
        arrays = (self.parameters[part], self.setpoints, states, gathered)
        self.call(len(self.setpoints), workload.SAMPLE_TIME, *(array.ctypes.data for array in arrays), BOUND)

    def squares(self) -> np.ndarray:
        """Of the following error, by variant."""
        return self.gathered[:, 0].ravel()


class Engine:
    """The native loop, in the same form."""

    def __init__(self, prepared: Prepared, setpoints: np.ndarray, lanes: int, arithmetic: str) -> None:
        self.lanes, self.prepared, self.setpoints = lanes, prepared, setpoints
        program = prepared.program(load=False, enable=False)
        self.made = prepared.native(
            program, record=(), gather=GATHERED, bounded=["tracking_error"], lanes=lanes, arithmetic=arithmetic
        )
        self.ends = np.zeros(prepared.lanes())
        names = [state.name for state in self.made.plan.states]
        self.place = names.index("statistics.following_error.squares")
        self.given: dict[int, tuple[np.ndarray, np.ndarray]] = {}

    def run(self, group: int) -> None:
        """One group."""
        part = slice(group * self.lanes, (group + 1) * self.lanes)
        if group not in self.given:
            self.given[group] = self.prepared.constants(self.made, part), self.prepared.states(self.made, part)
        constants, first = self.given[group]
        states = first.copy()
        self.made.run(self.setpoints.shape[0], 0, constants, self.setpoints, states, None, [])
        self.ends[part] = states[self.place]

    def squares(self) -> np.ndarray:
        """Of the following error, by variant."""
        return self.ends


def candidates(prepared: Prepared, setpoints: np.ndarray, substeps: int) -> dict[str, ByHand | Engine]:
    """C by all compilers, widths, contractions and polynomials; the engine in its widths and arithmetics."""
    found: dict[str, ByHand | Engine] = {}
    for name, command in compiler.compilers().items():
        for width, groups in ((8, 1), (8, 2), (8, 4), (16, 1), (16, 2), (32, 1)):
            for contract in ("fast", "off"):
                for shape in ("-DESTRIN", "-DHORNER"):
                    if (contract == "off" and shape == "-DHORNER") or (name == "gcc" and width > 8):
                        continue  # gcc takes vectors that are wider than the machine's apart through memory
                    flags = [f"-DSUBSTEPS={substeps}", f"-ffp-contract={contract}", shape]
                    try:
                        made = ByHand(prepared, setpoints, command, flags, width, groups)
                    except RuntimeError as error:  # a gcc without its C++ part
                        print(f"{name} is left out: {str(error).splitlines()[-1]}")
                        continue
                    title = f"C, {name}, {width}x{groups}, contract={contract}, {shape[2:].capitalize()}"
                    found[title] = made
    for arithmetic in ("exact", "fma"):
        for lanes in (8, 16, 32):
            found[f"engine, {arithmetic}, {lanes} lanes"] = Engine(prepared, setpoints, lanes, arithmetic)
    return found


def compare(substeps: int, count: int, whole: int) -> None:
    """All candidates on one loop."""
    loop, reference = workload.variants(VARIANTS, substeps), workload.reference()
    work = Work(loop, reference)
    prepared = Prepared(loop, work.first(), None, 0, BOUND)
    program = prepared.program(load=False, enable=False)
    probe = prepared.native(program, record=(), gather=GATHERED, bounded=["tracking_error"], lanes=8)
    setpoints = np.ascontiguousarray(work.inputs(probe, 0, workload.SAMPLES))
    vectors = sum(probe.plan.kinds.varying[node] for _, node in probe.plan.constants)
    found = candidates(prepared, setpoints, substeps)

    def group(made: ByHand | Engine) -> Callable[[], object]:
        return lambda: [made.run(i) for i in range(GROUP // made.lanes)]

    taken = rounds.measure({name: group(made) for name, made in found.items()}, count)
    if not any(name.startswith("C") for name in found):
        raise SystemExit("this benchmark needs a compiler: gcc with C++, clang, or pip install ziglang")
    best = min((name for name in found if name.startswith("C")), key=lambda name: statistics.median(taken[name]))
    mine = {
        a: min((n for n in found if n.startswith(f"engine, {a}")), key=lambda n: statistics.median(taken[n]))
        for a in ("exact", "fma")
    }
    truth = found[mine["exact"]].squares()[:GROUP]
    rows = []
    for name, made in found.items():
        each = statistics.median(taken[name]) / workload.SAMPLES / GROUP * 1e9
        apart = np.max(np.abs(made.squares()[:GROUP] / truth - 1.0))
        rows.append([name, f"{each:.2f}", f"{rounds.ratio(taken, name, best):.3f}", f"{apart:.1e}"])
        assert apart < 0.05, f"{name} simulates something else"
    print(f"## Batch, {substeps} substep(s), {vectors} numbers vary, one core, groups of {GROUP} variants\n")
    rounds.table(["candidate", "ns/sample/variant", "ratio to the best C", "Σ e² apart, at most"], rows)

    def total(made: ByHand | Engine, threads: int) -> Callable[[], object]:
        def call() -> None:
            with ThreadPoolExecutor(threads) as pool:
                list(pool.map(made.run, range(VARIANTS // made.lanes)))

        return call

    if whole:
        calls: dict[str, Callable[[], object]] = {}
        for threads in (1, 2):
            calls[f"{best}, {threads} thread(s)"] = total(found[best], threads)
            for arithmetic, name in mine.items():
                calls[f"{name}, {threads} thread(s)"] = total(found[name], threads)
                calls[f"simulate_batch(), {arithmetic}, {threads} thread(s)"] = lambda a=arithmetic, t=threads: (
                    simulate_batch(loop, reference, arithmetic=a, threads=t, bound=BOUND)
                )
        wall, cpu = rounds.measure_both(calls, whole)
        rows = []
        for name in calls:
            seconds = statistics.median(wall[name])
            speed = VARIANTS * workload.SAMPLES / seconds * 1e-6
            base = f"{best}, {name.rsplit(', ', 1)[1]}"
            ratios = [rounds.ratio(taken, name, base) for taken in (wall, cpu)]
            rows.append([name, f"{seconds:.2f}", f"{speed:.0f}", *(f"{ratio:.3f}" for ratio in ratios)])
        print(f"## The whole batch, {substeps} substep(s): {VARIANTS} variants x {workload.SAMPLES} samples\n")
        heads = ["candidate", "wall s", "million samples/s", "ratio to C by the wall clock", "by CPU time"]
        rounds.table(heads, rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--substeps", type=int, nargs="*", default=[1, 4])
    parser.add_argument("--whole", type=int, default=3)
    given = parser.parse_args()
    print(rounds.machine())
    for name, command in compiler.compilers().items():
        print(f"{name}: {compiler.version(command)}")
    print()
    for substeps in given.substeps:
        compare(substeps, given.rounds, given.whole)


if __name__ == "__main__":
    main()
