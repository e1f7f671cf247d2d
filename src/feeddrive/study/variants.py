"""The values of any range of variants: the same numbers, however the range is split, in constant memory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from feeddrive.language.errors import ParameterError
from feeddrive.study import points
from feeddrive.study.study import Study


@dataclass(frozen=True, eq=False)
class Variants:
    """Variants first .. first + n - 1 of a study: by column n values, numbers in SI, texts and counts as objects."""

    first: int
    values: Mapping[str, np.ndarray]
    count: int

    def __len__(self) -> int:
        return self.count

    @property
    def numbers(self) -> np.ndarray:
        """The numbers of the variants."""
        return np.arange(self.first, self.first + self.count, dtype=np.int64)

    def chosen(self, places: np.ndarray) -> dict[str, np.ndarray]:
        """The values of some of them."""
        return {name: values[places] for name, values in self.values.items()}


def variants(study: Study, first: int = 0, count: int | None = None) -> Variants:
    """The variants of a range.

    Raises ParameterError for a range that is not in the study.
    """
    count = study.count - first if count is None else count
    if not (first >= 0 and count >= 0 and first + count <= study.count):
        raise ParameterError(f"variants {first} to {first + count - 1} are not in 0 to {study.count - 1}")
    drawn = _points(study, first, count)
    values: dict[str, np.ndarray] = {}
    at = 0
    for factor in study.vary:
        values |= factor.at(drawn[:, at : at + factor.dimensions])
        at += factor.dimensions
    return Variants(first, values, count)


def _points(study: Study, first: int, count: int) -> np.ndarray:
    """Points of the unit cube, shape (count, dimensions)."""
    dimensions = tuple(factor.dimensions for factor in study.vary)
    seed = (study.seed, study.stream)
    match study.sampler:
        case "grid":
            levels = [factor.levels for factor in study.vary]
            steps = points.grid(first, count, tuple(0 if row is None else len(row) for row in levels))
            return np.stack([row[steps[:, j]] for j, row in enumerate(levels) if row is not None], axis=1)
        case "latin_hypercube":
            return points.latin_hypercube(seed, first, count, sum(dimensions), study.points)
        case "sobol":
            return points.sobol(seed, first, count, sum(dimensions))
        case "saltelli":
            return points.saltelli(seed, first, count, dimensions, study.points)
        case _:
            return points.uniform(seed, first, count, sum(dimensions))
