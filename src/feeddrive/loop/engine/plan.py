"""What a printer needs to know: the lowered graph, the order of everything in memory, and the kinds of the nodes."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

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
    sample: int | None
    order: tuple[int, ...]  # the nodes to compute, each after its arguments
    kinds: Kinds
    lanes: int
    arithmetic: str


def plan(program: Program, *, lanes: int = 1, varying: Collection[str] = (), arithmetic: str = "exact") -> Plan:
    """The plan of a program whose leaves named in `varying` differ between lanes."""
    roots = [*program.outputs.values(), *(node for state in program.states for node in (state.before, state.after))]
    leaves = {**program.constants, **program.inputs, **program.tables}
    graph, place = lower(program.graph, [*roots, *leaves.values()], arithmetic)
    states = tuple(Carried(s.name, place[s.before], place[s.after]) for s in program.states)
    sample = None if program.sample is None else place.get(program.sample)
    moved = [state for state in states if state.before != state.after]
    moving = [place[node] for node in program.inputs.values()]
    kinds = classify(
        graph,
        [*moving, *([] if sample is None else [sample]), *(state.before for state in moved)],
        [
            *(place[node] for name, node in program.constants.items() if name in varying),
            *(state.before for state in states if state.name in varying),
        ],
        [(state.before, state.after) for state in moved],
    )
    needed = reachable(graph, [*(place[n] for n in program.outputs.values()), *(s.after for s in moved)])
    return Plan(
        graph=graph,
        constants=tuple((name, place[node]) for name, node in program.constants.items()),
        inputs=tuple((name, place[node]) for name, node in program.inputs.items()),
        states=states,
        outputs=tuple((name, place[node]) for name, node in program.outputs.items()),
        tables=tuple((name, place[node]) for name, node in program.tables.items()),
        sample=sample,
        order=tuple(needed) if lanes > 1 else _longest_first(graph, needed, [s.after for s in moved]),
        kinds=kinds,
        lanes=lanes,
        arithmetic=arithmetic,
    )


def _longest_first(graph: Graph, needed: list[int], ends: list[int]) -> tuple[int, ...]:
    """The order in which the next states with the longest chains of operations come first, with all that they need.

    A single run waits for such a chain from sample to sample: a processor that meets it early fills the waiting with
    the rest.  With lanes there is enough to fill it, and the order of the trace keeps fewer numbers alive.
    """
    depth: dict[int, int] = {}
    for index in needed:
        depth[index] = 1 + max((depth[i] for i in arguments(graph.nodes[index])), default=0)
    order: dict[int, None] = {}
    for end in (*sorted(ends, key=lambda index: -depth[index]), *needed):
        waiting = [end]
        while waiting:
            missing = [i for i in arguments(graph.nodes[waiting[-1]]) if i not in order]
            if missing:
                waiting.append(missing[0])
            else:
                order[waiting.pop()] = None
    return tuple(order)
