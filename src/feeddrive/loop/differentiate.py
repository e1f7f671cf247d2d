"""Forward-mode derivatives of a graph: one rule per operation, for numbers and symbolic nodes alike."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from feeddrive.language import ops
from feeddrive.language.graph import Graph, arguments, reachable
from feeddrive.language.ring import Ring

# A tangent that is zero whatever the values is None, and costs nothing.


def _scaled(factor: Any, tangent: Any) -> Any:
    return None if tangent is None else factor * tangent


def _sum(a: Any, b: Any) -> Any:
    return b if a is None else a if b is None else a + b


def _difference(a: Any, b: Any) -> Any:
    return a if b is None else -b if a is None else a - b


def rule(name: str, values: Sequence[Any], result: Any, tangents: Sequence[Any]) -> Any:
    """The tangent of one operation from its arguments' values and tangents and its result.

    At a tie of `where` the tangent is that of the branch that is taken.  Rounding and table reads have slope 0, except
    `quantise`, whose slope to its first argument is taken as 1.
    """
    if all(tangent is None for tangent in tangents):
        return None
    match name:
        case "add":
            return _sum(tangents[0], tangents[1])
        case "sub":
            return _difference(tangents[0], tangents[1])
        case "mul":
            return _sum(_scaled(values[1], tangents[0]), _scaled(values[0], tangents[1]))
        case "div":
            above = _difference(tangents[0], _scaled(result, tangents[1]))
            return above / values[1]
        case "neg":
            return -tangents[0]
        case "abs":
            return ops.where(values[0] < 0.0, -tangents[0], tangents[0])
        case "sqrt":
            return tangents[0] / (2.0 * result)
        case "exp":
            return result * tangents[0]
        case "expm1":
            return (result + 1.0) * tangents[0]
        case "log":
            return tangents[0] / values[0]
        case "sin":
            return ops.cos(values[0]) * tangents[0]
        case "cos":
            return -(ops.sin(values[0]) * tangents[0])
        case "tanh":
            return (1.0 - result * result) * tangents[0]
        case "atan":
            return tangents[0] / (1.0 + values[0] * values[0])
        case "select":
            if tangents[1] is None and tangents[2] is None:
                return None
            zero = 0.0
            a = zero if tangents[1] is None else tangents[1]
            b = zero if tangents[2] is None else tangents[2]
            return ops.where(values[0], a, b)
        case "quantise":
            return tangents[0]
        case "get":  # the tangent of a ring is a ring
            return None if tangents[0] is None else tangents[0].get(values[1])
        case "put":
            ring = Ring(values[0].length) if tangents[0] is None else tangents[0]
            return None if tangents[0] is None and tangents[2] is None else ring.put(values[1], _number(tangents[2]))
        case _:
            return None


def _number(tangent: Any) -> Any:
    return 0.0 if tangent is None else tangent


def push(graph: Graph, outputs: Sequence[int], values: Mapping[int, Any], seeds: Mapping[int, Any]) -> list[Any]:
    """The tangents of nodes, from the tangents `seeds` of leaves; None where a node does not depend on them.

    `values` holds the value of every node: numbers, or the nodes' own symbols, whose tangents are then symbols of the
    same graph.
    """
    found: dict[int, Any] = dict(seeds)
    for index in reachable(graph, outputs):
        node = graph.nodes[index]
        inner = arguments(node)
        if inner and index not in found:
            tangents = [found.get(i) for i in inner]
            if any(tangent is not None for tangent in tangents):
                found[index] = rule(node[0], [values[i] for i in inner], values[index], tangents)
    return [found.get(index) for index in outputs]
