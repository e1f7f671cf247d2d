"""The general second-order filter of a drive's current setpoint path."""

from feeddrive.blocks.filter.biquad import SecondOrderSection, Section, prewarped, section, tustin
from feeddrive.language.block import Number, parameter


class SecondOrder(SecondOrderSection):
    """A filter with two zeros, two poles and unit gain at 0 Hz; each pair is prewarped at its own frequency.

        H(s) = (s²/ωz² + 2 damping_zero s/ωz + 1) / (s²/ωp² + 2 damping_pole s/ωp + 1),   ω = 2π frequency

    Far above both frequencies the gain is (frequency_pole / frequency_zero)².  Drive manuals call it the general
    second-order filter; it can be a low-pass with a stop band, or a lead.  With equal frequencies it is the `Notch`.
    """

    frequency_zero: Number = parameter("Hz", "natural frequency of the numerator", above=0)
    damping_zero: Number = parameter("", "damping ratio of the numerator", least=0, default=0.1)
    frequency_pole: Number = parameter("Hz", "natural frequency of the denominator", above=0)
    damping_pole: Number = parameter("", "damping ratio of the denominator", above=0, default=0.7)

    def prepare(self, T: Number) -> Section:
        # `tustin` scales each polynomial by its w²: this ratio restores the unit gain at 0 Hz
        ratio = prewarped(self.frequency_pole, T) / prewarped(self.frequency_zero, T)
        zeros = tustin(self.frequency_zero, self.damping_zero, T)
        return section(zeros, tustin(self.frequency_pole, self.damping_pole, T), ratio * ratio)
