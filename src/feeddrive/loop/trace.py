"""Tracing: from a loop to a program, the graph of one sample with named inputs, states and outputs."""

from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Self, TypeVar, cast

import numpy as np

from feeddrive.blocks.signals import Noise
from feeddrive.language import ops, tree
from feeddrive.language.block import Number
from feeddrive.language.graph import Graph, arguments, reachable
from feeddrive.language.ring import Ring

Whole = TypeVar("Whole")


class Carried(NamedTuple):
    """A number carried from sample to sample: its name, the node that reads it and the node of its next value."""

    name: str
    before: int
    after: int


@dataclass(frozen=True, eq=False)
class Program:
    """The graph of one sample with named inputs, states and outputs, which the engine runs, linearizes and
    differentiates.

    constants  name -> node: parameters (`control.law.Kv`), coefficients (`prepared.axis.change.0.1`), `seed`
    inputs     name -> node, one value per sample: `set_position` ... `set_snap`, `load_force`, `enable`, probes;
               for a machine prefixed by the axis: `x.set_position`
    states     numbers carried from sample to sample
    outputs    name -> node: the signals
    sample     node of the index k of the sample, or None
    tables     name -> node
    key        identifier of the trace: programs with equal keys have equal graphs; None if unknown
    """

    graph: Graph
    constants: dict[str, int]
    inputs: dict[str, int]
    states: tuple[Carried, ...]
    outputs: dict[str, int]
    sample: int | None
    tables: dict[str, int]
    key: Hashable = None

    def keeping(self, outputs: Sequence[str]) -> Self:
        """Return the program with these outputs only, without operations that they do not need."""
        kept = {name: self.outputs[name] for name in outputs}
        needed = set(reachable(self.graph, [*kept.values(), *(state.after for state in self.states)]))
        return replace(
            self,
            outputs=kept,
            constants={name: node for name, node in self.constants.items() if node in needed},
            inputs={name: node for name, node in self.inputs.items() if node in needed},
            tables={name: node for name, node in self.tables.items() if node in needed},
            sample=self.sample if self.sample in needed else None,
        )


def concrete(loop: Whole) -> Whole:
    """Return a loop, or a part of it, with numpy numbers as leaves: division by zero and overflow follow IEEE 754."""
    return tree.rebuild(loop, (v if isinstance(v, np.ndarray) else np.float64(v) for _, v in tree.leaves(loop)))


def numbers(values: Any, prefix: str) -> Iterator[tuple[str, Any]]:
    """Yield names and values of the precomputed coefficients; constants of the code remain part of the program."""
    for name, value in tree.leaves(values, prefix):
        if type(value) is not float:
            yield name, value


def trace(system: Any, template: Any, begun: Any, names: Sequence[str]) -> Program:
    """Return the program of a loop or a machine.

    `template` and `begun` are its precomputed coefficients and initial state, of which only the structure matters.
    `names` are the inputs of the program, such as `set_position` or `x.load_force`; other inputs add no operations.
    Raises StructureError if a law uses operations outside `ops`.
    """
    graph = Graph()
    constants: dict[str, int] = {}
    inputs: dict[str, int] = {}

    # symbols pass for numbers from here on: the third kind that a law runs on
    def constant(name: str) -> Number:
        symbol = graph.input(name)
        constants[name] = symbol.index
        return cast(Number, symbol)

    def signal(name: str) -> Number:
        symbol = graph.input(name)
        inputs[name] = symbol.index
        return cast(Number, symbol)

    rows = {name: graph.table(name, len(row)) for name, row in tree.tables(system)}
    symbolic = tree.with_tables(tree.rebuild(system, (constant(name) for name, _ in tree.leaves(system))), rows)
    prepared = tree.rebuild(
        template,
        # a plain float is a constant in the code of `prepare`: it stays one in the graph
        (v if type(v) is float else constant(name) for name, v in tree.leaves(template, "prepared")),
    )
    states = [name for name, _ in tree.leaves(begun)]
    before = tree.rebuild(begun, (leaf(graph, f"state.{name}", value) for name, value in tree.leaves(begun)))
    sample = graph.input("sample")
    signals_in = {name: signal(name) for name in names}
    noise = Noise(constant("seed"), cast(Number, sample))
    after, signals = symbolic.sample(prepared, before, signals_in, noise, cast(Number, sample * symbolic.sample_time))
    carried = tuple(
        Carried(name, node(graph, first), node(graph, value))
        for name, (_, first), (_, value) in zip(states, tree.leaves(before), tree.leaves(after), strict=True)
    )
    return Program(
        graph=graph,
        constants=constants,
        inputs=inputs,
        states=carried,
        outputs={name: graph.symbol(value).index for name, value in signals.items()},
        sample=sample.index,
        tables={name: row.index for name, row in rows.items()},
    )


def leaf(graph: Graph, name: str, value: Any) -> Any:
    """Return the symbol for a leaf of a state in a trace: a number, or a ring buffer of the same length."""
    return Ring(value.length, graph.ring(name, value.length)) if isinstance(value, Ring) else graph.input(name)


def node(graph: Graph, value: Any) -> int:
    """Return the node of a number or a ring buffer."""
    return graph.symbol(value.cells if isinstance(value, Ring) else value).index


def lengths(graph: Graph, index: int) -> int | None:
    """Return the number of cells of a ring buffer, whether before or after a write; None for a number."""
    origin = graph.nodes[graph.origin(index)]
    return origin[2] if origin[0] == "ring" else None


_PLAIN: dict[str, Any] = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": lambda a, b: a / b,
    "neg": lambda a: -a,
    "lt": lambda a, b: a < b,
    "le": lambda a, b: a <= b,
    "abs": ops.absolute,
    "and": ops.both,
    "or": ops.either,
    "not": ops.no,
    "eq": ops.equal,
    "select": ops.where,
    "get": lambda ring, place: ring.get(place),
    "put": lambda ring, place, value: ring.put(place, value),
}


def apply(name: str, *values: Any) -> Any:
    """Apply one operation of a graph to floats, arrays or symbols."""
    function = _PLAIN.get(name) or getattr(ops, name)
    return function(*values)


def node_values(graph: Graph, outputs: Sequence[int], leaves: Mapping[str, Any]) -> dict[int, Any]:
    """Return the value of every node on which the outputs depend, computed in plain Python from named inputs and
    tables.
    """
    results: dict[int, Any] = {}
    with np.errstate(all="ignore"):
        for index in reachable(graph, outputs):
            node = graph.nodes[index]
            match node[0]:
                case "const":
                    # numpy numbers divide by 0 as IEEE 754 says; a Python float raises
                    results[index] = np.float64(float.fromhex(node[1]))
                case "truth":
                    results[index] = node[1]
                case "input" | "table":
                    results[index] = leaves[node[1]]
                case "ring":
                    results[index] = leaves.get(node[1], Ring(node[2]))
                case name:
                    results[index] = apply(name, *(results[i] for i in arguments(node)))
    return results


def evaluate(graph: Graph, outputs: Sequence[int], leaves: Mapping[str, Any]) -> list[Any]:
    """Compute the values of the output nodes in plain Python, as a reference for the native code."""
    results = node_values(graph, outputs, leaves)
    return [results[index] for index in outputs]
