"""A layout executed in Python in the precision of the target: the reference, bit for bit, for single precision.

`configure` and `retune` run in double precision, `reset` and `step` in that of the layout.  Subnormal numbers count as
zero, as they are configured to on the targets.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from importlib import import_module
from typing import Any

import numpy as np

from feeddrive.export.layout import Layout
from feeddrive.language import matrix
from feeddrive.language.graph import ELEMENTARY, Graph, arguments, reachable

_OPERATIONS: dict[str, Callable[..., Any]] = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": lambda a, b: a / b,
    "neg": lambda a: -a,
    "abs": np.abs,
    "sqrt": np.sqrt,
    "floor": np.floor,
    "lt": lambda a, b: bool(a < b),
    "le": lambda a, b: bool(a <= b),
    "eq": lambda a, b: bool(a == b),
    "and": lambda a, b: a and b,
    "or": lambda a, b: a or b,
    "not": lambda a: not a,
    "select": lambda condition, a, b: a if condition else b,
    "power_of_two": lambda k: type(k)(np.ldexp(1.0, int(k))),
    "exponent": lambda x: type(x)(np.frexp(x)[1] - 1 if x != 0.0 else np.finfo(type(x)).minexp - 1),
    "gather": lambda row, place: row[int(place)],
    "decays": lambda *entries: bool(matrix.decays(np.reshape(entries, (math.isqrt(len(entries)), -1)).tolist())),
}


class LayoutRun:
    """A controller or a plant executed from its layout; see the module. Slow: some 10 000 operations in 10 ms."""

    def __init__(self, layout: Layout, parameters: Mapping[str, float] | None = None, *, wide: bool = False) -> None:
        """`parameters` are other values than those of the machine file, by dotted name; `wide`: in double precision."""
        self.layout = layout
        self.real: Any = np.float64 if wide or layout.precision == "double" else np.float32
        given = {v.path: v.value for v in layout.routine.parameters} | dict(parameters or {})
        self.parameters = given
        self.state: list[Any] = []
        self.design = self._configured()

    def _configured(self) -> dict[int, Any]:
        """The numbers that `configure` stores, by node, rounded once."""
        nodes = [field.node for field in self.layout.design]
        found = self.values(nodes)
        kept = (value if isinstance(value, bool) else self._rounded(value) for value in found)
        return dict(zip(nodes, kept, strict=True))

    def values(self, nodes: list[int]) -> list[Any]:
        """Values, in double precision, of nodes that depend on parameters only."""
        values = self._tables(np.float64)
        for node, (kind, i) in self.layout.leaves.items():
            if kind == "parameter":
                values[node] = np.float64(self.parameters[self.layout.routine.parameters[i].path])
            elif kind == "sample_time":
                values[node] = np.float64(self.layout.routine.sample_time)
        return evaluated(self.layout.graph, nodes, values, np.float64)

    def _rounded(self, value: Any) -> Any:
        with np.errstate(over="ignore", under="ignore"):
            return self.real(value)

    def _tables(self, real: Any) -> dict[int, Any]:
        rows = self.layout.routine.tables
        return {node: real(rows[i][2]) for node, (kind, i) in self.layout.leaves.items() if kind == "table"}

    def reset(self, inputs: Iterable[float]) -> list[Any]:
        """Start at the position of the axis; returns the first outputs of a plant."""
        return self._advance(self.layout.reset, inputs)

    def step(self, inputs: Iterable[float]) -> list[Any]:
        """One sample: the outputs in the order of the routine."""
        return self._advance(self.layout.step, inputs)

    def _advance(self, function: Any, inputs: Iterable[float]) -> list[Any]:
        layout = self.layout
        given = {"input": [self._rounded(x) for x in inputs], "state": self.state}
        values = {
            node: given[kind][i] for node, (kind, i) in layout.leaves.items() if kind in given and i < len(given[kind])
        }
        ends = [*function.states, *function.outputs]
        found = evaluated(layout.graph, ends, values | self._tables(self.real) | self.design, self.real)
        self.state = found[: len(function.states)]
        return found[len(function.states) :]

    def retune(self, changes: Mapping[str, float]) -> None:
        """Change parameters, by dotted name."""
        layout, routine = self.layout, self.layout.routine
        before, design = dict(self.parameters), self.design
        self.parameters = before | dict(changes)
        self.design = self._configured()
        assert layout.retune is not None
        values: dict[int, Any] = {}
        for node, (kind, i) in layout.retune.leaves.items():
            if kind == "state":
                values[node] = np.float64(self.state[i])
            elif kind in ("old", "new"):
                values[node] = np.float64((before if kind == "old" else self.parameters)[routine.parameters[i].path])
            elif i in routine.prepared_leaves:
                made = layout.prepared[routine.prepared_leaves.index(i)][1]
                held = design if kind == "old_prepared" else self.design
                constant = layout.graph.nodes[made]
                values[node] = np.float64(float.fromhex(constant[1]) if constant[0] == "const" else held.get(made, 0.0))
        found = evaluated(layout.retune.graph, list(layout.retune.states), values, np.float64)
        self.state = [self._rounded(x) for x in found]


def evaluated(graph: Graph, ends: list[int], leaves: Mapping[int, Any], real: Any) -> list[Any]:
    """The values of some nodes, each operation rounded to `real`; subnormal numbers are zero."""
    values: dict[int, Any] = dict(leaves)
    least = np.finfo(real).tiny
    with np.errstate(all="ignore"):
        for index in _needed(graph, ends, values):
            node = graph.nodes[index]
            if node[0] == "const":
                values[index] = real(float.fromhex(node[1]))
            elif node[0] == "truth":
                values[index] = node[1]
            else:
                given = [_flushed(values[i], least) for i in arguments(node)]
                operation = _OPERATIONS.get(node[0])
                result = elementary(node[0], given[0], real) if operation is None else operation(*given)
                values[index] = _flushed(result, least) if node[0] != "select" else result
    return [values[index] for index in ends]


def _flushed(value: Any, least: Any) -> Any:
    """The number, or zero of its sign if it is subnormal."""
    if isinstance(value, (bool, np.ndarray)) or not abs(value) < least:
        return value
    return value * type(value)(0.0)


def _needed(graph: Graph, ends: list[int], known: Mapping[int, Any]) -> list[int]:
    """The nodes to compute, in order, without known ones and their arguments."""
    found: set[int] = set()
    stack = [index for index in ends if index not in known]
    while stack:
        index = stack.pop()
        if index in found:
            continue
        found.add(index)
        stack.extend(i for i in arguments(graph.nodes[index]) if i not in known)
    return sorted(found)


_graphs: dict[tuple[str, Any], tuple[Graph, int, int]] = {}


def elementary(name: str, x: Any, real: Any) -> Any:
    """An elementary function by its own plain arithmetic in a precision."""
    assert name in ELEMENTARY, f"no operation '{name}' in {real.__name__}"
    key = (name, real)
    if key not in _graphs:
        module = import_module(f"feeddrive.language.{'mathematics' if real is np.float64 else 'single'}")
        graph = Graph()
        given = graph.input("x")
        result = graph.symbol(getattr(module, name)(given)).index
        assert reachable(graph, [result])
        _graphs[key] = (graph, given.index, result)
    graph, given, result = _graphs[key]
    return evaluated(graph, [result], {given: x}, real)[0]
