"""Cases on the cores of this machine: no service, and nothing to start.

Machine code that leaves Python to other threads is computed by threads of this process: they share the compiled code
and start at once.  What is Python, of which one thread runs at a time, is computed by processes; one that is killed is
replaced, and its cases are computed again.
"""

from __future__ import annotations

import contextlib
import itertools
import multiprocessing
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from queue import Empty
from typing import Any, TypeVar

from feeddrive.evaluation.case import Case, attached, computed, detached
from feeddrive.language.errors import WorkerError
from feeddrive.language.processes import follow_parent, one_thread
from feeddrive.language.progress import Progress

C = TypeVar("C", bound=Case[Any])
_AHEAD = 2  # cases for each worker that are handed out: one in work and one that waits, so that memory is constant
_LOOK = 0.1  # s after which a cancel is seen
_LOSSES = 3  # times that processes may end by themselves without a case in between


def by_threads(cases: Iterable[C], workers: int, progress: Progress) -> Generator[tuple[C, Any]]:
    """Yield cases with their outcomes as they are done, computed by threads of this process."""
    ended = Progress()
    pool = ThreadPoolExecutor(workers, "case")
    try:
        yield from _window(iter(cases), lambda case, _: pool.submit(case.outcome, ended), workers, progress, {})
    finally:
        ended.cancel()  # a thread that is at work ends at its next step
        pool.shutdown(cancel_futures=True)


def by_processes(
    cases: Iterable[C], workers: int, progress: Progress, tell: Callable[[Case[Any], str], None]
) -> Generator[tuple[C, Any]]:
    """Yield cases with their outcomes as they are done, computed by processes.

    tell  is told the stages within cases that have several

    Raises CancelledError within 0.1 s of a cancel, and WorkerError if processes are killed again and again.
    """
    left = iter(cases)
    handed = dict[int, C]()  # to processes, and not back
    losses = 0
    while True:
        first = next(left, None)
        if first is None:
            return
        common, _ = detached(first)
        try:
            with _processes(workers, common) as (pool, news):

                def submit(case: C, number: int, pool: Executor = pool, sent: Any = common) -> Future[Any]:
                    own, rest = detached(case)
                    alike = all(mine is theirs for mine, theirs in zip(own, sent, strict=True))
                    return pool.submit(_here, rest if alike else case, number, alike)

                def hear(news: Any = news) -> None:
                    with contextlib.suppress(Empty):
                        while True:
                            number, what = news.get_nowait()
                            if number in handed:
                                tell(handed[number], what)

                for done in _window(itertools.chain([first], left), submit, workers, progress, handed, hear):
                    losses = 0
                    yield done
            return
        except BrokenProcessPool:
            losses += 1
            again = [handed[number] for number in sorted(handed)]
            if losses > _LOSSES:
                raise WorkerError(
                    f"processes were killed {losses} times in a row, at {', '.join(case.name for case in again)}: is "
                    "there enough memory for as many --workers?  (A program of your own needs  "
                    "if __name__ == '__main__':  around its call.)"
                ) from None
            left = itertools.chain(again, left)
            handed.clear()


def _window(
    cases: Iterator[C],
    submit: Callable[[C, int], Future[Any]],
    workers: int,
    progress: Progress,
    handed: dict[int, C],
    hear: Callable[[], None] = lambda: None,
) -> Generator[tuple[C, Any]]:
    """Cases as they are done; as many are handed out at a time as keep all workers busy, and stand in `handed`."""
    waiting: dict[Future[Any], int] = {}
    numbers = itertools.count()

    def hand_out(count: int) -> None:
        for case in itertools.islice(cases, count):
            number = next(numbers)
            handed[number] = case
            waiting[submit(case, number)] = number

    hand_out(_AHEAD * workers)
    while waiting:
        done, _ = wait(waiting, _LOOK, FIRST_COMPLETED)
        hear()
        progress.check()
        for future in done:
            outcome = future.result()
            case = handed.pop(waiting.pop(future))
            hand_out(1)
            yield case, outcome


@contextmanager
def _processes(workers: int, common: tuple[Any, ...]) -> Generator[tuple[Executor, Any]]:
    """Processes that know what all cases have in common, and their news; they end with the block, also at work."""
    # a fresh interpreter each: a fork would copy the locks of the caller's threads
    context = multiprocessing.get_context("spawn")
    news: Any = context.Queue()
    with one_thread():
        before = set(multiprocessing.active_children())
        pool = ProcessPoolExecutor(workers, context, _begin, (common, news))
        try:
            yield pool, news
        except BaseException:
            for child in set(multiprocessing.active_children()) - before:
                child.terminate()
            raise
        finally:
            pool.shutdown(cancel_futures=True)


_common: tuple[Any, ...] = ()  # of a process: what its cases have in common
_news: Any = None  # of a process: where it tells the stages of its cases


def _begin(common: tuple[Any, ...], news: Any) -> None:
    global _common, _news
    follow_parent()
    _common, _news = common, news


class _Told(Progress):
    """The progress of a case in a process of its own."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self._number = number

    def show_step(self, what: str, done: int | None, of: int | None, part: str) -> None:
        if of is None:  # not a part of the stage before
            _news.put((self._number, what))


def _here(case: Case[Any], number: int, detached: bool) -> Any:
    whole = attached(case, _common) if detached else case
    return computed(whole, _Told(number) if case.stages > 1 else Progress())
