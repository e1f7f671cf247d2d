"""Gradient: how the cost of a run changes with any parameters, exact, for about the price of three runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from feeddrive.blocks.families import Load, Reference
from feeddrive.blocks.signals import Setpoint
from feeddrive.language import tree
from feeddrive.language.block import Number
from feeddrive.language.errors import ParameterError
from feeddrive.language.graph import Graph, Symbol
from feeddrive.language.recent import Recent
from feeddrive.language.table import Result, Table
from feeddrive.loop.differentiate import push
from feeddrive.loop.engine.native import Native, native
from feeddrive.loop.engine.plan import plan
from feeddrive.loop.loop import Loop, Signals
from feeddrive.loop.runner import Prepared, Work, by_lane
from feeddrive.loop.simulate import known, sample_count
from feeddrive.loop.trace import SETPOINT, Carried, Program, node_values

LANES = 8  # tangents that share a vector
COST = "gradient.cost"


def squared_error(signals: Signals) -> Any:
    """The default objective: the square of the tracking error, m²."""
    return signals.tracking_error * signals.tracking_error


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
            rows.append([name, f"{self.values[name]:.6g}", f"{slope:.6g}", f"{share:+.4f} %"])
        return Table(f"cost {self.cost:.6g}", ["parameter", "value", "d cost / d value", "cost for +1 %"], rows)


_gradients: Recent[Native] = Recent(64)


def gradient(
    loop: Loop,
    reference: Reference,
    parameters: Sequence[str],
    *,
    objective: Callable[[Signals], Any] = squared_error,
    load: Load | None = None,
    duration: float | None = None,
    start: tuple[float, float] | None = None,
    seed: int = 0,
    arithmetic: str = "exact",
) -> Gradient:
    """The mean of `objective(signals)` over a run and its derivatives to parameters by dotted name.

    Forward: eight tangents share a vector beside the run itself.  `objective` is plain arithmetic on one sample's
    `Signals`.  Quantisers count as straight lines; friction is differentiated in the state in which it is, stuck or
    sliding, so that the instants of sticking are held: tune with `Regularised` friction, and verify on the real one.
    The slope to a dead time of whole substeps is that to its right.
    Raises ParameterError for a name that is not known, and for `sample_time`, which is a constant of the design.
    """
    known((), arithmetic)
    if isinstance(parameters, str):
        raise ParameterError(f"parameters must be a list of names: [{parameters!r}]")
    for name in parameters:
        tree.declaration(loop, name)
        if name == "sample_time":
            raise ParameterError(
                "sample_time is a constant of the design: the reference is sampled with it, no gradient"
            )
    work = Work(loop, reference, load)
    count = sample_count(loop, reference, duration)
    delayed = "axis.actuator.dead_time" in parameters
    prepared = Prepared(loop, work.first(), start, seed, partial=delayed)
    program = prepared.program(load=load is not None, enable=False)
    seeds, first = _seeds(loop, prepared, work.first(), start, tuple(parameters))
    key = (program.key, objective, frozenset(seeds), frozenset(first), arithmetic)

    def differentiated() -> Native:
        augmented = _augmented(program, objective, frozenset(seeds), frozenset(first))
        varying = [f"d.{name}" for name in (*seeds, *first)]
        return native(plan(augmented, lanes=LANES, varying=varying, arithmetic=arithmetic))

    made = _gradients.get(key, differentiated)
    inputs, slopes, cost = work.inputs(made, 0, count), [], 0.0
    for begin in range(0, len(parameters), LANES):
        part = slice(begin, min(begin + LANES, len(parameters)))
        numbers = {**prepared.numbers, **{f"d.{name}": row for name, row in seeds.items()}}
        states = {**prepared.first, COST: 0.0, **{f"d.{name}": row for name, row in first.items()}}
        constants = by_lane([name for name, _ in made.plan.constants], numbers, LANES, part)
        carried = {state.name: states.get(state.name, 0.0) for state in made.plan.states}
        memory = by_lane(list(carried), carried, LANES, part)
        made.run(count, 0, constants, inputs, memory, None, prepared.rows(made))
        places = {state.name: i for i, state in enumerate(made.plan.states)}
        cost = float(memory[places[COST], 0]) / count
        row = memory[places[f"d.{COST}"]] if f"d.{COST}" in places else np.zeros(LANES)
        slopes.extend(row[: part.stop - part.start] / count)
    given = {name: float(tree.get(loop, name)) for name in parameters}
    return Gradient(cost, dict(zip(parameters, map(float, slopes), strict=True)), given)


def _augmented(
    program: Program, objective: Callable[[Signals], Any], seeded: frozenset[str], started: frozenset[str]
) -> Program:
    """The program with the summed cost and the tangents of everything that depends on the parameters."""
    graph = program.graph
    signals = Signals(*(cast(Number, Symbol(graph, node)) for node in program.outputs.values()))
    summed = graph.input(f"state.{COST}") + objective(signals)
    states = [*program.states, Carried(COST, graph.input(f"state.{COST}").index, summed.index)]
    tangents = {name: graph.input(f"d.{name}").index for name in seeded}
    ends = [state.after for state in states]
    moving = set(started)
    while True:  # the states that the parameters reach, from sample to sample
        seeds = {program.constants[name]: Symbol(graph, node) for name, node in tangents.items()}
        seeds |= {s.before: graph.input(f"state.d.{s.name}") for s in states if s.name in moving}
        values = {i: Symbol(graph, i) for i in range(len(graph.nodes))}
        pushed = push(graph, ends, values, seeds)
        reached = {s.name for s, tangent in zip(states, pushed, strict=True) if tangent is not None}
        if reached <= moving:
            break
        moving |= reached
    carried = [
        Carried(f"d.{s.name}", graph.input(f"state.d.{s.name}").index, graph.symbol(tangent).index)
        for s, tangent in zip(states, pushed, strict=True)
        if s.name in moving and tangent is not None
    ]
    constants = {**program.constants, **{f"d.{name}": node for name, node in tangents.items()}}
    return replace(program, states=(*states, *carried), constants=constants).keeping(())


_prepares: Recent[tuple[Graph, dict[str, int], dict[str, int]]] = Recent(64)


def _seeds(
    loop: Loop, prepared: Prepared, setpoint: Setpoint, start: tuple[float, float] | None, parameters: tuple[str, ...]
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Derivatives of constants and of first states to the parameters: rows of shape (parameters,), zero rows left out.

    Found from the trace of `prepare` and `start`, which happen once before the run.
    """
    position, velocity = (setpoint.position, setpoint.velocity) if start is None else start
    key = (tree.structure(loop), prepared.timing)
    graph, constants, states = _prepares.get(key, lambda: _traced_prepare(loop, prepared))
    leaves = {
        **prepared.numbers,
        "start.position": np.float64(position),
        "start.velocity": np.float64(velocity),
        **{f"start.{name}": value for name, value in zip(SETPOINT, setpoint, strict=True)},
    }
    eye = np.eye(len(parameters))
    inputs = {name: graph.input(name).index for name in parameters}
    dependent = _dependent(graph, set(inputs.values()))
    ends = {name: node for name, node in {**constants, **states}.items() if node in dependent}
    values = node_values(graph, list(ends.values()), leaves)
    seeds = {node: eye[i] for i, node in enumerate(inputs.values()) if node in values}
    with np.errstate(all="ignore"):
        pushed = dict(zip(ends, push(graph, list(ends.values()), values, seeds), strict=True))
    found = {name: eye[i] for i, name in enumerate(parameters)}
    found |= {name: _row(pushed[name], eye) for name in constants if pushed.get(name) is not None}
    first = {name: _row(pushed[name], eye) for name in states if pushed.get(name) is not None}
    return found, {name: row for name, row in first.items() if np.any(row)}


