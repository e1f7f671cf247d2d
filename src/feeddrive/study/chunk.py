"""Compute one chunk of a study and store it: variants simulated in batches, and rows in a Parquet file protected by a
digest.

A row depends only on the study and the number of its variant.  It does not depend on the chunk, the neighboring
variants, the vector width, the threads or the process that computes it.  Variants that need a different graph (another
law, another number of samples of dead time) form their own batches.  For a variant that cannot be built, is unstable or
diverges, the row contains the reason instead of figures; stability is checked only if a figure comes from the linear
model.

A SHA-256 of the whole file is stored in the footer of the Parquet file, as 64 hex digits in the key-value pair
`feeddrive.sha256`, where every Parquet reader can see it.  It is computed over the file with 64 zeros in its place, so
that any flipped bit, in a page or in the footer, is detected before pyarrow reads the file.  Page checksums do not
cover the footer: of 15,000 files with one flipped bit, 356 gave wrong rows and 74 a UnicodeDecodeError.
"""

from __future__ import annotations

import hashlib
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from feeddrive.evaluation.case import Case
from feeddrive.figures.figure import NEEDS, STATISTICS, Figure, Statistics
from feeddrive.figures.of_loops import LinearLoop
from feeddrive.language import ops, tree
from feeddrive.language.errors import CancelledError, FeeddriveError, plain
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text
from feeddrive.loop.hold import samples_of
from feeddrive.loop.machine import System
from feeddrive.loop.simulate import Run, simulate, simulate_batch
from feeddrive.study.study import Study
from feeddrive.study.variants import VariantGroup, Variants, variant_groups, variants

if TYPE_CHECKING:
    import pyarrow


STUDY = b"feeddrive.study"  # metadata key for the digest of the study
_KEY = b"feeddrive.sha256"
_BLANK = b"0" * 64
# Parquet footers are written in Thrift's compact protocol: 0x18 announces a binary as the next field, 0x40 its length
# of 64 bytes.
_VALUE = b"\x18\x40"


class DamagedChunkError(Exception):
    """The exception for a chunk whose bytes differ from those written; its message gives the reason."""


def chunk_bytes(rows: Any, study: str) -> bytes:
    """Return a pyarrow table as a Parquet file protected by a SHA-256, with the digest of its study."""
    import pyarrow as arrow
    from pyarrow import parquet

    sink = arrow.BufferOutputStream()
    signed = rows.replace_schema_metadata({STUDY: study.encode()})
    with parquet.ParquetWriter(sink, signed.schema, compression="zstd", write_page_checksum=True) as writer:
        writer.write_table(signed)
        # A digest of the right length keeps every offset of the file when it replaces the zeros.
        writer.add_key_value_metadata({_KEY: _BLANK})
    # The last occurrence is meant: the footer ends the file, and rows may hold the same bytes.
    head, mark, tail = sink.getvalue().to_pybytes().rpartition(_KEY + _VALUE + _BLANK)
    assert mark, "pyarrow writes keys and values side by side"
    return head + _KEY + _VALUE + _digest(head, tail) + tail


def chunk_rows(content: bytes, *, sealed: bool) -> tuple[Any, str]:
    """Return the rows of a chunk as a pyarrow table, and the digest of its study.

    Files without the SHA-256, as written by earlier versions, are read only if `sealed` is False; then only their pages
    are protected by checksums. Raises DamagedChunkError.
    """
    import pyarrow as arrow
    from pyarrow import parquet

    head, mark, tail = content.rpartition(_KEY + _VALUE)
    if mark and tail[:64] != _digest(head, tail[64:]):
        raise DamagedChunkError("its SHA-256 is not the one that was written into it")
    if sealed and not mark:
        raise DamagedChunkError("its SHA-256 is missing")
    try:
        rows = parquet.read_table(arrow.BufferReader(content), page_checksum_verification=True)
        study = (rows.schema.metadata or {}).get(STUDY, b"").decode()
        # Accessing the names decodes them from UTF-8, which checks them.
        _ = rows.column_names, rows.validate(full=True)
    except Exception as error:
        # pyarrow raises any error of its C++ library, and Unicode errors.
        raise DamagedChunkError(next(iter(str(error).splitlines()), type(error).__name__)) from None
    return rows.replace_schema_metadata(None), study


def _digest(head: bytes, tail: bytes) -> bytes:
    digest = hashlib.sha256(head)
    for part in (_KEY, _VALUE, _BLANK, tail):
        digest.update(part)
    return digest.hexdigest().encode()


