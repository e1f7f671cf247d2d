"""Small matrices: against scipy, and the same bits for numbers, lanes and symbols."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import linalg

from feeddrive.language import matrix
from feeddrive.language.graph import Graph, Symbol
from feeddrive.loop.trace import evaluate

sizes = st.integers(1, 5)
seeds = st.integers(0, 2**32 - 1)


def rows(a: np.ndarray) -> matrix.Matrix:
    return tuple(tuple(np.float64(x) for x in row) for row in a)


def positive_definite(random: np.random.Generator, n: int) -> np.ndarray:
    half = random.normal(size=(n, n))
    return half @ half.T + 0.1 * np.eye(n)


@given(sizes, seeds)
def test_solve_is_that_of_lapack(n: int, seed: int):
    random = np.random.default_rng(seed)
    a, b = positive_definite(random, n), random.normal(size=(n, 2))
    # Gauss without pivoting on a positive definite matrix is backward stable: n·cond·2⁻⁵², with a factor of 10
    allowed = 10 * n * np.linalg.cond(a) * 2.0**-52 * np.max(np.abs(np.linalg.solve(a, b)))
    assert np.max(np.abs(np.array(matrix.solve(rows(a), rows(b))) - np.linalg.solve(a, b))) <= allowed


@given(sizes, seeds, st.floats(-12.0, 2.0))
@settings(max_examples=60)
def test_expm1_is_that_of_scipy_and_keeps_small_matrices(n: int, seed: int, decade: float):
    random = np.random.default_rng(seed)
    a = random.normal(size=(n, n))
    a = a - (np.max(np.linalg.eigvals(a).real) + 0.1) * np.eye(n)  # stable, as a plant is
    a *= 10.0**decade / np.max(np.sum(np.abs(a), axis=1))
    got = np.array(matrix.expm1(rows(a)), dtype=float)
    if decade < -1.0:
        # e^A - 1 = A φ(A), with φ by its series: no ones that swallow the digits of a small A
        series, term = np.eye(n), np.eye(n)
        for k in range(2, 30):
            term = term @ a / k
            series = series + term
        true, scale = a @ series, np.max(np.abs(a))
        assert np.max(np.abs(got - true)) <= 1e-14 * scale
    else:
        true = linalg.expm(a) - np.eye(n)
        # each of up to 8 squarings doubles the relative error of the one before
        assert np.max(np.abs(got - true)) <= 1e-12 * (1.0 + np.max(np.abs(true)))


def test_expm1_of_a_nilpotent_matrix_is_exact():
    """A mass that nothing slows down: x'' = u has e^A - 1 = [[0, 1, 1/2], [0, 0, 1], [0, 0, 0]]."""
    a = rows(np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]]))
    got = np.array(matrix.expm1(a), dtype=float)
    assert np.array_equal(got, [[0.0, 1.0, 0.5], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])


def test_expm1_up_to_the_largest_norm():
    """-2⁹ on the diagonal, the largest norm that is promised: e^-512 - 1 = -1."""
    assert float(matrix.expm1(((np.float64(-512.0),),))[0][0]) == pytest.approx(-1.0, abs=1e-12)
    x = 2.0**9
    assert float(matrix.expm1(((np.float64(x),),))[0][0]) == pytest.approx(math.expm1(x), rel=1e-10)


@given(sizes, seeds, st.floats(2.0, 400.0))
@settings(max_examples=30)
def test_squarings_that_are_needed_anyway_change_no_bit(n: int, seed: int, norm: float):
    """A norm above 1 is halved twice at least: then no line of the traced text asks whether once would do."""
    a = np.random.default_rng(seed).normal(size=(n, n))
    a *= norm / np.max(np.sum(np.abs(a), axis=1)) * (1.0 + 1e-12)
    assert matrix.expm1(rows(a), at_least=2) == matrix.expm1(rows(a))
    counts = list[int]()
    for at_least in (0, 2):
        graph = Graph()
        matrix.expm1([[graph.input(f"a{i}{j}") for j in range(n)] for i in range(n)], at_least)
        counts.append(sum(1 for each in graph.nodes if each[0] == "select"))
    assert counts[0] - counts[1] == 2 + 2 * n * n  # of the number, and of each entry


@given(sizes, seeds)
@settings(max_examples=30)
def test_lanes_have_the_bits_of_their_numbers(n: int, seed: int):
    random = np.random.default_rng(seed)
    stack = random.normal(size=(n, n, 4)) * 10.0 ** random.uniform(-3, 1.5, size=4)
    lanes = matrix.expm1(tuple(tuple(stack[i, j] for j in range(n)) for i in range(n)))
    for lane in range(4):
        alone = np.array(matrix.expm1(rows(stack[:, :, lane])))
        assert np.array_equal(alone, [[x[lane] for x in row] for row in lanes])


@given(st.integers(1, 3), seeds)
@settings(max_examples=15, deadline=None)
def test_symbols_have_the_bits_of_their_numbers(n: int, seed: int):
    random = np.random.default_rng(seed)
    a = random.normal(size=(n, n)) * 10.0 ** random.uniform(-3, 1.5)
    b = positive_definite(random, n)
    graph = Graph()

    def symbols(name: str) -> matrix.Matrix:
        return tuple(tuple(graph.input(f"{name}{i}{j}") for j in range(n)) for i in range(n))

    traced = [
        x for made in (matrix.expm1(symbols("a")), matrix.solve(symbols("b"), symbols("a"))) for r in made for x in r
    ]
    leaves = {
        f"{name}{i}{j}": np.float64(m[i, j]) for name, m in (("a", a), ("b", b)) for i in range(n) for j in range(n)
    }
    values = evaluate(graph, [x.index for x in traced if isinstance(x, Symbol)], leaves)
    plain = [x for made in (matrix.expm1(rows(a)), matrix.solve(rows(b), rows(a))) for r in made for x in r]
    assert np.array_equal(np.array(values), np.array(plain))


def test_zeros_and_ones_of_the_text_cost_nothing():
    graph = Graph()
    x = graph.input("x")
    assert matrix.dot((0.0, 1.0, 0.0), (x, x, x)) is x
    assert matrix.add(((0.0,),), ((x,),))[0][0] is x
    assert len(graph.nodes) == 1
    # a zero that is a value and not part of the text stays an operation, or variants would differ in structure
    assert matrix.dot((np.float64(0.0),), (x,)) is not x


@pytest.mark.parametrize(("values", "expected"), [([1.0, 2.0, 4.0, 8.0], 3.0), ([8.0, 4.0, 2.0], 3.0)])
def test_the_edge_of_a_condition_is_found_from_either_side(values: list[float], expected: float) -> None:
    found = matrix.edge(lambda x: x <= expected, values)
    assert found is not None
    assert found <= expected
    assert found == pytest.approx(expected, rel=1e-5)  # as the docstring states


def test_a_condition_that_never_changes_has_no_edge() -> None:
    assert matrix.edge(lambda x: x > 0.0, [1.0, 2.0]) is None
    assert matrix.edge(lambda _: np.bool_(True), [1.0, 2.0]) is None  # nor one that does not depend on the value


def test_growth_of_lanes_is_that_of_each_matrix() -> None:
    """Of three variants the second is not finite; no bits are claimed, the eigenvalues are LAPACK's."""
    a = [[np.array([0.5, np.inf, 3.0]), 1.0], [0.0, np.array([2.0, 1.0, 0.25])]]
    np.testing.assert_allclose(matrix.growth(a), [2.0, np.inf, 3.0], rtol=1e-14)
    assert matrix.growth([[0.0, 2.0], [-2.0, 0.0]]) == pytest.approx(2.0, rel=1e-14)


