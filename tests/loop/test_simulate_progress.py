"""A run that reports how far it is has the same bits, and ends where it is canceled."""

from __future__ import annotations

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.language.errors import CancelledError
from feeddrive.language.progress import Progress
from feeddrive.loop.simulate import CHUNK


class Heard(Progress):
    """Keeps the steps; cancels itself after some."""

    def __init__(self, most: int = 10**6) -> None:
        super().__init__()
        self.steps, self.most = list[tuple[str, int | None, int | None]](), most

    def show_step(self, what: str, done: int | None, of: int | None, part: str) -> None:
        self.steps.append((what, done, of))
        if len(self.steps) >= self.most:
            self.cancel()


def given() -> tuple[fd.Loop, fd.blocks.Polynomial7, float]:
    loop = fd.read_machine("ball_screw").loop("x")
    return loop, fd.blocks.Polynomial7(distance=0.05, travel_time=0.5), 3.3 * CHUNK * loop.sample_time


def test_a_run_in_pieces_has_the_bits_of_one_in_one_piece() -> None:
    loop, move, duration = given()
    heard = Heard()
    found = fd.simulate(loop, move, duration=duration, seed=3, progress=heard)
    whole = fd.simulate(loop, move, duration=duration, seed=3)
    assert found.samples == whole.samples
    assert list(found.signals) == list(whole.signals)
    assert all(np.array_equal(found[name], whole[name]) for name in whole.signals)
    assert np.array_equal(found.time, whole.time)
    assert found.units == whole.units
    assert [done for _, done, _ in heard.steps] == [int(k * CHUNK * loop.sample_time) for k in range(4)]


def test_a_cancel_ends_a_run_between_two_pieces() -> None:
    loop, move, duration = given()
    heard = Heard(most=2)
    with pytest.raises(CancelledError):
        fd.simulate(loop, move, duration=duration, progress=heard)
    assert len(heard.steps) == 2


def test_a_step_with_a_count_of_its_own_is_a_part_of_the_one_before() -> None:
    heard = Heard()
    counted = heard.counted(2)
    counted.step("one")
    counted.step("seconds", 3, 8)
    counted.step("two")
    assert heard.steps == [("one", 0, 2), ("seconds", 3, 8), ("two", 1, 2)]
