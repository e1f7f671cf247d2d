"""A move within limits of velocity, acceleration and jerk."""

from feeddrive.blocks.reference.limited_move import LimitedMove
from feeddrive.language.block import Number, parameter


class JerkLimitedMove(LimitedMove):
    """A velocity rectangle convolved with two boxcars: seven pieces of constant jerk.

        velocity = rectangle(height v, length distance/v) * boxcar(v/a) * boxcar(a/j)

    The jerk jumps, so the snap is a train of impulses; the snap is reported as 0.  A law that feeds snap forward
    should follow a SnapLimitedMove.  If the distance is too short to reach a limit, that limit is lowered, velocity
    first, then acceleration; this is the shortest move within these limits.
    Raises StructureError for a move that would never end.
    Source: Lambrechts, Boerlage & Steinbuch 2005, with one boxcar fewer.
    """

    velocity: Number = parameter("m/s", "limit of the velocity", above=0)
    acceleration: Number = parameter("m/s2", "limit of the acceleration", above=0)
    jerk: Number = parameter("m/s3", "limit of the jerk", above=0)

    def limits(self) -> tuple[float, ...]:
        return self.velocity, self.acceleration, self.jerk