VARIANT, REASON = "variant", "reason"  # columns of every table of rows


def run_chunk(study: Study, number: int, *, threads: int = 1, progress: Progress | None = None) -> pyarrow.Table:
    """Return the rows of one chunk: variant number, varied values, and figures in SI units or the reason why there are
    none.

    A cancellation through `progress` takes effect between two groups of variants.
    """
    within = study.range(number)
    drawn = variants(study, within.start, len(within))
    rows = Rows(study.measure, len(within))
    for group in variant_groups(study, drawn):
        for part, system in batches(group, rows):
            _judge(study, part, system, rows, threads, progress or Progress())
    return rows.table(drawn)


@dataclass(frozen=True, eq=False)
class Chunk(Case["pyarrow.Table"]):
    """A case of a sweep that computes one chunk of a study; its outcome is the rows."""

    kind: ClassVar[str] = "chunk"
    common: ClassVar[tuple[str, ...]] = ("study",)
    isolated: ClassVar[bool] = True  # figures may be user code

    study: Study
    number: int

    @property
    def name(self) -> str:
        """The number of the chunk and the range of its variants, as text."""
        variants = self.study.range(self.number)
        return f"chunk {self.number} (variants {variants.start} to {variants.stop - 1})"

    @property
    def threaded(self) -> bool:
        """True if all figures are statistics, computed by compiled code; models and single runs need Python."""
        return all(figure.needs == STATISTICS for figure in self.study.measure)

    def outcome(self, progress: Progress) -> pyarrow.Table:
        """Compute the rows of the chunk."""
        return run_chunk(self.study, self.number, progress=progress)


class Rows:
    """The figures and failure reasons of the variants of a chunk, by index in the chunk; a missing figure is NaN."""

    def __init__(self, measure: tuple[Figure, ...], count: int) -> None:
        self.figures = {figure.key: np.full(count, np.nan) for figure in measure}
        self.reasons: list[str | None] = [None] * count

    def refuse(self, place: int, reason: object) -> None:
        """Mark the variant at an index as failed: record the first reason only, and delete its figures."""
        # Some exceptions have no text: their type is the only reason left.
        self.reasons[place] = self.reasons[place] or plain(str(reason)) or type(reason).__name__
        for values in self.figures.values():
            values[place] = np.nan

    @contextmanager
    def refusing(self, place: int) -> Generator[None]:
        """Record an exception as the failure reason of the variant at an index.

        A sweep of thousands of variants must not end because one variant or a user-defined figure fails.
        """
        try:
            yield
        except (CancelledError, MemoryError):
            # Neither is a property of the variant: a row with such a reason would differ from that of another machine.
            raise
        except FeeddriveError as error:
            self.refuse(place, error)
        except Exception as error:
            # The text of a foreign exception, such as a KeyError, is often unclear without its type.
            self.refuse(place, f"{type(error).__name__}: {error}")

    def table(self, drawn: Variants) -> pyarrow.Table:
        """Return the rows as a pyarrow table, in the order of their variants."""
        # Deferred: the import takes 50 ms.
        import pyarrow as arrow

        columns: dict[str, Any] = {VARIANT: arrow.array(drawn.numbers)}
        columns |= {name: arrow.array(values) for name, values in drawn.values.items()}
        # `from_pandas` turns NaN into null, which other readers of Parquet count as missing.
        columns |= {name: arrow.array(values, from_pandas=True) for name, values in self.figures.items()}
        columns[REASON] = arrow.array(self.reasons, arrow.string())
        return arrow.table(columns)


def batches(group: VariantGroup, rows: Rows) -> Iterator[tuple[VariantGroup, System]]:
    """Yield the parts of a group that share one graph, with their systems; skip variants that cannot be built."""
    for alike in _alike(group):
        # Building all variants at once checks all of their values; only a failure is worth a search for the variants at
        # fault.
        part = group.chosen(alike)
        try:
            yield part, varied(part)
        except FeeddriveError:
            sound = _sound(part, np.arange(alike.size), rows)
            if sound.size:
                part = part.chosen(sound)
                yield part, varied(part)


def varied(group: VariantGroup) -> System:
    """Return the system of all variants of a group, with array-valued numbers. Raises the errors of `tree.vary`."""
    return tree.vary(group.system, group.changes)


