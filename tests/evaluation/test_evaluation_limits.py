"""What the engine waits for, hands out and reads: a case on either side of each limit."""

# pyright: reportPrivateUsage=false

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from queue import Queue
from typing import Any

import pytest

from feeddrive.evaluation import cluster, engine
from feeddrive.evaluation.case import Case
from feeddrive.evaluation.store import Folder
from feeddrive.language.errors import CancelledError, WorkerError
from feeddrive.language.progress import Progress


@dataclass(frozen=True, eq=False)
class Number(Case[int]):
    """A number that is its own outcome."""

    number: int

    @property
    def name(self) -> str:
        return f"number {self.number}"

    def outcome(self, progress: Progress) -> int:
        return self.number

    def record(self, outcome: int) -> int:
        return outcome

    def restored(self, record: Any, progress: Progress) -> int:
        return int(record)


def test_each_worker_has_a_case_in_work_and_one_that_waits() -> None:
    """More of them would be in memory at once; fewer would let a worker wait for the caller."""
    taken = list[int]()

    def many() -> Iterator[Number]:
        for number in range(100):
            taken.append(number)
            yield Number(number)

    waiting = list[Future[int]]()

    def submit(case: Number, number: int) -> Future[int]:
        waiting.append(Future())
        if number == 0:
            waiting[0].set_result(0)
        return waiting[-1]

    workers = 3
    finished = engine._window(many(), submit, workers, Progress(), {})
    next(finished)
    assert len(taken) == 2 * workers + 1  # and the one that is done
    finished.close()


def test_a_cancel_is_seen_within_a_tenth_of_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    progress, times = Progress(), list[float]()

    def wait(waiting: object, timeout: float, _: object) -> tuple[set[Future[int]], object]:
        times.append(timeout)
        progress.cancel()
        return set(), waiting

    monkeypatch.setattr(engine, "wait", wait)
    with pytest.raises(CancelledError):
        list(engine._window(iter([Number(0)]), lambda *_: Future(), 1, progress, {}))
    assert max(times) < 0.15


@pytest.mark.parametrize(("losses", "given_up"), [(3, False), (4, True)])
def test_processes_may_be_killed_three_times_in_a_row(
    losses: int, given_up: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without a case in between; then there is likely too little memory, which no further try heals."""
    left = iter([True] * losses)

    class Pool:
        """Its process ends as soon as it has a case, as long as losses are left."""

        def submit(self, _: object, case: Number, *__: object) -> Future[int]:
            if next(left, False):
                raise BrokenProcessPool
            future = Future[int]()
            future.set_result(case.number)
            return future

    monkeypatch.setattr(engine, "_processes", lambda *_: contextlib.nullcontext((Pool(), Queue())))
    found = engine.by_processes([Number(7)], 1, Progress(), lambda *_: None)
    if given_up:
        with pytest.raises(WorkerError, match=f"killed {losses} times in a row"):
            list(found)
    else:
        assert [outcome for _, outcome in found] == [7]


@pytest.mark.parametrize(("megabytes", "read"), [(3, True), (6, False)])
def test_a_finished_case_of_up_to_four_megabytes_is_read(megabytes: int, read: bool, tmp_path: Path) -> None:
    store, case = Folder(tmp_path), Number(7)
    store.keep(case, 7)
    (path,) = tmp_path.iterdir()
    path.write_text(path.read_text() + " " * (megabytes * 1_000_000))  # JSON may have any space behind it
    assert store.known(case, Progress()) == (7 if read else None)


class Remarks(Progress):
    """The remarks."""

    def __init__(self) -> None:
        super().__init__()
        self.remarks = list[str]()

    def show_remark(self, message: object) -> None:
        self.remarks.append(str(message))


class Client:
    """A client of a cluster with some threads."""

    status = "running"

    def __init__(self, threads: int) -> None:
        self.threads = threads

    def nthreads(self) -> dict[str, int]:
        return {"worker": self.threads} if self.threads else {}


@pytest.mark.parametrize(("seconds", "remarks"), [(20.0, 0), (45.0, 1)])
def test_a_cluster_without_workers_is_named_after_half_a_minute(
    seconds: float, remarks: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A cluster that grows on demand needs some seconds for its first worker."""
    now = [100.0]
    monkeypatch.setattr(cluster.time, "monotonic", lambda: now[0])
    progress = Remarks()
    handed = cluster._Handed[Number](Client(0), "tcp://127.0.0.1:8786", progress)
    handed._window()
    now[0] += seconds
    handed._window()
    assert len(progress.remarks) == remarks
    assert all("no workers" in remark for remark in progress.remarks)


@pytest.mark.parametrize(("times", "given_up"), [(3, False), (4, True)])
def test_dask_may_give_a_case_up_three_times(times: int, given_up: bool) -> None:
    from distributed import KilledWorker

    handed = cluster._Handed[Number](Client(2), "tcp://127.0.0.1:8786", Progress())
    place = cluster._Place(Number(7), 0)
    answer = KilledWorker, KilledWorker("number 7", None, 3), None  # type: ignore[arg-type]
    for _ in range(times - 1):
        handed._explain(place, answer)
    if given_up:
        with pytest.raises(WorkerError, match=f"number 7 was given up {times} times"):
            handed._explain(place, answer)
    else:
        handed._explain(place, answer)


@pytest.mark.parametrize("threads", [4, 10])
def test_a_thread_of_a_cluster_never_waits_for_the_client(threads: int) -> None:
    """Each has a case beside the one in work while the client reads the outcome of a third."""
    handed = cluster._Handed[Number](Client(threads), "tcp://127.0.0.1:8786", Progress())
    assert 2 * threads < handed._window() <= 4 * threads
