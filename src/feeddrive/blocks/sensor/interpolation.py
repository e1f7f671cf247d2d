"""Interpolation error of an encoder's sine signals."""

from feeddrive.language import ops
from feeddrive.language.block import Block, Number, parameter


class Interpolation(Block):
    """The interpolation error: error = first · sin(2π x / signal_period) + second · sin(4π x / signal_period).

    Offsets of the two signals cause the first harmonic, unequal amplitudes the second.  Good linear encoders stay below
    1 % of the signal period.
    """

    signal_period: Number = parameter("m", "length of one period of the encoder's signals", above=0)
    first: Number | None = parameter("m", "amplitude of the first harmonic; absent for none", least=0, default=None)
    second: Number | None = parameter("m", "amplitude of the second harmonic; absent for none", least=0, default=None)

    def apply(self, position: Number) -> Number:
        """Return the position with the error, m."""
        angle = 2.0 * ops.pi * position / self.signal_period
        reading = position
        if self.first is not None:
            reading = reading + self.first * ops.sin(angle)
        if self.second is not None:
            reading = reading + self.second * ops.sin(2.0 * angle)
        return reading
