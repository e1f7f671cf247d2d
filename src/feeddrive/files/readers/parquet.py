"""Parquet: feeddrive's own format for logs and runs, with units, sample time and origin in the file's metadata.

Any other Parquet file with flat columns of numbers is read too.  Pages carry checksums, which are verified.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Generator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from feeddrive.files.columns import Columns, check_size, check_unpacked, is_wanted
from feeddrive.files.whole import written_whole
from feeddrive.language.errors import LogError, ParameterError

_KEY = b"feeddrive"
_GROUP = 65536  # rows of a row group
_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


def read_parquet(name: str, content: bytes, wanted: frozenset[str] | None) -> Columns:
    """The columns of a Parquet file. Raises LogError if it is damaged or cut off."""
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
                ticks = column.cast(arrow.int64())
                since = ticks.to_numpy() - (ticks[0].as_py() or 0) if len(ticks) else ticks.to_numpy()
                values[label] = since.astype(np.float64) * _SECONDS[column.type.unit]  # from the first row on
                units[label] = "s"
            else:
                values[label] = column.to_numpy().astype(np.float64)
    except LogError:
        raise
    except Exception:  # pyarrow hands every kind of error of its C++ library through
        raise LogError(f"{name}: is a damaged or cut off Parquet file; copy it again") from None
    return Columns("Parquet", values, units, constants, tuple(unread), left_out, metadata)


def _metadata(stored: Mapping[bytes, bytes]) -> dict[str, Any]:
    """What feeddrive wrote into the file; empty for a file of somebody else."""
    found = json.loads(stored[_KEY]) if _KEY in stored else {}
    if not isinstance(found, dict):
        raise ValueError
    return found


def write_parquet(path: str | Path, columns: Mapping[str, np.ndarray], metadata: Mapping[str, Any]) -> None:
    """Write columns of numbers and what belongs to them (JSON), whole or not at all; the same content, the same bytes.

    Raises FileError if it cannot be written, ParameterError for columns of unequal length or metadata that is no JSON.
    """
    with parquet_stream(path, list(columns), metadata) as append:
        append(columns)


@contextlib.contextmanager
def parquet_stream(
    path: str | Path, names: Sequence[str], metadata: Mapping[str, Any]
) -> Generator[Callable[[Mapping[str, np.ndarray]], None]]:
    """A Parquet file that is written piece by piece, in constant memory; it appears whole at the end or not at all.

    with parquet_stream(path, ["time", "force"], metadata) as append:
        append({"time": ..., "force": ...})
    """
    import pyarrow as arrow
    from pyarrow import parquet

    try:
        text = json.dumps(metadata, sort_keys=True, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise ParameterError(f"{path}: metadata cannot be written as JSON: {error}") from None
    schema = arrow.schema([(name, arrow.float64()) for name in names], {_KEY: text.encode()})

    def append(columns: Mapping[str, np.ndarray]) -> None:
        arrays = [np.ascontiguousarray(columns[name], dtype=np.float64) for name in names]
        shapes = {name: array.shape for name, array in zip(names, arrays, strict=True)}
        if any(array.ndim != 1 for array in arrays) or len(set(shapes.values())) > 1:
            raise ParameterError(f"{path}: columns must have one dimension and one length, not {shapes}")
        writer.write_table(arrow.Table.from_arrays(arrays, schema=schema), row_group_size=_GROUP)

    with (
        written_whole(path) as temporary,
        temporary.open("wb") as file,
        parquet.ParquetWriter(
            file,
            schema,
            compression="zstd",
            use_dictionary=False,
            column_encoding="BYTE_STREAM_SPLIT",
            write_page_checksum=True,
        ) as writer,
    ):
        yield append
