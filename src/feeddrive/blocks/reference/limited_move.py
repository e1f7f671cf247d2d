"""The base class of all limited moves, built by convolution with rectangular (boxcar) pulses."""

from abc import ABC, abstractmethod
from functools import cached_property

import numpy as np

from feeddrive.blocks.reference.boxcars import limited_profile
from feeddrive.blocks.reference.derivatives import Derivatives
from feeddrive.blocks.reference.move import Move
from feeddrive.blocks.reference.profile import Profile
from feeddrive.blocks.reference.stretches import Stretch, rest


class LimitedMove(Move, ABC):
    """A move whose leg velocity is a rectangle convolved with one boxcar per limit of a higher derivative."""

    @abstractmethod
    def limits(self) -> tuple[float, ...]:
        """Return the limits in SI units: velocity, acceleration, ... up to the piecewise constant derivative."""

    @cached_property
    def profile(self) -> Profile | None:
        """The profile of the leg, checked against its limits by integration; `peaks` holds its peak values.

        It is None for a distance of 0.
        """
        return limited_profile(self.kind, abs(self.distance), self.limits()) if self.distance else None

    @property
    def leg_time(self) -> float:
        """The duration of a leg, which is the sum of all lengths in its profile, s."""
        return self.profile.duration if self.profile else 0.0

    def leg(self, t: np.ndarray) -> Derivatives:
        if self.profile is None:
            rest = np.zeros_like(t)
            return rest, rest, rest, rest, rest
        return self.profile.at(t)

    def stretches(self) -> tuple[Stretch, ...]:
        """Return the dwells and the pieces of all legs, in order of time."""
        stretches = [rest(0.0, self.start)]
        for way, last in self.ways():
            if self.profile is not None:
                stretches += [Stretch(way, piece) for piece in self.profile.pieces]
            stretches.append(rest(way.ends(), last))
        return tuple(stretches)
