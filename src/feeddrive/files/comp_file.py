"""LinuxCNC compensation files (COMP_FILE of a joint): pitch error and backlash over the travel."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from feeddrive.blocks.compensation.pitch_compensation import PitchCompensation
from feeddrive.files.atomic_io import read_whole, write_whole
from feeddrive.language.errors import FileError, ParameterError
from feeddrive.language.quantity import Quantity

MOST = 256  # rows that LinuxCNC reads
_MOST_BYTES = 1_000_000


def comp_text(block: PitchCompensation, *, units: float = 1000.0, file_type: int = 0) -> str:
    """Return the rows of a compensation file: nominal, forward, reverse in machine units.

    units      machine units per meter: 1000 for mm
    file_type  COMP_FILE_TYPE of the joint. 0: positions actually reached in forward and in reverse motion;
               1: corrections to be added
    Raises ParameterError for another type and for more rows than LinuxCNC reads.
    """
    if file_type not in (0, 1):
        raise ParameterError(f"file_type = {file_type} must be 0 (positions reached) or 1 (what is added)")
    count = len(block.forward)
    if count > MOST:
        raise ParameterError(f"the compensation has {count} entries, and LinuxCNC reads {MOST}: learn a coarser one")
    nominal = block.table_start + block.spacing * np.arange(count)
    columns = [nominal, block.forward, block.backward]
    if file_type == 0:
        columns = [nominal, nominal - block.forward, nominal - block.backward]
    return "".join(" ".join(f"{units * float(x):.9f}" for x in row) + "\n" for row in zip(*columns, strict=True))


def write_comp_file(block: PitchCompensation, path: str | Path, *, units: float = 1000.0, file_type: int = 0) -> Path:
    """Write a compensation file, completely or not at all. Raises ParameterError as `comp_text`, and FileError."""
    place = Path(path)
    write_whole(place, comp_text(block, units=units, file_type=file_type))
    return place


def read_comp_file(path: str | Path, *, units: float = 1000.0, file_type: int = 0) -> PitchCompensation:
    """Read a compensation file in machine units, of which there are `units` per meter.

    LinuxCNC accepts any increasing positions; here they must be evenly spaced, as written by `write_comp_file`.
    Raises FileError, with the line, for a row without three numbers, positions that do not increase by a constant
    spacing, and fewer than two rows; ParameterError for another type.
    """
    if file_type not in (0, 1):
        raise ParameterError(f"file_type = {file_type} must be 0 (positions reached) or 1 (what is added)")
    place, rows = Path(path), list[list[float]]()
    for line, text in enumerate(read_whole(place, _MOST_BYTES).decode("utf-8", "replace").splitlines(), 1):
        if not text.strip():
            continue
        try:
            row = [float(word) for word in text.split()]
        except ValueError:
            row = []
        if len(row) != 3 or not np.all(np.isfinite(row)):
            raise FileError(
                f"{place}:{line}: '{text.strip()[:60]}' is no row of three numbers: nominal forward reverse"
            )
        if rows and row[0] <= rows[-1][0]:
            raise FileError(
                f"{place}:{line}: nominal {Quantity(row[0]):6} does not lie above {Quantity(rows[-1][0]):6}: sort the "
                "rows by the position"
            )
        rows.append(row)
    if len(rows) < 2:
        raise FileError(f"{place}: has {len(rows)} rows: a table needs two at least")
    table = np.array(rows) / units
    steps = np.diff(table[:, 0])
    spacing = float(table[-1, 0] - table[0, 0]) / (len(rows) - 1)
    uneven = np.flatnonzero(np.abs(steps - spacing) > 1e-3 * spacing)
    if uneven.size:
        raise FileError(
            f"{place}: rows {uneven[0] + 1} and {uneven[0] + 2} are {Quantity(units * steps[uneven[0]]):6} apart, not "
            f"{Quantity(units * spacing):6} as in the mean: give rows at one spacing"
        )
    added = table[:, 1:] if file_type == 1 else table[:, :1] - table[:, 1:]
    return PitchCompensation(
        forward=added[:, 0].copy(), backward=added[:, 1].copy(), table_start=float(table[0, 0]), spacing=spacing
    )
