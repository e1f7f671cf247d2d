"""A force recorded with a dynamometer, added at the tables of several axes."""

from collections.abc import Mapping
from typing import Any

from feeddrive.blocks.coupling.force_record import ForceRecord
from feeddrive.blocks.families import Coupling
from feeddrive.blocks.signals import Motion
from feeddrive.language import ops
from feeddrive.language.block import Number, parameter, part
from feeddrive.language.errors import StructureError


class DynamometerForce(Coupling):
    """The components of a measured cutting force, each applied to its own axis and updated in every substep.

        F_axis(t) = gain · row((t - offset) / interval)      linear between samples, 0 N before and after them

    Unlike a `Load`, which is sampled with the controller and held, it changes from substep to substep, and one record
    acts on all axes at the same instants.
    Do not use it where the force depends on the motion, as in chatter; use `MillingCut` there.
    """

    components: tuple[ForceRecord, ...] = part("components of the force, one an axis")
    interval: Number = parameter("s", "time between samples of the record", above=0)
    gain: Number = parameter("", "factor on all components", default=1)
    offset: Number = parameter("s", "instant of the first sample", default=0)

    def check(self) -> None:
        """Raise StructureError unless at least one axis is named, and each only once."""
        names = self.axes()
        if len(set(names)) < len(names) or not names:
            raise StructureError(
                f"dynamometer_force.components must name one or more axes, each axis once, not "
                f"{', '.join(names) or 'none'}"
            )

    def axes(self) -> tuple[str, ...]:
        """Return the names of the axes on which a component acts."""
        return tuple(component.axis for component in self.components)

    def step(
        self, prepared: Any, state: Any, motions: Mapping[str, Motion], time: Number, h: Number
    ) -> tuple[Any, dict[str, tuple[Number, Number]]]:
        place = (time - self.offset) / self.interval
        forces: dict[str, tuple[Any, Any]] = {}
        for component in self.components:
            row: Any = component.row
            last = float(ops.length(row) - 1)
            # `interpolate` alone would hold the ends of the record
            inside = ops.both(place >= 0.0, place <= last)
            forces[component.axis] = 0.0, ops.where(inside, self.gain * ops.interpolate(row, place), 0.0)
        return state, forces
