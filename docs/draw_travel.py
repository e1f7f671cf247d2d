"""Remakes picture and tables of docs/explanation/travel.md: schedules over the travel of a long screw.

python docs/draw_travel.py            docs/images/travel.svg, with the positions at which the schedule is proven
python docs/draw_travel.py --tables   what schedules gain at each place, and the bounds on what any schedule can gain
"""

import argparse
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from feeddrive import plot
from feeddrive.benchmark.rules import read_rules
from feeddrive.certificate import prove_along_travel
from feeddrive.language.table import Column, Table
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.tuning import Travel, along_travel, frozen, tune_control, tune_travel
from feeddrive.tuning.candidates import control_with

PLACES = (0.4, 1.5, 2.7)  # m
EA = 210e9 * math.pi * 0.046**2 / 4.0  # N
LAWS = ("cascade_ppi", "pole_placement", "linear_adrc")
GOALS = ("rope-snap", "least-stiffness")


def at(x: float) -> Loop:
    """Return the axis with its table at a position."""
    loop = read_rules(1).plants["screw_long"].loop
    plant = replace(loop.axis.plant, stiffness=1.0 / (1.0 / 300e6 + x / EA))  # type: ignore[call-arg]
    return replace(loop, axis=replace(loop.axis, plant=plant))


def draw(travel: Travel) -> None:
    """Tune, prove and draw."""
    found = tune_travel(travel, starts=1)
    proof = prove_along_travel(travel, found.control, sensitivity_peak=2.02)
    print(found, proof.sentence(), sep="\n")
    plot.travel(found, proof).savefig(Path(__file__).parent / "images" / "travel.svg", metadata={"Date": None})


def started(travel: Travel, law: str) -> Control:
    """Return the control from which a search begins: that of the plant, or its start values with another law."""
    loop = travel.at(PLACES[0])
    return loop.control if law == loop.control.law.kind else control_with(loop, law)


def gains(travel: Travel) -> Iterator[list[str | float]]:
    """Yield what a schedule gains at each place, tuned place by place, and at the worst one."""
    for law in LAWS:
        for goal in GOALS:
            # no positions between: no place gives way
            found = tune_travel(travel, started(travel, law), goal=goal, between=0, starts=3, seed=0)
            pairs = zip(found.before, found.after, strict=True)
            yield [law, goal, *(old.goal / new.goal - 1.0 for old, new in pairs), found.gained]


def bound(travel: Travel, law: str, goal: str, filters: str) -> float:
    """Return what no schedule gains at the worst place, as the gains of the softest place alone do not reach more.

    filters  "kept", or "placed" if filters followed the position, too
    """

    def worst(control: Control, places: tuple[float, ...]) -> float:
        return max(row.goal for row in along_travel(travel, control, places, goal=goal))

    loops = [travel.at(x) for x in PLACES]
    fixed = tune_control(started(travel, law), loops, goal=goal, filters=filters, starts=3, seed=0)
    # from the model of the axis at the softest place
    own = tune_travel(travel, fixed.control, goal=goal, between=0, starts=1).control
    begun = replace(fixed.control, law=frozen(own, PLACES[-1]).law)
    alone = tune_control(begun, loops[-1], goal=goal, filters=filters, starts=3, seed=0)
    return worst(fixed.control, PLACES) / worst(alone.control, PLACES[-1:]) - 1.0


def tables(travel: Travel) -> None:
    """Print both tables of docs/explanation/travel.md."""
    heads = [Column(f"{x:g} m", "share") for x in PLACES]
    print(
        Table("a schedule against fixed gains", ["law", "goal", *heads, Column("worst", "share")], list(gains(travel)))
    )
    rows: list[list[str | float]] = [
        [law, goal, *(bound(travel, law, goal, filters) for filters in ("kept", "placed"))]
        for law in LAWS
        for goal in GOALS
    ]
    columns = ["law", "goal", Column("schedule of gains", "share"), Column("of filters, too", "share")]
    print(Table("no schedule gains more at the worst place than", columns, rows))


def main() -> None:
    """Draw the picture, or print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--tables", action="store_true")
    travel = Travel.of({x: at(x) for x in PLACES})
    (tables if parser.parse_args().tables else draw)(travel)


if __name__ == "__main__":
    main()
