"""Draws docs/images/travel.svg: a schedule over the travel of a long screw, with the positions at which it is proven.

python docs/draw_travel.py
"""

import math
from dataclasses import replace
from pathlib import Path

from feeddrive import plot
from feeddrive.benchmark.rules import read_rules
from feeddrive.certificate import prove_along_travel
from feeddrive.loop.loop import Loop
from feeddrive.tuning import Travel, tune_travel

PLACES = (0.4, 1.5, 2.7)  # m
EA = 210e9 * math.pi * 0.046**2 / 4.0  # N


def at(x: float) -> Loop:
    """Return the axis with its table at a position."""
    loop = read_rules(1).plants["screw_long"].loop
    plant = replace(loop.axis.plant, stiffness=1.0 / (1.0 / 300e6 + x / EA))  # type: ignore[call-arg]
    return replace(loop, axis=replace(loop.axis, plant=plant))


def main() -> None:
    """Tune, prove and draw."""
    travel = Travel.of({x: at(x) for x in PLACES})
    found = tune_travel(travel, starts=1)
    proof = prove_along_travel(travel, found.control, sensitivity_peak=2.02)
    print(found, proof.sentence(), sep="\n")
    plot.travel(found, proof).savefig(Path(__file__).parent / "images" / "travel.svg", metadata={"Date": None})


if __name__ == "__main__":
    main()
