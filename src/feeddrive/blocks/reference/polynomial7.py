"""A move along a polynomial of degree seven."""

import numpy as np

from feeddrive.blocks.reference.derivatives import Derivatives, stretched
from feeddrive.blocks.reference.move import Move
from feeddrive.blocks.reference.smooth_step import seventh_degree
from feeddrive.language.block import Number, parameter


class Polynomial7(Move):
    """The move x = distance · (-20τ⁷ + 70τ⁶ - 84τ⁵ + 35τ⁴),   τ = t / travel_time.

    Velocity, acceleration and jerk are 0 at both ends; the snap jumps there, to ±840 distance / travel_time⁴.
    Peaks: velocity 35/16 · distance / travel_time in the middle, acceleration 84/(5√5) · distance / travel_time² at
    τ = 1/2 ± 1/(2√5), jerk 52.5 · distance / travel_time³ in the middle.
    Not suitable for long distances, since it never cruises; a SnapLimitedMove within the same limits is faster.
    Source: the polynomial of degree 7 is unique if velocity, acceleration and jerk are 0 at both ends.
    """

    travel_time: Number = parameter("s", "time of one way", above=0)

    @property
    def leg_time(self) -> float:
        return self.travel_time

    def leg(self, t: np.ndarray) -> Derivatives:
        return stretched(seventh_degree(t / self.travel_time), abs(self.distance), self.travel_time)
