"""From foreign logs to loops that can be tuned (docs/how_to/identification.md): `python benchmarks/entry.py --seed 1`.

30 logs of a simulator that shares no code with feeddrive (tests/foreign_axis.py): 5 laws, 3 masses each, with one and
with two encoders, linear and rotary, with drawn names, units, percent of a rated value, amperes, and decimal commas.
A person knows the data sheet of the drive (rated value, motor constant, whether the axis turns) and the units of the
columns, and no gain of the control.  First everything is left to the guess; where that is refused or doubted, the
columns are named with their units, as the message says.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line: threads that wait count as CPU time

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import foreign_axis as foreign
from feeddrive.identification.motion.identify import Identified
from feeddrive.language.errors import FeeddriveError
from feeddrive.language.judgment import Judgment
from feeddrive.language.progress import Progress
from feeddrive.workflow.command import load

MASSES = 3
BOTH_WAYS = ("dwells", "no dwells", "constant speeds", "circle")
TUNABLE = 0.05  # largest error of the mass of a recommended model


class Row(NamedTuple):
    """One log, and what came of it."""

    law: str
    two: bool
    rotary: bool
    attempts: int
    judgment: str
    mass: float | None  # relative error
    found: str
    tunable: bool
    why: str
    seconds: float


def draw(rng: np.random.Generator, law: str, *, two: bool) -> Any:
    """Return a log of a calm loop that moves both ways; others are drawn anew: nobody leaves a loop that rings on."""
    while True:
        logs = foreign.draw(rng, law=law, two=two, move=str(rng.choice(BOTH_WAYS)))
        if bool(logs.stable[0]):
            return logs


def data_sheet(written: Any, *, rotary: bool) -> dict[str, Any]:
    """Return what the data sheet of the drive says: whether the axis turns, and the value of 100 %, or of 1 A."""
    unit, known = written.units["force"], {"rotary": True} if rotary else dict[str, Any]()
    if unit == "%":
        return known | {"rated": f"{written.rated:g}{'Nm' if rotary else 'N'}"}
    if unit == "A":
        return known | {"torque_constant" if rotary else "motor_constant": written.rated}
    return known


def named(written: Any, *, rotary: bool, two: bool) -> dict[str, Any]:
    """Return the options that name all columns with their units."""
    turning = {"position": "angle", "setpoint": "set_angle", "force": "torque"}
    roles = turning if rotary else {"setpoint": "set_position"}
    # with two encoders the one of the load is the position of the axis; the other one keeps its guess
    taken = ["time", "setpoint", "position_load" if two else "position", "force"]
    typed: dict[str, Any] = {}
    for role in taken:
        what, unit = role.removesuffix("_load"), written.units[role].replace(" ", "")
        name = written.names[role]
        factor = {"%": written.rated / 100.0, "A": written.rated}.get(unit)
        scaled = f"{name}:{unit}" if factor is None else f"{name}*{factor:.10g}:{'Nm' if rotary else 'N'}"
        typed[roles.get(what, what)] = scaled
    return typed | ({"rotary": True} if rotary else {})


def identified(path: Path, out: Path, **typed: Any) -> tuple[Identified, Any]:
    command = load("identify")
    outcome = command.run(command.build_request(logs=[path], out=out, **typed), Progress())
    return outcome.result, outcome


def row(rng: np.random.Generator, law: str, folder: Path, *, two: bool) -> Row:
    logs = draw(rng, law, two=two)
    rotary = bool(logs.axes.rotary)
    written = foreign.write_csv(folder / "log.csv", logs.log(0, first=300), rng, rotary=rotary, two=two)
    sheet = data_sheet(written, rotary=rotary)
    begun, judgment, why = time.process_time(), "refused", ""
    mass: float | None = None
    found, tunable, attempts = "", False, 0
    for attempts, typed in enumerate((sheet, named(written, rotary=rotary, two=two)), 1):
        try:
            result, outcome = identified(written.path, folder / f"out_{attempts}", **typed)
        except FeeddriveError as error:
            judgment, why = "refused", str(error)
            continue
        judgment, why = outcome.judgment.name.lower(), str(outcome.verdict)
        # the mass that is written, which tuning uses
        fitted = result.rigid["mass"].value if result.loop is None else float(result.loop.axis.plant.rigid_mass())
        mass = fitted / float(np.ravel(logs.true("mass", 0))[0]) - 1.0
        found = "" if result.loop is None else "start law" if result.started else result.loop.control.law.kind
        tunable = (folder / f"out_{attempts}" / "machine.toml").exists()
        if outcome.judgment is not Judgment.UNITS_IN_DOUBT and not outcome.judgment.bad:
            break
    return Row(law, two, rotary, attempts, judgment, mass, found, tunable, why, time.process_time() - begun)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, help="directory for the logs and what came of them")
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    rows: list[Row] = []
    for law in foreign.LAWS:
        for two in (False, True):
            for _ in range(MASSES):
                with tempfile.TemporaryDirectory() as temporary:
                    folder = Path(temporary) if options.keep is None else options.keep / f"{len(rows) + 1:02d}"
                    folder.mkdir(parents=True, exist_ok=True)
                    rows.append(row(rng, law, folder, two=two))
                last = rows[-1]
                error = "" if last.mass is None else f"{100 * last.mass:+.2f} %"
                told = last.why[:110].replace("\n", " ")
                print(
                    f"{last.law:14} {'two' if two else 'one'} {'rot' if last.rotary else 'lin'} {last.attempts} "
                    f"{last.judgment:16} {error:>9} {last.found:14} {'tune' if last.tunable else '-':4} "
                    f"{last.seconds:5.1f} s  {told if not last.tunable else ''}",
                    flush=True,
                )
    recommended = [one for one in rows if one.judgment == "use_values"]
    wrong = [one for one in recommended if one.mass is None or abs(one.mass) > TUNABLE]
    print(f"seed {options.seed}: {len(rows)} logs; {dict(Counter(one.judgment for one in rows))}")
    print(f"  recommended {len(recommended)}, of these with a mass more than 5 % off: {len(wrong)}")
    print(f"  reach tune without a gain typed: {sum(one.tunable for one in rows)} of {len(rows)}")
    print(f"  by the first command: {sum(one.tunable and one.attempts == 1 for one in rows)}")
    print(f"  laws: {dict(Counter(one.found or 'none' for one in rows))}")


if __name__ == "__main__":
    main()
