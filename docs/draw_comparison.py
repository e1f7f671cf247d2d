"""Runs the comparisons for docs/reference/laws/comparison.md: tables as Markdown on the output, pictures as SVG.

python docs/draw_comparison.py [KEPT]     KEPT: a directory in which finished laws are kept, to go on after a stop
"""

from __future__ import annotations

import sys
from pathlib import Path

from feeddrive.comparison.compare import Comparison, compare_laws
from feeddrive.evaluation import Engine, Folder
from feeddrive.figures.ranking import CRITERIA
from feeddrive.files.machine import read_machine
from feeddrive.language.text import Text
from feeddrive.plot.drawing import drawn
from feeddrive.plot.laws import ratios_chart
from feeddrive.tuning.candidates import PLAIN

IMAGES = Path(__file__).parent / "images"
AXES = (("linear_motor", "x"), ("ball_screw", "x"), ("mill", "x"))


def markdown(found: Comparison) -> str:
    """One row a law: robustness and all figures."""
    heads = [
        "law",
        "Ms",
        "delay margin",
        "noise N/nm",
        "held back by",
        *(str(Text(criterion.column().named())) for criterion in CRITERIA),
        "rank",
    ]
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    for each in found.competitors:
        cells = [each.name, f"{each.figures['sensitivity_peak']:.2f}", f"{each.figures['delay_margin_samples']:.1f}"]
        cells += [f"{1e-9 * each.figures['noise_gain_N_per_m']:.3g}", each.held_by]
        for criterion in CRITERIA:
            value = each.figures.get(criterion.key)
            cells.append("–" if value is None else str(Text(criterion.bare(value))))
        cells.append(each.unplaced or str(found.places(CRITERIA[0])[found.competitors.index(each)]))
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    """All axes."""
    keep = Path(sys.argv[1]) if len(sys.argv) > 1 else None
    for machine, axis in AXES:
        store = None if keep is None else Folder(keep / machine)
        found = compare_laws(read_machine(machine), axis, engine=Engine.of(None, store=store))
        found.plot().savefig(IMAGES / f"tradeoff_{machine}.svg", metadata={"Date": None})
        ratios = ratios_chart([(each.name, each.figures) for each in found.competitors], PLAIN)
        drawn(ratios).savefig(IMAGES / f"comparison_{machine}.svg", metadata={"Date": None})
        print(f"\n## {found.title}\n\n{found.rule}\n\n{markdown(found)}\n")
        for each in found.competitors:
            if each.tuned is not None:
                print(
                    each.name, {name: float(f"{value:.4g}") for name, value in each.tuned.tunables.items()}, each.remark
                )
        for remark in found.remarks:
            print(f"- {remark}")
        for refusal in found.refusals:
            print(f"- not here: {refusal.name}: {refusal.reason}")


if __name__ == "__main__":
    main()
