"""Print the table of docs/explanation/safety.md: injected faults, cycles until the reaction, travel against its bound.

PYTHONPATH=src python benchmarks/safety.py [faults of each class] [healthy motions] [classes]

Both numbers are for each of the three modes on each of the two buses; a class is a name of `KINDS`, default all.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from injected_faults import BUSES, KINDS, healthy, trials, wrong

MODES = ("csp", "csv", "cst")


def main(each: int = 34, motions: int = 167, kinds: Sequence[str] = KINDS) -> None:
    began, total, faulty = time.process_time(), 0, list[str]()
    print("| fault | faults | not observable | cycles, largest | travel, largest share of its bound | largest, mm |")
    print("|---|---|---|---|---|---|")
    for kind in kinds:
        found, hidden = [], 0
        for mode in MODES:
            for bus in BUSES:
                made, missed = trials(kind, mode, bus, each)
                found += made
                hidden += missed
                bad = [text for one in made if (text := wrong(one, mode, bus))]
                print("".join(f"{text}\n" for text in bad), end="", file=sys.stderr, flush=True)
                faulty += bad
        whole = [one for one in found if one.observed is not None and one.commanded is not None]
        if not whole:
            continue
        total += len(found)
        share = max(one.moved / max(one.bound, 1e-6) for one in whole)
        print(
            f"| {kind} | {len(found)} | {hidden} | {max(one.delay for one in whole)} | {share:.2f} | "
            f"{1e3 * max(one.moved for one in whole):.1f} |",
            flush=True,
        )
    print(f"{total} faults, {len(faulty)} wrong; {time.process_time() - began:.0f} s")
    stops = [why for mode in MODES for bus in BUSES for seed in range(motions) if (why := healthy(mode, bus, seed))]
    print(f"{6 * motions} healthy motions, {len(stops)} stopped; {time.process_time() - began:.0f} s")
    print("\n".join(stops))


if __name__ == "__main__":
    given = sys.argv[1:]
    main(int(given[0]) if given else 34, int(given[1]) if given[1:] else 167, given[2:] or KINDS)
