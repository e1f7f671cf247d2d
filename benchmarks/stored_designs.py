"""Check the stored designs of the benchmark over the box of the rules, by other means than those of the tuner.

    python benchmarks/stored_designs.py                        # 1,000 plants from the box for each design
    python benchmarks/stored_designs.py --plant rack --draws 10000
    python benchmarks/stored_designs.py --law LQG --law 'P-P + DOB' --designs searched

The check is that of `box.py`: mechanics and law are written anew there; Ms is the peak of |1/(1 + L)|, refined at each
plant that is near the largest one, and stability is that of the eigenvalues of the whole loop.  A plant that `box.py`
does not know is left out and named.  Delay margin and noise are not checked.  The exit code is 1 if a design that keeps
its bounds by its record is found to exceed Ms by more than a thousandth, the tolerance of the rules, or to be unstable.
"""

import argparse
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from box import FORCES, Draws

from feeddrive.benchmark.benchmark import effort_of
from feeddrive.benchmark.rules import Rules, read_rules
from feeddrive.evaluation.competitor import Plant
from feeddrive.evaluation.designs import Designs
from feeddrive.evaluation.robustness import Design
from feeddrive.figures.of_loops import SENSITIVITY_PEAK
from feeddrive.loop.loop import Loop
from feeddrive.tuning.candidates import PLAIN

KINDS = ("rigid", "two_mass", "three_mass_chain", "modal")
ROOM = 1e-3  # of the bound: the tolerance of the rules
BATCH = 1000  # plants at once, with a seed of their own: larger arrays cost more time a plant
LINES = 640  # twice as dense as in `box.py`: LADRC and LQG have narrow peaks beside the resonances of the plant


@dataclass(frozen=True)
class Found:
    """A design over its box: the largest Ms by the search of the tuner and by the draws, and the largest |z|."""

    law: str
    searched: float | None
    drawn: float
    growth: float

    def exceeds(self, bound: float) -> bool:
        """Return True if the draws show more than the bound, or an unstable plant."""
        return self.drawn > bound * (1.0 + ROOM) or self.growth >= 1.0


def unknown(plant: Plant) -> str:
    """Return why a plant is not known to the check; empty if it is."""
    axis = plant.places[0].model
    if axis.plant.kind not in KINDS:
        return f"a plant '{axis.plant.kind}'"
    return next((f"a force '{force.kind}'" for force in axis.forces if force.kind not in FORCES), "")


def designs(
    rules: Rules, plant: Plant, laws: Sequence[str] = (), below: Path | None = None
) -> Iterator[tuple[Design, Loop]]:
    """Yield the designs of a plant that keep their bounds by their record, with their loops.

    laws   laws whose designs are wanted; default: all
    below  folder of the designs; default: that of the package
    """
    known = Designs(rules.designs(below), plant.name, rules.version)
    searched = rules.lineup(plant).searched
    plain = next(law for law in searched if law.name == PLAIN)
    for law in (law for law in searched if not laws or law.name in laws):
        for name, base in ((law.name, law), (effort_of(law.name), plain)):
            design = known.design(name)
            if design is not None and not design.refused and design.holds:
                yield design, replace(base.loop, control=design.control(base))


def main() -> None:
    """Check every plant in every box, and print the largest Ms of each design."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rules", type=int, default=2)
    parser.add_argument("--plant", action="append")
    parser.add_argument("--law", action="append", default=[])
    parser.add_argument("--designs", type=Path, help="folder of designs in place of those of the package")
    parser.add_argument("--draws", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    rules = read_rules(asked.rules)
    bad = count = plants = 0
    print("| box | plant | designs | largest Ms, by the tuner | of the draws | law | largest abs(z) | exceeded by |")
    print("|---|---|---|---|---|---|---|---|")
    for each in rules.boxes():
        box = each.tolerances
        if box is None:
            raise SystemExit(f"rules {asked.rules} have no box: name a version whose bounds hold over one")
        for plant in each.chosen(tuple(asked.plant or ())):
            if why := unknown(plant):
                print(f"| {box} | {plant.name} | not checked: {why} |", flush=True)
                continue
            batches = [min(BATCH, asked.draws - first) for first in range(0, asked.draws, BATCH)]
            draws = [
                Draws(replace(plant.loop, axis=place.model), box, count, asked.seed + i, LINES)
                for place in plant.places
                for i, count in enumerate(batches)
            ]
            plants += asked.draws * len(plant.places)
            rows: list[Found] = []
            for design, loop in designs(each, plant, asked.law, asked.designs):
                found = [drawn.under(loop.control, float(plant.rule.velocity)) for drawn in draws]
                searched = design.box["figures"][SENSITIVITY_PEAK.key]["worst"]
                peak, growth = max(worst.peak for worst in found), max(worst.growth for worst in found)
                rows.append(Found(design.law, searched, peak, growth))
            if not rows:
                print(f"| {box} | {plant.name} | no designs |", flush=True)
                continue
            exceeding = [row.law for row in rows if row.exceeds(float(each.sensitivity_peak))]
            worst = max(rows, key=lambda row: row.drawn)
            bad, count = bad + len(exceeding), count + len(rows)
            cells = (f"{max(row.searched or 0.0 for row in rows):.4f}", f"{worst.drawn:.4f}", worst.law)
            growth = f"{max(row.growth for row in rows):.5f}"
            names = ", ".join(exceeding) or "none"
            print(f"| {box} | {plant.name} | {len(rows)} | {' | '.join(cells)} | {growth} | {names} |", flush=True)
    print(f"\n{count} designs, {plants} plants: {bad} exceed; {time.process_time():.0f} s of processor time")
    sys.exit(bool(bad))


if __name__ == "__main__":
    main()
