"""Arrays of a kernel in the interpreter: cells are Python numbers, rows are views or records."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from feeddrive.language.kernels.source import BOOL, Layout, layout_of


class Cells:
    """An array whose elements are returned as `float` and `int`.

    NumPy numbers warn where Python raises an error (1.0 / 0.0), and NumPy integers wrap around.
    """

    __slots__ = ("held",)

    def __init__(self, held: np.ndarray) -> None:
        self.held = held

    def __len__(self) -> int:
        return len(self.held)

    def __getitem__(self, key: Any) -> Any:
        cell: Any = self.held[key]
        return cell.item() if isinstance(cell, np.generic) else Cells(cell)

    def __setitem__(self, key: Any, value: Any) -> None:
        if isinstance(value, tuple) and len(self.held[key]) != len(cast(tuple[Any, ...], value)):
            raise ValueError(f"{len(cast(tuple[Any, ...], value))} numbers for a row of {len(self.held[key])}")
        self.held[key] = value


class Rows:
    """An array of records: rows are read and assigned as records."""

    __slots__ = ("held", "layout")

    def __init__(self, held: np.ndarray, layout: Layout) -> None:
        self.held, self.layout = held, layout

    def __len__(self) -> int:
        return len(self.held)

    def __getitem__(self, key: Any) -> Any:
        row: np.ndarray = self.held[key]
        return Rows(row, self.layout) if row.ndim > 1 else _record(self.layout, iter(row.tolist()))

    def __setitem__(self, key: Any, record: Any) -> None:
        self.held[key] = columns(record)


def _record(layout: Layout, numbers: Iterator[float]) -> Any:
    """Return a record built from the numbers of a row."""
    return layout.python(
        *(
            _record(kind.layout, numbers) if kind.layout else bool(next(numbers)) if kind == BOOL else next(numbers)
            for kind in layout.fields.values()
        )
    )


def columns(record: tuple[Any, ...]) -> list[float]:
    """Return the numbers of a record as a row of an array; nested records are flattened."""
    return [number for part in record for number in (columns(part) if isinstance(part, tuple) else (float(part),))]


def rows_for(record: type, *sizes: int) -> NDArray[np.float64]:
    """Return an array of zeros for records, of the given sizes, with one column per number of a record."""
    return np.zeros((*sizes, layout_of(record).width))


def zeros(*sizes: int) -> NDArray[np.float64]:
    """Return a small array of fixed size for a local variable of a kernel: one to three sizes, at most 256 numbers."""
    return cast(Any, Cells(np.zeros(sizes)))
