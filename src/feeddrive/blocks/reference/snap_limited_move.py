"""A move within limits of velocity, acceleration, jerk and snap."""

from feeddrive.blocks.reference.limited_move import LimitedMove
from feeddrive.language.block import Number, parameter


class SnapLimitedMove(LimitedMove):
    """A velocity rectangle convolved with three boxcars: fifteen pieces of constant snap.

        velocity = rectangle(height v, length distance/v) * boxcar(v/a) * boxcar(a/j) * boxcar(j/s)

    Position, velocity, acceleration and jerk are continuous, the snap is ± s or 0.  If the distance is too short to
    reach a limit, that limit is lowered, velocity first, then acceleration, then jerk; see `boxcars.py`.  The move is
    the shortest of this family, which is not the time-optimal move: with the snap as the only limit it takes 7 %
    longer. Without a snap limit, use a JerkLimitedMove.
    Raises StructureError for a move that would never end.
    Source: Lambrechts, Boerlage & Steinbuch 2005 (fourth-order profiles).
    """

    velocity: Number = parameter("m/s", "limit of the velocity", above=0)
    acceleration: Number = parameter("m/s2", "limit of the acceleration", above=0)
    jerk: Number = parameter("m/s3", "limit of the jerk", above=0)
    snap: Number = parameter("m/s4", "limit of the snap", above=0)

    def limits(self) -> tuple[float, ...]:
        return self.velocity, self.acceleration, self.jerk, self.snap
