"""HDF5 files as saved by MATLAB 7.3 (save -v7.3); requires h5py (the extra `matlab`).

External links and external storage are not followed.

A single damaged bit can make HDF5's C library exhaust the memory or crash.  A separate process therefore reads the
file, with limits on memory (where the system supports them) and time, and returns plain arrays.
"""

from __future__ import annotations

import io
import json
import math
import os
import subprocess
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from typing import Any

import numpy as np

from feeddrive.files.columns import Columns, check_size, check_unpacked, is_wanted, most_unpacked
from feeddrive.language.errors import LogError, MissingExtraError

_DEEPEST = 8  # groups within groups
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
            [sys.executable, "-c", f"from {__name__} import answer; answer()"],
            input=request + b"\n" + content,
            capture_output=True,
            env=environment,
            timeout=_BASE_SECONDS + len(content) / _BYTES_PER_SECOND,
            check=True,
        )
        head, _, arrays = reader.stdout.partition(b"\n")
        told = json.loads(head)
    except (subprocess.SubprocessError, ValueError):  # it crashed, took too much memory or time, or was cut off
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
    except ImportError:  # Windows: only the time is limited there
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
    """Yield the dotted name of each dataset, with the numeric dataset or the reason why it is left out."""
    for key in group:
        label = f"{prefix}{key}"
        if key.startswith("#"):  # internal data of MATLAB cells and objects
            continue
        if not isinstance(group.get(key, getlink=True), h5py.HardLink):
            yield label, "a link to another place"
            continue
        item = group[key]
        if isinstance(item, h5py.Group):
            if depth < _DEEPEST:
                yield from _datasets(h5py, item, f"{label}.", depth + 1)
        elif item.external or item.is_virtual:
            yield label, "stored in another file"
        elif item.dtype.kind not in "fiu" or item.attrs.get("MATLAB_class", b"") == b"char":
            yield label, "text" if item.dtype.kind not in "fiu" or item.dtype.itemsize == 2 else "not real numbers"
        elif math.prod(item.shape) != max(item.shape, default=1):
            yield label, "a matrix"
        else:
            yield label, item
