"""A move within limits of velocity and acceleration."""

from feeddrive.blocks.reference.limited_move import LimitedMove
from feeddrive.language.block import Number, parameter


class TrapezoidalMove(LimitedMove):
    """A trapezoid of velocity, or a triangle if the distance is too short, as commanded by LinuxCNC's planner.

        velocity = rectangle(height v, length distance/v) * boxcar(v/a)

    The acceleration jumps, so the jerk consists of impulses; jerk and snap are reported as 0.  The move shows the
    effect of a planner without a jerk limit; to move a real axis with a flexible structure, use a SnapLimitedMove.
    Raises StructureError for a move that would never end.
    """

    velocity: Number = parameter("m/s", "limit of the velocity", above=0)
    acceleration: Number = parameter("m/s2", "limit of the acceleration", above=0)

    def limits(self) -> tuple[float, ...]:
        return self.velocity, self.acceleration
