"""Enclosures: they hold at points drawn in a cell, and they are not much wider than the numbers."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from feeddrive.certificate.enclosure import ORDER, Enclosed, enclose
from feeddrive.language import ops
from feeddrive.language.errors import ParameterError
from feeddrive.language.graph import Graph
from feeddrive.loop.trace import evaluate

MIDDLES, HALF, STEP = np.array([0.7, 1.9, 3.1]), 0.05, 0.01


def enclosed(function: Callable[[Any, Any], Any]) -> tuple[np.ndarray, Enclosed, Callable[[float, float], float]]:
    """Enclose f(x, y), x = middle + HALF t, y = x + STEP u, in each cell."""
    graph = Graph()
    end = graph.symbol(function(graph.input("x"), graph.input("y"))).index
    terms = np.stack([MIDDLES, np.full(3, HALF)])
    slope = np.array([np.full(3, STEP), np.zeros(3)])
    leaves = {"x": Enclosed(terms, None, np.zeros(3)), "y": Enclosed(terms, slope, np.zeros(3))}
    cell, (found,) = enclose(graph, [end], leaves, 3, 2)
    return cell, found, lambda x, y: float(evaluate(graph, [end], {"x": np.float64(x), "y": np.float64(y)})[0])


def farthest(function: Callable[[Any, Any], Any]) -> float:
    """Return the largest distance of f from its polynomial at drawn points, in units of the rest."""
    cell, found, exact = enclosed(function)
    random, worst = np.random.default_rng(4), 0.0
    for _ in range(200):
        row = int(random.integers(cell.size))
        t, u = random.uniform(-1.0, 1.0, 2)
        x = MIDDLES[cell[row]] + HALF * t
        value = sum(float(found.terms[k, row]) * t**k for k in range(len(found.terms)))
        assert found.slope is not None
        value += float(found.slope[0, row] + found.slope[1, row] * t) * u
        worst = max(worst, abs(exact(x, x + STEP * u) - value) / (float(found.rest[row]) + 1e-14))
    return worst


FUNCTIONS: dict[str, Callable[[Any, Any], Any]] = {
    "product": lambda x, y: (x * y + 2.0) * x - y,
    "quotient": lambda x, y: (1.0 + x * x) / (y * x + 0.5),
    "root": lambda x, y: ops.sqrt(x * y),
    "exponential": lambda x, y: ops.exp(-x) * ops.expm1(y),
    "logarithm": lambda x, y: ops.log(x) + y,
    "sine": lambda x, y: ops.sin(3.0 * x) * ops.cos(y),
    "magnitude": lambda x, y: ops.absolute(x - 5.0) * y,
    "chosen": lambda x, y: ops.where(x < 2.5, x * x, y),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_numbers_lie_in_their_enclosure(name: str) -> None:
    assert farthest(FUNCTIONS[name]) <= 1.0


@pytest.mark.parametrize("name", ["quotient", "root", "exponential", "sine"])
def test_the_rest_is_that_of_the_next_order(name: str) -> None:
    """The terms that are left out are of second order in the step and of fifth in the cell."""
    _, found, _ = enclosed(FUNCTIONS[name])
    # 20 times each: products of several factors leave several such terms
    share = HALF / float(MIDDLES[0])
    assert np.max(found.rest) < 20.0 * 30.0 * (STEP**2 + STEP * HALF**2 + share ** (ORDER + 1))


def test_the_rounding_of_a_sum_that_cancels_is_in_the_rest() -> None:
    _, found, _ = enclosed(lambda x, y: (x * 1e8 + y) - x * 1e8)
    # y is lost to a unit in the last place of 3e8
    assert np.all(found.rest > 2e-8)


def test_an_open_choice_has_the_hull_of_both_outcomes() -> None:
    """At 1.9 the comparison is open; both outcomes lie 2 apart."""
    cell, found, _ = enclosed(lambda x, y: ops.where(x < 1.91, x, x + 2.0) + 0.0 * y)
    assert cell.tolist() == [0, 1, 2]
    assert found.rest[0] < 1e-12
    assert found.rest[1] == pytest.approx(1.0 + HALF, rel=1e-6)


def test_an_open_choice_without_a_hull_splits_the_cell() -> None:
    """2^k of an open k has no bound, but one for each outcome."""
    cell, found, _ = enclosed(lambda x, y: x / ops.power_of_two(ops.where(x < 1.91, 1.0, 2.0)) + 0.0 * y)
    assert sorted(cell.tolist()) == [0, 1, 1, 2]
    values = sorted(found.terms[0, cell == 1].tolist())
    assert values == pytest.approx([1.9 / 4.0, 1.9 / 2.0])
    assert np.max(found.rest) < 1e-12


def test_a_number_that_may_be_divided_by_zero_is_unbounded() -> None:
    _, found, _ = enclosed(lambda x, y: y / (x - 1.92))
    assert np.isfinite(found.rest).tolist() == [True, False, True]


def test_what_has_no_enclosure_is_refused_by_name() -> None:
    with pytest.raises(ParameterError, match="'atan', which has no enclosure over positions"):
        enclosed(lambda x, y: ops.atan(x) + y)


def test_a_long_recursion_stays_near_the_number() -> None:
    """e^x by a thousand factors: the rest grows with the count of operations, not exponentially."""

    def many(x: Any, y: Any) -> Any:
        total = 1.0 + 0.0 * y
        for _ in range(1000):
            total = total * (1.0 + x / 1000.0)
        return total

    _, found, exact = enclosed(many)
    assert found.terms[0, 0] == pytest.approx(exact(0.7, 0.7), rel=1e-12)
    assert found.rest[0] < 1e-6 * math.exp(0.7)
