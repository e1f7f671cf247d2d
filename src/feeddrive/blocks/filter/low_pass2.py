"""A second-order low-pass filter."""

from feeddrive.blocks.filter.biquad import SecondOrderSection, Section, low_pass_section
from feeddrive.language.block import Number, parameter


class LowPass2(SecondOrderSection):
    """A second-order low-pass (PT2), discretized by Tustin's method with prewarping at its own frequency.

        H(s) = ω² / (s² + 2 damping ω s + ω²),   ω = 2π frequency

    Its phase lag at a frequency f far below `frequency` is about 2 damping · f / frequency rad.
    """

    frequency: Number = parameter("Hz", "natural frequency", above=0)
    damping: Number = parameter("", "damping ratio", above=0, default=0.7)

    def prepare(self, T: Number) -> Section:
        return low_pass_section(self.frequency, self.damping, T)
