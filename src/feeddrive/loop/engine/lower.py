"""Lowering: every composed operation is replaced by plain arithmetic, traced from the code that Python runs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from feeddrive.language import mathematics, ops
from feeddrive.language.graph import ELEMENTARY, Graph, Symbol, rebuilt

# How numbers are computed, a choice of the run:
#   exact  own elementary functions, every operation rounded by itself: the same bits everywhere (default)
#   libm   the elementary functions of the system's library
#   fma    own functions, and a·b + c may be rounded once: other last bits on other machines
ARITHMETIC = ("exact", "libm", "fma")


def lower(graph: Graph, roots: Sequence[int], arithmetic: str) -> tuple[Graph, dict[int, int]]:
    """The graph below the roots in the operations that printers know, and where each old node went."""
    return rebuilt(graph, roots, lambda made, name, values: composed(made, name, values, arithmetic))


def composed(graph: Graph, name: str, values: list[Symbol], arithmetic: str) -> Any:
    """One operation on symbols, in plain arithmetic where a printer has no word for it."""
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
    """A place that is one of the memory, whatever the number is."""
    held = ops.clip(place, 0.0, float(length - 1))
    return ops.where(ops.equal(held, held), held, 0.0)
