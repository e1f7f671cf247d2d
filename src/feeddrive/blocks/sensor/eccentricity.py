"""Eccentricity of a graduated disc on its shaft."""

from feeddrive.language import ops
from feeddrive.language.block import Block, Number, parameter


class Eccentricity(Block):
    """The error of an eccentric disc: error = amplitude · sin(2π x / period + phase).

    A disc with its center at a distance e from the shaft axis and a graduation of radius R has an error of up to e/R
    rad, which is an amplitude of e/R · period / 2π.
    """

    amplitude: Number = parameter("m", "largest error, seen at the table", least=0)
    period: Number = parameter("m", "table motion in one turn of the encoder", above=0)
    phase: Number = parameter("rad", "phase at x = 0", default=0)

    def at(self, position: Number) -> Number:
        """Return the error at a position, m."""
        return self.amplitude * ops.sin(2.0 * ops.pi * position / self.period + self.phase)
