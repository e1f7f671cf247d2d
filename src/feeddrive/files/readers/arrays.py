"""Arrays saved by numpy (.npy) and MATLAB (.mat, level 5 and 7.3).

numpy: numeric arrays of one or two dimensions.  A structured array gives a column for each field; the columns of
a matrix run along its longer dimension.  Objects are refused: numpy stores them as a pickle, which can execute code
when it is read.

MATLAB level 5 (save -v5, -v6, -v7): real numeric arrays are read, also in 1×1 structures as `s.x`.  The layout is
published by MathWorks (MAT-File Format, chapter 1): elements consist of a tag (type, length) and content, padded to 8
bytes; an array is an element that contains further elements (flags, dimensions, name, numbers); an element may be
compressed by zlib.

`scipy.io.loadmat` is not used: a damaged file can crash it (see tests/files/test_files_reasons.py), it decompresses
without a memory limit, and it creates objects.  Here every length is checked before it is used, and objects, functions,
cells, strings and sparse or complex arrays are left out.

MATLAB 7.3 (save -v7.3) is HDF5 and requires h5py (the extra `matlab`).  External links and external storage are not
followed.  A single damaged bit can make HDF5's C library exhaust the memory or crash.  A separate process therefore
reads the file, with limits on memory (where the system supports them) and time, and returns plain arrays.
"""

from __future__ import annotations

import io
import json
import math
import os
import re
import subprocess
import sys
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.lib import format as npy_format

from feeddrive.files.columns import MOST_NUMBERS, Columns, check_size, check_unpacked, is_wanted, most_unpacked
from feeddrive.language.errors import LogError, MissingExtraError

START = b"\x93NUMPY"
# the limit of numpy itself: a header is a Python literal, whose parser is not safe for a large one
_LONGEST_HEADER = 10_000
_MOST_COLUMNS = 64


def read_npy(name: str, content: bytes, wanted: frozenset[str] | None) -> Columns:
    """Read the columns of an array, numbered from 1 as `column_1`. Raise LogError for objects or a damaged file."""
    array = _array(name, content)
    if array.dtype.names is not None:
        arrays = {str(field): array[field] for field in array.dtype.names}
    elif array.ndim == 1:
        arrays = {"column_1": array}
    else:
        columns = array if array.shape[0] > array.shape[1] else array.T
        if columns.shape[1] > _MOST_COLUMNS:
            raise LogError(
                f"{name}: is a matrix of {array.shape[0]} x {array.shape[1]}; a log has at most {_MOST_COLUMNS} columns"
            )
        arrays = {f"column_{k + 1}": columns[:, k] for k in range(columns.shape[1])}
    check_size(name, len(arrays), array.shape[0] if array.ndim else 0)
    values: dict[str, np.ndarray] = {}
    left_out: dict[str, str] = {}
    unread: list[str] = []
    for label, column in arrays.items():
        if column.dtype.kind not in "fiub" or column.ndim != 1:
            left_out[label] = "complex numbers" if column.dtype.kind == "c" else f"of type {column.dtype}"
        elif is_wanted(label, wanted):
            values[label] = column.astype(np.float64)
        else:
            unread.append(label)
    return Columns("numpy", values, unread=tuple(unread), left_out=left_out)


def _array(name: str, content: bytes) -> np.ndarray:
    """Return the array of a .npy file without copying it; every length is checked before it is used."""
    file = io.BytesIO(content[: _LONGEST_HEADER + 32])
    try:
        version = npy_format.read_magic(file)
        read = npy_format.read_array_header_1_0 if version == (1, 0) else npy_format.read_array_header_2_0
        shape, by_columns, dtype = read(file, max_header_size=_LONGEST_HEADER)
    except Exception as error:  # the header is a Python literal, and numpy passes on any error of it
        if re.search(rb"'descr': *\[?'?\|O", content[:_LONGEST_HEADER]):
            raise _objects(name) from None
        what = "its header is too long" if "max_header_size" in str(error) else "its header is damaged"
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


_MATRIX, _PACKED = 14, 15
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_STRUCTURE = 2
_NUMERIC = range(6, 16)  # classes of arrays: double, single, int8 .. uint64
_OTHER = {1: "a cell array", 3: "an object", 4: "text", 5: "a sparse array", 16: "a function", 17: "an object"}
_COMPLEX = 0x08  # in the flags
# a level is a recursion, and a damaged file could nest without end
_DEEPEST = 8  # structures within structures


