"""The plan that a code printer works from: lowered graph, memory order, and the kind of each node."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from feeddrive.language.errors import StructureError
from feeddrive.language.graph import Graph, arguments, reachable
from feeddrive.loop.engine.classify import Kinds, classify
from feeddrive.loop.engine.lower import lower
from feeddrive.loop.trace import Carried, Program


@dataclass(frozen=True)
class Plan:
    """A program ready to be printed. Each tuple is in the order of its memory: (name, node)."""

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

    @property
    def memory(self) -> list[str]:
        """The names of all numbers that are carried from sample to sample, in the order of memory."""
        cells = (f"{name}[{i}]" for name, _, length in self.rings for i in range(length))
        return [*(state.name for state in self.states), *cells]


def plan(program: Program, *, lanes: int = 1, varying: Collection[str] = (), arithmetic: str = "exact") -> Plan:
    """The plan of a program whose leaves named in `varying` differ between lanes."""
    roots = [*program.outputs.values(), *(node for state in program.states for node in (state.before, state.after))]
    leaves = {**program.constants, **program.inputs, **program.tables}
    graph, place = lower(program.graph, [*roots, *leaves.values()], arithmetic)
    carried = tuple(Carried(s.name, place[s.before], place[s.after]) for s in program.states)
    states = tuple(state for state in carried if graph.name(state.before) != "ring")
    sample = None if program.sample is None else place.get(program.sample)
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
    return Plan(
        graph=graph,
        constants=tuple((name, place[node]) for name, node in program.constants.items()),
        inputs=tuple((name, place[node]) for name, node in program.inputs.items()),
        states=states,
        outputs=tuple((name, place[node]) for name, node in program.outputs.items()),
        tables=tuple((name, place[node]) for name, node in program.tables.items()),
        rings=tuple((graph.nodes[index][1], index, graph.nodes[index][2]) for index in rings),
        sample=sample,
        order=_ordered(graph, needed, ends, single=lanes == 1),
        kinds=kinds,
        lanes=lanes,
        arithmetic=arithmetic,
    )


def _ordered(graph: Graph, needed: list[int], ends: list[int], *, single: bool) -> tuple[int, ...]:
    """The order of evaluation: that of the trace with lanes; of a single run the longest chains first.

    The longest chains are those of the next states with the most operations in a row, with all that they need.  A
    single run waits for such a chain from sample to sample: a processor that meets it early fills the waiting with the
    rest.  With lanes there is enough to fill it, and the order of the trace keeps fewer numbers alive.

    A ring is written in place, after all reads of its previous contents.
    """
    before = reads_first(graph, needed)
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
            missing = [i for i in (*arguments(graph.nodes[last]), *before.get(last, ())) if i not in order]
            if missing:
                if before and last in waited and missing[0] in waited:
                    raise StructureError(
                        "a ring is read as it was before a write, at a place that depends on what it is after it"
                    )
                waited.add(last)
                waiting.append(missing[0])
            else:
                waited.discard(last)
                order[waiting.pop()] = None
    return tuple(order)


def reads_first(graph: Graph, needed: Collection[int]) -> dict[int, list[int]]:
    """For each write to a ring the reads of its cells as they were before, which come first.

    Raises StructureError where a ring is written twice from one state, which memory that is written in place cannot do.
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
