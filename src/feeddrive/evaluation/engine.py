"""The engine that evaluates cases in this process, on all cores or on a Dask cluster, and can be stopped and resumed.

    engine = Engine(workers=4, store=Folder(Path("kept")))
    outcomes = engine.evaluate(cases, progress)          # in the order of the cases

    for case, outcome in engine.finished(cases, progress):    # on completion; memory does not grow with the cases
        ...

The outcome of a case does not depend on where it is computed.  Comparison, benchmark, study and run declare cases for
this engine, which alone handles process pools, Dask and resuming.

On the cores of this machine no service has to be started.  Cases in machine code that releases the interpreter lock are
computed by threads of this process, which share the compiled code and start at once.  Cases in Python code, which only
one thread can execute at a time, are computed by processes; a killed process is replaced, and its cases are computed
again.
"""

from __future__ import annotations

import contextlib
import itertools
import multiprocessing
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager
from dataclasses import dataclass
from queue import Empty
from typing import Any, TypeVar

from feeddrive.evaluation.case import Case, attached, computed, detached
from feeddrive.evaluation.scheduler import Certificates
from feeddrive.evaluation.store import Store
from feeddrive.language.errors import ParameterError, WorkerError
from feeddrive.language.progress import Progress, follow_parent, one_thread
from feeddrive.language.threads import cores

C = TypeVar("C", bound=Case[Any])
# cases handed out for each worker: one at work and one that waits; with more, memory would grow with the cases
_AHEAD = 2
_LOOK = 0.1  # s after which a cancel is seen
# times in a row, without a finished case in between, that processes may be killed
_LOSSES = 3
# a fresh interpreter each: a fork would copy the locks of the caller's threads
_CONTEXT = multiprocessing.get_context("spawn")


def by_threads(cases: Iterable[C], workers: int, progress: Progress) -> Generator[tuple[C, Any]]:
    """Yield cases with their outcomes on completion, computed by threads of this process."""
    ended = Progress()
    pool = ThreadPoolExecutor(workers, "case")
    try:
        yield from _window(iter(cases), lambda case, _: pool.submit(case.outcome, ended), workers, progress, {})
    finally:
        # a thread cannot be killed: the case at work ends at its next step
        ended.cancel()
        pool.shutdown(cancel_futures=True)


def by_processes(
    cases: Iterable[C], workers: int, progress: Progress, tell: Callable[[Case[Any], str], None]
) -> Generator[tuple[C, Any]]:
    """Yield cases with their outcomes on completion, computed by processes.

    tell  called with a case and the name of its stage, for cases with several stages

    Raises CancelledError within 0.1 s of a cancellation, and WorkerError if processes are killed repeatedly.
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
                # pool and shared fields are bound as defaults, since the loop makes others after a loss
                def submit(case: C, number: int, pool: Executor = pool, sent: Any = common) -> Future[Any]:
                    own, rest = detached(case)
                    alike = all(mine is theirs for mine, theirs in zip(own, sent, strict=True))
                    return pool.submit(_here, rest if alike else case, number, alike)

                def hear(news: Any = news) -> None:
                    with contextlib.suppress(Empty):
                        while True:
                            number, what = news.get_nowait()
                            # a message may arrive after the outcome of its case
                            if number in handed:
                                tell(handed[number], what)

                for done in _window(itertools.chain([first], left), submit, workers, progress, handed, hear):
                    # a finished case shows that the machine can go on: only losses in a row count
                    losses = 0
                    yield done
            return
        except BrokenProcessPool:
            losses += 1
            # it is unknown which case killed the process: all pending ones are computed again
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
    """Yield cases with their outcomes; `handed` contains the pending cases, just enough to keep all workers busy."""
    waiting: dict[Future[Any], int] = {}
    numbers = itertools.count()

    def hand_out(count: int) -> None:
        for case in itertools.islice(cases, count):
            number = next(numbers)
            # before it is submitted: a pool that breaks at once must not lose the case
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
            # before the yield, so that no worker is idle while the caller handles the outcome
            hand_out(1)
            yield case, outcome


@contextmanager
def _processes(workers: int, common: tuple[Any, ...]) -> Generator[tuple[Executor, Any]]:
    """Yield a pool of processes that hold the shared fields, and their message queue; an error terminates them."""
    news: Any = _CONTEXT.Queue()
    with one_thread():
        # the calling program may have other child processes, which must survive
        before = set(multiprocessing.active_children())
        pool = ProcessPoolExecutor(workers, _CONTEXT, _begin, (common, news))
        try:
            yield pool, news
        except BaseException:
            # terminated: `shutdown` alone waits for the cases at work
            for child in set(multiprocessing.active_children()) - before:
                child.terminate()
            raise
        finally:
            pool.shutdown(cancel_futures=True)


# shared fields and message queue of a worker process, set once at its start: as arguments they would be sent with
# each case
_common: tuple[Any, ...] = ()
_news: Any = None


def _begin(common: tuple[Any, ...], news: Any) -> None:
    global _common, _news
    follow_parent()
    _common, _news = common, news


class _Told(Progress):
    """The progress of a case in a worker process, which sends the names of the stages to the parent process."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self._number = number

    def show_step(self, what: str, done: int | None, of: int | None, part: str) -> None:
        if of is None:  # not a part of the stage before
            _news.put((self._number, what))


def _here(case: Case[Any], number: int, detached: bool) -> Any:
    whole = attached(case, _common) if detached else case
    return computed(whole, _Told(number) if case.stages > 1 else Progress())


