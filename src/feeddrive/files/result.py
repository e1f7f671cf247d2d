"""Runs as files: Parquet with units and all that belongs to the run, CSV for everything else.

Both hold the numbers to the last bit, and the same run gives the same bytes.
"""

from __future__ import annotations

import contextlib
import csv
import io
from collections.abc import Callable, Generator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from feeddrive.files.readers.parquet import parquet_stream, write_parquet
from feeddrive.files.whole import written_whole
from feeddrive.language.errors import ParameterError

_BLOCK = 65536  # rows that are turned into text at once


def write_run_parquet(
    path: str | Path,
    time: np.ndarray,
    columns: Mapping[str, np.ndarray],
    units: Mapping[str, str],
    sample_time: float,
    metadata: Mapping[str, Any] | None = None,
) -> None:
    """Write signals over time (s) as Parquet, whole or not at all; `read_log` reads them back, bit for bit.

    `metadata` (JSON) is kept beside units and sample time.  Raises FileError if it cannot be written.
    """
    write_parquet(path, {"time": time, **columns}, _described(units, sample_time, metadata))


@contextlib.contextmanager
def run_stream(
    path: str | Path, units: Mapping[str, str], sample_time: float, metadata: Mapping[str, Any] | None = None
) -> Generator[Callable[[np.ndarray, Mapping[str, np.ndarray]], None]]:
    """The same for a run that comes piece by piece, in constant memory; the columns are those that have a unit.

    with run_stream(path, {"force": "N"}, T) as append:
        append(time, {"force": force})
    """
    names = ["time", *units]
    with parquet_stream(path, names, _described(units, sample_time, metadata)) as append:
        yield lambda time, columns: append({"time": time, **columns})


def _described(units: Mapping[str, str], sample_time: float, metadata: Mapping[str, Any] | None) -> dict[str, Any]:
    return {**(metadata or {}), "sample_time": float(sample_time), "units": {"time": "s", **units}}


def write_run_csv(
    path: str | Path, time: np.ndarray, columns: Mapping[str, np.ndarray], units: Mapping[str, str]
) -> None:
    """Write signals over time (s) as CSV with the heads `name [unit]`, whole or not at all.

    Every number is written with the fewest digits that give it back exactly.  Raises FileError if it cannot be written.
    """
    import pyarrow as arrow
    from pyarrow import csv as arrow_csv

    arrays = [np.ascontiguousarray(each, dtype=np.float64) for each in (time, *columns.values())]
    if any(array.shape != arrays[0].shape or array.ndim != 1 for array in arrays):
        shapes = {name: array.shape for name, array in zip(("time", *columns), arrays, strict=True)}
        raise ParameterError(f"{path}: columns must have one dimension and one length, not {shapes}")
    heads = io.StringIO()
    csv.writer(heads, lineterminator="\n").writerow(
        [_head(name, unit) for name, unit in (("time", "s"), *((name, units.get(name, "")) for name in columns))]
    )
    with written_whole(path) as temporary, temporary.open("wb") as file:
        file.write(heads.getvalue().encode("utf-8"))
        table = arrow.Table.from_arrays(arrays, names=[str(k) for k in range(len(arrays))])
        arrow_csv.write_csv(table, file, arrow_csv.WriteOptions(include_header=False, batch_size=_BLOCK))


def _head(name: str, unit: str) -> str:
    return f"{name} [{unit}]" if unit else name
