"""A force as a function of position and time."""

from typing import Any

from feeddrive.blocks.families import Force, Plant
from feeddrive.blocks.signals import Motion
from feeddrive.language import ops
from feeddrive.language.block import Number, parameter, table


class ForceMap(Force):
    """A measured force on the load's body as a function of position, either constant in time or oscillating.

        F = row(x_load) · (mean + swing · sin(2π frequency t + phase))

    `row` is interpolated linearly between entries at begin, begin + spacing, ... and held beyond its ends; if no force
    is to act beyond the ends, begin and end the row with 0.  The force of a cable chain or a cover is a map that is
    constant in time (no swing).  A cutting force on a part of the travel is a map that oscillates at the tooth-passing
    frequency.
    """

    row: Number = table("N", "forces along the travel")
    begin: Number = parameter("m", "position of the first entry")
    spacing: Number = parameter("m", "distance between entries", above=0)
    mean: Number = parameter("", "part that is constant in time", default=1)
    swing: Number | None = parameter("", "part that oscillates; absent for none", default=None)
    frequency: Number = parameter("Hz", "frequency of the swing", above=0, default=1)
    phase: Number = parameter("rad", "phase of the swing at t = 0", default=0)

    def step(
        self, state: Any, plant: Plant, motion: Motion, drive: Number, time: Number, h: Number
    ) -> tuple[Any, Number, Number]:
        along = ops.interpolate(self.row, (motion.position_load - self.begin) / self.spacing)
        if self.swing is None:
            return state, 0.0, self.mean * along
        beat = self.swing * ops.sin(2.0 * ops.pi * self.frequency * time + self.phase)
        return state, 0.0, (self.mean + beat) * along
