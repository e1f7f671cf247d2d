"""A step of one block over recorded signals, compiled as in a run: a cut, or a friction, along a known motion."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from feeddrive.language import tree
from feeddrive.language.graph import Graph
from feeddrive.language.ring import Ring
from feeddrive.loop.engine.llvm import native
from feeddrive.loop.engine.plan import plan
from feeddrive.loop.trace import Carried, Program, concrete, leaf, node

Step = Callable[[Any, Any, Mapping[str, Any], Any, Any], tuple[Any, Mapping[str, Any]]]


def stepped(
    block: Any, start: Callable[[Any], Any], step: Step, signals: Mapping[str, np.ndarray], sample_time: float
) -> dict[str, np.ndarray]:
    """Return the outputs of a step of a block at every sample, each of shape (n,).

    block        the block itself, whose equations are those of a run: a second copy of them could differ
    start        returns its state before the first sample, from the block with plain numbers
    step         step(block, state, signals at sample k, k, T) returns the state after the sample and named outputs;
                 traced, and compiled once per structure
    signals      inputs by name, shape (n,)
    sample_time  T, s
    """
    plain, tables = concrete(block), dict(tree.tables(block))
    begun = start(plain)
    compiled = native(plan(_program(block, begun, step, tuple(signals), tables)))
    values = {**dict(tree.leaves(plain)), "T": np.float64(sample_time)}
    constants = np.array([[values[name]] for name, _ in compiled.plan.constants]).reshape(-1, 1)
    held = {name: value for name, value in tree.leaves(begun) if not isinstance(value, Ring)}
    states = np.zeros((len(compiled.plan.memory), 1))
    for i, state in enumerate(compiled.plan.states):
        states[i, 0] = held[state.name]
    inputs = np.column_stack([signals[name] for name, _ in compiled.plan.inputs])
    count = next(iter(signals.values())).size
    outputs = np.empty((count, len(compiled.plan.outputs), 1))
    rows = [np.asarray(tables[name]) for name, _ in compiled.plan.tables]
    compiled.run(count, 0, constants, np.ascontiguousarray(inputs), states, outputs, rows)
    return {name: outputs[:, i, 0].copy() for i, (name, _) in enumerate(compiled.plan.outputs)}


def _program(block: Any, begun: Any, step: Step, names: tuple[str, ...], tables: Mapping[str, Any]) -> Program:
    """Trace one step of the block into a program with named inputs, states and outputs."""
    graph = Graph()
    symbolic = tree.rebuild(block, (graph.input(name) for name, _ in tree.leaves(block)))
    symbolic = tree.with_tables(symbolic, {name: graph.table(name, len(row)) for name, row in tables.items()})
    before = tree.rebuild(begun, (leaf(graph, f"state.{name}", value) for name, value in tree.leaves(begun)))
    symbols = {name: graph.input(name) for name in names}
    sample, T = graph.input("sample"), graph.input("T")
    after, outputs = step(symbolic, before, symbols, sample, T)
    carried = tuple(
        Carried(name, node(graph, old), node(graph, new))
        for (name, old), (_, new) in zip(tree.leaves(before), tree.leaves(after), strict=True)
    )
    return Program(
        graph=graph,
        constants={name: graph.input(name).index for name in (*dict(tree.leaves(block)), "T")},
        inputs={name: symbol.index for name, symbol in symbols.items()},
        states=carried,
        outputs={name: graph.symbol(value).index for name, value in outputs.items()},
        sample=sample.index,
        tables={name: graph.table(name, len(row)).index for name, row in tables.items()},
    )
