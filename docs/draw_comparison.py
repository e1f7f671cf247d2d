"""Runs the comparisons for docs/laws/comparison.md: tables as Markdown on the output, pictures into docs/images.

python docs/draw_comparison.py
"""

from __future__ import annotations

from pathlib import Path

from feeddrive.comparison.compare import Comparison, compare_laws
from feeddrive.comparison.figures import CRITERIA
from feeddrive.comparison.report import figure
from feeddrive.files.machine import read_machine
from feeddrive.loop.runner import cores

IMAGES = Path(__file__).parent / "images"
AXES = (("linear_motor", "x"), ("ball_screw", "x"), ("mill", "x"))


def markdown(found: Comparison) -> str:
    """One row a law: robustness and all figures."""
    heads = ["law", "Ms", "delay margin", "held back by", *(f"{c.head} {c.unit}" for c in CRITERIA)]
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    for each in found.competitors:
        cells = [each.name, f"{each.figures['sensitivity_peak']:.2f}", f"{each.figures['delay_margin_samples']:.1f}"]
        cells.append(each.held_by)
        for criterion in CRITERIA:
            value = each.figures.get(criterion.key)
            cells.append("–" if value is None else figure(value, criterion))
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    """All axes."""
    for machine, axis in AXES:
        found = compare_laws(read_machine(machine), axis, workers=cores())
        found.plot().savefig(IMAGES / f"comparison_{machine}.svg", metadata={"Date": None})
        print(f"\n## {found.title}\n\n{markdown(found)}\n")
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
