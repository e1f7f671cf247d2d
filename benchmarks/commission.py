"""Commission drives that feeddrive does not know, one process each, and print what came of them.

PYTHONPATH=src python benchmarks/commission.py [--seed 0] [--count 20] [--out DIR] [--only SEED,SEED] [--mode csv]

The drives are those of tests/unknown_drives.py: two to four traits each, drawn by seed, with a person who confirms and
measures.  Rules: a drive counts as proven if the new control was kept and certified, and the measured RMS of the
following error and the measured stiffness lie within 10 % of the prediction.  An excursion is a true travel, speed or
force of the real axis beyond the limit that the user stated, in any cycle, the travel counted from where the axis stood
at the very first.  A refusal must leave gains, mode and limits of the drive as they were, and the drive off.  CPU time
is that of the process from the drawn drive to the end, the drive itself among it; its share is given beside.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line: threads that wait count as CPU time
sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

NEAR = 0.1  # share by which measured and predicted may differ
QUESTIONS, CPU = 8, 180.0  # s
PROVEN = 0.9  # share of the drives that must end in a proven loop
FIGURES = ("following_rms", "following_peak", "stiffness")
LIMITS = ("max_torque", "following_error_window", "position_least", "position_most", "quick_stop_deceleration")


def one(seed: int, out: Path, mode: str | None = None) -> dict[str, Any]:
    """Commission one drive, by force or with mode "csv" by velocities; return its row."""
    import feeddrive as fd
    import unknown_drives as ud
    from feeddrive.bus.drive_file import read_drive
    from feeddrive.bus.live import BusAxis
    from feeddrive.language.errors import FeeddriveError

    unknown = ud.draw(seed)
    firmware, person = unknown.firmware, unknown.person()
    path = unknown.write(out)
    before = firmware.old_control() | {name: firmware.values[name] for name in LIMITS}
    axis = BusAxis(read_drive(path), transport=lambda _drive: unknown.transport(), paced=False)
    began, error = time.process_time(), ""
    try:
        fd.commission(axis, mode=mode, out=out / "commission", progress=person)
    except FeeddriveError as refused:
        error = f"{type(refused).__name__}: {refused}"
    except Exception:  # a fault of the command is a row of the table, too
        error = "NOT AN ERROR OF FEEDDRIVE: " + traceback.format_exc(limit=-3)
    cpu = time.process_time() - began
    record: dict[str, Any] = {}
    kept_record = out / "commission" / "commission.json"
    if kept_record.exists():
        record = json.loads(kept_record.read_text(encoding="utf-8"))
    (out / "person.txt").write_text("\n".join([*person.asked, "", *person.heard, "", error]), encoding="utf-8")
    after = firmware.old_control() | {name: firmware.values[name] for name in LIMITS}
    row = {
        "seed": seed,
        "traits": unknown.traits,
        "bus": unknown.bus,
        "cycle_time": unknown.build.cycle_time,
        "kept": bool(record.get("kept")),
        "refusal": str(record.get("refusal") or error),
        "error": error,
        "predicted": record.get("predicted") or {},
        "measured": record.get("measured") or {},
        "before": record.get("before") or {},
        "steps": [step.get("name", "") for step in record.get("steps", [])],
        "certified": sorted(str(p.relative_to(out)) for p in out.rglob("*") if "certificate" in p.name),
        "excursions": unknown.excursions(),
        "when": {name: firmware.when[name] for name in unknown.excursions()},
        "changed": {name: [str(before[name]), str(after[name])] for name in before if before[name] != after[name]},
        "off": firmware.state.words,
        "questions": person.questions,
        "cpu": cpu,
        "motion": firmware.cycles * firmware.cycle_time,
        "operations": len(firmware.moves),
        "factor": unknown.truth.length_factor,
    }
    row["drive_cpu"] = firmware.cycles * cycle_cost(ud.Firmware(unknown.build))
    return row


def cycle_cost(firmware: Any) -> float:
    """The CPU time of one cycle of the drive, s."""
    began = time.process_time()
    for _ in range(2000):
        firmware.cycle()
    return (time.process_time() - began) / 2000


def ratios(row: Mapping[str, Any]) -> dict[str, float]:
    """Measured over predicted; NaN where one is missing."""
    found = {}
    for name in FIGURES:
        measured, predicted = row["measured"].get(name), row["predicted"].get(name)
        found[name] = measured / predicted if measured is not None and predicted else math.nan
    return found


def is_proven(row: Mapping[str, Any]) -> bool:
    """True if the new control was kept and certified, with error and stiffness as predicted."""
    found = ratios(row)
    near = all(abs(found[name] - 1.0) <= NEAR for name in ("following_rms", "stiffness"))
    return row["kept"] and bool(row["certified"]) and not row["refusal"] and near


def is_left_alone(row: Mapping[str, Any]) -> bool:
    """True if the drive is off and holds the old control and limits."""
    is_off = row["off"] in ("switch on disabled", "ready to switch on", "switched on")
    return is_off and not {name for name in row["changed"] if name != "off"}


def line(row: Mapping[str, Any]) -> str:
    """A row of the table."""
    found = ratios(row)

    def pair(name: str, factor: float, form: str) -> str:
        measured, predicted = row["measured"].get(name), row["predicted"].get(name)
        if measured is None or predicted is None:
            return "-"
        return f"{factor * predicted:{form}} / {factor * measured:{form}} ({found[name]:.3f})"

    beyond = ", ".join(f"{name} {share:.2f} ({row['when'][name]})" for name, share in row["excursions"].items())
    if is_proven(row):
        end = "proven"
    elif row["kept"]:
        end = "KEPT, off the prediction" if row["certified"] else "KEPT, NOT CERTIFIED"
    else:
        alone = "" if is_left_alone(row) else f" NOT AS IT WAS: {row['off']}, {row['changed']}"
        end = f"refused{alone}: {row['refusal'] or 'no reason given'}"
    end = " ".join(end.split()).replace("|", "/")
    return (
        f"| {row['seed']} | {' '.join(row['traits'])} | {row['bus']} {1e3 * row['cycle_time']:g} ms | {end} | "
        f"{pair('following_rms', 1e6, '.3g')} | {pair('following_peak', 1e6, '.3g')} | "
        f"{pair('stiffness', 1e-6, '.3g')} | {beyond or 'none'} | {row['questions']} | "
        f"{row['cpu']:.0f} ({row['drive_cpu']:.0f}) | {row['motion']:.0f} |"
    )


def summary(rows: Sequence[Mapping[str, Any]]) -> str:
    """What the bars ask for, and what was reached."""
    count = len(rows)
    beyond = [row["seed"] for row in rows if row["excursions"]]
    proven = [row["seed"] for row in rows if is_proven(row)]
    rest = [row for row in rows if not is_proven(row)]
    kept = [row["seed"] for row in rest if row["kept"]]
    wrong = [row["seed"] for row in rest if not row["kept"] and not (row["refusal"] and is_left_alone(row))]
    crashed = [row["seed"] for row in rows if row["error"].startswith("NOT AN ERROR")]
    peak = [row["seed"] for row in rows if row["kept"] and not abs(ratios(row)["following_peak"] - 1.0) <= NEAR]
    longest = max((row["cpu"] for row in rows), default=0.0)
    asked = max((row["questions"] for row in rows), default=0)

    def bar(text: str, reached: bool, which: Sequence[int] = ()) -> str:
        return f"- {'reached' if reached else 'MISSED'}: {text}{f' {list(which)}' if which else ''}\n"

    return (
        f"\n{count} drives, seeds {rows[0]['seed'] if rows else '-'} to {rows[-1]['seed'] if rows else '-'}\n\n"
        + bar(f"{len(beyond)} with an excursion beyond a limit (bar 0)", not beyond, beyond)
        + bar(
            f"{len(proven)} proven, RMS following error and stiffness within {100 * NEAR:.0f} % "
            f"(bar {math.ceil(PROVEN * count)})",
            len(proven) >= PROVEN * count,
        )
        + bar(f"{len(kept)} kept without that (bar 0)", not kept, kept)
        + bar(f"{len(wrong)} refused without a reason or not as they were (bar 0)", not wrong, wrong)
        + bar(f"{len(crashed)} ended in an error that is none of feeddrive (bar 0)", not crashed, crashed)
        + bar(f"{longest:.0f} s of CPU time at most (bar {CPU:.0f})", longest <= CPU)
        + bar(f"{asked} questions at most (bar {QUESTIONS})", asked <= QUESTIONS)
        + f"- besides: of those kept, {len(peak)} have a peak of the following error beyond {100 * NEAR:.0f} % {peak}\n"
    )


HEAD = (
    "| seed | traits | bus | end | following error, RMS, um: predicted / measured (ratio) | peak, um | "
    "stiffness, N/um | beyond limits | questions | CPU, s (drive) | motion, s |\n" + "|---" * 11 + "|"
)


def main(seeds: Sequence[int], out: Path, mode: str | None = None) -> None:
    print(HEAD, flush=True)
    rows = []
    for seed in seeds:
        folder = out / str(seed)
        folder.mkdir(parents=True, exist_ok=True)
        command = [sys.executable, __file__, "--one", str(seed), "--out", str(folder)]
        command += [] if mode is None else ["--mode", mode]
        done = subprocess.run(command, capture_output=True, text=True, timeout=1800)
        (folder / "output.txt").write_text(done.stdout + done.stderr, encoding="utf-8")
        if done.returncode != 0:
            print(f"| {seed} | the process ended with {done.returncode}: {done.stderr[-300:]!r} |", flush=True)
            continue
        rows.append(json.loads((folder / "row.json").read_text(encoding="utf-8")))
        print(line(rows[-1]), flush=True)
    (out / "rows.json").write_text(json.dumps(rows), encoding="utf-8")
    print(summary(rows))


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--only", default="")
    parser.add_argument("--mode", choices=("cst", "csv"))
    parser.add_argument("--one", type=int)
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    where = given.out or Path(tempfile.mkdtemp(prefix="commission_"))
    if given.one is not None:
        (where / "row.json").write_text(json.dumps(one(given.one, where, given.mode)), encoding="utf-8")
    else:
        wanted = [int(s) for s in given.only.split(",")] if given.only else range(given.seed, given.seed + given.count)
        main(list(wanted), where, given.mode)
        print(f"files: {where}")
