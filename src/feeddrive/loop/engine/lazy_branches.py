"""Operations needed by one branch of a `select` only: a single run computes them only when that branch is taken.

Both branches of `where` are pure, so a value that is not selected need not be computed; this changes no bit.  It pays
where an expensive branch is rarely taken, such as the exponential of Stribeck friction, which is negligible at high
speed.  Cheap branches are always computed: a mispredicted branch costs about twenty operations.
"""

from __future__ import annotations

from typing import NamedTuple

from feeddrive.language.graph import ELEMENTARY, arguments
from feeddrive.loop.engine.plan import Plan

LEAST_COST = 32  # in additions; a polynomial of one quarter of the sine's period is below it
_COSTS = {"input": 0, "div": 10, "sqrt": 10, "uniform": 30, "gather": 5} | dict.fromkeys(ELEMENTARY, 40)


class Branch(NamedTuple):
    """One branch of a `select` node: 1 for true, 2 for false."""

    select: int
    branch: int


def lazy_branches(plan: Plan) -> dict[Branch, list[int]]:
    """The operations that belong to each branch, in order; an inner branch keeps its own."""
    places = _places(plan)
    costs: dict[Branch, int] = {}
    nodes = plan.graph.nodes
    for index, place in sorted(places.items()):
        for branch in (
            Branch(index, 1),
            Branch(index, 2),
        ):  # inner choices come first: their cost counts for the outer one
            if place is not None and branch in costs:
                costs[place] = costs.get(place, 0) + costs[branch]
        if place is not None:
            costs[place] = costs.get(place, 0) + _COSTS.get(nodes[index][0], 1)
    kept = {branch for branch, cost in costs.items() if cost >= LEAST_COST}
    found: dict[Branch, list[int]] = {branch: [] for branch in kept}
    for index in plan.order:
        place = places.get(index)
        while place is not None and place not in kept:
            place = places[place.select]
        if place is not None:
            found[place].append(index)
    return found


def _places(plan: Plan) -> dict[int, Branch | None]:
    """For each operation the innermost branch that alone needs it; None where the loop itself does."""
    nodes, moving = plan.graph.nodes, plan.kinds.moving
    needs: dict[int, list[Branch | None]] = {node: [None] for _, node in plan.outputs}
    for state in plan.states:
        needs.setdefault(state.after, []).append(None)
    for index in plan.order:
        if nodes[index][0] in ("get", "put"):
            needs.setdefault(index, []).append(None)
    places: dict[int, Branch | None] = {}
    for index in reversed(plan.order):
        if not moving[index]:
            continue
        # what reads or writes a ring has its place in the order of these
        places[index] = None if nodes[index][0] in ("get", "put") else _common(needs[index], places)
        inner = arguments(nodes[index])
        for position, argument in enumerate(inner):
            chosen = nodes[index][0] == "select" and position > 0 and inner[1] != inner[2]
            needs.setdefault(argument, []).append(Branch(index, position) if chosen else places[index])
    return places


def _common(branches: list[Branch | None], places: dict[int, Branch | None]) -> Branch | None:
    """The innermost branch around all of some branches."""
    around = _around(branches[0], places)
    for branch in branches[1:]:
        others = _around(branch, places)
        around = [one for one in around if one in others]
    return around[0] if around else None


def _around(branch: Branch | None, places: dict[int, Branch | None]) -> list[Branch]:
    """A branch and all branches around it, from the inside out."""
    found: list[Branch] = []
    while branch is not None:
        found.append(branch)
        branch = places[branch.select]
    return found
