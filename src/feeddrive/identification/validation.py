"""Cross-validation: each stretch of a log predicted by a fit of all others."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from feeddrive.language.errors import ParameterError
from feeddrive.language.table import Result, Table

GAP = 5  # rows beside a stretch that its fit does not use either: their residual is much the same


@dataclass(frozen=True, eq=False, repr=False)
class Validation(Result):
    """Of each stretch: its error when it was not used, over its measured RMS, and the parameters without it.

    relative  RMS of all errors on unused rows over the RMS of what was measured
    values    shape (stretches, parameters)
    """

    errors: np.ndarray
    relative: float
    values: np.ndarray
    unit: str

    def table(self) -> Table:
        """One row a stretch."""
        rows = [[f"{i + 1}", f"{100.0 * error:.3g}"] for i, error in enumerate(self.errors)]
        return Table(f"unused rows: {100.0 * self.relative:.3g} % RMS", ["stretch", "error %"], rows)


def cross_validated(columns: np.ndarray, measured: np.ndarray, folds: int, unit: str) -> Validation:
    """Leave out one stretch of rows after the other, with `GAP` rows beside it, and predict it.

    A stretch that holds a direction or a speed alone makes its fit one that never saw it; that shows as a large error.
    """
    n = measured.size
    if not 2 <= folds <= n // (4 * GAP):
        raise ParameterError(f"folds = {folds} must be >= 2 and <= {n // (4 * GAP)}, for {n} rows")
    edges = np.linspace(0, n, folds + 1).astype(int)
    squares, sizes, found = [], [], []
    for begin, end in pairwise(edges):
        used = np.ones(n, dtype=bool)
        used[max(0, begin - GAP) : end + GAP] = False
        values = np.linalg.lstsq(columns[used], measured[used], rcond=None)[0]
        off = measured[begin:end] - columns[begin:end] @ values
        squares.append(float(off @ off))
        sizes.append(float(measured[begin:end] @ measured[begin:end]))
        found.append(values)
    each = np.sqrt(np.array(squares) / np.maximum(np.array(sizes), np.finfo(float).tiny))
    return Validation(each, float(np.sqrt(sum(squares) / sum(sizes))), np.array(found), unit)
