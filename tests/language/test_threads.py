"""Stages in threads: the same items and errors in the same order, and an end without delay."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing

import pytest

from feeddrive.language.kernels.kernel import interpreted, kernel
from feeddrive.language.threads import ahead, in_order, through


def counted(until: int, seen: list[int] | None = None) -> Iterator[int]:
    """Numbers from 0 on, and an error in place of `until`."""
    number = 0
    try:
        while number < until:
            yield number
            number += 1
        raise ValueError(f"no {until}")
    finally:
        if seen is not None:
            seen.append(number)


def taken(items: Iterator[int]) -> tuple[list[int], str]:
    """The items up to an error, and its text."""
    out = list[int]()
    try:
        for item in items:
            out.append(item)
    except ValueError as error:
        return out, str(error)
    return out, ""


@pytest.mark.parametrize("most", [1, 3])
@pytest.mark.parametrize("until", [0, 1, 50])
def test_errors_come_behind_the_items_before_them(most: int, until: int) -> None:
    """Whether the items are made in the other thread or in this one."""
    wanted = list(range(until)), f"no {until}"
    assert taken(ahead(counted(until), most)) == wanted
    assert taken(through(counted(until), lambda items: items, most)) == wanted


def test_an_error_of_a_stage_comes_in_order() -> None:
    def stage(items: Iterator[int]) -> Iterator[int]:
        for item in items:
            if item == 7:
                raise ValueError("seven")
            yield from (item, -item)

    found, said = taken(through(counted(50), stage, 2))
    assert found == [sign * k for k in range(7) for sign in (1, -1)]
    assert said == "seven"


def test_a_stage_may_give_more_or_fewer_items_and_end_early() -> None:
    assert taken(through(counted(20), lambda items: (k for k in items if k % 5 == 0), 2))[0] == [0, 5, 10, 15]
    assert list(through(iter(range(10**9)), lambda items: [next(items), next(items)], 2)) == [0, 1]


def test_no_more_items_are_made_than_are_taken_and_wait() -> None:
    """Items that take 2 ms are handed over one by one: one is taken, two wait, and one more is made."""
    made = list[int]()

    def slow() -> Iterator[int]:
        for k in range(1000):
            threading.Event().wait(0.003)
            made.append(k)
            yield k

    with closing(ahead(slow(), 2)) as items:
        next(items)
        threading.Event().wait(0.1)
        assert len(made) <= 4
    with closing(through(slow(), lambda given: given, 2)) as items:
        made.clear()
        next(items)
        assert len(made) <= 8


def test_closing_ends_threads_and_closes_generators_in_them() -> None:
    before, seen = threading.active_count(), list[int]()
    for items in (ahead(counted(10**9, seen), 2), through(counted(10**9), lambda given: ahead(given, 2), 2)):
        with closing(items):
            next(items)
        assert threading.active_count() == before
    assert len(seen) == 1


def test_results_have_the_order_of_their_items_and_context_variables_are_kept() -> None:
    @kernel
    def third(x: float) -> float:
        return x / 3.0

    threads = set[int]()

    def work(x: float) -> float:
        threads.add(threading.get_ident())
        return third(x)

    items = [float(k) for k in range(30)]
    with ThreadPoolExecutor(2) as workers, interpreted():
        assert list(in_order(workers, work, items)) == list(in_order(None, work, items)) == [x / 3.0 for x in items]
        assert list(through(iter(items), lambda given: map(work, given), 2)) == [x / 3.0 for x in items]
    # no machine code was made: the threads have run the interpreter, too
    assert third.unit.latest is None
    assert len(threads) > 1
