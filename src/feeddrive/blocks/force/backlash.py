"""Backlash between screw and table."""

from typing import Any

from feeddrive.blocks.families import Force, Plant
from feeddrive.blocks.force.screw_error import ScrewError
from feeddrive.blocks.force.spring import check_spring
from feeddrive.blocks.plant.lead_error import LeadError
from feeddrive.blocks.signals import Motion
from feeddrive.language import ops
from feeddrive.language.block import Number, parameter, part
from feeddrive.language.errors import StructureError


class Backlash(Force):
    """A gap in the spring between the motor's and the load's body.

        δ = x_motor (+ e(x_motor)) - x_load
        spring force = stiffness · (δ - clip(δ, ±gap/2)),   so   F_motor = stiffness · (clip(δ, ±gap/2) - e) = -F_load

    The clip is evaluated at the middle of the substep; within the gap this is exact to second order in the substep. The
    damper of the plant acts within the gap too, like the oil film of a lubricated nut.
    Do not use it with substeps longer than a third of the period of the spring mode.
    Source: the dead-zone model, Nordin & Gutman 2002, section 2.
    """

    gap: Number = parameter("m", "free play between the two ends", least=0)
    lead_error: LeadError | None = part("lead error of the screw, if there is one too", default=None)

    def fits(self, plant: Plant, beside: tuple[Force, ...]) -> None:
        """Raise StructureError if the plant has no spring, or if another force deflects the same spring."""
        check_spring(self.kind, plant)
        if any(isinstance(other, (Backlash, ScrewError)) for other in beside):
            raise StructureError(
                "axis.forces: 'backlash' beside 'screw_error' or a second 'backlash' would count a deflection twice; "
                "give the lead error as backlash.lead_error"
            )

    def step(
        self, state: Any, plant: Any, motion: Motion, drive: Number, time: Number, h: Number
    ) -> tuple[Any, Any, Any]:
        stretch = motion.position_motor - motion.position_load
        half = 0.5 * self.gap
        if self.lead_error is None:
            push = plant.stiffness * ops.clip(stretch, -half, half)
        else:
            error = self.lead_error.at(motion.position_motor)
            push = plant.stiffness * (ops.clip(stretch + error, -half, half) - error)
        return state, push, -push