T = TypeVar("T")
MOST_WORKERS = 1024


class Bar:
    """The progress of one or several evaluations as a single count of steps that never decreases.

    A case counts with all its `stages` when it is done; while it runs, at most all but one of them are counted.
    """

    def __init__(self, progress: Progress, total: int) -> None:
        self.progress, self.total = progress, total
        self._counted = dict[str, int]()

    def stage(self, case: Case[Any], what: str) -> None:
        """Count the start of a stage of a case."""
        self._show(case.name, min(self._counted.get(case.name, 0) + 1, case.stages - 1), f"{case.name}: {what}")

    def finished(self, case: Case[Any]) -> None:
        """Count all stages of a case that is done."""
        self._show(case.name, case.stages, case.name)

    def step(self, what: str) -> None:
        """Count a step that belongs to no case."""
        self._show(what, 1, what)

    def of(self, case: Case[Any]) -> Progress:
        """Return the progress of one case, which is cancelled together with the evaluation."""
        return _Stages(self, case)

    def _show(self, name: str, count: int, what: str) -> None:
        self._counted[name] = count
        self.progress.step(what, sum(self._counted.values()), self.total)


class _Stages(Progress):
    """The progress of a case in this process."""

    def __init__(self, bar: Bar, case: Case[Any]) -> None:
        super().__init__()
        self._bar, self._case = bar, case

    @property
    def cancelled(self) -> bool:
        return self._bar.progress.cancelled

    def show_step(self, what: str, done: int | None, of: int | None, part: str) -> None:
        if of is not None:  # a part of the stage before
            self._bar.progress.show_step(what, done, of, part)
        elif self._case.stages > 1:
            self._bar.stage(self._case, what)


@dataclass(frozen=True)
class Engine:
    """The engine that computes cases, with a store of finished ones.

    workers       number of cases computed in parallel on this machine; with more than 1, the calling program must be
                  importable without side effects, with its main code under `if __name__ == "__main__":`
    scheduler     address of a Dask cluster that is used instead of this machine, such as tls://10.0.0.5:8786
    store         store of finished cases, which are not computed again; None to store nothing
    certificates  of this client for a scheduler with TLS; None: those of Dask's configuration, if there are any
    """

    workers: int = 1
    scheduler: str | None = None
    store: Store | None = None
    certificates: Certificates | None = None

    def __post_init__(self) -> None:
        if not 1 <= self.workers <= MOST_WORKERS:
            raise ParameterError(f"workers = {self.workers} must be 1 to {MOST_WORKERS}")

    @classmethod
    def of(
        cls,
        workers: int | None,
        scheduler: str | None = None,
        store: Store | None = None,
        certificates: Certificates | None = None,
    ) -> Engine:
        """Return the engine for these options; without `workers` it uses all cores.

        Raises ParameterError if both workers and a scheduler, which has its own workers, are given.
        """
        if workers is not None and scheduler is not None:
            raise ParameterError(
                f"workers = {workers} are of this machine, and the scheduler has its own: give one of them"
            )
        return cls(cores() if workers is None else workers, scheduler, store, certificates)

    def evaluate(self, cases: Sequence[Case[T]], progress: Progress | Bar | None = None) -> list[T]:
        """Return the outcomes of cases in order, from the store if known; new outcomes are stored on completion.

        progress  a progress, or the bar of several evaluations

        Raises CancelledError on a cancellation, WorkerError if processes or workers are lost repeatedly, FileError if
        the store cannot be written, and any error of a case: the first error stops the other cases.
        """
        bar = progress if isinstance(progress, Bar) else Bar(progress or Progress(), sum(c.stages for c in cases))
        outcomes = dict[int, T]()
        left = list[int]()
        for i, case in enumerate(cases):
            known = None if self.store is None else self.store.known(case, bar.of(case))
            if known is None:
                left.append(i)
                continue
            outcomes[i] = known
            bar.finished(case)
        # by identity: arrays in their fields make cases neither comparable nor hashable
        places = {id(cases[i]): i for i in left}
        with closing(self.finished((cases[i] for i in left), bar)) as finished:
            for case, outcome in finished:
                if self.store is not None:
                    self.store.keep(case, outcome)
                outcomes[places[id(case)]] = outcome
                bar.finished(case)
        return [outcomes[i] for i in range(len(cases))]

    def finished(self, cases: Iterable[C], progress: Progress | Bar | None = None) -> Generator[tuple[C, Any]]:
        """Yield each case with its outcome on completion; closing the generator stops the evaluation.

        Cases are taken from the iterable as workers become free.  The caller handles the store.
        Raises the errors of `evaluate`.
        """
        bar = progress if isinstance(progress, Bar) else Bar(progress or Progress(), 0)
        # two cases decide whether a pool is worth starting; the iterable may be too long to count
        some = list(itertools.islice(ahead := iter(cases), 2))
        cases = itertools.chain(some, ahead)
        if not some:
            return
        if self.scheduler is not None:
            # imported late, since Dask is an extra
            from feeddrive.evaluation import cluster

            yield from cluster.finished(cases, self.scheduler, bar.progress, certificates=self.certificates)
        elif some[0].threaded:
            yield from by_threads(cases, self.workers, bar.progress)
        elif some[0].isolated or min(self.workers, len(some)) > 1:
            yield from by_processes(cases, self.workers, bar.progress, bar.stage)
        else:
            for case in cases:
                bar.progress.check()
                yield case, case.outcome(bar.of(case))
