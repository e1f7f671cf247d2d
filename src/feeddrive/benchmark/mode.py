"""The mode that drawn plants have and no law is told."""

from feeddrive.files.section import Section
from feeddrive.language.block import Number, parameter


class UnmodelledMode(Section):
    """The mode that every drawn plant has and no law is told; its numbers are drawn evenly in their logarithm.

        frequency = detune^u · max(1/(2π τ), above · detune · f),  -1 <= u <= 1,    τ = dead time + T/2
        modal mass = rigid mass / share,    shape 1 at drive and motor encoder, ±1 at the table and its encoder

    f is the frequency of the highest mode of the model, so that the mode lies at least `above` times higher.
    """

    detune: Number = parameter("", "factor by which its frequency is higher or lower", least=1)
    above: Number = parameter("", "least frequency over that of the highest mode of the model", above=1)
    share_least: Number = parameter("", "least rigid mass over its modal mass", above=0)
    share_most: Number = parameter("", "largest rigid mass over its modal mass", above=0)
    damping_least: Number = parameter("", "least damping ratio", above=0)
    damping_most: Number = parameter("", "largest damping ratio", above=0)

    @property
    def ranges(self) -> tuple[tuple[float, float], ...]:
        """The ranges of the detuning factor, the share and the damping ratio."""
        detune = float(self.detune)
        return (
            (1.0 / detune, detune),
            (float(self.share_least), float(self.share_most)),
            (float(self.damping_least), float(self.damping_most)),
        )
