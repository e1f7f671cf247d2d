"""Runs and logs as files: Parquet with units, sample time and provenance; CSV for other programs.

Both preserve every bit of the numbers, and identical runs give identical bytes.  Any other Parquet file with flat
columns of numbers can be read too.  The checksums of Parquet pages are verified.
"""

import contextlib
import csv
import io
import json
import math
import platform
import re
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from feeddrive.files.atomic_io import written_whole
from feeddrive.files.columns import Columns, arrow_column, arrow_numbers, check_size, check_unpacked, is_wanted
from feeddrive.language.errors import LogError, ParameterError
from feeddrive.language.quantity import Units
from feeddrive.language.text import resolve
from feeddrive.language.units import turning_key
from feeddrive.version import __version__

_KEY = b"feeddrive"
_GROUP = 65536  # rows of a row group
_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


def summary_text(figures: Mapping[str, Any], *, rotary: bool = False, quoted: Sequence[str] = ()) -> str:
    """Return named figures as JSON; for a rotary axis, with keys and sentences in rotary units.

    quoted  user-defined names and strings, which are left unchanged
    """
    units = Units(rotary=rotary)
    return json.dumps(_in_units(figures, units, frozenset(quoted)), indent=2) + "\n"


def _in_units(value: Any, units: Units, quoted: frozenset[str]) -> Any:
    """Return a JSON value with its keys and sentences converted to the given units."""
    if isinstance(value, Mapping):
        return {
            key if key in quoted else figure_key(key, units): _in_units(entry, units, quoted)
            for key, entry in value.items()
        }
    if isinstance(value, list | tuple):
        return [_in_units(entry, units, quoted) for entry in value]
    return resolve(value, units) if isinstance(value, str) else value


def figure_key(key: str, units: Units) -> str:
    """Return a figure key with the unit suffix in the given units: force_peak_N is force_peak_N_m on a rotary axis."""
    return turning_key(key) if units.rotary else key


def plain(value: float | None) -> float | str | None:
    """Return a figure as a JSON value: infinity becomes the string "infinite"."""
    # JSON has no infinity.
    return "infinite" if value is not None and math.isinf(value) else value


def figures_text(
    labels: Mapping[str, Sequence[str]], figures: Sequence[Mapping[str, float | None]], units: Units
) -> str:
    """Return a CSV table of label columns and one column per figure; a missing figure is an empty cell."""
    keys, text = list(dict.fromkeys(key for row in figures for key in row)), io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*labels, *(figure_key(key, units) for key in keys)])
    for names, row in zip(zip(*labels.values(), strict=True), figures, strict=True):
        cells = (row.get(key) for key in keys)
        writer.writerow([*names, *("" if cell is None else repr(float(cell)) for cell in cells)])
    return text.getvalue()


def read_parquet(name: str, content: bytes, wanted: frozenset[str] | None) -> Columns:
    """Read the columns of a Parquet file. Raise LogError if it is damaged or truncated."""
    import pyarrow as arrow
    from pyarrow import parquet

    values: dict[str, np.ndarray] = {}
    left_out: dict[str, str] = {}
    units: dict[str, str] = {}
    unread: list[str] = []
    try:
        file = parquet.ParquetFile(arrow.BufferReader(content), page_checksum_verification=True)
        schema = file.schema_arrow
        metadata = _metadata(schema.metadata or {})
        constants = {str(key): float(value) for key, value in dict(metadata.get("constants", {})).items()}
        units.update({key: str(unit) for key, unit in dict(metadata.get("units", {})).items()})
        chosen: list[str] = []
        for field in schema:
            numeric = arrow.types.is_integer(field.type) or arrow.types.is_floating(field.type)
            if not (numeric or arrow.types.is_boolean(field.type) or arrow.types.is_timestamp(field.type)):
                left_out[field.name] = f"of type {field.type}"
            elif is_wanted(field.name, wanted):
                chosen.append(field.name)
            else:
                unread.append(field.name)
        check_size(name, len(chosen), file.metadata.num_rows)
        check_unpacked(name, len(chosen) * file.metadata.num_rows, len(content))
        table = file.read(columns=chosen)
        for label in chosen:
            column = table.column(label)
            if arrow.types.is_timestamp(column.type):
                # as integers: ns since 1970 have 61 bits, a float64 has 53
                ticks = column.cast(arrow.int64())
                since = arrow_numbers(ticks) - (ticks[0].as_py() or 0) if len(ticks) else arrow_numbers(ticks)
                # From the first row on, which keeps nanoseconds in a float64.
                values[label] = since.astype(np.float64) * _SECONDS[column.type.unit]
                units[label] = "s"
            else:
                values[label] = arrow_numbers(column).astype(np.float64)
    except LogError:
        raise
    except Exception:
        # pyarrow passes on any error of its C++ library.
        raise LogError(f"{name}: is a damaged or cut off Parquet file; copy it again") from None
    return Columns("Parquet", values, units, constants, tuple(unread), left_out, metadata)


def _metadata(stored: Mapping[bytes, bytes]) -> dict[str, Any]:
    """Return the metadata written by feeddrive, or an empty dict for a file from another program."""
    metadata = json.loads(stored[_KEY]) if _KEY in stored else {}
    # A foreign entry under our key is damage, which the caller reports.
    if not isinstance(metadata, dict):
        raise ValueError
    return metadata


