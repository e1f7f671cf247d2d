"""Forces of blocks over measured motion, with derivatives to their parameters: the regressors of the fits."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import Any, Generic, TypeVar, cast

import numpy as np

from feeddrive.blocks.families import Friction
from feeddrive.language import tree
from feeddrive.language.block import Block, Number
from feeddrive.language.graph import Graph, Symbol
from feeddrive.loop.differentiate import push
from feeddrive.loop.trace import evaluate

B = TypeVar("B", bound=Block)


class TracedForce(Generic[B]):
    """A force that a block computes from arguments, traced once, with its forward tangents.

    `force` takes the block with symbols for its leaves and the arguments by name; `names` are the block's leaves.
    """

    def __init__(self, block: B, arguments: Sequence[str], force: Callable[[B, Mapping[str, Number]], Number]) -> None:
        graph = Graph()
        self.names, self.arguments = tuple(name for name, _ in tree.leaves(block)), tuple(arguments)
        leaves = [graph.input(name) for name in self.names]
        symbolic = tree.rebuild(block, (cast(Number, leaf) for leaf in leaves))
        given = {name: cast(Number, graph.input(f"of {name}")) for name in self.arguments}
        end = graph.symbol(force(symbolic, given)).index
        values = {i: Symbol(graph, i) for i in range(len(graph.nodes))}
        slopes = [push(graph, [end], values, {leaf.index: 1.0})[0] for leaf in leaves]
        self.graph = graph
        self.ends = [end, *(graph.symbol(0.0 if slope is None else slope).index for slope in slopes)]

    def at(self, values: Mapping[str, Any], **arguments: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The force, and its slopes on a last axis; values of leaves are numbers, or arrays that broadcast."""
        leaves = {name: np.asarray(values[name], np.float64) for name in self.names}
        leaves |= {f"of {name}": np.asarray(arguments[name], np.float64) for name in self.arguments}
        shape = np.broadcast_shapes(*(each.shape for each in leaves.values()))
        force, *slopes = evaluate(self.graph, self.ends, leaves)
        return np.broadcast_to(force, shape), np.stack([np.broadcast_to(each, shape) for each in slopes], axis=-1)


@lru_cache(maxsize=32)
def steady_curve(friction: Friction) -> TracedForce[Friction]:
    """`friction.steady` over "velocity"; the numbers of the block do not matter."""
    return TracedForce(friction, ("velocity",), lambda block, given: block.steady(given["velocity"]))
