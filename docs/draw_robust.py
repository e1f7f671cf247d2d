"""Runs the comparisons of docs/box.md: laws at equal robustness at the model, and at equal robustness over a box.

python docs/draw_robust.py [--machine ball_screw] [--kept FOLDER]     writes the picture into docs/images, and the table

Both comparisons tune the same filters with every law.  KEPT holds finished laws, to go on after a stop.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from feeddrive.comparison.compare import TODAY, Comparison, compare_laws
from feeddrive.evaluation import Engine, Folder
from feeddrive.evaluation.competitor import Competitor
from feeddrive.figures.figure import Figure
from feeddrive.figures.of_loops import ROPE_SNAP, SENSITIVITY_PEAK
from feeddrive.files.machine import read_machine
from feeddrive.language.quantity import number
from feeddrive.loop.box import Box
from feeddrive.tuning.candidates import PLAIN

IMAGES = Path(__file__).parent / "images"
TRACKING = "tracking_error_rms_m"


def ratio(law: Competitor, plain: Competitor, key: str, *, worst: bool) -> str:
    """The factor by which a law is better than P-PI, where less is better; empty without a place."""
    values = [(each.worst if worst else each.figures).get(key) for each in (law, plain)]
    if law.unplaced or plain.unplaced or None in values:
        return "-"
    ours, theirs = (float(value) for value in values if value is not None)
    return number(theirs / ours, 3)


def row(law: Competitor, model: Comparison, box: Comparison, snap: Figure) -> str:
    """One row of the table."""
    at_model = next((each for each in model.competitors if each.name == law.name), None)
    cells = [law.name]
    if at_model is None:
        cells += ["-", "-"]
    else:
        cells += [ratio(at_model, model[PLAIN], key, worst=False) for key in (snap.key, TRACKING)]
    cells += [ratio(law, box[PLAIN], key, worst=False) for key in (snap.key, TRACKING)]
    cells += [ratio(law, box[PLAIN], key, worst=True) for key in (snap.key, TRACKING)]
    peak = law.worst.get(SENSITIVITY_PEAK.key)
    cells += ["unstable" if peak is None else number(peak, 4), law.kind or "ranked"]
    return f"| {' | '.join(cells)} |"


def main() -> None:
    """Compare twice, print the table and draw the comparison over the box."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--machine", default="ball_screw")
    parser.add_argument("--law", action="append")
    parser.add_argument("--kept", type=Path)
    asked = parser.parse_args()
    machine, found = read_machine(asked.machine), list[Comparison]()
    for name, box in (("model", None), ("box", Box())):
        store = None if asked.kept is None else Folder(asked.kept / name)
        begun = sum(os.times()[:4])
        found.append(
            compare_laws(machine, laws=asked.law, box=box, filters="free", engine=Engine.of(None, store=store))
        )
        print(f"{name}: {sum(os.times()[:4]) - begun:.0f} s of processor time", flush=True)
    model, over = found
    print(f"\n{over.rule}\n\n| law | model: snap | tracking | box, at the model: snap | tracking "
          "| at the worst plant: snap | tracking | Ms at worst | |\n|---|---|---|---|---|---|---|---|---|")  # fmt: skip
    for law in over.competitors:
        if law.name != TODAY:
            print(row(law, model, over, ROPE_SNAP))
    over.plot().savefig(IMAGES / f"robust_{asked.machine}.svg", metadata={"Date": None})


if __name__ == "__main__":
    main()