class _DamagedError(Exception):
    """The exception for bytes that violate the file format."""


@dataclass(frozen=True)
class _Bytes:
    """A range of bytes of the file, and its byte order, `<` or `>`."""

    content: memoryview
    order: str

    def word(self, at: int) -> int:
        if at + 4 > len(self.content):
            raise _DamagedError
        return int.from_bytes(self.content[at : at + 4], "little" if self.order == "<" else "big")

    def element(self, at: int) -> tuple[int, _Bytes, int]:
        """Return the type and content of the element at an offset, and the offset of the next element."""
        kind, length = self.word(at), self.word(at + 4)
        if kind >> 16:  # the short form: length and type in the first four bytes, content in the next four
            kind, length, start, end = kind & 0xFFFF, kind >> 16, at + 4, at + 8
            if length > 4:
                raise _DamagedError
        else:
            start = at + 8
            # a packed element is not padded to 8 bytes, unlike all others
            end = start + length if kind == _PACKED else start + (length + 7) // 8 * 8
        if start + length > len(self.content):
            raise _DamagedError
        return kind, _Bytes(self.content[start : start + length], self.order), end

    def numbers(self, kind: int) -> np.ndarray:
        if kind not in _NUMBERS:
            raise _DamagedError
        dtype = np.dtype(self.order + _NUMBERS[kind])
        if len(self.content) % dtype.itemsize:
            raise _DamagedError
        return np.frombuffer(self.content, dtype)


def read_mat(name: str, content: bytes, wanted: frozenset[str] | None) -> Columns:
    """Read the columns of a MATLAB 5 file; matrix columns are numbered from 1, and a scalar is a constant.

    Raises LogError for a truncated or damaged file, naming the last complete variable.
    """
    order = {b"IM": "<", b"MI": ">"}.get(content[126:128])
    if order is None:
        raise LogError(f"{name}: is a damaged MATLAB file: its header does not state a byte order")
    values: dict[str, np.ndarray] = {}
    constants: dict[str, float] = {}
    left_out: dict[str, str] = {}
    unread: list[str] = []
    whole = _Bytes(memoryview(content), order)
    at = 128
    last = ""
    left = most_unpacked(len(content))
    try:
        while at < len(content):
            kind, piece, at = whole.element(at)
            if kind == _PACKED:
                piece = _unpacked(name, piece, left)
                left -= len(piece.content)
            for variable, array in _arrays(piece, "", 0):
                last = variable
                if not variable:  # internal data of MATLAB objects
                    continue
                if isinstance(array, str):
                    left_out[variable] = array
                else:
                    numbers = sum(column.size for column in values.values()) + array.size
                    if wanted is None:
                        check_unpacked(name, numbers, len(content))
                    unread += _keep(variable, array, wanted, values, constants)
    except (_DamagedError, zlib.error, OverflowError):
        after = f" after variable '{last}'" if last else ""
        raise LogError(f"{name}: is damaged or cut off{after}; copy it again") from None
    if sum(column.size for column in values.values()) > MOST_NUMBERS:
        raise LogError(f"{name}: holds more than the {MOST_NUMBERS:,} numbers that are read; map fewer columns")
    return Columns("MATLAB 5", values, {}, constants, tuple(unread), left_out)


def _unpacked(name: str, packed: _Bytes, most: int) -> _Bytes:
    """Decompress an element to the length that its tag states. Raise LogError for more than `most` bytes."""
    zip_ = zlib.decompressobj()
    tag = _Bytes(memoryview(zip_.decompress(packed.content, 8)), packed.order)
    kind, length = tag.word(0), tag.word(4)
    if kind != _MATRIX:
        raise _DamagedError
    if length > most:
        raise LogError(f"{name}: its packed variables hold more than allowed; it is damaged or a zip bomb")
    # to zlib a limit of 0 bytes is none
    inner = zip_.decompress(zip_.unconsumed_tail, length) if length else b""
    if len(inner) != length:
        raise _DamagedError
    # Reads to the end of the stream, where zlib verifies its checksum.
    rest = zip_.decompress(zip_.unconsumed_tail, 8)
    if rest.strip(b"\0") or not zip_.eof:
        raise _DamagedError
    return _Bytes(memoryview(inner), packed.order)


