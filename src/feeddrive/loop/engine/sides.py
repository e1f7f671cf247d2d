"""Operations that only one side of a choice needs: a single run computes them only when that side is chosen.

Both sides of `where` are pure, so a value that is not chosen need not be computed; this changes no bit.  It pays where
much work hangs on a condition that rarely changes, such as the exponential of Stribeck friction, which has died out
at speed.  Small sides are computed always: a wrong guess of a processor costs about twenty operations.
"""

from __future__ import annotations

from typing import NamedTuple

from feeddrive.language.graph import ELEMENTARY, arguments
from feeddrive.loop.engine.plan import Plan

LEAST_COST = 32  # in additions; a polynomial of one quarter of the sine's period is below it
_COSTS = {"input": 0, "div": 10, "sqrt": 10, "uniform": 30, "gather": 5} | dict.fromkeys(ELEMENTARY, 40)


class Side(NamedTuple):
    """One side of a `select`: 1 for true, 2 for false."""

    select: int
    side: int


def one_sided(plan: Plan) -> dict[Side, list[int]]:
    """The operations that belong to each side, in order; what a side within a side needs belongs to the inner one."""
    places = _places(plan)
    costs: dict[Side, int] = {}
    nodes = plan.graph.nodes
    for index, place in sorted(places.items()):
        for side in (Side(index, 1), Side(index, 2)):  # inner choices come first: their cost counts for the outer one
            if place is not None and side in costs:
                costs[place] = costs.get(place, 0) + costs[side]
        if place is not None:
            costs[place] = costs.get(place, 0) + _COSTS.get(nodes[index][0], 1)
    kept = {side for side, cost in costs.items() if cost >= LEAST_COST}
    found: dict[Side, list[int]] = {side: [] for side in kept}
    for index in plan.order:
        place = places.get(index)
        while place is not None and place not in kept:
            place = places[place.select]
        if place is not None:
            found[place].append(index)
    return found


def _places(plan: Plan) -> dict[int, Side | None]:
    """For each operation the innermost side that needs it while nobody else does; None for the loop itself."""
    nodes, moving = plan.graph.nodes, plan.kinds.moving
    needs: dict[int, list[Side | None]] = {node: [None] for _, node in plan.outputs}
    for state in plan.states:
        needs.setdefault(state.after, []).append(None)
    places: dict[int, Side | None] = {}
    for index in reversed(plan.order):
        if not moving[index]:
            continue
        places[index] = _common(needs[index], places)
        inner = arguments(nodes[index])
        for position, argument in enumerate(inner):
            chosen = nodes[index][0] == "select" and position > 0 and inner[1] != inner[2]
            needs.setdefault(argument, []).append(Side(index, position) if chosen else places[index])
    return places


def _common(sides: list[Side | None], places: dict[int, Side | None]) -> Side | None:
    """The innermost side around all of some sides."""
    around = _around(sides[0], places)
    for side in sides[1:]:
        others = _around(side, places)
        around = [one for one in around if one in others]
    return around[0] if around else None


def _around(side: Side | None, places: dict[int, Side | None]) -> list[Side]:
    """A side and all sides around it, from the inside out."""
    found: list[Side] = []
    while side is not None:
        found.append(side)
        side = places[side.select]
    return found
