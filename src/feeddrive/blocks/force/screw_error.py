"""The lead error of a screw in a drive with an axial spring."""

from typing import Any

from feeddrive.blocks.families import Force, Plant
from feeddrive.blocks.force.spring import check_spring
from feeddrive.blocks.plant.lead_error import LeadError
from feeddrive.blocks.signals import Motion
from feeddrive.language.block import Number, part


class ScrewError(Force):
    """The force of a screw's lead error, which deflects the spring between screw and table.

        spring force = stiffness (x_motor + e(x_motor) - x_load),  so  F_motor = -stiffness e,   F_load = +stiffness e

    The effects of the slope e' on the screw's torque and on the force of the damper are neglected; both are smaller by
    a factor of e', about 1e-4.  If the axis has backlash, specify the lead error in the backlash block, not here.  On a
    rigid axis the lead error belongs to the rotary encoder.
    """

    lead_error: LeadError = part("the error along the travel")

    def fits(self, plant: Plant, beside: tuple[Force, ...]) -> None:
        """Raise StructureError if the plant has no spring."""
        check_spring(self.kind, plant)

    def step(self, state: Any, plant: Any, motion: Motion, drive: Any, time: Any, h: Number) -> tuple[Any, Any, Any]:
        push = plant.stiffness * self.lead_error.at(motion.position_motor)
        return state, -push, push
