"""Exact gradient of a scalar cost of a run with respect to any parameters, at about the cost of three runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from feeddrive.blocks.families import Load, Reference
from feeddrive.language import tree
from feeddrive.language.block import Number
from feeddrive.language.errors import NoSlopeError, ParameterError
from feeddrive.language.graph import Graph, Symbol, arguments
from feeddrive.language.quantity import Quantity
from feeddrive.language.recent import Recent
from feeddrive.language.ring import Ring
from feeddrive.language.table import Column, Result, Table
from feeddrive.loop.beginning import STARTS, TracedBeginning, each_axis, traced_beginning
from feeddrive.loop.engine.native import Native, native
from feeddrive.loop.engine.plan import plan
from feeddrive.loop.loop import Loop, Signals
from feeddrive.loop.machine import System, check_system
from feeddrive.loop.runner import Prepared, by_lane
from feeddrive.loop.simulate import known, sample_count
from feeddrive.loop.trace import Carried, Program, lengths, node, node_values
from feeddrive.loop.traced_model import push
from feeddrive.loop.work import Work

LANES = 8  # tangents that share a vector
COST = "gradient.cost"


def squared_error(signals: Any) -> Any:
    """Return the default objective: the squared tracking error, m²; for a machine the sum over its axes."""
    if isinstance(signals, Signals):
        return signals.tracking_error * signals.tracking_error
    total: Any = None
    for signal in signals.values():
        square = signal.tracking_error * signal.tracking_error
        total = square if total is None else total + square
    return total


@dataclass(frozen=True, eq=False, repr=False)
class Gradient(Result):
    """The mean of an objective over a run, and its derivatives by parameter name."""

    cost: float
    gradient: Mapping[str, float]
    values: Mapping[str, float]

    def table(self) -> Table:
        """Derivative, and relative change of the cost for 1 % of each parameter."""
        rows = []
        for name, slope in self.gradient.items():
            share = slope * self.values[name] / self.cost if self.cost else float("nan")
            rows.append([name, self.values[name], slope, Quantity(0.01 * share, "share", form="+.4f")])
        columns = ["parameter", Column("value", form="6"), Column("d cost / d value", form="6"), "cost for +1 %"]
        return Table(f"cost {Quantity(self.cost):6}", columns, rows)


_gradients: Recent[Native] = Recent(64)


def gradient(
    loop: System,
    reference: Reference | Mapping[str, Reference],
    parameters: Sequence[str],
    *,
    objective: Callable[[Any], Any] = squared_error,
    load: Load | Mapping[str, Load] | None = None,
    duration: float | None = None,
    start: tuple[float, float] | Mapping[str, tuple[float, float]] | None = None,
    seed: int = 0,
    arithmetic: str = "exact",
) -> Gradient:
    """Return the mean of `objective(signals)` over a run and its derivatives to parameters by path
    (axis.x.control.law.Kv).

    Forward mode: eight tangents are computed in one vector with the run.  `objective` is plain arithmetic on the
    `Signals` of one sample; for a machine on a mapping of them by axis.  Quantizers count as straight lines; friction
    is differentiated in its present state, stuck or sliding, with the instants of sticking held fixed: tune with
    `Regularised` friction, and verify with the real one.
    The slope to a dead time of whole substeps is that to its right.
    Raises ParameterError for a name that is not known, and for `sample_time`, which is a constant of the design;
    NoSlopeError if a root or logarithm at 0 in the run leaves no finite gradient.
    """
    check_system(loop)
    known(loop, (), arithmetic)
    if isinstance(parameters, str):
        raise ParameterError(f"parameters must be a list of paths: [{parameters!r}]")
    names = tuple(tree.name_of(loop, path) for path in parameters)
    for name in names:
        if name.rpartition(".")[2] == "sample_time":
            raise ParameterError(
                "sample_time is a constant of the design: the reference is sampled with it, no gradient"
            )
    work = Work(loop, reference, load)
    count = sample_count(work, duration)
    delayed = [axis for axis, name in _dead_times(loop).items() if name in names]
    prepared = Prepared(loop, work.first(), start, seed, partial=delayed)
    program = prepared.program(load=work.load)
    seeds, first = _seeds(loop, prepared, work.first(), start, names)
    key = (program.key, objective, frozenset(seeds), frozenset(first), arithmetic)

    def differentiated() -> Native:
        augmented = _augmented(loop, program, objective, frozenset(seeds), frozenset(first))
        varying = [f"d.{name}" for name in (*seeds, *first)]
        return native(plan(augmented, lanes=LANES, varying=varying, arithmetic=arithmetic))

    derivative = _gradients.get(key, differentiated)
    inputs, slopes, cost = work.inputs(derivative, 0, count), [], 0.0
    for begin in range(0, len(parameters), LANES):
        part = slice(begin, min(begin + LANES, len(parameters)))
        numbers = {**prepared.numbers, **{f"d.{name}": row for name, row in seeds.items()}}
        states = {**prepared.first, COST: 0.0, **{f"d.{name}": row for name, row in first.items()}}
        constants = by_lane([name for name, _ in derivative.plan.constants], numbers, LANES, part)
        carried = {name: states.get(name, 0.0) for name in derivative.plan.memory}
        memory = by_lane(list(carried), carried, LANES, part)
        derivative.run(count, 0, constants, inputs, memory, None, prepared.rows(derivative))
        places = {state.name: i for i, state in enumerate(derivative.plan.states)}
        cost = float(memory[places[COST], 0]) / count
        row = memory[places[f"d.{COST}"]] if f"d.{COST}" in places else np.zeros(LANES)
        slopes.extend(row[: part.stop - part.start] / count)
    graph = program.graph
    roots = sorted({str(line) for index, line in graph.lines.items() if graph.name(index) != "select"})
    if math.isfinite(cost) and not np.all(np.isfinite(slopes)) and roots:
        raise NoSlopeError(
            f"the cost of this run has no finite gradient: a root or logarithm came to 0 in it, where it has no finite "
            f"slope ({'; '.join(roots)}). Take differences of runs, or give it a finite slope at 0"
        )
    values = {name: float(tree.get(loop, name)) for name in parameters}
    return Gradient(cost, dict(zip(parameters, map(float, slopes), strict=True)), values)


def _dead_times(loop: System) -> dict[str, str]:
    """Return the name of the dead time of each axis."""
    if isinstance(loop, Loop):
        return {loop.name: "axis.actuator.dead_time"}
    return {axis: f"axis.{axis}.actuator.dead_time" for axis in loop.axes()}


def _signals(loop: System, program: Program) -> Any:
    """Return the signals of a sample on symbols; for a machine by axis."""

    def row(port: str) -> Signals:
        symbols = (Symbol(program.graph, program.outputs[f"{port}{name}"]) for name in Signals._fields)
        return Signals(*(cast(Number, symbol) for symbol in symbols))

    if isinstance(loop, Loop):
        return row("")
    return {axis: row(port) for axis, port in zip(loop.loops(), loop.ports(), strict=True)}


def _augmented(
    loop: System, program: Program, objective: Callable[[Any], Any], seeded: frozenset[str], started: frozenset[str]
) -> Program:
    """Return the program with the summed cost and the tangents of everything that depends on the parameters."""
    graph = program.graph
    summed = graph.input(f"state.{COST}") + objective(_signals(loop, program))
    states = [*program.states, Carried(COST, graph.input(f"state.{COST}").index, summed.index)]
    tangents = {name: graph.input(f"d.{name}").index for name in seeded}
    ends = [state.after for state in states]
    moving = set(started)
    while True:  # the states that the parameters reach, from sample to sample
        seeds = {program.constants[name]: Symbol(graph, node) for name, node in tangents.items()}
        seeds |= {s.before: _tangent(graph, s) for s in states if s.name in moving}
        values = {i: _value(graph, i) for i in range(len(graph.nodes))}
        pushed = push(graph, ends, values, seeds)
        reached = {s.name for s, tangent in zip(states, pushed, strict=True) if tangent is not None}
        if reached <= moving:
            break
        moving |= reached
    carried = [
        Carried(f"d.{s.name}", node(graph, _tangent(graph, s)), node(graph, tangent))
        for s, tangent in zip(states, pushed, strict=True)
        if s.name in moving and tangent is not None
    ]
    constants = {**program.constants, **{f"d.{name}": node for name, node in tangents.items()}}
    return replace(program, states=(*states, *carried), constants=constants).keeping(())


def _tangent(graph: Graph, state: Carried) -> Any:
    """Return the tangent of a state where it is read."""
    size = lengths(graph, state.before)
    name = f"state.d.{state.name}"
    return graph.input(name) if size is None else Ring(size, graph.ring(name, size))


def _value(graph: Graph, index: int) -> Any:
    size = lengths(graph, index)
    return Symbol(graph, index) if size is None else Ring(size, Symbol(graph, index))


_traced: Recent[TracedBeginning] = Recent(64)


def _seeds(
    loop: System, prepared: Prepared, setpoint: Any, start: Any, parameters: tuple[str, ...]
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Return derivatives of constants and first states to the parameters: rows of shape (parameters,), without zero
    rows.

    Found from the trace of `prepare` and `start`, which happen once before the run.
    """
    if start is None:
        start = each_axis(lambda at: (at.position, at.velocity), setpoint)
    key = (tree.structure(loop), prepared.timing)
    graph, constants, states = _traced.get(key, lambda: traced_beginning(loop, prepared.timing))
    leaves = {
        **prepared.numbers,
        **_starts(setpoint, start),
    }
    eye = np.eye(len(parameters))
    inputs = {name: graph.input(name).index for name in parameters}
    dependent = _dependent(graph, set(inputs.values()))
    ends = {name: node for name, node in {**constants, **states}.items() if node in dependent}
    values = node_values(graph, list(ends.values()), leaves)
    seeds = {node: eye[i] for i, node in enumerate(inputs.values()) if node in values}
    with np.errstate(all="ignore"):
        pushed = dict(zip(ends, push(graph, list(ends.values()), values, seeds), strict=True))
    tangents = {name: eye[i] for i, name in enumerate(parameters)}
    tangents |= {name: _row(pushed[name], eye) for name in constants if pushed.get(name) is not None}
    first = {name: _row(pushed[name], eye) for name in states if pushed.get(name) is not None}
    return tangents, {name: row for name, row in first.items() if np.any(row)}


def _row(tangent: Any, eye: np.ndarray) -> np.ndarray:
    return np.array(np.broadcast_to(tangent, eye.shape[:1]), dtype=float)


def _dependent(graph: Graph, leaves: set[int]) -> set[int]:
    """Return the nodes that depend on some leaves."""
    dependent = set(leaves)
    for index, operation in enumerate(graph.nodes):
        if any(i in dependent for i in arguments(operation)):
            dependent.add(index)
    return dependent


def _starts(setpoint: Any, start: Any) -> dict[str, Any]:
    """Return the numbers of the first setpoint and of the start by name; for a machine prefixed by the axis."""
    if isinstance(setpoint, Mapping):
        rows = {axis: _starts(one, start[axis]) for axis, one in setpoint.items()}
        return {f"{axis}.{name}": value for axis, row in rows.items() for name, value in row.items()}
    values = (*start, *setpoint)
    return dict(zip(STARTS, map(np.float64, values), strict=True))
