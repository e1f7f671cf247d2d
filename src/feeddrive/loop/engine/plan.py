"""What a printer needs to know: the lowered graph, the order of everything in memory, and the kinds of the nodes."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from feeddrive.language.graph import Graph, reachable
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
    order: tuple[int, ...]  # the nodes to compute
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
        order=tuple(needed),
        kinds=kinds,
        lanes=lanes,
        arithmetic=arithmetic,
    )