def _arrays(piece: _Bytes, prefix: str, depth: int) -> Iterator[tuple[str, np.ndarray | str]]:
    """Yield the dotted name of each array in a matrix element, and its values or the reason why it is omitted."""
    if not len(piece.content):
        return
    _, flags, at = piece.element(0)
    kind_of_sizes, sizes, at = piece.element(at)
    _, letters, at = piece.element(at)
    array_class, is_complex = flags.word(0) & 0xFF, bool(flags.word(0) >> 8 & _COMPLEX)
    own = bytes(letters.content).decode("latin-1")
    name = prefix + own if own else prefix.rstrip(".")
    if array_class == 17:  # opaque: three names instead of dimensions
        yield bytes(sizes.content).decode("latin-1"), _OTHER[17]
        return
    shape = [int(size) for size in sizes.numbers(kind_of_sizes)]
    if min(shape, default=-1) < 0:
        raise _DamagedError
    if array_class == _STRUCTURE and shape == [1, 1]:
        if depth < _DEEPEST:
            yield from _fields(piece, at, name, depth)
        else:
            yield name, f"inside more than {_DEEPEST} structures"
    elif array_class in _NUMERIC and len(shape) > 2:
        yield name, f"an array of {len(shape)} dimensions"
    elif array_class not in _NUMERIC or is_complex:
        yield name, "complex numbers" if is_complex else _OTHER.get(array_class, "a structure of several elements")
    else:
        kind, numbers, _ = piece.element(at)
        values = numbers.numbers(kind)
        # as objects: the product of the sizes in a damaged file overflows 64 bits
        if values.size != np.prod(shape, dtype=object):
            raise _DamagedError
        yield name, values.reshape(shape, order="F")


def _fields(piece: _Bytes, at: int, name: str, depth: int) -> Iterator[tuple[str, np.ndarray | str]]:
    _, width, at = piece.element(at)
    _, letters, at = piece.element(at)
    size = width.word(0) if len(width.content) >= 4 else 0
    if not 0 < size <= 4096 or len(letters.content) % size:
        raise _DamagedError
    for start in range(0, len(letters.content), size):
        label = bytes(letters.content[start : start + size]).split(b"\0")[0].decode("latin-1")
        _, inner, at = piece.element(at)
        yield from _arrays(inner, f"{name}.{label}.", depth + 1)


def _keep(
    variable: str,
    array: np.ndarray,
    wanted: frozenset[str] | None,
    values: dict[str, np.ndarray],
    constants: dict[str, float],
) -> list[str]:
    """Store a scalar as a constant, or the requested columns of an array; return the names of the unread columns."""
    if array.size == 1:
        constants[variable] = float(array.ravel()[0])
        if wanted is not None and variable in wanted:
            values[variable] = array.ravel().astype(np.float64)
        return []
    if array.size == 0:
        return []
    rows = array if min(array.shape) > 1 else array.reshape(-1, 1)
    unread: list[str] = []
    for k in range(rows.shape[1] if rows.shape[1] <= 64 else 0):
        column = variable if rows.shape[1] == 1 else f"{variable}.{k + 1}"
        if is_wanted(column, wanted) or is_wanted(variable, wanted):
            values[column] = rows[:, k].astype(np.float64)
        else:
            unread.append(column)
    return unread


_DEEPEST_GROUP = 8  # groups within groups
# address space, not memory: libraries map much more than they use
_BASE_BYTES = 2**31  # of address space for Python, numpy and the library
_BASE_SECONDS, _BYTES_PER_SECOND = 60.0, 5e6  # a busy computer reads faster


def read_mat73(name: str, content: bytes, wanted: frozenset[str] | None) -> Columns:
    """Read the columns of an HDF5 file, members of groups as `group.x`; a scalar is a constant.

    Raises LogError for a damaged file, MissingExtraError without h5py.
    """
    if find_spec("h5py") is None:
        raise MissingExtraError("h5py", "matlab", f"{name}: reading a MATLAB 7.3 or HDF5 file")
    request = json.dumps({"name": name, "wanted": None if wanted is None else sorted(wanted)}).encode()
    # the other process finds the package where this one found it; threads of linear algebra take address space
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "OPENBLAS_NUM_THREADS": "1"}
    try:
        reader = subprocess.run(
            # -P: a module in the working directory, such as json.py, would be imported first, and run
            [sys.executable, "-P", "-c", f"from {__name__} import answer; answer()"],
            input=request + b"\n" + content,
            capture_output=True,
            env=environment,
            timeout=_BASE_SECONDS + len(content) / _BYTES_PER_SECOND,
            check=True,
        )
        head, _, arrays = reader.stdout.partition(b"\n")
        told = json.loads(head)
    except (subprocess.SubprocessError, ValueError):
        # The reader crashed, exceeded its memory or time, or its answer is incomplete.
        raise LogError(f"{name}: is damaged or cut off; copy it again") from None
    if "error" in told:
        raise LogError(told["error"])
    with np.load(io.BytesIO(arrays), allow_pickle=False) as stored:
        values = {label: stored[f"arr_{place}"] for place, label in enumerate(told["labels"])}
    return Columns("MATLAB 7.3 (HDF5)", values, {}, told["constants"], tuple(told["unread"]), told["left_out"])


