"""What is fixed by the export, since a PLC should not compute it: design numbers that take too many operations.

A filter takes some 30 operations, the gains of a pole placement 100, a matrix exponential 700 to 10 000.  What is above
the bound stands in the text as first values, and the parameters that it depends on are no parameters any more: to
change them is to export anew.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from feeddrive.export.layout import Layout
from feeddrive.export.layout_run import LayoutRun
from feeddrive.language.graph import Graph, arguments, reachable
from feeddrive.loop.routine import Variable

MOST_OPERATIONS = 500  # behind one design number


@dataclass(frozen=True)
class Fixed:
    """What is fixed by the export: design numbers with their values, and the parameters behind them.

    nodes  values of the nodes that depend on fixed parameters alone and are read by rules on others
    """

    fields: Mapping[str, float]
    parameters: tuple[Variable, ...]
    nodes: Mapping[int, float]


def fixed(layout: Layout) -> Fixed:
    """The design numbers that take too many operations, and what depends on the same parameters alone."""
    leaves = layout.leaves
    held: set[int] = set()
    below = {field.name: set(reachable(layout.graph, [field.node])) for field in layout.design}
    for nodes in below.values():
        if len(nodes) > MOST_OPERATIONS:
            held |= {node for node in nodes if leaves.get(node, ("", 0))[0] == "parameter"}
    values = LayoutRun(layout).design
    found: dict[str, float] = {}
    for field in layout.design:
        given = {node for node in below[field.name] if leaves.get(node, ("", 0))[0] == "parameter"}
        if given and given <= held:
            found[field.name] = float(values[field.node])
    routine = layout.routine
    return Fixed(
        found, tuple(routine.parameters[leaves[node][1]] for node in sorted(held)), _read_by_rules(layout, held)
    )


def _read_by_rules(layout: Layout, held: set[int]) -> dict[int, float]:
    """What rules on other parameters read of fixed ones: the operations nearest to the rules, with their values."""
    graph, leaves = layout.graph, layout.leaves
    free = [kind == "parameter" and node not in held for node, (kind, _) in leaves.items()]
    moving = {node for node, moves in zip(leaves, free, strict=True) if moves}
    depends: list[bool] = []
    for index, node in enumerate(graph.nodes):
        depends.append(index in moving or any(depends[i] for i in arguments(node)))
    wanted: set[int] = set()
    for rule in layout.conditions[len(layout.routine.parameters) :]:
        if depends[rule]:
            for index in reachable(graph, [rule]):
                if depends[index]:
                    wanted |= {i for i in arguments(graph.nodes[index]) if not depends[i]}
    wanted = {i for i in wanted if graph.nodes[i][0] not in ("const", "truth", "input") and reaches(graph, i, held)}
    values = LayoutRun(layout, wide=True).values(sorted(wanted))
    return dict(zip(sorted(wanted), values, strict=True))


def reaches(graph: Graph, node: int, held: set[int]) -> bool:
    """Whether a node depends on one of some others."""
    return bool(held & set(reachable(graph, [node])))
