"""A notch filter for one resonance."""

from feeddrive.blocks.filter.biquad import SecondOrderSection, Section, notch_section
from feeddrive.language.block import Number, parameter


class Notch(SecondOrderSection):
    """A second-order notch by Tustin's method, prewarped at its own frequency, in direct form II transposed.

        H(s) = (s² + 2 ζn ω s + ω²) / (s² + 2 ζd ω s + ω²),   ω = 2π frequency
        s -> (2/T)(z - 1)/(z + 1),   ω -> (2/T) tan(ωT/2)

    Its depth is ζn/ζd.  Do not use it if the resonance shifts by more than the notch width (about 2 ζd · frequency).
    """

    frequency: Number = parameter("Hz", "centre of the notch", above=0)
    damping_zero: Number = parameter("", "damping ratio of the numerator: the depth", least=0, default=0.05)
    damping_pole: Number = parameter("", "damping ratio of the denominator: the width", above=0, default=0.5)

    def prepare(self, T: Number) -> Section:
        return notch_section(self.frequency, self.damping_zero, self.damping_pole, T)