def answer() -> None:
    """Run the reader process: read the request from standard input, write columns or error to standard output."""
    head = json.loads(sys.stdin.buffer.readline())
    content = sys.stdin.buffer.read()
    _limit_memory(_BASE_BYTES + 3 * len(content) + 3 * most_unpacked(len(content)))
    try:
        wanted = None if head["wanted"] is None else frozenset(head["wanted"])
        columns = read_here(head["name"], content, wanted)
    except LogError as error:
        sys.stdout.write(json.dumps({"error": str(error)}))
        return
    told = {
        "labels": list(columns.values),
        "constants": dict(columns.constants),
        "unread": columns.unread,
        "left_out": dict(columns.left_out),
    }
    arrays = io.BytesIO()
    np.savez(arrays, *columns.values.values())
    sys.stdout.buffer.write(json.dumps(told).encode() + b"\n" + arrays.getvalue())


def _limit_memory(most: int) -> None:
    """Limit the address space of this process, in bytes, on systems that support it."""
    try:
        import resource
    except ImportError:
        # Windows has no such limit: only the time is limited there.
        return
    resource.setrlimit(resource.RLIMIT_AS, (most, most))


def read_here(name: str, content: bytes, wanted: frozenset[str] | None) -> Columns:
    """Read the columns of an HDF5 file in this process. Raise LogError."""
    import h5py

    values: dict[str, np.ndarray] = {}
    constants: dict[str, float] = {}
    left_out: dict[str, str] = {}
    unread: list[str] = []
    try:
        with h5py.File(io.BytesIO(content), "r") as file:
            for label, dataset in _datasets(h5py, file, "", 0):
                if isinstance(dataset, str):
                    left_out[label] = dataset
                elif dataset.size == 1:
                    constants[label] = float(np.asarray(dataset[()]).ravel()[0])
                elif is_wanted(label, wanted):
                    check_size(name, len(values) + 1, dataset.size)
                    check_unpacked(name, sum(column.size for column in values.values()) + dataset.size, len(content))
                    values[label] = np.asarray(dataset[()]).ravel().astype(np.float64)
                else:
                    unread.append(label)
    except LogError:
        raise
    except Exception:  # h5py passes on any error of its C library
        raise LogError(f"{name}: is damaged or cut off; copy it again") from None
    return Columns("MATLAB 7.3 (HDF5)", values, {}, constants, tuple(unread), left_out)


def _datasets(h5py: Any, group: Any, prefix: str, depth: int) -> Iterator[tuple[str, Any]]:
    """Yield the dotted name of each dataset, and the dataset itself or the reason why it is omitted."""
    for key in group:
        label = f"{prefix}{key}"
        # Internal data of MATLAB cells and objects.
        if key.startswith("#"):
            continue
        if not isinstance(group.get(key, getlink=True), h5py.HardLink):
            yield label, "a link to another place"
            continue
        item = group[key]
        if isinstance(item, h5py.Group):
            if depth < _DEEPEST_GROUP:
                yield from _datasets(h5py, item, f"{label}.", depth + 1)
            else:
                yield label, f"inside more than {_DEEPEST_GROUP} groups"
        elif item.external or item.is_virtual:
            yield label, "stored in another file"
        elif item.dtype.kind not in "fiu" or item.attrs.get("MATLAB_class", b"") == b"char":
            yield label, "text" if item.dtype.kind not in "fiu" or item.dtype.itemsize == 2 else "not real numbers"
        elif math.prod(item.shape) != max(item.shape, default=1):
            yield label, "a matrix"
        else:
            yield label, item
