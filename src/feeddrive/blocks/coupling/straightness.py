"""The straightness of a guideway."""

from typing import Any

from feeddrive.language import ops
from feeddrive.language.block import Block, Number, choice, parameter, table


class Straightness(Block):
    """The lateral error of the tool point along a guideway, as a table over its travel.

        error = row((position - start) / spacing)

    The error is interpolated linearly between entries at start, start + spacing, ... and held beyond the ends.
    Source: ISO 230-1, straightness error of a linear motion.
    """

    along: str = choice("direction of the motion", options=("x", "y", "z"))
    across: str = choice("direction of the error", options=("x", "y", "z"))
    row: Any = table("m", "errors along the travel")
    start: Number = parameter("m", "position of the first entry")
    spacing: Number = parameter("m", "distance between entries", above=0)

    def at(self, position: Number) -> Number:
        """Return the error in m at a position in m."""
        return ops.interpolate(self.row, (position - self.start) / self.spacing)
