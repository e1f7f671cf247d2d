"""Reference outputs of a routine, computed by the simulator: every target must reproduce them bit for bit.

The step is traced again, with the prepared numbers as inputs, and run by the engine of the simulation; `prepare`,
`start` and `retune` run on plain numbers.  No code that was printed for a target is used.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

import numpy as np

from feeddrive.language import tree
from feeddrive.language.block import Number
from feeddrive.language.errors import ParameterError
from feeddrive.language.graph import Graph
from feeddrive.language.ring import Ring
from feeddrive.loop.engine.native import Native, native
from feeddrive.loop.engine.plan import plan
from feeddrive.loop.routine import Routine
from feeddrive.loop.routine_trace import on_target
from feeddrive.loop.trace import Carried, Program, concrete, leaf, node, numbers

Changes = Mapping[int, Mapping[str, float]]


class ControllerRun:
    """The control of a routine as the simulator runs it, from a reset on; `step` may be called again and again."""

    def __init__(self, routine: Routine, first: np.ndarray) -> None:
        """Reset the control with the inputs `first`, shape (inputs,)."""
        if routine.memory != "controller":
            raise ParameterError(f"{routine.name} is an axis; its answers are those of `simulate`")
        self.routine = routine
        self.T = np.float64(routine.sample_time)
        self._both: Any = on_target(routine.origin)
        self._prepare()
        first_inputs = dict(zip((v.path for v in routine.inputs), map(np.float64, first), strict=True))
        with np.errstate(all="ignore"):
            self.state = self._plain.start(self._prepared, first_inputs)
        self._native = self._compiled()
        self._load()

    def _prepare(self) -> None:
        self._plain = concrete(self._both)
        with np.errstate(all="ignore"):
            self._prepared = self._plain.prepare(self.T)
        self._numbers = {**dict(tree.leaves(self._plain)), **dict(numbers(self._prepared, "prepared")), "T": self.T}

    def _compiled(self) -> Native:
        """Return one sample as machine code."""
        graph = Graph()
        constants: dict[str, int] = {}
        inputs: dict[str, int] = {}

        def symbol(name: str, nodes: dict[str, int]) -> Any:
            node = graph.input(name)
            nodes[name] = node.index
            return node

        rows = {name: graph.table(name, len(row)) for name, row in tree.tables(self._both)}
        leaves = iter([symbol(name, constants) for name, _ in tree.leaves(self._both)])
        both: Any = tree.with_tables(tree.rebuild(self._both, leaves), rows)
        prepared = tree.rebuild(
            self._prepared,
            (v if type(v) is float else symbol(name, constants) for name, v in tree.leaves(self._prepared, "prepared")),
        )
        names = [name for name, _ in tree.leaves(self.state)]
        begun = tree.leaves(self.state)
        before = tree.rebuild(self.state, (leaf(graph, f"state.{name}", value) for name, value in begun))
        signals = {v.path: symbol(v.path, inputs) for v in self.routine.inputs}
        T = cast(Number, symbol("T", constants))
        after, values = both.step(prepared, before, signals, T)
        carried = zip(names, tree.leaves(before), tree.leaves(after), strict=True)
        program = Program(
            graph=graph,
            constants=constants,
            inputs=inputs,
            states=tuple(
                Carried(name, node(graph, first), node(graph, value)) for name, (_, first), (_, value) in carried
            ),
            outputs={v.path: graph.symbol(values[v.path]).index for v in self.routine.outputs},
            sample=None,
            tables={name: row.index for name, row in rows.items()},
        )
        return native(plan(program))

    def _load(self) -> None:
        """Put state, constants and tables in the order of the machine code, where steps read and write them."""
        plan, values, rows = self._native.plan, dict(tree.leaves(self.state)), dict(tree.tables(self._both))
        held = [np.float64(values[state.name]) for state in plan.states]
        for name, _, length in plan.rings:
            cells = values[name.removeprefix("state.")].cells
            held += [0.0] * length if cells is None else list(cells)
        self._states = np.array(held, dtype=np.float64)[:, None]
        self._constants = np.array([[self._numbers[name]] for name, _ in plan.constants], dtype=np.float64)
        self._rows = [rows[name] for name, _ in plan.tables]

    def _unload(self) -> None:
        """Store the state as the blocks know it."""
        values = dict(tree.leaves(self.state))
        plan = self._native.plan
        values |= {state.name: np.float64(self._states[i, 0]) for i, state in enumerate(plan.states)}
        first = len(plan.states)
        for name, _, length in plan.rings:
            values[name.removeprefix("state.")] = Ring(length, self._states[first : first + length, 0].copy())
            first += length
        self.state = tree.rebuild(self.state, iter(values[name] for name, _ in tree.leaves(self.state)))

    def step(self, inputs: np.ndarray) -> np.ndarray:
        """Return the outputs of some samples: inputs (n, inputs), outputs (n, outputs), in the order of the routine."""
        row = np.ascontiguousarray(inputs, dtype=np.float64)
        out = np.empty((len(row), len(self.routine.outputs)))
        self._native.run(len(row), 0, self._constants, row, self._states, out, self._rows)
        return out

    def retune(self, changes: Mapping[str, float]) -> None:
        """Change parameters, by path, from the next sample on. Raises ParameterError as the blocks do."""
        self._unload()
        before, prepared = self._plain, self._prepared
        changed = tree.vary(self._both, changes)
        tree.check_sampled(changed, float(self.T))
        self._both = changed
        self._prepare()
        with np.errstate(all="ignore"):
            self.state = self._plain.retune(self.state, before, prepared, self._prepared)
        self._load()


def run(routine: Routine, inputs: np.ndarray, changes: Changes | None = None) -> np.ndarray:
    """Return the outputs of a controller after a reset with the first inputs: inputs (n, inputs), outputs (n, outputs).

    `changes` are other parameters, by sample and path, which hold from that sample on.
    """
    held = ControllerRun(routine, inputs[0])
    pieces, start = [], 0
    for place in sorted(changes or {}):
        pieces.append(held.step(inputs[start:place]))
        held.retune((changes or {})[place])
        start = place
    return np.vstack([*pieces, held.step(inputs[start:])])
