"""The steady curve of a friction block over velocity, with its slopes to the block's own parameters."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any, cast

import numpy as np

from feeddrive.blocks.families import Friction
from feeddrive.language import tree
from feeddrive.language.block import Number
from feeddrive.language.graph import Graph, Symbol
from feeddrive.loop.differentiate import push
from feeddrive.loop.trace import evaluate


class SteadyCurve:
    """`friction.steady` traced once, with its forward tangents: what a fit regresses on is what the loop simulates.

    names  of the parameters, in the order of the block's leaves
    """

    def __init__(self, friction: Friction) -> None:
        graph = Graph()
        self.names = tuple(name for name, _ in tree.leaves(friction))
        leaves = [graph.input(name) for name in self.names]
        symbolic = tree.rebuild(friction, (cast(Number, leaf) for leaf in leaves))
        force = graph.symbol(symbolic.steady(cast(Number, graph.input("velocity")))).index
        values = {i: Symbol(graph, i) for i in range(len(graph.nodes))}
        slopes = [push(graph, [force], values, {leaf.index: 1.0})[0] for leaf in leaves]
        self.graph, self.force = graph, force
        self.slopes = [graph.symbol(0.0 if slope is None else slope).index for slope in slopes]

    def at(self, velocity: np.ndarray, values: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray]:
        """Force against the motion and its slopes on a last axis; values are numbers or broadcast with the velocity."""
        leaves = {name: np.asarray(values[name], np.float64) for name in self.names}
        shape = np.broadcast_shapes(velocity.shape, *(each.shape for each in leaves.values()))
        force, *slopes = evaluate(self.graph, [self.force, *self.slopes], {**leaves, "velocity": velocity})
        return np.broadcast_to(force, shape), np.stack([np.broadcast_to(each, shape) for each in slopes], axis=-1)


@lru_cache(maxsize=32)
def steady_curve(friction: Friction) -> SteadyCurve:
    """The traced curve of a block; the numbers of the block do not matter."""
    return SteadyCurve(friction)
