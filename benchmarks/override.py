"""A feed override: the cycle time at 100 %, and each hold's time to standstill beside that of the quickest stop.

    python benchmarks/override.py [--holds 40] [--seed 29] [--chips 3D_Chips.ngc]

The quickest stop is that of `tests/path/quickest_stop.py`.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

import numpy as np
from planner import LIMITS, curve, mixed, moves, zigzag

from feeddrive.path.motion import Part, Pause
from feeddrive.path.program.moves import Move
from feeddrive.path.program.reading import read_program
from feeddrive.path.proof import Prover
from feeddrive.path.schedule.override import Override, override
from feeddrive.path.setpoints import planned

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "path"))

reference = import_module("quickest_stop")


def proven(given: Sequence[Move], factor: Override | None) -> tuple[list[Part | Pause], float]:
    """Plan and prove; return the parts and the cycle time, s."""
    prover = Prover(LIMITS)
    parts = list(planned(given, "XYZ", LIMITS, factor))
    for each in parts:
        if isinstance(each, Part):
            prover.prove(each)
    if prover.proof().count:
        raise SystemExit(f"not proven: {prover.proof().faults[0]}")
    return parts, sum(map(reference.lasts, parts))


def holds(name: str, given: Sequence[Move], parts: Sequence[Part | Pause], times: np.ndarray) -> None:
    """A row: time to standstill over that of the quickest stop, and of those in corners in time."""
    ratios, inside, spent, unknown = list[float](), list[float](), 0.0, 0
    for begin in times.tolist():
        now, took = 0.0, time.process_time()
        stands = None
        for each in planned(given, "XYZ", LIMITS, override([(begin, 0.0), (begin + 3.0, 1.0)])):
            if isinstance(each, Pause) and each.why == "Hold":
                stands = now
                break
            now += reference.lasts(each)
        spent += time.process_time() - took
        found = reference.state_at(parts, begin)
        if stands is None or stands <= begin + 1e-9:
            continue
        if found is None:
            inside.append(stands - begin)
            continue
        pieces, state = found
        least = reference.quickest(pieces, LIMITS, state, stands - begin)
        if not np.isfinite(least):
            unknown += 1
            continue
        ratios.append((stands - begin) / least)
        if ratios[-1] > 1.1:
            print(f"   {name}: hold at {begin:.6f} s stands after {stands - begin:.5f} s, quickest {least:.5f} s")
    q = np.quantile(ratios, [0.5, 0.95, 1.0]) if ratios else [np.nan] * 3
    most = f"{1e3 * max(inside):.0f} ms" if inside else "-"
    print(
        f"| {name} | {len(ratios)} | {q[0]:.3f} | {q[1]:.3f} | {q[2]:.3f} | {len(inside)} | {most} | {unknown} | "
        f"{spent:.1f} s |",
        flush=True,
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--holds", type=int, default=40)
    parser.add_argument("--seed", type=int, default=29)
    parser.add_argument("--chips", type=Path)
    parser.add_argument("--only", default="")
    asked = parser.parse_args()
    programs: dict[str, list[Move]] = {
        "arcs of 2 to 6 mm and lines": list(mixed(150, 1e-5, 0.05)),
        "the same, 150 mm/s": list(mixed(150, 1e-4, 0.15)),
        "chords of 1 mm": list(moves(curve(1e-3, 300), 1e-5, 0.1)),
        "chords of 1 mm, 400 mm/s": list(moves(curve(1e-3, 600), 1e-4, 0.4)),
        "zigzag of 20 degrees, 5 mm": list(moves(zigzag(5e-3, 40), 1e-5, 0.1)),
    }
    if asked.chips:
        lines = asked.chips.read_text(encoding="utf-8").splitlines()[:600]
        short = Path("chips_begin.ngc")
        short.write_text("\n".join([*lines, "M2"]), encoding="utf-8")
        programs["3D_Chips, 600 lines"] = list(read_program(short))
        short.unlink()
    programs = {name: given for name, given in programs.items() if asked.only in name}
    print("| program | without | 100 % | ratio | 60 %, from a third on 100 %, from two thirds on 150 % |")
    print("|---|--:|--:|--:|--:|")
    known = {}
    for name, given in programs.items():
        parts, without = proven(given, None)
        _, at_100 = proven(given, override([]))
        _, steps = proven(given, override([(0.0, 0.6), (without / 3, 1.0), (2 * without / 3, 1.5)]))
        known[name] = parts, without
        print(f"| {name} | {without:.3f} s | {at_100:.3f} s | {at_100 / without:.4f} | {steps:.3f} s |", flush=True)
    print("\n| holds | number | median | 95 % | largest | in corners in time | longest there | no reference | CPU |")
    print("|---|--:|--:|--:|--:|--:|--:|--:|--:|")
    draw = np.random.default_rng(asked.seed)
    for name, given in programs.items():
        parts, without = known[name]
        holds(name, given, parts, np.sort(draw.uniform(0.0, without, asked.holds)))
