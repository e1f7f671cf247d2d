"""Faults put into foreign logs, and what feeddrive says: `python benchmarks/faults_of_logs.py --seed 1`.

The faults and what must become of them are those of `tests/log_faults.py`; the logs are drawn from
`tests/foreign_axis.py`, `--count` axes of each of five laws. `--keep FILE` adds the answers of a run to a file, from
which the table of several runs is printed: a law at a time with `--law`.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import foreign_axis as foreign
import log_faults

HOW = ("refused", "named", "harmless", "other", "unseen")


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=3)
    parser.add_argument("--law", action="append", choices=foreign.LAWS)
    parser.add_argument("--keep", type=Path)
    options = parser.parse_args()
    answers = json.loads(options.keep.read_text()) if options.keep is not None and options.keep.exists() else []
    begun = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        for log in log_faults.drawn(options.seed, options.count, options.law or foreign.LAWS, Path(folder)):
            for name, fault in log_faults.FAULTS.items():
                found = log_faults.answer(fault, log, Path(folder) / "log.csv")
                answers.append([log.law, name, found.how, found.off])
                if not fault.holds(found):
                    print(f"{log.law}, {log.mass:.4g} kg, {name}: {found.how}: {found.said[:300]}", flush=True)
    if options.keep is not None:
        options.keep.write_text(json.dumps(answers))
    logs = len(answers) // len(log_faults.FAULTS)
    print(f"\nseed {options.seed}, {logs} logs, {time.process_time() - begun:.0f} s CPU\n")
    print("| fault | " + " | ".join(HOW) + " | recommended mass off, at most |")
    print("|---|" + "---|" * len(HOW) + "---|")
    for name in log_faults.FAULTS:
        found = Counter(how for _, fault, how, _ in answers if fault == name)
        off = max(abs(off) for _, fault, _, off in answers if fault == name)
        told = f"{100.0 * off:.2g} %" if off else ""
        print(f"| {name} | " + " | ".join(str(found[how] or "") for how in HOW) + f" | {told} |")


if __name__ == "__main__":
    main()
