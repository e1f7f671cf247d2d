"""The lead error of a screw along its travel."""

from typing import Any

from feeddrive.language import ops
from feeddrive.language.block import Block, Number, parameter, table


class LeadError(Block):
    """The lead error e of a screw: the nut is at x_nut = x_screw + e(x_screw).

    e is interpolated linearly between entries at start, start + spacing, ... and held beyond the ends of the row.
    """

    row: Any = table("m", "errors along the travel")
    start: Number = parameter("m", "position of the first entry")
    spacing: Number = parameter("m", "distance between entries", above=0)

    def at(self, position: Number) -> Number:
        """Return the lead error e, in m, at a position in m."""
        return ops.interpolate(self.row, (position - self.start) / self.spacing)
