"""MATLAB files of level 7.3 (save -v7.3), which are HDF5 files, and plain HDF5 files: their real numeric arrays.

Needs h5py (the extra `matlab`).  Links to other files and data stored in other files are not followed.
"""

from __future__ import annotations

import io
import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from feeddrive.files.columns import Columns, check_size, check_unpacked, is_wanted
from feeddrive.language.errors import LogError, MissingExtraError

_DEEPEST = 8


def read_mat73(name: str, content: bytes, wanted: frozenset[str] | None) -> Columns:
    """The columns of an HDF5 file, groups as `group.x`; a single number is a constant.

    Raises LogError for a damaged file, MissingExtraError without h5py.
    """
    try:
        import h5py
    except ImportError:
        raise MissingExtraError("h5py", "matlab", f"{name}: reading a MATLAB 7.3 or HDF5 file") from None
    values: dict[str, np.ndarray] = {}
    constants: dict[str, float] = {}
    left_out: dict[str, str] = {}
    unread: list[str] = []
    try:
        with h5py.File(io.BytesIO(content), "r") as file:
            for label, found in _datasets(h5py, file, "", 0):
                if isinstance(found, str):
                    left_out[label] = found
                elif found.size == 1:
                    constants[label] = float(np.asarray(found[()]).ravel()[0])
                elif is_wanted(label, wanted):
                    check_size(name, len(values) + 1, found.size)
                    check_unpacked(name, sum(each.size for each in values.values()) + found.size, len(content))
                    values[label] = np.asarray(found[()]).ravel().astype(np.float64)
                else:
                    unread.append(label)
    except LogError:
        raise
    except Exception:  # h5py hands every kind of error of its C library through
        raise LogError(f"{name}: is damaged or cut off; copy it again") from None
    return Columns("MATLAB 7.3 (HDF5)", values, {}, constants, tuple(unread), left_out)


def _datasets(h5py: Any, group: Any, prefix: str, depth: int) -> Iterator[tuple[str, Any]]:
    """Dotted name and dataset of everything numeric with one dimension, or why it is left out."""
    for key in group:
        label = f"{prefix}{key}"
        if key.startswith("#"):  # what MATLAB keeps for its cells and objects
            continue
        if not isinstance(group.get(key, getlink=True), h5py.HardLink):
            yield label, "a link to somewhere else"
            continue
        found = group[key]
        if isinstance(found, h5py.Group):
            if depth < _DEEPEST:
                yield from _datasets(h5py, found, f"{label}.", depth + 1)
        elif found.external or found.is_virtual:
            yield label, "stored in another file"
        elif found.dtype.kind not in "fiu" or found.attrs.get("MATLAB_class", b"") == b"char":
            yield label, "text" if found.dtype.kind not in "fiu" or found.dtype.itemsize == 2 else "no real numbers"
        elif math.prod(found.shape) != max(found.shape, default=1):
            yield label, "a matrix"
        else:
            yield label, found
