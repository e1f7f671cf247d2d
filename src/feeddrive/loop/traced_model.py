"""The linear model of a loop as nodes of graphs: every entry as a function of the parameters of the loop."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from feeddrive.blocks.signals import Setpoint
from feeddrive.language.errors import ParameterError
from feeddrive.language.ring import Ring
from feeddrive.loop.gradient import TracedModel, jacobian_entries
from feeddrive.loop.linearize import unlimited_loop
from feeddrive.loop.loop import SETPOINT, Loop
from feeddrive.loop.runner import Prepared, TracedBeginning, traced_beginning
from feeddrive.loop.trace import lengths


@dataclass(frozen=True, eq=False)
class TracedLoop:
    """A loop as two graphs: from its parameters to the numbers of a sample, and from these to its linear model.

    beginning  parameters and the first setpoint -> precomputed coefficients and first states
    model      both -> the matrix [A B; C D] with one input, a force added to the command, and one output, the force of
               the control: the sensitivity is 1 + C (z - A)⁻¹ B + D
    names      the states, in the order of the matrix
    fixed      leaves of the model that are neither: first states that do not follow from the parameters, inputs, seed
    """

    beginning: TracedBeginning
    model: TracedModel
    names: tuple[str, ...]
    fixed: Mapping[str, float]


def traced_loop(loop: Loop, position: float, velocity: float) -> TracedLoop:
    """Trace the linear model of a loop in motion at a velocity (m/s) through a position (m), as `linearize` does.

    Raises ParameterError for a law with two rates, and for a loop that reads a table or the past of a signal.
    """
    loop = unlimited_loop(loop)
    if loop.control.law.period() > 1:
        raise ParameterError(
            f"the law '{loop.control.law.kind}' has two rates, and the proof along the travel takes one: set "
            "position_every = 1"
        )
    setpoint = Setpoint(*map(np.float64, (position, velocity, 0.0, 0.0, 0.0)))
    prepared = Prepared(loop, setpoint, (position, velocity))
    program = prepared.program(load=False, enable=False, probes=("added_force",))
    if prepared.tables or any(lengths(program.graph, state.before) for state in program.states):
        raise ParameterError(
            "the loop reads a table or the past of a signal, which the proof along the travel does not enclose: leave "
            "this block out"
        )
    graph = program.graph
    states = program.states
    ends = [*(state.after for state in states), program.outputs["force"]]
    columns = [*(state.before for state in states), program.inputs["added_force"]]
    derived = jacobian_entries(graph, ends, columns)
    n = len(states)
    leaves = {node[1]: i for i, node in enumerate(graph.nodes) if node[0] == "input"}
    whole = TracedModel(graph, n, (n + 1, n + 1), derived, leaves)
    begun, settled = prepared.first, prepared.settled()
    fixed = {
        f"state.{name}": float(value)
        for name, value in settled.items()
        if not isinstance(value, Ring) and float(value) != float(begun[name])
    }
    fixed |= {name: float(value) for name, value in zip(SETPOINT, setpoint, strict=True)}
    fixed |= {"added_force": 0.0, "sample": 0.0, "seed": 0.0}
    kept = whole.kept()
    return TracedLoop(
        traced_beginning(loop, prepared.timing),
        whole.trimmed(),
        tuple(states[i].name for i in kept),
        fixed,
    )
