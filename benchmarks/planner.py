"""Part programs to proven setpoints: lines a minute, memory, the first call.

    python benchmarks/planner.py [--blocks 100000] [--file PATH] [--memory] [--first] [--threads 1]

Programs of chords: a curve with chords of 50 µm and of 1 mm, zigzags with corners of 20 degrees, arcs with short lines.
`--file` takes a part program instead, repeated to 5,000 lines.
`--memory` reads a program of a million lines from a file, and says how memory grows from its first ten thousand on.
`--first` is the first plan in a fresh process, without machine code on disk and with it.
`--start` is the command `plan` on a file of 100 lines, without and with machine code on disk, and what only imports.
With `--threads 2` the table has the lines a minute of real time on one thread and on two, in turn; the load counts.  It
does not for processor time, all of it and that of the calling thread: the real time on two is no less than the half of
the first, nor than the second.
"""

from __future__ import annotations

import argparse
import os
import re
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from feeddrive.path.geometry.segments import Pause
from feeddrive.path.program.blocks import Line
from feeddrive.path.program.moves import Arc, Feed, Move, PathMode, Straight
from feeddrive.path.program.reading import read_program
from feeddrive.path.proof import Prover
from feeddrive.path.setpoints import Sampler, planned

LIMITS = np.array([[0.5, 5.0, 100.0, 5e4]] * 3)  # m/s .. m/s⁴
EVERY = 10_000  # blocks between looks at the memory


def curve(step: float, count: int) -> Iterator[tuple[float, float]]:
    """Points on a wavy spiral, step in m."""
    angle = 0.0
    for _ in range(count):
        radius = 0.05 + 0.01 * np.sin(7.0 * angle)
        angle += step / radius
        yield radius * float(np.cos(angle)), radius * float(np.sin(angle))


def zigzag(step: float, count: int) -> Iterator[tuple[float, float]]:
    """Corners of 20 degrees to the left and to the right in turn."""
    x = y = 0.0
    for k in range(count):
        heading = np.radians(10.0 if k % 2 else -10.0)
        x, y = x + step * float(np.cos(heading)), y + step * float(np.sin(heading))
        yield x, y


