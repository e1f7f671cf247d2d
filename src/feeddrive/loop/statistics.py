"""Statistics accumulated while a program runs, so that long runs and large batches need not be recorded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from feeddrive.language import ops
from feeddrive.language.graph import Symbol
from feeddrive.loop.trace import Carried, Program

LEFT = "statistics.left"


def gathered(signal: str, what: str) -> str:
    """Return the name of the state that gathers `squares` (sum of squares), `least` or `most` of a signal."""
    return f"statistics.{signal}.{what}"


def gathering(program: Program, signals: Sequence[str], bounded: Sequence[str] = ()) -> Program:
    """Return the program that also gathers sum of squares, least and most of signals; the peak is the larger of ±both.

    `bounded` names signals; the first sample in which one is outside ±`bound` (a constant of the program) is kept in
    `LEFT`; -1 until then. NaN is outside.
    """
    graph = program.graph
    states, constants, sample = list(program.states), dict(program.constants), program.sample

    def carry(name: str, after: object) -> None:
        states.append(Carried(name, graph.input(f"state.{name}").index, graph.symbol(after).index))

    for signal in signals:
        value = Symbol(graph, program.outputs[signal])
        before = {what: graph.input(f"state.{gathered(signal, what)}") for what in START}
        carry(gathered(signal, "squares"), before["squares"] + value * value)
        carry(gathered(signal, "least"), ops.minimum(before["least"], value))
        carry(gathered(signal, "most"), ops.maximum(before["most"], value))
    if bounded:
        bound = graph.input("bound")
        constants["bound"] = bound.index
        count = graph.input("sample")
        sample = count.index
        left = graph.input(f"state.{LEFT}")
        inside: Any = None
        for name in bounded:
            one = ops.absolute(Symbol(graph, program.outputs[name])) <= bound
            inside = one if inside is None else ops.both(inside, one)
        carry(LEFT, ops.where(ops.either(inside, left >= 0.0), left, count))
    return replace(program, states=tuple(states), constants=constants, sample=sample)


START = {"squares": 0.0, "least": float("inf"), "most": float("-inf")}


def begin(name: str) -> float:
    """Return the start value of a gathering state."""
    return -1.0 if name == LEFT else START[name.rsplit(".", 1)[1]]
