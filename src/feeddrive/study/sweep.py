"""A sweep runs all variants of a study chunk by chunk, on this machine or on a Dask cluster, and stores the rows.

    result = sweep("ball_screw_series", "out", workers=2)
    result.store.table()

Each chunk is computed, written atomically and discarded, so that memory does not grow with the number of variants.
If a sweep ends early, the chunks written so far are retained, and `resume` computes the others; the rows are the same
as those of an uninterrupted sweep.
"""

import time
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from feeddrive.evaluation.engine import Engine
from feeddrive.evaluation.scheduler import Certificates
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
    """A completed sweep.

    ran      number of variants computed by this call; the others were already in the store
    seconds  computing time
    workers  number of threads or processes; 0 for a cluster
    """

    study: Study
    store: Store
    ran: int
    seconds: float
    workers: int

    def table(self) -> Table:
        """Tabulate the number of variants, of those whose figures could not be computed, and the computing speed."""
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
        """The number of variants whose figures could not be computed, and the first ten of them, with the reasons."""
        return bad_variants(self.store)


def sweep(
    study: StudyLike,
    out: str | Path,
    *,
    workers: int | None = None,
    resume: bool = False,
    scheduler: str | None = None,
    certificates: Certificates | None = None,
    allow: Sequence[str] = (),
    progress: Progress | None = None,
) -> Sweep:
    """Run all variants of a study and store the rows in `out` as a partitioned Parquet table (`Store`).

    study         a study file, the name of a bundled study, or a `Study`
    out           a directory, or an fsspec address such as s3://bucket/mill
    workers       number of parallel workers (default: all cores); the rows are bit-identical for any number
    resume        continue a sweep of this study in `out`; otherwise an existing sweep raises FileError
    scheduler     address of a Dask cluster to use instead of this machine, such as tls://10.0.0.5:8786
    certificates  of this client for a scheduler with TLS; None: those of Dask's configuration, if there are any
    allow         modules whose figures the study may measure

    Raises FileError if the study or store is invalid, or if the store can no longer be written; WorkerError if workers
    are unreachable or are lost repeatedly; CancelledError after a cancellation or Ctrl-C. After an error during the
    sweep, `resume` continues it.
    """
    # First, so that impossible options are refused before a file is read.
    engine = Engine.of(workers, scheduler, certificates=certificates)
    study = read_study(study, allow)
    store, progress = Store(out), progress or Progress()
    begun = time.perf_counter()
    done = store.begin(Manifest(study.text, study.digest, study.count, study.chunk), resume=resume)
    rate = Rate(study, done)
    # A generator, since a large study has more chunks than should be in memory.
    left = (Chunk(study, number) for number in range(study.chunks) if number not in done)
    try:
        rate.show(progress)
        # Closing the generator ends or cancels the remaining work, whatever stops this loop.
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
    """A counter of finished variants that computes their rate and the remaining time at this rate."""

    def __init__(self, study: Study, done: frozenset[int]) -> None:
        self._all = study.count
        self.before = sum(len(study.range(number)) for number in done)
        self.ran = 0
        self._begun = time.monotonic()

    @property
    def done(self) -> int:
        """The number of variants in the store."""
        return self.before + self.ran

    def add(self, variants: int) -> None:
        """Count finished variants."""
        self.ran += variants

    def text(self) -> str:
        """Return the state of the sweep as text: `3,200 of 10,000 variants, 1,250 a second, 5 s left`."""
        count = f"{self.done:,} of {self._all:,} variants"
        spent = time.monotonic() - self._begun
        # Chunks of an earlier call are not counted: they may come from a faster machine.
        if not self.ran or spent <= 0.0:
            return count
        per_variant = spent / self.ran
        return Text(f"{count}, {rate(1.0 / per_variant)} a second, {_time((self._all - self.done) * per_variant)} left")

    def kept(self, store: Store) -> str:
        """Return a sentence on the number of rows that were stored by a sweep that ended early."""
        if not self.done:
            return "nothing was written"
        return f"{self.done:,} of {self._all:,} variants are in {store.address}: go on with --resume"

    def show(self, progress: Progress) -> None:
        """Report the state of the sweep. Raise CancelledError after a cancellation."""
        progress.step(self.text(), self.done, self._all)


def rate(value: float) -> Quantity:
    """Return a rate with three digits, or as a whole number with thousands separators."""
    return Quantity(value, form=",.0f" if value >= 100.0 else "3")


def _time(seconds: float) -> str:
    for unit, size in (("days", 86400.0), ("h", 3600.0), ("min", 60.0)):
        # From two on: rounding to a whole number of units is coarse below that.
        if seconds >= 2.0 * size:
            return Text(f"{Quantity(seconds / size, unit):.0f SI}")
    return Text(f"{Quantity(seconds, 's'):.0f SI}")


def bad_variants(store: Store, most: int = 10) -> tuple[int, list[tuple[int, str]]]:
    """Return the number of variants without figures, and the numbers of the first `most` with the reasons."""
    count, first = 0, list[tuple[int, str]]()
    for part in store.batches([VARIANT, REASON]):
        bad = part.filter(part.column(REASON).is_valid())
        count += bad.num_rows
        some = bad.slice(0, most - len(first))
        first += zip(some.column(VARIANT).to_pylist(), some.column(REASON).to_pylist(), strict=True)
    return count, first
