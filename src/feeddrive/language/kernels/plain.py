"""Arrays as the interpreter sees them in a kernel: cells are Python's numbers, rows are views."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
from numpy.typing import NDArray


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
        found: Any = self.held[key]
        return found.item() if isinstance(found, np.generic) else Cells(found)

    def __setitem__(self, key: Any, value: Any) -> None:
        if isinstance(value, tuple) and len(self.held[key]) != len(cast(tuple[Any, ...], value)):
            raise ValueError(f"{len(cast(tuple[Any, ...], value))} numbers for a row of {len(self.held[key])}")
        self.held[key] = value


def zeros(*sizes: int) -> NDArray[np.float64]:
    """A small array of a fixed size as a local variable of a kernel: one to three sizes, 256 numbers at most."""
    return cast(Any, Cells(np.zeros(sizes)))
