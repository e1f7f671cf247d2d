"""Arrays in a kernel that the interpreter runs: cells are Python's numbers, rows are views or records."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from feeddrive.language.kernels.source import BOOL, Layout, layout_of


class Cells:
    """An array whose numbers come out as `float` and `int`.

    Numbers of numpy warn where Python raises (1.0 / 0.0), and whole numbers of numpy wrap around.
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
    """An array of records: its rows come out as records and take them."""

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
    """A record from the numbers of a row."""
    return layout.python(
        *(
            _record(kind.layout, numbers) if kind.layout else bool(next(numbers)) if kind == BOOL else next(numbers)
            for kind in layout.fields.values()
        )
    )


def columns(record: tuple[Any, ...]) -> list[float]:
    """The numbers of a record as a row of an array holds them, those of records inside one by one."""
    return [number for part in record for number in (columns(part) if isinstance(part, tuple) else (float(part),))]


def rows_for(record: type, *sizes: int) -> NDArray[np.float64]:
    """An array of zeros for records: of these sizes, with a column for each number of a record."""
    return np.zeros((*sizes, layout_of(record).width))


def zeros(*sizes: int) -> NDArray[np.float64]:
    """A small array of a fixed size as a local variable of a kernel: one to three sizes, 256 numbers at most."""
    return cast(Any, Cells(np.zeros(sizes)))
