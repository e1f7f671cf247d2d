"""A figure of a study: a number that is measured of every variant, its name, unit, meaning, and what it comes from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from feeddrive.language.errors import ParameterError
from feeddrive.loop.simulate import Batch

NEEDS = ("statistics", "model", "run")
BETTER = ("lower", "higher", "")


@dataclass(frozen=True)
class Figure:
    """A number that is measured of every variant.

    name     that of its column, with the SI unit at its end: following_error_rms_m
    unit     SI
    meaning  in words
    needs    "statistics", "model" or "run": what `of` is given
    of       of Statistics the values of all variants, shape (n,); of a LinearLoop or a Run one number, or None
             where it does not occur
    better   "lower", "higher", or empty where neither is
    signals  whose statistics are gathered, by their names of a single axis
    """

    name: str
    unit: str
    meaning: str
    needs: str
    of: Callable[[Any], Any]
    better: str = "lower"
    signals: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name, value, allowed in (("needs", self.needs, NEEDS), ("better", self.better, BETTER)):
            if value not in allowed:
                raise ParameterError(f"figure '{self.name}': {name} = {value!r} must be one of {', '.join(allowed)}")


@dataclass(frozen=True, eq=False)
class Statistics:
    """A batch as seen by one axis: `rms("force")` is an array over the variants; `port` is `x.` in a machine."""

    batch: Batch
    port: str = ""

    def rms(self, signal: str) -> np.ndarray:
        """Root of the mean square over the run."""
        return self.batch.rms[f"{self.port}{signal}"]

    def peak(self, signal: str) -> np.ndarray:
        """Largest absolute value over the run."""
        return self.batch.peak[f"{self.port}{signal}"]
