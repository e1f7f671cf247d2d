"""A machine of three axes with a regenerative cut at 20 kHz, against the same by hand in C: 4 teeth in 5 slices.

Every axis is that of `workload.py`.  The tool cuts a slot along x; three earlier surfaces count.  The C gets its
numbers, its first state and its setpoints, and keeps its past in a ring of its own.

python benchmarks/cut.py [--rounds 40] [--substeps 1 4] [--hours 0]
"""

from __future__ import annotations

import argparse
import ctypes
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import compiler
import hour
import numpy as np
import rounds
import workload

from feeddrive.blocks.coupling.milling_cut import MillingCut
from feeddrive.blocks.cutting.mechanistic_cutter import MechanisticCutter
from feeddrive.blocks.families import Reference
from feeddrive.blocks.reference.sine import Sine
from feeddrive.loop.machine import Machine
from feeddrive.loop.runner import Prepared, Work
from feeddrive.loop.simulate import stream

SOURCE = (Path(__file__).parent / "cut.c").read_text()
AXES = ("x", "y", "z")
SAMPLES = 40_000
RECORD = tuple(f"{axis}.{name}" for axis in AXES for name in ("position_load", "load_force"))
# the order of `Axis` in cut.c, and that of `Cut`
AXIS = [
    "control.law.Kv",
    "control.law.Kp",
    "control.law.Tn",
    "control.law.velocity_feedforward",
    "control.feedforward.0.mass",
    "control.feedforward.0.viscous",
    "control.force_limit",
    "friction_load.coulomb",
    "friction_load.breakaway",
    "friction_load.stribeck_velocity",
    "encoder_motor.resolution",
    "encoder_load.resolution",
]
CUT = [
    "cutter.diameter",
    "cutter.axial_depth",
    "cutter.helix_angle",
    "cutter.Ktc",
    "cutter.Krc",
    "cutter.Kac",
    "cutter.Kte",
    "cutter.Kre",
    "cutter.Kae",
    "spindle_speed",
]


def machine(substeps: int) -> Machine:
    """Three ball screws with encoders and friction, and a slot of 2 mm in aluminum."""
    tool = MechanisticCutter(
        teeth=4,
        slices=5,
        diameter=0.012,
        axial_depth=2e-3,
        helix_angle=np.pi / 6,
        Ktc=796e6,
        Krc=168e6,
        Kac=222e6,
        Kte=27.7e3,
        Kre=30.8e3,
        Kae=1.4e3,
    )
    cut = MillingCut(
        cutter=tool, spindle_speed=7000.0, along_z="z", direction=0.0, surfaces=3, remembered=1024 * substeps
    )
    return Machine.of(dict.fromkeys(AXES, workload.loop(substeps)), (cut,))


def path() -> dict[str, Reference]:
    """A feed along x that swings, and slow motions of the others."""
    return {
        "x": Sine(amplitude=0.04, frequency=0.25, cycles=1000000),
        "y": Sine(amplitude=0.002, frequency=0.5, cycles=1000000),
        "z": Sine(amplitude=0.001, frequency=0.5, cycles=1000000),
    }


def parameters(prepared: Prepared) -> np.ndarray:
    """The numbers of `Parameters` in cut.c."""
    found: list[float] = []
    for i, axis in enumerate(AXES):
        names = [f"axis.{axis}.{name}" for name in AXIS]
        names += [f"prepared.control.{axis}.filters.0.{name}" for name in ("b0", "b1", "b2", "a2")]
        names += [f"prepared.cores.{i}.change.{row}.{column}" for row in range(4) for column in range(4)]
        names += [f"prepared.cores.{i}.axes.0.new.0.{row}" for row in range(4)]
        names += [f"prepared.cores.{i}.axes.0.forces.1.{row}" for row in range(4)]
        found += [float(prepared.numbers[name]) for name in names]
    found += [float(prepared.numbers[f"couplings.0.{name}"]) for name in CUT]
    return np.array([*found, workload.SAMPLE_TIME])


