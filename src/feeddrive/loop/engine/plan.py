"""The plan from which code is generated: lowered graph, memory order, kinds of nodes, lazy branches.

In a single run, an operation that only one branch of a `select` needs is computed only if that branch is taken.

Both branches of `where` are pure, so a value that is not selected need not be computed; the results remain
bit-identical.  Skipping it pays off where an expensive branch is rarely taken, such as the exponential of Stribeck
friction, which is negligible at high speed.  Cheap branches are always computed: a mispredicted branch costs about
twenty operations.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from feeddrive.language import mathematics, ops
from feeddrive.language.errors import StructureError
from feeddrive.language.graph import ELEMENTARY, TRUTH, Graph, Symbol, arguments, reachable, rebuilt
from feeddrive.loop.trace import Carried, Program


class Kinds(NamedTuple):
    """The kinds of all nodes, by index: whether a node changes between samples, whether it differs between lanes
    (variants), and whether it is a truth value.
    """

    moving: list[bool]
    varying: list[bool]
    truth: list[bool]


def classify(
    graph: Graph, moving: Collection[int], varying: Collection[int], carried: Collection[tuple[int, int]]
) -> Kinds:
    """Return the kinds of all nodes.

    moving   nodes with a new value in each sample (inputs, the sample index)
    varying  leaves that differ between lanes (constants, states that start differently)
    carried  (before, after) nodes of the states; a state varies as soon as its next value does
    """
    before = {b for b, _ in carried}
    varying = set(varying)
    while True:
        kinds = _pass(graph, set(moving) | before, varying)
        more = {b for b, a in carried if kinds.varying[a]} - varying
        if not more:
            return kinds
        varying |= more


def _pass(graph: Graph, moving: set[int], varying: set[int]) -> Kinds:
    kinds = Kinds([], [], [])
    for index, node in enumerate(graph.nodes):
        inner = arguments(node)
        kinds.moving.append(index in moving or any(kinds.moving[i] for i in inner))
        kinds.varying.append(index in varying or any(kinds.varying[i] for i in inner))
        selected = node[0] == "select" and kinds.truth[node[2]]
        kinds.truth.append(node[0] in TRUTH or node[0] == "truth" or selected)
    return kinds


@dataclass(frozen=True)
class Plan:
    """A program ready for code generation. Each tuple lists names and nodes in memory order."""

    graph: Graph
    constants: tuple[tuple[str, int], ...]
    inputs: tuple[tuple[str, int], ...]
    states: tuple[Carried, ...]
    outputs: tuple[tuple[str, int], ...]
    tables: tuple[tuple[str, int], ...]
    rings: tuple[tuple[str, int, int], ...]  # name, node and length; their cells lie behind the states
    sample: int | None
    order: tuple[int, ...]  # the nodes to compute, each after its arguments
    kinds: Kinds
    lanes: int
    arithmetic: str
    together: Mapping[int, tuple[int, ...]]  # selection -> those by the same condition evaluated with it; single runs

    @property
    def memory(self) -> list[str]:
        """The names of all numbers that are carried from sample to sample, in memory order."""
        cells = (f"{name}[{i}]" for name, _, length in self.rings for i in range(length))
        return [*(state.name for state in self.states), *cells]


def plan(program: Program, *, lanes: int = 1, varying: Collection[str] = (), arithmetic: str = "exact") -> Plan:
    """Return the plan of a program whose leaves named in `varying` differ between lanes."""
    roots = [*program.outputs.values(), *(node for state in program.states for node in (state.before, state.after))]
    leaves = {**program.constants, **program.inputs, **program.tables}
    graph, place = lower(program.graph, [*roots, *leaves.values()], arithmetic)
    carried = tuple(Carried(s.name, place[s.before], place[s.after]) for s in program.states)
    states = tuple(state for state in carried if graph.name(state.before) != "ring")
    sample = None if program.sample is None else place.get(program.sample)
    # a state that never changes is a constant of the run
    moved = [state for state in carried if state.before != state.after]
    needed = reachable(graph, [*(place[n] for n in program.outputs.values()), *(s.after for s in moved)])
    rings = [index for index in needed if graph.name(index) == "ring"]
    moving = [place[node] for node in program.inputs.values()]
    kinds = classify(
        graph,
        [*moving, *([] if sample is None else [sample]), *(state.before for state in moved), *rings],
        [
            *(place[node] for name, node in program.constants.items() if name in varying),
            *(state.before for state in states if state.name in varying),
            *(rings if lanes > 1 else ()),
        ],
        [(state.before, state.after) for state in moved],
    )
    ends = [state.after for state in moved]
    unordered = Plan(
        graph=graph,
        constants=tuple((name, place[node]) for name, node in program.constants.items()),
        inputs=tuple((name, place[node]) for name, node in program.inputs.items()),
        states=states,
        outputs=tuple((name, place[node]) for name, node in program.outputs.items()),
        tables=tuple((name, place[node]) for name, node in program.tables.items()),
        rings=tuple((graph.nodes[index][1], index, graph.nodes[index][2]) for index in rings),
        sample=sample,
        order=(),
        kinds=kinds,
        lanes=lanes,
        arithmetic=arithmetic,
        together=_together(graph, needed, kinds) if lanes == 1 else {},
    )
    unordered = _in_order(unordered, needed, ends)
    if unordered.together:
        branches = {branch.select for branch in lazy_branches(unordered)}
        worth = {index: group for index, group in unordered.together.items() if group[0] in branches}
        # groups without an expensive branch gain nothing: they keep the order of the trace
        if len(worth) < len(unordered.together):
            unordered = _in_order(replace(unordered, together=worth), needed, ends)
    return unordered


def _in_order(unordered: Plan, needed: list[int], ends: list[int]) -> Plan:
    return replace(
        unordered, order=_ordered(unordered.graph, needed, ends, unordered.together, single=unordered.lanes == 1)
    )


def _together(graph: Graph, needed: list[int], kinds: Kinds) -> dict[int, tuple[int, ...]]:
    """Return, for each selection, its group: the selections that are evaluated together, in place of the first of them.

    A group has a common condition, so results needed on only one side of it, such as the forces of a tooth in the
    cut, share one branch.  All operands of a group were traced before its first selection, so none of its selections
    depends on another.
    """
    open_: dict[int, list[int]] = {}
    groups: list[list[int]] = []
    for index in needed:
        node = graph.nodes[index]
        if node[0] == "select" and kinds.moving[index]:
            group = open_.get(node[1])
            if group is None or max(arguments(node)) >= group[0]:
                group = open_[node[1]] = []
                groups.append(group)
            group.append(index)
    return {index: tuple(group) for group in groups if len(group) >= FEWEST for index in group}


def _ordered(
    graph: Graph, needed: list[int], ends: list[int], together: Mapping[int, tuple[int, ...]], *, single: bool
) -> tuple[int, ...]:
    """Return the order of evaluation: for several lanes that of the trace, for one lane the longest chains first.

    The longest chains are the longest sequences of dependent operations that lead to the next value of a state.  A
    single run waits for such a chain in every sample; a processor that starts it early fills the latency with other
    operations.  With several lanes there are enough other operations, and the order of the trace keeps fewer numbers
    alive.

    A ring buffer is written in place, after all reads of its previous contents.  Selections that are evaluated together
    are consecutive.
    """
    before = reads_first(graph, needed)

    def inner(index: int) -> Sequence[int]:
        group = together.get(index)
        return arguments(graph.nodes[index]) if group is None else _chosen_from(graph, group)

    if not single and not before:
        return tuple(needed)
    depth: dict[int, int] = {}
    for index in needed:
        depth[index] = 1 + max((depth[i] for i in arguments(graph.nodes[index])), default=0)
    order: dict[int, None] = {}
    waited: set[int] = set()
    for end in (*(sorted(ends, key=lambda index: -depth[index]) if single else ()), *needed):
        waiting = [end]
        while waiting:
            last = waiting[-1]
            missing = [i for i in (*inner(last), *before.get(last, ())) if i not in order]
            if missing:
                if before and last in waited and missing[0] in waited:
                    raise StructureError(
                        "a ring is read as it was before a write, at a place that depends on what it is after it"
                    )
                waited.add(last)
                waiting.append(missing[0])
            else:
                waited.discard(last)
                order |= dict.fromkeys(together.get(waiting.pop(), (last,)))
    return tuple(order)


def _chosen_from(graph: Graph, group: Sequence[int]) -> list[int]:
    """Return all operands of a group of selections."""
    return [i for index in group for i in arguments(graph.nodes[index])]


def reads_first(graph: Graph, needed: Collection[int]) -> dict[int, list[int]]:
    """Return, for each write to a ring buffer, the reads of its previous contents, which must be evaluated first.

    Raises StructureError if two writes start from the same contents of a ring buffer, since it is overwritten in place.
    """
    reads: dict[int, list[int]] = {}
    writes: dict[int, int] = {}
    for index in needed:
        node = graph.nodes[index]
        if node[0] == "get":
            reads.setdefault(node[1], []).append(index)
        elif node[0] == "put":
            if node[1] in writes:
                raise StructureError("a ring is written twice from one state: write to what the first write returned")
            writes[node[1]] = index
    return {write: reads.get(state, []) for state, write in writes.items()}


# How numbers are computed, a choice of the run:
#   exact  own elementary functions, every operation rounded by itself: the same bits everywhere (default)
#   libm   the elementary functions of the system's library
#   fma    own functions, and a·b + c may be rounded once: other last bits on other machines
ARITHMETIC = ("exact", "libm", "fma")


def lower(graph: Graph, roots: Sequence[int], arithmetic: str) -> tuple[Graph, dict[int, int]]:
    """Return the graph of the roots, rewritten in operations that the code printers support, and the map from old to
    new nodes.
    """
    return rebuilt(graph, roots, lambda target, name, values: composed(target, name, values, arithmetic))


def composed(graph: Graph, name: str, values: list[Symbol], arithmetic: str) -> Any:
    """Return one operation on symbols, in plain arithmetic if a printer has no such operation."""
    if name in ELEMENTARY and arithmetic != "libm":
        return getattr(mathematics, name)(*values)
    if name == "quantise":
        x, step = values
        return step * ops.floor(x / step + 0.5)
    if name == "gather":
        row, place = values
        return graph.apply("gather", row, _inside(place, graph.nodes[row.index][2]))
    if name in ("get", "put"):
        ring, place, *value = values
        return graph.apply(name, ring, _inside(place, graph.nodes[graph.origin(ring.index)][2]), *value)
    return graph.apply(name, *values)


def _inside(place: Symbol, length: int) -> Symbol:
    """Return the index clamped to the valid memory range."""
    held = ops.clip(place, 0.0, float(length - 1))
    # a NaN passes the clip, and its conversion to an address is undefined
    return ops.where(ops.equal(held, held), held, 0.0)


# In additions. A mispredicted branch costs about twenty; the polynomial of a quarter period of the sine costs less.
LEAST_COST = 32
# Selections by one condition that are evaluated together; fewer would share too little.
FEWEST = 4
_COSTS = {"input": 0, "div": 10, "sqrt": 10, "uniform": 30, "gather": 5} | dict.fromkeys(ELEMENTARY, 40)


class Branch(NamedTuple):
    """A branch of a `select` node or of a group evaluated together: its first node, and 1 for true or 2 for false."""

    select: int
    branch: int


def lazy_branches(plan: Plan) -> dict[Branch, list[int]]:
    """Return, for each branch, the operations that belong to it but not to a branch inside it, in order of
    evaluation.
    """
    places = _places(plan)
    costs: dict[Branch, int] = {}
    nodes = plan.graph.nodes
    for index, place in sorted(places.items()):
        # inner selections have smaller indices: their costs are complete when they are added to the outer one
        for branch in (
            Branch(index, 1),
            Branch(index, 2),
        ):
            if place is not None and branch in costs:
                costs[place] = costs.get(place, 0) + costs[branch]
        if place is not None:
            costs[place] = costs.get(place, 0) + _COSTS.get(nodes[index][0], 1)
    kept = {branch for branch, cost in costs.items() if cost >= LEAST_COST}
    members: dict[Branch, list[int]] = {branch: [] for branch in kept}
    for index in plan.order:
        place = places.get(index)
        while place is not None and place not in kept:
            place = places[place.select]
        if place is not None:
            members[place].append(index)
    return members


def _places(plan: Plan) -> dict[int, Branch | None]:
    """Return, for each operation, the innermost branch that contains all its uses; None if it is always needed."""
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
        group = plan.together.get(index, (index,))
        if group[-1] in places and index != group[-1]:
            continue
        wanted = [branch for node in group for branch in needs[node]]
        # reads and writes of a ring keep their order: none of them moves into a branch
        place = None if nodes[index][0] in ("get", "put") else _common(wanted, places)
        for node in group:
            places[node] = place
            inner = arguments(nodes[node])
            for position, argument in enumerate(inner):
                chosen = nodes[node][0] == "select" and position > 0 and inner[1] != inner[2]
                needs.setdefault(argument, []).append(Branch(group[0], position) if chosen else place)
    return places


def _common(branches: list[Branch | None], places: dict[int, Branch | None]) -> Branch | None:
    """Return the innermost branch that encloses all of `branches`; None if there is none."""
    around = _around(branches[0], places)
    for branch in branches[1:]:
        others = _around(branch, places)
        around = [one for one in around if one in others]
    return around[0] if around else None


def _around(branch: Branch | None, places: dict[int, Branch | None]) -> list[Branch]:
    """Return a branch and all branches that enclose it, from the inside out."""
    branches: list[Branch] = []
    while branch is not None:
        branches.append(branch)
        branch = places[branch.select]
    return branches