@given(sizes, seeds)
def test_products_of_numbers_are_the_sums_of_dot_and_keep_literal_zeros(n: int, seed: int):
    random = np.random.default_rng(seed)

    def sparse() -> matrix.Matrix:
        # literal zeros, which cause no operation, beside computed ones, infinity and NaN
        chosen = (0.0, np.float64(0.0), np.float64(-0.0), np.float64(np.inf), np.float64(np.nan))
        return tuple(
            tuple(
                chosen[random.integers(5)] if random.random() < 0.5 else np.float64(random.normal()) for _ in range(n)
            )
            for _ in range(n)
        )

    a, b = sparse(), sparse()
    with np.errstate(all="ignore"):
        expected = [[matrix.dot(row, column) for column in zip(*b, strict=True)] for row in a]
    for row, wanted in zip(matrix.multiply(a, b), expected, strict=True):
        # of NaN no bits: its sign may differ
        assert [(type(x), str(x)) for x in row] == [(type(x), str(x)) for x in wanted]


@pytest.mark.parametrize("radius", [0.5, 1.0 - 1e-9, 1.0, 1.0 + 1e-9, math.nan])
def test_matrices_decay_together_if_each_of_them_does(radius: float):
    def turning(size: float) -> matrix.Matrix:
        return rows(size * np.array([[np.cos(0.3), np.sin(0.3)], [-np.sin(0.3), np.cos(0.3)]]))

    several = [turning(size) for size in (0.1, radius, 0.999)]
    alone = [bool(matrix.decays(one)) for one in several]
    assert alone == [True, radius < 1.0, True]
    assert bool(matrix.all_decay(several)) == all(alone)
    # variants of an array are judged one by one
    lanes = [tuple(tuple(np.array([x, 0.5 * x]) for x in row) for row in one) for one in several]
    assert np.array_equal(matrix.all_decay(lanes), [radius < 1.0, not math.isnan(radius)])


def test_of_matrices_of_symbols_each_is_a_condition():
    graph = Graph()
    size = graph.input("size")
    holds = matrix.all_decay([[[size]], [[0.5 * size]], [[np.float64(0.5)]]])
    names = [node[0] for node in graph.nodes]
    assert isinstance(holds, Symbol)
    assert names.count("decays") == 2
    assert names[holds.index] == "and"
