"""Statements from a graph: choices, names, and states that take over each other's values."""

from __future__ import annotations

from typing import Any

import pytest
from structured_text_machine import program

from feeddrive.export.structured_text_code import INPUTS, VARIABLES, Declared, Section, Unit
from feeddrive.language import ops
from feeddrive.language.graph import Graph


def printed(graph: Graph, states: dict[str, Any], inputs: tuple[str, ...] = ()) -> tuple[str, list[str]]:
    """A function block whose variables a, b, ... take the values of some symbols of them, and its statements."""
    leaves = {graph.input(name).index: name for name in (*states, *inputs)}
    section = Section("f", {}, graph, leaves, {}, {}, "LREAL", [*states, *inputs])
    nodes = [graph.symbol(value).index for value in states.values()]
    lines = section.compute(nodes)
    lines += section.assign(zip(states, nodes, strict=True))
    variables = [*(Declared(name, "LREAL", f"{i}.0") for i, name in enumerate(states, 1)), *section.variables]
    unit = Unit("f", "", "", {INPUTS: [Declared(name, "LREAL") for name in inputs], VARIABLES: variables}, lines)
    return unit.text(), lines


def values(text: str, names: str, **inputs: float) -> list[float]:
    answer = program(text).blocks["f"].instance().call(**inputs)
    return [getattr(answer, name) for name in names]


def test_states_that_exchange_their_values() -> None:
    graph = Graph()
    a, b, c = (graph.input(name) for name in "abc")
    text, _ = printed(graph, {"a": b, "b": a, "c": c})
    assert values(text, "abc") == [2.0, 1.0, 3.0]


def test_a_state_that_becomes_the_negative_of_another_takes_the_old_one() -> None:
    graph = Graph()
    a, b = graph.input("a"), graph.input("b")
    text, _ = printed(graph, {"a": -b, "b": -a})
    assert values(text, "ab") == [-2.0, -1.0]


def test_a_number_that_stays_is_not_assigned() -> None:
    graph = Graph()
    text, lines = printed(graph, {"a": graph.input("a"), "b": graph.constant(-0.0)})
    assert lines == ["b := -0.0;"]
    assert str(values(text, "ab")[1]) == "-0.0"


def test_choices_on_one_condition_stand_in_one_if() -> None:
    """Also choices within them; what both need comes before, and the other side is not computed."""
    graph = Graph()
    x, a, b = (graph.input(name) for name in "xab")
    high, low = x > 1.0, x < -1.0
    first = ops.where(high, a / x, ops.where(low, b, 0.0))
    second = ops.where(high, b / x, ops.where(low, a, x * 5.0))
    text, lines = printed(graph, {"a": first, "b": second}, ("x",))
    assert sum(line.startswith("IF") for line in lines) == 1
    assert sum(line.startswith("ELSIF") for line in lines) == 1
    assert [values(text, "ab", x=at) for at in (2.0, 0.0, -2.0)] == [[0.5, 1.0], [0.0, 0.0], [2.0, 1.0]]


def test_what_a_choice_makes_is_computed_before_it_is_used() -> None:
    graph = Graph()
    x, a = graph.input("x"), graph.input("a")
    size = ops.where(x > 0.0, x, -x)
    twice = size + size
    other = ops.where(x > 0.0, twice, a)
    text, _ = printed(graph, {"a": other, "b": twice * size}, ("x",))
    assert values(text, "ab", x=3.0) == [6.0, 18.0]
    assert values(text, "ab", x=-3.0) == [1.0, 18.0]


@pytest.mark.parametrize("x", [0.0, 1.0])
def test_a_choice_between_conditions_is_a_condition(x: float) -> None:
    graph = Graph()
    given, a = graph.input("x"), graph.input("a")
    chosen = ops.where(given > 0.5, a > 0.0, a < 0.0)
    text, _ = printed(graph, {"a": ops.where(chosen, 7.0, 8.0), "b": ops.where(ops.no(chosen), 1.0, 0.0)}, ("x",))
    assert values(text, "ab", x=x) == ([7.0, 0.0] if x > 0.5 else [8.0, 1.0])
