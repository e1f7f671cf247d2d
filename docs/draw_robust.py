"""Runs the comparisons of docs/explanation/box.md: laws at equal robustness, at the model and over a box.

python docs/draw_robust.py [--machine ball_screw] [--kept FOLDER]     writes pictures into docs/images, and the table

Both comparisons tune the same filters with every law.  KEPT holds finished laws, to go on after a stop.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import numpy as np

from feeddrive.comparison.compare import TODAY, Comparison, compare_laws
from feeddrive.evaluation import Engine, Folder
from feeddrive.evaluation.competitor import Competitor
from feeddrive.figures.figure import Figure
from feeddrive.figures.of_loops import ROPE_SNAP, SENSITIVITY_PEAK, STIFFNESS_AT
from feeddrive.files.machine import read_machine
from feeddrive.language.quantity import number
from feeddrive.loop.box import Box
from feeddrive.plot.chart import LOG, THIN, Chart, Curve, Level, Mark, Panel
from feeddrive.plot.drawing import drawn
from feeddrive.tuning.candidates import PLAIN

IMAGES = Path(__file__).parent / "images"
TRACKING, STIFFNESS = "tracking_error_rms_m", STIFFNESS_AT[0].key


def ratio(law: Competitor, plain: Competitor, key: str, *, worst: bool) -> str:
    """The factor by which a law is better than P-PI; a dash without a place."""
    values = [(each.worst if worst else each.figures).get(key) for each in (law, plain)]
    if law.unplaced or plain.unplaced or None in values:
        return "-"
    ours, theirs = (float(value) for value in values if value is not None)
    return number(ours / theirs if key == STIFFNESS else theirs / ours, 3)


def row(law: Competitor, model: Comparison, box: Comparison, snap: Figure) -> str:
    """One row of the table."""
    at_model = next((each for each in model.competitors if each.name == law.name), None)
    cells = [law.name]
    if at_model is None:
        cells += ["-", "-"]
    else:
        cells += [ratio(at_model, model[PLAIN], key, worst=False) for key in (snap.key, TRACKING)]
    cells += [ratio(law, box[PLAIN], key, worst=False) for key in (snap.key, TRACKING)]
    cells += [ratio(law, box[PLAIN], key, worst=True) for key in (snap.key, STIFFNESS, TRACKING)]
    peak = law.worst.get(SENSITIVITY_PEAK.key)
    cells += ["unstable" if peak is None else number(peak, 4), law.kind or "ranked"]
    return f"| {' | '.join(cells)} |"


def gain(law: Competitor | None, plain: Competitor, *, worst: bool) -> tuple[float, float] | None:
    """How many times a law is better than P-PI in tracking and in stiffness at 10 Hz; None without a place.

    Both are those at the worst plant if `worst`: tracking at the same plants for all laws.
    """
    if law is None or law.unplaced or plain.unplaced:
        return None
    errors, stiffness = (
        [(each.worst if worst else each.figures).get(key) for each in (law, plain)] for key in (TRACKING, STIFFNESS)
    )
    values = [float(value) for value in (*errors, *stiffness) if value]
    return (values[1] / values[0], values[2] / values[3]) if len(values) == 4 and np.isfinite(values).all() else None


def remaining(model: Comparison, over: Comparison) -> Chart:
    """Draw what is left of the gains over P-PI at equal worst-case robustness: a dot for each law.

    A line leads to it from the gain at equal robustness at the model alone.
    """
    named = {law.name: law for law in model.competitors}
    bases = list(dict.fromkeys(base(law.name) for law in over.competitors))
    marks, ways = list[Mark](), list[Curve]()
    for law in over.competitors:
        end = gain(law, over[PLAIN], worst=True)
        if law.name == TODAY or end is None:
            continue
        number_of, start = bases.index(base(law.name)) - 1, gain(named.get(law.name), model[PLAIN], worst=False)
        marks.append(Mark(*end, number_of, name=law.name, key=law.name))
        if start is not None:
            x, y = (np.array(pair) for pair in zip(start, end, strict=True))
            ways.append(Curve(x, y, number=number_of, look=THIN))
    x, y = (np.concatenate([[mark.x for mark in marks], *(way.x for way in ways)]),
            np.concatenate([[mark.y for mark in marks], *(way.y for way in ways)]))  # fmt: skip
    panel = Panel(
        "stiffness at 10 Hz, worst plant\n(times that of P-PI)",
        tuple(ways),
        marks=tuple(marks),
        levels=(Level(1.0), Level(1.0, upright=True)),
        scale=LOG,
        low=0.85 * float(np.min(y)),
        high=1.15 * float(np.max(y)),
    )
    label = (
        "tracking, worst plant (times better than P-PI); dots: limits and figures over the box, lines: from the model"
    )
    return Chart(label, (panel,), LOG, 0.6 * float(np.min(x)), 2.0 * float(np.max(x)), height=6.4)


def base(name: str) -> str:
    """The name of a law up to the first " + " or comma: laws with the same one share a color."""
    return name.partition(" + ")[0].partition(",")[0]


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
    heads = "law | model: snap | tracking | box, at the model: snap | tracking | at the worst plant: snap | stiffness"
    print(f"\n{over.rule}\n\n| {heads} | tracking | Ms at worst | |\n|{10 * '---|'}")
    for law in over.competitors:
        if law.name != TODAY:
            print(row(law, model, over, ROPE_SNAP))
    over.plot().savefig(IMAGES / f"robust_{asked.machine}.svg", metadata={"Date": None})
    drawn(remaining(model, over)).savefig(IMAGES / f"remaining_{asked.machine}.svg", metadata={"Date": None})


if __name__ == "__main__":
    main()
