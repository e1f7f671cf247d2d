"""One sample of a control as a linear model: its entries and their slopes, in Python or by machine code."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np

from feeddrive.blocks.signals import Setpoint
from feeddrive.language import tree
from feeddrive.language.block import Number
from feeddrive.language.graph import Graph, Symbol, reachable
from feeddrive.language.recent import Recent
from feeddrive.loop.beginning import PAYS_AFTER
from feeddrive.loop.control import Control
from feeddrive.loop.engine.native import Native, native
from feeddrive.loop.engine.plan import plan
from feeddrive.loop.trace import Program, node_values
from feeddrive.loop.traced_model import push

READINGS = ("reading_motor", "reading_load")


@dataclass(frozen=True, eq=False)
class TracedControl:
    """The linear model of a control as nodes of a graph: its entries that are not plain zeros, by row and column.

    Rows are the states after a sample and the force, columns the states before it and the two readings.
    """

    graph: Graph
    entries: tuple[tuple[int, int, int], ...]  # row, column, node
    inputs: Mapping[str, int]  # parameters by name
    states: tuple[str, ...]
    after: tuple[int, ...]  # nodes of the states after a sample
    force: int  # node of the command
    _walks: dict[tuple[str, ...], Walk] = field(default_factory=dict)

    def walk(self, tunables: tuple[str, ...]) -> Walk:
        """Numbers and slopes of the entries for a set of tunables; kept, with its machine code."""
        return self._walks.setdefault(tunables, Walk(self, tunables))


_traced: Recent[TracedControl] = Recent(64)


def traced_control(control: Control, begun: Any) -> TracedControl:
    """The linear model of one sample of a control in the state `begun`; kept by structure."""
    return _traced.get(tree.structure(control), lambda: _trace(control, begun))


def _trace(control: Control, begun: Any) -> TracedControl:
    """One sample of the control on symbols, and its forward slopes to states and readings, on symbols as well."""
    graph = Graph()

    def symbol(name: str) -> Number:
        return cast(Number, graph.input(name))

    rows = {name: graph.table(name, len(row)) for name, row in tree.tables(control)}
    names = [name for name, _ in tree.leaves(control)]
    symbolic = tree.with_tables(tree.rebuild(control, (symbol(name) for name in names)), rows)
    T = symbol("T")
    states = tuple(name for name, _ in tree.leaves(begun))
    state = tree.rebuild(begun, (symbol(f"state.{name}") for name in states))
    setpoint = Setpoint(*(symbol(f"set.{name}") for name in Setpoint._fields))
    motor, load = (symbol(name) for name in READINGS)
    after, command = symbolic.step(symbolic.prepare(T), state, setpoint, motor, load, 1.0, T)
    ends = [graph.symbol(value).index for _, value in tree.leaves(after)] + [graph.symbol(command.applied).index]
    columns = [graph.input(f"state.{name}").index for name in states] + [graph.input(name).index for name in READINGS]
    values = {i: Symbol(graph, i) for i in range(len(graph.nodes))}
    entries: list[tuple[int, int, int]] = []
    for j, column in enumerate(columns):
        for i, tangent in enumerate(push(graph, ends, values, {column: 1.0})):
            if tangent is not None:
                node = graph.symbol(tangent).index
                if graph.nodes[node] != ("const", (0.0).hex()):
                    entries.append((i, j, node))
    places = {name: graph.input(name).index for name in names}
    return TracedControl(graph, tuple(entries), places, states, tuple(ends[:-1]), ends[-1])


class Walk:
    """The entries of a traced control and their slopes to tunables, at numbers for all inputs.

    The first points of a structure are computed in Python, later ones by machine code of the same graph and of its
    slopes on symbols, with the same bits: a hundred to a thousand times quicker.
    """

    def __init__(self, traced: TracedControl, tunables: tuple[str, ...]) -> None:
        self.traced, self.tunables = traced, tunables
        self._nodes = [node for _, _, node in traced.entries]
        kinds = {traced.graph.nodes[i][0] for i in reachable(traced.graph, self._nodes)}
        self._seen, self._possible = 0, not kinds & {"table", "ring"}
        self._native: tuple[Native, list[str]] | None = None

    def at(self, leaves: Mapping[str, Any], points: int, *, with_slopes: bool) -> tuple[np.ndarray, np.ndarray]:
        """Entries (points, entries) and slopes to the tunables (points, entries, tunables), empty if not wanted.

        leaves  all inputs of the trace by name: numbers, or a number for each point
        """
        self._seen += points
        if not self._possible or self._seen <= PAYS_AFTER:
            return self._in_python(leaves, points, with_slopes=with_slopes)
        code, names = self._native = self._native or self._compiled()
        rows = np.array([np.broadcast_to(leaves[name], points) for name in names], dtype=np.float64).T.copy()
        nothing, answers = np.empty((1, 0)), np.empty((points, 1 + len(self.tunables), len(self._nodes)))
        for row, answer in zip(rows, answers, strict=True):
            code.run(1, 0, row, nothing, nothing[0], answer, ())
        slopes = answers[:, 1:].transpose(0, 2, 1)
        return answers[:, 0], slopes if with_slopes else slopes[:, :, :0]

    def _in_python(self, leaves: Mapping[str, Any], points: int, *, with_slopes: bool) -> tuple[np.ndarray, np.ndarray]:
        traced, count = self.traced, len(self.tunables) if with_slopes else 0
        numbers = node_values(traced.graph, self._nodes, leaves)
        values, slopes = np.zeros((points, len(self._nodes))), np.zeros((points, len(self._nodes), count))
        for i, node in enumerate(self._nodes):
            values[:, i] = numbers[node]
        if count:
            eye, places = np.eye(count)[:, :, None], [traced.inputs[name] for name in self.tunables]
            seeds = {place: one for place, one in zip(places, eye, strict=True) if place in numbers}
            with np.errstate(all="ignore"):
                tangents = push(traced.graph, self._nodes, numbers, seeds)
            for i, tangent in enumerate(tangents):
                if tangent is not None:
                    slopes[:, i] = np.broadcast_to(tangent, (count, points)).T
        return values, slopes

    def _compiled(self) -> tuple[Native, list[str]]:
        """Machine code of the entries and of their slopes to each tunable, and the names of its inputs."""
        graph = self.traced.graph
        values = {i: Symbol(graph, i) for i in range(len(graph.nodes))}
        ends = [*self._nodes]
        for name in self.tunables:
            tangents = push(graph, self._nodes, values, {self.traced.inputs[name]: 1.0})
            ends += [graph.symbol(0.0 if tangent is None else tangent).index for tangent in tangents]
        names = [node[1] for node in (graph.nodes[i] for i in reachable(graph, ends)) if node[0] == "input"]
        program = Program(
            graph=graph,
            constants={name: graph.input(name).index for name in names},
            inputs={},
            states=(),
            outputs={str(place): node for place, node in enumerate(ends)},
            sample=None,
            tables={},
        )
        return native(plan(program), flush=False, quick=True), names


def needed(traced: TracedControl) -> list[int]:
    """The states that depend on a reading and act on the force."""
    n = len(traced.states)
    links = {(i, j) for i, j, _ in traced.entries}
    reached = {i for i, j in links if j >= n and i < n}
    seen = {j for i, j in links if i == n and j < n}
    for _ in range(n):
        reached |= {i for i, j in links if i < n and j in reached}
        seen |= {j for i, j in links if j < n and i in seen}
    return sorted(reached & seen)