def write_parquet(path: str | Path, columns: Mapping[str, np.ndarray], metadata: Mapping[str, Any]) -> None:
    """Write columns of numbers with metadata (JSON), completely or not at all; the same content gives the same bytes.

    Raises FileError if it cannot be written, ParameterError for columns of unequal length or metadata that is not JSON.
    """
    with parquet_stream(path, list(columns), metadata) as append:
        append(columns)


@contextlib.contextmanager
def parquet_stream(
    path: str | Path, names: Sequence[str], metadata: Mapping[str, Any]
) -> Generator[Callable[[Mapping[str, np.ndarray]], None]]:
    """Write a Parquet file in chunks, in constant memory; it appears at the end or not at all.

    with parquet_stream(path, ["time", "force"], metadata) as append:
        append({"time": ..., "force": ...})
    """
    try:
        # Sorted keys give the same bytes for equal metadata; JSON has no NaN.
        text = json.dumps(metadata, sort_keys=True, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise ParameterError(f"{path}: metadata cannot be written as JSON: {error}") from None

    def append(columns: Mapping[str, np.ndarray]) -> None:
        arrays = [np.ascontiguousarray(columns[name], dtype=np.float64) for name in names]
        shapes = {name: array.shape for name, array in zip(names, arrays, strict=True)}
        if any(array.ndim != 1 for array in arrays) or len(set(shapes.values())) > 1:
            raise ParameterError(f"{path}: columns must have one dimension and one length, not {shapes}")
        import pyarrow as arrow

        writer = begun()
        table = arrow.Table.from_arrays([arrow_column(array) for array in arrays], schema=writer.schema)
        writer.write_table(table, row_group_size=_GROUP)

    with written_whole(path) as temporary, temporary.open("wb") as file, contextlib.ExitStack() as stack:

        @cache
        def begun() -> Any:
            # with the first rows: a program that is refused before needs no pyarrow
            return stack.enter_context(_parquet_writer(file, names, text))

        yield append
        begun()


def _parquet_writer(file: Any, names: Sequence[str], metadata: str) -> Any:
    """Open a Parquet file of columns of float64."""
    import pyarrow as arrow
    from pyarrow import parquet

    return parquet.ParquetWriter(
        file,
        arrow.schema([(name, arrow.float64()) for name in names], {_KEY: metadata.encode()}),
        compression="zstd",
        # measured floats hardly repeat, so that a dictionary costs space; their bytes of equal weight do repeat
        use_dictionary=False,
        column_encoding="BYTE_STREAM_SPLIT",
        # without it a flipped bit is another number, and no error
        write_page_checksum=True,
    )


_BLOCK = 65536  # rows that are converted to text at once


def write_run_parquet(
    path: str | Path,
    time: np.ndarray,
    columns: Mapping[str, np.ndarray],
    units: Mapping[str, str],
    sample_time: float,
    metadata: Mapping[str, Any] | None = None,
) -> None:
    """Write signals over time (s) as Parquet, completely or not at all; `read_log` reads them back, bit for bit.

    `metadata` (JSON) is stored with units and sample time.  Raises FileError if it cannot be written.
    """
    write_parquet(path, {"time": time, **columns}, _described(units, sample_time, metadata))


@contextlib.contextmanager
def run_stream(
    path: str | Path, units: Mapping[str, str], sample_time: float, metadata: Mapping[str, Any] | None = None
) -> Generator[Callable[[np.ndarray, Mapping[str, np.ndarray]], None]]:
    """Write a run as Parquet in chunks, in constant memory, with one column for each entry of `units`.

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
    """Write signals over time (s) as CSV with headers `name [unit]`, completely or not at all.

    Every number has the fewest digits that reproduce it exactly.  Raises FileError if it cannot be written.
    """
    import pyarrow as arrow
    from pyarrow import csv as arrow_csv

    arrays = [np.ascontiguousarray(column, dtype=np.float64) for column in (time, *columns.values())]
    if any(array.shape != arrays[0].shape or array.ndim != 1 for array in arrays):
        shapes = {name: array.shape for name, array in zip(("time", *columns), arrays, strict=True)}
        raise ParameterError(f"{path}: columns must have one dimension and one length, not {shapes}")
    # Headers are written separately: names may contain commas and quotes, which the csv module escapes.
    heads = io.StringIO()
    csv.writer(heads, lineterminator="\n").writerow(
        [_head(name, unit) for name, unit in (("time", "s"), *((name, units.get(name, "")) for name in columns))]
    )
    with written_whole(path) as temporary, temporary.open("wb") as file:
        file.write(heads.getvalue().encode("utf-8"))
        table = arrow.Table.from_arrays(list(map(arrow_column, arrays)), names=[str(k) for k in range(len(arrays))])
        arrow_csv.write_csv(table, file, arrow_csv.WriteOptions(include_header=False, batch_size=_BLOCK))


def _head(name: str, unit: str) -> str:
    return f"{name} [{unit}]" if unit else name


def versions() -> dict[str, str]:
    """Return the versions of feeddrive, Python and the numerical libraries, so that a run can be reproduced."""
    # Deferred: most programs that write files need neither.
    import llvmlite
    import scipy

    return {
        "feeddrive": __version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        "llvmlite": llvmlite.__version__,
    }


def file_names(rows: Iterable[Any]) -> list[str]:
    """Return a unique file name for each law: its letters and digits, with a number appended to duplicates."""
    names: list[str] = []
    for row in rows:
        plain = re.sub(r"[^a-z0-9]+", "_", row.name.lower()).strip("_") or "law"
        names.append(plain if plain not in names else f"{plain}_{len(names) + 1}")
    return names
