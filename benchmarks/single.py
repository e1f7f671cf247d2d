"""One run of 40,000 samples with six signals, against the same loop written by hand in C.

The C gets its numbers, its first state and its setpoints; all of `simulate()` prepares them.  Four rows say how long
that takes after other runs of the same loop: with nothing changed, and with another gain, mass or path in each run.

python benchmarks/single.py [--rounds 60] [--substeps 1 4]
"""

from __future__ import annotations

import argparse
import ctypes
import dataclasses
import itertools
import statistics
from collections.abc import Callable, Iterator
from pathlib import Path

import compiler
import numpy as np
import rounds
import workload

from feeddrive.blocks.reference.snap_limited_move import SnapLimitedMove
from feeddrive.language import tree
from feeddrive.loop.loop import Loop
from feeddrive.loop.runner import Prepared, Work
from feeddrive.loop.simulate import simulate

SOURCE = (Path(__file__).parent / "single.c").read_text()
# the order of `Parameters` and `State` in single.c
PARAMETERS = [
    "control.law.Kv",
    "control.law.Kp",
    "control.law.Tn",
    "control.law.velocity_feedforward",
    "control.feedforward.0.mass",
    "control.feedforward.0.viscous",
    "control.force_limit",
    "axis.friction_load.coulomb",
    "axis.friction_load.breakaway",
    "axis.friction_load.stribeck_velocity",
    "axis.encoder_motor.resolution",
    "axis.encoder_load.resolution",
    "sample_time",
    *(f"prepared.control.filters.0.{name}" for name in ("b0", "b1", "b2", "a2")),
    *(f"prepared.axis.change.{i}.{j}" for i in range(4) for j in range(4)),
    *(f"prepared.axis.new.0.{i}" for i in range(4)),
    *(f"prepared.axis.forces.1.{i}" for i in range(4)),
]
WARM = 20  # runs with other numbers before the clock starts
CHANGES = 300  # of them, more than are kept
_steps = itertools.count(1)  # of 1e-6 each: no change comes twice
STATES = [
    "control.memory.law.positions.0",
    "control.memory.law.integral",
    "control.memory.filters.0.first",
    "control.memory.filters.0.second",
    "control.applied",
    "control.requested",
    "axis.pending.0",
    "axis.position.0",
    "axis.position.1",
    "axis.velocity.0",
    "axis.velocity.1",
]


def by_hand(
    prepared: Prepared, setpoints: np.ndarray, record: np.ndarray, command: list[str], flags: list[str]
) -> Callable[[], object]:
    """The C loop as a call without arguments."""
    made = compiler.library(SOURCE, command, flags)
    run = made.run
    run.restype, run.argtypes = None, [ctypes.c_long, *[ctypes.c_void_p] * 4]
    parameters = np.array([float(prepared.numbers[name]) for name in PARAMETERS])
    first = np.array([float(prepared.first[name]) for name in STATES])
    state = np.empty_like(first)
    arguments = [setpoints.shape[0], *(array.ctypes.data for array in (parameters, setpoints, state, record))]

    def call(kept: object = (made, parameters)) -> object:
        state[:] = first
        run(*arguments)
        return kept

    return call


def engine(prepared: Prepared, setpoints: np.ndarray, record: np.ndarray, arithmetic: str) -> Callable[[], object]:
    """The native time loop as a call without arguments."""
    program = prepared.program(load=False, enable=False)
    made = prepared.native(program, record=workload.RECORD, arithmetic=arithmetic)
    constants, first, rows = prepared.constants(made), prepared.states(made), prepared.rows(made)
    states = first.copy()

    def call() -> None:
        states[:] = first
        made.run(setpoints.shape[0], 0, constants, setpoints, states, record, rows)

    return call


