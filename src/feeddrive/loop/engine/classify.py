"""Classification of graph nodes: constant over a run, different between lanes, or a truth value."""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

from feeddrive.language.graph import TRUTH, Graph, arguments


class Kinds(NamedTuple):
    """For every node, in order: does it change from sample to sample, from lane to lane, is it a truth value?"""

    moving: list[bool]
    varying: list[bool]
    truth: list[bool]


def classify(
    graph: Graph, moving: Collection[int], varying: Collection[int], carried: Collection[tuple[int, int]]
) -> Kinds:
    """Kinds of all nodes.

    moving   nodes that are given at each sample (inputs, the sample index)
    varying  leaves that differ between lanes (constants, states that start differently)
    carried  (before, after) of the states; a state varies as soon as its next value does
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
