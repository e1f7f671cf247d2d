"""A move at constant velocity, as a linear interpolator commands it."""

import numpy as np

from feeddrive.blocks.reference.derivatives import Derivatives
from feeddrive.blocks.reference.move import Move
from feeddrive.language.block import Number, parameter


class LinearMove(Move):
    """The move x = distance · t / travel_time, whose velocity jumps at both ends.

    Within the leg all higher derivatives are 0; the impulses at its ends are omitted.
    When to use: to show the error at a corner without a velocity profile; to cut with a constant chip load.
    To move a real axis, use a JerkLimitedMove.
    Source: Beltrán-Carbajal et al. 2013, eqs. (19)-(22), with the constant feed of its simulation.
    """

    travel_time: Number = parameter("s", "time of one way", above=0)

    @property
    def leg_time(self) -> float:
        return self.travel_time

    def leg(self, t: np.ndarray) -> Derivatives:
        rest = np.zeros_like(t)
        velocity = abs(self.distance) / self.travel_time
        return velocity * t, np.full_like(t, velocity), rest, rest, rest
