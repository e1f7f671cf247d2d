"""The engine: cases to outcomes, in this process, on the cores of this machine, or on a Dask cluster.

    engine = Engine(workers=4, store=Folder(Path("kept")))
    outcomes = engine.evaluate(cases, progress)          # in the order of the cases

    for case, outcome in engine.finished(cases, progress):    # as they are done; memory does not grow with the cases
        ...

Who computes a case changes nothing of its outcome.  Comparison, benchmark, study and run are declarations of cases on
this engine: process pools, Dask and what is resumed stand here alone.
"""

from __future__ import annotations

import itertools
from collections.abc import Generator, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any, TypeVar

from feeddrive.evaluation.case import Case
from feeddrive.evaluation.cores import by_processes, by_threads
from feeddrive.evaluation.store import Store
from feeddrive.language.errors import ParameterError
from feeddrive.language.progress import Progress
from feeddrive.loop.runner import cores

T = TypeVar("T")
C = TypeVar("C", bound=Case[Any])
MOST_WORKERS = 1024


class Bar:
    """The steps of one or several evaluations as one progress that never goes back.

    A case counts as its `stages`; while it is computed at most all but one of them are counted, all when it is done.
    """

    def __init__(self, progress: Progress, total: int) -> None:
        self.progress, self.total = progress, total
        self._counted = dict[str, int]()

    def stage(self, case: Case[Any], what: str) -> None:
        """Count a stage that begins within a case."""
        self._show(case.name, min(self._counted.get(case.name, 0) + 1, case.stages - 1), f"{case.name}: {what}")

    def finished(self, case: Case[Any]) -> None:
        """Count all stages of a case that is done."""
        self._show(case.name, case.stages, case.name)

    def step(self, what: str) -> None:
        """Count a step that is no case."""
        self._show(what, 1, what)

    def of(self, case: Case[Any]) -> Progress:
        """Return the progress of one case, which is cancelled with the whole."""
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
    """Where cases are computed, and where finished ones are kept.

    workers    how many are computed side by side on this machine; more than 1 only from a program that may be imported
               anew, as one with its work under `if __name__ == "__main__":`
    scheduler  the address of a Dask cluster that computes in place of this machine, as tcp://10.0.0.5:8786
    store      finished cases that are not computed again; None: nothing is kept
    """

    workers: int = 1
    scheduler: str | None = None
    store: Store | None = None

    def __post_init__(self) -> None:
        if not 1 <= self.workers <= MOST_WORKERS:
            raise ParameterError(f"workers = {self.workers} must be 1 to {MOST_WORKERS}")

    @classmethod
    def of(cls, workers: int | None, scheduler: str | None = None, store: Store | None = None) -> Engine:
        """Return the engine that options ask for; without `workers` it has all cores.

        Raises ParameterError for both workers and a scheduler, which has its own.
        """
        if workers is not None and scheduler is not None:
            raise ParameterError(
                f"workers = {workers} are of this machine, and the scheduler has its own: give one of them"
            )
        return cls(cores() if workers is None else workers, scheduler, store)

    def evaluate(self, cases: Sequence[Case[T]], progress: Progress | Bar | None = None) -> list[T]:
        """Return the outcomes of cases in their order; known ones are taken from the store, others kept as they end.

        progress  or the bar of several evaluations

        Raises CancelledError at a cancel, WorkerError if processes or workers are lost again and again, FileError if
        the store cannot be written, and what a case raises: the first error ends the others.
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
        places = {id(cases[i]): i for i in left}
        with closing(self.finished((cases[i] for i in left), bar)) as finished:
            for case, outcome in finished:
                if self.store is not None:
                    self.store.keep(case, outcome)
                outcomes[places[id(case)]] = outcome
                bar.finished(case)
        return [outcomes[i] for i in range(len(cases))]

    def finished(self, cases: Iterable[C], progress: Progress | Bar | None = None) -> Generator[tuple[C, Any]]:
        """Yield each case with its outcome as it is done; closing the generator ends the work.

        Cases are taken from the iterable as workers become free.  The store is left to the caller.
        Raises as `evaluate`.
        """
        bar = progress if isinstance(progress, Bar) else Bar(progress or Progress(), 0)
        some = list(itertools.islice(ahead := iter(cases), 2))
        cases = itertools.chain(some, ahead)
        if not some:
            return
        if self.scheduler is not None:
            from feeddrive.evaluation import cluster  # its client is an extra

            yield from cluster.finished(cases, self.scheduler, bar.progress)
        elif some[0].threaded:
            yield from by_threads(cases, self.workers, bar.progress)
        elif some[0].isolated or min(self.workers, len(some)) > 1:
            yield from by_processes(cases, self.workers, bar.progress, bar.stage)
        else:
            for case in cases:
                bar.progress.check()
                yield case, case.outcome(bar.of(case))
