"""Arrays that numpy saved (.npy): numbers only, of one or two dimensions.

A structure gives a column for each of its fields, a matrix one for each of its short rows or columns.  Objects are
refused: numpy stores them as a pickle, which executes code when it is read.
"""

from __future__ import annotations

import io
import math
import re

import numpy as np
from numpy.lib import format as npy_format

from feeddrive.files.columns import Columns, check_size, is_wanted
from feeddrive.language.errors import LogError

START = b"\x93NUMPY"
_LONGEST_HEADER = 10_000
_MOST_COLUMNS = 64


def read_npy(name: str, content: bytes, wanted: frozenset[str] | None) -> Columns:
    """The columns of an array, numbered from 1 as `column_1`. Raises LogError for objects and for a damaged file."""
    array = _array(name, content)
    if array.dtype.names is not None:
        found = {str(field): array[field] for field in array.dtype.names}
    elif array.ndim == 1:
        found = {"column_1": array}
    else:
        columns = array if array.shape[0] > array.shape[1] else array.T
        if columns.shape[1] > _MOST_COLUMNS:
            raise LogError(
                f"{name}: is a matrix of {array.shape[0]} x {array.shape[1]}; a log has at most {_MOST_COLUMNS} columns"
            )
        found = {f"column_{k + 1}": columns[:, k] for k in range(columns.shape[1])}
    check_size(name, len(found), array.shape[0] if array.ndim else 0)
    values: dict[str, np.ndarray] = {}
    left_out: dict[str, str] = {}
    unread: list[str] = []
    for label, column in found.items():
        if column.dtype.kind not in "fiub" or column.ndim != 1:
            left_out[label] = "complex numbers" if column.dtype.kind == "c" else f"of type {column.dtype}"
        elif is_wanted(label, wanted):
            values[label] = column.astype(np.float64)
        else:
            unread.append(label)
    return Columns("numpy", values, unread=tuple(unread), left_out=left_out)


def _array(name: str, content: bytes) -> np.ndarray:
    """The array in a file, without a copy. Every length is checked before it is used."""
    file = io.BytesIO(content[: _LONGEST_HEADER + 32])
    try:
        version = npy_format.read_magic(file)
        read = npy_format.read_array_header_1_0 if version == (1, 0) else npy_format.read_array_header_2_0
        shape, by_columns, dtype = read(file, max_header_size=_LONGEST_HEADER)
    except Exception as error:  # the header is a Python literal, and numpy hands every kind of error of it through
        if re.search(rb"'descr': *\[?'?\|O", content[:_LONGEST_HEADER]):
            raise _objects(name) from None
        what = "its header is longer than any" if "max_header_size" in str(error) else "its header is damaged"
        raise LogError(f"{name}: is a numpy file that cannot be read: {what}; save it again") from None
    if dtype.hasobject:
        raise _objects(name)
    if not 1 <= len(shape) <= 2 or min(shape, default=0) < 0 or dtype.itemsize == 0:
        raise LogError(f"{name}: is an array of {len(shape)} dimensions; a log has one or two")
    size = math.prod(shape)
    start = file.tell()
    if len(content) - start != size * dtype.itemsize:
        raise LogError(
            f"{name}: is cut off or damaged: {size:,} numbers are stated, of {size * dtype.itemsize:,} bytes, "
            f"and {len(content) - start:,} bytes are there; copy it again"
        )
    return np.frombuffer(content, dtype, size, start).reshape(shape, order="F" if by_columns else "C")


def _objects(name: str) -> LogError:
    return LogError(
        f"{name}: holds Python objects, which are stored as a pickle and could execute code; they are never read: "
        "save its numbers as one array of float64"
    )