def changing(loop: Loop, path: SnapLimitedMove, arithmetic: str) -> Iterator[tuple[str, Callable[[], object]]]:
    """What changes from run to run, and a call that makes the next run; the changed blocks are built beforehand."""

    def run(subjects: Iterator[tuple[Loop, SnapLimitedMove]]) -> Callable[[], object]:
        made = itertools.cycle(list(itertools.islice(subjects, CHANGES)))
        return lambda: simulate(*next(made), record=workload.RECORD, arithmetic=arithmetic)

    def varied(name: str) -> Iterator[tuple[Loop, SnapLimitedMove]]:
        value = tree.get(loop, name)
        for k in _steps:
            yield tree.vary(loop, {name: value * (1.0 + 1e-6 * k)}), path

    moved = ((loop, dataclasses.replace(path, dwell_before=path.dwell_before - 1e-6 * k)) for k in _steps)
    yield "a gain changed", run(varied("axis.x.control.law.Kv"))
    yield "a mass changed", run(varied("axis.x.plant.mass_load"))
    yield "another reference", run(moved)


def compare(substeps: int, count: int) -> None:
    """All candidates on one loop."""
    loop, reference = workload.loop(substeps), workload.reference()
    work = Work(loop, reference)
    prepared = Prepared(loop, work.first())
    program = prepared.program(load=False, enable=False)
    made = prepared.native(program, record=workload.RECORD)
    setpoints = np.ascontiguousarray(work.inputs(made, 0, workload.SAMPLES))
    records: dict[str, np.ndarray] = {}
    calls: dict[str, Callable[[], object]] = {}

    def add(name: str, make: Callable[..., Callable[[], object]], *arguments: object) -> None:
        records[name] = np.zeros((workload.SAMPLES, len(workload.RECORD)))
        calls[name] = make(prepared, setpoints, records[name], *arguments)

    native = [f"-DSUBSTEPS={substeps}", "-O3", "-march=native"]
    for name, command in compiler.compilers().items():
        add(f"C by hand, {name}", by_hand, command, native)
        add(f"C by hand, {name}, no contraction", by_hand, command, [*native, "-ffp-contract=off"])
    for arithmetic in ("libm", "exact", "fma"):
        add(f"engine, {arithmetic}", engine, arithmetic)
        calls[f"simulate(), {arithmetic}, nothing changed"] = lambda a=arithmetic: simulate(
            loop, reference, record=workload.RECORD, arithmetic=a
        )
        calls |= {f"simulate(), {arithmetic}, {what}": run for what, run in changing(loop, reference, arithmetic)}
    for each in (name for name in calls if "changed" in name or "another" in name):
        for _ in range(WARM):  # the first runs with other numbers compute in Python
            calls[each]()
    base = next(iter(calls))
    taken = rounds.measure(calls, count)
    truth = records[f"{base}, no contraction"]
    rows = []
    for name in calls:
        apart = "-"
        if name in records:
            same = np.array_equal(records[name], truth)
            apart = "bit-equal" if same else f"{np.max(np.abs(records[name][:, 0] - truth[:, 0])):.1e} m"
        each = statistics.median(taken[name]) / workload.SAMPLES * 1e9
        rows.append([name, f"{each:.1f}", f"{rounds.ratio(taken, name, base):.3f}", apart])
    print(f"## One run, {substeps} substep(s), {workload.SAMPLES} samples, {len(workload.RECORD)} signals\n")
    rounds.table(["candidate", "ns/sample", "ratio", "position against C without contraction"], rows)
    assert np.array_equal(records["engine, libm"], truth), "the engine and the C by hand must agree bit for bit"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=60)
    parser.add_argument("--substeps", type=int, nargs="*", default=[1, 4])
    given = parser.parse_args()
    print(rounds.machine())
    if not compiler.compilers():
        raise SystemExit("this benchmark needs a C compiler: gcc, clang, or pip install ziglang")
    for name, command in compiler.compilers().items():
        print(f"{name}: {compiler.version(command)}")
    print()
    for substeps in given.substeps:
        compare(substeps, given.rounds)


if __name__ == "__main__":
    main()