def _row(tangent: Any, eye: np.ndarray) -> np.ndarray:
    return np.array(np.broadcast_to(tangent, eye.shape[:1]), dtype=float)


def _dependent(graph: Graph, leaves: set[int]) -> set[int]:
    """The nodes that depend on some leaves."""
    found = set(leaves)
    for index, node in enumerate(graph.nodes):
        if node[0] not in ("const", "truth", "input", "table") and any(i in found for i in node[1:]):
            found.add(index)
    return found


def _traced_prepare(loop: Loop, prepared: Prepared) -> tuple[Graph, dict[str, int], dict[str, int]]:
    """The graph of `prepare` and `start`: its nodes by the names of prepared numbers and of states."""
    graph = Graph()
    timing = prepared.timing
    rows = {name: graph.table(name, len(row)) for name, row in tree.tables(loop)}
    symbolic = tree.with_tables(tree.rebuild(loop, (graph.input(name) for name, _ in tree.leaves(loop))), rows)
    made = symbolic.prepare(timing)
    position, velocity, *rest = (
        cast(Number, graph.input(f"start.{name}")) for name in ("position", "velocity", *SETPOINT)
    )
    begun = symbolic.start(made, timing, Setpoint(*rest), position, velocity)
    constants = {name: graph.symbol(v).index for name, v in tree.leaves(made, "prepared") if isinstance(v, Symbol)}
    states = {name: graph.symbol(v).index for name, v in tree.leaves(begun)}
    return graph, constants, states
