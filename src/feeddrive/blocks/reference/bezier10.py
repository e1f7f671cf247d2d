"""A move along a Bezier polynomial of degree ten."""

import numpy as np

from feeddrive.blocks.reference.derivatives import Derivatives, stretched
from feeddrive.blocks.reference.move import Move
from feeddrive.blocks.reference.smooth_step import tenth_degree
from feeddrive.language.block import Number, parameter


class Bezier10(Move):
    """The move x = distance · τ⁵(252 - 1050τ + 1800τ² - 1575τ³ + 700τ⁴ - 126τ⁵),   τ = t / travel_time.

    All derivatives up to the snap are continuous; the motion is not symmetric in time: four derivatives are 0 at the
    start, five at the end.  The velocity peaks at 2.6018 · distance / travel_time at τ = 4/9.
    Do not use it while cutting, unless the chip load follows the instantaneous feed.
    Source: the family of Bezier references in Beltrán-Carbajal et al. 2013; the coefficients follow from the
    derivatives that vanish at the ends.
    """

    travel_time: Number = parameter("s", "time of one way", above=0)

    @property
    def leg_time(self) -> float:
        return self.travel_time

    def leg(self, t: np.ndarray) -> Derivatives:
        return stretched(tenth_degree(t / self.travel_time), abs(self.distance), self.travel_time)
