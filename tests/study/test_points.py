"""Points of the unit cube: the same in every split, and what each sampler promises."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy import stats
from scipy.stats import qmc

from feeddrive.study.distributions import grid, latin_hypercube, permuted, saltelli, sobol, uniform

TOTAL = 3000
SAMPLERS: dict[str, Callable[[int, int], np.ndarray]] = {
    "uniform": lambda first, count: uniform((7, 0), first, count, 5),
    "sobol": lambda first, count: sobol((7, 0), first, count, 5),
    "latin_hypercube": lambda first, count: latin_hypercube((7, 0), first, count, 5, TOTAL),
    "saltelli": lambda first, count: saltelli((7, 0), first, count, (1, 2, 1), TOTAL // 5),
}


@pytest.mark.parametrize("name", SAMPLERS)
@pytest.mark.parametrize("size", [1, 16, 777])
def test_a_split_range_has_the_same_bits(name: str, size: int) -> None:
    made = SAMPLERS[name]
    firsts = range(0, TOTAL, size) if size > 100 else [0, 1, 2, 599, 600, 1016, 1023, 1024, 2984]
    whole = made(0, TOTAL)
    for first in firsts:
        part = made(first, min(size, TOTAL - first))
        assert np.array_equal(part, whole[first : first + size])


@pytest.mark.parametrize("name", SAMPLERS)
def test_points_lie_inside_of_the_cube(name: str) -> None:
    found = SAMPLERS[name](0, TOTAL)
    assert np.all((found > 0.0) & (found < 1.0))


@pytest.mark.parametrize("total", [1, 2, 3, 200, 1000, 4097])
def test_a_permutation_has_every_number_once(total: int) -> None:
    found = permuted(np.arange(total, dtype=np.uint64), total, (1, 2))
    assert sorted(found.tolist()) == list(range(total))


def test_a_permutation_is_random() -> None:
    """Ranks of 20000 numbers: their correlation with the order is within 4 standard errors of 0, as are neighbors."""
    found = permuted(np.arange(20_000, dtype=np.uint64), 20_000, (3,)).astype(float)
    error = 1.0 / np.sqrt(found.size)
    assert abs(np.corrcoef(found, np.arange(found.size))[0, 1]) < 4.0 * error
    assert abs(np.corrcoef(found[1:], found[:-1])[0, 1]) < 4.0 * error


def test_a_latin_hypercube_has_one_point_in_each_stratum() -> None:
    found = SAMPLERS["latin_hypercube"](0, TOTAL)
    for column in found.T:
        assert np.array_equal(np.sort(np.floor(column * TOTAL)), np.arange(TOTAL))


def test_random_numbers_are_uniform_and_independent() -> None:
    found = uniform((11, 0), 0, 20_000, 3)
    for column in found.T:
        assert stats.kstest(column, "uniform").pvalue > 1e-3
    assert np.max(np.abs(np.corrcoef(found.T) - np.eye(3))) < 4.0 / np.sqrt(len(found))


def test_other_streams_are_other_numbers() -> None:
    assert not np.any(uniform((7, 0), 0, 100, 2) == uniform((7, 1), 0, 100, 2))
    assert not np.any(sobol((7, 0), 0, 100, 2) == sobol((7, 1), 0, 100, 2))


def test_sobol_points_fill_the_cube_better_than_random_ones() -> None:
    assert qmc.discrepancy(SAMPLERS["sobol"](0, 1024)) < 0.1 * qmc.discrepancy(SAMPLERS["uniform"](0, 1024))


def test_saltelli_swaps_one_factor_at_a_time() -> None:
    n, groups = 512, (1, 2, 1)
    found = saltelli((7, 0), 0, n * 5, groups, n).reshape(5, n, 4)
    a, b = found[0], found[1]
    ends = np.cumsum((0, *groups))
    for j in range(3):
        own = np.zeros(4, dtype=bool)
        own[ends[j] : ends[j + 1]] = True
        assert np.array_equal(found[2 + j][:, own], b[:, own])
        assert np.array_equal(found[2 + j][:, ~own], a[:, ~own])
    assert not np.any(a == b)


def test_a_grid_has_every_combination_with_the_last_fastest() -> None:
    assert grid(0, 6, (2, 3)).tolist() == [[0, 0], [0, 1], [0, 2], [1, 0], [1, 1], [1, 2]]
    assert grid(4, 2, (2, 3)).tolist() == [[1, 1], [1, 2]]
