"""Exported C on other machines: other compilers, and other processors by qemu-user, against the simulator.

    PYTHONPATH=src:tests python tests/foreign_machines.py [--samples 20000] [--machine s390x] [--loop NAME] [--seed 1]

prints the table of docs/internals/c_quality.md, a row a machine; one missing is a row NOT RUN with what to install.
The loops are all those of the tests that a machine file can hold, and those of the bundled machine files.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np

from exported import LOOPS
from feeddrive.blocks.catalogue import catalogue
from feeddrive.export.c_bundle import streamed, version
from feeddrive.export.c_code import texts
from feeddrive.export.design import Trial, trial
from feeddrive.export.layout import layout
from feeddrive.files.machine import BUNDLED, read_machine
from feeddrive.language import tree
from feeddrive.loop.loop import Loop
from feeddrive.loop.routine import Routine, controller_routine, run

EXACT = "-ffp-contract=off"
C99 = ("-std=c99", EXACT)
LEAST_NORMAL = 2.0**-1022


@dataclass(frozen=True)
class Machine:
    """A compiler with its flags, and the program that runs what it makes.

    order    order of the bytes of a number, as NumPy writes it
    flushes  False if the processor has no mode in which numbers below the normal ones are zero
    """

    command: str
    flags: tuple[str, ...]
    package: str
    emulator: tuple[str, ...] = ()
    order: str = "="
    flushes: bool = True

    def missing(self) -> str:
        """What is not installed and how to install it, or an empty text."""
        lacking = [name for name in (self.command, *self.emulator[:1]) if shutil.which(name) is None]
        packages = f"{self.package}{' qemu-user' if self.emulator else ''}"
        return f"NOT RUN: {', '.join(lacking)} is missing: apt-get install {packages}" if lacking else ""


MACHINES: Mapping[str, Machine] = {
    "gcc -O0": Machine("gcc", (*C99, "-O0"), "gcc"),
    "gcc -O3": Machine("gcc", (*C99, "-O3"), "gcc"),
    "clang -O2": Machine("clang", (*C99, "-O2"), "clang"),
    "tcc": Machine("tcc", (), "tcc"),
    "aarch64": Machine(
        "aarch64-linux-gnu-gcc", (*C99, "-O2", "-static"), "gcc-aarch64-linux-gnu", ("qemu-aarch64",)
    ),
    "s390x": Machine(
        "s390x-linux-gnu-gcc", (*C99, "-O2", "-static"), "gcc-s390x-linux-gnu", ("qemu-s390x",), ">", flushes=False
    ),
    "i686 with SSE2": Machine(
        "i686-linux-gnu-gcc", (*C99, "-O2", "-msse2", "-mfpmath=sse", "-static"), "gcc-i686-linux-gnu", ("qemu-i386",)
    ),
}  # fmt: skip
X87 = ("i686-linux-gnu-gcc", (*C99, "-O2", "-mfpmath=387"))


@cache
def loops() -> Mapping[str, Loop]:
    """The loops of the tests whose blocks a machine file can name, and those of the bundled machine files."""
    known = {kind for family in catalogue().values() for kind in family}
    found = {name: loop for name, loop in LOOPS.items() if {b.kind for b in tree.blocks(loop.control)} - OWN <= known}
    for name in sorted(file.stem for file in (BUNDLED / "machines").glob("*.toml")):
        found |= {f"{name}, axis {axis}": loop for axis, loop in read_machine(name).loops.items()}
    return found


OWN = {"control", "guard"}  # parts of a control that are no blocks of the catalogue


@cache
def routine_of(name: str) -> Routine:
    """The routine of a loop, traced once for all machines."""
    return controller_routine(loops()[name], "axis_x")


def tried(routine: Routine, count: int, seed: int, *, tiny: bool) -> Trial:
    """Random samples with live changes, trips and broken numbers; without those below the normal ones unless `tiny`."""
    found = trial(routine, count, seed, changes=20, broken=2e-3)
    inputs = found.inputs
    if not tiny:
        inputs = np.where((inputs != 0.0) & (np.abs(inputs) < LEAST_NORMAL), 0.0, inputs)
    return Trial(inputs, found.changes)


def different(name: str, machine: Machine, count: int, seed: int) -> int:
    """How many output values of a loop differ in a bit between a machine and the simulator; all NaN are one."""
    routine = routine_of(name)
    planned = layout(routine)
    made = texts(planned, "a control under test", "made by a test")
    files = {"axis_x.h": made.header, "axis_x.c": made.source, "axis_x_configure.c": made.configure}
    given = tried(routine, count, seed, tiny=machine.flushes)
    answer = streamed(
        planned,
        files,
        given,
        flags=machine.flags,
        command=machine.command,
        emulator=machine.emulator,
        order=machine.order,
    ).outputs
    wanted = run(routine, given.inputs, given.changes)
    bits = np.ascontiguousarray(answer).view(np.uint64) != np.ascontiguousarray(wanted).view(np.uint64)
    return int(np.sum(bits & ~(np.isnan(answer) & np.isnan(wanted))))


def rows(names: list[str], machines: list[str], count: int, seed: int) -> Iterator[str]:
    """The rows of the table, one a machine."""
    for key in machines:
        machine = MACHINES[key]
        if machine.missing():
            yield f"| {key} | {machine.missing()} | | | |"
            continue
        begun, differing = time.monotonic(), dict[str, int]()
        for name in names:
            if found := different(name, machine, count, seed):
                differing[name] = found
        print(f"{key}: {time.monotonic() - begun:.0f} s; {differing or 'none differs'}", file=sys.stderr, flush=True)
        flags = " ".join(flag for flag in machine.flags if flag not in (*C99, "-static"))
        yield f"| {key} | {version(machine.command)} | `{flags}` | {len(names)} | {sum(differing.values())} |"


def main() -> None:
    """Print the table."""
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("--samples", type=int, default=20_000)
    asked.add_argument("--machine", action="append", choices=list(MACHINES))
    asked.add_argument("--loop", action="append", choices=list(loops()))
    asked.add_argument("--seed", type=int, default=1)
    given = asked.parse_args()
    names = given.loop or list(loops())
    print(f"| machine | compiler | flags | loops of {given.samples} samples | outputs that differ in a bit |")
    print("|---|---|---|---|---|")
    for row in rows(names, given.machine or list(MACHINES), given.samples, given.seed):
        print(row, flush=True)


if __name__ == "__main__":
    main()