def by_hand(
    prepared: Prepared, setpoints: np.ndarray, record: np.ndarray, command: list[str], flags: list[str], length: int
) -> Callable[[], object]:
    """The C as a call without arguments."""
    run = compiler.library(SOURCE, command, flags).run
    run.restype, run.argtypes = None, [ctypes.c_long, *[ctypes.c_void_p] * 5]
    given = parameters(prepared)
    states = [
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
    first = np.array([[float(prepared.first[f"axis.{axis}.{name}"]) for name in states] for axis in AXES])
    state, past = np.empty_like(first), np.zeros(4 * length + 1)
    arguments = [len(setpoints), *(each.ctypes.data for each in (given, setpoints, state, past, record))]

    def call(kept: object = (given, past)) -> object:
        state[:] = first
        run(*arguments)
        return kept

    return call


def engine(prepared: Prepared, setpoints: np.ndarray, record: np.ndarray, arithmetic: str) -> Callable[[], object]:
    """The native time loop as a call without arguments."""
    made = prepared.native(prepared.program(load=False, enable=False), record=RECORD, arithmetic=arithmetic)
    constants, first, rows = prepared.constants(made), prepared.states(made), prepared.rows(made)
    states = first.copy()

    def call() -> None:
        states[:] = first
        made.run(len(setpoints), 0, constants, setpoints, states, record, rows)

    return call


def compare(substeps: int, count: int) -> None:
    """All candidates at one number of substeps."""
    subject = machine(substeps)
    work = Work(subject, path())
    prepared = Prepared(subject, work.first())
    made = prepared.native(prepared.program(load=False, enable=False), record=RECORD)
    setpoints = np.ascontiguousarray(work.inputs(made, 0, SAMPLES))
    by_axis = setpoints.reshape(SAMPLES, len(AXES), 5)
    records: dict[str, np.ndarray] = {}
    calls: dict[str, Callable[[], object]] = {}

    def add(name: str, make: Callable[..., Callable[[], object]], given: np.ndarray, *arguments: Any) -> None:
        records[name] = np.zeros((SAMPLES, len(RECORD)))
        calls[name] = make(prepared, given, records[name], *arguments)

    length = 1024 * substeps
    flags = [f"-DSUBSTEPS={substeps}", f"-DLENGTH={length}", "-O3", "-march=native"]
    for name, command in compiler.compilers().items():
        add(f"C by hand, {name}", by_hand, by_axis, command, flags, length)
        add(f"C by hand, {name}, no contraction", by_hand, by_axis, command, [*flags, "-ffp-contract=off"], length)
    for arithmetic in ("libm", "exact", "fma"):
        add(f"engine, {arithmetic}", engine, setpoints, arithmetic)
    base = next(iter(calls))
    taken = rounds.measure(calls, count)
    rows = []
    for name in calls:
        each = statistics.median(taken[name]) / SAMPLES * 1e9
        apart = np.max(np.abs(records[name] - records[base]), axis=0)
        away = f"{np.max(apart[::2]):.1e} m, {np.max(apart[1::2]):.1e} N"
        fast = workload.SAMPLE_TIME / (each * 1e-9)
        rows.append([name, f"{each:.0f}", f"{rounds.ratio(taken, name, base):.2f}", f"{fast:.0f}", away])
    print(f"\n## Three axes and a cut, {substeps} substep(s), {SAMPLES} samples, {len(RECORD)} signals\n")
    rounds.table(["candidate", "ns/sample", "ratio", "times real time", "apart from the first"], rows)
    assert np.max(np.abs(records["engine, exact"] - records[base])[:, ::2]) < 1e-6, "engine and C must agree"


def an_hour(hours: float) -> None:
    """The machine for so long, its signals handed out in chunks."""
    subject = machine(1)
    list(stream(subject, path(), duration=1.0, record=RECORD))
    before, begun, most, samples = hour.resident(), (time.perf_counter(), time.process_time()), 0.0, 0
    for part in stream(subject, path(), duration=3600.0 * hours, record=RECORD):
        samples += part.time.size
        most = max(most, hour.resident())
    spans = time.perf_counter() - begun[0], time.process_time() - begun[1]
    print(f"\n## {hours:g} h of machining\n")
    heads = ["samples", "wall s", "CPU s", "MB before", "MB at most", "MB after"]
    rounds.table(heads, [[f"{x:.0f}" for x in (samples, *spans, before, most, hour.resident())]])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=40)
    parser.add_argument("--substeps", type=int, nargs="*", default=[1, 4])
    parser.add_argument("--hours", type=float, default=0.0)
    given = parser.parse_args()
    print(rounds.machine())
    if not compiler.compilers():
        raise SystemExit("this benchmark needs a C compiler: gcc, clang, or pip install ziglang")
    for substeps in given.substeps:
        compare(substeps, given.rounds)
    if given.hours:
        an_hour(given.hours)


if __name__ == "__main__":
    main()