def _alike(group: VariantGroup) -> list[np.ndarray]:
    """Group variants by the number of whole samples in their dead time and by the presence of a fractional sample.

    Both alter the graph, and hence the rounding of the results.
    """
    groups: dict[tuple[Any, ...], list[int]] = {}
    delays: list[Any] = []
    for loop in group.system.loops().values():
        path = tree.path_of(loop, "axis.actuator.dead_time")
        dead_time: Any = group.changes.get(path, loop.axis.actuator.dead_time)
        samples = samples_of(dead_time, loop.sample_time)
        delays += [ops.floor(samples), samples > ops.floor(samples)]
    # A dead time that does not vary is a single number.
    columns = [np.broadcast_to(delay, len(group.rows)).tolist() for delay in delays]
    for place, kind in enumerate(zip(*columns, strict=True)):
        groups.setdefault(kind, []).append(place)
    return [np.array(places) for places in groups.values()]


def _sound(group: VariantGroup, some: np.ndarray, rows: Rows) -> np.ndarray:
    """Return the indices of the variants that can be built; find the others by bisection and record the reasons."""
    try:
        if some.size == 1:
            group.one(int(some[0]))
        else:
            varied(group.chosen(some))
    except FeeddriveError as error:
        if some.size == 1:
            rows.refuse(int(group.rows[some[0]]), error)
            return some[:0]
        return np.concatenate([_sound(group, part, rows) for part in np.array_split(some, 2)])
    return some


def _judge(study: Study, group: VariantGroup, system: System, rows: Rows, threads: int, progress: Progress) -> None:
    """Compute the figures of variants that share one graph: from a batch, from linear models and from single runs."""
    wanted = {need: [figure for figure in study.measure if figure.needs == need] for need in NEEDS}
    if wanted["statistics"]:
        _gather(group, system, wanted["statistics"], rows, threads, progress)
    if not (wanted["model"] or wanted["run"]):
        return
    speed = group.speed if wanted["model"] else 0.0
    for place, row in enumerate(group.rows.tolist()):
        progress.check()
        # A variant that diverged in the batch has its reason: a model or a run would only confirm it.
        if rows.reasons[row] is None:
            with rows.refusing(row):
                linear = LinearLoop(group.loop(place), speed) if wanted["model"] else None
                for figure in wanted["model"]:
                    rows.figures[figure.key][row] = figure.value(linear)
                run = run_of(group, place) if wanted["run"] else None
                for figure in wanted["run"]:
                    rows.figures[figure.key][row] = figure.value(run)


def _gather(
    group: VariantGroup, system: System, wanted: Sequence[Figure], rows: Rows, threads: int, progress: Progress
) -> None:
    """Compute the statistics of a batch; if it cannot be run, bisect it to find the variants that cause the error."""
    # Several figures may use one signal, which is gathered only once.
    signals = dict.fromkeys(f"{group.port}{signal}" for figure in wanted for signal in figure.signals)
    try:
        batch = simulate_batch(
            system,
            group.references,
            load=group.loads,
            duration=group.duration,
            seed=group.seed,
            gather=list(signals),
            threads=threads,
            progress=progress,
        )
    except CancelledError:
        # CancelledError is a FeeddriveError as well, and must not become the reason of a variant.
        raise
    except FeeddriveError as error:
        if len(group.rows) == 1:
            rows.refuse(int(group.rows[0]), error)
            return
        # A batch fails as a whole: bisection finds one variant among n with 2 log2 n runs instead of n.
        for part in np.array_split(np.arange(len(group.rows)), 2):
            half = group.chosen(part)
            _gather(half, varied(half), wanted, rows, threads, progress)
        return
    statistics = Statistics(batch, group.port)
    for figure in wanted:
        rows.figures[figure.key][group.rows] = figure.read(statistics)
    # A diverged variant does not stop the batch: `left` is its sample, or -1 for a variant within bounds.
    for place in np.flatnonzero(batch.left >= 0):
        sample = int(batch.left[place])
        rows.refuse(
            int(group.rows[place]),
            Text(
                f"the loop left its bounds at sample {sample} (t = {Quantity(sample * batch.sample_time, 's'):6 SI}): "
                "it is unstable or was started far from its setpoint"
            ),
        )


def run_of(group: VariantGroup, place: int) -> Run:
    """Simulate one variant; for a machine, return the signals of the measured axis."""
    system = group.one(place)
    seed = int(group.seed[place])
    run = simulate(system, group.references, load=group.loads, duration=group.duration, seed=seed, name=group.axis)
    return run.axis(group.axis) if group.port else run
