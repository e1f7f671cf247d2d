"""The chunks of a study on the cores of this machine: no service, and nothing to start.

Statistics of batches are machine code that leaves Python to other threads, so threads of this process compute them:
they share the compiled code and start at once.  Linear models and runs of single variants are Python, of which one
thread runs at a time, so processes compute them; one that is killed is replaced, and its chunks are computed again.
"""

from __future__ import annotations

import itertools
import multiprocessing
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING

from feeddrive.language.errors import WorkerError
from feeddrive.language.processes import follow_parent, one_thread
from feeddrive.language.progress import Progress
from feeddrive.study.chunk import run_chunk
from feeddrive.study.study import Study

if TYPE_CHECKING:
    import pyarrow

_AHEAD = 2  # chunks for each worker that are handed out: one in work and one that waits, so that memory is constant
_LOOK = 0.1  # s after which a cancel is seen
_LOSSES = 3  # times that processes may end by themselves without a chunk in between


def finished(
    study: Study, numbers: Iterable[int], workers: int, progress: Progress
) -> Generator[tuple[int, pyarrow.Table]]:
    """Number and rows of each chunk, in the order in which they are done; closing it ends the work.

    Raises CancelledError within 0.1 s of a cancel, and WorkerError if processes are killed again and again.
    """
    if all(each.needs == "statistics" for each in study.measure):
        yield from _by_threads(study, iter(numbers), workers, progress)
    else:
        yield from _by_processes(study, iter(numbers), workers, progress)


def _by_threads(
    study: Study, numbers: Iterator[int], workers: int, progress: Progress
) -> Generator[tuple[int, pyarrow.Table]]:
    ended = Progress()
    pool = ThreadPoolExecutor(workers, "chunk")
    try:
        yield from _window(
            numbers, lambda n: pool.submit(run_chunk, study, n, progress=ended), workers, progress, set()
        )
    finally:
        ended.cancel()  # a thread that is at work ends after its next group of variants
        pool.shutdown(cancel_futures=True)


def _by_processes(
    study: Study, numbers: Iterator[int], workers: int, progress: Progress
) -> Generator[tuple[int, pyarrow.Table]]:
    handed: set[int] = set()  # to processes, and not back
    losses = 0
    while True:
        try:
            with _processes(study, workers) as pool:
                for found in _window(numbers, partial(pool.submit, _here), workers, progress, handed):
                    losses = 0
                    yield found
            return
        except BrokenProcessPool:
            losses += 1
            if losses > _LOSSES:
                raise WorkerError(
                    f"processes of the sweep were killed {losses} times in a row, at the chunks "
                    f"{', '.join(map(str, sorted(handed)))}: is there enough memory for as many --workers?  (A program "
                    "of your own needs  if __name__ == '__main__':  around its call.)"
                ) from None
            numbers = itertools.chain(sorted(handed), numbers)
            handed.clear()


def _window(
    numbers: Iterator[int], submit: Callable[[int], Future[pyarrow.Table]], workers: int, progress: Progress,
    handed: set[int],
) -> Generator[tuple[int, pyarrow.Table]]:  # fmt: skip
    """Chunks as they are done; as many are handed out at a time as keep all workers busy, and stand in `handed`."""
    waiting: dict[Future[pyarrow.Table], int] = {}

    def hand_out(count: int) -> None:
        for number in itertools.islice(numbers, count):
            handed.add(number)
            waiting[submit(number)] = number

    hand_out(_AHEAD * workers)
    while waiting:
        done, _ = wait(waiting, _LOOK, FIRST_COMPLETED)
        progress.check()
        for future in done:
            rows = future.result()
            number = waiting.pop(future)
            handed.discard(number)
            hand_out(1)
            yield number, rows


@contextmanager
def _processes(study: Study, workers: int) -> Generator[Executor]:
    """Processes that know the study; they end with the block, also while they work."""
    # a fresh interpreter each: a fork would copy the locks of the caller's threads
    with one_thread():
        pool = ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), _begin, (study,))
        before = set(multiprocessing.active_children())
        try:
            yield pool
        except BaseException:
            for child in set(multiprocessing.active_children()) - before:
                child.terminate()
            raise
        finally:
            pool.shutdown(cancel_futures=True)


_study: Study  # of a process: what it computes chunks of


def _begin(study: Study) -> None:
    global _study
    follow_parent()
    _study = study


def _here(number: int) -> pyarrow.Table:
    return run_chunk(_study, number)
