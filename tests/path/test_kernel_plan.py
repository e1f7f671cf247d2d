"""The planner of the benchmark: whole plans by machine code, by the interpreter and by C have the same bits."""

from __future__ import annotations

import ctypes
import random
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fresh_draws import Seeded
from kernel_oracle import compare

FOLDER = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture
def planner(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(FOLDER))
    import kernel_plan

    return kernel_plan.plan_and_sample


def plans(count: int, seed: int) -> Iterator[list[Any]]:
    """Paths of 1 to 39 pieces; limits and caps over decades; room for the plan is too small at times."""
    draw = random.Random(seed)
    for _ in range(count):
        n = draw.randint(1, 39)
        ends = np.cumsum([0.0, *(10.0 ** draw.uniform(-5, -1) for _ in range(n))])
        caps = np.array([10.0 ** draw.uniform(-3, 0) for _ in range(n)])
        limits = 10.0 ** draw.uniform(-1, 2), 10.0 ** draw.uniform(0, 4), 10.0 ** draw.uniform(2, 6)
        room = draw.choice([15 * n, 15 * n, 15 * n, n])
        yield [
            ends,
            caps,
            *limits,
            np.zeros(9 * n + 9, dtype=np.int64),
            np.zeros((3 * n + 3, 2)),
            np.zeros(room),
            np.zeros((room, 5)),
            np.linspace(0.0, 1.0, 20),
            np.zeros((20, 5)),
        ]


def test_whole_plans_have_the_bits_of_the_interpreter(planner: Any, seeded: Seeded):
    assert compare(planner, plans(12, seed=seeded(1))) < 12


@pytest.mark.slow(reason="650 whole plans by the interpreter, 54 times what the quick test has")
def test_many_whole_plans_have_the_bits_of_the_interpreter(planner: Any):
    assert 0 < compare(planner, plans(650, seed=2)) < 400


def test_c_by_hand_of_the_benchmark_has_the_same_bits(planner: Any, tmp_path: Path):
    """What kernels are timed against computes the same, or the comparison would mean nothing."""
    if not shutil.which("gcc"):
        pytest.skip("NOT TESTED against C by hand: there is no gcc")
    import compiler
    import kernels

    source = (FOLDER / "kernel_plan.c").read_text(encoding="utf-8")
    library = compiler.library(source, ["gcc"], ["-O2", "-ffp-contract=off"])
    library.plan_and_sample.restype = ctypes.c_int64
    given, other = kernels.arguments(7), kernels.arguments(7)
    count, _, way = planner(*given)
    assert way == pytest.approx(given[0][-1], rel=1e-12)
    assert kernels.by_hand(library, other) == count > 500
    assert np.array_equal(given[-3][:count], other[-3][:count])
    assert np.array_equal(given[-1], other[-1])
    assert np.ptp(given[-1][:, 1]) > 0.01  # m/s: setpoints of a motion, not zeros
