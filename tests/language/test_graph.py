"""Tracing: the graph computes what the source computes, and refuses what would mean something else on symbols."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from feeddrive.language import ops
from feeddrive.language.errors import LanguageError, StructureError
from feeddrive.language.graph import ARITY, SPELLED, Graph, Symbol, arguments, reachable
from feeddrive.loop.trace import evaluate


@pytest.fixture
def x() -> Symbol:
    return Graph().input("x")


def branch(x: Symbol) -> float:
    return 1.0 if x > 0.0 else 2.0


REFUSED = {
    "if": branch,
    "and": lambda x: x > 0.0 and x < 1.0,
    "chained comparison": lambda x: 0.0 < x < 1.0,
    "not": lambda x: not x,
    "min": lambda x: min(x, 1.0),
    "float": float,
    "int": int,
    "math.sin": math.sin,
    "math.floor": math.floor,
    "power": lambda x: x**2,
    "reversed power": lambda x: 2.0**x,
    "equality": lambda x: x == 1.0,
    "inequality": lambda x: x != 1.0,
    "numpy function": np.sin,
    "numpy array": lambda x: np.array([1.0, 2.0]) * x,
    "index": lambda x: [1.0, 2.0][x],
    "hash": hash,
    "remainder": lambda x: x % 2.0,
    "whole division": lambda x: 2.0 // x,
    "divmod": lambda x: divmod(x, 2.0),
    "round": round,
    "&": lambda x: (x > 0.0) & (x < 1.0),
    "~": lambda x: ~(x > 0.0),
}


@pytest.mark.parametrize("how", REFUSED)
def test_what_a_law_may_not_do_raises(how: str, x: Symbol):
    with pytest.raises(TypeError):
        REFUSED[how](x)


def test_the_refusal_says_what_to_write_instead(x: Symbol):
    with pytest.raises(TypeError, match=r"ops\.where"):
        bool(x > 0.0)
    with pytest.raises(TypeError, match=r"ops\.equal"):
        x == 1.0  # noqa: B015
    with pytest.raises(TypeError, match=r"x\*x"):
        x**2


INSTEAD = {
    "ops.sqrt": lambda x: 1.0 + math.sqrt(2.0 * x),
    "ops.absolute": lambda x: math.fabs(x),
    "ops.exp": lambda x: [math.exp(0.0), math.exp(x)],
    "ops.atan2": lambda x: math.atan2(x, 1.0),
    "ops.sqrt(x*x + y*y)": lambda x: math.hypot(x, 1.0),
    "ops.tanh": np.tanh,
    "ops.maximum": lambda x: np.maximum(x, 0.0),
    "ops.atan(x)": np.arctan,
    "-ops.floor(-x)": math.ceil,
    "ops.floor(x + 0.5)": round,
    "ops.floor(x / y)": lambda x: np.float64(3.0) // x,
    "ops.power": lambda x: np.float64(3.0) ** x,
    "ops.minimum": lambda x: min(x, 1.0),
    "ops.both": lambda x: (x > 0.0) & (x < 1.0),
    "ops.equal": lambda x: np.float64(1.0) == x,
}


@pytest.mark.parametrize("word", INSTEAD)
def test_a_function_of_another_library_is_refused_with_what_stands_for_it(word: str, x: Symbol):
    """`math.sqrt` of a symbol said that a law uses `ops`, and not which of its functions."""
    with pytest.raises(LanguageError, match=re.escape(word)):
        INSTEAD[word](x)


def test_the_refusal_names_the_line(x: Symbol):
    with pytest.raises(LanguageError, match=r"test_graph\.py, line \d+: .*math\.sqrt\(x\)"):
        math.sqrt(x)


def test_what_is_named_for_other_functions_is_in_ops():
    assert {each for text in SPELLED.values() for each in re.findall(r"ops\.(\w+)", text)} <= set(ops.__all__)


def test_abs_is_that_of_ops_and_numbers_of_numpy_take_part(x: Symbol):
    """`abs(x)` was "bad operand type"."""
    assert abs(x).index == ops.absolute(x).index
    pairs = [
        (np.float64(2.0) * x, 2.0 * x),
        (np.float64(2.0) - x, 2.0 - x),
        (x / np.float64(2.0), x / 2.0),
        (np.float64(2.0) > x, x < 2.0),
        (np.float64(2.0) <= x, x >= 2.0),
    ]
    assert all(one.index == other.index for one, other in pairs)


def test_two_traces_do_not_mix(x: Symbol):
    with pytest.raises(StructureError, match="two traces"):
        x + Graph().input("y")


def test_an_absent_part_and_a_constant_nan_are_refused(x: Symbol):
    with pytest.raises(StructureError, match="absent"):
        x + None
    with pytest.raises(StructureError, match="NaN"):
        x + math.nan


def test_the_same_operation_is_stored_once(x: Symbol):
    first, second = x * 2.0 + 1.0, x * 2.0 + 1.0
    assert first.index == second.index


def test_zero_and_minus_zero_are_two_constants(x: Symbol):
    assert x.graph.constant(0.0).index != x.graph.constant(-0.0).index
    values = evaluate(x.graph, [x.graph.constant(-0.0).index], {})
    assert math.copysign(1.0, values[0]) == -1.0


def test_nothing_is_rearranged(x: Symbol):
    """(x + 1) - 1 is not x, and a sum that keeps what was rounded away stays as it is written (Kahan 1965)."""
    roundtrip = (x + 1.0) - 1.0
    assert evaluate(x.graph, [roundtrip.index], {"x": np.float64(1e-20)})[0] == 0.0
    total, kept = x, x.graph.constant(0.0)
    for _ in range(10):
        part = x - kept
        summed = total + part
        kept = (summed - total) - part
        total = summed
    value = np.float64(0.1)
    t, k = value, np.float64(0.0)
    for _ in range(10):
        p = value - k
        s = t + p
        k = (s - t) - p
        t = s
    assert evaluate(x.graph, [total.index], {"x": value})[0] == t


def test_what_no_output_needs_is_left_out(x: Symbol):
    used, unused = x + 1.0, x * 7.0
    kept = reachable(x.graph, [used.index])
    assert unused.index not in kept
    assert kept == sorted(kept)
    assert all(i in kept for node in kept for i in arguments(x.graph.nodes[node]))


numbers = st.floats(-1e3, 1e3)


def formula(a: object, b: object) -> object:
    """Every operation that laws are written in, on two numbers."""
    total = ops.where(a < b, a * 3.0 - b, b / 7.0 + a)
    total = total + ops.sqrt(ops.absolute(a)) - ops.floor(b) + (-a) * ops.sign(b)
    total = total + ops.clip(a, -2.0, 5.0) + ops.minimum(a, b) * ops.maximum(a, 1.0)
    total = total + ops.exp(ops.clip(a, -5.0, 5.0)) + ops.sin(a) * ops.cos(b) + ops.tanh(b) + ops.atan2(a, b)
    total = total + ops.log(1.0 + ops.absolute(a)) + ops.expm1(ops.clip(b, -1.0, 1.0)) + ops.quantise(a, 0.125)
    chosen = ops.both(ops.no(a <= b), ops.either(ops.equal(a, b), b > -1.0))
    total = ops.where(chosen, total, total * 0.5)
    return total + ops.power_of_two(ops.clip(ops.floor(a), -8.0, 8.0)) + ops.exponent(1.0 + ops.absolute(b))


@given(numbers, numbers)
def test_the_graph_has_the_bits_of_the_source(a: float, b: float):
    graph = Graph()
    traced = formula(graph.input("a"), graph.input("b"))
    assert isinstance(traced, Symbol)
    with np.errstate(all="ignore"):
        plain = formula(np.float64(a), np.float64(b))
        walked = evaluate(graph, [traced.index], {"a": np.float64(a), "b": np.float64(b)})[0]
        lanes = formula(np.array([a, a]), np.array([b, b]))
    assert walked == plain
    assert np.array_equal(lanes, [plain, plain])


def test_every_operation_of_a_graph_has_a_meaning_for_numbers():
    from feeddrive.loop.trace import apply

    truth = {"and", "or", "not"}
    for name, count in ARITY.items():
        if name in ("gather", "get", "put"):  # of tables and rings
            continue
        values = [
            np.bool_(True) if name in truth or (name == "select" and i == 0) else np.float64(1.0) for i in range(count)
        ]
        with np.errstate(all="ignore"):
            assert np.isfinite(float(apply(name, *values))), name


def test_a_truth_value_that_numpy_computed_stays_one() -> None:
    """`ops.no(True)` is a numpy bool: as a condition it once became the number 0.0, which no engine can print."""
    graph = Graph()
    chosen = ops.where(ops.no(True), graph.input("x"), 1.0)
    assert graph.nodes[graph.nodes[chosen.index][1]] == ("truth", False)
