"""The sum of several forces."""

import numpy as np

from feeddrive.blocks.families import Load
from feeddrive.blocks.sampled import are_all
from feeddrive.language.block import part
from feeddrive.language.errors import StructureError


class ForceSum(Load):
    """The sum of several loads, F(t) = Σ Fᵢ(t) in N.

    Raises StructureError if there is no load.
    """

    loads: tuple[Load, ...] = part("loads that are added")

    def check(self) -> None:
        """Raise StructureError unless there is at least one load."""
        if not are_all(self.loads, Load):
            raise StructureError("force_sum.loads must be a tuple of loads, at least one")

    def at(self, t: np.ndarray) -> np.ndarray:
        total = self.loads[0].at(t)
        for load in self.loads[1:]:
            total = total + load.at(t)
        return total
