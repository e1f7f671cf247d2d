"""Computational cost of a loop: operations per sample, and the number of substeps required by its axis."""

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from feeddrive.blocks.signals import Setpoint
from feeddrive.language import tree
from feeddrive.language.graph import Graph, arguments, reachable
from feeddrive.language.table import Result, Table
from feeddrive.loop.loop import Loop
from feeddrive.loop.trace import concrete


@dataclass(frozen=True, eq=False, repr=False)
class Effort(Result):
    """The number of operations in one sample by kind: add, sub, mul, div, select, lt, ...

    An elementary function counts as one operation.
    """

    operations: Mapping[str, int]

    @property
    def total(self) -> int:
        """The total number of operations."""
        return sum(self.operations.values())

    def table(self) -> Table:
        """Return a table with one row for each kind of operation, the most frequent first."""
        rows = [[name, count] for name, count in sorted(self.operations.items(), key=lambda entry: -entry[1])]
        return Table(f"{self.total} operations a sample", ["operation", "number"], rows)


def effort(loop: Loop) -> Effort:
    """Count the operations of the controller in one sample, without the guard, which is the same for all laws.

    Operations on parameters alone are executed once before the run and are not counted; common subexpressions are
    counted once.  The count depends only on the code of the law, so it is the same on every computer.
    docs/reference/speed.md lists measured times.
    """
    plain = concrete(replace(loop, control=replace(loop.control, guard=None)))
    prepared = plain.control.prepare(plain.sample_time)
    zero = np.float64(0.0)
    begun = plain.control.start(prepared, Setpoint(*[zero] * len(Setpoint._fields)), zero, zero)  # type: ignore[arg-type]
    graph = Graph()
    rows = {name: graph.table(name, len(row)) for name, row in tree.tables(plain.control)}
    control = tree.rebuild(plain.control, (graph.input(name) for name, _ in tree.leaves(plain.control)))
    control = tree.with_tables(control, rows)
    # a literal in the code of `prepare` stays a constant of the graph, as it does in compiled code
    held = tree.rebuild(
        prepared, (v if type(v) is float else graph.input(name) for name, v in tree.leaves(prepared, "prepared"))
    )
    moving: set[int] = set()

    def varying(name: str) -> Any:
        symbol = graph.input(name)
        moving.add(symbol.index)
        return symbol

    state = tree.rebuild(begun, (varying(f"state.{name}") for name, _ in tree.leaves(begun)))
    setpoint = Setpoint(*(varying(f"set.{name}") for name in Setpoint._fields))
    after, command = control.step(held, state, setpoint, varying("motor"), varying("load"), 1.0, graph.input("T"))  # type: ignore[arg-type]
    ends = [graph.symbol(value).index for _, value in tree.leaves((after, command.applied))]
    counted: Counter[str] = Counter()
    for index in reachable(graph, ends):
        inner = arguments(graph.nodes[index])
        if any(i in moving for i in inner):
            moving.add(index)
            counted[graph.name(index)] += 1
    return Effort(dict(counted))


# rad that the fastest mode may turn in a substep: a tenth of a turn, by judgement
MOST_TURN = 0.6


def fastest_mode(loop: Loop) -> float:
    """Return the highest natural frequency of the axis in Hz; 0 for a rigid axis."""
    mechanics = loop.axis.mechanics()
    mass = np.array(mechanics.mass, dtype=float)
    stiffness = np.array(mechanics.stiffness, dtype=float)
    # a free body has the eigenvalue 0, which rounding makes negative
    squares = np.linalg.eigvals(np.linalg.solve(mass, stiffness))
    return float(np.sqrt(np.max(np.abs(squares), initial=0.0)) / (2.0 * np.pi))


def substeps_needed(loop: Loop) -> int:
    """Return the number of substeps that friction and other forces on a flexible axis require.

    It is 1 without friction or other forces that depend on the motion, since the linear part is discretized exactly.
    """
    axis = loop.axis
    held = (axis.friction_motor, axis.friction_load)
    if not axis.forces and all(friction is None for friction in held):
        return 1
    turn = 2.0 * math.pi * fastest_mode(loop) * float(tree.get(loop, "sample_time"))
    return max(1, math.ceil(turn / MOST_TURN))