def moves(points: Iterator[tuple[float, float]], tolerance: float, feed: float) -> Iterator[Move]:
    yield PathMode(Line("", 1, ""), "continuous", tolerance)
    yield Feed(Line("", 1, ""), feed, 0.0)
    start = None
    for k, (x, y) in enumerate(points):
        end = (x, y, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        if start is not None:
            yield Straight(Line("", k, ""), start, end, False)
        start = end


def mixed(count: int, tolerance: float, feed: float) -> Iterator[Move]:
    """As adaptive clearing has it: an arc of 2 to 6 mm, then one to five lines of 0.2 to 1 mm, seed 3."""
    draw, heading, k = np.random.default_rng(3), 0.0, 0
    yield PathMode(Line("", 1, ""), "continuous", tolerance)
    yield Feed(Line("", 1, ""), feed, 0.0)
    start = (0.0,) * 9
    while k < count:
        radius, turn = draw.uniform(0.002, 0.006), draw.choice([-1.0, 1.0]) * draw.uniform(0.3, 2.5)
        heading += draw.normal() * draw.choice([0.0, 0.02, 0.1])
        sense = np.sign(turn)
        center = float(start[0] - sense * radius * np.sin(heading)), float(start[1] + sense * radius * np.cos(heading))
        heading += turn
        x, y = center[0] + sense * radius * np.sin(heading), center[1] - sense * radius * np.cos(heading)
        end = (float(x), float(y), *start[2:])
        yield Arc(Line("", k, ""), start, end, (0, 1, 2), center, int(sense))
        start, k = end, k + 1
        for _ in range(int(draw.integers(1, 6))):
            heading += 0.08 * draw.normal()
            step = draw.uniform(2e-4, 1e-3)
            end = (start[0] + float(step * np.cos(heading)), start[1] + float(step * np.sin(heading)), *start[2:])
            yield Straight(Line("", k, ""), start, end, False)
            start, k = end, k + 1


def repeated(path: Path, count: int) -> list[Move]:
    """The moves of a program that is repeated until it has at least `count`."""
    text = re.sub(r"(?i)\b(M0?2|M30)\b|%", "", path.read_text(encoding="utf-8"))
    with tempfile.TemporaryDirectory() as folder:
        long = Path(folder) / path.name
        long.write_text(text, encoding="utf-8")
        once = len(list(read_program(long, front_end="own")))
        long.write_text(text * -(-count // once) + "\nM2\n", encoding="utf-8")
        return list(read_program(long, front_end="own"))


def resident() -> float:
    """Memory of this process, MB."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 1e6


def speed(name: str, given: list[Move]) -> None:
    """A row: lines a minute of processor time, planned and proven."""
    count = len(given)
    list(planned(given[:2000], "XYZ", LIMITS))  # the first call compiles
    begun = time.process_time()
    found = list(planned(given, "XYZ", LIMITS))
    planning = time.process_time() - begun
    prover = Prover(LIMITS)
    begun = time.process_time()
    for each in found:
        if not isinstance(each, Pause):
            prover.prove(each)
    proving = time.process_time() - begun
    if prover.proof().count:
        raise SystemExit(f"{name}: {prover.proof()}")
    print(f"| {name} | {60 * count / planning:.2g} | {60 * count / (planning + proving):.2g} |", flush=True)


def walls(name: str, given: list[Move], threads: int) -> None:
    """A row: lines a minute of real time, planned and proven, on one thread and on several; the best of three each."""
    count, best, took, own = len(given) - 2, {1: 1e99, threads: 1e99}, {1: 1e99, threads: 1e99}, 1e99
    for _ in range(4):
        for number in best:
            prover, begun, cpu, calling = Prover(LIMITS), time.monotonic(), time.process_time(), time.thread_time()
            for each in planned(given, "XYZ", LIMITS, threads=number):
                if not isinstance(each, Pause):
                    prover.prove(each)
            if prover.proof().count:
                raise SystemExit(f"{name}: {prover.proof()}")
            best[number] = min(best[number], time.monotonic() - begun)
            took[number] = min(took[number], time.process_time() - cpu)
            own = min(own, time.thread_time() - calling)
    rates = [60 * count / best[number] for number in (1, threads)]
    cells = [
        f"{rates[0]:.3g}",
        f"{rates[1]:.3g}",
        f"{rates[1] / rates[0]:.2f}",
        f"{took[1]:.2f}",
        f"{took[threads]:.2f}",
        f"{own:.2f}",
    ]
    print(f"| {name} | {' | '.join(cells)} | {os.getloadavg()[0]:.1f} |", flush=True)


def memory(count: int, threads: int) -> None:
    """Reads, plans, proves and samples a program of `count` lines."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "long.ngc"
        with open(path, "w", encoding="utf-8") as file:
            file.write("G21 G90 G64 P0.01 F6000\n")
            for x, y in curve(2e-4, count):
                file.write(f"G1 X{1e3 * x:.4f} Y{1e3 * y:.4f}\n")
            file.write("M2\n")
        read, seen = 0, list[float]()

        def counted() -> Iterator[Move]:
            nonlocal read
            for move in read_program(path):
                yield move
                read += 1
                if read % EVERY == 0:
                    seen.append(resident())

        prover, sampler, begun, samples = Prover(LIMITS), Sampler(1e-3), time.process_time(), 0
        for each in planned(counted(), "XYZ", LIMITS, threads=threads):
            if not isinstance(each, Pause):
                prover.prove(each)
                samples += len(sampler.sample(each))
        took = time.process_time() - begun
    print(f"{read} moves in {took:.0f} s of processor time, {samples} setpoints, {prover.proof().count} faults")
    print(f"memory at {EVERY} moves {seen[0]:.1f} MB, largest later {max(seen):.1f} MB, at the end {seen[-1]:.1f} MB")


def first() -> None:
    """The time of a first plan, proof and sampling in fresh processes, imports left out."""
    with tempfile.TemporaryDirectory() as cache:
        for what in ("nothing on disk", "machine code on disk"):
            asked = [sys.executable, __file__, "--child"]
            said = subprocess.run(
                asked, env={**os.environ, "XDG_CACHE_HOME": cache}, capture_output=True, text=True, check=True
            )
            print(f"first plan, {what}: {said.stdout.strip()}")


def start(repeats: int = 3) -> None:
    """The processor time of the command on 100 lines of `mixed`, the least of some runs; a fresh cache for each."""
    main = ["-c", "from feeddrive.cli import main; main()"]
    with tempfile.TemporaryDirectory() as folder:
        program = Path(folder) / "part.ngc"
        program.write_text(_text(100), encoding="utf-8")
        plan = [*main, "plan", str(program), "--machine", "mill", "--out", f"{folder}/out"]
        commands = {
            "import feeddrive": ["-c", "import feeddrive"],
            "--help": [*main, "--help"],
            "plan --help": [*main, "plan", "--help"],
            "plan of a file that is not there": [*main, "plan", "nowhere.ngc", "--machine", "mill"],
            "plan": plan,
            "plan --no-pictures": [*plan, "--no-pictures"],
        }
        print("| s of processor time | nothing on disk | machine code on disk |\n|---|--:|--:|")
        for name, command in commands.items():
            cold, warm = list[float](), list[float]()
            for _ in range(repeats):
                with tempfile.TemporaryDirectory() as cache:
                    cold.append(_spent(command, cache))
                    # a few more, since kernels that have run long are compiled again, thoroughly
                    more = 6 if "plan" in command and "--out" in command else 1
                    warm += [_spent(command, cache) for _ in range(more)][-2:]
            print(f"| {name} | {min(cold):.2f} | {min(warm):.2f} |", flush=True)


def _spent(command: list[str], cache: str) -> float:
    """User and system time of a process, s."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    os.chmod(cache, 0o700)
    env = {**os.environ, "FEEDDRIVE_CACHE": cache}
    subprocess.run([sys.executable, *command], env=env, capture_output=True, check=False)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def _text(count: int) -> str:
    """A part program with arcs and short lines."""
    lines = ["G21 G90 G17 G64 P0.01 F3000"]
    for move in mixed(count - 2, 1e-5, 0.05):
        if isinstance(move, Arc | Straight):
            (x, y), word = (1e3 * value for value in move.end[:2]), "G1"
            center = ""
            if isinstance(move, Arc):
                word = "G3" if move.turns > 0 else "G2"
                center = " ".join(
                    f" {name}{1e3 * (c - s):.6f}" for name, c, s in zip("IJ", move.center, move.start, strict=False)
                )
            lines.append(f"{word} X{x:.6f} Y{y:.6f}{center}")
    return "\n".join([*lines[: count - 1], "M2", ""])


def usual(n: int) -> dict[str, list[Move]]:
    """The programs of the tables, with n chords of 50 um and a tenth of that of the others."""
    programs = {
        "curve, chords of 50 um, within 10 um": list(moves(curve(5e-5, n), 1e-5, 0.1)),
        "curve, chords of 1 mm, within 10 um": list(moves(curve(1e-3, n // 10), 1e-5, 0.1)),
    }
    for step, tolerance in ((1e-3, 1e-5), (1e-3, 1e-6), (5e-3, 1e-5)):
        what = f"zigzag of 20 degrees, {1e3 * step:g} mm, within {1e6 * tolerance:g} um"
        programs[what] = list(moves(zigzag(step, n // 10), tolerance, 0.1))
    programs["arcs of 2 to 6 mm mixed with short lines, within 10 um"] = list(mixed(n // 10, 1e-5, 0.05))
    return programs


def child() -> None:
    """One fresh process."""
    programs = [list(moves(points, 1e-5, 0.1)) for points in (curve(1e-3, 60), zigzag(2e-2, 4))]
    begun, faults = time.process_time(), 0
    for given in programs:
        prover, sampler = Prover(LIMITS), Sampler(1e-3)
        for each in planned(given, "XYZ", LIMITS):
            if not isinstance(each, Pause):
                prover.prove(each)
                sampler.sample(each)
        faults += prover.proof().count
    print(f"{time.process_time() - begun:.2f} s of processor time, {faults} faults")


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--blocks", type=int, default=100_000)
    parser.add_argument("--file", type=Path)
    parser.add_argument("--memory", action="store_true")
    parser.add_argument("--first", action="store_true")
    parser.add_argument("--start", action="store_true")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--child", action="store_true")
    asked = parser.parse_args()
    if asked.child:
        child()
    elif asked.memory:
        memory(max(asked.blocks, 10 * EVERY), asked.threads)
    elif asked.first:
        first()
    elif asked.start:
        start()
    else:
        programs = {f"{asked.file.name}, repeated": repeated(asked.file, 5000)} if asked.file else usual(asked.blocks)
        if asked.threads > 1:
            head = f"on {asked.threads}"
            columns = ["on 1 thread", head, "ratio", "CPU, s", f"CPU {head}, s", "of the calling thread, s", "load"]
            print(f"| lines a minute of real time | {' | '.join(columns)} |\n|---{'|--:' * len(columns)}|")
            for what, given in programs.items():
                walls(what, given, asked.threads)
            raise SystemExit
        print("| lines | planned a minute | and proven |\n|---|--:|--:|")
        for what, given in programs.items():
            speed(what, given)
