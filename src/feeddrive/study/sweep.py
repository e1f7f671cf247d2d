"""A sweep: all variants of a study run on this machine or on a Dask cluster, chunk by chunk, into a store.

    result = sweep("ball_screw_series", "out", workers=2)
    result.store.table()

A chunk is computed, written whole, and forgotten, so that memory does not grow with the number of variants.  Whatever
ends a sweep, what is written stays, and `resume` computes the rest: to the same rows as a sweep that nothing disturbed.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from feeddrive.evaluation.engine import Engine
from feeddrive.language.errors import CancelledError, WorkerError
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity, unit_name
from feeddrive.language.table import Column, Result, Table
from feeddrive.language.text import Text
from feeddrive.study.chunk import REASON, VARIANT, Chunk
from feeddrive.study.store import Manifest, Store
from feeddrive.study.study import Study, StudyLike, read_study


@dataclass(frozen=True, eq=False, repr=False)
class Sweep(Result):
    """A sweep whose rows are complete.

    ran      variants that this call computed; the others were there already
    seconds  that it took
    workers  how many worked: threads or processes; 0 for those of a cluster
    """

    study: Study
    store: Store
    ran: int
    seconds: float
    workers: int

    def table(self) -> Table:
        """How many variants there are, how many of them have no figures, and how quick it was."""
        rows = [
            ["variants", self.study.count],
            ["without figures", self.bad[0]],
            ["computed now", self.ran],
            [f"in {unit_name('s', 's')}", Quantity(self.seconds, "s", form="3 SI", bare=True)],
            ["a second", rate(self.ran / self.seconds) if self.ran else None],
        ]
        columns = ["variants", Column("", "", ",.0f")]
        return Table(f"{self.study.title}: rows in {self.store.address}", columns, rows)

    @cached_property
    def bad(self) -> tuple[int, list[tuple[int, str]]]:
        """How many variants have no figures, and number and reason of the first ten."""
        return bad_variants(self.store)


def sweep(
    study: StudyLike,
    out: str | Path,
    *,
    workers: int | None = None,
    resume: bool = False,
    scheduler: str | None = None,
    allow: Sequence[str] = (),
    progress: Progress | None = None,
) -> Sweep:
    """Run all variants of a study; the rows stand in `out` as a partitioned Parquet table (`Store`).

    study      a study file, the name of a bundled study, or what `read_study` gave
    out        a directory, or an address of fsspec such as s3://bucket/mill
    workers    how many work side by side (default: all cores); they change no bit of the rows
    resume     go on with a sweep of this study that is in `out`; without it one that is there is refused
    scheduler  address of a Dask cluster that computes in place of this machine, as tcp://10.0.0.5:8786
    allow      modules whose figures the study may name

    Raises FileError for a study or store that cannot be used, and for a store that cannot be written any more;
    WorkerError for workers that cannot be reached or are lost again and again; CancelledError after a cancel or Ctrl-C.
    After each of them `resume` goes on.
    """
    engine = Engine.of(workers, scheduler)
    study = read_study(study, allow)
    store, progress = Store(out), progress or Progress()
    begun = time.perf_counter()
    done = store.begin(Manifest(study.text, study.digest, study.count, study.chunk), resume=resume)
    rate = Rate(study, done)
    left = (Chunk(study, number) for number in range(study.chunks) if number not in done)
    try:
        rate.show(progress)
        with closing(engine.finished(left, progress)) as chunks:
            for chunk, rows in chunks:
                store.write(chunk.number, rows)
                rate.add(rows.num_rows)
                rate.show(progress)
    except (CancelledError, KeyboardInterrupt):
        raise CancelledError(f"stopped; {rate.kept(store)}") from None
    except WorkerError as error:
        raise WorkerError(f"{error}; {rate.kept(store)}") from None
    return Sweep(study, store, rate.ran, time.perf_counter() - begun, 0 if scheduler else engine.workers)


class Rate:
    """Counts the finished variants; gives their rate, and the time that the rest takes at this rate."""

    def __init__(self, study: Study, done: frozenset[int]) -> None:
        self._all = study.count
        self.before = sum(len(study.range(number)) for number in done)
        self.ran = 0
        self._begun = time.monotonic()

    @property
    def done(self) -> int:
        """Variants that are in the store."""
        return self.before + self.ran

    def add(self, variants: int) -> None:
        """Count variants that were finished."""
        self.ran += variants

    def text(self) -> str:
        """The state in words: `3,200 of 10,000 variants, 1,250 a second, 5 s left`."""
        count = f"{self.done:,} of {self._all:,} variants"
        spent = time.monotonic() - self._begun
        if not self.ran or spent <= 0.0:
            return count
        per_variant = spent / self.ran
        return Text(f"{count}, {rate(1.0 / per_variant)} a second, {_time((self._all - self.done) * per_variant)} left")

    def kept(self, store: Store) -> str:
        """The rows that are kept of a sweep that ends early, in words."""
        if not self.done:
            return "nothing was written"
        return f"{self.done:,} of {self._all:,} variants are in {store.address}: go on with --resume"

    def show(self, progress: Progress) -> None:
        """Report the state. Raises CancelledError after a cancel."""
        progress.step(self.text(), self.done, self._all)


def rate(value: float) -> Quantity:
    """Return a rate that is read to three digits, or as a whole number with commas."""
    return Quantity(value, form=",.0f" if value >= 100.0 else "3")


def _time(seconds: float) -> str:
    for unit, size in (("days", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2.0 * size:
            return Text(f"{Quantity(seconds / size, unit):.0f SI}")
    return Text(f"{Quantity(seconds, 's'):.0f SI}")


def bad_variants(store: Store, most: int = 10) -> tuple[int, list[tuple[int, str]]]:
    """How many variants have no figures, and number and reason of the first ones; chunk by chunk."""
    count, first = 0, list[tuple[int, str]]()
    for part in store.batches([VARIANT, REASON]):
        bad = part.filter(part.column(REASON).is_valid())
        count += bad.num_rows
        some = bad.slice(0, most - len(first))
        first += zip(some.column(VARIANT).to_pylist(), some.column(REASON).to_pylist(), strict=True)
    return count, first
