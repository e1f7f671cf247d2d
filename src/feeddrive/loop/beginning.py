"""The start of a run: the numbers that a loop prepares and its first state, by Python or by machine code.

Both come from the same source, `prepare` and `start` of the blocks.  The first runs of a structure compute them in
Python, which is quicker than to compile what runs once; later ones run the traced graph, to the same bits.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable, Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple, cast

import numpy as np

from feeddrive.blocks.signals import Setpoint
from feeddrive.language import tree
from feeddrive.language.block import Number
from feeddrive.language.graph import Graph, Symbol
from feeddrive.language.recent import Recent
from feeddrive.language.ring import Ring
from feeddrive.loop.engine.native import Native, native
from feeddrive.loop.engine.plan import plan
from feeddrive.loop.hold import Hold
from feeddrive.loop.loop import SETPOINT, Loop
from feeddrive.loop.machine import System
from feeddrive.loop.trace import Program, concrete, evaluate, numbers

# Runs with other numbers that compute in Python before machine code is made: it costs about as much as so many of them.
PAYS_AFTER = 12


class Trees(NamedTuple):
    """A system with numpy numbers as leaves, what it prepared, and its first state."""

    plain: Any
    prepared: Any
    begun: Any


class Beginning:
    """Delay structure, numbers and first states by name, tables and structure of a system at the start of a run."""

    def __init__(
        self,
        timing: Any,
        numbers: dict[str, Any],
        first: dict[str, Any],
        tables: dict[str, Any],
        structure: Hashable,
        trees: Callable[[], Trees],
    ) -> None:
        self.timing, self.numbers, self.first = timing, numbers, first
        self.tables, self.structure, self._trees = tables, structure, trees

    @cached_property
    def trees(self) -> Trees:
        """The same numbers as trees, which only a trace or a live change needs."""
        return self._trees()

    @cached_property
    def varying(self) -> frozenset[str]:
        """The names of numbers and first states that are arrays over lanes."""
        both = {**self.numbers, **self.first}
        return frozenset(name for name, value in both.items() if isinstance(value, np.ndarray))


class _Structure:
    """The count of starts of a structure with new numbers, and its machine code once there were enough."""

    def __init__(self) -> None:
        self.begun = 0
        self.code: NativeBeginning | None = None


_holds: Recent[Hold] = Recent(256)
_beginnings: Recent[Beginning] = Recent(256)
_structures: Recent[_Structure] = Recent(64)


def beginning(system: System, setpoint: Any, start: Any, partial: Collection[str]) -> Beginning:
    """Return the start of a system at a first setpoint; `start` is (position, velocity), None for those of the
    setpoint.

    Kept for the next run of a loop with the same numbers; nothing is kept of machines, tables and variants in lanes.
    """
    if start is None:
        start = each_axis(lambda at: (at.position, at.velocity), setpoint)
    position, velocity = (each_axis(lambda at, i=i: typed(at[i]), start) for i in (0, 1))

    def by_python() -> Beginning:
        return _by_python(system, setpoint, position, velocity, partial)

    if not isinstance(system, Loop):
        return by_python()
    shape, values = tree.structure_and_values(system)
    row = _bits([*values, position, velocity, *setpoint])
    if row is None:
        return by_python()
    # whether a number is a float or a numpy number matters to a trace
    key = shape, tuple(map(type, setpoint)), frozenset(partial)

    def built() -> Beginning:
        timing = system.timing(partial)
        seen = _structures.get((*key, timing), _Structure)
        seen.begun += 1
        if seen.begun <= PAYS_AFTER:
            return by_python()
        if seen.code is None:
            seen.code = NativeBeginning(system, timing, row)
        trees = seen.code.run(row)
        if trees is None:
            seen.code = NativeBeginning(system, timing, None)
            trees = cast(tuple[dict[str, Any], dict[str, Any]], seen.code.run(row))
        return Beginning(timing, *trees, {}, shape, lambda: by_python().trees)

    return _beginnings.get((key, row.tobytes()), built)


def _by_python(system: Any, setpoint: Any, position: Any, velocity: Any, partial: Collection[str]) -> Beginning:
    """Return the prepared numbers and the first state of a loop or machine, computed in Python."""
    timing = system.timing(partial)
    plain = concrete(system)
    with np.errstate(all="ignore"):
        prepared = _prepared(plain, timing)
        begun = plain.start(prepared, timing, setpoint, position, velocity)
    named = dict(tree.leaves(plain))
    named.update(numbers(prepared, "prepared"))
    first = {name: v for name, v in tree.leaves(begun) if not isinstance(v, Ring)}
    trees = Trees(plain, prepared, begun)
    return Beginning(timing, named, first, dict(tree.tables(system)), tree.structure(system), lambda: trees)


def _prepared(plain: Any, timing: Any) -> Any:
    """Return the prepared numbers of a loop or machine; the hold of an unchanged axis is reused."""
    if not isinstance(plain, Loop):
        return plain.prepare(timing)
    axis, T = plain.axis, plain.sample_time
    core = (axis.plant, axis.actuator, axis.friction_motor, axis.friction_load)
    kept = key(core)
    if kept is None:
        return plain.prepare(timing)
    hold = _holds.get((kept, axis.substeps, T, timing), lambda: axis.prepare(T, timing))
    return plain.Prepared(plain.control.prepare(T), hold)


def key(held: Any) -> Hashable:
    """Return the structure of blocks and all bits of their numbers; None with tables or lanes, which are not cached."""
    structure, values = tree.structure_and_values(held)
    row = _bits(values)
    return None if row is None else (structure, row.tobytes())


def _bits(values: Sequence[Any]) -> np.ndarray | None:
    """Return numbers as a row of floats; None with tables or lanes."""
    if np.ndarray in map(type, values):
        return None
    return np.array(values, dtype=np.float64)


def typed(value: Any) -> Any:
    """Return a number, or the numbers of lanes, as numpy types."""
    return np.asarray(value, dtype=np.float64) if isinstance(value, (list, np.ndarray)) else np.float64(value)


def each_axis(function: Callable[[Any], Any], argument: Any) -> Any:
    """Apply a function to the argument of a loop, or to the argument of each axis of a machine."""
    return (
        {name: function(one) for name, one in argument.items()} if isinstance(argument, Mapping) else function(argument)
    )


class TracedBeginning(NamedTuple):
    """The graph of `prepare` and `start`.

    Leaves are the numbers of the system by name, and `start.position`, `start.velocity`, `start.set_position` ...; of a
    machine the latter with the axis before them.
    """

    graph: Graph
    constants: dict[str, int]  # nodes of prepared numbers, by name
    states: dict[str, int]  # nodes of first states, by name


STARTS = tuple(f"start.{name}" for name in ("position", "velocity", *SETPOINT))


def traced_beginning(system: System, timing: Any, counted: Callable[[Symbol], float] | None = None) -> TracedBeginning:
    """Trace `prepare` and `start` of a system on symbols; `counted` as in `Graph`."""
    graph = Graph(counted)
    rows = {name: graph.table(name, len(row)) for name, row in tree.tables(system)}
    leaves = (graph.input(name) for name, _ in tree.leaves(system))
    symbolic: Any = tree.with_tables(tree.rebuild(system, leaves), rows)
    prepared = symbolic.prepare(timing)
    at = {
        axis: [cast(Number, graph.input(f"{port}{name}")) for name in STARTS]
        for axis, port in zip(system.loops(), system.ports(), strict=True)
    }
    position, velocity, setpoint = (
        {axis: take(row) for axis, row in at.items()}
        for take in (lambda row: row[0], lambda row: row[1], lambda row: Setpoint(*row[2:]))
    )
    if isinstance(system, Loop):
        setpoint, position, velocity = setpoint[system.name], position[system.name], velocity[system.name]
    begun = symbolic.start(prepared, timing, setpoint, position, velocity)
    constants = {name: graph.symbol(v).index for name, v in tree.leaves(prepared, "prepared") if isinstance(v, Symbol)}
    states = {name: graph.symbol(v).index for name, v in tree.leaves(begun) if not isinstance(v, Ring)}
    return TracedBeginning(graph, constants, states)


class NativeBeginning:
    """`prepare` and `start` of one structure of a loop as machine code."""

    def __init__(self, loop: Loop, timing: Any, row: np.ndarray | None) -> None:
        """Compile. `row` holds the numbers of a run: loops of a fixed count go no further than it needs; None: all the
        way.
        """
        self._leaves = [name for name, _ in tree.leaves(loop)]
        names = [*self._leaves, *STARTS]
        counts: dict[int, float] = {}

        def counted(symbol: Symbol) -> float:
            assert row is not None
            (count,) = evaluate(symbol.graph, [symbol.index], dict(zip(names, row, strict=True)))
            return counts.setdefault(symbol.index, float(count))

        graph, constants, states = traced_beginning(loop, timing, None if row is None else counted)
        self._constants, self._states, self._counts = list(constants), list(states), np.array([*counts.values()])
        ends = [*counts, *constants.values(), *states.values()]
        program = Program(
            graph=graph,
            constants={name: graph.input(name).index for name in names},
            inputs={},
            states=(),
            outputs={str(place): node for place, node in enumerate(ends)},
            sample=None,
            tables={},
        )
        self._native: Native = native(plan(program), flush=False, quick=True)

    def run(self, row: np.ndarray) -> tuple[dict[str, Any], dict[str, Any]] | None:
        """Return numbers and first states by name; None if a loop of a fixed count must go further than traced."""
        outputs = np.empty((1, len(self._native.plan.outputs)))
        self._native.run(1, 0, row, np.empty((1, 0)), np.empty(0), outputs, ())
        counts, prepared = len(self._counts), len(self._counts) + len(self._constants)
        if not np.all(outputs[0, :counts] <= self._counts):
            return None
        values = dict(zip(self._leaves, row, strict=False))
        values.update(zip(self._constants, outputs[0, counts:prepared], strict=True))
        return values, dict(zip(self._states, outputs[0, prepared:], strict=True))
